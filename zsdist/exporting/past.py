"""Past of a policy, for the model card of its bundle: what it was trained on, and how it did on test scenes."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from zsdist.errors import RunError
from zsdist.evaluation.contenders import FULL
from zsdist.run import checkpoint_files, location
from zsdist.run.checkpoint import Policy

EVALUATION_FILE = "evaluation.json"  # in a run directory: the comparison at its end
FIGURES = ("success", "collision", "timeout", "spl")


def training_of(policy: Policy) -> dict[str, Any]:
    """Return what a policy was trained on.

    Raises:
        RunError: its checkpoint cannot be read.
    """
    settings, manifest = policy.config, checkpoint_files.read_manifest(Path(policy.source))
    return {
        "simulator": "zsdist",
        "scenes": list(settings.scenes.train),
        "scenes_a_family": settings.scenes.train_scenes,
        "episodes": manifest["episodes"],
        "seed": settings.seed,
        "camera": settings.camera.back_end,
    }


def evaluations_of(policy: Policy, files: Sequence[Path]) -> dict[str, dict[str, Any]]:
    """Return how a policy did on test scenes, by the name of the scenes; of two results on the same the later counts.

    Args:
        policy: policy whose run directory is searched too.
        files: results of `zsdist evaluate --json` for this policy.

    Raises:
        RunError: a given file cannot be read, or is of other weights.
    """
    found = []
    own = location.find_run(Path(policy.source)) / EVALUATION_FILE
    if own.is_file():
        found += [result for result in _results(own) if _is_of(policy, result)]
    for file in files:
        results = _results(file)
        if not results or not all(_is_of(policy, result) for result in results):
            raise RunError(
                f"--evaluation {file} is not of these weights, {policy.sha256[:16]}; allowed is what `zsdist evaluate "
                "POLICY --json FILE` writes for the policy that is exported"
            )
        found += results
    return {Path(result["scenes"]).name: _short(result) for result in found}  # a folder without its place


def _results(file: Path) -> list[dict[str, Any]]:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise RunError(
            f"evaluation {file} cannot be read: {reason}; allowed is what `zsdist evaluate --json` writes"
        ) from error
    results = content if isinstance(content, list) else [content]
    wanted = {"weights_sha256", "scenes", "episodes", "seed", "confidence_95", *FIGURES}
    for result in results:
        if not isinstance(result, dict) or not wanted <= result.keys():
            raise RunError(
                f"evaluation {file} is no result of one policy; allowed is what `zsdist evaluate --json` writes"
            )
    return results


def _is_of(policy: Policy, result: dict[str, Any]) -> bool:
    return bool(result["weights_sha256"] == policy.sha256 and result.get("variant", FULL) == FULL)


def _short(result: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of a result that belong in a manifest, rounded."""
    short = {name: result[name] for name in ("episodes", "seed")}
    for name in FIGURES:
        interval = result["confidence_95"].get(name)
        short[name] = None if result[name] is None else round(result[name], 4)
        short[f"{name}_95"] = None if interval is None else [round(end, 4) for end in interval]
    return short
