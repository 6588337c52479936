from collections import defaultdict

import pytest
from rehearsal import Tap, episodes, rehearse, resume, start

from zsdist.dqn import network
from zsdist.run.checkpoint import load_policy
from zsdist.types import Level
from zsdist.vision.reading_cache import SET_BYTES
from zsdist.wire.messages import Ack, Candidate, Jobs, Push, Records, WeightsMessage

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    tap = Tap()
    spec = start(tmp_path_factory.mktemp("runs") / "one")
    return spec, rehearse(spec, watch=tap), tap.by_kind()


def test_two_runs_with_one_seed_end_in_equal_weights(run, tmp_path):
    _, summary, _ = run
    again = rehearse(start(tmp_path / "two"))
    assert again["weights"]["sha256"] == summary["weights"]["sha256"]
    assert again["transitions"] == summary["transitions"]
    other = rehearse(start(tmp_path / "three", "seed=1", "run.episodes=4"))
    assert other["weights"]["sha256"] != summary["weights"]["sha256"]


def driven(messages):
    """Return the last statistics of each actor in each sitting that was long enough for a second report."""
    reports = defaultdict(list)
    for one in messages["stats"]:
        if one["role"] == "actor":
            reports[one["id"], one["epoch"]].append(one)
    return {key: found[-1] for key, found in reports.items() if len(found) > 1 and found[-1]["started_episodes"]}


def test_only_the_end_of_the_last_sitting_looks_like_the_end_of_the_run(run):
    _, _, messages = run
    told = [one for one in messages["stats"] if one["role"] == "scheduler"]
    assert told[-1]["stage"] == "done"
    assert {one["episodes"] for one in told if one["stage"] != "train"} == {8}
    assert len({one["epoch"] for one in told}) > 1  # there were several sittings


def test_the_size_of_the_cache_changes_how_often_the_model_runs_and_nothing_else(run, tmp_path, monkeypatch):
    _, summary, messages = run
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    tap = Tap()
    small = rehearse(start(tmp_path / "small", f"vision.cache_bytes={SET_BYTES}"), watch=tap)
    assert small["weights"]["sha256"] == summary["weights"]["sha256"]
    last, last_small = (list(driven(every).values()) for every in (messages, tap.by_kind()))
    for fields, fields_small in zip(last, last_small, strict=True):
        readings = fields["cache_hits"] + fields["cache_misses"]
        assert (
            readings == fields["env_steps"] + fields["started_episodes"]
        )  # one more for the last state of each episode
        assert fields["cache_bypasses"] == 0  # these cars stand on the lattice
        assert fields["cache_hits"] >= fields_small["cache_hits"] >= 0
    assert sum(one["cache_hits"] for one in last) > sum(one["cache_hits"] for one in last_small)


def test_a_second_run_finds_all_readings_in_the_cache_and_learns_the_same(run, tmp_path):
    _, summary, _ = run
    tap = Tap()
    again = rehearse(start(tmp_path / "again"), watch=tap)
    assert again["weights"]["sha256"] == summary["weights"]["sha256"]
    assert all(fields["cache_hits"] > fields["cache_misses"] == 0 for fields in driven(tap.by_kind()).values())


def test_the_counts_balance_and_every_lease_is_finished_once(run):
    spec, summary, _ = run
    for counts in summary["transitions"].values():
        assert counts["produced"] == counts["stored"] + counts["rejected"] > 0
        assert counts["abandoned_at_most"] == 0
    assert sorted(record["episode"] for record in episodes(spec.folder)) == list(range(1, 9))
    assert sum(summary["outcomes"].values()) == summary["episodes"] == 8
    assert summary["env_steps"] == sum(record["steps"] for record in episodes(spec.folder))
    assert summary["transitions"]["low"]["produced"] == summary["env_steps"]


def test_transitions_flow_from_every_actor_to_the_replay(run):
    _, summary, messages = run
    pushes = [message for message in messages["push"] if isinstance(message, Push)]
    assert {push.actor for push in pushes} == {"actor-0", "actor-1"}
    assert {push.stream for push in pushes} == set(Level)
    for level in Level:
        unique = {(push.actor, push.epoch, push.sequence): push.count for push in pushes if push.stream is level}
        assert sum(unique.values()) == summary["transitions"][level]["stored"]


