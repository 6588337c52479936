import pytest

from zsdist.dqn.exploration import epsilon


def test_epsilon_decays_per_finished_episode_to_its_minimum():
    assert epsilon(0, 0.995, 0.1) == 1.0
    assert epsilon(100, 0.995, 0.1) == pytest.approx(0.6058, abs=1e-4)
    assert epsilon(459, 0.995, 0.1) > 0.1
    assert epsilon(460, 0.995, 0.1) == epsilon(10_000, 0.995, 0.1) == 0.1
