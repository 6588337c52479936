import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from zsdist import config, errors
from zsdist.run import nursery, nursery_process, nursery_shim

PATIENCE_S = 60.0
WORKER = """
import json, os, signal, sys
print(json.dumps({"arguments": sys.argv[1:], "parent": os.getppid(), "folder": os.getcwd(), "name": __name__,
                  "word": os.environ.get("A_WORD"), "loaded": "zsdist.run.role_host" in sys.modules}), flush=True)
sys.stdin.read()
"""
LAUNCHER = """
import sys
from zsdist.run import nursery
with nursery.employed():
    import os
    print(os.environ["ZSDIST_NURSERY"], flush=True)
    sys.stdin.read()
"""
pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="there is no nursery on other systems")


@pytest.fixture
def worker(tmp_path):
    """File of a worker as a raylet names it, with a `setup_worker.py` beside it that only says so."""
    path = tmp_path / "worker.py"
    path.write_text(WORKER)
    (tmp_path / nursery_shim.SETUP).write_text("import sys; print('set up', *sys.argv[1:])")
    return path


def shim(worker, *arguments, **environment):
    """Start a worker as the raylet does."""
    command = [sys.executable, nursery_shim.__file__, str(worker), *arguments]
    pipe = subprocess.PIPE
    return subprocess.Popen(
        command, stdin=pipe, stdout=pipe, text=True, cwd=worker.parent, env=os.environ | environment
    )


@pytest.mark.integration
def test_a_worker_is_a_fork_that_has_everything_loaded(worker):
    with nursery.employed():
        started = shim(worker, "--worker-id=7", "--language=PYTHON", "--serialized-runtime-env-context={}", A_WORD="x")
        seen = json.loads(started.stdout.readline())
        assert started.wait(PATIENCE_S) == 0  # it has handed over
        assert seen["arguments"] == ["--worker-id=7"]
        assert (seen["word"], seen["folder"], seen["name"]) == ("x", str(worker.parent), "__main__")
        assert "nursery_process" in " ".join(psutil.Process(seen["parent"]).cmdline())
        started.stdin.close()  # the fork has its streams, and ends
        assert started.stdout.read() == ""
        with nursery.employed():  # there is one already
            assert [nursery.is_employed(), len(psutil.Process().children())] == [True, 1]
    assert not nursery.is_employed()
    assert not psutil.pid_exists(seen["parent"])


@pytest.mark.parametrize(
    "arguments", [(), ('--serialized-runtime-env-context={"env_vars": {}}',), ("--language=JAVA",)]
)
def test_a_worker_starts_by_itself_without_a_nursery(worker, arguments):
    started = shim(worker, *arguments, **{nursery_shim.VARIABLE: f"1:{worker.parent / 'nothing'}"})
    output, _ = started.communicate(timeout=PATIENCE_S)
    assert output.split()[:3] == ["set", "up", str(worker)]
    assert nursery_shim.is_plain(["worker.py", *arguments]) == (not arguments)


@pytest.mark.integration
def test_forks_do_not_outlive_a_killed_launcher(worker):
    launcher = subprocess.Popen(
        [sys.executable, "-c", LAUNCHER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    started = shim(worker, **{nursery_shim.VARIABLE: launcher.stdout.readline().strip()})
    parent = psutil.Process(json.loads(started.stdout.readline())["parent"])
    (fork,) = parent.children()
    launcher.send_signal(signal.SIGKILL)
    launcher.communicate()
    parent.wait(PATIENCE_S)
    fork.wait(PATIENCE_S)
    started.communicate()


def test_the_word_of_another_launcher_is_not_ours(monkeypatch):
    monkeypatch.setenv(nursery_shim.VARIABLE, f"{os.getpid() + 1}:/somewhere")
    assert not nursery.is_employed()


def test_an_error_of_the_preparation_is_that_of_the_command():
    settings = config.load(None, ("scenes.test=[nowhere]",))
    answer = nursery_process.prepared(settings.model_dump_json())
    assert set(answer) == {"error", "message"}
    assert issubclass(getattr(errors, answer["error"]), errors.ZsdistError)
    assert "nowhere" in answer["message"]


@pytest.mark.integration
def test_the_launcher_gets_the_error_of_the_preparation():
    with nursery.employed(), pytest.raises(errors.ZsdistError, match="nowhere"):
        nursery.prepare(config.load(None, ("scenes.test=[nowhere]",)), list)


def test_a_nursery_that_has_died_is_named(monkeypatch, tmp_path: Path):
    monkeypatch.setenv(nursery_shim.VARIABLE, f"{os.getpid()}:{tmp_path / 'nothing'}")
    with pytest.raises(errors.RunError, match="has died"):
        nursery.prepare(config.load(None, ()), list)