def test_the_replay_acknowledges_and_grants_credit_to_every_stream(run):
    _, _, messages = run
    acks = [ack for ack in messages["ack"] if isinstance(ack, Ack)]
    for actor in ("actor-0", "actor-1"):
        for stream in ("high", "low", "episodes", "evaluation"):
            assert max(ack.received for ack in acks if (ack.actor, ack.stream) == (actor, stream)) > 0
        granted = defaultdict(list)  # in each sitting, in which an actor has an epoch of its own
        for ack in acks:
            if (ack.actor, ack.stream) == (actor, "low"):
                granted[ack.epoch].append(ack.credit)
        assert next(iter(granted.values()))[0] is None  # unlimited until learning starts
        for credits in granted.values():
            limits = [credit for credit in credits if credit is not None]
            while_open = limits[: limits.index(max(limits)) + 1] if limits else []  # then it is what was produced
            assert while_open == sorted(while_open)
        assert limits[-1] > 0


def test_actors_act_with_the_weights_that_the_learners_broadcast(run):
    spec, summary, messages = run
    for level in Level:
        broadcast = [message for message in messages["weights"] if message.weights.level is level]
        assert all(isinstance(message, WeightsMessage) for message in broadcast)
        versions = {message.weights.version for message in broadcast}
        acted = [record[f"{level}_version"] for record in episodes(spec.folder)]
        assert set(acted) <= versions
        assert max(acted) > min(acted)  # later episodes were driven with newer weights
        assert broadcast[-1].sha256 == summary["weights"]["sha256"][level]
        assert max(one.get(f"{level}_weight_version", 0) for one in messages["stats"] if one["role"] == "actor") > 0


def test_both_learners_update_at_the_configured_pace(run):
    spec, summary, _ = run
    for level, settings in ((Level.HIGH, spec.config.high), (Level.LOW, spec.config.low)):
        counts = summary["transitions"][level]
        updates = summary["learner_updates"][level]
        assert 0 < updates <= counts["stored"] * settings.updates_per_insert
        assert updates > 0.6 * counts["stored"] * settings.updates_per_insert  # the run ends before the last ones
        assert counts["sampled"] > 0


def test_the_scheduler_leases_episodes_and_receives_the_result_of_each(run):
    _, _, messages = run
    jobs = [message for message in messages["evaluation"] if isinstance(message, Jobs)]
    leased = {number for message in jobs for number in message.content["leases"]}
    assert leased == set(range(1, 9))
    reports = [message for message in messages["episodes"] if isinstance(message, Records)]
    assert {record["episode"] for report in reports for record in report.records} == set(range(1, 9))


def test_each_merge_drives_candidates_on_equal_scenes_and_promotes_the_best(run):
    _, summary, messages = run
    assert [merge["episode"] for merge in summary["merges"]] == [4, 8]
    assert summary["merges"][0]["candidates"] == ["recent", "distilled"]
    assert summary["merges"][1]["candidates"] == ["recent", "distilled", "best"]
    offered = {(one.level, one.merge, one.name) for one in messages["candidate"] if isinstance(one, Candidate)}
    assert len(offered) == 2 * (2 + 3)
    jobs = {tuple(drive) for one in messages["evaluation"] if isinstance(one, Jobs) for drive in one.content["drives"]}
    assert jobs == {(name, scene) for name in ("recent", "distilled", "best") for scene in (0, 1)}
    results = [record for one in messages["evaluation"] if isinstance(one, Records) for record in one.records]
    for merge in summary["merges"]:  # two scenes are too few for `best` to be better by more than chance
        learned = {name: merge["scores"][name] for name in ("recent", "distilled")}
        assert learned[merge["chosen"]] == max(learned.values())
        driven = [record for record in results if record["merge"] == summary["merges"].index(merge) + 1]
        cost = merge["cost"]
        assert (cost["drives"], cost["actions"]) == (len(driven), sum(record["steps"] for record in driven))
        assert cost["seconds"] > 0
    for index in (1, 2):
        scenes = {record["scene_index"]: record["scene"] for record in results if record["merge"] == index}
        assert all(record["scene"] == scenes[record["scene_index"]] for record in results if record["merge"] == index)
    merged = [message.merge for message in messages["weights"]]
    assert max(merged) == 2


def test_drives_of_candidates_do_not_count_as_training(run):
    _, summary, messages = run
    results = [record for one in messages["evaluation"] if isinstance(one, Records) for record in one.records]
    assert results
    assert all(record["epsilon"] == 0 and "episode" not in record for record in results)
    assert sum(summary["outcomes"].values()) == 8


