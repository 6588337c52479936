import subprocess
import sys

import numpy as np
import pytest

from zsdist.common import half_precision

EVERY = np.arange(2**16, dtype=np.uint16).view(np.float16)


def bits(column):
    return column.view(np.uint16 if column.dtype == np.float16 else np.uint32)


def test_every_half_float_is_converted_to_its_value_and_back_to_itself():
    with np.errstate(invalid="ignore"):
        expected = EVERY.astype(np.float32)
    wide, numbers = half_precision.from_half(EVERY), ~np.isnan(EVERY)
    assert np.array_equal(bits(wide)[numbers], bits(expected)[numbers]) and np.isnan(wide[~numbers]).all()
    assert np.array_equal(bits(half_precision.to_half(wide))[numbers], bits(EVERY)[numbers])
    assert np.isnan(half_precision.to_half(wide)[~numbers]).all()


@pytest.mark.filterwarnings("ignore:overflow")
def test_values_between_are_rounded_to_the_nearest_and_ties_to_even():
    finite = np.sort(EVERY[np.isfinite(EVERY)].astype(np.float32))
    middles = ((finite[1:].astype(np.float64) + finite[:-1]) / 2).astype(np.float32)
    beside = [np.nextafter(middles, np.float32(side)) for side in (-np.inf, np.inf)]
    other = np.random.default_rng(0).normal(size=100_000) * 10.0 ** np.random.default_rng(1).integers(-9, 6, 100_000)
    edges = np.array([65519.996, 65520.0, 1e30, np.inf, -np.inf, 2**-25, 2**-26, 0.0, -0.0], np.float32)
    for values in (middles, *beside, other.astype(np.float32), edges):
        assert np.array_equal(bits(half_precision.to_half(values)), bits(values.astype(np.float16)))


def test_shapes_are_kept_and_columns_need_not_be_contiguous():
    column = np.random.default_rng(0).random((6, 4, 8), np.float32)[::2, :, ::2]
    assert np.array_equal(half_precision.to_half(column), column.astype(np.float16))
    assert np.array_equal(
        half_precision.from_half(column.astype(np.float16)[:, ::2]), column.astype(np.float16)[:, ::2]
    )
    assert half_precision.to_half(column[:0]).shape == (0, 4, 4)


@pytest.mark.parametrize("module", ["zsdist.run.ray", "zsdist.launch", "zsdist.evaluation.workers", "zsdist.monitor"])
def test_modules_that_do_not_learn_do_not_import_torch(module):
    found = f"import sys, {module}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", found], check=False).returncode == 0
