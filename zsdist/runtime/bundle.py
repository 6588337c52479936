"""Bundle of an exported policy: its files, their hashes, and the manifest that says what they mean."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from zsdist.common.section import Section
from zsdist.config import Config, GridConfig
from zsdist.planning.grid import Grid
from zsdist.types import Level

FORMAT = 1
MANIFEST_FILE = "manifest.json"
VISION_FILE = "vision.onnx"
NETWORK_FILES = {Level.HIGH: "high.onnx", Level.LOW: "low.onnx"}
PARITY_FILE = "parity.safetensors"
CARD_FILE = "README.md"
FILES = (VISION_FILE, *NETWORK_FILES.values(), PARITY_FILE, CARD_FILE)
"""Files of a bundle beside its manifest, which has the hash of each."""

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class BundleCamera(Section):
    """Camera that the policy expects: a pinhole without distortion, level, looking along the robot's heading.

    Attributes:
        width_px: width of a picture.
        height_px: height of a picture, equal to the width.
        field_of_view_deg: horizontal and vertical angle.
        height_m: height of the lens above the ground.
        forward_m: distance of the lens ahead of the robot's centre.
        range_m: range of vision; what is farther counts as free.
        encoding: layout of a pixel.
    """

    width_px: int
    height_px: int
    field_of_view_deg: float
    height_m: float
    forward_m: float
    range_m: float
    encoding: Literal["rgb8"] = "rgb8"


class BundleFootprint(Section):
    """Box that the policy keeps free of obstacles, around the robot's centre and along its heading.

    Attributes:
        length_m: length of the robot.
        width_m: width of the robot.
        margin_m: margin on every side.
    """

    length_m: float
    width_m: float
    margin_m: float


class BundleAction(Section):
    """One action: a turn in place, then an advance.

    Attributes:
        name: name of the action, as in `zsdist.types.Action`.
        turn_deg: turn, counter-clockwise positive.
        forward_m: advance after the turn, along an axis of the grid.
        forward_diagonal_m: the same advance along a diagonal.
    """

    name: str
    turn_deg: float
    forward_m: float
    forward_diagonal_m: float


class GraphPort(Section):
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


class BundleGraph(Section):
    """Network of a bundle, an ONNX file."""

    file: str
    inputs: tuple[GraphPort, ...]
    outputs: tuple[GraphPort, ...]


class BundleManifest(Section):
    """Content of `manifest.json`."""

    format: Literal[1] = 1
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
    settings: dict[str, Any]
    limits: dict[str, float]
    trained_on: dict[str, Any]
    evaluated: dict[str, Any]


@dataclass(frozen=True)
class Bundle:
    """Bundle in a folder, whose files have been checked.

    Attributes:
        folder: folder of the files.
        manifest: content of `manifest.json`.
    """

    folder: Path
    manifest: BundleManifest

    @classmethod
    def load(cls, folder: Path) -> "Bundle":
        """Return the bundle in a folder, with the hash of every file checked.

        Raises:
            BundleError: the folder or a file is missing, damaged, or of another version of the format or of zsdist.
        """
        raise NotImplementedError

    @property
    def camera(self) -> BundleCamera:
        """Camera that the policy expects."""
        return self.manifest.camera

    @property
    def footprint(self) -> BundleFootprint:
        """Box that the policy keeps free."""
        return self.manifest.footprint

    @property
    def actions(self) -> tuple[BundleAction, ...]:
        """Actions, in the order of `zsdist.types.Action`."""
        return self.manifest.actions

    @cached_property
    def config(self) -> Config:
        """Configuration that the policy drives under; sections without influence on a decision have their defaults."""
        raise NotImplementedError

    @cached_property
    def grid(self) -> Grid:
        """Planning grid, in the middle of the arena."""
        return Grid.from_config(self.config.grid)
