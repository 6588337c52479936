"""Simulated car as a gymnasium environment: `gymnasium.make("zsdist/CarNavigation-v0")`."""

import contextlib
import copy
import math
import operator
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ClosedEnvironmentError, InvalidAction, ResetNeeded

from zsdist import config as settings
from zsdist.common import places, presets
from zsdist.config import Config
from zsdist.errors import ConfigError, SceneError
from zsdist.planning.grid import Grid
from zsdist.planning.lattice import NOWHERE, flat_state, successors
from zsdist.planning.rewards import RewardTerms, obstacle_avoidance, target_distance, target_reached
from zsdist.sim.camera import Camera, make_camera
from zsdist.sim.physics.world import World
from zsdist.sim.scenes import families, sources
from zsdist.sim.scenes import scene as scene_files
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Action, Pose


class CarNavigation(gymnasium.Env):
    """Environment with one car in one scene per episode; an action is one of the five lattice moves.

    Observation, a dictionary:
        `image`: `(px, px, 3)` uint8, picture of the camera on the car at its true pose, with its roll and pitch.
        `pose`: `(3,)` float64, true `x_m`, `y_m`, `heading_rad` of the car.
        `goal`: `(2,)` float64, `x_m`, `y_m` of the goal.

    The reward is the sum of the terms in `zsdist.planning.rewards`. An episode terminates at a collision or at the
    goal, and is truncated after `config.sim.max_steps` actions. A move off the grid is masked in `info`. If it is made
    nevertheless, it only turns the car. Apart from picture, pose and goal, only the scene's name is revealed.

    The `info` of a reset has `scene`, `action_mask` `(5,)` int8, as `action_space.sample` takes it, and `sim_steps`.
    That of a step also has `success`, `collision` and `reward_terms`, a dictionary of `distance`, `safety` and `goal`.

    Copies and pickles go on where the environment was, and share nothing with it. An environment that is no longer
    used releases its simulation, closed or not.

    Args:
        family: family of the training scenes from which a reset chooses by its seed, or path of a folder of scene files
            or of one; `reset(options={"scene": scene})` sets a scene.
        config: configuration of grid, simulation, camera, rewards and number of training scenes, as a `Config`, a
            mapping of settings, a preset's name or the path of a YAML file; None: the defaults. `spec` holds all.
        camera: camera that draws the images, which the caller closes; None: the one that `config.camera` describes.
        render_mode: `rgb_array`: `render` returns the camera's image; None: it returns nothing. `gymnasium.make` shows
            these images in a window for `human`, with the package pygame.
        images: whether observations and their space have an `image`; without it, only `picture` uses the camera.

    Attributes:
        family: family of the training scenes, or absolute path of the scene files.
        config: configuration of the environment.
        render_mode: `rgb_array` or None.
        grid: planning grid.
        world: simulated physics.

    Raises:
        ConfigError: there is no such family or render mode, or the configuration is not valid.
        SceneError: a scene file is wrong.
        SimulationError: PyBullet allows no further client in this process.
    """

    # gymnasium.Env declares an instance variable.
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012
    _spec: EnvSpec | None = None

    def __init__(
        self,
        family: str | os.PathLike[str] = "iid",
        config: Config | Mapping[str, Any] | str | os.PathLike[str] | None = None,
        camera: Camera | None = None,
        render_mode: str | None = None,
        images: bool = True,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ConfigError(f"render_mode is {render_mode!r}; allowed are None, 'rgb_array'")
        self.config = _config(config)
        self.render_mode = render_mode
        self.grid = Grid.from_config(self.config.grid)
        self.family, self._scenes = _source(family, self.grid)
        self.world = World(self.grid, self.config.sim.step_s)
        self._own_camera = camera is None
        self._camera: Camera = make_camera(self.config.camera) if camera is None else camera
        self._image: np.ndarray | None = None
        self._images = images
        self._steps = 0
        self._over = True
        self._closed = False
        wall, px = self.grid.arena_m / 2, self.config.camera.size_px
        farthest = np.array([wall, wall, math.pi])
        self.action_space = spaces.Discrete(len(Action))
        observed: dict[str, spaces.Space[Any]] = {}
        if images:
            observed["image"] = spaces.Box(0, 255, (px, px, 3), np.uint8)
        observed["pose"] = spaces.Box(-farthest, farthest, dtype=np.float64)
        observed["goal"] = spaces.Box(-wall, wall, (2,), np.float64)
        self.observation_space = spaces.Dict(observed)

    def __copy__(self) -> Self:
        return copy.deepcopy(self)

    @property
    def spec(self) -> EnvSpec | None:
        """Specification from which `gymnasium.make` made the environment, with all settings, so that JSON can hold it.

        None for an environment that was made directly.
        """
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None and spec.kwargs.get("config") is not None:
            spec = replace(spec, kwargs=spec.kwargs | {"config": self.config.model_dump(mode="json")})
        if spec is not None and self._scenes is not None:
            spec = replace(spec, kwargs=spec.kwargs | {"family": self.family})
        self._spec = spec

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode in `options["scene"]`, or else in a training scene of the family or one of the files.

        Args:
            seed: seed of the choice of scenes from here on, an integer of Python or numpy; None: go on.
            options: its only key is `scene`: a `Scene`, the path of a scene file, or a mapping with its content.

        Returns:
            Observation and `info`.

        Raises:
            SceneError: the scene is not valid, or an obstacle or a wall stands on its start.
            ConfigError: there is another option.
            ClosedEnvironmentError: the environment is closed.
        """
        self._check_open()
        with contextlib.suppress(TypeError):  # gymnasium refuses what is no integer
            seed = operator.index(seed)  # type: ignore[arg-type]
        scene = self._wanted_scene({} if options is None else options)
        super().reset(seed=seed)
        if scene is None:
            scene = self._training_scene()
        self._over = True  # if the world refuses the scene
        sim_steps = self.world.reset(scene)
        self._steps, self._over = 0, False
        pose = self.world.pose
        return self._observe(scene, pose), self._info(scene, pose, sim_steps)

    def step(self, action: int) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive one action to its end.

        Returns:
            Observation, reward, whether the episode terminated, whether it was truncated, and `info`.

        Raises:
            ResetNeeded: the episode is over, or none has begun.
            InvalidAction: `action` is none of 0 to 4.
            ClosedEnvironmentError: the environment is closed.
        """
        scene = self.world.scene
        if self._over or scene is None:
            self._check_open()
            raise ResetNeeded("no episode is running; call reset() before step()")
        if not (type(action) is int and 0 <= action < len(Action)) and not self.action_space.contains(action):
            raise InvalidAction(f"action is {action!r}; allowed are the integers 0 to {len(Action) - 1}")
        driven = self.world.drive(int(action))
        self._steps += 1
        position, rewards = driven.pose[:2], self.config.reward
        success = not driven.contact and math.dist(position, scene.goal) <= self.config.sim.success_radius_m
        terms = RewardTerms(
            distance=target_distance(position, scene.goal),
            safety=obstacle_avoidance(driven.contact, rewards.collision, rewards.safe),
            goal=target_reached(success, rewards.goal, rewards.step),
        )
        terminated = success or driven.contact
        truncated = not terminated and self._steps >= self.config.sim.max_steps
        self._over = terminated or truncated
        info = self._info(scene, driven.pose, driven.sim_steps)
        info |= {"reward_terms": terms._asdict(), "success": success, "collision": driven.contact}
        return self._observe(scene, driven.pose), terms.total, terminated, truncated, info

    def action_masks(self) -> np.ndarray:
        """Return which actions are allowed now, `(5,)` bool: `action_mask` of `info`, as MaskablePPO asks for it.

        Raises:
            ResetNeeded: no episode has begun.
            ClosedEnvironmentError: the environment is closed.
        """
        self._check_open()
        if self.world.scene is None:
            raise ResetNeeded("no episode has begun; call reset() before action_masks()")
        return self._mask(self.world.pose)

    def picture(self, pose: Pose | None = None) -> np.ndarray:
        """Return the camera's picture, `(px, px, 3)` uint8; it must not be written.

        Args:
            pose: pose of a car that stands level; None: the car's true pose, with its roll and pitch.

        Raises:
            ResetNeeded: no episode has begun.
            ClosedEnvironmentError: the environment is closed.
        """
        self._check_open()
        scene = self.world.scene
        if scene is None:
            raise ResetNeeded("no episode has begun; call reset() before picture() or render()")
        if pose is not None:
            return self._camera.render(scene, pose, 0.0, 0.0, self.world.people)
        if self._image is None:
            roll_rad, pitch_rad = self.world.tilt
            self._image = self._camera.render(scene, self.world.pose, roll_rad, pitch_rad, self.world.people)
        return self._image

    def render(self) -> np.ndarray | None:
        """Return the camera's image, `(px, px, 3)` uint8, in the mode `rgb_array`; None without a render mode."""
        return None if self.render_mode is None else self.picture().copy()

    def close(self) -> None:
        """Release the simulation and the environment's own camera; closing again does nothing."""
        self._closed = self._over = True
        self.world.close()
        if self._own_camera:
            self._camera.close()

    def _check_open(self) -> None:
        if self._closed:
            raise ClosedEnvironmentError("the environment is closed; make another one")

    def _wanted_scene(self, options: Mapping[str, Any]) -> Scene | None:
        if not isinstance(options, Mapping):
            raise ConfigError(f"reset options are {options!r:.80}; allowed is a dictionary with the key 'scene'")
        unknown = [key for key in options if key != "scene"]
        if unknown:
            raise ConfigError(f"reset option {unknown[0]!r} is unknown; allowed is 'scene'")
        scene = options.get("scene")
        if scene is None or isinstance(scene, Scene):
            return scene
        if isinstance(scene, str | os.PathLike):
            return scene_files.read(Path(scene).expanduser(), self.grid)
        if isinstance(scene, Mapping):
            return scene_files.parse(scene, self.grid)
        raise SceneError(
            f"reset option 'scene' is {scene!r:.80}; allowed are a Scene, the path of a scene file, and a mapping with "
            "its content"
        )

    def _training_scene(self) -> Scene:
        if self._scenes is not None:
            return self._scenes[int(self.np_random.integers(len(self._scenes)))]
        count = self.config.scenes.train_scenes
        if self.family == "singleton":
            count = min(count, families.SINGLETON_SCENES)
        index = int(self.np_random.integers(count))
        return families.generate(self.family, families.split_seed("train", index))

    def _observe(self, scene: Scene, pose: Pose) -> dict[str, np.ndarray]:
        self._image = None
        poses = {"pose": np.array(pose), "goal": np.array(scene.goal, dtype=np.float64)}
        return {"image": self.picture().copy()} | poses if self._images else poses

    def _info(self, scene: Scene, pose: Pose, sim_steps: int) -> dict[str, Any]:
        return {"scene": scene.name, "action_mask": self._mask(pose).astype(np.int8), "sim_steps": sim_steps}

    def _mask(self, pose: Pose) -> np.ndarray:
        state = self.grid.lattice_state(pose)
        mask: np.ndarray = successors(self.grid.cells)[flat_state(state, self.grid.cells)] != NOWHERE
        return mask


def _source(family: Any, grid: Grid) -> tuple[str, list[Scene] | None]:
    """Return a family's name and None, or the absolute path of scene files and their scenes."""
    if isinstance(family, str) and family in families.FAMILIES:
        return family, None
    if not isinstance(family, str | os.PathLike) or not os.path.exists(os.path.expanduser(family)):
        raise ConfigError(
            f"scene family is {family!r:.80}; allowed are {', '.join(families.FAMILIES)}, a folder of scene files and "
            "one such file"
        )
    path = os.fspath(family)
    return places.absolute(path), sources.read_files(path, "family", grid=grid)


def _config(given: Config | Mapping[str, Any] | str | os.PathLike[str] | None) -> Config:
    if given is None:
        return Config()
    if isinstance(given, Config):
        return given
    if isinstance(given, str | os.PathLike):
        if isinstance(given, str) and presets.find(given) is not None:
            return settings.load(given)
        return settings.load(Path(given).expanduser())
    if isinstance(given, Mapping):
        return settings.parse(dict(given))
    raise ConfigError(
        f"config is {given!r:.80}; allowed are a Config, a mapping of settings, the path of a YAML file, a "
        "preset's name, and None"
    )
