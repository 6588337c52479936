"""Vision of the car: pretrained encoder, visual-act head on its tokens, labels, losses, training (Algorithm 1)."""

import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # onnxruntime reads it at its import; else it reports its use
