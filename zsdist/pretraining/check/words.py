"""Part of the check about words: Table 3, the targets of attention, and the naming of pictures."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from zsdist.common import random_streams
from zsdist.common.console import say
from zsdist.config import CameraConfig, Config
from zsdist.datasets.captioned import captioned_views
from zsdist.errors import WeightsError
from zsdist.pretraining.batches import BATCH, batched
from zsdist.pretraining.check.sets import Sample, wilderness
from zsdist.sim.scenes.kinds import KINDS
from zsdist.sim.scenes.manifest import MANIFEST
from zsdist.vision import weights_folder
from zsdist.vision.encoders import open_encoder
from zsdist.vision.encoders.base import Encoder
from zsdist.vision.rays import RAYS, ray_angles_rad
from zsdist.vision.visual_act import VisualAct
from zsdist.vision.weights_folder import HEAD_FILE, PROJECTION_FILE, VOCABULARY_FILE
from zsdist.vision.words.measures import LEFT_OUT, naming_accuracy, words_of_kinds
from zsdist.vision.words.table3 import COLUMNS, background_share, directions_of, object_share, only_direction, table3
from zsdist.vision.words.vocabulary import GROUND_WORDS, KIND_WORDS, TABLE3_WORDS, Vocabulary, shipped_words

if TYPE_CHECKING:
    from zsdist.vision.models.projection import Projection
    from zsdist.vision.training.projection import WordExamples

PAPER_TABLE3 = {
    "tree": (0.2607, 0.4121, 0.1298, 0.0736),
    "person": (0.2473, 0.5223, 0.2954, 0.1371),
    "asphalt": (0.1849, 0.0718, 0.1035, 0.1302),
    "sand": (0.3001, 0.1727, 0.0931, 0.1127),
    "grass": (0.2131, 0.1981, 0.1703, 0.0689),
}
"""Similarities in the paper's Table 3, by our concepts. The authors measured them with CLIP in one setting."""

UNSEEN_IMAGES = 1600  # number of captioned pictures to train on for the figure of unseen kinds
UNSEEN_EPOCHS = 8
_HELD_OUT = 160  # number of captioned pictures for validation


class Observations:
    """Collection of the attended embeddings of pictures, for Table 3 and the shares of attention.

    Args:
        model: model whose attention is measured.
        words: embedding `(D,)` of the word for each kind and ground, by name.
        angles_rad: `(R,)`, angles of the rays, left positive.
    """

    def __init__(self, model: VisualAct, words: dict[str, np.ndarray], angles_rad: np.ndarray) -> None:
        self._model, self._words, self._angles = model, words, angles_rad
        self._embeddings: list[np.ndarray] = []
        self._segments: list[np.ndarray] = []
        self._distances: list[np.ndarray] = []
        self._grounds: list[str] = []

    @classmethod
    def create(cls, model: VisualAct, config: Config, left_out: dict[str, str]) -> Self | None:
        """Return an empty collection; None, with the reason in `left_out`, if the weights have no words."""
        reason = _reason_without_words(config)
        if reason is not None:
            left_out |= dict.fromkeys(("table3", "attention"), reason)
            return None
        return cls(model, word_rows(config), ray_angles_rad(RAYS, math.radians(config.camera.field_of_view_deg)))

    def add(self, batch: list[Sample]) -> None:
        """Add a batch of pictures."""
        self._embeddings.append(self._model.observe(np.stack([sample.image for sample in batch])).embeddings)
        self._segments += [sample.truth["ray_segment"] for sample in batch]
        self._distances += [sample.truth["ray_clearance_m"] for sample in batch]
        self._grounds += [sample.scene.ground for sample in batch]

    def add_wilderness(self, images: int, seed: int, config: Config) -> None:
        """Add pictures of the wilderness, as the encoder takes them; the check has others where the camera's differ."""
        for batch in batched(wilderness(images, seed, camera_for_words(config)), BATCH):
            self.add(batch)

    def figures(self) -> dict[str, Any]:
        """Return `table3` with the paper's figures, and `attention` to objects and grounds."""
        embeddings = np.concatenate(self._embeddings)
        segments, distances = np.stack(self._segments), np.stack(self._distances)
        directions = {
            kind: only_direction(*directions_of(KINDS[kind].segment_id, segments, distances, self._angles))
            for kind in KIND_WORDS
        }
        grounds = {ground: np.array(self._grounds) == ground for ground in GROUND_WORDS}
        table_directions = {kind: direction for kind, direction in directions.items() if kind in TABLE3_WORDS}
        rows = table3(embeddings, self._words, table_directions, grounds)
        return {
            "table3": {name: row | {"paper": list(PAPER_TABLE3[name])} for name, row in rows.items()},
            "attention": {
                "object_nearest_in_its_direction": {
                    kind: {
                        "share": object_share(embeddings, self._words[kind], direction),
                        "images": int((direction >= 0).sum()),
                    }
                    for kind, direction in directions.items()
                },
                "background_lower_than_whole": {
                    ground: {
                        "share": background_share(embeddings, self._words[ground], pictures),
                        "images": int(pictures.sum()),
                    }
                    for ground, pictures in grounds.items()
                },
            },
        }


