"""Films as a browser gets them: codec, pixels and order of the file, read back by PyAV."""

import os

import av
import numpy as np
import pytest
from PIL import Image

from zsdist.errors import RunError
from zsdist.reporting import film_file


def pictures(count=12, size=(62, 94)):
    rows, columns = np.mgrid[0 : size[0], 0 : size[1]]
    for number in range(count):
        yield np.stack([columns * 2 % 256, rows * 4 % 256, np.full(size, 20 * number)], -1).astype(np.uint8)


def test_a_film_is_h264_that_browsers_play_and_that_begins_with_its_index(tmp_path):
    film_file.write(pictures(), tmp_path / "film.mp4", still=7)
    content = (tmp_path / "film.mp4").read_bytes()
    assert 0 < content.find(b"moov") < content.find(b"mdat")
    with av.open(str(tmp_path / "film.mp4")) as container:
        (stream,) = container.streams
        assert (stream.codec_context.name, stream.pix_fmt, stream.frames) == ("h264", "yuv420p", 12)
        assert stream.average_rate == film_file.FRAMES_PER_SECOND
        read = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(read) == 12
    for got, expected in zip(read, pictures(), strict=True):
        assert np.abs(got.astype(int) - expected).mean() < 6
    still = np.asarray(Image.open(tmp_path / "film.jpg")).astype(int)
    assert np.abs(still - list(pictures())[7]).mean() < 4
    assert sorted(os.listdir(tmp_path)) == ["film.jpg", "film.mp4"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_an_interrupted_film_is_not_there_and_an_older_one_stays(tmp_path, error):
    def broken():
        yield from pictures(9)
        raise error

    with pytest.raises(error):
        film_file.write(broken(), tmp_path / "film.mp4", still=1)
    assert os.listdir(tmp_path) == []
    film_file.write(pictures(), tmp_path / "film.mp4", still=1)
    before = (tmp_path / "film.mp4").read_bytes()
    with pytest.raises(error):
        film_file.write(broken(), tmp_path / "film.mp4", still=1)
    assert (tmp_path / "film.mp4").read_bytes() == before
    assert sorted(os.listdir(tmp_path)) == ["film.jpg", "film.mp4"]


def test_a_film_that_cannot_be_written_is_named_in_one_line(tmp_path):
    with pytest.raises(RunError, match=r"film .*none/film.mp4 cannot be written: No such file") as raised:
        film_file.write(pictures(), tmp_path / "none" / "film.mp4", still=1)
    assert "\n" not in str(raised.value)
