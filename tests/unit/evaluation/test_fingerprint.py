from zsdist.common import code_hash
from zsdist.config import Config, load
from zsdist.evaluation import fingerprint
from zsdist.evaluation.contenders import Contender
from zsdist.run import program
from zsdist.types import Level

CONFIG = Config()


def test_the_hash_covers_the_code_that_drives_an_episode_and_nothing_else():
    names = code_hash.modules(fingerprint.ROOT)
    drives = (
        "sim.physics.world",
        "sim.physics.car",
        "vision.visual_act",
        "planning.belief",
        "agent.shield",
        "dqn.network",
    )
    assert {f"zsdist.{name}" for name in drives} | {"zsdist.evaluation.baselines", "zsdist.types"} <= names
    others = ("roles", "run", "transport", "wire", "replay", "protocol", "pretraining", "dqn.learner", "config")
    assert not [name for name in names for other in others if name.startswith(f"zsdist.{other}")]
    measures = ("report", "metrics", "statistics", "episode_store")
    assert not names & {f"zsdist.evaluation.{name}" for name in measures}


def test_the_hash_of_the_code_is_the_same_each_time():
    assert fingerprint.code_sha256() == fingerprint.code_sha256() and len(fingerprint.code_sha256()) == code_hash.DIGITS


def learned(config=CONFIG, **changes):
    parameters = {level: program.make_learner(config, level).parameters() for level in Level}
    return fingerprint.contender_sha256(Contender(config, parameters, **changes))


def test_everything_an_episode_depends_on_changes_the_hash_of_a_contender():
    hashes = [
        learned(),
        learned(variant="hybrid"),
        learned(variant="untrained"),
        learned(variant="oracle-depth"),
        learned(shielded=False),
        learned(load(overrides=("seed=1",))),
        learned(load(overrides=("vision.network=student",))),
        learned(load(overrides=("sim.max_steps=20",))),
        fingerprint.contender_sha256(Contender(CONFIG, baseline="random")),
    ]
    assert len(set(hashes)) == len(hashes)


def test_settings_of_training_do_not_change_the_hash_of_a_contender():
    assert learned(load(overrides=("vision.cache_bytes=0", "run.actors=7", "replay.adaptive=false"))) == learned()
