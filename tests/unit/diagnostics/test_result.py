from zsdist.diagnostics.result import CheckStatus, guarded
from zsdist.errors import ZsdistError


def test_an_exception_in_a_check_is_that_checks_failure():
    def broken():
        raise ZsdistError("the camera\nis gone")

    result = guarded("camera", broken)
    assert result.status is CheckStatus.FAIL and "the camera is gone" in result.found
