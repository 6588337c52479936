import numpy as np
import pytest

from zsdist.roles.promotion import promoted


def network(seed):
    return {"w": np.random.default_rng(seed).normal(size=(5, 3)).astype(np.float32)}


CANDIDATES = {"recent": network(0), "distilled": network(1), "best": network(2)}


@pytest.mark.parametrize("chosen", CANDIDATES)
def test_where_nothing_was_learned_meanwhile_the_winner_is_promoted_bit_for_bit(chosen):
    found = promoted(chosen, CANDIDATES, {"w": CANDIDATES["recent"]["w"].copy()})
    assert found["w"].dtype == np.float32
    assert np.array_equal(found["w"], CANDIDATES[chosen]["w"])


def test_what_was_learned_meanwhile_is_kept_unless_the_last_winner_wins_again():
    present = network(3)
    learned = present["w"] - CANDIDATES["recent"]["w"]
    assert promoted("recent", CANDIDATES, present) is present
    assert np.array_equal(promoted("distilled", CANDIDATES, present)["w"], CANDIDATES["distilled"]["w"] + learned)
    assert promoted("best", CANDIDATES, present) is CANDIDATES["best"]
