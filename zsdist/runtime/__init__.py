"""Exported policies on a robot: the bundle's files, and the runner that decides. It needs no torch and no simulator."""

import zsdist.vision  # noqa: F401 (first: it keeps onnxruntime, once that is imported, from reporting its use)
