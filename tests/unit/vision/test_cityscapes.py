"""Tests of the reader on small folders in the layout of Cityscapes, drawn from a world with known distances."""

import json
import math
import shutil

import cv2
import numpy as np
import pytest

from zsdist.config import CameraConfig
from zsdist.errors import ConfigError, DataError
from zsdist.vision.cityscapes import files
from zsdist.vision.cityscapes.views import SCALE, cityscapes_masked_views, cityscapes_views
from zsdist.vision.masks import MOST_MASKS
from zsdist.vision.rays import RAYS, ray_angles_rad

HEIGHT, WIDTH = 256, 512  # a quarter of the real size, with a quarter of the real focal length
CAMERA = CameraConfig(size_px=64, field_of_view_deg=45.0)
FX, FY, U0, V0, BASELINE, PITCH, EYE_M = 565.6, 566.3, 274.2, 128.3, 0.209, 0.038, 1.22
CALIBRATION = {
    "intrinsic": {"fx": FX, "fy": FY, "u0": U0, "v0": V0},
    "extrinsic": {"baseline": BASELINE, "pitch": PITCH, "roll": 0.0, "x": 1.7, "y": 0.1, "yaw": 0.0, "z": EYE_M},
}
ROAD, BUILDING, POLE, VEGETATION, SKY, PERSON, CAR = 7, 11, 17, 21, 23, 24, 26
NAMES = {BUILDING: "building", POLE: "pole", VEGETATION: "vegetation", PERSON: "person", CAR: "car"}
COLOURS = {ROAD: 90, BUILDING: 160, POLE: 220, VEGETATION: 60, SKY: 250, PERSON: 130, CAR: 20, 0: 0}
ANGLES = ray_angles_rad(RAYS, math.radians(45.0))
HOUSE = (BUILDING, 18.0, (-20.0, 0.0), (0.0, 6.0))  # label, metres ahead, right from and to, up from and to
A_CAR = (CAR, 10.0, (0.9, 2.7), (0.0, 1.4))
A_PERSON = (PERSON, 12.0, (-2.4, -1.8), (0.0, 1.7))
A_POLE = (POLE, 9.0, (-1.05, -1.0), (0.0, 4.0))
CROWN = (VEGETATION, 8.0, (0.5, 2.0), (2.0, 4.0))


def draw(things, stereo=True):
    """Return labels, instance numbers and disparity of flat objects that face the camera, seen from `EYE_M`."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    a, b = (u - U0) / FX, (v - V0) / FY  # right and down for each metre along the axis
    ahead, down = math.cos(PITCH) - b * math.sin(PITCH), math.sin(PITCH) + b * math.cos(PITCH)
    labels = np.where(down > 0, ROAD, SKY)
    depth = np.where(down > 0, EYE_M / np.maximum(down, 1e-9), np.inf)
    instances, polygons, measured = labels.copy(), [], np.ones(labels.shape, bool)
    for number, (label, far, right, up) in enumerate(sorted(things, key=lambda thing: -thing[1])):
        z = far / ahead
        height = EYE_M - z * down
        there = (right[0] < a * z) & (a * z < right[1]) & (up[0] <= height) & (height < up[1])
        labels[there], depth[there], measured[there] = label, z[there], stereo
        instances[there] = 1000 * label + number if label >= PERSON else label
        rows, columns = np.nonzero(there)
        box = [(columns.min(), rows.min()), (columns.max(), rows.min()), (columns.max(), rows.max())]
        corners = [[int(x), int(y)] for x, y in (*box, (columns.min(), rows.max()))]
        polygons.append({"label": NAMES[label], "polygon": corners})
    disparity = np.where(measured, np.rint(256 * BASELINE * FX / depth) + 1, 0)
    return labels, instances, disparity, polygons


def write(root, things, name="aachen_000000_000019", split="train", stereo=True, labels=None):
    shown, instances, disparity, polygons = draw(things, stereo)
    if labels is not None:
        shown = instances = np.full_like(shown, labels)

    def path(folder, end):
        file = root / folder / split / name.split("_")[0] / f"{name}{end}"
        file.parent.mkdir(parents=True, exist_ok=True)
        return file

    grey = np.vectorize(COLOURS.get)(shown).astype(np.uint8)
    cv2.imwrite(str(path("leftImg8bit", "_leftImg8bit.png")), np.stack([grey, grey, grey // 2], -1))  # BGR
    cv2.imwrite(str(path("gtFine", "_gtFine_instanceIds.png")), instances.astype(np.uint16))
    cv2.imwrite(str(path("disparity", "_disparity.png")), disparity.astype(np.uint16))
    path("gtFine", "_gtFine_polygons.json").write_text(
        json.dumps({"imgHeight": HEIGHT, "imgWidth": WIDTH, "objects": polygons})
    )
    path("camera", "_camera.json").write_text(json.dumps(CALIBRATION))
    return root


def only(root, camera=CAMERA, **options):
    return next(cityscapes_views(root, "train", 1, 0, camera, **options))


def expected(things):
    """Return scaled distance and motion in the middle of each ray's columns, and the rays completely on one object."""
    distance, moving = np.full(RAYS, 5.0), np.zeros(RAYS, bool)
    edges = np.tan(math.radians(22.5)) * (2 * np.arange(RAYS + 1) / RAYS - 1)
    clear = np.ones(RAYS, bool)
    for label, far, right, _ in sorted(things, key=lambda thing: -thing[1]):
        covered = (edges[:-1] * far > right[0]) & (edges[1:] * far < right[1])
        clear &= covered | (edges[1:] * far < right[0]) | (edges[:-1] * far > right[1])
        distance[covered], moving[covered] = far / SCALE, label >= PERSON
    return np.minimum(distance / np.cos(ANGLES), 5.0), moving, clear


