import pytest

from zsdist.common import atomic_files


def test_a_file_is_replaced_whole_and_nothing_is_left_beside_it(tmp_path):
    path = tmp_path / "file"
    for content in (b"first", b"the second, longer", b""):
        atomic_files.replace(path, content)
        assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


def test_a_write_that_breaks_off_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "file"
    atomic_files.replace(path, b"old")

    def breaks_off(place, content):
        place.write_bytes(content[:1])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(atomic_files, "write", breaks_off)
    with pytest.raises(OSError, match="No space"):
        atomic_files.replace(path, b"new")
    assert path.read_bytes() == b"old"
