"""Check of a learner's update that was refused: it is made again, and what goes wrong first is named."""

from pathlib import Path

from zsdist.diagnostics.result import CheckResult, CheckStatus
from zsdist.roles import divergence
from zsdist.run import program


def check_update(file: Path) -> CheckResult:
    """Make the update in a file of a run's folder `nan` again.

    Raises:
        RunError: the file cannot be read, or holds no update.
    """
    from zsdist.roles.rollback import read_update  # torch takes two seconds to import, and no other check needs it

    update = read_update(file, program.make_learner)
    found = update.dqn.examine(update.batch)
    where = f"update {update.number} of the {update.level} level"
    if found is None:
        return CheckResult("update", CheckStatus.OK, f"{where}: all of its numbers are finite and in range")
    remedy = divergence.remedy(update.config, update.level)
    return CheckResult("update", CheckStatus.FAIL, f"{where}: first {found}", f"{remedy[0].upper()}{remedy[1:]}.")
