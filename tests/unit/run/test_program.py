import pytest
from fakes import FakeVisualAct

from zsdist.config import Config, load
from zsdist.run import program


@pytest.fixture
def seen_by():
    return program._seen_by(Config(), FakeVisualAct())


@pytest.mark.parametrize("setting", ["camera.height_m=0.9", "camera.back_end=pybullet", "grid.cells=16"])
def test_what_another_camera_or_lattice_shows_is_another_vision(spec, seen_by):
    assert program._seen_by(load(overrides=(spec,)), FakeVisualAct()) != seen_by


@pytest.mark.parametrize("name", ["encoder_sha256", "weights_sha256"])
def test_what_other_weights_see_is_another_vision(name, seen_by):
    other = FakeVisualAct()
    setattr(other, name, "f" * 64)
    assert program._seen_by(Config(), other) != seen_by


@pytest.mark.parametrize("made_by", ["zsdist.common.code_hash.sha256", "zsdist.run.program.version"])
def test_what_other_code_or_libraries_see_is_another_vision(made_by, seen_by, monkeypatch):
    monkeypatch.setattr(made_by, lambda *_: "another")
    assert program._seen_by(Config(), FakeVisualAct()) != seen_by


def test_a_setting_that_no_reading_depends_on_makes_no_other_vision(seen_by):
    config = load(overrides=("seed=7", "run.episodes=3", "vision.cache_bytes=100000", "low.learning_rate=0.1"))
    assert program._seen_by(config, FakeVisualAct()) == seen_by
