import numpy as np
import pytest
from fakes import FakeVisualAct, LatticeEnv

from zsdist.agent.blocks import GOAL_CHOICE
from zsdist.agent.features import HIGH_STATE_SIZE
from zsdist.config import Config
from zsdist.dqn import network
from zsdist.evaluation.drivers import LearnedDriver, Observability
from zsdist.evaluation.episodes import EpisodeRunner
from zsdist.evaluation.oracle_view import by_camera
from zsdist.reporting import guidance
from zsdist.reporting.maps import DrivenPath
from zsdist.run import program
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Level

CONFIG = Config()
WALL = Obstacle("box", 0.0, 0.0, size_m=(0.5, 25.0, 2.0))  # the eastern half cannot be reached
POLES = tuple(Obstacle("pole", -11.0, north, radius_m=0.2) for north in (-11.0, 11.0))
SCENES = {
    "open": Scene("open", "grass", Start(-5.3125, 0.3125, 0.0), (5.9375, 0.3125), POLES),
    "walled": Scene("walled", "grass", Start(-5.3125, 0.3125, 0.0), (5.9375, 0.3125), (WALL, *POLES)),
}


def of_network(scene, parameters):
    env, visual_act = LatticeEnv(config=CONFIG), FakeVisualAct()
    learned = {level: program.make_learner(CONFIG, level).parameters() for level in Level}
    moments = []
    config = CONFIG.model_copy(update={"sim": CONFIG.sim.model_copy(update={"max_steps": 30})})
    runner = EpisodeRunner(
        LatticeEnv(config=config),
        config,
        LearnedDriver(config, learned, by_camera(visual_act)),
        Observability.CAMERA,
        float,
    )
    runner.drive(scene, np.random.default_rng(0), moments.append)
    env.reset(options={"scene": scene})
    known = moments[-1].thought.situation
    return known, guidance.guidance_of(CONFIG, parameters or learned[Level.HIGH], known, env.picture, visual_act)


def always(choice, value):
    """Return a network that prefers one choice for any input."""
    parameters = network.initial_parameters(HIGH_STATE_SIZE, GOAL_CHOICE + 1, (8,), 0)
    parameters["output.weight"][:] = 0.0
    parameters["output.bias"][choice] = value
    return parameters


def test_a_network_that_values_only_the_goal_points_to_it_from_everywhere():
    known, found = of_network(SCENES["open"], always(GOAL_CHOICE, 3.0))
    goal = np.array(SCENES["open"].goal)
    assert np.isfinite(found.pull).sum() >= 12
    for by, bx in zip(*np.nonzero(np.isfinite(found.pull)), strict=True):
        rows, columns = known.grid.block_cells(bx, by)
        middle = np.array(known.grid.centre((columns.start + columns.stop) // 2, (rows.start + rows.stop) // 2))
        away = goal - middle
        if np.hypot(*away) > 6.0:
            assert found.towards[by, bx] @ away / np.hypot(*away) > 0.8


def test_a_network_without_preference_has_no_pull():
    _, found = of_network(SCENES["open"], always(GOAL_CHOICE, 0.0))
    assert found.pull[np.isfinite(found.pull)] == pytest.approx(0.0)


def test_directions_are_of_unit_length_where_a_block_is_reachable_and_missing_elsewhere():
    _, found = of_network(SCENES["walled"], None)
    known = np.isfinite(found.pull)
    np.testing.assert_allclose(np.hypot(*found.towards[known].T), 1.0)
    assert np.isnan(found.towards[~known]).all()


def test_guidance_is_drawn_for_each_drive(tmp_path):
    _, found = of_network(SCENES["open"], None)
    path = DrivenPath(np.array([[-5.0, 0.0], [5.0, 0.0]]), "success", "made")
    drives = [guidance.Drive(scene, path, found) for scene in SCENES.values()]
    assert guidance.draw_guidance(drives, CONFIG, tmp_path) == "fig10-guidance.png"
    drawing = (tmp_path / "fig10-guidance.svg").read_text()
    assert all(f">{name}<" in drawing for name in SCENES)
