from made_runs import RESULT, make_run

from zsdist.reporting import runs, tables
from zsdist.reporting.runs import Evaluation


def evaluation(scenes, policy="trained", method="full", seed=0, **changes):
    sha256 = None if method is None else RESULT["weights_sha256"]
    return Evaluation(RESULT | {"scenes": scenes, "policy": policy, "weights_sha256": sha256} | changes, method, seed)


def rows_of(lines):
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in lines
        if line.startswith("| ") and "---" not in line
    ]


def test_table_4_holds_the_papers_figures_beside_ours_and_says_that_they_are_not_the_same_test():
    lines = tables.table_4([evaluation("ood-layout"), evaluation("iid")])
    rows = rows_of(lines)
    assert ["(b) layout", "paper: proposed", "11.91%", "3.12%", "-", "-"] in rows
    ours = [row for row in rows if row[0].startswith("`")]
    assert ours == [["`ood-layout`", "full", "90.0% (60.0-98.0)", "10.0% (2.0-40.0)", "0.60 (0.50-0.70)", "10"]]
    assert any("not the same test" in line for line in lines)


def test_table_4_without_evaluations_says_so_and_invents_none():
    lines = tables.table_4([evaluation("iid")])
    assert len(rows_of(lines)) == 1 + 6 and any(line.startswith("Left out: our figures") for line in lines)


def test_several_seeds_are_their_mean_with_the_least_and_the_greatest():
    several = [evaluation("ood-layout", seed=seed, success=rate) for seed, rate in enumerate((0.8, 0.9, 1.0))]
    (row,) = [row for row in rows_of(tables.table_4(several)) if row[1] == "full"]
    assert row[2] == "90.0% (seeds 80.0-100.0)" and row[-1] == "10 + 10 + 10"


def test_of_two_evaluations_of_one_policy_the_longer_one_counts():
    twice = [evaluation("ood-layout", episodes=5, success=0.2), evaluation("ood-layout", episodes=50, success=0.5)]
    for order in (twice, twice[::-1]):
        (row,) = [row for row in rows_of(tables.table_4(order)) if row[1] == "full"]
        assert row[2].startswith("50.0%") and row[-1] == "50"


def test_policies_are_compared_on_each_kind_of_scenes_best_first():
    lines = tables.every_policy(
        [evaluation("iid"), evaluation("iid", "astar", None, None, success=1.0), evaluation("ood-all", "b", None, None)]
    )
    assert [line for line in lines if line.startswith("###")] == ["### `iid`", "### `ood-all`"]
    assert [row[0] for row in rows_of(lines)] == ["policy", "astar", "full", "policy", "b"]


def test_one_policy_alone_is_no_comparison():
    assert tables.every_policy([evaluation("iid")])[0].startswith("Left out: the comparison")


def test_the_singleton_table_has_the_papers_values_and_the_runs_of_enough_episodes(tmp_path):
    long = make_run(tmp_path / "a", episodes=40)
    short = make_run(tmp_path / "b", "seed=1")
    material = runs.read([long, short])
    seen = [evaluation("singleton", method="default", seed=0)]
    rows = {row[0]: row[1:] for row in rows_of(tables.singleton(material.methods, seen))}
    assert rows["paper: proposed"][1] == "297" and rows["paper: proposed"][3] == "480"
    assert rows["default, seed 0"][0] == "2.0" and rows["default, seed 0"][-1] == "0.70"
    assert rows["default, seed 1"][:4] == ["-", "-", "-", "-"] and rows["default, seed 1"][-1] == "not evaluated"


def test_training_collisions_are_counted_over_all_seeds(tmp_path):
    places = [make_run(tmp_path / str(seed), f"seed={seed}", episodes=4) for seed in range(2)]
    (row,) = rows_of(tables.training_outcomes(runs.read(places).methods))[1:]
    assert row[:6] == ["default", "2", "8", "8", "0", "0"] and row[6].startswith("0.0% (0.0-")


def test_merges_are_listed_with_the_promoted_candidate_in_bold(tmp_path):
    merge = {"episode": 9, "candidates": ["recent", "best"], "chosen": "best", "scores": {"recent": 0.2, "best": 0.5}}
    merge["scenes_driven"] = {"recent": 6, "best": 20}
    folder = make_run(tmp_path / "a", summary={"merges": [merge]})
    (row,) = rows_of(tables.merges([runs.read_run(folder)]))[1:]
    assert row == ["default, seed 0", "9", "recent +0.20 on 6, **best +0.50 on 20**"]
