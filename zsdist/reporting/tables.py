"""Tables of evaluations: the paper's Table 4 and ours, baselines and ablations, the singleton case, merges."""

import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zsdist.common import random_streams
from zsdist.evaluation.contenders import FULL, HYBRID
from zsdist.evaluation.statistics import bootstrap_95, runs_95, wilson_95
from zsdist.reporting.convergence import converged, fluctuation, per_action, per_episode
from zsdist.reporting.markdown import Markup, code, escaped, missing, table
from zsdist.reporting.runs import Evaluation, Method, Run
from zsdist.types import Outcome

NOT_THE_SAME_TEST = (
    "The paper's authors measured its figures on a grid map; ours are measured by driving a car in a physics "
    "simulation through our own scenes of the same three kinds. They are listed together, but are not the same test."
)
# Table 4: name in the paper, then success and collision (%) of the traditional method and of the proposed one.
TABLE_4 = {
    "ood-start-goal": ("(a) starts and goals", "9.25", "8.53", "21.62", "2.64"),
    "ood-layout": ("(b) layout", "3.31", "14.72", "11.91", "3.12"),
    "ood-clusters": ("(c) distribution", "16.28", "7.34", "31.88", "0.65"),
}
SINGLETON = "singleton"
PAPER_CONVERGENCE = (  # Sec. 4.4: method, final value, episodes to converge
    ("paper: traditional HRL", "24", "780"),
    ("paper: proposed", "297", "480"),
)
RATES = ("success", "collision")
DEPLOYABLE = (FULL, HYBRID)  # variants meant for deployment
ORACLE = "oracle-"


@dataclass(frozen=True)
class Rate:
    """Share of episodes with its 95% interval.

    Attributes:
        mean: the share.
        low: lower end of the interval.
        high: upper end of the interval.
        note: units of the interval and a space, if the interval is not over episodes.
    """

    mean: float
    low: float
    high: float
    note: str = ""

    def __str__(self) -> str:
        return f"{100 * self.mean:.1f}% ({self.note}{100 * self.low:.1f}-{100 * self.high:.1f})"


def table_4(evaluations: Sequence[Evaluation], adding: str = "") -> list[str]:
    """Return the paper's Table 4 with ours, one row for each kind of scene and each trained policy that drove it.

    Args:
        evaluations: evaluations of all policies.
        adding: command that adds ours, where there are none.
    """
    trained = [
        evaluation for evaluation in evaluations if evaluation.variant in DEPLOYABLE and not _is_baseline(evaluation)
    ]
    rows = []
    for split, (name, *paper) in TABLE_4.items():
        rows.append([name, "paper: traditional HRL", f"{paper[0]}%", f"{paper[1]}%", "-", "-"])
        rows.append([name, "paper: proposed", f"{paper[2]}%", f"{paper[3]}%", "-", "-"])
        for label, seeds in by_label(trained, split).items():
            rows.append([code(split), label, *(str(rate(seeds, key)) for key in RATES), _mean(seeds, "spl"), _n(seeds)])
    lines = [*table(("scenes", "policy", "success", "collision", "SPL", "n"), rows), NOT_THE_SAME_TEST, ""]
    if not _of(trained, *TABLE_4):
        lines += missing(f"our figures, as no evaluation of a trained policy on {', '.join(TABLE_4)} was given", adding)
    return lines


def every_policy(evaluations: Sequence[Evaluation], reference: str | None, adding: str = "") -> list[str]:
    """Return success, collision and SPL of every policy on each kind of scenes that was driven, best first.

    Args:
        evaluations: evaluations of policies, baselines, ablations and variants.
        reference: label of the policy that the others are compared with, scene by scene; None: no comparison.
        adding: command that adds a policy, where there are fewer than two.
    """
    compared = [evaluation for evaluation in evaluations if not evaluation.variant.startswith(ORACLE)]
    if len({evaluation.label for evaluation in compared}) < 2:
        return missing("the comparison, as evaluations of fewer than two policies were given", adding)
    lines = []
    for split in dict.fromkeys(evaluation.scenes for evaluation in compared):
        lines += [f"### {code(split)}", "", *_compare(by_label(compared, split), reference)]
    return lines


