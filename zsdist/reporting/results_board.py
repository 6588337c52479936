"""Results of a finished run for TensorBoard: its merges, the evaluation of its policy, and its figures as pictures."""

import json
from pathlib import Path
from typing import Any

from zsdist.common import folders
from zsdist.reporting.markdown import table
from zsdist.run.board import Board

_SHOWN = ("success", "collision", "timeout", "spl")


def add(folder: Path) -> None:
    """Add the results of the finished run in `folder` to its events, as far as they are there.

    Groups: `merges`, with the score of each candidate over training episodes and the name of the winner; `evaluation`,
    with a table and a curve of one point for each policy; `figures`.

    Raises:
        OSError: a file cannot be read or written.
    """
    board, summary = Board(folder / "tensorboard"), _read(folder / "summary.json")
    try:
        for merge in [] if summary is None else summary["merges"]:
            board.add(merge["episode"], {f"merges/{name}": score for name, score in merge["scores"].items()})
            board.add_text("merges/chosen", merge["chosen"], merge["episode"])
        episodes = 0 if summary is None else summary["episodes"]
        results = _read(folder / "evaluation.json") or []
        if results:
            board.add_text("evaluation", _table(results), episodes)
        for result in results:
            name = f"evaluation/{result['scenes']}/{result['policy']}"
            board.add(episodes, {f"{name}/{key}": result[key] for key in _SHOWN if result[key] is not None})
        for path in folders.visible(folder / "figures", "*.png"):
            board.add_picture(f"figures/{path.stem}", path.read_bytes(), episodes)
        board.sync()
    finally:
        board.close()


def _read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def _table(results: list[dict[str, Any]]) -> str:
    rows = [
        (
            result["scenes"],
            result["policy"],
            str(result["episodes"]),
            *("-" if result[key] is None else f"{result[key]:.2f}" for key in _SHOWN),
        )
        for result in results
    ]
    return "\n".join(table(("scenes", "policy", "episodes", *_SHOWN), rows))
