"""Kinds of obstacles and grounds: shape, size and colour, for physics and cameras.

An obstacle's collision shape is an upright cylinder or box, from the ground to its height. The drawn shape is the same
at the ground, so that the car hits what the camera shows. Only parts below `SIGHT_HEIGHT_M` count as obstacles, so a
tree's crown does not.
"""

from dataclasses import dataclass
from typing import Literal

Colour = tuple[float, float, float]
Shape = Literal["cylinder", "sphere", "cone", "tree", "capsule", "box", "car"]

SIGHT_HEIGHT_M = 1.5  # rays ignore parts above it
WALL_HEIGHT_M = 2.0  # height of the arena's walls
WALL_COLOUR: Colour = (0.62, 0.60, 0.57)

SEGMENT_SKY = 0
SEGMENT_GROUND = 1
SEGMENT_WALL = 2  # the arena's walls


@dataclass(frozen=True)
class Kind:
    """One kind of obstacle.

    Attributes:
        name: name in scene files.
        height_m: height of the drawn body; boxes and cars have the height of their `size_m` instead.
        default_radius_m: radius at the ground (Table 1 of the paper: 1 m); None for kinds with a `size_m`.
        shape: drawn shape. `cylinder`; `sphere`: half an ellipsoid that stands on the ground with semi-axes
            `(radius, radius, height)`; `cone`: a frustum with `radius` at the ground and `TOP_SHARE` of it at the top;
            `tree`: a trunk cylinder of `radius` up to `TRUNK_HEIGHT_M` and a wider crown above; `capsule`: an upright
            body of `radius`; `box`; `car`: a box with a cabin.
        dynamic: whether obstacles of the kind may move.
        base_colour: red, green, blue in 0 to 1; the camera varies it from scene to scene.
        segment_id: number in segmentation images.
    """

    name: str
    height_m: float
    default_radius_m: float | None
    shape: Shape
    dynamic: bool
    base_colour: Colour
    segment_id: int

    @property
    def round(self) -> bool:
        """True if the collision shape is a circle (`radius_m`) instead of an oriented box (`size_m`)."""
        return self.default_radius_m is not None


@dataclass(frozen=True)
class Ground:
    """One kind of ground: `name` as in scene files, `base_colour` in 0 to 1, `roughness` of its texture in 0 to 1."""

    name: str
    base_colour: Colour
    roughness: float


TOP_SHARE = 0.8  # ratio of a frustum's top radius to its base radius: steep, so that picture and collision agree
TRUNK_HEIGHT_M = 2.2
CROWN_SHARE = 1.4  # ratio of a crown's radius to the trunk's

KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind("tree", 4.5, 1.0, "tree", False, (0.36, 0.25, 0.15), 3),
        Kind("person", 1.75, 0.3, "capsule", True, (0.70, 0.30, 0.25), 4),
        Kind("sand_pile", 0.9, 1.0, "cone", False, (0.78, 0.66, 0.42), 5),
        Kind("rock", 1.0, 1.0, "sphere", False, (0.45, 0.44, 0.43), 6),
        Kind("bush", 1.2, 1.0, "sphere", False, (0.20, 0.42, 0.16), 7),
        Kind("pole", 3.5, 0.15, "cylinder", False, (0.55, 0.57, 0.60), 8),
        Kind("box", 2.0, None, "box", False, (0.65, 0.55, 0.48), 9),
        Kind("car", 1.5, None, "car", False, (0.25, 0.33, 0.60), 10),
    )
}

GROUNDS: dict[str, Ground] = {
    ground.name: ground
    for ground in (
        Ground("sand", (0.80, 0.71, 0.52), 0.5),
        Ground("grass", (0.33, 0.48, 0.22), 0.8),
        Ground("asphalt", (0.33, 0.33, 0.35), 0.3),
    )
}
