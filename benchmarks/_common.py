"""Functions that the benchmarks share: import of optional modules, and the report at the end.

It imports only the standard library, since the peers' environments have neither zsdist nor its dependencies.
"""

import importlib
import json
import os
import platform
from importlib.metadata import version
from types import ModuleType


def require(module: str, install: str) -> ModuleType:
    """Import a module, or end the script with one line that says how to install it.

    Args:
        module: full name of the module.
        install: command that installs the module.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.partition(".")[0]:
            raise
        raise SystemExit(f"this benchmark needs {error.name}, which is not installed; run: {install}") from None


def report(subject: str, figures: dict[str, float], ratios: dict[str, float]) -> None:
    """Print figures and ratios as a table for people, then as the JSON line with which every benchmark ends."""
    figures, ratios = ({name: round(value, 4) for name, value in part.items()} for part in (figures, ratios))
    print()
    for name, value in (figures | ratios).items():
        print(f"{name:44s} {value:14g}")
    machine = {
        "machine": platform.machine(),
        "cpus": os.cpu_count(),
        "python": platform.python_version(),
        "onnxruntime": version("onnxruntime"),
        "torch": version("torch"),
    }
    print(json.dumps({"subject": subject, "machine": machine, "figures": figures, "ratios": ratios}))
