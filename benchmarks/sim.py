"""RL steps per CPU-second of one core, from physics alone to a whole actor, and the cost of each part.

`python benchmarks/sim.py [--quick]` prints a table, then one JSON line. Every design drives the same car through the
same scenes with the same actions, and the designs take turns, so that other load on the machine affects all of them
alike. All times are CPU time of the process without resets. The obvious design is PyBullet's renderer at 512 px with
the trunk run eagerly by torch at each step. `warm` is the default vision in training with every reading in the cache.
None of these designs has an agent. `actor_...` are whole steps of an actor with its agent: cold without a reading
cache; learning with the cache filled by the episodes before; warm when the same episodes are driven again, so that
every reading is in the cache. Networks without an encoder are left out where the weights contain none.
"""

import argparse
import dataclasses
import os
import statistics
import time
import uuid
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one core, as for each role; set before numpy and torch read it

import numpy as np
import torch
from _common import report

from zsdist.agent.hierarchy import q_functions
from zsdist.config import CameraConfig, Config, VisionConfig
from zsdist.driving.actor_car import ActorCar, EpisodeTask
from zsdist.driving.perception import Perception
from zsdist.planning.footprint import FootprintTable
from zsdist.planning.grid import Grid
from zsdist.run import program
from zsdist.sim.env import CarNavigation
from zsdist.sim.scenes.families import draw
from zsdist.types import Level, Pose
from zsdist.vision import weights_folder
from zsdist.vision.encoders import lite0
from zsdist.vision.encoders.base import resample
from zsdist.vision.models import STUDENT_PX
from zsdist.vision.reading_cache import ReadingCache
from zsdist.vision.visual_act import ALONE, VisualAct

CARS = (1, 4, 16, 32)
ENCODER_PX = 224
EPSILON = 0.5  # exploration of the actor's episodes: the middle of a run's decay

Read = Callable[[np.ndarray], object]


class Onlooker:
    """Car without an agent, with the attributes that `Perception` reads in a training episode."""

    trains = True

    def __init__(self, env: CarNavigation, scene_hash: str) -> None:
        self.scene_hash = scene_hash
        self.picture = env.picture
        self._world = env.world

    @property
    def pose(self) -> Pose:
        """True pose of the car."""
        return self._world.pose

    def goal_from_here(self) -> tuple[float, float]:
        """Return bearing and distance of the goal."""
        return self.pose.towards(*self._world.scene.goal)


@dataclasses.dataclass
class Design:
    """Simulated car with or without a camera and a network.

    Attributes:
        name: name in the table.
        env: environment of the car.
        camera: whether a picture is drawn after each action.
        read: network that reads the pictures `(1, px, px, 3)`; None: no network.
        perception: camera and network with a reading cache, in place of `camera` and `read`.
        parts_ms: CPU milliseconds of each action's physics, camera and network.
        rates: RL steps per CPU-second, one for each round.
    """

    name: str
    env: CarNavigation
    camera: bool = True
    read: Read | None = None
    perception: Perception | None = None
    parts_ms: list[tuple[float, float, float]] = dataclasses.field(default_factory=list)
    rates: list[float] = dataclasses.field(default_factory=list)

    def drive(self, scene: object, seed: int, actions: int) -> None:
        """Drive one round of random actions without collision on the true map; restart finished episodes."""
        rng, grid = np.random.default_rng(seed), self.env.grid
        blocked = FootprintTable(grid).blocked(scene.occupancy(grid))
        onlooker = Onlooker(self.env, scene.hash())
        self._begin(scene)
        spent_s = 0.0
        for _ in range(actions):
            state = grid.lattice_state(self.env.world.pose)
            free = np.flatnonzero(~blocked[state.iy, state.ix, state.heading])
            action = int(rng.choice(free)) if len(free) else int(rng.integers(5))
            marks = [time.process_time()]
            *_, terminated, truncated, _ = self.env.step(action)
            marks.append(time.process_time())
            picture = self.env.picture() if self.camera else None
            marks.append(time.process_time())
            if self.read is not None:
                self.read(picture[None])
            elif self.perception is not None:
                self.perception.views([onlooker])
            marks.append(time.process_time())
            self.parts_ms.append(tuple(1e3 * np.diff(marks)))
            spent_s += marks[-1] - marks[0]
            if terminated or truncated:
                self._begin(scene)
        self.rates.append(actions / spent_s)

    def rehearse(self, scene: object, seed: int, actions: int) -> None:
        """Drive the same round without recording it."""
        dataclasses.replace(self, parts_ms=[], rates=[]).drive(scene, seed, actions)

    def _begin(self, scene: object) -> None:
        self.env.reset(options={"scene": scene})
        if self.camera:
            self.env.picture()  # prepares the scene: a cost of the reset, not of an action


