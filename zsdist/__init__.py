"""Visual navigation of a car by zero-shot vision and hierarchical reinforcement learning, trained on many processes."""

from zsdist.common import search_path  # noqa: F401 (first: it decides where the other imports are found)

# isort: split
import signal
import sys
from itertools import pairwise

import gymnasium

__version__ = "0.1.0"

# While a command is being imported, a Ctrl-C ends it without a traceback; `zsdist.common.cli` handles it from then on.
_is_command = any(option == "-m" and module.startswith("zsdist.") for option, module in pairwise(sys.orig_argv))
if _is_command and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

gymnasium.register(id="zsdist/CarNavigation-v0", entry_point="zsdist.sim.env:CarNavigation")
