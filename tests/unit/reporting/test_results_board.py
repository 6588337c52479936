"""What TensorBoard has of a finished run."""

import json

import cv2
import numpy as np
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.util.tensor_util import make_ndarray

from zsdist.reporting import results_board

MERGE = {"episode": 100, "candidates": ["best", "new"], "chosen": "new", "scores": {"best": 0.5, "new": 0.75}}
RESULT = {"scenes": "iid", "policy": "trained", "episodes": 20, "success": 0.9, "collision": 0.1, "timeout": 0.0}


def shown(folder):
    events = EventAccumulator(str(folder / "tensorboard")).Reload()
    return {
        tag: [(event.step, make_ndarray(event.tensor_proto)) for event in events.Tensors(tag)]
        for tag in events.Tags()["tensors"]
    }


def test_merges_results_and_figures_of_a_finished_run_are_shown(tmp_path):
    (tmp_path / "summary.json").write_text(json.dumps({"episodes": 150, "merges": [MERGE]}))
    (tmp_path / "evaluation.json").write_text(json.dumps([RESULT | {"spl": None}]))
    (tmp_path / "figures").mkdir()
    cv2.imwrite(str(tmp_path / "figures" / "rewards.png"), np.zeros((30, 40, 3), np.uint8))
    results_board.add(tmp_path)
    found = shown(tmp_path)
    assert set(found) == {
        "merges/best", "merges/new", "merges/chosen", "evaluation", "figures/rewards",
        *(f"evaluation/iid/trained/{name}" for name in ("success", "collision", "timeout")),
    }  # fmt: skip
    ((step, score),) = found["merges/new"]
    assert (step, float(score)) == (100, 0.75)
    ((step, table),) = found["evaluation"]
    assert step == 150 and b"| iid | trained | 20 | 0.90 | 0.10 | 0.00 | - |" in table.item()
    ((_, picture),) = found["figures/rewards"]
    assert [int(size) for size in picture[:2]] == [40, 30]
    assert cv2.imdecode(np.frombuffer(picture[2], np.uint8), cv2.IMREAD_COLOR).shape == (30, 40, 3)


def test_a_run_without_results_adds_nothing(tmp_path):
    results_board.add(tmp_path)
    assert shown(tmp_path) == {}
