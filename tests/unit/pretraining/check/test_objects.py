import json
import math

import numpy as np
import pytest

from zsdist.config import Config
from zsdist.datasets.labelled import camera_angles_rad, label
from zsdist.errors import RunError
from zsdist.planning.grid import Grid
from zsdist.pretraining.check import objects
from zsdist.pretraining.check.objects import (
    Approach,
    approach,
    drive_up,
    measure,
    obstacle_number,
    summary,
    visible_side,
)
from zsdist.sim.ground_truth import rays_met
from zsdist.sim.physics.collision import touching
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Pose, View
from zsdist.vision.rays import BIN_EDGES_M, BINS, RAYS, ray_angles_rad

CONFIG = Config(camera={"size_px": 32})
GRID = Grid.from_config(CONFIG.grid)
SCENE = Scene(
    "made-up",
    "grass",
    Start(-9.0, -9.0, 0.0),
    (9.0, 9.0),
    (
        Obstacle("box", 6.0, 6.0, size_m=(1.0, 1.0, 2.0)),
        Obstacle("tree", 0.0, 0.0, radius_m=0.5),
        Obstacle("pole", 0.0, 5.0, radius_m=0.15),
    ),
)
DRIVE = Approach(SCENE, 1, tuple(Pose(x, 0.0, 0.0) for x in np.linspace(-6.0, -2.8, objects.OBSERVATIONS)))


class Model:
    """Model that predicts the true distance of every ray, or that all rays are free."""

    weights_sha256 = "made up"

    def __init__(self, sees):
        self.sees = sees

    def __call__(self, images, bearing, distance):
        return [self.view(pose) for pose in DRIVE.poses]

    def view(self, pose):
        distance = label(SCENE, pose, CONFIG.camera)["ray_clearance_m"] if self.sees else np.full(RAYS, 5.0)
        bins = np.clip(np.searchsorted(BIN_EDGES_M, distance, side="right") - 1, 0, BINS - 1)
        angles = ray_angles_rad(RAYS, math.pi / 2)
        nothing = np.zeros(3, np.float32)
        return View(nothing, nothing, nothing, np.eye(BINS, dtype=np.float32)[bins], angles, BIN_EDGES_M)


def test_a_model_that_sees_puts_the_object_on_the_map_and_a_blind_one_does_not():
    assert drive_up(Model(sees=True), DRIVE, CONFIG)
    assert not drive_up(Model(sees=False), DRIVE, CONFIG)


def test_the_visible_side_is_the_near_half_without_cells_of_others():
    side = visible_side(DRIVE, GRID, CONFIG.camera)
    xs, ys = GRID.fine_centres()
    rows, columns = np.nonzero(side)
    assert side.any() and xs[columns].max() < 0.5 and np.abs(ys[rows]).max() < 1.0
    beside = Obstacle("rock", -0.5, 0.0, radius_m=0.3)
    crowded = Approach(with_also(beside), 1, DRIVE.poses)
    assert not (visible_side(crowded, GRID, CONFIG.camera) & occupied_cells(beside)).any()


def with_also(obstacle):
    return Scene(SCENE.name, SCENE.ground, SCENE.start, SCENE.goal, (*SCENE.obstacles, obstacle))


def occupied_cells(obstacle):
    return Scene("alone", "grass", SCENE.start, SCENE.goal, (obstacle,)).occupancy(GRID)


def rays(scene, pose):
    return rays_met(scene, pose, CONFIG.camera, camera_angles_rad(CONFIG.camera))


def test_a_ray_has_the_number_of_the_obstacle_that_it_meets():
    assert [obstacle_number(SCENE, index) for index in range(3)] == [2, 0, 1]
    assert (rays(SCENE, DRIVE.poses[-1]).obstacle == obstacle_number(SCENE, 1)).any()


def test_approaches_come_near_touch_nothing_and_follow_from_their_number():
    for number in range(4):
        drive = approach(number, 7, CONFIG.camera)
        circles, boxes = drive.scene.circles(), drive.scene.boxes()
        assert len(drive.poses) == objects.OBSERVATIONS
        assert not any(touching(pose, circles, boxes, arena_m=25.0) for pose in drive.poses)
        assert approach(number, 7, CONFIG.camera) == drive
        met = rays(drive.scene, drive.poses[-1]).obstacle == obstacle_number(drive.scene, drive.index)
        assert label(drive.scene, drive.poses[-1], CONFIG.camera)["ray_clearance_m"][met].min() < 2.5


def test_a_measurement_is_resumed_where_it_stopped(tmp_path, monkeypatch):
    driven = []
    monkeypatch.setattr(objects, "drive_up", lambda model, drive, config: not driven.append(drive.scene.name))
    file, quiet = tmp_path / "objects.jsonl", lambda line: None
    measure(Model(True), CONFIG, 2, 7, file, quiet)
    found = measure(Model(True), CONFIG, 5, 7, file, quiet)
    assert len(driven) == 5 and found["objects"] == 5 and found["unseen"] == 0
    assert [json.loads(line)["object"] for line in file.read_text().splitlines()] == list(range(5))


def test_lines_of_another_seed_or_a_damaged_file_are_refused_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(objects, "drive_up", lambda model, drive, config: True)
    file, quiet = tmp_path / "objects.jsonl", lambda line: None
    measure(Model(True), CONFIG, 1, 7, file, quiet)
    with pytest.raises(RunError, match="another seed"):
        measure(Model(True), CONFIG, 1, 8, file, quiet)
    file.write_text("{")
    with pytest.raises(RunError, match="damaged"):
        measure(Model(True), CONFIG, 1, 7, file, quiet)


def test_shares_come_with_their_interval_and_by_kind():
    lines = [{"kind": "tree", "seen": True}] * 9 + [{"kind": "rock", "seen": False}]
    found = summary(lines)
    assert found["share"] == 0.1 and found["confidence_95"][0] < 0.1 < found["confidence_95"][1]
    assert found["kinds"]["rock"] == {"objects": 1, "unseen": 1}
