"""Opening of a run: a new run directory, or an earlier one that is resumed. Nothing is written before all checks."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from zsdist.common import commands, locks
from zsdist.config import Config
from zsdist.errors import CompleteError, RunError
from zsdist.run import (
    checkpoint_files,
    cluster_address,
    directory,
    killed_start,
    local_ray,
    location,
    nursery,
    preflight,
    training,
)
from zsdist.run.program import RunSpec
from zsdist.vision.fingerprint import VisionIdentity

Notify = Callable[[str], None]  # shows one line to the user


def open_new(settings: Config, folder: Path | None, notify: Notify, held: ExitStack) -> RunSpec:
    """Make the directory of a new run, and lock it.

    Args:
        settings: configuration of the run.
        folder: folder to make; None: a folder in `runs/`, named by configuration and time.
        notify: called with lines for the user.
        held: keeps the lock of the folder.

    Raises:
        ZsdistError: the settings cannot be run on this machine, or the folder cannot be made, or is in use.
    """
    if folder is not None:
        _check_free(folder)
        directory.check_new(folder)
    preflight.check_recorded(settings)
    vision = _check_beside_nursery(settings, notify, held)
    made = directory.create(folder, settings, lock=lambda path: _lock(path, held)).resolve()
    return RunSpec(settings, directory.key_name(made), made, {}, vision)


def open_resumed(folder: Path, overrides: tuple[str, ...], notify: Notify, held: ExitStack) -> RunSpec:
    """Lock the directory of an earlier run, and go on where it was killed, or reset it to its newest checkpoint.

    Without a checkpoint it is reset to its beginning. A folder that names a checkpoint is reset to that in any case.

    Args:
        folder: run directory, or a path inside it.
        overrides: settings to change, as `KEY.PATH=VALUE`.
        notify: called with lines for the user.
        held: keeps the lock of the folder.

    Raises:
        CompleteError: the run has nothing left to do.
        RunError: there is no run to resume, or it is in use or has finished more episodes.
        ZsdistError: the settings cannot be run on this machine.
    """
    given, folder = folder, location.find_run(folder)
    directory.check_is_run(folder)
    _lock(folder, held)
    settings, states = directory.reopen(folder, overrides, notify)
    preflight.check_used(settings, overrides)
    if states:
        location.check_is_newest(given, checkpoint_files.newest_checkpoint(folder))
    preflight.check_shards(settings, states)
    resolved, killed = folder.resolve(), None
    if settings.placement == "ray" and location.find_checkpoint(given) is None:
        killed = killed_start.find(resolved, settings, notify)
    finished = len(states["scheduler"].meta["finished"]) if states else 0
    finished = finished if killed is None else killed.finished
    # With all episodes finished, the last merge or the evaluation may still be missing: then the run may be resumed.
    complete = settings.run.episodes == finished and directory.ended(folder) == "complete"
    if settings.run.episodes < finished or complete:
        error = CompleteError if complete else RunError
        raise error(
            f"the run in {folder} has finished {finished} episodes and --episodes is {settings.run.episodes}; "
            f"allowed is more than {finished}. Drive as many again with "
            f"{commands.module('zsdist.launch', '--resume', folder, '--episodes', 2 * finished)}, or evaluate the run "
            f"with {commands.module('zsdist.evaluate', folder)}"
        )
    if not states and killed is None:
        preflight.check_recorded(settings)
    trained = checkpoint_files.read_vision(checkpoint_files.newest_checkpoint(folder)) if states else None
    vision = _check_beside_nursery(settings, notify, held)
    if trained is None and killed is None:
        notify(f"the run in {folder} ended before its first checkpoint; it begins anew")
    elif trained is not None and (note := trained.check(str(folder), vision)):
        notify(note)
    name = directory.key_name(resolved)
    if killed is not None:
        notify(f"the run goes on where it was killed, after {finished} finished episodes")
        directory.rewrite_config(resolved, settings)
        return RunSpec(settings, name, resolved, states, vision, start=killed.word)
    directory.rewind(resolved, settings, states)
    return RunSpec(settings, name, resolved, states, vision)


def check_parts(settings: Config, notify: Notify) -> VisionIdentity:
    """Check memory, certificates, Ray, scenes and weights, and compile all code that is compiled at first use.

    Returns:
        The vision model of this configuration on this machine.
    """
    preflight.check_memory(settings)
    preflight.check_certificates(settings)
    cluster_address.check(settings)
    if local_ray.is_used(settings):
        local_ray.check_open_files(settings)
    notify("preparing; the first time this takes about 15 s, for compilation")
    if not nursery.is_employed():
        return preflight.warm_up(settings)
    return nursery.prepare(settings, lambda: training.runner(settings))  # whose import takes a second


def _check_beside_nursery(settings: Config, notify: Notify, held: ExitStack) -> VisionIdentity:
    if local_ray.is_used(settings):
        held.enter_context(nursery.employed())
    return check_parts(settings, notify)


def _lock(folder: Path, held: ExitStack) -> None:
    held.enter_context(locks.held(folder, f"run directory {folder}"))


def _check_free(folder: Path) -> None:
    locks.check_free(folder, f"run directory {folder}")
