import hashlib
import math
import subprocess
import sys

import numpy as np
import pytest

from zsdist.errors import SceneError
from zsdist.planning.footprint import successor
from zsdist.planning.grid import Grid
from zsdist.sim.physics.collision import NO_BOXES, clearance_m
from zsdist.sim.physics.world import ON_LATTICE_M, ON_LATTICE_RAD, World
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.sim.scenes.walkers import STOP_M
from zsdist.types import Action, LatticeState, Pose

GRID = Grid()
FORWARD, LEFT, RIGHT, TURN_LEFT, TURN_RIGHT = Action
ROUTE = [FORWARD, LEFT, FORWARD, TURN_RIGHT, FORWARD, RIGHT, FORWARD, TURN_LEFT, LEFT, FORWARD]


def scene(*obstacles: Obstacle, x: float = 0.3125, y: float = 0.3125, heading_deg: float = 0.0) -> Scene:
    return Scene("test", "sand", Start(x, y, heading_deg), (8.0, 8.0), obstacles)


SCATTERED = scene(
    Obstacle("tree", 3.5, 3.0, 1.0),
    Obstacle("rock", -3.0, 2.0, 0.7),
    Obstacle("box", 0.0, -4.0, None, (4.0, 0.6, 2.0), 30.0),
    Obstacle("person", 6.0, 0.0, 0.3, path=((6.0, 0.0), (6.0, 3.0)), speed_mps=0.8),
)
OTHER = scene(Obstacle("bush", 4.1, 0.3, 0.9), Obstacle("bush", -3.0, 2.0, 0.4), heading_deg=45.0)


def hash_of_drive(world: World, of: Scene, actions: list[Action]) -> str:
    """Return the hash of every pose and tilt."""
    world.reset(of)
    numbers = [*world.pose, *world.tilt]
    for action in actions:
        result = world.drive(action)
        numbers += [*result.pose, *world.tilt, result.sim_steps, *world.people.ravel()]
        if result.contact:
            break
    return hashlib.sha256(np.array(numbers).tobytes()).hexdigest()


@pytest.fixture(scope="module")
def world():
    world = World(GRID)
    yield world
    world.close()


def distance(pose: Pose, target: Pose) -> tuple[float, float]:
    turn = math.remainder(pose.heading_rad - target.heading_rad, math.tau)
    return math.dist(pose[:2], target[:2]), abs(turn)


@pytest.mark.parametrize("heading", range(8))
@pytest.mark.parametrize("action", Action)
def test_an_action_from_rest_ends_within_a_tenth_of_a_metre_and_five_degrees_of_its_target(world, heading, action):
    state = LatticeState(16, 16, heading)
    world.reset(scene(), GRID.pose(state))
    result = world.drive(action)
    metres, radians = distance(result.pose, GRID.pose(successor(state, action)))
    assert metres <= 0.10
    assert radians <= math.radians(5.0)
    assert not result.contact
    assert 8 <= result.sim_steps <= 30


def test_errors_do_not_add_up_along_a_route(world):
    world.reset(scene())
    state = GRID.lattice_state(world.pose)
    for action in ROUTE:
        state = successor(state, action)
        metres, radians = distance(world.drive(action).pose, GRID.pose(state))
        assert metres <= 0.15
        assert radians <= math.radians(8.0)


def test_a_replay_is_bit_equal_after_other_episodes_in_the_same_world(world):
    first = hash_of_drive(world, SCATTERED, ROUTE)
    assert hash_of_drive(world, SCATTERED, ROUTE) == first
    hash_of_drive(world, OTHER, [FORWARD] * 9)
    hash_of_drive(world, SCATTERED, [TURN_LEFT, FORWARD])
    assert hash_of_drive(world, SCATTERED, ROUTE) == first


def test_a_replay_is_bit_equal_if_the_car_already_stands_on_its_start(world):
    first = hash_of_drive(world, SCATTERED, ROUTE)
    for _ in range(3):
        world.reset(SCATTERED)
    assert hash_of_drive(world, SCATTERED, ROUTE) == first


def test_a_replay_is_bit_equal_after_a_collision_and_in_a_new_world(world):
    crash = hash_of_drive(world, OTHER, [RIGHT] + [FORWARD] * 9)
    hash_of_drive(world, SCATTERED, ROUTE)
    assert hash_of_drive(world, OTHER, [RIGHT] + [FORWARD] * 9) == crash
    new = World(GRID)
    assert hash_of_drive(new, OTHER, [RIGHT] + [FORWARD] * 9) == crash
    new.close()


def test_a_replay_is_bit_equal_after_the_client_was_replaced(world, monkeypatch):
    first = hash_of_drive(world, SCATTERED, ROUTE)
    monkeypatch.setattr("zsdist.sim.physics.world._MOST_SHAPES", 0)  # as after thousands of scenes
    hash_of_drive(world, OTHER, ROUTE)
    assert hash_of_drive(world, SCATTERED, ROUTE) == first