def test_every_role_publishes_its_statistics_and_a_token(run):
    _, _, messages = run
    roles = {("scheduler", "0"), ("replay", "0"), ("actor", "0"), ("actor", "1")}
    roles |= {("learner", "high"), ("learner", "low")}
    assert {(one["role"], one["id"]) for one in messages["stats"]} == roles
    assert all({"time_s", "host", "pid", "epoch"} <= set(one) for one in messages["stats"])
    came = {key.split("/", 3)[3] for key, payload in messages["alive"] if payload == b"1"}
    assert came == {f"{role}/{one}" for role, one in roles}


def test_a_resumed_run_continues_and_appends_to_its_files(tmp_path):
    first = rehearse(start(tmp_path / "run", "run.episodes=4"))
    second = rehearse(resume(tmp_path / "run", "run.episodes=7"))
    assert (first["episodes"], second["episodes"]) == (4, 7)
    assert sorted(record["episode"] for record in episodes(tmp_path / "run")) == list(range(1, 8))
    for level in Level:
        assert second["learner_updates"][level] > first["learner_updates"][level]
        assert second["weights"]["version"][level] > first["weights"]["version"][level]
        counts = second["transitions"][level]
        assert counts["stored"] > first["transitions"][level]["stored"]
        assert counts["produced"] == counts["stored"] + counts["rejected"]
    assert [merge["episode"] for merge in second["merges"]] == [4, 7]
    assert second["wall_s"] > first["wall_s"]


def test_an_interruption_saves_the_last_checkpoint_and_counts_no_episode_after_it(tmp_path):
    rounds = iter(range(10**9))
    summary = rehearse(start(tmp_path / "run", "run.episodes=100"), interrupted=lambda: next(rounds) > 150)
    assert summary["ended"] == "interrupted"
    assert 0 < summary["episodes"] == len(episodes(tmp_path / "run")) < 100
    for counts in summary["transitions"].values():
        assert counts["produced"] == counts["stored"] + counts["rejected"] > 0
    finished = rehearse(resume(tmp_path / "run", f"run.episodes={summary['episodes'] + 2}"))
    assert finished["ended"] == "complete"
    numbers = [record["episode"] for record in episodes(tmp_path / "run")]
    assert len(numbers) == len(set(numbers)) == summary["episodes"] + 2


def test_a_run_interrupted_in_its_last_merge_repeats_it_when_resumed(tmp_path):
    tap = Tap()

    def merging():
        return any(one.content["drives"] for one in tap.by_kind()["evaluation"] if isinstance(one, Jobs))

    many = ("run.episodes=4", "merge.validation_scenes=20", "merge.drop_after_scenes=20")
    first = rehearse(start(tmp_path / "run", *many), watch=tap, interrupted=merging)
    assert (first["episodes"], first["ended"], first["merges"]) == (3, "interrupted", [])
    spec, before = resume(tmp_path / "run"), episodes(tmp_path / "run")
    second = rehearse(spec)
    assert (second["episodes"], second["ended"]) == (4, "complete")
    assert [merge["episode"] for merge in second["merges"]] == [4]
    assert episodes(tmp_path / "run")[:3] == before


def test_a_run_ends_with_the_policy_of_the_last_merge_even_when_updates_are_due(tmp_path):
    tap, pace = Tap(), 30
    paces = (f"low.updates_per_insert={pace}", f"high.updates_per_insert={pace}")
    spec = start(tmp_path / "run", "merge.every_episodes=8", *paces)
    summary = rehearse(spec, watch=tap)
    chosen = summary["merges"][-1]["chosen"]
    policy = load_policy(spec.folder)
    for level in Level:
        assert 0 < summary["learner_updates"][level] < pace * summary["transitions"][level]["stored"]
        offered = [one for one in tap.by_kind()["candidate"] if (one.level, one.name) == (level, chosen)]
        assert network.sha256(policy.parameters[level]) == network.sha256(offered[0].parameters)


def test_a_checkpoint_holds_the_policy_that_was_broadcast_last(run):
    spec, summary, _ = run
    policy = load_policy(spec.folder)
    assert set(policy.parameters) == set(Level)
    assert policy.config == spec.config
    for level in Level:
        assert network.sha256(policy.parameters[level]) == summary["weights"]["sha256"][level]


def test_credit_suffices_when_an_episode_ends_on_the_first_step_of_an_option(tmp_path):
    overrides = ("agent.option_max_steps=4", "sim.max_steps=5", "low.min_size=16", "run.episodes=24")
    summary = rehearse(start(tmp_path / "run", *overrides, "merge.every_episodes=100"))
    assert summary["outcomes"]["timeout"] > 0
    for counts in summary["transitions"].values():
        assert counts["produced"] == counts["stored"] == summary["env_steps"]
