"""Reference camera: PyBullet's TinyRenderer over meshes of the same shapes, in a physics client of its own.

It has no textures, so its pictures differ from the caster's in colour; depth and segments agree to about a pixel
(measured by `benchmarks/camera.py`).
"""

import math
import threading
from functools import cache
from typing import Any

import numpy as np

from zsdist.config import CameraConfig
from zsdist.sim.bullet import Client, pybullet
from zsdist.sim.camera.appearance import Appearance, of_scene
from zsdist.sim.camera.caster import Look
from zsdist.sim.camera.optics import mount
from zsdist.sim.camera.primitives import Form, Primitives, primitives_of
from zsdist.sim.scenes.kinds import SEGMENT_GROUND, SEGMENT_SKY
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose

_NEAR_M, _FAR_M = 0.05, 100.0
_SIDES = 48  # sides of a round shape: its chords stay within 0.3% of the radius
_RINGS = 16
_GROUND_HALF_M = 60.0
_GROUND_TILES = 6  # tiles per side
Mesh = tuple[np.ndarray, np.ndarray]  # vertices (V, 3) and triangles (T, 3)
_lists_in_use = threading.Lock()


class TinyCamera:
    """Camera that draws with PyBullet; arguments and results are those of `CasterCamera`.

    The client is started for the first picture. It holds the shapes of one scene at a time; another scene replaces
    them. A copy has a client of its own.

    Attributes:
        config: resolution, field of view and mount.
    """

    def __init__(self, config: CameraConfig, look: Look = of_scene) -> None:
        self.config = config
        self._look = look
        self._connection: Client | None = None
        self._closed = False
        self._scene: Scene | None = None
        size, fov = config.size_px, config.field_of_view_deg
        self._size = size
        projection = list(pybullet.computeProjectionMatrixFOV(fov, 1.0, _NEAR_M, _FAR_M))
        # TinyRenderer samples a pixel at its corner; a shift by half a pixel makes that its centre.
        projection[8], projection[9] = 1 / size, 1 / size
        self._projection = projection

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.config, self._look)

    def render(
        self, scene: Scene, pose: Pose, roll_rad: float = 0.0, pitch_rad: float = 0.0, people: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the picture; see `CasterCamera.render`."""
        return self.render_labelled(scene, pose, roll_rad, pitch_rad, people)[0]

    def render_labelled(
        self, scene: Scene, pose: Pose, roll_rad: float = 0.0, pitch_rad: float = 0.0, people: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return picture, depth and segments; see `CasterCamera.render_labelled`."""
        if self._closed:
            raise RuntimeError("the camera is closed; make another one")
        if scene is not self._scene:
            self._build(scene)
        self._place(self._primitives.rows_at(people))
        origin, axes = mount(pose, self.config.forward_m, self.config.height_m, roll_rad, pitch_rad)
        view = pybullet.computeViewMatrix(origin, origin + axes[0], axes[2])
        light = self._appearance.light
        _, _, colours, buffer, bodies = pybullet.getCameraImage(
            self._size, self._size, view, self._projection, lightDirection=light[:3].tolist(),
            lightAmbientCoeff=float(light[3]), lightDiffuseCoeff=float(light[4]), lightSpecularCoeff=0.0,
            shadow=0,  # in every call, since shadows stay on once they are switched on
            renderer=pybullet.ER_TINY_RENDERER, physicsClientId=self._client,
        )  # fmt: skip
        shape = (self._size, self._size)
        bodies = np.reshape(bodies, shape)
        segments = self._segments[np.where(bodies < 0, -1, bodies)]
        buffer = np.reshape(np.asarray(buffer, np.float64), shape)
        depth = _FAR_M * _NEAR_M / (_FAR_M - (_FAR_M - _NEAR_M) * buffer)
        depth = np.where(bodies < 0, np.inf, depth).astype(np.float32)
        image = np.reshape(np.asarray(colours, np.uint8), (*shape, 4))[..., :3].copy()
        image[bodies < 0] = (self._appearance.sky[:3] * 255).astype(np.uint8)
        return image, depth, segments

    def close(self) -> None:
        """Disconnect the client; closing again does nothing."""
        self._closed = True
        self._scene = None
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _build(self, scene: Scene) -> None:
        self._scene = None  # until all shapes are there
        if self._connection is None:
            self._connection = Client()
            self._client = self._connection.number
        pybullet.resetSimulation(physicsClientId=self._client)
        self._primitives: Primitives = primitives_of(scene)
        self._appearance: Appearance = self._look(scene, self._primitives)
        ground = self._body(_ground_mesh(), self._appearance.ground[:3])
        self._bodies = [
            self._body(_mesh(form, row), material[:3])
            for form, row, material in zip(
                self._primitives.forms, self._primitives.rows, self._appearance.materials, strict=True
            )
        ]
        # The last entry is the sky: pixels without a body have the index -1.
        self._segments = np.full(max([ground, *self._bodies]) + 2, SEGMENT_SKY, np.uint8)
        self._segments[ground] = SEGMENT_GROUND
        self._segments[self._bodies] = self._primitives.segments
        self._scene = scene

    def _body(self, mesh: Mesh, colour: np.ndarray) -> int:
        vertices, triangles = mesh
        # Triangles share no corners, so that TinyRenderer shades each flat with its own normal.
        corners = vertices[triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        vertices_given, normals_given, indices = _lists(3 * len(corners))
        with _lists_in_use:
            _fill(vertices_given, corners.reshape(-1, 3))
            _fill(normals_given, np.repeat(normals, 3, axis=0))
            shape = pybullet.createVisualShape(
                pybullet.GEOM_MESH, vertices=vertices_given, indices=indices, normals=normals_given,
                rgbaColor=[*colour, 1.0], physicsClientId=self._client,
            )  # fmt: skip
        return pybullet.createMultiBody(0, -1, shape, physicsClientId=self._client)

    def _place(self, rows: np.ndarray) -> None:
        for body, row in zip(self._bodies, rows, strict=True):
            turn = (0.0, 0.0, math.sin(row[6] / 2), math.cos(row[6] / 2))
            pybullet.resetBasePositionAndOrientation(body, row[:3].tolist(), turn, physicsClientId=self._client)


@cache
def _lists(count: int) -> tuple[list[list[float]], list[list[float]], list[int]]:
    """Return lists for `count` vertices and normals, and their indices.

    PyBullet never releases the Python objects that it gets for a mesh, about 30 MiB a scene. So all meshes of a length
    are passed in the same objects, with other numbers.
    """
    return [[0.0] * 3 for _ in range(count)], [[0.0] * 3 for _ in range(count)], list(range(count))


def _fill(given: list[list[float]], rows: np.ndarray) -> None:
    for item, row in zip(given, rows.tolist(), strict=True):
        item[:] = row


def _mesh(form: int, row: np.ndarray) -> Mesh:
    """Return vertices and triangles of a primitive in its own frame; triangles are counter-clockwise from outside."""
    if form == Form.BOX:
        return _loft([(0.0, 1.0), (1.0, 1.0)], 4, (row[4] * math.sqrt(2), row[5] * math.sqrt(2), row[3]), math.pi / 4)
    if form == Form.FRUSTUM:
        return _loft([(0.0, row[4]), (row[3], row[5])], _SIDES, (1.0, 1.0, 1.0))
    angles = np.linspace(-math.pi / 2, math.pi / 2, _RINGS)
    return _loft([(math.sin(a), max(math.cos(a), 1e-6)) for a in angles], _SIDES, (row[3], row[4], row[5]))


def _loft(
    profile: list[tuple[float, float]], sides: int, scale: tuple[float, float, float], first: float = 0.0
) -> Mesh:
    """Return a mesh of rings of `sides` corners at each (z, radius) of the profile, joined, capped and scaled."""
    angles = first + np.arange(sides) * math.tau / sides
    rings = [np.stack([r * np.cos(angles), r * np.sin(angles), np.full(sides, z)], 1) for z, r in profile]
    ends = np.array([[0.0, 0.0, profile[0][0]], [0.0, 0.0, profile[-1][0]]])
    vertices = np.concatenate([*rings, ends]) * np.array(scale)
    here = np.arange(sides)
    there = (here + 1) % sides
    triangles = []
    for k in range(len(profile) - 1):
        low, high = k * sides, (k + 1) * sides
        triangles.append(np.stack([low + here, low + there, high + there], 1))
        triangles.append(np.stack([low + here, high + there, high + here], 1))
    bottom, top, last = len(vertices) - 2, len(vertices) - 1, (len(profile) - 1) * sides
    triangles.append(np.stack([np.full(sides, bottom), there, here], 1))
    triangles.append(np.stack([np.full(sides, top), last + here, last + there], 1))
    return vertices, np.concatenate(triangles)


def _ground_mesh() -> Mesh:
    """Return the ground as squares of two triangles each."""
    ticks = np.linspace(-_GROUND_HALF_M, _GROUND_HALF_M, _GROUND_TILES + 1)
    xs, ys = np.meshgrid(ticks, ticks)
    vertices = np.stack([xs.ravel(), ys.ravel(), np.zeros(xs.size)], 1)
    corner = (np.arange(_GROUND_TILES)[:, None] * (_GROUND_TILES + 1) + np.arange(_GROUND_TILES)).ravel()
    above = corner + _GROUND_TILES + 1
    return vertices, np.concatenate(
        [np.stack([corner, corner + 1, above + 1], 1), np.stack([corner, above + 1, above], 1)]
    )
