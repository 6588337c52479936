"""Milliseconds per picture for each network that reads pictures, on one core, and for the trunk run eagerly by torch.

`python benchmarks/vision.py [--quick]` prints a table, then one JSON line. In each round every network gets the same
new picture, in turn, one at a time as in an actor. Cold: the processor's caches are flushed before each reading, as by
an actor that simulates and renders between two readings. Cached: the same reading repeated at once. Networks without an
encoder are left out where the weights have none.
"""

import argparse
import os
import statistics
import time
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one core, as for a role; set before numpy and torch read it

import numpy as np
import torch
from _common import report

from zsdist.config import CameraConfig, VisionConfig
from zsdist.datasets.labelled import labelled_views
from zsdist.vision import weights_folder
from zsdist.vision.encoders import lite0
from zsdist.vision.encoders.base import resample
from zsdist.vision.models import STUDENT_PX
from zsdist.vision.visual_act import ALONE, VisualAct

FLUSHED_BYTES = 64 << 20  # more than a core's own and shared caches
WARM_UP = 3  # rounds that are not counted

Reader = Callable[[np.ndarray], object]


def main() -> None:
    """Measure, print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer rounds; takes at most 50 s on two cores")
    parser.add_argument("--weights", default="pretrained", help="like vision.weights (default: pretrained)")
    options = parser.parse_args()
    camera, rounds = CameraConfig(), 40 if options.quick else 200
    pictures = [view.image[None] for view in labelled_views(["iid", "street"], "validation", rounds, 0, camera)]
    began_s = time.perf_counter()
    model = VisualAct.load(VisionConfig(weights=options.weights), camera)
    opened_s = time.perf_counter() - began_s  # the networks are built, or read from the cache
    readers = _readers(model, options.weights, camera)
    times = _milliseconds(readers, pictures)
    figures = {f"{name}_{state}_ms": value for name, by_state in times.items() for state, value in by_state.items()}
    figures |= {"open_s": opened_s, "pictures": len(pictures), "camera_px": camera.size_px}
    ratios = {"onnx_vs_eager": times["trunk_eager"]["cold"] / times["trunk"]["cold"]}
    for name in ALONE:
        if name in times:
            ratios[f"{name}_vs_head"] = times["trunk_and_head"]["cold"] / times[f"resample_and_{name}"]["cold"]
    print(f"{'ms per picture, median':24}{'cold':>10}{'cached':>10}")
    for name, by_state in times.items():
        print(f"{name:24}{by_state['cold']:10.3f}{by_state['cached']:10.3f}")
    report("vision", figures, ratios)


def _readers(model: VisualAct, weights: str, camera: CameraConfig) -> dict[str, Reader]:
    """Return functions that read a picture `(1, px, px, 3)`, by name; the last one does not use onnxruntime."""
    encoder, eager = lite0.EfficientNetLite0(), lite0.eager_trunk(lite0.weights_file()).eval()
    tokens = np.zeros((1, encoder.side, encoder.side, encoder.features), np.float32)
    readers: dict[str, Reader] = {
        "trunk": encoder.tokens,
        "head": lambda image: model.read_tokens(tokens),  # its time does not depend on the tokens
        "trunk_and_head": model.read,
    }
    folder = weights_folder.read(weights_folder.locate(weights))
    for name, (file, px) in ALONE.items():
        if folder.has(file):
            alone = VisualAct.load(VisionConfig(weights=weights, network=name), camera)
            small = np.zeros((1, px, px, 3), np.uint8)
            readers |= {
                name: lambda image, read=alone.read, small=small: read(small),
                f"resample_and_{name}": alone.read,
            }
    readers["resample"] = lambda image: resample(image, STUDENT_PX)

    def read_eagerly(image: np.ndarray) -> torch.Tensor:
        with torch.no_grad():
            return eager(torch.from_numpy(image))

    return readers | {"trunk_eager": read_eagerly}


def _milliseconds(readers: dict[str, Reader], pictures: list[np.ndarray]) -> dict[str, dict[str, float]]:
    """Return the median milliseconds of each reader, cold and cached; the readers alternate on each picture."""
    flushed = np.zeros(FLUSHED_BYTES // 8)
    times: dict[str, dict[str, list[float]]] = {name: {"cold": [], "cached": []} for name in readers}
    for picture in pictures[:WARM_UP] + pictures:
        for name, read in readers.items():
            flushed += 1
            for state in ("cold", "cached"):
                began = time.thread_time()  # CPU time of this thread, so that other load on the machine does not count
                read(picture)
                times[name][state].append(1e3 * (time.thread_time() - began))
    return {
        name: {state: statistics.median(values[WARM_UP:]) for state, values in by_state.items()}
        for name, by_state in times.items()
    }


if __name__ == "__main__":
    main()
