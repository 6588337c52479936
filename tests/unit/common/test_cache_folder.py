import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from zsdist.common.cache_folder import cache_folder, compiled_code_folder, prepare_matplotlib
from zsdist.errors import CacheError

USED = ("ZSDIST_CACHE", "NUMBA_CACHE_DIR", "MPLCONFIGDIR")


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """Return a home folder, with nothing stated and a folder for temporary files beside it."""
    for name in USED:
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "home").mkdir()
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    return tmp_path / "home"


@pytest.fixture
def without_home(home, monkeypatch):
    """Put a file where the home folder is, which no user can write into, root included."""
    home.rmdir()
    home.write_text("")


def test_a_stated_folder_is_the_cache_even_if_it_does_not_exist(tmp_path, monkeypatch):
    monkeypatch.setenv("ZSDIST_CACHE", str(tmp_path / "stated"))
    assert cache_folder() == tmp_path / "stated" and not cache_folder().exists()


def test_a_stated_folder_may_be_relative_or_in_the_home_folder(tmp_path, home, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ZSDIST_CACHE", "near")
    assert cache_folder() == tmp_path / "near"
    monkeypatch.setenv("ZSDIST_CACHE", "~/far")
    assert cache_folder() == home / "far"


def test_a_stated_home_folder_that_is_not_known_is_refused_in_one_line(monkeypatch):
    monkeypatch.setenv("ZSDIST_CACHE", "~nobody-here/cache")
    with pytest.raises(CacheError, match=r"ZSDIST_CACHE is '~nobody-here/cache'.*path of a folder"):
        cache_folder()
    assert compiled_code_folder() is None


def test_nothing_stated_gives_the_home_folder(home):
    assert cache_folder() == home / ".cache" / "zsdist"


def test_a_user_without_a_home_folder_gets_a_private_folder_for_temporary_files(tmp_path, without_home):
    assert cache_folder() == tmp_path / "tmp" / f"zsdist-cache-{os.getuid()}"
    assert cache_folder().stat().st_mode & 0o777 == 0o700


def test_a_temporary_folder_that_others_may_write_or_that_is_a_link_is_not_trusted(tmp_path, without_home):
    folder = tmp_path / "tmp" / f"zsdist-cache-{os.getuid()}"
    folder.mkdir()
    folder.chmod(0o777)
    with pytest.raises(CacheError, match=r"no cache can be written.*ZSDIST_CACHE"):
        cache_folder()
    folder.rmdir()
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    folder.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(CacheError):
        cache_folder()


def test_nothing_that_can_be_written_is_one_line_with_all_that_was_tried(tmp_path, home, without_home, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(home))
    with pytest.raises(CacheError) as refusal:
        cache_folder()
    text = str(refusal.value)
    assert "\n" not in text and str(home / ".cache" / "zsdist") in text and "ZSDIST_CACHE" in text
    assert compiled_code_folder() is None


def test_compiled_code_is_in_the_cache_unless_numbas_own_variable_states_another_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("ZSDIST_CACHE", str(tmp_path / "stated"))
    assert compiled_code_folder() == tmp_path / "stated" / f"numba-{os.getuid()}"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numbas"))
    assert compiled_code_folder() == tmp_path / "numbas"


def test_a_stated_folder_that_cannot_be_written_leaves_code_without_a_cache(home, without_home, monkeypatch):
    monkeypatch.setenv("ZSDIST_CACHE", str(home / "cache"))
    assert compiled_code_folder() is None


def test_matplotlib_keeps_its_folder_where_the_home_folder_can_be_written():
    prepare_matplotlib()
    assert "MPLCONFIGDIR" not in os.environ


def test_matplotlib_writes_into_the_cache_where_the_home_folder_cannot_be_written(without_home, monkeypatch):
    monkeypatch.setitem(os.environ, "MPLCONFIGDIR", "")  # restored at the end
    del os.environ["MPLCONFIGDIR"]
    prepare_matplotlib()
    assert Path(os.environ["MPLCONFIGDIR"]) == cache_folder() / "matplotlib"


KERNEL = """
import pathlib
from zsdist.common.compiled import compiled

@compiled()
def twice(x):
    return 2 * x

print(twice(2.0), sorted(path.suffix for path in pathlib.Path(FOLDER).rglob("*.nb?")))
"""


@pytest.mark.parametrize(("stated", "written"), [("cache", "['.nbc', '.nbi']"), ("file/cache", "[]")])
def test_a_kernel_works_with_its_code_in_the_cache_and_without_a_cache(tmp_path, stated, written):
    (tmp_path / "file").write_text("")
    (tmp_path / "kernel.py").write_text(KERNEL.replace("FOLDER", repr(str(tmp_path))))
    environment = os.environ | {"ZSDIST_CACHE": str(tmp_path / stated)}
    command = [sys.executable, str(tmp_path / "kernel.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert (done.stdout.strip(), done.stderr) == (f"4.0 {written}", "")
