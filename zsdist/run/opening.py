"""Opening of a run: a new run directory, or an earlier one that is resumed. Nothing is written before all checks."""

from collections.abc import Callable
from pathlib import Path

from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.run import directory, local_ray, location, preflight
from zsdist.run.program import RunSpec
from zsdist.vision.fingerprint import VisionIdentity

Notify = Callable[[str], None]  # shows one line to the user


def open_new(settings: Config, folder: Path | None, notify: Notify) -> RunSpec:
    """Make the directory of a new run.

    Args:
        settings: configuration of the run.
        folder: folder to make; None: a folder in `runs/`, named by configuration and time.
        notify: called with lines for the user.

    Raises:
        ZsdistError: the settings cannot be run on this machine, or the folder cannot be made.
    """
    vision = check_parts(settings, notify)
    made = directory.create(folder, settings).resolve()
    return RunSpec(settings, directory.key_name(made), made, {}, vision)


def open_resumed(folder: Path, overrides: tuple[str, ...], notify: Notify) -> RunSpec:
    """Reset the directory of an earlier run to its newest checkpoint.

    Args:
        folder: run directory, or a path inside it.
        overrides: settings to change, as `KEY.PATH=VALUE`.
        notify: called with lines for the user.

    Raises:
        RunError: there is no run or no checkpoint to resume from, or the run is complete.
        ZsdistError: the settings cannot be run on this machine.
    """
    given, folder = folder, location.find_run(folder)
    settings, states = directory.reopen(folder, overrides, notify)
    location.check_is_newest(given, directory.newest_checkpoint(folder))
    preflight.check_shards(settings, states)
    finished = len(states["scheduler"].meta["finished"])
    # With all episodes finished, the last merge or the evaluation may still be missing: then the run may be resumed.
    complete = settings.run.episodes == finished and directory.ended(folder) == "complete"
    if settings.run.episodes < finished or complete:
        raise RunError(
            f"the run in {folder} has finished {finished} episodes and --episodes is {settings.run.episodes}; "
            f"allowed is more than {finished}"
        )
    trained = directory.read_vision(directory.newest_checkpoint(folder))
    vision = check_parts(settings, notify)
    if note := trained.check(str(folder), vision):
        notify(note)
    resolved = folder.resolve()
    directory.rewind(resolved, settings, states)
    return RunSpec(settings, directory.key_name(resolved), resolved, states, vision)


def check_parts(settings: Config, notify: Notify) -> VisionIdentity:
    """Check memory, certificates, scenes and weights, and compile all code that is compiled at first use.

    Returns:
        The vision model of this configuration on this machine.
    """
    preflight.check_memory(settings)
    preflight.check_certificates(settings)
    if settings.placement == "ray" and settings.run.address is None:
        local_ray.check_open_files(settings)
    notify("preparing; the first time this takes about 15 s, for compilation")
    return preflight.warm_up(settings)
