import re

import pytest

from zsdist.common import code_hash
from zsdist.config import Config, load
from zsdist.errors import RunError
from zsdist.evaluation import fingerprint
from zsdist.evaluation.contenders import Contender
from zsdist.run import program
from zsdist.types import Level

CONFIG = Config()
A, B, C = "a" * 16, "b" * 16, "c" * 16
ENTRY = "- {{commit: 1a2b3c4, hashes: {}, proof: equal episodes}}\n"


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
    names = names - {"zsdist.roles.shapes"}  # the weights that training begins with, and `untrained` drives with
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


def listing(tmp_path, text):
    file = tmp_path / "equivalent_code.yaml"
    file.write_text(text)
    return file


def test_listed_hashes_are_equivalent_to_those_of_their_entry_and_others_to_themselves_alone(tmp_path):
    file = listing(tmp_path, ENTRY.format(f'["{A}", "{B}"]') + ENTRY.format(f'["{C}"]'))
    classes = [fingerprint.equivalent(code, file) for code in (A, B, C, "d" * 16)]
    assert classes == [{A, B}, {A, B}, {C}, {"d" * 16}]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hashes: [", "is not valid YAML"),
        ("- {a: 1, a: 2}", "key 'a' appears twice"),
        ("", "holds a NoneType; allowed is a list of entries"),
        ("- {commit: 1a2b3c4}", "entry 1 is {'commit': 1a2b3c4}; allowed is a mapping with commit, hashes, proof"),
        (f'- {{commit: a1, hashes: ["{A}"], proof: " "}}', "entry 1: proof is ' '; allowed is a text"),
        (
            f'- {{commit: a1, hashes: ["{A}"], proof: "a\\nb"}}',
            "entry 1: proof is 'a\\nb'; allowed is a text in one line",
        ),
        (ENTRY.format("[]"), "entry 1: hashes is []; allowed is a list of one or more"),
        (ENTRY.format("[ABC]"), "hash is ABC; allowed are 16 hexadecimal digits in quotes"),
        (ENTRY.format(f"[{A}]") * 2, f"entry 2: hash {A} is in an earlier entry too"),
    ],
)
def test_a_damaged_list_of_equivalent_code_is_refused_in_one_line(tmp_path, text, message):
    with pytest.raises(RunError, match=re.escape(message)) as caught:
        fingerprint.equivalent(A, listing(tmp_path, text))
    assert "equivalent_code.yaml" in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_list_of_equivalent_code_is_refused(tmp_path):
    with pytest.raises(RunError, match=r"equivalent code cannot be read from .*none\.yaml: No such file"):
        fingerprint.equivalent(A, tmp_path / "none.yaml")


def test_the_list_in_the_package_is_sound_and_accepts_the_code_in_use():
    assert fingerprint.code_sha256() in fingerprint.equivalent(fingerprint.code_sha256())
