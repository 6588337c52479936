"""Captioned pictures for learning words: the contents of 14 x 14 cells of a picture, and a caption."""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from zsdist.common import random_streams
from zsdist.config import CameraConfig
from zsdist.datasets.degradation import degrade
from zsdist.datasets.sampling import drawn_scenes, free_pose, people_on_paths, varied_camera
from zsdist.sim.camera import make_camera
from zsdist.sim.scenes.kinds import KINDS, SEGMENT_GROUND, SEGMENT_SKY, SEGMENT_WALL
from zsdist.sim.scenes.manifest import Split
from zsdist.sim.scenes.scene import Scene
from zsdist.vision.words.vocabulary import CONCEPTS, SIDES, caption

CELLS = 14  # number of cells along a side, like the default encoder's tokens
CAPTION_SHARE = 0.02  # share of the picture that a kind must cover to be in the caption
MOST_CAPTIONED = 3  # most kinds in a caption
DOMINANT_SHARE = 0.06  # share of the picture that the dominant kind must cover
DOMINANT_TIMES = 2.0  # the dominant kind must also cover this many times as much as any other kind
_NATURAL_SHARE = 0.75  # share of varied cameras with natural colours, almost the only difference between grounds
_TILT_JITTER_RAD = 0.05


@dataclass(frozen=True)
class CaptionedView:
    """Picture and its contents for C concepts in the order of `vocabulary.CONCEPTS`.

    Attributes:
        image: `(size_px, size_px, 3)` uint8.
        cells: `(14, 14, C)` float16, share of each cell that shows the concept; the shares of a cell sum to 1.
        caption: caption of the whole picture, in training words.
        dominant: index of the dominant kind (`dominant_kind`); -1: none.
        ground: index of the concept of the ground.
        scene: name of the scene.
        scene_hash: `Scene.hash()`; it groups the pictures of one scene.
    """

    image: np.ndarray
    cells: np.ndarray
    caption: str
    dominant: int
    ground: int
    scene: str
    scene_hash: str


def captioned_views(
    families: Sequence[str], split: Split, count: int, seed: int, camera: CameraConfig, varied: bool = False
) -> Iterator[CaptionedView]:
    """Yield captioned pictures, the same for the same arguments. Families alternate; a scene gives several pictures.

    Args:
        families: names of families in `families.FAMILIES`.
        split: range of the families' seeds for the scenes; an unknown one raises `SceneError`.
        count: number of pictures.
        seed: seed of scenes, poses, appearance and captions.
        camera: resolution, field of view, mount and range.
        varied: whether mount, tilt and picture quality are random, and the colours of one camera in four (for
            training); else scenes have the appearance of a drive.
    """
    rng = random_streams.captioned_pictures(seed, split)
    for _, scene, number in drawn_scenes(families, split, count, rng):
        yield from _views_of(scene, number, rng, camera, varied)


def describe(segments: np.ndarray, ground: str, rng: np.random.Generator) -> tuple[np.ndarray, str, int]:
    """Return `cells`, `caption` and `dominant` of a `CaptionedView` from a segmentation image.

    Args:
        segments: `(size_px, size_px)` uint8 from a camera.
        ground: name of the scene's ground.
        rng: source of the choice of words.
    """
    concepts = _concept_of_segment(ground)[segments]
    cells = cell_shares(concepts, CELLS)
    kinds = cells[:, :, : len(KINDS)].mean((0, 1))
    captioned = [kind for kind in np.argsort(-kinds) if kinds[kind] >= CAPTION_SHARE][:MOST_CAPTIONED]
    seen = [(CONCEPTS[kind], _side(cells[:, :, kind])) for kind in captioned]
    return cells.astype(np.float16), caption(seen, ground, rng), dominant_kind(kinds)


def cell_shares(concepts: np.ndarray, side: int) -> np.ndarray:
    """Return the share of each concept in each of `side` x `side` cells, `(side, side, C)` float32.

    Args:
        concepts: `(px, px)` int64, index of the concept at each pixel; px is `side` or more.
        side: number of cells along a side.
    """
    cell = np.arange(len(concepts)) * side // len(concepts)
    numbers = (cell[:, None] * side + cell) * len(CONCEPTS) + concepts
    counts = np.bincount(numbers.ravel(), minlength=side * side * len(CONCEPTS)).reshape(side, side, len(CONCEPTS))
    return (counts / counts.sum(-1, keepdims=True)).astype(np.float32)


def dominant_kind(shares: np.ndarray) -> int:
    """Return the index of the dominant kind, from the shares `(kinds,)` of the picture that each covers; -1: none."""
    second, first = np.argsort(shares)[-2:]
    return int(first) if shares[first] >= max(DOMINANT_SHARE, DOMINANT_TIMES * shares[second]) else -1


def _views_of(
    scene: Scene, count: int, rng: np.random.Generator, config: CameraConfig, varied: bool
) -> Iterator[CaptionedView]:
    with contextlib.closing(varied_camera(config, rng, _NATURAL_SHARE) if varied else make_camera(config)) as camera:
        for _ in range(count):
            people = people_on_paths(scene, rng)
            pose = free_pose(scene, rng, people)
            roll, pitch = rng.uniform(-_TILT_JITTER_RAD, _TILT_JITTER_RAD, 2) if varied else (0.0, 0.0)
            image, _, segments = camera.render_labelled(scene, pose, roll, pitch, people)
            cells, sentence, dominant = describe(segments, scene.ground, rng)
            yield CaptionedView(
                image=degrade(image, rng) if varied else image,
                cells=cells,
                caption=sentence,
                dominant=dominant,
                ground=CONCEPTS.index(scene.ground),
                scene=scene.name,
                scene_hash=scene.hash(),
            )


def _concept_of_segment(ground: str) -> np.ndarray:
    """Return the index of the concept of each segment number, `(256,)`, in a scene with this ground."""
    table = np.zeros(256, np.int64)
    table[[SEGMENT_SKY, SEGMENT_GROUND, SEGMENT_WALL]] = [CONCEPTS.index(name) for name in ("sky", ground, "wall")]
    for kind in KINDS.values():
        table[kind.segment_id] = CONCEPTS.index(kind.name)
    return table


def _side(shares: np.ndarray) -> str:
    """Return the third of the picture with a kind's centre (one of `SIDES`), from its share of each cell `(14, 14)`."""
    columns = shares.sum(0)
    middle = float((columns * (np.arange(CELLS) + 0.5)).sum() / columns.sum()) / CELLS
    return SIDES[min(int(3 * middle), 2)]