def camera_for_words(config: Config) -> CameraConfig:
    """Return the camera whose pictures attention and words are measured on.

    It is the car's, in the encoder's resolution if the car's network needs no encoder and has another one.
    """
    if config.vision.network == "head":
        return config.camera
    return config.camera.model_copy(update={"size_px": open_encoder(config.vision.encoder).input_px})


def word_rows(config: Config) -> dict[str, np.ndarray]:
    """Return the embedding `(D,)` of the word for each kind and ground, of the paper's word if there is one."""
    weights = weights_folder.read(weights_folder.locate(config.vision.weights))
    vocabulary = Vocabulary.from_bytes(weights.content(VOCABULARY_FILE))
    names = {name: words.training[0] for name, words in (KIND_WORDS | GROUND_WORDS).items()} | TABLE3_WORDS
    rows = _text_projector(shipped_projection(config))(vocabulary.rows(list(names.values())))
    return dict(zip(names, rows, strict=True))


def shipped_projection(config: Config) -> "Projection":
    """Return the projection of the configured weights; raise `WeightsError` if it is missing or damaged."""
    import safetensors
    import safetensors.torch

    from zsdist.vision.models.projection import projection_of

    weights = weights_folder.read(weights_folder.locate(config.vision.weights))
    try:
        return projection_of(safetensors.torch.load(weights.content(PROJECTION_FILE)))
    except (safetensors.SafetensorError, KeyError, RuntimeError) as error:
        raise WeightsError(
            f"weights {weights.path / PROJECTION_FILE} do not belong to a projection: "
            f"{' '.join(str(error).split())[:200]}"
        ) from error


def naming(config: Config, seed: int, count: int, unseen_kinds: bool, left_out: dict[str, str]) -> dict[str, Any]:
    """Return, under `words`, the accuracy of naming new pictures with one word of six; chance is 1/6.

    There is one accuracy with training words, one with unseen words, and with `unseen_kinds` one for kinds that the
    projection has never seen.

    Args:
        config: configuration with weights, encoder and camera.
        seed: seed of pictures and choices.
        count: number of pictures.
        unseen_kinds: whether to train four projections too, each without two kinds, so that each kind is left out once.
        left_out: dictionary to which parts that cannot be measured are added, with the reason.
    """
    reason = _reason_without_words(config)
    if reason is not None:
        left_out["words"] = reason
        return {}
    encoder = open_encoder(config.vision.encoder)
    token_batches: list[np.ndarray] = []
    kinds: list[str] = []
    for batch in batched(
        captioned_views(MANIFEST["word-training"].families, "test", count, seed, camera_for_words(config)), BATCH
    ):
        token_batches.append(encoder.tokens(np.stack([view.image for view in batch])).astype(np.float16))
        kinds += [view.dominant for view in batch]
    tokens, dominant = np.concatenate(token_batches), np.array(kinds)
    projection = shipped_projection(config)
    images = _image_embeddings(projection, tokens)
    figures = {}
    for name, use in (("training_words", "training"), ("words_never_seen", "test")):
        try:
            rows = _kind_rows(encoder, projection, use)
        except WeightsError as error:
            left_out[f"words.{name}"] = str(error)
            continue
        figures[name] = naming_accuracy(images, dominant, rows, random_streams.check_names(seed))
    if unseen_kinds:
        figures["unseen_kinds"] = _unseen_kinds(config, encoder, seed, tokens, dominant)
    else:
        left_out["words.unseen_kinds"] = "measured with --unseen-kinds"
    return {"words": figures}