def oracles(evaluations: Sequence[Evaluation], reference: str | None, adding: str = "") -> list[str]:
    """Return tables of a policy with one part replaced by an oracle; `hybrid` replaces the low level."""
    splits = dict.fromkeys(evaluation.scenes for evaluation in evaluations if evaluation.variant.startswith(ORACLE))
    if not splits:
        return missing("oracles, as no evaluation with --variant oracle-... was given", adding)
    lines = []
    for split in splits:
        shown = [
            evaluation
            for evaluation in _of(evaluations, split)
            if evaluation.variant.startswith(ORACLE) or evaluation.variant == HYBRID or evaluation.label == reference
        ]
        lines += [f"### {code(split)}", "", *_compare(by_label(shown, split), reference)]
    return lines


def paired_success(ours: Sequence[Evaluation], theirs: Sequence[Evaluation]) -> tuple[float, float, float, int] | None:
    """Return the difference of success on the scenes that both drove, its 95% interval (two values), and their number.

    Several seeds count with their mean in each scene; the interval is a bootstrap over scenes. None if they have no
    scene in common.
    """
    first, second = _successes(ours), _successes(theirs)
    differences = np.array([first[scene] - second[scene] for scene in first if scene in second])
    if not len(differences):
        return None
    low, high = bootstrap_95(differences, random_streams.intervals(0))
    return float(differences.mean()), low, high, len(differences)


def singleton(methods: Sequence[Method], evaluations: Sequence[Evaluation]) -> list[str]:
    """Return the paper's three metrics of the singleton case, one row per run, with the paper's values."""
    rows = [[name, "-", value, "-", episodes, "-", "-", "-"] for name, value, episodes in PAPER_CONVERGENCE]
    rows += [
        [f"{run.method}, seed {run.settings.seed}", *_convergence(run), *_efficiency(run, evaluations)]
        for method in methods
        for run in method.runs
    ]
    head = (
        "run",
        "final value per action",
        "final value per episode",
        "episodes to converge, per action",
        "per episode",
        "fluctuation, first half",
        "last half",
        "efficiency (singleton, greedy)",
    )
    return table(head, rows)


def training_outcomes(methods: Sequence[Method]) -> list[str]:
    """Return the outcomes of each method's training episodes, with the share of collisions and its interval."""
    rows = []
    for method in methods:
        outcomes = [episode["outcome"] for run in method.runs for episode in run.episodes]
        hits = outcomes.count(Outcome.COLLISION)
        low, high = wilson_95(hits, len(outcomes))
        rows.append(
            [
                method.name,
                str(len(method.runs)),
                str(len(outcomes)),
                *(f"{outcomes.count(outcome)}" for outcome in Outcome),
                f"{100 * hits / len(outcomes):.1f}% ({100 * low:.1f}-{100 * high:.1f})",
            ]
        )
    return table(("method", "seeds", "episodes", *(str(outcome) for outcome in Outcome), "collisions (95%)"), rows)


def merges(runs: Sequence[Run]) -> list[str]:
    """Return every merge: its candidates with score and scenes driven, the promoted one in bold."""
    rows = []
    for run in runs:
        for merge in run.merges:
            candidates = []
            for name in merge["candidates"]:
                driven = merge.get("scenes_driven", {}).get(name)
                text = f"{name} {merge['scores'][name]:+.2f}" + (f" on {driven}" if driven is not None else "")
                candidates.append(f"**{escaped(text)}**" if name == merge["chosen"] else escaped(text))
            rows.append(
                [f"{run.method}, seed {run.settings.seed}", str(merge["episode"]), Markup(", ".join(candidates))]
            )
    return table(("run", "after episodes", "candidates: success − collision, scenes driven"), rows)


def _convergence(run: Run) -> list[str]:
    curves = [converged(curve(run)) if run.episodes else None for curve in (per_action, per_episode)]
    finals = ["-" if one is None else f"{one.final:.1f}" for one in curves]
    when = ["-" if one is None else "not yet" if one.episode is None else str(one.episode) for one in curves]
    spread = fluctuation(run) if run.episodes else None
    return [*finals, *when, *(("-", "-") if spread is None else (f"{value:.0f}" for value in spread))]


def _efficiency(run: Run, evaluations: Sequence[Evaluation]) -> list[str]:
    by_method = by_label(evaluations, SINGLETON).get(run.method, ())
    evaluated = [evaluation for evaluation in by_method if evaluation.seed == run.settings.seed]
    if not evaluated:
        return ["not evaluated"]
    return [_mean(evaluated, "step_efficiency")]


def _compare(groups: dict[str, list[Evaluation]], reference: str | None) -> list[str]:
    head = ["policy", "success", "collision", "timeout", "SPL", "shield changed", "n"]
    against = groups.get(reference) if reference else None
    rows = []
    for label, seeds in groups.items():
        rates = (str(rate(seeds, key)) for key in (*RATES, "timeout"))
        row = [label, *rates, _mean(seeds, "spl"), _shield_share(seeds), _n(seeds)]
        rows.append([*row, _paired(seeds, against)] if against else row)
    rows.sort(key=lambda row: -float(row[1].split("%")[0]))
    return table([*head, f"success − {reference}, paired (scenes)"] if against else head, rows)