def main() -> None:
    """Measure, print the tables and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer rounds; ends within 50 s on two cores")
    parser.add_argument("--weights", default="pretrained", help="weights, as vision.weights (default: pretrained)")
    options = parser.parse_args()
    rounds, actions, warm_episodes, measured = (3, 10, 10, 200) if options.quick else (8, 25, 100, 1000)
    torch.set_num_threads(1)
    designs, head = _designs(options.weights)
    for index in range(-1, rounds):  # the first round warms up
        for design in designs:
            scene = draw("singleton", "train", max(index, 0))
            if design.perception is not None:
                design.rehearse(scene, index + 1, actions)
            design.drive(scene, index + 1, actions)
    for design in designs:
        if design.perception is not None:
            design.perception.close()
    figures = _figures(designs, actions)
    figures |= _actors(options.weights, warm_episodes, measured)
    figures |= _floor(figures, head)
    slow = figures["tiny_512px_eager_steps_per_cpu_s"]
    ratios = {
        "warm_vs_tiny512": figures["warm_steps_per_cpu_s"] / slow,
        "default_vs_tiny512": figures["actor_warm_steps_per_cpu_s"] / slow,
        "learning_vs_tiny512": figures["actor_learning_steps_per_cpu_s"] / slow,
        "cold_vs_tiny512": figures["actor_cold_4_cars_steps_per_cpu_s"] / slow,
        "car_camera_trunk_head_vs_tiny512": figures["caster_224px_trunk_head_steps_per_cpu_s"] / slow,
        "cost_a_step_32_cars_vs_1": figures["actor_cold_32_cars_ms"] / figures["actor_cold_1_cars_ms"],
    }
    report("sim", figures, ratios)


def _designs(weights: str) -> tuple[list[Design], Read]:
    """Return all designs, and the head alone, whose time does not depend on its tokens."""

    def env(size_px: int = ENCODER_PX, back_end: str = "caster") -> CarNavigation:
        camera = CameraConfig(size_px=size_px, back_end=back_end)
        return CarNavigation(config=Config(camera=camera), images=False)

    model = VisualAct.load(VisionConfig(weights=weights), CameraConfig())
    encoder, eager = lite0.EfficientNetLite0(), lite0.eager_trunk(lite0.weights_file()).eval()

    def read_eagerly(image: np.ndarray) -> torch.Tensor:
        with torch.no_grad():
            return eager(torch.from_numpy(resample(image, ENCODER_PX)))

    perception = Perception(model, Grid.from_config(Config().grid), Config().vision.rays, _memory())
    designs = [
        Design("physics", env(), camera=False),
        Design("caster_224px", env()),
        Design("caster_128px", env(STUDENT_PX)),
        Design("tiny_512px", env(512, "pybullet")),
        Design("caster_224px_trunk", env(), read=encoder.tokens),
        Design("caster_224px_trunk_head", env(), read=model.read),
        Design("tiny_512px_eager", env(512, "pybullet"), read=read_eagerly),
        Design("warm", env(), camera=False, perception=perception),
    ]
    folder = weights_folder.read(weights_folder.locate(weights))
    for name, (file, px) in ALONE.items():
        if folder.has(file):
            alone = VisualAct.load(VisionConfig(weights=weights, network=name), CameraConfig(size_px=px))
            designs.append(Design(f"caster_{px}px_{name}", env(px), read=alone.read))
    tokens = np.zeros((1, encoder.side, encoder.side, encoder.features), np.float32)
    return designs, lambda: model.read_tokens(tokens)


def _memory() -> ReadingCache:
    """Return an empty reading cache: its name is unique."""
    return ReadingCache(Config().vision.cache_bytes, f"benchmark {uuid.uuid4().hex}")


def _figures(designs: list[Design], actions: int) -> dict[str, float]:
    figures = {}
    print(f"{'ms an action, median':26}{'physics':>9}{'camera':>9}{'network':>9}{'all':>9}{'steps/CPU-s':>13}")
    for design in designs:
        parts = np.median(design.parts_ms[actions:], axis=0)
        rate = statistics.median(design.rates[1:])
        print(f"{design.name:26}{parts[0]:9.3f}{parts[1]:9.3f}{parts[2]:9.3f}{1e3 / rate:9.3f}{rate:13.0f}")
        figures[f"{design.name}_steps_per_cpu_s"] = rate
        for part, value, present in zip(
            ("physics", "camera", "network"),
            parts,
            (True, design.camera, design.read is not None or design.perception is not None),
            strict=True,
        ):
            if present:
                figures[f"{design.name}_{part}_ms"] = float(value)
    return figures


def _floor(figures: dict[str, float], head: Callable[[], object]) -> dict[str, float]:
    """Return the cost of each part of an action alone, their sum, and the cost of all parts measured together."""
    times = []
    for _ in range(60):
        began = time.process_time()
        head()
        times.append(1e3 * (time.process_time() - began))
    floor = {
        "physics": figures["physics_physics_ms"],
        "camera": figures["caster_224px_camera_ms"],
        "trunk": figures["caster_224px_trunk_network_ms"],
        "head": statistics.median(times),
    }
    whole_ms = 1e3 / figures["caster_224px_trunk_head_steps_per_cpu_s"]
    actor_ms = figures["actor_cold_4_cars_ms"]
    print("the floor, ms an action: " + " + ".join(f"{name} {ms:.3f}" for name, ms in floor.items()), end=" ")
    print(f"= {sum(floor.values()):.3f}; together {whole_ms:.3f}; with the agent, four cars {actor_ms:.3f}")
    return {f"floor_{name}_ms": ms for name, ms in floor.items()} | {
        "floor_sum_ms": sum(floor.values()),
        "floor_measured_together_ms": whole_ms,
        "floor_measured_actor_ms": actor_ms,
    }


def _actors(weights: str, warm_episodes: int, measured: int) -> dict[str, float]:
    """Return the cost of steps of whole actors in default training episodes: cold, learning and warm."""
    config = Config(vision=VisionConfig(weights=weights))
    parts, q = (
        program.simulation(config),
        q_functions({level: program.make_learner(config, level).parameters() for level in Level}),
    )
    grid, figures = Grid.from_config(config.grid), {}
    rays = config.vision.rays
    crews = {cars: _Crew(config, parts, cars, Perception(parts.visual_act, grid, rays, None), q) for cars in CARS}
    times = {cars: [] for cars in CARS}
    for _ in range(6):  # the first round warms up
        for cars, crew in crews.items():
            times[cars].append(crew.drive(max(cars, measured // 10)))
    for cars in CARS:
        ms = statistics.median(times[cars][1:])
        figures |= {f"actor_cold_{cars}_cars_ms": ms, f"actor_cold_{cars}_cars_steps_per_cpu_s": 1e3 / ms}
    perception = Perception(parts.visual_act, grid, rays, _memory())
    learning = _Crew(config, parts, config.run.cars_per_actor, perception, q)
    while learning.episodes < warm_episodes:
        learning.drive(config.run.cars_per_actor)
    figures |= _remembering("learning", learning, perception, measured, warm_episodes)
    again = _Crew(config, parts, config.run.cars_per_actor, perception, q)
    figures |= _remembering("warm", again, perception, measured, 0)
    perception.close()
    return figures


def _remembering(name: str, crew: "_Crew", perception: Perception, steps: int, episodes: int) -> dict[str, float]:
    """Return the cost of a step with a reading cache, and the share of readings from the cache."""
    before = np.array([perception.hits, perception.misses, perception.bypasses])
    ms = crew.drive(steps)
    hits, *others = np.array([perception.hits, perception.misses, perception.bypasses]) - before
    share = float(hits / (hits + sum(others)))
    print(f"{name}: {ms:.3f} ms a step, {1e3 / ms:.0f} steps/CPU-s, {share:.0%} remembered, {episodes} episodes before")
    return {
        f"actor_{name}_ms": ms,
        f"actor_{name}_steps_per_cpu_s": 1e3 / ms,
        f"actor_{name}_remembered_share": share,
        f"actor_{name}_after_episodes": episodes,
    }


class _Crew:
    """Cars of an actor without its messages, with an untrained agent in training episodes."""

    def __init__(self, config: Config, parts: program.ActorParts, cars: int, perception: Perception, q: dict) -> None:
        self.episodes = 0
        self._parts, self._perception, self._q = parts, perception, q
        self._cars = [ActorCar(parts.make_env(), config) for _ in range(cars)]

    def drive(self, steps: int) -> float:
        """Drive at least `steps` steps; return the CPU milliseconds of one step, without resets."""
        driven, spent_s = 0, 0.0
        while driven < steps:
            for car in self._cars:
                if car.idle:
                    self.episodes += 1
                    scene = self._parts.schedule.training(self.episodes)
                    car.begin(
                        EpisodeTask(scene, self.episodes, EPSILON, True, (0, self.episodes)), dict.fromkeys(Level, 0)
                    )
            began = time.process_time()
            for car, view in zip(self._cars, self._perception.views(self._cars), strict=True):
                ended = car.over
                car.advance(view, self._q)
                car.drain()
                driven += not ended
                if ended:
                    car.record()
            spent_s += time.process_time() - began
        return 1e3 * spent_s / driven


if __name__ == "__main__":
    main()
