"""Words for what is to be seen: those trained on, those kept to choose by, those never used before the test.

A concept is a kind of obstacle, a ground, the arena's wall or the sky. Each has three lists of words that share no
noun but "sand". A projection learns from the first, choices are made by the second, and the third is for the final
figures alone, which therefore tell how it takes to words that nobody trained or tuned it with.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import safetensors
import safetensors.numpy

from zsdist.errors import WeightsError


class Words(NamedTuple):
    """Of one concept, by use; each with its article, as it stands in a sentence."""

    training: tuple[str, ...]
    validation: tuple[str, ...]
    test: tuple[str, ...]


KIND_WORDS: dict[str, Words] = {
    "tree": Words(
        ("a tree", "a pine", "a birch", "a maple", "a tree trunk", "a willow", "a tall tree", "woods", "a spruce",
         "a poplar", "a chestnut tree", "an apple tree", "a palm tree", "a larch", "a cedar", "a lime tree"),
        ("an elm", "a fir"),
        ("an oak", "a beech"),
    ),
    "person": Words(
        ("a person", "people", "a man", "a woman", "a human", "a child", "somebody walking", "a standing figure",
         "a lady", "a gentleman", "a worker", "a tourist", "a teenager", "a jogger", "an adult", "a stranger"),
        ("a passer-by", "a boy"),
        ("a pedestrian", "a girl"),
    ),
    "sand_pile": Words(
        ("a sand pile", "a pile of sand", "a mound of sand", "a sand hill", "a sandy mound", "a stack of sand",
         "a mound", "a pile of gravel", "a pile of earth", "a sand castle", "a mound of dirt", "an anthill"),
        ("a hillock", "a sandbank"),
        ("a dune", "a heap of sand"),
    ),
    "rock": Words(
        ("a rock", "a stone", "rocks", "a big stone", "a piece of granite", "a rough grey stone", "a limestone rock",
         "a piece of rock", "a mossy stone", "a lump of granite", "a meteorite", "a cliff", "a flint", "marble"),
        ("a cobble", "a slab of basalt"),
        ("a boulder", "a pebble"),
    ),
    "bush": Words(
        ("a bush", "bushes", "a hedge", "a thicket", "a leafy plant", "a green bush", "foliage", "a rose bush",
         "a fern", "a holly", "brushwood", "an evergreen hedge", "a currant bush", "a laurel", "ivy", "heather"),
        ("undergrowth", "a juniper"),
        ("a shrub", "a bramble"),
    ),
    "pole": Words(
        ("a pole", "a column", "a pillar", "a mast", "a flagpole", "a metal pole", "a signpost", "a traffic sign",
         "a rod", "a bar", "a telegraph pole", "a thin metal column", "a stick", "an antenna", "a bollard"),
        ("a stake", "a pylon"),
        ("a lamp post", "a street light"),
    ),
    "box": Words(
        ("a box", "a container", "a big box", "a cabinet", "a carton", "a chest", "a rectangular block",
         "a wooden box", "a cardboard box", "a cube", "a shipping container", "a wardrobe", "a locker", "a cupboard",
         "a building", "a shed"),
        ("a package", "a bin"),
        ("a crate", "a parcel"),
    ),
    "car": Words(
        ("a car", "a parked car", "a vehicle", "a sedan", "a taxi", "a van", "a motor vehicle", "a sports car",
         "a convertible", "a station wagon", "a pickup truck", "a jeep", "a police car", "a coupe", "a lorry"),
        ("a hatchback", "a limousine"),
        ("an automobile", "a minivan"),
    ),
}  # fmt: skip
GROUND_WORDS: dict[str, Words] = {
    "sand": Words(
        ("sand", "sandy ground", "a beach", "a desert", "a sandy surface"),
        ("the seashore",),
        ("a sandlot",),
    ),
    "grass": Words(
        ("grass", "a lawn", "a meadow", "green grass", "a grassy field"),
        ("turf",),
        ("a pasture",),
    ),
    "asphalt": Words(
        ("asphalt", "floor", "the floor", "a road", "pavement", "a hard grey surface"),
        ("tarmac",),
        ("a driveway",),
    ),
}
SURROUNDINGS_WORDS: dict[str, Words] = {
    "wall": Words(("a wall", "a brick wall", "a long wall", "a fence"), ("a rampart",), ("a barrier",)),
    "sky": Words(("the sky", "a blue sky", "a cloudy sky", "clouds"), ("the horizon",), ("the heavens",)),
}
WORDS: dict[str, Words] = KIND_WORDS | GROUND_WORDS | SURROUNDINGS_WORDS
CONCEPTS = tuple(WORDS)
"""Names of the concepts in the order of every array that has a column for each; the kinds come first."""

TABLE3_WORDS = {"tree": "tree", "person": "people", "asphalt": "floor", "sand": "sand", "grass": "grass"}
"""The objects of Table 3 of the paper as it names them, by the concept that is meant."""

_SIDES = {
    "left": ("on the left", "at the left", "to the left"),
    "ahead": ("ahead", "in front", "in the middle", "straight ahead"),
    "right": ("on the right", "at the right", "to the right"),
}
SIDES = tuple(_SIDES)
_PLACES = {
    "sand": ("on sand", "on sandy ground", "at a beach", "in a desert"),
    "grass": ("on grass", "on a lawn", "in a meadow", "on green grass"),
    "asphalt": ("on asphalt", "on a road", "on a grey floor", "on the pavement"),
}
_OPENINGS = ("", "", "a picture of ", "a photo of ", "there is ")
_EMPTY = ("nothing", "an empty place", "open ground", "free space")


def caption(seen: Sequence[tuple[str, str]], ground: str, rng: np.random.Generator) -> str:
    """A sentence for a whole picture, of training words alone.

    Args:
        seen: kinds with the side of the picture where each is (one of `SIDES`), the most important first.
        ground: a key of `GROUND_WORDS`.
        rng: chooses among the words that mean the same.
    """
    things = [f"{_choice(KIND_WORDS[kind].training, rng)} {_choice(_SIDES[side], rng)}" for kind, side in seen]
    joined = f"{', '.join(things[:-1])} and {things[-1]}" if len(things) > 1 else (things or [_choice(_EMPTY, rng)])[0]
    return f"{_choice(_OPENINGS, rng)}{joined} {_choice(_PLACES[ground], rng)}"


def _choice(options: Sequence[str], rng: np.random.Generator) -> str:
    return options[int(rng.integers(len(options)))]


@dataclass(frozen=True)
class Vocabulary:
    """Words with their embeddings, as a text tower gave them, so that the tower need not be loaded.

    Attributes:
        words: no two the same.
        embeddings: `(N, D)` float32 of unit length.
        text_sha256: of the weights of the tower.
    """

    words: tuple[str, ...]
    embeddings: np.ndarray
    text_sha256: str

    def __getitem__(self, word: str) -> np.ndarray:
        """Embedding `(D,)` of a word.

        Raises:
            WeightsError: it is not one of the words.
        """
        if word not in self.words:
            raise WeightsError(f"word {word!r} is not in the vocabulary of {len(self.words)}: it needs the text tower")
        return self.embeddings[self.words.index(word)]

    def rows(self, words: Sequence[str]) -> np.ndarray:
        """Embeddings `(len(words), D)` of words; raises `WeightsError` where one is missing."""
        return np.stack([self[word] for word in words])

    def to_bytes(self) -> bytes:
        """In the format of safetensors, the words in its metadata; the same bytes for the same content."""
        rows = np.ascontiguousarray(self.embeddings, "<f4")
        about = {
            "__metadata__": {"words": json.dumps(self.words), "text_sha256": self.text_sha256},
            "embeddings": {"dtype": "F32", "shape": rows.shape, "data_offsets": (0, rows.nbytes)},
        }
        header = json.dumps(about, sort_keys=True).encode()  # safetensors' own writer has no order of its metadata
        header += b" " * (-len(header) % 8)
        return len(header).to_bytes(8, "little") + header + rows.tobytes()

    @classmethod
    def from_bytes(cls, content: bytes) -> "Vocabulary":
        """What `to_bytes` gave.

        Raises:
            WeightsError: the content is damaged.
        """
        try:
            embeddings = safetensors.numpy.load(content)["embeddings"]
            length = int.from_bytes(content[:8], "little")
            about = json.loads(content[8 : 8 + length])["__metadata__"]
            words, digest = tuple(json.loads(about["words"])), about["text_sha256"]
        except (safetensors.SafetensorError, KeyError, ValueError, TypeError) as error:
            raise WeightsError(f"vocabulary is damaged: {' '.join(str(error).split())[:200]}") from error
        if embeddings.ndim != 2 or len(embeddings) != len(words):
            shape = embeddings.shape
            raise WeightsError(f"vocabulary has {len(words)} words, and embeddings {shape}; allowed is one for each")
        return cls(words, embeddings, digest)


def shipped_words() -> tuple[str, ...]:
    """The words a folder of weights holds: those of training, and those of Table 3."""
    words = [word for concept in WORDS.values() for word in concept.training] + list(TABLE3_WORDS.values())
    return tuple(dict.fromkeys(words))
