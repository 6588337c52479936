"""Maps of Nav2, by the rules of its map_server."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image

from zsdist.errors import SceneError
from zsdist.sim.maps import nav2
from zsdist.sim.maps.nav2 import Rules

HEAD = "image: m.png\nresolution: 0.05\norigin: [2.0, 3.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"


def read(folder, text=HEAD, values=((0, 254), (205, 100))):
    Image.fromarray(np.array(values, np.uint8)).save(folder / "m.png")
    (folder / "m.yaml").write_text(text)
    return nav2.read(folder / "m.yaml")


@pytest.mark.parametrize(
    ("rules", "greys"),
    [
        # what map_server makes of each grey value
        (Rules("trinary", False, 0.65, 0.196), {0: 100, 89: 100, 90: -1, 100: -1, 205: -1, 206: 0, 254: 0, 255: 0}),
        (Rules("trinary", False, 0.65, 0.25), {0: 100, 89: 100, 90: -1, 191: -1, 192: 0, 205: 0, 254: 0}),
        (Rules("trinary", True, 0.65, 0.196), {0: 0, 49: 0, 50: -1, 165: -1, 166: 100, 254: 100, 255: 100}),
        (Rules("trinary", False, 0.5, 0.5), {0: 100, 127: 100, 128: 0, 255: 0}),
        (Rules("trinary", False, 0.2, 0.6), {0: 100, 101: 100, 102: 0, 204: 0, 255: 0}),  # both: free
        (Rules("scale", False, 0.65, 0.25), {0: 100, 89: 100, 90: 99, 128: 62, 140: 50, 191: 0, 192: 0, 255: 0}),
        (Rules("scale", True, 0.9, 0.1), {0: 0, 25: 0, 128: 50, 229: 100, 230: 100, 26: 0, 40: 7}),
        (Rules("raw", False, 0.65, 0.25), {0: 0, 1: 1, 99: 99, 100: 100, 101: -1, 127: -1, 128: -1, 255: -1}),
        (Rules("raw", True, 0.65, 0.25), {0: 0, 100: 100, 255: -1}),
    ],
)
def test_grey_becomes_occupancy_as_in_map_server(rules, greys):
    found = nav2.occupancy(np.array([list(greys)], np.uint8), None, rules)
    assert dict(zip(greys, found[0].tolist(), strict=True)) == greys


def test_transparent_is_unknown_except_in_raw_maps():
    grey, clear = np.array([[0, 255, 50]], np.uint8), np.array([[True, True, True]])
    assert nav2.occupancy(grey, clear, Rules("trinary")).tolist() == [[-1, -1, -1]]
    assert nav2.occupancy(grey, clear, Rules("scale")).tolist() == [[-1, -1, -1]]
    assert nav2.occupancy(grey, clear, Rules("raw")).tolist() == [[0, -1, 50]]


def test_the_first_row_of_the_picture_is_the_top_and_the_origin_the_outer_corner_of_the_lower_left_cell(tmp_path):
    found = read(tmp_path)
    assert found.cells.tolist() == [[0, -1], [100, 0]]  # from the bottom
    assert found.to_world(0.0, 0.0) == (2.0, 3.0)
    assert found.to_world(0.05, 0.1) == pytest.approx((2.05, 3.1))
    assert found.size_m == pytest.approx((0.1, 0.1))


def test_the_yaw_of_the_origin_turns_the_map_about_that_corner(tmp_path):
    found = read(tmp_path, HEAD.replace("0.0]", f"{math.pi / 2}]"))
    assert found.to_world(0.1, 0.0) == pytest.approx((2.0, 3.1))
    assert found.to_world(0.0, 0.1) == pytest.approx((1.9, 3.0))
    assert [float(v) for v in found.to_picture(np.array(2.0), np.array(3.1))] == pytest.approx([0.1, 0.0])


def test_cells_of_map_savers_grey_for_unknown_are_doubtful_only_where_the_thresholds_make_them_free(tmp_path):
    assert read(tmp_path).doubtful.tolist() == [[True, False], [False, False]]
    assert not read(tmp_path, HEAD.replace("0.25", "0.196")).doubtful.any()
    assert not read(tmp_path, HEAD + "mode: raw\n").doubtful.any()
    assert read(tmp_path, HEAD.replace("negate: 0", "negate: true"), [[50, 254]]).doubtful.tolist() == [[True, False]]


@settings(max_examples=30, deadline=None)
@given(occupied=arrays(bool, array_shapes(min_dims=2, max_dims=2, max_side=7)))
@pytest.mark.parametrize("ending", ["png", "pgm"])
def test_a_written_map_reads_back(tmp_path_factory, ending, occupied):
    file = tmp_path_factory.mktemp("map") / "a b.yaml"
    nav2.write(occupied, 0.05, (-1.5, 2.25), file, ending)
    found = nav2.read(file)
    assert (found.cells == np.where(occupied, 100, 0)).all() and not found.doubtful.any()
    assert (found.resolution_m, found.origin, found.name) == (0.05, (-1.5, 2.25, 0.0), "a b")


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (("image: m.png\n", ""), "lacks the key 'image'"),
        (("m.png", "none.png"), "none.png"),
        (("0.05", "0"), "allowed is 0.001 to 1 m"),
        (("0.05", ".nan"), "allowed is a number"),
        (("[2.0, 3.0, 0.0]", "[1, 2]"), "x, y and yaw"),
        (("negate: 0", "negate: maybe"), "negate"),
        (("negate: 0", "negate: 0\nmode: quad"), "allowed are trinary, scale, raw"),
        (("0.65", "high"), "occupied_thresh"),
        ((HEAD, "[1, 2"), "no YAML"),
        ((HEAD, "obstacles: []"), "scene already"),
    ],
)
def test_a_wrong_map_is_refused_in_one_line_with_its_name(tmp_path, change, why):
    with pytest.raises(SceneError, match=why) as refused:
        read(tmp_path, HEAD.replace(*change))
    assert "m.yaml" in str(refused.value) and "\n" not in str(refused.value)


def test_keys_that_map_server_does_not_know_are_ignored(tmp_path):
    assert read(tmp_path, HEAD + "mode: Trinary\ncostmap: {a: 1}\n").cells.shape == (2, 2)
