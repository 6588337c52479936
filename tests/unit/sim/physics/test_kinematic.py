import math

import pytest

from zsdist.config import Config
from zsdist.planning.footprint import successor
from zsdist.sim.physics.kinematic import make_env
from zsdist.sim.scenes import families
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Action, Pose

OPEN = Scene("open", "grass", Start(0.3125, 0.3125, 0.0), (9.0625, 0.3125), ())


@pytest.fixture(scope="module")
def env():
    made = make_env(Config(), images=False, exact=True)
    yield made
    made.close()


@pytest.mark.parametrize("action", list(Action))
def test_every_action_ends_on_the_lattice_to_the_micrometre(env, action):
    env.reset(options={"scene": OPEN})
    state = env.grid.lattice_state(OPEN.start.pose)
    for _ in range(3):
        observation, *_ = env.step(int(action))
        state = successor(state, action)
        there, here = env.grid.pose(state), Pose(*observation["pose"])
        assert math.dist(there[:2], here[:2]) < 1e-6
        assert abs(math.remainder(there.heading_rad - here.heading_rad, math.tau)) < 1e-6


def test_an_obstacle_in_the_way_is_hit(env):
    pole = Obstacle("pole", 2.3, 0.3125, radius_m=0.1)
    env.reset(options={"scene": Scene("pole", "grass", OPEN.start, OPEN.goal, (pole,))})
    ended = [env.step(int(Action.FORWARD)) for _ in range(2)][-1]
    assert ended[2] and ended[4]["collision"]


def test_people_walk_on_while_it_drives(env):
    scene = families.draw("ood-dynamic", "validation", 0)
    env.reset(options={"scene": scene})
    before = env.world.people
    env.step(int(Action.TURN_LEFT_90))
    assert (env.world.people != before).any()
