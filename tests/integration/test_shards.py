import pytest
from rehearsal import Tap, episodes, rehearse, resume, start

from zsdist.errors import ConfigError
from zsdist.run import directory, preflight
from zsdist.types import Level
from zsdist.wire.messages import Push

pytestmark = pytest.mark.integration
TWO = ("replay.shards=2", "run.actors=3")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    tap = Tap()
    spec = start(tmp_path_factory.mktemp("runs") / "two", *TWO, "run.episodes=24", "merge.every_episodes=12")
    return spec, rehearse(spec, watch=tap), tap.by_kind()


def last(messages, role):
    return {one["id"]: one for one in messages["stats"] if one["role"] == role}


def test_the_counts_balance_over_all_shards(run):
    spec, summary, messages = run
    replays = last(messages, "replay")
    assert set(replays) == {"0", "1"}
    for level in Level:
        counts = summary["transitions"][level]
        assert counts["produced"] == counts["stored"] + counts["rejected"] == summary["env_steps"]
        for name, total in counts.items():
            assert sum(one[f"{level}_{name}"] for one in replays.values()) == total
    assert sorted(record["episode"] for record in episodes(spec.folder)) == list(range(1, 25))


def test_each_shard_stores_what_its_actors_push_and_nothing_else(run):
    _, _, messages = run
    for level in Level:
        pushed = {
            (push.actor, push.epoch, push.sequence): push.count
            for push in messages["push"]
            if isinstance(push, Push) and push.stream is level
        }
        for identifier, one in last(messages, "replay").items():
            mine = sum(count for (actor, *_), count in pushed.items() if int(actor[-1]) % 2 == int(identifier))
            assert one[f"{level}_stored"] == mine > 0


def test_updates_per_insert_follow_the_setting_in_each_shard_and_overall(run):
    spec, summary, messages = run
    for level, settings in ((Level.HIGH, spec.config.high), (Level.LOW, spec.config.low)):
        for one in last(messages, "replay").values():
            assert one[f"{level}_updates_served"] <= one[f"{level}_stored"] * settings.updates_per_insert
        served = sum(one[f"{level}_updates_served"] for one in last(messages, "replay").values())
        stored = summary["transitions"][level]["stored"]
        assert 0.9 * settings.updates_per_insert < served / stored <= settings.updates_per_insert
        assert summary["learner_updates"][level] <= served


def test_sizes_are_divided_in_proportion_to_the_actors(run):
    _, _, messages = run
    for level in Level:
        large, small = (last(messages, "replay")[identifier][f"{level}_capacity"] for identifier in ("0", "1"))
        assert large == pytest.approx(2 * small, abs=2)


def test_two_runs_with_one_seed_and_two_shards_end_in_equal_weights(tmp_path):
    one, two = (rehearse(start(tmp_path / name, *TWO)) for name in ("one", "two"))
    assert one["weights"]["sha256"] == two["weights"]["sha256"]
    assert one["transitions"] == two["transitions"]


def test_a_run_with_priorities_n_steps_and_shards_balances_and_repeats(tmp_path):
    options = (*TWO, "replay.prioritised=true", "replay.n_step=3")
    tap = Tap()
    one = rehearse(start(tmp_path / "one", *options), watch=tap)
    two = rehearse(start(tmp_path / "two", *options))
    assert one["weights"]["sha256"] == two["weights"]["sha256"]
    for level in Level:
        counts = one["transitions"][level]
        assert counts["produced"] == counts["stored"] + counts["rejected"] == one["env_steps"]
        for replay in "01":
            told = [one for one in tap.by_kind()["stats"] if (one["role"], one["id"]) == ("replay", replay)]
            assert all(one[f"{level}_prioritised"] <= one[f"{level}_sampled"] for one in told)
            assert any(one[f"{level}_prioritised"] for one in told)


def test_a_run_can_be_resumed_with_more_shards_but_not_with_fewer(tmp_path):
    first = rehearse(start(tmp_path / "run", "run.episodes=4"))
    second = rehearse(resume(tmp_path / "run", "run.episodes=8", "replay.shards=2"))
    for level in Level:
        counts = second["transitions"][level]
        assert counts["produced"] == counts["stored"] + counts["rejected"] > first["transitions"][level]["produced"]
    assert len(list((tmp_path / "run").glob("checkpoints/00000008/replay*.state"))) == 2
    settings, states = directory.reopen(tmp_path / "run", ("replay.shards=1",))
    with pytest.raises(ConfigError, match=r"replay\.shards is 1 and the checkpoint holds 2; allowed are 2 or more"):
        preflight.check_shards(settings, states)
