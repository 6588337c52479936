import pytest

from zsdist.diagnostics.result import CheckStatus, guarded
from zsdist.errors import ZsdistError


def test_an_exception_in_a_check_is_that_checks_failure():
    def broken():
        raise ZsdistError("the camera\nis gone")

    result = guarded("camera", broken)
    assert result.status is CheckStatus.FAIL and "the camera is gone" in result.found and not result.advice


@pytest.mark.parametrize(
    ("error", "advice"),
    [
        (ImportError("no module ray"), "Install zsdist again"),
        (PermissionError(13, "Permission denied", "/x"), "can be used by this user"),
        (MemoryError(), "more memory"),
        (RuntimeError("no locator"), "report it"),
    ],
)
def test_the_advice_fits_the_exception_and_is_not_always_to_install_again(error, advice):
    def broken():
        raise error

    result = guarded("camera", broken)
    assert result.status is CheckStatus.FAIL and advice in result.advice
    assert ("Install" in result.advice) == isinstance(error, ImportError)
