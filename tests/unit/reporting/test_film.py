import math

import cv2
import numpy as np
import pytest
from fakes import FakeVisualAct, LatticeEnv

from zsdist import config
from zsdist.errors import RunError
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.drivers import LearnedDriver, Observability
from zsdist.evaluation.episodes import EpisodeRunner
from zsdist.evaluation.oracle_view import by_camera
from zsdist.evaluation.workers import Simulation
from zsdist.reporting import film, film_file
from zsdist.run import program
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Action, Level, Pose
from zsdist.vision.visual_act import Observation

CONFIG = config.load(overrides=("sim.max_steps=3", "camera.size_px=64"))
SCENE = Scene(
    "made",
    "grass",
    Start(-5.3125, 0.3125, 0.0),
    (5.9375, 0.3125),
    (Obstacle("tree", 0.0, 4.0, radius_m=1.0), Obstacle("box", 2.0, -5.0, size_m=(3.0, 1.0, 2.0))),
)


class Looking(FakeVisualAct):
    """Vision model with attention at the upper left for forward, the lower left for left, the lower right for right.

    It believes the nearest obstacle of every direction in one bin.
    """

    def __init__(self, nearest_bin=0):
        super().__init__()
        self._nearest_bin = nearest_bin

    def read(self, images):
        reading = super().read(images)
        clearance = np.zeros_like(reading.clearance)
        clearance[..., self._nearest_bin] = 1.0
        return reading._replace(clearance=clearance)

    def observe(self, images):
        attention = np.zeros((len(images), 3, 196), np.float32)
        attention[:, 0, 0] = attention[:, 1, 182] = attention[:, 2, 195] = 1.0
        return Observation(attention, np.zeros((len(images), 4, 8), np.float32))


@pytest.fixture(scope="module")
def moments():
    parameters = {level: program.make_learner(CONFIG, level).parameters() for level in Level}
    driver, seen = LearnedDriver(CONFIG, parameters, by_camera(FakeVisualAct())), []
    EpisodeRunner(LatticeEnv(config=CONFIG), CONFIG, driver, Observability.CAMERA, lambda: 0.0).drive(
        SCENE, np.random.default_rng(0), seen.append
    )
    return seen


def panel(picture, index):
    left = index * (film.PANEL_PX + film.GAP_PX)
    return picture[: film.PANEL_PX, left : left + film.PANEL_PX].astype(int)


def test_every_action_has_its_frames_and_the_end_is_held(moments):
    pictures = list(film.frames(moments, CONFIG, None))
    assert len(pictures) == 3 * film.FRAMES_PER_ACTION + film.LAST_FRAMES
    assert len({picture.shape for picture in pictures}) == 1
    assert (pictures[-1] == pictures[-film.LAST_FRAMES]).all()
    assert all(side % 2 == 0 for side in pictures[0].shape[:2])  # the codec needs even sides


def test_a_film_read_back_shows_what_was_written(moments, tmp_path):
    pictures = list(film.frames(moments, CONFIG, None))
    film_file.write(iter(pictures), tmp_path / "film.mp4", still=7)
    reader = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    read = []
    while (got := reader.read())[0]:
        read.append(cv2.cvtColor(got[1], cv2.COLOR_BGR2RGB))
    assert len(read) == len(pictures)
    assert np.abs(read[0].astype(int) - pictures[0]).mean() < 6
    still = cv2.cvtColor(cv2.imread(str(tmp_path / "film.jpg")), cv2.COLOR_BGR2RGB)
    assert np.abs(still.astype(int) - pictures[7]).mean() < 3


def test_attention_is_shown_where_the_network_attends_for_the_action_taken(moments):
    bare, looked = (next(iter(film.frames(moments, CONFIG, eye))) for eye in (None, Looking()))
    changed = np.abs(panel(bare, 1) - panel(looked, 1)).sum(-1)[40:]
    row, column = np.unravel_index(changed.argmax(), changed.shape)
    half = film.PANEL_PX / 2
    corners = {0: (True, True), 1: (False, True), 2: (False, False)}  # upper?, left?
    directions = {
        Action.FORWARD: 0,
        Action.LEFT_45: 1,
        Action.TURN_LEFT_90: 1,
        Action.RIGHT_45: 2,
        Action.TURN_RIGHT_90: 2,
    }
    assert (row + 40 < half, column < half) == corners[directions[Action(moments[0].action)]]
    assert (panel(bare, 0) == panel(looked, 0)).all() and (panel(bare, 2) == panel(looked, 2)).all()


def test_attention_fades_where_nothing_is_believed_to_be_in_range(moments):
    bare, blank = (next(iter(film.frames(moments, CONFIG, eye))) for eye in (None, Looking(nearest_bin=-1)))
    assert (panel(bare, 1) == panel(blank, 1)).all()


def test_the_map_shows_seen_ground_and_grows(moments):
    pictures = list(film.frames(moments, CONFIG, None))
    white = [(panel(picture, 2) > 250).all(-1).sum() for picture in (pictures[0], pictures[-1])]
    assert 0 < white[0] <= white[1]


def test_the_caption_names_the_decision_and_the_outcome(moments):
    first, second = film.caption(moments[0], 1, 3)
    assert first.startswith("made") and "action 1 of at most 3" in first
    assert "R_p:  forward" in second and "option:" in second and "shield" in second
    assert film.caption(moments[-1], 3, 3)[1] == "ended: timeout"


@pytest.mark.parametrize(
    ("share", "expected"),
    [(0.0, (0.0, 0.0, 0.0)), (0.2, (0.0, 0.0, 45.0)), (0.4, (0.0, 0.0, 90.0)), (0.7, (0.0, 1.0, 90.0))],
)
def test_between_two_poses_the_car_turns_first_and_then_moves(share, expected):
    pose = film.between(Pose(0.0, 0.0, 0.0), Pose(0.0, 2.0, math.pi / 2), Action.LEFT_45, share)
    assert (pose.x_m, pose.y_m, math.degrees(pose.heading_rad)) == pytest.approx(expected, abs=1e-6)


def test_between_headings_the_car_turns_the_shorter_way():
    pose = film.between(Pose(0, 0, 3.0), Pose(0, 0, -3.0), Action.TURN_LEFT_90, 0.5)
    assert abs(pose.heading_rad) == pytest.approx(math.pi)


def test_a_folder_that_cannot_be_made_is_refused_in_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match=r"--video .* cannot be written"):
        film.film(None, [SCENE], 0, tmp_path / "file" / "films", print)


def test_each_scene_becomes_a_film_and_a_still_named_by_its_outcome(tmp_path):
    simulation = Simulation(lambda config, **_: LatticeEnv(config=config), lambda config: FakeVisualAct())
    films = []
    files = film.film(
        Contender(CONFIG, baseline="random"), [SCENE, SCENE], 0, tmp_path / "films", films.append, simulation
    )
    assert films == files and all(file.stat().st_size > 1000 for file in files)
    names = [file.stem.rpartition("-") for file in files]
    assert [name[0] for name in names] == ["00-made", "01-made"]
    assert {name[2] for name in names} <= {"timeout", "collision", "success"}
    assert sorted(tmp_path.glob("films/*.jpg")) == [file.with_suffix(".jpg") for file in files]
