"""Stand-ins for the simulator and the visual-act model, fast enough to drive thousands of steps a second.

`LatticeEnv` has the interface of `zsdist.sim.env.CarNavigation`; its "image" is a row of true ray distances, which
`FakeVisualAct` turns into the views that a good model would give, with noise and misses on demand.
"""

import math

import numpy as np

from zsdist.config import Config
from zsdist.evaluation.records import EpisodeRecord
from zsdist.planning.footprint import ADVANCES, TURNS, successor
from zsdist.planning.grid import Grid
from zsdist.planning.rewards import RewardTerms, obstacle_avoidance, target_distance, target_reached
from zsdist.sim.physics import collision, raycast
from zsdist.sim.scenes import families
from zsdist.sim.scenes.kinds import KINDS
from zsdist.types import Action, Outcome, Pose, View
from zsdist.vision import labels, rays
from zsdist.vision.reading import Reading

CENTIMETRES = 100
SAMPLES = 9  # poses along a move that are tested for contact


class LatticeEnv:
    """Environment without physics: every action ends exactly on the lattice, and walkers stand at their start."""

    def __init__(self, family="iid", config=None):
        self.family = family
        self.config = config or Config()
        self.grid = Grid.from_config(self.config.grid)
        self._angles = rays.ray_angles_rad(rays.RAYS, math.radians(self.config.camera.field_of_view_deg))

    def reset(self, *, seed=None, options=None):
        scene = (options or {}).get("scene")
        if scene is None:
            index = int(np.random.default_rng(seed).integers(self.config.scenes.train_scenes))
            scene = families.generate(self.family, families.split_seed("train", index))
        self.scene = scene
        self._circles, self._boxes = scene.circles(), scene.boxes()
        kinds = [KINDS[obstacle.kind] for obstacle in scene.obstacles]
        self._dynamic = np.array(
            [kind.dynamic for kind in kinds if kind.round]
            + [kind.dynamic for kind in kinds if not kind.round]
            + [False]
        )
        self.state = self.grid.lattice_state(scene.start.pose)
        self._steps = 0
        return self._observe(), self._about()

    def step(self, action):
        state, pose = self.state, self.grid.pose(self.state)
        end = successor(state, action)
        stays = not self.grid.on_grid(end.ix, end.iy)
        turn = TURNS[action] * math.tau / 8
        advance = 0.0 if stays or not ADVANCES[action] else math.dist(self.grid.centre(*end[:2]), pose[:2])
        hit = any(self._touches(pose.x_m, pose.y_m, pose.heading_rad + turn * s) for s in np.linspace(0, 1, SAMPLES))
        heading = pose.heading_rad + turn
        for share in np.linspace(0, 1, SAMPLES)[1:] if advance else ():
            ahead = advance * share
            hit = hit or self._touches(
                pose.x_m + ahead * math.cos(heading), pose.y_m + ahead * math.sin(heading), heading
            )
        self.state = end._replace(ix=state.ix, iy=state.iy) if stays else end
        self._steps += 1
        place, rewards = self.grid.centre(self.state.ix, self.state.iy), self.config.reward
        success = not hit and math.dist(place, self.scene.goal) <= self.config.sim.success_radius_m
        terms = RewardTerms(
            target_distance(place, self.scene.goal),
            obstacle_avoidance(hit, rewards.collision, rewards.safe),
            target_reached(success, rewards.goal, rewards.step),
        )
        terminated = success or hit
        truncated = not terminated and self._steps >= self.config.sim.max_steps
        info = self._about() | {"reward_terms": terms._asdict(), "success": success, "collision": hit}
        return self._observe(), terms.total, terminated, truncated, info

    def close(self):
        pass

    def picture(self, pose=None):
        return self._image(self.grid.pose(self.state) if pose is None else pose)

    def _touches(self, x_m, y_m, heading_rad):
        return collision.touching(
            Pose(x_m, y_m, heading_rad), self._circles, self._boxes, arena_m=self.config.grid.arena_m
        )

    def _observe(self):
        pose = self.grid.pose(self.state)
        return {"image": self._image(pose), "pose": np.array(pose), "goal": np.array(self.scene.goal, float)}

    def _image(self, pose):
        camera = self.config.camera
        distances, hits = raycast.ray_distances(
            self._circles,
            self._boxes,
            self.config.grid.arena_m / 2,
            pose.x_m + camera.forward_m * math.cos(pose.heading_rad),
            pose.y_m + camera.forward_m * math.sin(pose.heading_rad),
            self._angles + pose.heading_rad,
            camera.range_m,
        )
        hundredths = np.round(distances * CENTIMETRES).astype(int)
        dynamic = np.where(hits >= 0, self._dynamic[hits], False)
        return np.stack([hundredths // 256, hundredths % 256, dynamic], axis=1).astype(np.uint8)[None]

    def _about(self):
        ends = [successor(self.state, action) for action in Action]
        mask = np.array([self.grid.on_grid(end.ix, end.iy) for end in ends])
        return {"scene": self.scene.name, "action_mask": mask.astype(np.int8), "sim_steps": 10}


class FakeVisualAct:
    """Views from the pictures of `LatticeEnv`.

    `noise` is relative, per ray; `misses` is the share of rays that miss any obstacle.
    """

    encoder_name = "fake"
    encoder_sha256 = "1" * 64
    weights_sha256 = "0" * 64

    def __init__(self, noise=0.0, misses=0.0, seed=0):
        self._noise, self._misses = noise, misses
        self._rng = np.random.default_rng(seed)
        self._angles = rays.ray_angles_rad(rays.RAYS, math.pi / 2)

    def __call__(self, images, goal_bearing_rad, goal_distance_m):
        return self.views(self.read(images), goal_bearing_rad, goal_distance_m)

    def read(self, images):
        distances = np.array([self._distances(image[0]) for image in images])
        clearance, dynamic = labels.nearest(distances, images[:, 0, :, 2] > 0, self._angles)
        return Reading(rays.soft_labels(clearance), dynamic.astype(np.float32), rays.soft_labels(distances))

    def views(self, reading, goal_bearing_rad, goal_distance_m):
        clearance_m = rays.quantile_m(reading.clearance, 0.5)
        bearing, distance = np.asarray(goal_bearing_rad, float), np.asarray(goal_distance_m, float)
        room = labels.openness(clearance_m, reading.dynamic, distance[:, None])
        advice = labels.reward_label(room, labels.progress(bearing, distance)).astype(np.float32)
        return [
            View(advice[i], clearance_m[i], reading.dynamic[i], reading.rays[i], self._angles, rays.BIN_EDGES_M)
            for i in range(len(advice))
        ]

    def _distances(self, row):
        distances = (row[:, 0].astype(float) * 256 + row[:, 1]) / CENTIMETRES
        if self._noise:
            free = distances >= rays.RANGE_M
            distances = np.clip(distances * (1 + self._noise * self._rng.normal(size=len(row))), 0.05, rays.RANGE_M)
            distances[free] = rays.RANGE_M
        if self._misses:
            distances[self._rng.random(len(row)) < self._misses] = rays.RANGE_M
        return distances


RECORD = EpisodeRecord(
    scene="one",
    outcome=Outcome.SUCCESS,
    steps=25,
    fewest_steps=20,
    path_m=20.0,
    shortest_m=15.0,
    remaining_m=0.0,
    min_clearance_m=0.4,
    static=True,
    decision_ms=(1.0,) * 25,
    shield_changes=0,
    poses=(Pose(0, 0, 0), Pose(3, 4, 0)),
)  # an evaluated episode, for tests of metrics, files and reports
