"""Visual navigation of a car by zero-shot vision and hierarchical reinforcement learning, trained on many processes.

Importing the package registers the Gymnasium environment `zsdist/CarNavigation-v0`, which `load_policy` drives:

    import gymnasium, zsdist

    policy = zsdist.load_policy("pretrained")  # or a run directory, a checkpoint, a baseline
    env = gymnasium.make("zsdist/CarNavigation-v0", config=policy.config)
    observation, info = env.reset(seed=1)
    action = policy.act(observation)

`zsdist.config.load` reads settings, `zsdist.evaluate.find_policy` and `zsdist.evaluation` measure policies, and
`zsdist.run.training` trains. Each command, such as `zsdist launch`, is a module with `make_parser` and `main`.
`examples/` has programs, docs/environment.md the tables of the environment.
"""

from zsdist.common import search_path  # (first: it decides where the other imports are found)

# isort: split
import importlib
import importlib.util
import signal
import sys
from typing import Any

__all__ = ["__version__", "load_policy"]
__version__ = "0.1.0"

# While a command is being imported, a Ctrl-C ends it without a traceback; `zsdist.common.cli` handles it from then on.
if search_path.is_command(sys.orig_argv) and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

if importlib.util.find_spec("gymnasium") is not None:  # an exported policy runs without it
    importlib.import_module("gymnasium").register(
        id="zsdist/CarNavigation-v0", entry_point="zsdist.sim.env:CarNavigation"
    )


def __getattr__(name: str) -> Any:
    """Return `load_policy`, which is imported at its first use: it needs much that other users do not."""
    if name == "load_policy":
        return importlib.import_module("zsdist.policy").load_policy
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the names of the package, `load_policy` included."""
    return sorted({*globals(), *__all__})
