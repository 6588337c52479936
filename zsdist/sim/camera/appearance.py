"""Appearance of a scene: colours, textures, ground, sky and sun.

`of_scene` gives the appearance in which the car drives, always the same for the same scene. `varied` is for training
pictures: anything may have any colour, any texture and any ground, so that a network must learn from shape and position
rather than from colour.
"""

import colorsys
import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from zsdist.sim.camera.primitives import ARENA_HALF_M, Part, Primitives
from zsdist.sim.scenes.families_layout import ROAD_HALF_M, Road, road_of
from zsdist.sim.scenes.kinds import GROUNDS, KINDS, WALL_COLOUR
from zsdist.sim.scenes.scene import Obstacle, Scene


class Texture(IntEnum):
    """Texture of a surface."""

    PLAIN = 0
    BARK = 1  # noise stretched along the vertical
    BRICK = 2
    WINDOWS = 3
    BANDS = 4


class Pattern(IntEnum):
    """Pattern of the ground, drawn over its noise."""

    NONE = 0
    TILES = 1
    STRIPES = 2
    CHECKER = 3
    LANES = 4
    KERBS = 5  # a road with lanes, its kerbs and pavements beyond


@dataclass(frozen=True)
class Appearance:
    """Parameters of the shading; colours are in 0 to 1.

    Attributes:
        materials: `(P, 11)`, a row for each primitive: colour (3), second colour (3), `Texture`, strength of its noise,
            size of a noise texel in metres, offset of the texture in metres, period of its figure in metres.
        ground: `(19,)` colour (3), second colour of the patches (3), `Pattern`, strength of the noise, texel in metres,
            period in metres, cosine and sine of the pattern's direction, contrast of the patches, strength of the
            pattern, colour of the pattern (3), and for `Pattern.KERBS` the distance in metres of the road's middle to
            the left of the origin and half the road's width in metres.
        sky: `(7,)`: colour at the horizon (3), colour overhead (3), amount of cloud.
        light: `(7,)`: unit direction to the sun (3), ambient light, sunlight, distance in metres at which haze is one
            half, gain of the camera.
    """

    materials: np.ndarray
    ground: np.ndarray
    sky: np.ndarray
    light: np.ndarray


_SURFACES: dict[str, tuple[Texture, float, float]] = {  # texture, noise strength, texel in metres
    "tree": (Texture.BARK, 0.5, 0.01),
    "person": (Texture.PLAIN, 0.15, 0.01),
    "sand_pile": (Texture.PLAIN, 0.25, 0.008),
    "rock": (Texture.PLAIN, 0.5, 0.01),
    "bush": (Texture.PLAIN, 0.9, 0.02),
    "pole": (Texture.PLAIN, 0.12, 0.01),
    "box": (Texture.PLAIN, 0.2, 0.01),
    "car": (Texture.PLAIN, 0.06, 0.02),
}
_CROWN: tuple[tuple[float, float, float], float, float] = ((0.22, 0.40, 0.14), 0.9, 0.04)
_PLAIN_SHARE = 0.25  # share of varied appearances without any texture, as in plain renderers
_GLASS = (0.10, 0.13, 0.16)
_SKIN = (0.72, 0.54, 0.43)
_TROUSERS = (0.18, 0.20, 0.28)
_LIGHT = 1.4  # sunlight and ambient light together
_DISGUISED_SHARE = 0.7  # share of the obstacles of a disguised scene that have the colours of the ground
_ROAD_SHARE = 0.6  # share of varied appearances of a street that show its road; the rest have any ground
_PAVEMENT = (0.78, 0.77, 0.74)
_STREET_FURNITURE_M = 1.2  # boxes higher than this get bricks or windows


def of_scene(scene: Scene, primitives: Primitives) -> Appearance:
    """Return the natural appearance of a scene, drawn from its hash: colours and surfaces near those of each kind."""
    rng = np.random.default_rng(int(scene.hash(), 16))
    obstacles = [_natural_materials(obstacle, rng) for obstacle in scene.obstacles]
    wall = _material(_near(WALL_COLOUR, rng, 0.02, 0.1), Texture.BRICK, 0.2, 0.012, rng)
    materials = [
        wall if owner < 0 else obstacles[owner].get(part, obstacles[owner][Part.BODY])
        for owner, part in zip(primitives.owners, primitives.parts, strict=True)
    ]
    ground = GROUNDS[scene.ground]
    colour = _near(ground.base_colour, rng, 0.02, 0.12)
    second = _near(ground.base_colour, rng, 0.05, 0.25)
    pattern = Pattern.LANES if scene.ground == "asphalt" and rng.random() < 0.5 else Pattern.NONE
    ground_row = _ground(colour, second, pattern, ground.roughness, rng, (0.85, 0.85, 0.82))
    sky, light = _sky(rng), _light(rng, (0.4, 0.6), 0.1)
    road = road_of(scene)
    if road is not None:
        ground_row = _with_road(ground_row, road, _near(_PAVEMENT, rng, 0.03, 0.15))
    return Appearance(np.array(materials), ground_row, sky, light)