@pytest.mark.parametrize("stereo", [True, False])
def test_rays_have_the_true_length_with_stereo_or_from_the_foot_on_the_ground(tmp_path, stereo):
    things = [HOUSE, A_CAR, A_PERSON]
    view = only(write(tmp_path, things, stereo=stereo))
    distance, moving, clear = expected(things)
    assert clear.sum() > 20 and moving[clear].sum() > 2
    assert view.ray_clearance_m[clear] == pytest.approx(distance[clear], rel=0.01 if stereo else 0.06)
    assert (view.ray_dynamic == moving)[clear].all()
    assert view.ray_clearance_m.dtype == np.float32 and view.ray_dynamic.dtype == bool


def test_rays_run_from_left_to_right_and_a_thin_pole_stops_its_ray(tmp_path):
    view = only(write(tmp_path, [A_POLE]))
    (hit,) = np.nonzero(view.ray_clearance_m < 5.0)
    assert len(hit) <= 2 and ANGLES[hit] == pytest.approx(math.atan(1.02 / 9.0), abs=0.03)
    assert view.ray_clearance_m[hit] == pytest.approx(9.0 / SCALE, rel=0.02)
    assert not view.ray_dynamic.any()


def test_stray_stereo_values_make_no_object_nearer(tmp_path):
    root, fine = write(tmp_path, [HOUSE, A_CAR]), CAMERA.model_copy(update={"size_px": 224})
    clean = only(root, fine).ray_clearance_m
    path = next(root.rglob("*_disparity.png"))
    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    rng = np.random.default_rng(0)
    stray = rng.random(values.shape) < 0.005
    values[stray] = 256 * BASELINE * FX / rng.uniform(2.0, 6.0, stray.sum())
    cv2.imwrite(str(path), values)
    assert only(root, fine).ray_clearance_m == pytest.approx(clean, rel=0.01)


def test_objects_above_the_car_do_not_obstruct(tmp_path):
    assert (only(write(tmp_path, [CROWN])).ray_clearance_m == 5.0).all()


def test_the_scale_is_metres_of_the_street_per_metre_of_the_car(tmp_path):
    root = write(tmp_path, [A_CAR])
    near, far = (only(root, scale=scale).ray_clearance_m.min() for scale in (8.0, 2.5))
    assert near == pytest.approx(10.0 / 8.0, rel=0.02) and far == pytest.approx(4.0, rel=0.02)