def show(result: dict[str, Any]) -> None:
    """Print the figures about words."""
    if "table3" in result:
        say("")
        say("Table 3: similarity with the words, ours (the paper's: another setting, with CLIP)")
        for name, row in result["table3"].items():
            cells = "  ".join(f"{row[key]:.3f} ({paper:.3f})" for key, paper in zip(COLUMNS, row["paper"], strict=True))
            say(f"{name:10} {cells}  of {row['images']} pictures")
        for name, shares in result["attention"].items():
            known = ", ".join(
                f"{kind} {found['share']:.2f} ({found['images']})" for kind, found in shares.items() if "share" in found
            )
            say(f"{name.replace('_', ' ')}: {known}")
    for name, found in result.get("words", {}).items():
        if "accuracy" in found:
            say(f"one word of six, {name.replace('_', ' ')}: {found['accuracy']:.2f} of {found['images']} pictures")


def _unseen_kinds(
    config: Config, encoder: Encoder, seed: int, tokens: np.ndarray, dominant: np.ndarray
) -> dict[str, float]:
    """Return the accuracy of four projections, each trained without some kinds, in naming these kinds."""
    from zsdist.vision.training.projection import WordRecipe, new_projection, train

    texts = shipped_words()
    vocabulary = Vocabulary(texts, encoder.embed_texts(texts), encoder.text_sha256)
    examples = _word_examples(encoder, UNSEEN_IMAGES, seed, config.camera)
    held_out = _word_examples(encoder, _HELD_OUT, seed + 1, config.camera)
    parts = []
    for kinds in LEFT_OUT:
        recipe = WordRecipe(epochs=UNSEEN_EPOCHS, exclude_kinds=kinds)
        projection = new_projection(examples, seed)
        rng = random_streams.check_words(seed)
        for _ in train(projection, examples, held_out, vocabulary, recipe, rng, lambda: 0.0):
            pass
        rows = _kind_rows(encoder, projection, "training")
        parts.append(naming_accuracy(_image_embeddings(projection, tokens), dominant, rows, rng, kinds))
        say(f"unseen kinds {', '.join(kinds)}: {parts[-1]['accuracy']:.2f}")
    measured = [part for part in parts if part["images"]]
    of_kinds = {kind: part[kind] for part in measured for kind in KIND_WORDS if kind in part}
    images = sum(part["images"] for part in measured)
    accuracy = sum(part["accuracy"] * part["images"] for part in measured) / images if images else float("nan")
    return {"accuracy": accuracy, "images": images, **of_kinds}


def _word_examples(encoder: Encoder, count: int, seed: int, camera: CameraConfig) -> "WordExamples":
    """Return captioned pictures to train a projection on."""
    from zsdist.vision.training.projection import WordExamples

    purpose = MANIFEST["word-training"]
    views = captioned_views(purpose.families, purpose.split, count, seed, camera, varied=True)
    columns = [
        (
            encoder.tokens(np.stack([view.image for view in batch])).astype(np.float16),
            np.stack([view.cells for view in batch]),
            encoder.embed_texts([view.caption for view in batch]).astype(np.float16),
            np.array([view.dominant for view in batch]),
            np.array([view.ground for view in batch]),
        )
        for batch in batched(views, BATCH)
    ]
    return WordExamples(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def _reason_without_words(config: Config) -> str | None:
    """Return the reason why the weights have no words; None if they have words."""
    weights = weights_folder.read(weights_folder.locate(config.vision.weights))
    missing = [file for file in (HEAD_FILE, PROJECTION_FILE, VOCABULARY_FILE) if not weights.has(file)]
    return f"weights {weights.path} lack {' and '.join(missing)}" if missing else None


def _kind_rows(encoder: Encoder, projection: "Projection", use: str) -> dict[str, np.ndarray]:
    """Return the projected embeddings `(n, D)` of the words of each kind; `use` is `training` or `test`."""
    return {
        kind: _text_projector(projection)(encoder.embed_texts(texts)) for kind, texts in words_of_kinds(use).items()
    }


def _text_projector(projection: "Projection") -> Callable[[np.ndarray], np.ndarray]:
    """Return a function from embeddings `(N, D)` of texts to the common space, `(N, D)`."""
    import torch

    def project(embeddings: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return projection.texts(torch.from_numpy(np.asarray(embeddings, np.float32))).numpy()

    return project


def _image_embeddings(projection: "Projection", tokens: np.ndarray) -> np.ndarray:
    """Return the embeddings I_0 `(N, D)` of pictures from their tokens."""
    import torch

    from zsdist.vision.models.projection import image_embedding

    projection.eval()
    with torch.no_grad():
        parts = [
            image_embedding(projection(torch.from_numpy(tokens[start : start + 64].astype(np.float32)))).numpy()
            for start in range(0, len(tokens), 64)
        ]
    return np.concatenate(parts)
