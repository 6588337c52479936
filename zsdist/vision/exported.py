"""Export of networks to files for onnxruntime. A file is built once with torch, cached and shared by all processes."""

import hashlib
import logging
import os
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import onnxruntime

from zsdist.common.cache_folder import VARIABLE, cache_folder
from zsdist.errors import CacheError, ConfigError, WeightsError

if TYPE_CHECKING:
    import torch

CPU_DEVICE = "cpu"
_CPU, _GPU = "CPUExecutionProvider", "CUDAExecutionProvider"
TOLERANCE = 1e-3
"""Largest difference allowed between the exported network and the original, per unit of its largest output."""


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's content in hexadecimal; raise `WeightsError` if the file cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise WeightsError(f"weights {path} cannot be read: {error.strerror or error}") from error


def files_sha256(paths: Sequence[Path]) -> str:
    """Return the SHA-256 of one file, or that of the hashes of several in order; raises like `file_sha256`."""
    digests = [file_sha256(path) for path in paths]
    return digests[0] if len(digests) == 1 else hashlib.sha256("".join(digests).encode()).hexdigest()


class FileSession(onnxruntime.InferenceSession):
    """Session that a copy or a pickle opens anew from its file, on the machine that has it."""

    path: Path
    device: str

    def __reduce__(self) -> tuple[Any, ...]:
        return open_session, (self.path, self.device)


def cached_session(name: str, build: Callable[[Path], None], device: str = CPU_DEVICE) -> FileSession:
    """Return a session of the network `name` from the cache; build it with `build(path)` if it is missing.

    Several processes may build at once: each writes its own file and renames it, so no process reads a partial file.

    Raises:
        ConfigError: `device` asks for a GPU, as `vision.device` does, and none can be used.
        CacheError: the cache cannot be written or read.
        WeightsError: the cached file is damaged.
    """
    path = cache_folder() / f"{name}.onnx"
    advice = f"set the environment variable {VARIABLE} to a folder that you can write"
    try:
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{name}-") as folder:
                build(Path(folder) / path.name)
                os.replace(Path(folder) / path.name, path)
        path.open("rb").close()
    except OSError as error:
        raise CacheError(f"cache {path.parent} cannot be used: {error.strerror or error}; {advice}") from error
    return open_session(path, device)


def open_session(path: Path, device: str = CPU_DEVICE) -> FileSession:
    """Return an onnxruntime session on one thread.

    Args:
        path: file of the network.
        device: as the setting `vision.device`: `cpu`, `gpu`, or `auto` for a GPU where one can be used.

    Raises:
        ConfigError: `device` is `gpu` and none can be used.
        WeightsError: the file is missing or damaged.
    """
    if not path.exists():
        raise WeightsError(f"cached network {path} is missing; load the model from its weights")
    try:
        session = FileSession(str(path), session_options(1), providers=_providers(device))
    except Exception as error:  # onnxruntime's errors share no narrower base class
        reason = " ".join(str(error).split())
        raise WeightsError(f"cached network {path} is damaged ({reason}); delete it to have it rebuilt") from error
    session.path, session.device = path, device
    if device == "gpu" and session.get_providers()[0] != _GPU:
        raise ConfigError(
            f"vision.device is 'gpu', and onnxruntime computes with {session.get_providers()[0]} here; allowed is a "
            "machine with a GPU and the package onnxruntime-gpu in place of onnxruntime, or vision.device=cpu or auto"
        )
    return session


def session_options(threads: int) -> onnxruntime.SessionOptions:
    """Return the options of every session: as many threads as given, and no messages but errors."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.log_severity_level = 3  # errors only
    return options


def _providers(device: str) -> list[str]:
    """Return onnxruntime's names of what may compute, the best first."""
    if device == CPU_DEVICE or _GPU not in onnxruntime.get_available_providers():
        return [_CPU]
    if hasattr(onnxruntime, "preload_dlls"):
        onnxruntime.preload_dlls()  # CUDA's libraries from the packages that torch brought, where there are any
    return [_GPU, _CPU]


def export(
    module: "torch.nn.Module",
    example: np.ndarray,
    path: Path,
    input_name: str,
    outputs: list[str],
    free: Sequence[str] = ("batch",),
) -> None:
    """Write `module` as an ONNX file with a free batch size, and check its outputs on `example` against torch.

    Args:
        module: network with one tensor as input.
        example: `(B, ...)` input of the dtype that the network expects.
        path: file to write.
        input_name: name of the input.
        outputs: names of the outputs, in order.
        free: names of the leading axes of the input that may have any length; in an output only the first one may.

    Raises:
        WeightsError: the outputs of the file differ from those of `module`.
    """
    import torch

    module = module.eval()  # on the outermost module: otherwise the exporter switches it back to training mode
    tensor = torch.from_numpy(example)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the exporter warns of constant folding and of its own deprecation
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)
        torch.onnx.export(
            module,
            (tensor,),
            str(path),
            input_names=[input_name],
            output_names=outputs,
            dynamic_axes={name: {0: free[0]} for name in outputs} | {input_name: dict(enumerate(free))},
            opset_version=18,
            dynamo=False,  # takes one second; the newer exporter takes ten and needs one more package
        )
        expected = module(tensor)
    expected = [expected] if isinstance(expected, torch.Tensor) else expected
    found = open_session(path).run(outputs, {input_name: example})
    for name, ours, theirs in zip(outputs, found, expected, strict=True):
        difference = float(np.abs(ours - theirs.numpy()).max() / max(np.abs(theirs.numpy()).max(), 1e-9))
        if not difference <= TOLERANCE:
            raise WeightsError(
                f"exported network {path.stem}: output {name} differs from torch by {difference:.2g}; "
                f"allowed is {TOLERANCE:.2g}"
            )
