"""Every configuration of a learned baseline completes a short run."""

import json
from pathlib import Path

import pytest
from rehearsal import SEEN, SMALL, kinematic, rehearse

from zsdist import config
from zsdist.run import directory
from zsdist.run.program import RunSpec

pytestmark = pytest.mark.integration
BASELINES = sorted((Path(__file__).parents[2] / "configs" / "baselines").glob("*.yaml"))


@pytest.mark.parametrize("path", BASELINES, ids=lambda path: path.stem)
def test_a_baseline_trains_to_the_end(path, tmp_path):
    asked = config.load(path)
    overrides = [one for one in SMALL if asked.merge.every_episodes or not one.startswith("merge.every_episodes")]
    settings = config.load(path, tuple(overrides))
    folder = directory.create(tmp_path / "run", settings)
    summary = rehearse(RunSpec(settings, directory.key_name(folder), folder, {}, SEEN, kinematic))
    assert summary["episodes"] == settings.run.episodes
    assert bool(summary["merges"]) == bool(asked.merge.every_episodes)
    for level in ("high", "low"):
        books = summary["transitions"][level]
        assert books["produced"] == books["stored"] + books["rejected"] > 0
    lines = (folder / "episodes.jsonl").read_text().splitlines()
    guided = sum(json.loads(line)["low_guide"] for line in lines)
    assert (guided == 0) == (asked.agent.guide_share == 0)
