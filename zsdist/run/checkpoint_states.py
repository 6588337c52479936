"""States of single roles in the checkpoints of a run."""

import hashlib
import json
from pathlib import Path

from zsdist.errors import DecodeError
from zsdist.run import checkpoint_files
from zsdist.wire import codec
from zsdist.wire.messages import State


def newest(folder: Path, name: str) -> State | None:
    """Return a role's newest sound state in the checkpoints of a run; the other roles' states are not read."""
    for checkpoint in reversed(checkpoint_files.checkpoints(folder)):
        try:
            payload = (checkpoint / f"{name}.state").read_bytes()
            wanted = json.loads((checkpoint / "manifest.json").read_text(encoding="utf-8"))["sha256"][name]
            if hashlib.sha256(payload).hexdigest() == wanted:
                return codec.decode(payload, expect=State)
        except (OSError, ValueError, KeyError, TypeError, DecodeError):
            continue  # damaged: the one before it is used
    return None
