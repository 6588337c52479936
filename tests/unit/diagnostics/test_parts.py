from zsdist.diagnostics import parts
from zsdist.diagnostics.result import CheckStatus


def test_a_folder_in_which_ray_cannot_start_is_found(monkeypatch):
    monkeypatch.setenv("RAY_TMPDIR", "/" + "x" * 60)
    found = parts.check_ray()
    assert found.status is CheckStatus.FAIL and "RAY_TMPDIR" in found.found and "--single-process" in found.advice


def test_the_camera_and_a_loopback_message_work_here():
    assert parts.check_camera().status is CheckStatus.OK
    assert parts.check_zenoh().status is CheckStatus.OK