def test_a_replay_is_bit_equal_in_another_process(world):
    program = (
        "import importlib.util as u, sys; s = u.spec_from_file_location('t', sys.argv[1]); t = u.module_from_spec(s); "
        "s.loader.exec_module(t); print(t.hash_of_drive(t.World(t.GRID), t.SCATTERED, t.ROUTE))"
    )
    command = [sys.executable, "-c", program, __file__]
    run = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert run.stdout.split()[-1] == hash_of_drive(world, SCATTERED, ROUTE)


def test_a_drive_stops_at_once_at_a_collision(world):
    world.reset(scene(Obstacle("tree", 3.0, 0.3125, 1.0)))  # 0.67 m ahead of the front
    results = [world.drive(FORWARD) for _ in range(2)]
    assert not results[0].contact
    assert results[1].contact
    assert world.touches() or world.contact()
    front = results[1].pose.x_m + 1.02
    assert 1.95 < front < 2.12  # at most the distance of one step into the trunk


def test_the_arenas_walls_are_hit(world):
    world.reset(scene(x=9.6875))  # last cell: an advance would leave the grid
    pose = world.drive(FORWARD).pose
    assert pose.x_m == pytest.approx(9.6875, abs=0.1)
    with pytest.raises(SceneError, match="wall stands on the start"):
        world.reset(scene(), Pose(11.6, 0.0, 0.0))


def test_an_advance_off_the_grid_turns_only(world):
    world.reset(scene(x=9.6875))
    result = world.drive(LEFT)
    assert GRID.lattice_state(result.pose) == GRID.lattice_state(Pose(9.6875, 0.3125, math.pi / 4))


def test_a_start_off_the_lattice_is_driven_onto_it(world):
    steps = world.reset(scene(x=0.1, y=0.55, heading_deg=20.0))
    metres, radians = distance(world.pose, GRID.pose(GRID.lattice_state(world.pose)))
    assert steps > 0
    assert metres <= ON_LATTICE_M
    assert radians <= ON_LATTICE_RAD


def test_a_start_without_room_to_reach_the_lattice_is_kept(world):
    walls = [Obstacle("box", 0.1, y, None, (6.0, 0.2, 2.0), 0.0) for y in (-0.7, 0.9)]
    steps = world.reset(scene(*walls, x=0.1, y=0.1, heading_deg=8.0))
    assert steps == 0
    assert distance(world.pose, Pose(0.1, 0.1, math.radians(8.0)))[0] < 0.01


def test_an_obstacle_on_the_start_is_refused(world):
    with pytest.raises(SceneError, match=r"test: an obstacle or a wall stands on the start \(0.3125, 0.3125\)"):
        world.reset(scene(Obstacle("tree", 1.0, 1.0, 1.0)))


def test_a_walking_person_stops_at_a_distance_from_the_car_and_is_never_hit(world):
    path = ((4.0, -6.0), (4.0, 6.0))
    world.reset(scene(Obstacle("person", 4.0, -6.0, 0.3, path=path, speed_mps=1.2)))
    nearest = math.inf
    for action in [TURN_LEFT, TURN_RIGHT] * 8:  # the car stays in place, 2.4 m off the path
        assert not world.drive(action).contact
        nearest = min(nearest, clearance_m(world.pose, np.array([(*world.people[0], 0.3)]), NO_BOXES))
    assert world.people[0, 1] != -6.0
    assert nearest >= STOP_M - 1.2 * 0.05


def test_people_return_to_their_start_with_each_episode(world):
    moving = scene(Obstacle("person", 6.0, 0.0, 0.3, path=((6.0, 0.0), (6.0, 3.0)), speed_mps=0.8))
    world.reset(moving)
    world.drive(TURN_LEFT)
    assert world.people[0, 1] > 0.3
    world.reset(moving)
    assert world.people.tolist() == [[6.0, 0.0]]


def test_contacts_and_box_test_agree_among_obstacles(world):
    rng = np.random.default_rng(3)
    obstacles = [Obstacle("tree", *rng.uniform(-9, 9, 2), radius_m=rng.uniform(0.3, 1.2)) for _ in range(12)]
    obstacles += [
        Obstacle("box", *rng.uniform(-9, 9, 2), size_m=(*rng.uniform(0.3, 3, 2), 2.0), heading_deg=rng.uniform(0, 360))
        for _ in range(8)
    ]
    cluttered = scene(*(o for o in obstacles if math.hypot(o.x_m, o.y_m) > 3.0), x=0.0, y=0.0)
    world.reset(cluttered)
    verdicts = []
    for _ in range(400):
        world.put(Pose(*rng.uniform(-11.2, 11.2, 2), rng.uniform(-math.pi, math.pi)))
        verdicts.append((world.touches(), world.contact()))
    verdicts = np.array(verdicts)
    assert 0.1 < verdicts[:, 0].mean() < 0.9
    assert (verdicts[:, 0] == verdicts[:, 1]).mean() >= 0.99
