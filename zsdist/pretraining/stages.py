"""Training stages of a pretraining: words, head, student, compact.

After every epoch, a stage appends its figures to the history and saves its state. At the end, its weights replace the
state. So an interrupted pretraining is resumed after the last complete epoch. The head is tested on kinds that it has
not seen, so it is not trained on the pictures for words; only the contrast uses the projection learned from them.
"""

import contextlib
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace as changed
from pathlib import Path

import numpy as np
import safetensors.torch
import torch
from torch import nn

from zsdist.common import atomic_files, json_lines, random_streams
from zsdist.errors import RunError
from zsdist.pretraining import fresh
from zsdist.pretraining.job import Job
from zsdist.pretraining.pictures import Pictures
from zsdist.pretraining.progress import PretrainingProgress
from zsdist.vision.encoders.base import Encoder
from zsdist.vision.training import compact as of_compact
from zsdist.vision.training import head as of_head
from zsdist.vision.training import projection as of_words
from zsdist.vision.training import student as of_student
from zsdist.vision.training.calibration import calibrate
from zsdist.vision.training.contrast import Contrast
from zsdist.vision.training.examples import Examples
from zsdist.vision.training.trainer import Recipe, Trainer
from zsdist.vision.weights_folder import (
    COMPACT_FILE,
    HEAD_FILE,
    HISTORY_FILE,
    PROJECTION_FILE,
    STUDENT_FILE,
    VOCABULARY_FILE,
)
from zsdist.vision.words.vocabulary import Vocabulary, shipped_words

TIME_SHARES = {"pictures": 0.4, "words": 0.05, "head": 0.25, "student": 0.3, "compact": 3.0}
RECIPES: dict[str, Recipe] = {
    "words": of_words.WordRecipe(),
    "head": Recipe(epochs=12),
    "student": Recipe(epochs=20, batch=32),
    "compact": Recipe(epochs=300, batch=64, weight_decay=0.05, patience=300, average=0.998),
}


