"""What several scripts share: their last lines."""

import json
import os
import platform

import onnxruntime
import torch


def report(subject: str, figures: dict[str, float], ratios: dict[str, float]) -> None:
    """Prints figures and ratios as a table for people, then as the JSON line with which every benchmark ends."""
    figures, ratios = ({name: round(value, 4) for name, value in part.items()} for part in (figures, ratios))
    print()
    for name, value in (figures | ratios).items():
        print(f"{name:44s} {value:14g}")
    machine = {
        "machine": platform.machine(),
        "cpus": os.cpu_count(),
        "python": platform.python_version(),
        "onnxruntime": onnxruntime.__version__,
        "torch": torch.__version__,
    }
    print(json.dumps({"subject": subject, "machine": machine, "figures": figures, "ratios": ratios}))
