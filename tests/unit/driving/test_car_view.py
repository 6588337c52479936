import base64
import io
import json
from functools import partial

import numpy as np
from fakes import FakeVisualAct, LatticeEnv
from PIL import Image

from zsdist.config import Config
from zsdist.dqn import network
from zsdist.driving import car_view
from zsdist.driving.actor_car import ActorCar, EpisodeTask
from zsdist.driving.perception import Perception
from zsdist.planning.grid import Grid
from zsdist.roles.shapes import SHAPES
from zsdist.sim.scenes import families
from zsdist.types import Level

CONFIG = Config()
Q = {
    level: partial(network.apply, network.initial_parameters(shape.state_size, shape.actions, (8,), seed=0))
    for level, shape in SHAPES.items()
}


class PictureEnv(LatticeEnv):
    """Environment that shows a picture where one is asked for at a pose."""

    def picture(self, pose=None):
        return super().picture() if pose is None else np.full((32, 32, 3), 90, np.uint8)


def begun():
    car = ActorCar(PictureEnv(), CONFIG)
    task = EpisodeTask(families.draw("iid", "train", 0), 3, 0.5, True, (1,), most_steps=8)
    car.begin(task, {Level.HIGH: 1, Level.LOW: 2})
    return car


def drive(car, steps, look=lambda car: None):
    perception = Perception(FakeVisualAct(), Grid(), "all", None)
    for _ in range(steps):
        ended = car.over
        car.advance(*perception.views([car]), Q)
        look(car)
        if ended:
            break
    return car


def shown(car):
    return json.loads(json.dumps(car_view.detail(car, CONFIG, Q[Level.HIGH]), allow_nan=False))


def bits(text, size):
    flat = np.unpackbits(np.frombuffer(base64.b64decode(text), np.uint8))
    return flat[: size * size].reshape(size, size).astype(bool)


def test_a_close_look_shows_picture_rays_belief_values_gradients_and_subgoal():
    car = drive(begun(), 5)
    view, situation = shown(car), car.agent.situation
    assert (view["kind"], view["number"], view["step"]) == ("training", 3, 5)
    assert len(view["path"]) == 6 and view["path"][0] == view["start"] and view["decided_at"][:2] == view["path"][-2]
    assert Image.open(io.BytesIO(base64.b64decode(view["picture"]))).size == (32, 32)
    for name, known in (("seen", situation.seen), ("occupied", situation.occupied)):
        np.testing.assert_array_equal(bits(view["belief"][name], view["belief"]["size"]), known)
    rays = view["rays"]
    assert all(near <= median <= far for near, median, far in zip(*map(rays.get, car_view.RAY_SHARES), strict=True))
    assert len(rays["near_m"]) == len(rays["angles_deg"])
    assert sum(choice["goal"] for choice in view["choices"]) == 1
    assert all(abs(np.hypot(*gradient["to"]) - 1) < 0.01 for gradient in view["gradients"])
    assert view["subgoal"] and view["behaviour"] in ("greedy", "guide", "uniform")


def test_the_believed_way_leads_from_the_car_to_the_goal_along_the_gradients():
    car = drive(begun(), 2)
    view = shown(car)
    assert np.hypot(*np.subtract(view["way"][-1], view["goal"])) <= CONFIG.sim.success_radius_m
    assert np.hypot(*np.subtract(view["way"][0], view["decided_at"][:2])) < CONFIG.grid.cell_size_m
    towards = {tuple(gradient["block"]): gradient["to"] for gradient in view["gradients"]}
    block = car.agent.situation.block
    assert np.dot(towards[block], np.subtract(view["goal"], view["decided_at"][:2])) > 0


def test_looking_changes_nothing():
    records = [drive(begun(), 9, look).record() for look in (lambda car: None, lambda car: car.idle or shown(car))]
    assert records[0] == records[1]


def test_a_car_that_has_not_decided_shows_its_place_and_an_idle_one_nothing():
    car = begun()
    view = shown(car)
    assert view["pose"][:2] == view["start"] and "picture" not in view
    car.cut()
    assert shown(car) == car_view.overview(car) == {"kind": "idle"}
