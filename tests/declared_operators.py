"""Workaround to import the reference libraries of the encoder tests with a torch without CUDA; import it first.

The registry's torchvision is compiled for CUDA. With a CPU build of torch its operators cannot be loaded, and its
import fails on the two that it describes unconditionally. The tests never call them, so it suffices to declare them.
"""

import ctypes
from importlib.util import find_spec
from pathlib import Path

import torch


def declare_missing_operators():
    compiled = Path(find_spec("torchvision").origin).with_name("_C.so")
    try:
        ctypes.CDLL(str(compiled))
    except OSError:
        library = torch.library.Library("torchvision", "FRAGMENT")
        for name in ("nms", "qnms"):
            library.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        return library
    return None


DECLARED = declare_missing_operators()  # the operators are declared as long as this object lives
