import copy
import pickle
import subprocess
import sys
import threading

import numpy as np
import pytest
import torch

from zsdist.errors import CacheError, ConfigError, WeightsError
from zsdist.vision.exported import cached_session, export, file_sha256

EXAMPLE = np.arange(6, dtype=np.float32).reshape(2, 3)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ZSDIST_CACHE", str(tmp_path / "cache"))


class Twice(torch.nn.Module):
    def forward(self, x):
        return 2 * x


def build(path):
    export(Twice(), EXAMPLE, path, "x", ["y"])


def test_an_exported_network_computes_the_same_as_torch_for_any_batch():
    session = cached_session("twice", build)
    np.testing.assert_allclose(session.run(["y"], {"x": np.ones((5, 3), np.float32)})[0], 2.0)


def test_a_network_is_built_once_and_then_read():
    cached_session("twice", build)
    cached_session("twice", lambda path: pytest.fail("built again"))


def test_concurrent_builders_leave_one_whole_file_and_nothing_else(tmp_path):
    build(tmp_path / "made.onnx")
    content, meet, written = (tmp_path / "made.onnx").read_bytes(), threading.Barrier(2), []

    def together(path):
        path.write_bytes(content[:100])
        written.append(path)
        meet.wait(timeout=30)  # both have a partial file now
        path.write_bytes(content)

    threads = [threading.Thread(target=cached_session, args=("twice", together)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(written)) == 2
    assert [path.name for path in (tmp_path / "cache").iterdir()] == ["twice.onnx"]
    cached_session("twice", build).run(["y"], {"x": EXAMPLE})


def test_a_network_that_differs_from_its_export_is_refused():
    class Drifting(torch.nn.Module):  # its export keeps the first output, as an export in training mode does
        calls = 0

        def forward(self, x):
            self.calls += 1
            return x * self.calls

    with pytest.raises(WeightsError, match="differs from torch"):
        cached_session("drifting", lambda path: export(Drifting(), EXAMPLE, path, "x", ["y"]))


def test_layers_that_behave_differently_in_training_are_exported_in_evaluation_mode():
    dropout = torch.nn.Sequential(torch.nn.Dropout(0.9))
    session = cached_session("dropout", lambda path: export(dropout.train(), EXAMPLE, path, "x", ["y"]))
    np.testing.assert_array_equal(session.run(["y"], {"x": EXAMPLE})[0], EXAMPLE)


def test_a_damaged_file_of_the_cache_is_named(tmp_path):
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / "twice.onnx").write_bytes(b"half a fi")
    with pytest.raises(WeightsError, match=r"twice\.onnx is damaged.*delete it"):
        cached_session("twice", build)


def test_a_cache_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ZSDIST_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(WeightsError, match="ZSDIST_CACHE"):
        cached_session("twice", build)


def test_the_hash_of_a_missing_file_names_it(tmp_path):
    with pytest.raises(WeightsError, match="nowhere"):
        file_sha256(tmp_path / "nowhere")


def test_several_axes_may_have_any_length():
    session = cached_session("free", lambda path: export(Twice(), EXAMPLE, path, "x", ["y"], free=("batch", "length")))
    with pytest.raises(Exception, match="INVALID_ARGUMENT"):
        cached_session("twice", build).run(["y"], {"x": np.ones((1, 8), np.float32)})
    np.testing.assert_allclose(session.run(["y"], {"x": np.ones((1, 8), np.float32)})[0], 2.0)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda session: pickle.loads(pickle.dumps(session))])
def test_a_copy_of_a_session_is_opened_from_its_file(duplicate, tmp_path):
    session = cached_session("twice", build)
    other = duplicate(session)
    assert (other.run(["y"], {"x": EXAMPLE})[0] == session.run(["y"], {"x": EXAMPLE})[0]).all()
    (tmp_path / "cache" / "twice.onnx").unlink()
    with pytest.raises(WeightsError, match=r"twice\.onnx is missing; load the model from its weights"):
        duplicate(session)


def test_what_a_full_or_foreign_cache_says_is_one_line_with_what_to_do(tmp_path, monkeypatch):
    def full(path):
        raise OSError(28, "No space left on device")

    with pytest.raises(
        CacheError, match=r"cache .* cannot be used: No space left.*ZSDIST_CACHE to a folder"
    ) as refusal:
        cached_session("twice", full)
    assert "\n" not in str(refusal.value)


def test_nothing_of_the_use_of_networks_is_reported_to_others():
    code = "import os, zsdist.vision.exported; print(os.environ['ORT_DISABLE_TELEMETRY'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "1\n"


def test_where_there_is_no_gpu_one_that_is_asked_for_is_missed_and_one_that_would_be_nice_is_not():
    session = copy.copy(cached_session("twice", build, "auto"))
    assert session.device == "auto"
    np.testing.assert_allclose(session.run(["y"], {"x": EXAMPLE})[0], 2 * EXAMPLE)
    with pytest.raises(
        ConfigError, match=r"vision.device is 'gpu', .* CPUExecutionProvider here; allowed is .*onnxruntime-gpu"
    ):
        cached_session("twice", build, "gpu")
