import numpy as np
import pytest

from zsdist.errors import DecodeError
from zsdist.piloting.pictures import fit


def ramp(height, width):
    picture = np.zeros((height, width, 3), np.uint8)
    picture[..., 0] = np.arange(width) * 255 // width
    return picture


def test_a_square_picture_is_taken_as_it_is():
    picture = ramp(64, 64)
    assert fit(picture, None, 90.0) is picture


def test_another_shape_needs_the_angle():
    with pytest.raises(DecodeError, match="pictures are 640 x 480; give the camera's angle by --camera-fov-deg"):
        fit(ramp(480, 640), None, 90.0)


def test_a_wider_camera_is_cut_to_the_wanted_angle():
    fitted = fit(ramp(480, 640), 90.0, 60.0)
    assert fitted.shape == (370, 370, 3)  # 640 tan 30 / tan 45 pixels
    assert abs(int(fitted[0, 185, 0]) - 127) <= 2


def test_a_narrower_camera_gets_its_edge_repeated():
    fitted = fit(ramp(480, 640), 60.0, 90.0)
    side = fitted.shape[0]
    assert fitted.shape == (side, side, 3) and side == 1109
    assert (fitted[:, 0] == fitted[:, 200]).all() and fitted[0, side // 2, 0] == pytest.approx(127, abs=2)
