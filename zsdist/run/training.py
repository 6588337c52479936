"""Training of an opened run, and the checks of its summary."""

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import Any, Protocol

from zsdist.common import commands, output_files
from zsdist.config import Config
from zsdist.errors import RunError, ZsdistError
from zsdist.roles.replay import shards
from zsdist.run import checkpoint_files, directory, killed_start, local_ray, profiling, program
from zsdist.run.program import RunSpec, Watch
from zsdist.wire.messages import State

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
    run = runner(spec.config)
    is_first = not (spec.folder / "epochs").exists()
    try:
        return _train(run, spec, interrupted, watch)
    except BaseException as error:
        discarded = is_first and directory.discard(spec.folder)
        if discarded or not isinstance(error, ZsdistError):
            raise
        where = "resume from the last checkpoint" if checkpoint_files.has_checkpoint(spec.folder) else "begin anew"
        where = "go on" if spec.config.placement == "ray" and killed_start.has_ledger(spec.folder) else where
        raise RunError(f"{error}; {where} with {commands.quoted('--resume', spec.folder)}") from error


def _train(run: _Run, spec: RunSpec, interrupted: Callable[[], bool], watch: Watch) -> Summary:
    epochs = directory.issue_epochs(spec.folder, program.epoch_count(spec.config))
    with output_files.written(f"run directory {spec.folder}"):
        for of_an_earlier_start in ("summary.json", "endpoint"):
            (spec.folder / of_an_earlier_start).unlink(missing_ok=True)
        here = spec.profile and spec.config.placement != "ray"  # else each role's process samples itself
        with profiling.sampled(spec.folder, program.supervisor(epochs)) if here else nullcontext():
            run(replace(spec, launch=epochs[0]), epochs, interrupted=interrupted, watch=watch)
        summary = json.loads((spec.folder / "summary.json").read_text(encoding="utf-8"))
        shutil.rmtree(spec.folder / "journal", ignore_errors=True)  # the last checkpoint holds everything
        return summary


def check_accounts(summary: Summary) -> None:
    """Check that every transition that was produced was either stored or rejected; raise `RunError` if not."""
    for level, counts in summary["transitions"].items():
        if counts["produced"] != counts["stored"] + counts["rejected"]:
            raise RunError(
                f"the transition counts of level {level} do not balance: {counts['produced']} produced, "
                f"{counts['stored']} stored, {counts['rejected']} rejected"
            )


def describe_losses(summary: Summary) -> list[str]:
    """Return a line for each level that has lost transitions with damaged parts of journals."""
    return [
        f"damaged journals have cost the {level} level {lost} transitions before they were used and {rows} of its ring"
        for level, counts in summary["transitions"].items()
        if (lost := counts.get("lost", 0)) + (rows := counts.get("lost_rows", 0))
    ]


def describe_untrained_levels(summary: Summary, settings: Config, states: Mapping[str, State]) -> list[str]:
    """Return a line for each level whose learner made no update since this start of the run, with the reason.

    Args:
        summary: summary of the run.
        settings: its configuration.
        states: states from which it was resumed; empty for a new run.
    """
    lines = []
    for level, updates in summary["learner_updates"].items():
        learner = states.get(f"learner-{level}")
        if updates != (learner.meta["updates"] if learner else 0):
            continue
        stored, level_settings = summary["transitions"][level]["stored"], getattr(settings, level)
        before = sum(state.meta[level]["stored"] for name, state in states.items() if shards.is_state_name(name))
        when = " since it was resumed" if learner else ""
        added, ratio = stored - before, level_settings.updates_per_insert
        if stored < level_settings.min_size:
            reason = f"{stored} transitions were stored, and training starts at {level_settings.min_size} "
            reason += f"({level}.min_size)"
        elif added * ratio < 1:
            reason = f"{added} transitions were added, for {ratio:g} updates each ({level}.updates_per_insert)"
        else:
            reason = f"{added} transitions were added, and the run ended before any update"
        lines.append(f"the {level} level was not trained{when}: {reason}")
    return lines


def runner(settings: Config) -> _Run:
    """Return the function that runs the roles, whose libraries are imported here."""
    if settings.placement == "ray":  # each takes a second or two to import, and a run needs only one of them
        if not local_ray.is_used(settings):
            from zsdist.run import ray

            return ray.run
        local_ray.stay_on_loopback()
        from zsdist.run import nursery, ray, undertaker

        return undertaker.employed()(nursery.employed()(ray.run))
    from zsdist.run import inline

    return inline.run
