"""Report on a trained vision model: a Markdown page with figures, measured on new pictures of the test split."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zsdist.common import random_streams
from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.pretraining.check import figures, words
from zsdist.pretraining.check.check import FIGURES, SET_FIGURES, summarise_sets
from zsdist.pretraining.check.figures import Miss
from zsdist.pretraining.check.predictions import Predictions, predict
from zsdist.pretraining.check.sets import SETS, WILDERNESS, Sample, of_set, wilderness
from zsdist.reporting.attention import seen_share
from zsdist.reporting.markdown import Markup, escaped, missing, table
from zsdist.vision import weights_folder
from zsdist.vision.labels import DIRECTIONS
from zsdist.vision.rays import RANGE_M, quantile_m
from zsdist.vision.scores import MISS_M, calibration
from zsdist.vision.visual_act import VisualAct
from zsdist.vision.weights_folder import HISTORY_FILE
from zsdist.vision.words.table3 import COLUMNS

PAGE = "vision.md"
SHARES = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95])  # quantiles of the reliability curves
_MISSES = 8  # most pictures with misses that are shown
_MISSES_OF_A_SET = 2  # most of these pictures from one set
_ATTENTION_KINDS = ("tree", "person", "sand_pile", "rock", "car")


def write(config: Config, images: int, seed: int, out: Path) -> Path:
    """Measure the model, draw the figures and write the page; return its path.

    Args:
        config: configuration with weights and camera.
        images: number of pictures of the wilderness and of each set.
        seed: seed of the pictures.
        out: folder of the page and its figures; created if it does not exist.

    Raises:
        WeightsError: the weights cannot be used.
        RunError: the folder cannot be written.
    """
    model = VisualAct.load(config.vision, config.camera)
    try:
        out.mkdir(parents=True, exist_ok=True)
        return _write(model, config, images, seed, out)
    except OSError as error:
        raise RunError(f"--out {out} cannot be written: {error.strerror or error}") from error


def _write(model: VisualAct, config: Config, images: int, seed: int, out: Path) -> Path:
    left_out: dict[str, str] = {}
    observations = words.Observations.create(model, config, left_out)
    quantile, rng = config.vision.ray_quantile, random_streams.check_goals(seed)
    samples = list(wilderness(images, seed, config.camera))
    wild = predict(model, samples, quantile, rng)
    if observations is not None:
        observations.add_wilderness(images, seed, config)
    misses = worst_misses(wild, samples, WILDERNESS.title, _MISSES_OF_A_SET)
    sets = {}
    for name, pictures in SETS.items():
        set_samples = list(of_set(name, images, seed, config.camera))
        sets[name] = predict(model, set_samples, quantile, rng)
        misses += worst_misses(sets[name], set_samples, pictures.title, _MISSES_OF_A_SET)
    page = [
        "# Vision",
        "",
        f"Weights {model.weights_sha256[:16]} ({config.vision.network}, encoder {escaped(model.encoder_name)}), "
        f"{images} pictures a set, seed {seed}, distances at the {quantile:.0%} quantile. No picture was used for any "
        "choice.",
        "",
        *_losses(config, out),
        *_actions(wild),
        *_sets(sets),
        *_table3(observations.figures() if observations is not None else None, left_out),
        *_attention(model, samples, observations is not None, left_out, out),
        *_clearance(wild, sets, out),
        *_reliability(wild, sets, out),
        *_misses(misses, config, out),
    ]
    path = out / PAGE
    path.write_text("\n".join(page) + "\n", encoding="utf-8")
    return path


def worst_misses(predictions: Predictions, samples: Sequence[Sample], title: str, count: int) -> list[Miss]:
    """Return up to `count` pictures with missed rays (as `ray_scores` counts them), the worst first."""
    missed = (predictions.true_rays_m < MISS_M[0]) & (predictions.rays_m > MISS_M[1])
    beyond = np.where(missed, predictions.rays_m - predictions.true_rays_m, 0.0)
    order = np.argsort(-beyond.sum(1), kind="stable")[:count]
    return [
        Miss(samples[i].image, predictions.true_rays_m[i], predictions.rays_m[i], int(beyond[i].argmax()), title)
        for i in order
        if missed[i].any()
    ]


def reliability(predictions: Predictions) -> tuple[np.ndarray, np.ndarray]:
    """Return quantiles, and the share of true distances under each, over rays whose quantile is below the range."""
    under = [
        calibration(quantile_m(predictions.ray_probabilities, share), predictions.true_rays_m, RANGE_M)["short"]
        for share in SHARES
    ]
    return SHARES, np.array(under)


def _losses(config: Config, out: Path) -> list[str]:
    weights = weights_folder.read(weights_folder.locate(config.vision.weights))
    if not (weights.path / HISTORY_FILE).exists():
        return ["## Loss (Fig. 5)", "", f"Left out: the weights come without {HISTORY_FILE}.", ""]
    history = weights.history()
    if not history:
        return ["## Loss (Fig. 5)", "", f"Left out: {HISTORY_FILE} is empty.", ""]
    figures.draw_losses(history, out / "vision-loss.png")
    return [
        "## Loss (Fig. 5)",
        "",
        "![loss over epochs](vision-loss.png)",
        "",
        "The loss of each stage has its own parts and scale; the paper's Fig. 5 is of its own loss and data.",
        "",
    ]


def _actions(wild: Predictions) -> list[str]:
    scores = wild.scores()
    rows = [["all", *(f"{scores[key]:.3f}" for key in FIGURES)]]
    for family in dict.fromkeys(wild.families.tolist()):
        family_scores = wild.scores(wild.families == family)
        rows.append([family, *(f"{family_scores[key]:.3f}" for key in FIGURES)])
    return ["## Wilderness", "", *table(["family", *(key.replace("_", " ") for key in FIGURES)], rows)]


def _sets(sets: dict[str, Predictions]) -> list[str]:
    scores = summarise_sets({name: predictions.set_scores() for name, predictions in sets.items()})
    titles = {name: pictures.title for name, pictures in SETS.items()}
    rows = [
        [titles.get(name, Markup(f"**{name}**")), *(f"{row[key]:.3f}" if key in row else "-" for key in SET_FIGURES)]
        for name, row in scores.items()
    ]
    return [
        "## Sets of pictures",
        "",
        "Each set differs from the training data of the head in one way. Miss: share of the rays with an obstacle "
        "nearer than 1.5 m that are predicted beyond 2.5 m. False alarm: share of the rays free for 3.5 m that are "
        "predicted under 2 m. Calibration: share of true distances under the 10% quantile, over rays whose quantile is "
        "below the range; it should be 0.100.",
        "",
        *table(["set", *(key.replace("_", " ") for key in SET_FIGURES)], rows),
    ]


def _table3(found: dict[str, Any] | None, left_out: dict[str, str]) -> list[str]:
    if found is None:
        return ["## Table 3", "", *missing(left_out["table3"])]
    rows = [
        [name.replace("_", " "), *(f"{row[key]:.4f}" for key in COLUMNS), str(row["images"]), *map(str, row["paper"])]
        for name, row in found["table3"].items()
    ]
    head = ["object", *COLUMNS, "pictures", *(f"paper {key}" for key in COLUMNS)]
    shares = [
        [name.replace("_", " "), title, f"{each['share']:.3f}" if each["images"] else "-", str(each["images"])]
        for title, of in (
            (Markup("$I_a$ most similar in its direction"), "object_nearest_in_its_direction"),
            (Markup("lower in $I_1$ to $I_3$ than in $I_0$"), "background_lower_than_whole"),
        )
        for name, each in found["attention"][of].items()
    ]
    return [
        "## Table 3",
        "",
        "Similarity of the word with the whole picture ($I_0$) and with the attended part of each action "
        "($I_1$ forward, $I_2$ left, $I_3$ right). Ours are means over pictures with the object ahead and nowhere else "
        "or on the ground. The authors of the paper measured theirs with CLIP in one setting, so the two are different "
        "tests.",
        "",
        *table(head, rows),
        "Share of pictures in which attention goes to the right place:",
        "",
        *table(["of", "what", "share", "pictures"], shares),
    ]


def _attention(model: VisualAct, samples: list[Sample], known: bool, left_out: dict[str, str], out: Path) -> list[str]:
    if not known:
        return ["## Attention of each action", "", *missing(left_out["attention"])]
    chosen = attention_examples(samples)
    images = np.stack([sample.image for sample in chosen.values()])
    attention, seen = model.observe(images).attention, seen_share(model.read(images).clearance)
    figures.draw_attention(list(images), attention, seen, list(chosen), out / "vision-attention.jpg")
    return ["## Attention of each action", "", "![attention of each action](vision-attention.jpg)", ""]


def attention_examples(samples: Sequence[Sample]) -> dict[str, Sample]:
    """Return, by kind, the first sample in which an object of the kind covers six rays or more."""
    chosen = {}
    for kind in _ATTENTION_KINDS:
        segment = words.KINDS[kind].segment_id
        for sample in samples:
            rays = sample.truth["ray_segment"] == segment
            if rays.sum() >= 6 and sample.truth["ray_clearance_m"][rays].min() > 1.0:
                chosen[kind.replace("_", " ")] = sample
                break
    return chosen or {samples[0].family: samples[0]}


def _clearance(wild: Predictions, sets: dict[str, Predictions], out: Path) -> list[str]:
    every = [wild, *sets.values()]
    median = np.concatenate([quantile_m(each.ray_probabilities, 0.5) for each in every])
    true, predicted = (np.concatenate([getattr(each, name) for each in every]) for name in ("true_rays_m", "rays_m"))
    true_clearance, clearance = (
        np.concatenate([getattr(each, name) for each in every]) for name in ("true_clearance_m", "clearance_m")
    )
    panels = {
        f"nearest of {', '.join(DIRECTIONS)}, as planned with": (true_clearance, clearance),
        "rays, as planned with": (true, predicted),
        "rays, median": (true, median),
    }
    figures.draw_confusion(panels, out / "vision-clearance.png")
    return [
        "## Clearance, true and predicted",
        "",
        "![predicted against true clearance](vision-clearance.png)",
        "",
        "All pictures together. Planning uses the working quantile, which is cautious: it lies below the diagonal by "
        "design.",
        "",
    ]


def _reliability(wild: Predictions, sets: dict[str, Predictions], out: Path) -> list[str]:
    curves = {WILDERNESS.title: reliability(wild)} | {
        SETS[name].title: reliability(each) for name, each in sets.items()
    }
    figures.draw_reliability(curves, out / "vision-reliability.png")
    return [
        "## Reliability of the distributions",
        "",
        "![share of true distances under each quantile](vision-reliability.png)",
        "",
        "Above the diagonal, predicted distances are too long; below it, they are too short.",
        "",
    ]


def _misses(misses: list[Miss], config: Config, out: Path) -> list[str]:
    if not misses:
        return ["## Worst misses", "", "None: no near ray was predicted beyond 2.5 m.", ""]
    worst = sorted(misses, key=lambda miss: np.minimum(miss.true_m - miss.predicted_m, 0.0).sum())[:_MISSES]
    angle = math.radians(config.camera.field_of_view_deg)
    figures.draw_misses(worst, angle, config.camera.height_m, out / "vision-misses.jpg")
    return [
        "## Worst misses",
        "",
        "![the worst misses with their rays](vision-misses.jpg)",
        "",
        "The lines in a picture are the ends of the rays on the ground, without free rays, and at the lower edge if "
        "they are below it. The same distances are plotted below. The dotted line is the ray with the largest error. "
        "At most two pictures per set.",
        "",
    ]
