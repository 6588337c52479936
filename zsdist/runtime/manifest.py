"""Content of a bundle's `manifest.json`: the contract between an exported policy and whoever runs it."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from zsdist import config
from zsdist.config import Config, GridConfig

FORMAT: Literal[1] = 1
DECISIVE = {  # settings on which a decision depends, beside camera and grid
    "sim": ("max_steps", "success_radius_m"),
    "vision": ("network", "rays", "ray_quantile"),
    "agent": None,  # all of them
}

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Length = Annotated[float, Field(gt=0, le=1000)]
Pixels = Annotated[int, Field(ge=32, le=4096)]


class ManifestPart(BaseModel):
    """Part of a manifest, frozen; an entry that it does not know is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class BundleCamera(ManifestPart):
    """Camera that the policy expects: a pinhole without distortion, level, looking along the robot's heading.

    Attributes:
        width_px: width of a picture.
        height_px: height of a picture, equal to the width.
        field_of_view_deg: horizontal and vertical angle.
        focal_px: focal length of a picture of this size.
        centre_px: principal point, columns from the left and rows from the top; the first pixel's centre is at 0.5.
        height_m: height of the lens above the ground.
        forward_m: distance of the lens ahead of the robot's centre.
        range_m: range of vision; what is farther counts as free.
        encoding: layout of a pixel.
    """

    width_px: Pixels
    height_px: Pixels
    field_of_view_deg: Annotated[float, Field(ge=30, le=120)]
    focal_px: Annotated[float, Field(gt=0)]
    centre_px: tuple[float, float]
    height_m: Length
    forward_m: Annotated[float, Field(ge=-100, le=100)]
    range_m: Length
    encoding: Literal["rgb8"] = "rgb8"


class BundleFootprint(ManifestPart):
    """Box that the policy keeps free of obstacles, around the robot's centre and along its heading.

    Attributes:
        length_m: length of the robot.
        width_m: width of the robot.
        margin_m: margin on every side.
    """

    length_m: Length
    width_m: Length
    margin_m: Annotated[float, Field(ge=0, le=10)]


class BundleAction(ManifestPart):
    """One action: a turn in place, then an advance.

    Attributes:
        name: name of the action, as in `zsdist.types.Action`.
        turn_deg: turn, counter-clockwise positive.
        forward_m: advance after the turn, along an axis of the grid.
        forward_diagonal_m: the same advance along a diagonal of the grid.
    """

    name: str
    turn_deg: float
    forward_m: float
    forward_diagonal_m: float


class GraphPort(ManifestPart):
    """Input or output of a network.

    Attributes:
        name: name in the ONNX file.
        shape: sizes of the axes; "batch" may be any.
        dtype: type of the values, as numpy names it.
        unit: unit of the values; empty: none.
        meaning: what the values are, in order.
    """

    name: str
    shape: tuple[int | str, ...]
    dtype: str
    unit: str
    meaning: str


class BundleGraph(ManifestPart):
    """Network of a bundle, an ONNX file.

    Attributes:
        file: name of the file.
        normalisation: what is done to the input inside the network, and what must be done before.
        inputs: inputs of the network.
        outputs: outputs of the network.
    """

    file: str
    normalisation: str
    inputs: tuple[GraphPort, ...]
    outputs: tuple[GraphPort, ...]


class BundleLimits(ManifestPart):
    """Limits within which the policy was trained; a robot that exceeds them is outside of what was tried.

    Attributes:
        max_steps: actions after which an attempt counts as failed.
        success_radius_m: distance to the goal at which it is reached.
        speed_mps: greatest speed of the simulated car.
    """

    max_steps: Annotated[int, Field(ge=1)]
    success_radius_m: Length
    speed_mps: Length


class BundleManifest(ManifestPart):
    """Content of `manifest.json`.

    Attributes:
        format: version of this layout.
        name: name of the policy.
        zsdist: version of zsdist that made the bundle, which must be the one that runs it.
        weights_sha256: hash of both Q-networks, as `zsdist evaluate --json` reports it.
        files: SHA-256 of every other file.
        vision: names and hashes of the encoder and of the network on it.
        camera: camera that the policy expects.
        frames: meaning of each frame of coordinates.
        grid: planning grid, in the middle of the arena.
        footprint: box that the policy keeps free.
        actions: actions, in the order of the outputs of the low-level network.
        graphs: networks, by name.
        settings: settings on which a decision depends, by section, as in a configuration.
        limits: limits within which the policy was trained.
        trained_on: what the policy was trained on.
        evaluated: success on test scenes by the name of the scenes, with 95% intervals.
    """

    format: Literal[1]
    name: str
    zsdist: str
    weights_sha256: Sha256
    files: dict[str, Sha256]
    vision: dict[str, str]
    camera: BundleCamera
    frames: dict[str, str]
    grid: GridConfig
    footprint: BundleFootprint
    actions: tuple[BundleAction, ...]
    graphs: dict[str, BundleGraph]
    settings: dict[str, dict[str, Any]]
    limits: BundleLimits
    trained_on: dict[str, Any]
    evaluated: dict[str, dict[str, Any]]


def decisive_settings(settings: Config) -> dict[str, dict[str, Any]]:
    """Return the settings of a configuration on which a decision depends, by section."""
    whole = settings.model_dump(mode="json")
    return {
        section: whole[section] if names is None else {name: whole[section][name] for name in names}
        for section, names in DECISIVE.items()
    }


def configuration(manifest: BundleManifest) -> Config:
    """Return a configuration under which a policy decides as in the one that it was exported from.

    Raises:
        ConfigError: a setting is not allowed.
    """
    camera = manifest.camera
    return config.parse(
        {
            **manifest.settings,
            "grid": manifest.grid.model_dump(),
            "camera": {
                "size_px": camera.width_px,
                "field_of_view_deg": camera.field_of_view_deg,
                "range_m": camera.range_m,
                "height_m": camera.height_m,
                "forward_m": camera.forward_m,
            },
        }
    )
