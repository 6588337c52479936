"""The networks of a pretraining, one stage after the other: words, head, student.

A stage appends its figures to the history after every epoch and then saves where it stands; when it is over, its
weights take the place of that, so a pretraining that was broken off goes on at the last whole epoch. The pictures of
the head and those of the words are kept apart: the head, which is tested on kinds that it has not seen, meets the
projection through the contrast alone.
"""

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace as changed
from pathlib import Path

import numpy as np
import safetensors.torch
import torch
from torch import nn

from zsdist.common import atomic_files
from zsdist.errors import RunError
from zsdist.pretraining.calibrating import calibrate
from zsdist.pretraining.job import Job
from zsdist.pretraining.pictures import Pictures
from zsdist.pretraining.progress import PretrainingProgress
from zsdist.vision.encoders.base import Encoder
from zsdist.vision.training import head as of_head
from zsdist.vision.training import projection as of_words
from zsdist.vision.training import student as of_student
from zsdist.vision.training.contrast import Contrast
from zsdist.vision.training.trainer import Recipe, Trainer
from zsdist.vision.weights_folder import HEAD_FILE, HISTORY_FILE, PROJECTION_FILE, STUDENT_FILE, VOCABULARY_FILE
from zsdist.vision.words.vocabulary import Vocabulary, shipped_words

TIME_SHARES = {"pictures": 0.4, "words": 0.05, "head": 0.25, "student": 0.3}
RECIPES = {"words": of_words.WordRecipe(), "head": Recipe(epochs=12), "student": Recipe(epochs=20, batch=32)}


