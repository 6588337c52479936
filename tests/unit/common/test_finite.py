import numpy as np
import pytest

from zsdist.common import finite
from zsdist.errors import RunError


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_number_that_is_not_finite_is_found_wherever_it_is(value):
    for place in range(5):
        numbers = np.ones(5, np.float32)
        numbers[place] = value
        assert not finite.all_finite(numbers)
        with pytest.raises(RunError, match=f"values hold {value}, 1 of 5 numbers"):
            finite.require("values", numbers)


def test_finite_numbers_are_accepted_however_large_their_sum_is():
    finite.require("values", np.full(100, np.finfo(np.float32).max))
    finite.require("values", np.array([np.finfo(np.float64).max] * 2))
    finite.require("values", np.zeros(0))
