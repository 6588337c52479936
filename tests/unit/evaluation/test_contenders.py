import numpy as np
import pytest
from fakes import FakeVisualAct, LatticeEnv

from zsdist.config import load
from zsdist.dqn import network
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.contenders import VARIANTS, Contender
from zsdist.evaluation.drivers import Observability
from zsdist.evaluation.workers import Simulation, make_runner
from zsdist.roles.shapes import initial_weights
from zsdist.run import program
from zsdist.sim.scenes import families
from zsdist.types import Level, Outcome

CONFIG = load(overrides=("sim.max_steps=60", "seed=5"))
TRAINED = {level: program.make_learner(load(), level).parameters() for level in Level}
ASKED = []


def make_env(config, *, images, exact):
    ASKED.append((images, exact))
    return LatticeEnv(config=config)


KINEMATIC = Simulation(make_env, lambda config: FakeVisualAct())


def drive(contender, index=0):
    scene = families.draw("iid", "validation", index)
    return make_runner(contender, KINEMATIC).drive(scene, np.random.default_rng(0))


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_drives(variant):
    assert drive(Contender(CONFIG, TRAINED, variant=variant)).steps > 0


@pytest.mark.parametrize("baseline", BASELINES)
def test_every_baseline_drives(baseline):
    assert drive(Contender(CONFIG, baseline=baseline)).steps > 0


@pytest.mark.parametrize("variant", ["untrained-high", "untrained-low", "untrained"])
def test_untrained_levels_have_fresh_networks_of_the_same_shapes_and_the_others_their_own(variant):
    contender = Contender(CONFIG, TRAINED, variant=variant)
    for level in Level:
        fresh = level in VARIANTS[variant].untrained
        assert (network.sha256(contender.networks[level]) != network.sha256(TRAINED[level])) == fresh
        assert {k: v.shape for k, v in contender.networks[level].items()} == {
            k: v.shape for k, v in TRAINED[level].items()
        }


@pytest.mark.parametrize("seed", [0, 1, 7])
def test_untrained_weights_are_those_with_which_the_policy_began_its_training(seed):
    config = load(overrides=(f"seed={seed}",))
    networks = Contender(config, TRAINED, variant="untrained").networks
    for level in Level:
        began = program.make_learner(config, level).parameters()
        assert (
            network.sha256(networks[level]) == network.sha256(began) == network.sha256(initial_weights(config, level))
        )


def test_with_planners_on_both_levels_the_weights_do_not_matter():
    one, other = (
        drive(Contender(CONFIG, {level: initial_weights(of, level) for level in Level}, variant="oracle-levels"))
        for of in (CONFIG, load(overrides=("seed=1",)))
    )
    assert one.poses == other.poses and one.outcome is Outcome.SUCCESS


def test_variants_leave_the_policys_own_configuration_alone():
    contender = Contender(CONFIG, TRAINED, variant="hybrid")
    assert (contender.settings.agent.high_policy, contender.settings.agent.low_policy) == ("learned", "planner")
    assert contender.config is CONFIG and Contender(CONFIG, TRAINED).settings == CONFIG


def test_environments_have_pictures_and_exact_motion_where_a_contender_needs_them():
    asked = {}
    for variant in ("full", "oracle-depth", "oracle-motion"):
        make_runner(Contender(CONFIG, TRAINED, variant=variant), KINEMATIC)
        asked[variant] = ASKED[-1]
    assert asked == {"full": (True, False), "oracle-depth": (False, False), "oracle-motion": (True, True)}
    make_runner(Contender(CONFIG, TRAINED, variant="oracle-depth"), KINEMATIC, images=True)
    assert ASKED[-1] == (True, False)
    assert Contender(CONFIG, TRAINED, variant="oracle-depth").observability is Observability.RANGES
