"""What an image leaves out: files that nothing reads."""

import runpy
from types import SimpleNamespace

from deployments import DEPLOY

slim = SimpleNamespace(**runpy.run_path(str(DEPLOY / "slim.py")))


def test_what_nothing_reads_is_listed_and_removed(tmp_path):
    for name in (
        "pybullet_data/plane.urdf",
        "torch/test/a",
        "torch/bin/protoc",
        "torch/bin/torch_shm_manager",
        "other/a",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1234")
    found = slim.unread(tmp_path)
    assert [str(path.relative_to(tmp_path)) for path in found] == ["pybullet_data", "torch/bin/protoc", "torch/test"]
    assert sum(map(slim.size, found)) == 12
    for path in found:
        slim.remove(path)
    assert slim.unread(tmp_path) == []
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == ["a", "torch_shm_manager"]
