import numpy as np
import pytest

from zsdist.pretraining.check.figures import (
    Miss,
    confusion,
    draw_attention,
    draw_confusion,
    draw_losses,
    draw_misses,
    draw_reliability,
    feet_px,
)
from zsdist.vision.rays import RANGE_M, RAYS


def test_a_confusion_without_errors_is_the_diagonal_and_its_rows_are_shares():
    distances = np.array([0.1, 0.3, 0.7, 1.2, 2.2, 4.9, 5.0])
    exact = confusion(distances, distances)
    assert np.allclose(exact, np.diag(np.diag(exact))) and set(exact.sum(1)) <= {0.0, 1.0}
    mixed = confusion(np.full(4, 1.0), np.array([1.0, 1.0, 1.0, RANGE_M]))
    assert mixed[:, -1].max() == 0.25


def test_the_end_of_a_nearer_ray_is_lower_in_the_picture_and_at_most_at_its_edge():
    far, near, below = (feet_px(np.full(RAYS, d), 224, np.pi / 2, 1.0)[1] for d in (4.0, 2.0, 0.2))
    assert (far < near).all() and (far > 112).all() and (below == 224).all()
    across, down = feet_px(np.full(RAYS, 2.0), 224, np.pi / 2, 1.0)
    assert down[RAYS // 2] == pytest.approx(112 * 1.5, abs=0.5) and (np.diff(across) > 0).all()


def test_every_figure_is_drawn(tmp_path):
    image, side = np.full((32, 32, 3), 90, np.uint8), np.linspace(0.0, 1.0, 16)
    line = {"epoch": 1, "loss": 2.0, "validation_loss": 2.5}
    draw_losses([{"stage": stage, **line} for stage in ("words", "head")], tmp_path / "loss.png")
    attention = np.tile(side / side.sum(), (1, 3, 1))
    draw_attention([image], attention, np.full((1, 3), 0.4), ["tree"], tmp_path / "attention.png")
    draw_confusion({"a": (np.full(3, 1.0), np.full(3, 2.0))}, tmp_path / "confusion.png")
    draw_reliability({"a": (side, side), "b": (side, side**2)}, tmp_path / "reliability.png")
    miss = Miss(image, np.full(RAYS, 1.0), np.full(RAYS, RANGE_M), 3, "made up")
    draw_misses([miss] * 5, np.pi / 2, 1.0, tmp_path / "misses.png")
    assert all(file.stat().st_size > 2000 for file in tmp_path.iterdir()) and len(list(tmp_path.iterdir())) == 5