def _paired(seeds: Sequence[Evaluation], against: Sequence[Evaluation]) -> str:
    if seeds is against:
        return "-"
    found = paired_success(seeds, against)
    if found is None:
        return "no scene in common"
    difference, low, high, scenes = (100 * value for value in found)
    return f"{difference:+.1f} ({low:+.1f} to {high:+.1f}; {scenes / 100:.0f})"


def _successes(evaluations: Sequence[Evaluation]) -> dict[tuple[str, int], float]:
    """Return mean success by scene and repetition; a scene that is driven several times has one entry for each time."""
    found: dict[tuple[str, int], list[bool]] = {}
    for evaluation in evaluations:
        times: Counter[str] = Counter()
        for row in evaluation.result.get("per_scene", ()):
            scene = (row["scene"], times[row["scene"]])
            times[row["scene"]] += 1
            found.setdefault(scene, []).append(row["outcome"] == Outcome.SUCCESS)
    return {scene: float(np.mean(outcomes)) for scene, outcomes in found.items()}


def _is_baseline(evaluation: Evaluation) -> bool:
    return evaluation.result["weights_sha256"] is None


def _of(evaluations: Sequence[Evaluation], *splits: str) -> list[Evaluation]:
    return [evaluation for evaluation in evaluations if evaluation.scenes in splits]


def rate(evaluations: Sequence[Evaluation], key: str) -> Rate:
    """Return the share of episodes with an outcome, with its 95% interval.

    Over several seeds it is the interquartile mean with a bootstrap over seeds and scenes. Where the seeds did not
    drive the same scenes, it is the mean with minimum and maximum.
    """
    first = evaluations[0].result
    values = [evaluation.result[key] for evaluation in evaluations]
    if len(values) == 1:
        interval = first["confidence_95"].get(key)
        return Rate(values[0], *(interval or wilson_95(round(first[key] * first["episodes"]), first["episodes"])))
    scenes = [[row["scene"] for row in evaluation.result.get("per_scene", ())] for evaluation in evaluations]
    if not scenes[0] or any(one != scenes[0] for one in scenes):
        return Rate(statistics.fmean(values), min(values), max(values), "seeds ")
    scores = np.array([[row["outcome"] == key for row in each.result["per_scene"]] for each in evaluations], float)
    families = [scene.rpartition("-")[0] for scene in scenes[0]]
    return Rate(*runs_95(scores, families, random_streams.intervals(0)), f"{len(values)} seeds ")


def by_label(evaluations: Sequence[Evaluation], split: str) -> dict[str, list[Evaluation]]:
    """Return evaluations on a split by label, for each training seed the one with the most episodes."""
    found: dict[str, dict[int | None, Evaluation]] = {}
    for evaluation in _of(evaluations, split):
        of_label = found.setdefault(evaluation.label, {})
        before = of_label.get(evaluation.seed)
        if before is None or evaluation.result["episodes"] > before.result["episodes"]:
            of_label[evaluation.seed] = evaluation
    return {label: list(of_label.values()) for label, of_label in found.items()}


def _shield_share(evaluations: Sequence[Evaluation]) -> str:
    """Return the share of actions that the shield changed."""
    values = [evaluation.result["shield_changed_share"] for evaluation in evaluations
              if "shield_changed_share" in evaluation.result]  # fmt: skip
    return f"{100 * statistics.fmean(values):.1f}%" if values else "-"


def _mean(evaluations: Sequence[Evaluation], key: str) -> str:
    """Return a mean with its 95% interval, or over several seeds with minimum and maximum."""
    values = [evaluation.result[key] for evaluation in evaluations if evaluation.result.get(key) is not None]
    if not values:
        return "-"
    if len(values) > 1:
        return f"{statistics.fmean(values):.2f} (seeds {min(values):.2f}-{max(values):.2f})"
    interval = evaluations[0].result["confidence_95"].get(key)
    return f"{values[0]:.2f}" + (f" ({interval[0]:.2f}-{interval[1]:.2f})" if interval else "")


def _n(evaluations: Sequence[Evaluation]) -> str:
    counts = [str(evaluation.result["episodes"]) for evaluation in evaluations]
    return counts[0] if len(set(counts)) == len(counts) == 1 else " + ".join(counts)
