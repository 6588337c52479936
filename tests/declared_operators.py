"""Makes the libraries that the encoders are held against importable beside a torch without CUDA; import it first.

The registry's torchvision is compiled for CUDA. Beside a CPU build of torch its operators cannot be loaded, and its
import fails on the two that it describes without asking. Nothing here calls them: they are declared, no more.
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


DECLARED = declare_missing_operators()  # as long as this lives, they are known