def test_the_picture_is_level_at_true_angles_and_filled_outside_the_frame(tmp_path):
    image = only(write(tmp_path, [A_CAR])).image
    assert image.shape == (64, 64, 3) and image.dtype == np.uint8
    assert abs(int(image[30, 32, 0]) - COLOURS[SKY] // 2) < 3 and abs(int(image[33, 32, 2]) - COLOURS[ROAD]) < 3  # RGB
    tangent = math.tan(math.radians(22.5))
    columns = np.flatnonzero(image[33, :, 2] < 40)
    assert columns[[0, -1]] == pytest.approx([32 * (1 + x / 10.0 / tangent) for x in (0.9, 2.7)], abs=1.5)
    assert (image[:8] == image[0, 0]).all() and (image[-8:] == image[0, 0]).all()
    assert COLOURS[ROAD] < image[0, 0, 2] < COLOURS[SKY]


def test_a_hidden_object_leaves_the_rays_beside_it_and_background_changes_nothing(tmp_path):
    root = write(tmp_path, [HOUSE, A_POLE, A_CAR])
    (view,) = cityscapes_masked_views(root, "train", 1, 0, CAMERA)
    assert (view.image == only(root).image).all() and view.scene_hash == only(root).scene_hash
    assert 5 <= len(view.masks) <= MOST_MASKS
    objects = [mask for mask in view.masks if not mask.background]
    shown = {int(np.median(view.image[mask.hidden][:, 2])): mask for mask in objects}
    assert set(shown) == {COLOURS[BUILDING], COLOURS[CAR]}  # too little of the pole is visible in such a small picture
    car = shown[COLOURS[CAR]]
    hit = view.ray_dynamic
    assert hit.any() and (car.ray_distance_m[hit] == 5.0).all() and not car.ray_dynamic.any()
    assert (car.ray_distance_m[~hit] == view.ray_distance_m[~hit]).all()
    house = shown[COLOURS[BUILDING]]
    (pole,) = np.nonzero((house.ray_distance_m < 2.5) & ~hit)
    assert len(pole) and (house.ray_distance_m[:8] == 5.0).all()
    assert all((m.ray_distance_m == view.ray_distance_m).all() for m in view.masks if m.background)
    assert not any(mask.hidden[0].any() for mask in view.masks)  # pixels that the frame does not show


def test_each_standing_object_has_the_mask_of_its_polygon(tmp_path):
    root = write(tmp_path, [(POLE, 9.0, (-1.5, -1.2), (0.0, 4.0)), (POLE, 9.0, (1.2, 1.5), (0.0, 4.0))])
    (view,) = cityscapes_masked_views(root, "train", 1, 0, CAMERA)
    objects = [mask for mask in view.masks if not mask.background]
    assert len(objects) == 2
    for mask, other in (objects, objects[::-1]):
        assert not (mask.hidden & other.hidden).any()
        assert (mask.ray_distance_m[view.ray_distance_m < 5.0] == 5.0).any()


def test_labelled_frames_come_once_each_in_a_random_order(tmp_path):
    names = [f"{city}_00000{k}_000019" for city in ("aachen", "bremen") for k in range(3)]
    for name in names:
        write(tmp_path, [A_CAR], name)
    write(tmp_path, [A_CAR], "ulm_000000_000019", labels=0)

    def order(seed, count=9, first=0):
        return [view.scene for view in cityscapes_views(tmp_path, "train", count, seed, CAMERA, first=first)]

    assert sorted(order(0)) == names
    assert order(0, 3) + order(0, 9, first=3) == order(0)
    assert len({tuple(order(seed)) for seed in range(3)}) > 1


def test_frames_of_one_drive_share_a_hash(tmp_path):
    for name in ("aachen_000000_000019", "aachen_000000_000020", "aachen_000001_000019", "bremen_000000_000019"):
        write(tmp_path, [A_CAR], name)
    write(tmp_path, [A_CAR], "lindau_000000_000019", split="val")
    hashes = {view.scene: view.scene_hash for view in cityscapes_views(tmp_path, "train", 9, 0, CAMERA)}
    assert hashes["aachen_000000_000019"] == hashes["aachen_000000_000020"]
    assert len(set(hashes.values())) == 3 and all(int(text, 16) < 2**64 for text in hashes.values())
    assert [view.scene for view in cityscapes_views(tmp_path, "val", 9, 0, CAMERA)] == ["lindau_000000_000019"]


def test_a_wider_view_than_the_frames_is_refused(tmp_path):
    root = write(tmp_path, [A_CAR])
    with pytest.raises(ConfigError, match=r"field_of_view_deg is 90; .* 45\.\d degrees: allowed is 30 to 45$"):
        only(root, CameraConfig())


def damage_camera(part, key, value):
    def act(root):
        path = next(root.rglob("*_camera.json"))
        tree = json.loads(path.read_text())
        tree[part][key] = value
        path.write_text(json.dumps(tree))

    return act


def cut(pattern):
    def act(root):
        path = next(root.rglob(pattern))
        path.write_bytes(path.read_bytes()[:-40])

    return act


def replace(pattern, text):
    return lambda root: next(root.rglob(pattern)).write_text(text)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda root: shutil.rmtree(root / "leftImg8bit"), r"has no leftImg8bit/train/.* expected is the root"),
        (lambda root: shutil.rmtree(root / "disparity"), r"lacks .*_disparity\.png; .* disparity_trainvaltest\.zip"),
        (lambda root: next(root.rglob("*_instanceIds.png")).unlink(), r"lacks .*_gtFine_instanceIds\.png"),
        (lambda root: shutil.rmtree(root / "camera"), r"lacks .*_camera\.json; .* camera_trainvaltest\.zip"),
        (cut("*_leftImg8bit.png"), r"_leftImg8bit\.png is damaged: \d+ bytes"),
        (cut("*_disparity.png"), r"_disparity\.png is damaged"),
        (replace("*_instanceIds.png", "no picture"), r"_instanceIds\.png is damaged: 10 bytes"),
        (replace("*_camera.json", "{"), r"_camera\.json cannot be read as JSON"),
        (replace("*_camera.json", '{"intrinsic": {}}'), r"_camera\.json lacks the key 'extrinsic'"),
        (replace("*_polygons.json", "{}"), r"_polygons\.json lacks the key 'objects'"),
        (replace("*_polygons.json", '{"objects": [{"label": "car"}]}'), r"without a label and a polygon"),
        (replace("*_polygons.json", '{"objects": [3]}'), r"without a label and a polygon"),
        (damage_camera("extrinsic", "baseline", None), r"extrinsic\.baseline None; expected is a number above 0"),
        (damage_camera("intrinsic", "fx", -1.0), r"intrinsic\.fx -1\.0; expected is a number above 0"),
        (damage_camera("intrinsic", "u0", 1096.98), r"axis at pixel 1096\.98, .* width, 512; .* 2048 x 1024"),
    ],
)
def test_missing_and_damaged_files_are_named_in_one_line(tmp_path, act, message):
    root = write(tmp_path, [A_CAR])
    act(root)
    with pytest.raises(DataError, match=message) as raised:
        only(root)
    assert "\n" not in str(raised.value)


