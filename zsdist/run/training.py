"""Training of an opened run, and the checks of its summary."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from zsdist.common import output_files
from zsdist.config import Config
from zsdist.errors import RunError, ZsdistError
from zsdist.run import directory, program
from zsdist.run.program import RunSpec, Watch

Summary = Mapping[str, Any]  # `summary.json`


class _Run(Protocol):
    def __call__(
        self, spec: RunSpec, epochs: Sequence[int], *, interrupted: Callable[[], bool], watch: Watch
    ) -> None: ...


def train(spec: RunSpec, interrupted: Callable[[], bool], watch: Watch) -> Summary:
    """Run all roles until the training has ended.

    Args:
        spec: specification of the run.
        interrupted: returns whether to stop early.
        watch: called once a round with the runner's transport and the clock.

    Returns:
        The run's summary.

    Raises:
        ZsdistError: a role failed for good, or could not start; where none has begun in a new run directory, it is
            removed.
    """
    run = _runner(spec.config.placement)
    is_first = not (spec.folder / "epochs").exists()
    try:
        return _train(run, spec, interrupted, watch)
    except BaseException as error:
        discarded = is_first and directory.discard(spec.folder)
        if discarded or not isinstance(error, ZsdistError):
            raise
        where = "resume from the last checkpoint" if directory.has_checkpoint(spec.folder) else "begin anew"
        raise RunError(f"{error}; {where} with --resume {spec.folder}") from error


def _train(run: _Run, spec: RunSpec, interrupted: Callable[[], bool], watch: Watch) -> Summary:
    epochs = directory.issue_epochs(spec.folder, program.epoch_count(spec.config))
    with output_files.written(f"run directory {spec.folder}"):
        (spec.folder / "summary.json").unlink(missing_ok=True)
        run(spec, epochs, interrupted=interrupted, watch=watch)
        return json.loads((spec.folder / "summary.json").read_text())


def check_accounts(summary: Summary) -> None:
    """Check that every transition that was produced was either stored or rejected; raise `RunError` if not."""
    for level, counts in summary["transitions"].items():
        if counts["produced"] != counts["stored"] + counts["rejected"]:
            raise RunError(
                f"the transition counts of level {level} do not balance: {counts['produced']} produced, "
                f"{counts['stored']} stored, {counts['rejected']} rejected"
            )


def describe_untrained_levels(summary: Summary, settings: Config) -> list[str]:
    """Return a line for each level whose learner made no update, with the reason."""
    lines = []
    for level, updates in summary["learner_updates"].items():
        if not updates:
            stored, least = summary["transitions"][level]["stored"], getattr(settings, level).min_size
            lines.append(
                f"the {level} level was not trained: {stored} transitions were stored, and training starts at "
                f"{least} ({level}.min_size)"
            )
    return lines


def _runner(placement: str) -> _Run:
    if placement == "ray":  # each takes a second or two to import, and a run needs only one of them
        from zsdist.run import ray

        return ray.run
    from zsdist.run import inline

    return inline.run
