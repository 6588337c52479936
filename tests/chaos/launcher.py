"""Launcher of a small run, as `zsdist.launch` is one: `python tests/chaos/launcher.py FOLDER [KEY.PATH=VALUE ...]`.

It resumes the run in FOLDER if there is one. Cars are kinematic, so vision is neither checked nor compiled.
"""

import contextlib
import dataclasses
import os
import sys
from pathlib import Path

import small_run
from rehearsal import SEEN

from zsdist import config
from zsdist.common.signals import Interruption, handled_by
from zsdist.errors import ZsdistError
from zsdist.run import opening, restarts, training


def main() -> int:
    """Train until a signal, and return the exit status of `zsdist.launch`."""
    folder, settings = Path(sys.argv[1]), tuple(sys.argv[2:])
    if small_run.UNLIMITED in os.environ:
        restarts.RESTARTS_ALLOWED = restarts.EARLY_DEATHS = int(os.environ[small_run.UNLIMITED])
    opening.check_parts = lambda settings, notify: SEEN
    interruption = Interruption()
    with contextlib.ExitStack() as held, handled_by(interruption):
        try:
            if (folder / "config.yaml").exists():
                spec = opening.open_resumed(folder, settings, print, held)
            else:
                resolved = config.load(None, (*small_run.LIGHT, *settings))
                spec = opening.open_new(resolved, folder, print, held)
            fields = {field.name: getattr(spec, field.name) for field in dataclasses.fields(spec)}
            spec = small_run.DisturbedRunSpec(**fields | {"make_parts": small_run.counted})
            summary = training.train(spec, interruption, lambda transport, now: None)
            training.check_accounts(summary)
        except ZsdistError as error:
            print(f"zsdist: {error}", flush=True)
            return 2
    print(f"ended: {summary['ended']}", flush=True)
    return interruption.status if interruption() else 0


if __name__ == "__main__":
    sys.exit(main())
