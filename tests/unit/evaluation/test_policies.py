import pytest

from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.policies import NamedPolicy, check_together

LEARNED, BASELINE = Contender(Config(), {}), Contender(Config(), baseline="astar")


def test_learned_policies_of_different_weights_are_evaluated_together():
    check_together([NamedPolicy("a", LEARNED, "1"), NamedPolicy("b", LEARNED, "2")], no_shield=True)


@pytest.mark.parametrize(
    ("policies", "no_shield", "words"),
    [
        ([NamedPolicy("astar", BASELINE)], True, "baseline 'astar' has no shield"),
        ([NamedPolicy("a", LEARNED, "1"), NamedPolicy("astar", BASELINE)], False, "'astar' is allowed alone"),
        ([NamedPolicy("a", LEARNED, "1"), NamedPolicy("b", LEARNED, "1")], False, "b has the weights of a"),
    ],
)
def test_other_combinations_are_refused(policies, no_shield, words):
    with pytest.raises(RunError, match=words):
        check_together(policies, no_shield)
