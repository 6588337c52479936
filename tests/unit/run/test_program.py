import threading

import pytest
from fakes import FakeVisualAct

from zsdist import config as configuration
from zsdist.config import Config, load
from zsdist.run import program
from zsdist.run.program import RoleSpec, RunSpec
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Level


@pytest.fixture
def fingerprint():
    return program.reading_fingerprint(Config(), FakeVisualAct())


@pytest.mark.parametrize("override", ["camera.height_m=0.9", "camera.back_end=pybullet", "grid.cells=16"])
def test_another_camera_or_lattice_changes_the_fingerprint_of_readings(override, fingerprint):
    assert program.reading_fingerprint(load(overrides=(override,)), FakeVisualAct()) != fingerprint


@pytest.mark.parametrize("name", ["encoder_sha256", "weights_sha256"])
def test_other_weights_change_it(name, fingerprint):
    other = FakeVisualAct()
    setattr(other, name, "f" * 64)
    assert program.reading_fingerprint(Config(), other) != fingerprint


@pytest.mark.parametrize("made_by", ["zsdist.common.code_hash.sha256", "zsdist.run.program.version"])
def test_other_code_or_libraries_change_it(made_by, fingerprint, monkeypatch):
    monkeypatch.setattr(made_by, lambda *_: "another")
    assert program.reading_fingerprint(Config(), FakeVisualAct()) != fingerprint


def test_a_setting_that_no_reading_depends_on_does_not_change_it(fingerprint):
    config = load(overrides=("seed=7", "run.episodes=3", "vision.cache_bytes=100000", "low.learning_rate=0.1"))
    assert program.reading_fingerprint(config, FakeVisualAct()) == fingerprint


def test_a_level_learns_by_the_learner_that_the_specification_of_the_run_makes(tmp_path):
    made = []

    def make_dqn(settings, level):
        made.append(level)
        return program.make_learner(settings, level)

    spec = RunSpec(load(overrides=configuration.ONE_PROCESS), "run", tmp_path, {}, None, make_dqn=make_dqn)
    transport = MemoryTransport(MemoryBroker(), "learner-low")
    spec.build(RoleSpec("learner", "low", 3), transport, threading.Event())
    assert made == [Level.LOW]
