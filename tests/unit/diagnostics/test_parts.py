from zsdist.diagnostics import parts
from zsdist.diagnostics.result import CheckStatus


def test_the_camera_and_a_loopback_message_work_here():
    assert parts.check_camera().status is CheckStatus.OK
    assert parts.check_zenoh().status is CheckStatus.OK
