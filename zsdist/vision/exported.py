"""Networks as files that onnxruntime runs: built once with torch, kept in a cache, shared by every process."""

import hashlib
import logging
import os
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import onnxruntime

from zsdist.errors import WeightsError

if TYPE_CHECKING:
    import torch

TOLERANCE = 1e-3
"""Largest difference allowed between the exported network and the original, per unit of its largest output."""


def cache_folder() -> Path:
    """Where exported networks are kept: `$ZSDIST_CACHE`, else `~/.cache/zsdist`."""
    return Path(os.environ.get("ZSDIST_CACHE") or Path.home() / ".cache" / "zsdist")


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's content, as hexadecimal digits; raises `WeightsError` where it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise WeightsError(f"weights {path} cannot be read: {error.strerror or error}") from error


def cached_session(name: str, build: Callable[[Path], None]) -> onnxruntime.InferenceSession:
    """The network `name` from the cache, built by `build(path)` where it is not there yet.

    Several processes may build at once: each writes a file of its own and renames it, so that nobody reads half a file.

    Raises:
        WeightsError: the cache cannot be written, or holds a file that is damaged.
    """
    path = cache_folder() / f"{name}.onnx"
    if not path.exists():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{name}-") as folder:
                build(Path(folder) / path.name)
                os.replace(Path(folder) / path.name, path)
        except OSError as error:
            raise WeightsError(
                f"cache folder {path.parent} cannot be written: {error.strerror or error}; "
                "allowed is any folder of your own, set by the variable ZSDIST_CACHE"
            ) from error
    return open_session(path)


def open_session(path: Path) -> onnxruntime.InferenceSession:
    """An onnxruntime session on one thread; raises `WeightsError` where the file is damaged."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3  # errors only
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors share no root below this one
        reason = " ".join(str(error).split())
        raise WeightsError(f"cached network {path} is damaged ({reason}); delete it and it is built anew") from error


def export(
    module: "torch.nn.Module",
    example: np.ndarray,
    path: Path,
    input_name: str,
    outputs: list[str],
    free: Sequence[str] = ("batch",),
) -> None:
    """Writes `module` as an ONNX file with a free batch size and checks it on `example` against torch.

    Args:
        module: the network, taking one tensor.
        example: `(B, ...)` an input, of the dtype it is to take.
        path: file to write.
        input_name: name of the input.
        outputs: names of what it returns, in order.
        free: names of the input's first axes that may be of any length; of the outputs' only the first may.

    Raises:
        WeightsError: the file does not compute what `module` does.
    """
    import torch

    module = module.eval()  # on the outermost module: the exporter otherwise switches it back to training
    tensor = torch.from_numpy(example)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the exporter's, on folding of constants and on its own age
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)
        torch.onnx.export(
            module,
            (tensor,),
            str(path),
            input_names=[input_name],
            output_names=outputs,
            dynamic_axes={name: {0: free[0]} for name in outputs} | {input_name: dict(enumerate(free))},
            opset_version=18,
            dynamo=False,  # this one takes a second, the newer one ten and a package more
        )
        expected = module(tensor)
    expected = [expected] if isinstance(expected, torch.Tensor) else expected
    found = open_session(path).run(outputs, {input_name: example})
    for name, ours, theirs in zip(outputs, found, expected, strict=True):
        difference = float(np.abs(ours - theirs.numpy()).max() / max(np.abs(theirs.numpy()).max(), 1e-9))
        if not difference <= TOLERANCE:
            raise WeightsError(
                f"exported network {path.stem}: {name} differs from torch's by {difference:.2g}; "
                f"allowed is {TOLERANCE:.2g}"
            )
