"""Words for the contents of pictures, in lists for training, validation and test.

A concept is a kind of obstacle, a ground, the arena's wall or the sky. Each has three lists of words that share no
noun but "sand". A projection learns from the first list, settings are chosen with the second, and the third is only for
the final figures, which therefore measure words that were used neither in training nor in tuning.
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
    """Words of one concept by use, with their articles, as in a sentence."""

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
"""Names of the concepts in the order of all arrays with a column per concept; the kinds come first."""

TABLE3_WORDS = {"tree": "tree", "person": "people", "asphalt": "floor", "sand": "sand", "grass": "grass"}
"""Words of the objects in Table 3 of the paper, by concept."""

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
    """Return a sentence for a whole picture, made of training words only.

    Args:
        seen: kinds with the side of the picture where each is (one of `SIDES`), the most important first.
        ground: name of the ground, a key of `GROUND_WORDS`.
        rng: source of the choice among synonyms.
    """
    parts = [f"{_choice(KIND_WORDS[kind].training, rng)} {_choice(_SIDES[side], rng)}" for kind, side in seen]
    joined = f"{', '.join(parts[:-1])} and {parts[-1]}" if len(parts) > 1 else (parts or [_choice(_EMPTY, rng)])[0]
    return f"{_choice(_OPENINGS, rng)}{joined} {_choice(_PLACES[ground], rng)}"


def _choice(options: Sequence[str], rng: np.random.Generator) -> str:
    return options[int(rng.integers(len(options)))]


@dataclass(frozen=True)
class Vocabulary:
    """Words with their embeddings, so that the text tower need not be loaded.

    Attributes:
        words: N different words and phrases.
        embeddings: `(N, D)` float32, unit vectors of the words.
        text_sha256: SHA-256 of the weights of the text tower.
    """

    words: tuple[str, ...]
    embeddings: np.ndarray
    text_sha256: str

    def __getitem__(self, word: str) -> np.ndarray:
        """Return the embedding `(D,)` of a word.

        Raises:
            WeightsError: the word is not in the vocabulary.
        """
        if word not in self.words:
            raise WeightsError(
                f"word {word!r} is not in the vocabulary of {len(self.words)} words; embed it with the text tower"
            )
        return self.embeddings[self.words.index(word)]

    def rows(self, words: Sequence[str]) -> np.ndarray:
        """Return embeddings `(len(words), D)` of words; raise `WeightsError` if one is missing."""
        return np.stack([self[word] for word in words])

    def to_bytes(self) -> bytes:
        """Return the bytes of a safetensors file with the words in its metadata; equal content gives equal bytes."""
        rows = np.ascontiguousarray(self.embeddings, "<f4")
        about = {
            "__metadata__": {"words": json.dumps(self.words), "text_sha256": self.text_sha256},
            "embeddings": {"dtype": "F32", "shape": rows.shape, "data_offsets": (0, rows.nbytes)},
        }
        header = json.dumps(about, sort_keys=True).encode()  # the writer of safetensors does not sort its metadata
        header += b" " * (-len(header) % 8)
        return len(header).to_bytes(8, "little") + header + rows.tobytes()

    @classmethod
    def from_bytes(cls, content: bytes) -> "Vocabulary":
        """Return the vocabulary that `to_bytes` wrote.

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
            raise WeightsError(f"vocabulary has {len(words)} words and embeddings {shape}; allowed is one per word")
        return cls(words, embeddings, digest)


def shipped_words() -> tuple[str, ...]:
    """Return the words that a weights folder holds: the training words and those of Table 3."""
    words = [word for concept in WORDS.values() for word in concept.training] + list(TABLE3_WORDS.values())
    return tuple(dict.fromkeys(words))