def test_files_of_other_types_or_sizes_are_refused(tmp_path):
    root = write(tmp_path, [A_CAR])
    path = next(root.rglob("*_disparity.png"))
    cv2.imwrite(str(path), np.zeros((HEIGHT, WIDTH), np.uint8))
    with pytest.raises(DataError, match=r"_disparity\.png has 1 channels of 8 bit; expected is 1 of 16 bit"):
        only(root)
    cv2.imwrite(str(path), np.zeros((HEIGHT // 2, WIDTH), np.uint16))
    with pytest.raises(DataError, match=r"is \(128, 512\) pixels; expected is \(256, 512\)"):
        only(root)


def test_hidden_files_beside_pictures_are_no_pictures(tmp_path):
    city = tmp_path / "leftImg8bit" / "train" / "aachen"
    city.mkdir(parents=True)
    for name in ("aachen_000000_000019_leftImg8bit.png", "._aachen_000000_000019_leftImg8bit.png", ".DS_Store"):
        (city / name).touch()
    assert [path.name for path in files.frames(tmp_path, "train")] == ["aachen_000000_000019_leftImg8bit.png"]


def test_other_splits_and_an_empty_folder_are_refused(tmp_path):
    with pytest.raises(DataError, match="split is 'test'; allowed are train, val"):
        next(cityscapes_views(tmp_path, "test", 1, 0, CAMERA))
    with pytest.raises(DataError, match="expected is the root of a Cityscapes copy"):
        next(cityscapes_views(tmp_path / "nowhere", "train", 1, 0, CAMERA))