class Budget:
    """Time limit, divided among pictures and stages; time that one of them does not use goes to the later ones.

    Args:
        allowed_s: total time from now on in seconds; infinite: no limit.
        stages: stages in their order, keys of `TIME_SHARES`.
        clock: function that returns the time in seconds.
    """

    def __init__(self, allowed_s: float, stages: Sequence[str], clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._stages = clock, list(stages)
        self._end_s = clock() + allowed_s

    def begin(self, stage: str) -> Callable[[], float]:
        """Begin a stage; return a function that returns the share of the stage's time that is used."""
        start_s = self._clock()
        remaining = self._stages[self._stages.index(stage) :]
        share = TIME_SHARES[stage] / sum(TIME_SHARES[name] for name in remaining)
        allowed_s = max(share * (self._end_s - start_s), 1e-3)
        return lambda: (self._clock() - start_s) / allowed_s


class Stages:
    """Training of all stages of a job, resumed from the files of earlier sessions in the folder.

    Args:
        job: settings of the pretraining.
        folder: folder of the pretraining.
        pictures: training data.
        encoder: encoder of the pictures.
        budget: time limit.
        progress: display of every epoch.
        workers: number of processes that make fresh pictures.
    """

    def __init__(
        self,
        job: Job,
        folder: Path,
        pictures: Pictures,
        encoder: Encoder,
        budget: Budget,
        progress: PretrainingProgress,
        workers: int,
    ) -> None:
        self._job, self._pictures, self._encoder = job, pictures, encoder
        self._budget, self._progress, self._workers = budget, progress, workers
        self._history = folder / HISTORY_FILE
        self._folder = folder / "stages"
        self._field_of_view_rad = math.radians(job.config.camera.field_of_view_deg)

    def run(self) -> dict[str, bytes]:
        """Train every stage; return the files of the weights folder by name."""
        self._folder.mkdir(exist_ok=True)
        contents: dict[str, bytes] = {}
        projection = None
        if "words" in self._job.stages:
            projection, word_files = self.words()
            contents |= word_files
        if "head" in self._job.stages:
            examples, validation = self._pictures.examples(), self._pictures.validation()
            head = of_head.new_head(examples, self._field_of_view_rad, self._job.seed)

            def train_head(recipe: Recipe, rng: np.random.Generator, time_used: Callable[[], float]) -> Trainer:
                contrast = None if projection is None else Contrast(projection, *self._pictures.masked())
                return of_head.train(head, examples, validation, recipe, rng, time_used, contrast)

            self._train("head", head, train_head, lambda: calibrate(head, validation))
            contents[HEAD_FILE] = _saved(head)
        if "student" in self._job.stages:
            student = of_student.new_student(self._field_of_view_rad, self._job.seed)

            def train_student(recipe: Recipe, rng: np.random.Generator, time_used: Callable[[], float]) -> Trainer:
                teacher = of_student.predict_with_teacher(head, examples)
                return of_student.train(student, examples, validation, recipe, rng, time_used, teacher)

            pictures = of_student.with_image_tokens(validation)
            self._train("student", student, train_student, lambda: calibrate(student, pictures))
            contents[STUDENT_FILE] = _saved(student)
        if "compact" in self._job.stages:
            contents[COMPACT_FILE] = _saved(self._compact())
        return contents

    def _compact(self) -> nn.Module:
        """Return the compact network, trained on pictures that are made meanwhile."""
        network = of_compact.new_compact(self._field_of_view_rad, self._job.seed)
        self._progress.log(f"compact: makes {fresh.epoch_pictures(self._job)} new pictures for each epoch")
        unseen = fresh.validation(self._job)
        with contextlib.ExitStack() as opened:

            def epochs(first: int) -> Iterator[Examples]:
                return opened.enter_context(contextlib.closing(fresh.epochs(self._job, self._workers, first)))

            def train(recipe: Recipe, rng: np.random.Generator, time_used: Callable[[], float]) -> Trainer:
                pictures = fresh.epoch_pictures(self._job)
                return of_compact.train(network, pictures, epochs, unseen, recipe, rng, time_used)

            self._train("compact", network, train, lambda: calibrate(network, unseen))
        return network

    def words(self) -> tuple[nn.Module, dict[str, bytes]]:
        """Return the projection to text space, and the files of projection and vocabulary.

        An encoder may have its own projection, which is not trained and needs no file.
        """
        words, native = shipped_words(), self._encoder.native_projection()
        vocabulary = Vocabulary(words, self._encoder.embed_texts(words), self._encoder.text_sha256)
        if native is not None:
            self._progress.log("words: the encoder has its own projection, which is not trained")
            own_projection = nn.Linear(*native["weight"].shape[::-1])
            own_projection.load_state_dict({name: torch.from_numpy(value) for name, value in native.items()})
            return own_projection, {VOCABULARY_FILE: vocabulary.to_bytes()}
        examples = self._pictures.described()
        projection = of_words.new_projection(examples, self._job.seed)

        def train(recipe: Recipe, rng: np.random.Generator, time_used: Callable[[], float]) -> Trainer:
            assert isinstance(recipe, of_words.WordRecipe), "as in RECIPES"
            validation = self._pictures.described_validation()
            return of_words.train(projection, examples, validation, vocabulary, recipe, rng, time_used)

        self._train("words", projection, train, lambda: None)
        return projection, {
            VOCABULARY_FILE: vocabulary.to_bytes(),
            PROJECTION_FILE: _saved(projection),
        }

    def _train(
        self,
        stage: str,
        network: nn.Module,
        begin: Callable[[Recipe, np.random.Generator, Callable[[], float]], Trainer],
        finish: Callable[[], None],
    ) -> None:
        """Train the network of a stage in place, or load its weights if an earlier session has finished it.

        Args:
            stage: name of the stage.
            network: network of the stage.
            begin: function that returns the trainer for a recipe, a random generator and the share of time used.
            finish: function that is called once the network is trained.
        """
        weights_file, state_file = self._folder / f"{stage}.safetensors", self._folder / f"{stage}.training"
        if weights_file.exists():
            network.load_state_dict(safetensors.torch.load(weights_file.read_bytes()))
            self._progress.log(f"{stage}: already trained")
            return
        recipe = RECIPES[stage]
        if self._job.epochs:
            recipe = changed(recipe, epochs=self._job.epochs)
        rng = random_streams.training_stage(self._job.seed, list(TIME_SHARES).index(stage))
        trainer = begin(recipe, rng, self._budget.begin(stage))
        if state_file.exists():
            trainer.restore(state_file.read_bytes())
            self._progress.log(f"{stage}: resumed after epoch {trainer.epoch}")
        last_saved = trainer.epoch  # later epochs were interrupted before their state was saved
        json_lines.prune(self._history, lambda line: line["stage"] == stage and line["epoch"] > last_saved)
        try:
            for figures in trainer:
                with self._history.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"stage": stage, **figures}) + "\n")
                atomic_files.replace(state_file, trainer.state())
                self._progress.epoch(stage, figures, recipe.epochs)
        except RunError as error:
            raise RunError(f"stage {stage!r}: {error}") from error
        finish()
        atomic_files.replace(weights_file, _saved(network))
        state_file.unlink(missing_ok=True)


def _saved(network: nn.Module) -> bytes:
    """Return the weights of a network in the format of safetensors, which has dense arrays only."""
    return safetensors.torch.save({name: value.contiguous() for name, value in network.state_dict().items()})


def best_epochs(history: Path) -> dict[str, dict[str, float]]:
    """Return, for each stage in a history, the figures of the epoch whose weights were kept."""
    best: dict[str, dict[str, float]] = {}
    if not history.exists():
        return best
    for line in map(json.loads, history.read_text(encoding="utf-8").splitlines()):
        stage = line.pop("stage")
        if stage not in best or line["validation_loss"] < best[stage]["validation_loss"]:
            best[stage] = {name: round(value, 5) for name, value in line.items()}
    return best
