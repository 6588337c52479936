from made_runs import RESULT, make_run

from zsdist.reporting import runs, tables
from zsdist.reporting.runs import Evaluation


def evaluation(scenes, label="full", seed=0, learned=True, **changes):
    about = {"scenes": scenes, "policy": label, "weights_sha256": RESULT["weights_sha256"] if learned else None}
    return Evaluation(RESULT | about | changes, label, label if learned else None, seed)


def outcomes(*succeeded):
    return [{"scene": f"s{index}", "outcome": "success" if one else "timeout"} for index, one in enumerate(succeeded)]


def rows_of(lines):
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in lines
        if line.startswith("| ") and "---" not in line
    ]


def test_table_4_holds_the_papers_figures_beside_ours_and_states_that_they_are_not_the_same_test():
    lines = tables.table_4([evaluation("ood-layout"), evaluation("iid")])
    rows = rows_of(lines)
    assert ["(b) layout", "paper: proposed", "11.91%", "3.12%", "-", "-"] in rows
    ours = [row for row in rows if row[0].startswith("`")]
    assert ours == [["`ood-layout`", "full", "90.0% (60.0-98.0)", "10.0% (2.0-40.0)", "0.60 (0.50-0.70)", "10"]]
    assert any("not the same test" in line for line in lines)


def test_table_4_without_evaluations_reports_that_they_are_missing():
    lines = tables.table_4([evaluation("iid")])
    assert len(rows_of(lines)) == 1 + 6 and any(line.startswith("Left out: our figures") for line in lines)


def test_several_seeds_are_their_interquartile_mean_with_an_interval_over_seeds_and_scenes():
    several = [
        evaluation("ood-layout", seed=seed, success=rate, per_scene=outcomes(1, 1, seed))
        for seed, rate in enumerate((2 / 3, 1.0))
    ]
    (row,) = [row for row in rows_of(tables.table_4(several)) if row[1] == "full"]
    assert row[2].startswith("83.3% (2 seeds 33.3-100.0)") and row[-1] == "10 + 10"


def test_seeds_that_drove_different_scenes_are_their_mean_with_minimum_and_maximum():
    several = [
        evaluation("ood-layout", seed=seed, success=rate, per_scene=outcomes(*[1] * (seed + 1)))
        for seed, rate in enumerate((0.8, 0.9, 1.0))
    ]
    (row,) = [row for row in rows_of(tables.table_4(several)) if row[1] == "full"]
    assert row[2] == "90.0% (seeds 80.0-100.0)"


def test_the_longer_of_two_evaluations_of_one_policy_counts():
    twice = [evaluation("ood-layout", episodes=5, success=0.2), evaluation("ood-layout", episodes=50, success=0.5)]
    for order in (twice, twice[::-1]):
        (row,) = [row for row in rows_of(tables.table_4(order)) if row[1] == "full"]
        assert row[2].startswith("50.0%") and row[-1] == "50"


def test_table_4_lists_trained_policies_without_variants_and_baselines():
    drove = [
        evaluation("ood-layout", "full, hybrid", variant="hybrid"),
        evaluation("ood-layout", "full, oracle-depth", variant="oracle-depth"),
        evaluation("ood-layout", "astar", learned=False),
    ]
    assert [row[1] for row in rows_of(tables.table_4(drove)) if row[0].startswith("`")] == ["full, hybrid"]


def test_policies_are_compared_on_each_kind_of_scenes_best_first():
    best = evaluation("iid", "astar", learned=False, success=1.0)
    lines = tables.every_policy([evaluation("iid"), best, evaluation("ood-all", "b", learned=False)], None)
    assert [line for line in lines if line.startswith("###")] == ["### `iid`", "### `ood-all`"]
    assert [row[0] for row in rows_of(lines)] == ["policy", "astar", "full", "policy", "b"]


def test_one_policy_alone_is_no_comparison():
    assert tables.every_policy([evaluation("iid")], None)[0].startswith("Left out: the comparison")


def test_policies_are_compared_with_the_reference_on_the_scenes_that_both_drove():
    ours = evaluation("iid", per_scene=outcomes(1, 1, 1, 0))
    theirs = evaluation("iid", "other", per_scene=outcomes(1, 0, 0, 0)[:3])
    rows = {row[0]: row[-1] for row in rows_of(tables.every_policy([ours, theirs], "full"))}
    assert rows["full"] == "-" and rows["other"].startswith("-66.7 (") and rows["other"].endswith("; 3)")


def test_a_paired_difference_of_equal_evaluations_is_zero_with_an_interval_of_zero_width():
    same = [evaluation("iid", per_scene=outcomes(1, 0, 1))]
    assert tables.paired_success(same, same) == (0.0, 0.0, 0.0, 3)


def test_a_scene_that_was_driven_twice_is_paired_each_time():
    twice = [{"scene": "s", "outcome": how} for how in ("success", "timeout")]
    ours, theirs = [evaluation("a", per_scene=twice)], [evaluation("a", per_scene=twice[::-1])]
    assert tables.paired_success(ours, theirs)[0] == 0.0 and tables.paired_success(ours, theirs)[3] == 2
    assert tables.paired_success(ours, [evaluation("a", per_scene=outcomes(1))]) is None


def test_seeds_count_with_their_mean_in_each_scene():
    two = [evaluation("iid", seed=seed, per_scene=outcomes(seed, 1)) for seed in range(2)]
    assert tables.paired_success(two, [evaluation("iid", per_scene=outcomes(0, 0))])[0] == 0.75


def test_oracles_are_listed_with_their_policy_only_in_their_own_table():
    drove = [
        evaluation("iid"),
        evaluation("iid", "full, oracle-depth", variant="oracle-depth"),
        evaluation("iid", "full, hybrid", variant="hybrid"),
        evaluation("iid", "astar", learned=False),
        evaluation("ood-all"),
    ]
    lines = tables.oracles(drove, "full")
    assert [line for line in lines if line.startswith("###")] == ["### `iid`"]
    assert {row[0] for row in rows_of(lines)} == {"policy", "full", "full, hybrid", "full, oracle-depth"}
    assert "full, oracle-depth" not in "".join(tables.every_policy(drove, "full"))
    assert tables.oracles(drove[:1], "full")[0].startswith("Left out: oracles")


def test_a_rate_without_an_interval_of_its_own_gets_one():
    bare = evaluation("iid", "full, no shield", shielded=False, confidence_95={}, success=0.5)
    (row,) = [row for row in rows_of(tables.every_policy([evaluation("iid"), bare], None)) if "no shield" in row[0]]
    assert row[1] == "50.0% (23.7-76.3)"


def test_the_singleton_table_has_the_papers_values_and_the_runs_of_enough_episodes(tmp_path):
    long = make_run(tmp_path / "a", episodes=40)
    short = make_run(tmp_path / "b", "seed=1")
    material = runs.read([long, short])
    seen = [evaluation("singleton", "default")] * 2  # as a JSON and as a file of episodes
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