class Budget:
    """The time allowed, parted among pictures and stages; what one leaves over is for those after it.

    Args:
        allowed_s: in all, from now on; infinite: no limit.
        stages: keys of `TIME_SHARES` in the order in which they come.
        clock: in seconds.
    """

    def __init__(self, allowed_s: float, stages: Sequence[str], clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._stages = clock, list(stages)
        self._end_s = clock() + allowed_s

    def begin(self, stage: str) -> Callable[[], float]:
        """A function that tells which share of a stage's time is gone; the stage begins now."""
        began_s = self._clock()
        left = self._stages[self._stages.index(stage) :]
        share = TIME_SHARES[stage] / sum(TIME_SHARES[name] for name in left)
        allowed_s = max(share * (self._end_s - began_s), 1e-3)
        return lambda: (self._clock() - began_s) / allowed_s


class Stages:
    """Trains what a job asks for in `folder`, where it also looks for what earlier sittings left.

    Args:
        job: what is to be trained.
        folder: of the pretraining.
        pictures: all of them.
        encoder: of the pictures.
        budget: of time.
        watch: is told of every epoch.
    """

    def __init__(
        self, job: Job, folder: Path, pictures: Pictures, encoder: Encoder, budget: Budget, watch: PretrainingProgress
    ) -> None:
        self._job, self._pictures, self._encoder, self._budget, self._watch = job, pictures, encoder, budget, watch
        self._history = folder / HISTORY_FILE
        self._folder = folder / "stages"
        self._field_of_view_rad = math.radians(job.config.camera.field_of_view_deg)

    def run(self) -> dict[str, bytes]:
        """Every stage; returns the files of the weights folder by name."""
        self._folder.mkdir(exist_ok=True)
        contents, projection = {}, None
        if "words" in self._job.stages:
            projection, more = self.words()
            contents |= more
        if "head" in self._job.stages:
            examples, validation = self._pictures.examples(), self._pictures.validation()
            head = of_head.new_head(examples, self._field_of_view_rad, self._job.seed)

            def train_head(recipe: Recipe, rng: np.random.Generator, time_used: Callable[[], float]) -> Trainer:
                contrast = None if projection is None else Contrast(projection, *self._pictures.masked())
                return of_head.train(head, examples, validation, recipe, rng, time_used, contrast)

            self._train("head", head, train_head, lambda: calibrate(head, validation))
            contents[HEAD_FILE] = safetensors.torch.save(head.state_dict())
        if "student" in self._job.stages:
            student = of_student.new_student(self._field_of_view_rad, self._job.seed)

            def train_student(recipe: Recipe, rng: np.random.Generator, time_used: Callable[[], float]) -> Trainer:
                teacher = of_student.predict_with_teacher(head, examples)
                return of_student.train(student, examples, validation, recipe, rng, time_used, teacher)

            pictures = of_student.with_image_tokens(validation)
            self._train("student", student, train_student, lambda: calibrate(student, pictures))
            contents[STUDENT_FILE] = safetensors.torch.save(student.state_dict())
        return contents

    def words(self) -> tuple[nn.Module, dict[str, bytes]]:
        """The projection to the space of words, which an encoder may bring, and the files of it and the vocabulary."""
        words, native = shipped_words(), self._encoder.native_projection()
        vocabulary = Vocabulary(words, self._encoder.embed_texts(words), self._encoder.text_sha256)
        if native is not None:
            self._watch.say("words: the encoder brings its own projection, which is not trained")
            projection = nn.Linear(*native["weight"].shape[::-1])
            projection.load_state_dict({name: torch.from_numpy(value) for name, value in native.items()})
            return projection, {VOCABULARY_FILE: vocabulary.to_bytes()}
        examples = self._pictures.described()
        projection = of_words.new_projection(examples, self._job.seed)

        def train(recipe: Recipe, rng: np.random.Generator, time_used: Callable[[], float]) -> Trainer:
            validation = self._pictures.described_validation()
            return of_words.train(projection, examples, validation, vocabulary, recipe, rng, time_used)

        self._train("words", projection, train, lambda: None)
        return projection, {
            VOCABULARY_FILE: vocabulary.to_bytes(),
            PROJECTION_FILE: safetensors.torch.save(projection.state_dict()),
        }

    def _train(
        self,
        stage: str,
        network: nn.Module,
        begin: Callable[[Recipe, np.random.Generator, Callable[[], float]], Trainer],
        finish: Callable[[], None],
    ) -> None:
        """Trains a stage's network in place, or loads the weights with which an earlier sitting ended."""
        ended, stands = self._folder / f"{stage}.safetensors", self._folder / f"{stage}.training"
        if ended.exists():
            network.load_state_dict(safetensors.torch.load(ended.read_bytes()))
            self._watch.say(f"{stage}: trained already")
            return
        recipe = RECIPES[stage]
        if self._job.epochs:
            recipe = changed(recipe, epochs=self._job.epochs)
        rng = np.random.default_rng([self._job.seed, list(TIME_SHARES).index(stage)])
        trainer = begin(recipe, rng, self._budget.begin(stage))
        if stands.exists():
            trainer.restore(stands.read_bytes())
            self._watch.say(f"{stage}: going on after epoch {trainer.epoch}")
        prune(self._history, stage, trainer.epoch)
        try:
            for figures in trainer:
                with self._history.open("a") as file:
                    file.write(json.dumps({"stage": stage, **figures}) + "\n")
                atomic_files.replace(stands, trainer.state())
                self._watch.epoch(stage, figures, recipe.epochs)
        except RunError as error:
            raise RunError(f"stage {stage!r}: {error}") from error
        finish()
        atomic_files.replace(ended, safetensors.torch.save(network.state_dict()))
        stands.unlink(missing_ok=True)


def prune(history: Path, stage: str, epoch: int) -> None:
    """Leaves out of a history the epochs of a stage after `epoch`: they were broken off before they were saved."""
    if not history.exists():
        return
    lines = [json.loads(line) for line in history.read_text().splitlines() if line.endswith("}")]
    kept = [line for line in lines if line["stage"] != stage or line["epoch"] <= epoch]
    atomic_files.replace(history, "".join(json.dumps(line) + "\n" for line in kept).encode())


def best_epochs(history: Path) -> dict[str, dict[str, float]]:
    """Of each stage in a history the figures of the epoch whose weights were kept."""
    best: dict[str, dict[str, float]] = {}
    if not history.exists():
        return best
    for line in map(json.loads, history.read_text().splitlines()):
        stage = line.pop("stage")
        if stage not in best or line["validation_loss"] < best[stage]["validation_loss"]:
            best[stage] = {name: round(value, 5) for name, value in line.items()}
    return best
