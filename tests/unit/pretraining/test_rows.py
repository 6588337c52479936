import numpy as np
import pytest

from zsdist.pretraining.rows import Rows


def test_rows_of_several_files_are_indexed_like_one_array(tmp_path):
    whole = np.arange(60).reshape(12, 5)
    paths = []
    for number, part in enumerate(np.split(whole, [4, 5])):
        paths.append(tmp_path / f"{number}.npy")
        np.save(paths[-1], part)
    rows = Rows.read(paths)
    assert len(rows) == 12 and rows.shape == (12, 5) and rows.dtype == whole.dtype
    for index in (slice(None), slice(3, 9, 2), np.array([11, 0, 4, 4, -1]), whole[:, 0] > 20, np.array([], int)):
        assert (rows[index] == whole[index]).all()
    assert (np.asarray(rows) == whole).all()
    with pytest.raises(IndexError):
        rows[np.array([12])]