def varied(scene: Scene, primitives: Primitives, rng: np.random.Generator) -> Appearance:
    """Return a random appearance: in half of the cases mostly the kinds' own colours, else any colour and texture."""
    natural = rng.random() < 0.5
    obstacles = [
        _natural_materials(obstacle, rng) if natural and rng.random() < 0.8 else _random_materials(rng)
        for obstacle in scene.obstacles
    ]
    wall = _random_materials(rng)[Part.BODY]
    materials = np.array(
        [
            wall if owner < 0 else obstacles[owner].get(part, obstacles[owner][Part.BODY])
            for owner, part in zip(primitives.owners, primitives.parts, strict=True)
        ]
    )
    base = GROUNDS[scene.ground].base_colour if natural else _random_colour(rng)
    colour, second = _near(base, rng, 0.08, 0.25), _near(base, rng, 0.15, 0.4)
    pattern = Pattern(int(rng.integers(len(Pattern))))
    ground = _ground(colour, second, pattern, rng.uniform(0.1, 1.0), rng, _random_colour(rng))
    ground[17:] = rng.uniform(-ARENA_HALF_M, ARENA_HALF_M), rng.uniform(*ROAD_HALF_M)
    road = road_of(scene)
    if road is not None and rng.random() < _ROAD_SHARE:
        ground = _with_road(ground, road, _near(_PAVEMENT, rng, 0.05, 0.3) if natural else _random_colour(rng))
    sky = _sky(rng)
    if not natural:
        sky[:6] = np.clip(sky[:6] * np.tile(rng.uniform(0.5, 1.2, 3), 2), 0, 1)
    if rng.random() < _PLAIN_SHARE:
        materials[:, 6:8] = Texture.PLAIN, 0.0
        ground[6:8], ground[12], sky[6] = (Pattern.NONE, 0.0), 0.0, 0.0
    return Appearance(materials, ground, sky, _light(rng, (0.35, 0.8), 0.25))


def disguised(appearance: Appearance, primitives: Primitives, rng: np.random.Generator) -> Appearance:
    """Return an appearance in which most obstacles have about the colours of the ground, and no figure of their own."""
    materials = appearance.materials.copy()
    for owner in np.unique(primitives.owners):
        if rng.random() < _DISGUISED_SHARE:
            rows = primitives.owners == owner
            ground = appearance.ground[:3], appearance.ground[3:6]
            materials[rows, :3], materials[rows, 3:6] = (_near(tuple(colour), rng, 0.03, 0.12) for colour in ground)
            materials[rows, 6] = Texture.PLAIN
    return Appearance(materials, appearance.ground, appearance.sky, appearance.light)


def _natural_materials(obstacle: Obstacle, rng: np.random.Generator) -> dict[Part, np.ndarray]:
    """Return a row of `materials` for each part of an obstacle, with colours near its kind's base colour."""
    kind = KINDS[obstacle.kind]
    texture, noise, texel = _SURFACES[kind.name]
    if kind.name == "box" and obstacle.height_m > _STREET_FURNITURE_M:
        texture = Texture(rng.choice([Texture.PLAIN, Texture.BRICK, Texture.WINDOWS]))
    if kind.name == "pole" and rng.random() < 0.3:
        texture = Texture.BANDS
    painted = kind.name in ("person", "car")  # clothes and paint have any hue
    colour = _random_colour(rng) if painted else _near(kind.base_colour, rng, 0.04, 0.2)
    parts = {Part.BODY: _material(colour, texture, noise, texel, rng)}
    if kind.shape == "tree":
        parts[Part.TOP] = _material(_near(_CROWN[0], rng, 0.05, 0.2), Texture.PLAIN, _CROWN[1], _CROWN[2], rng)
    elif kind.shape == "car":
        parts[Part.TOP] = _material(_near(_GLASS, rng, 0.02, 0.1), Texture.PLAIN, 0.05, texel, rng)
    elif kind.shape == "capsule":
        parts[Part.TOP] = _material(_near(_SKIN, rng, 0.02, 0.3), Texture.PLAIN, 0.1, texel, rng)
        parts[Part.LEGS] = _material(_near(_TROUSERS, rng, 0.3, 0.3), Texture.PLAIN, 0.15, texel, rng)
    return parts


