"""A launcher that is killed with all its roles: the next start goes on, and nothing acknowledged is lost."""

import contextlib
import json
from collections import defaultdict
from dataclasses import replace

import pytest
import rehearsal
from rehearsal import Tap

from zsdist.common import folders
from zsdist.config import load
from zsdist.run import directory, inline, killed_start, program
from zsdist.run.program import RunSpec
from zsdist.run.training import check_accounts
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.wire import codec
from zsdist.wire.messages import Ack, Push


class KilledError(Exception):
    """All processes are gone."""


class Launch:
    """One start of a run; it is killed after a number of rounds, or as soon as orders fulfil a condition."""

    def __init__(self, spec, fatal=None):
        self.spec, self.tap, self._fatal, self._rounds = spec, Tap(), fatal, 0
        epochs = directory.issue_epochs(spec.folder, program.epoch_count(spec.config))
        with contextlib.suppress(KilledError):
            self._run(replace(spec, launch=epochs[0]), epochs)
        self.sent, self.acknowledged = defaultdict(dict), defaultdict(int)
        for message in (item for kind in ("push", "ack") for item in self.tap.by_kind()[kind]):
            if isinstance(message, Push):
                self.sent[message.stream, message.actor, message.epoch][message.sequence + 1] = message.produced
            elif isinstance(message, Ack) and message.stream in ("high", "low"):
                stream = (message.stream, message.actor, message.epoch)
                self.acknowledged[stream] = max(self.acknowledged[stream], message.received)

    def _run(self, spec, epochs):
        """Run all roles as processes of their own would run, without sittings, on a virtual clock."""
        broker = MemoryBroker()

        def connect(role_spec):
            return MemoryTransport(broker, role_spec.name)

        supervisor = connect(program.supervisor(epochs))
        with contextlib.closing(inline.Runner(spec, epochs, supervisor, connect, RunSpec.build)) as runner:
            runner.run(inline.VirtualClock(0.0), lambda: False, self._watch)

    def _watch(self, transport, now):
        before = len(self.tap.messages)
        self.tap(transport, now)
        self._rounds += 1
        if self._rounds == self._fatal:
            raise KilledError
        for message in self.tap.messages[before:]:
            if "/control/" in message.key and self._is_fatal(codec.decode(message.payload).content):
                raise KilledError

    def _is_fatal(self, orders):
        return callable(self._fatal) and self._fatal(orders)

    def transitions(self, level):
        """Return the number of acknowledged transitions of a level."""
        return sum(
            self.sent[stream][frames] for stream, frames in self.acknowledged.items() if frames and stream[0] == level
        )


def next_start(spec, *overrides):
    """Return the specification of the start after one that was killed, and what the user is told."""
    settings, states = directory.reopen(spec.folder, overrides)
    told = []
    killed = killed_start.find(spec.folder, settings, told.append)
    return replace(spec, config=settings, states=states, start=killed.word), told


def ended(folder):
    summary = json.loads((folder / "summary.json").read_text())
    check_accounts(summary)
    lines = rehearsal.episodes(folder)
    assert [line["finished_as"] for line in lines] == list(range(1, 9))
    assert sorted(line["episode"] for line in lines) == list(range(1, 9))
    assert summary["episodes"] == 8 and summary["ended"] == "complete"
    assert [merge["episode"] for merge in summary["merges"]] == [4, 8]
    assert summary["env_steps"] == sum(line["steps"] for line in lines)
    assert sum(summary["outcomes"].values()) == 8
    return summary


def compares(orders):
    return orders.get("driven") and not orders["chosen"]


def promotes(orders):
    return orders.get("chosen")


def closes(orders):
    return orders.get("closing")


@pytest.mark.parametrize("fatal", [(60, 60), (compares,), (promotes, closes)])
def test_no_acknowledged_transition_and_no_episode_is_lost_or_counted_twice(tmp_path, fatal):
    spec, launches = rehearsal.start(tmp_path / "run"), []
    for when in fatal:
        launches.append(Launch(spec, when))
        assert not (tmp_path / "run" / "summary.json").exists(), "the run had ended before it was killed"
        spec, told = next_start(spec)
        assert told == []
    launches.append(Launch(spec))
    summary = ended(tmp_path / "run")
    for level in ("high", "low"):
        acknowledged = [launch.transitions(level) for launch in launches]
        assert acknowledged[0] and summary["transitions"][level]["produced"] >= sum(acknowledged)


def test_a_run_may_go_on_with_fewer_actors_and_more_episodes(tmp_path):
    spec = rehearsal.start(tmp_path / "run")
    Launch(spec, 90)
    spec, told = next_start(spec, "run.actors=1", "run.episodes=9")
    Launch(spec)
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    check_accounts(summary)
    assert summary["episodes"] == 9 and told == []


def test_other_settings_of_the_replay_or_a_missing_journal_lead_back_to_the_checkpoint_and_say_so(tmp_path):
    spec = rehearsal.start(tmp_path / "run")
    Launch(spec, 90)
    told = []
    assert killed_start.find(spec.folder, load(spec.folder / "config.yaml"), told.append).word == spec.start
    assert killed_start.find(spec.folder, load(spec.folder / "config.yaml", ("replay.n_step=5",)), told.append) is None
    for base in folders.visible(spec.folder / "journal" / f"{spec.start}-0" / "low", "*.[bc]*"):  # and its copy
        base.unlink()
    assert killed_start.find(spec.folder, load(spec.folder / "config.yaml"), told.append) is None
    assert "settings of the replay have changed" in told[0] and "low is missing" in told[1]
    assert all("resumed from its last checkpoint" in line for line in told)


def test_a_start_that_had_ended_is_not_gone_on_with(tmp_path):
    spec = rehearsal.start(tmp_path / "run")
    Launch(spec)
    assert killed_start.has_ledger(spec.folder)
    assert killed_start.find(spec.folder, spec.config, pytest.fail) is None