def _random_materials(rng: np.random.Generator) -> dict[Part, np.ndarray]:
    return {
        part: _material(_random_colour(rng), texture, rng.uniform(0, 0.9), rng.uniform(0.006, 0.03), rng)
        for part, texture in zip(Part, rng.choice(list(Texture), len(Part)), strict=True)
    }


def _material(
    colour: tuple[float, ...], texture: Texture, noise: float, texel_m: float, rng: np.random.Generator
) -> np.ndarray:
    """Return a row of `Appearance.materials` with random details."""
    second = _near(_GLASS, rng, 0.05, 0.2) if texture == Texture.WINDOWS else _near(colour, rng, 0.05, 0.35)
    if texture == Texture.BANDS:
        second = _random_colour(rng)
    return np.array([*colour, *second, texture, noise, texel_m, rng.uniform(0, 10), rng.uniform(0.4, 1.6)])


def _ground(
    colour: tuple[float, ...],
    second: tuple[float, ...],
    pattern: Pattern,
    roughness: float,
    rng: np.random.Generator,
    figure: tuple[float, ...],
) -> np.ndarray:
    """Return `Appearance.ground` with random details; `figure` is the colour of the pattern."""
    angle = rng.uniform(0, math.pi)
    texel, period = rng.uniform(0.007, 0.015), rng.uniform(0.5, 3.0)
    return np.array(
        [*colour, *second, pattern, 0.15 + 0.4 * roughness, texel, period, math.cos(angle), math.sin(angle),
         rng.uniform(0.2, 0.8), rng.uniform(0.3, 0.9), *figure, 0.0, 0.0]
    )  # fmt: skip


def _with_road(ground: np.ndarray, road: Road, pavement: tuple[float, ...]) -> np.ndarray:
    """Return a copy of `Appearance.ground` with the kerbs of a road."""
    result = ground.copy()
    # If the road leads along y, the pattern's left is west, where x is negative.
    direction, left_m = ((1.0, 0.0), road.middle_m) if road.along_x else ((0.0, 1.0), -road.middle_m)
    result[6], result[10:12], result[14:17], result[17:] = Pattern.KERBS, direction, pavement, (left_m, road.half_m)
    return result


def _sky(rng: np.random.Generator) -> np.ndarray:
    overcast = rng.random()
    zenith = np.array([0.25, 0.45, 0.80]) * (1 - overcast) + 0.68 * overcast
    horizon = np.array([0.75, 0.84, 0.93]) * (1 - overcast) + 0.80 * overcast
    return np.array([*horizon, *zenith, rng.uniform(0, 1.5)])


def _light(rng: np.random.Generator, ambient: tuple[float, float], gain: float) -> np.ndarray:
    azimuth, height = rng.uniform(0, math.tau), rng.uniform(0.5, 1.2)
    sun = (math.cos(height) * math.cos(azimuth), math.cos(height) * math.sin(azimuth), math.sin(height))
    shade = rng.uniform(*ambient)
    return np.array([*sun, shade, _LIGHT - shade, rng.uniform(40, 150), rng.uniform(1 - gain, 1 + gain)])


def _random_colour(rng: np.random.Generator) -> tuple[float, float, float]:
    return colorsys.hsv_to_rgb(rng.random(), rng.random() ** 1.5, rng.uniform(0.2, 0.95))


def _near(colour: tuple[float, ...], rng: np.random.Generator, hue: float, rest: float) -> tuple[float, float, float]:
    """Return a colour whose hue differs by up to `hue` turns, saturation and value by up to the share `rest`."""
    h, s, v = colorsys.rgb_to_hsv(*colour)
    return colorsys.hsv_to_rgb(
        (h + rng.uniform(-hue, hue)) % 1.0,
        min(s * (1 + rng.uniform(-rest, rest)), 1.0),
        min(v * (1 + rng.uniform(-rest, rest)), 1.0),
    )
