"""Depth maps: their numbers, sizes and names, and one clear message for every kind of bad folder."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from io_samples import frame_picture, write_picture

from mocap.data import Camera, CameraRig
from mocap.data.depth import DepthUnits
from mocap.errors import MocapError
from mocap.io import check_session, open_session
from mocap.io.calibration import write_calibration
from mocap.io.session.reading import depth_of
from mocap.io.video import DepthReader

N = 4
SIZE = (96, 64)


def camera(name: str, x: float, y: float) -> Camera:
    """A camera 2 m up that looks down at the middle of the floor."""
    center = np.array([x, y, 2.0])
    ahead = np.array([0.0, 0.0, 0.2]) - center
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    R = np.array([right, np.cross(ahead, right), ahead])
    K = np.array([[90.0, 0, 47.5], [0, 91.0, 31.5], [0, 0, 1]])
    return Camera(name, SIZE, K, np.zeros(4), R, -R @ center)


RIG = CameraRig((camera("a", 3.0, 0.1), camera("b", -0.2, 2.8)))


def floor_depth(of: Camera) -> np.ndarray:
    """Depth (H, W) m of the floor, at most 9 m."""
    w, h = of.size
    uv = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).astype(np.float64)
    rays = of.rays(uv)
    with np.errstate(divide="ignore"):
        along = np.where(rays[..., 2] < 0, -of.center[2] / rays[..., 2], np.inf)
    return np.minimum(along * (rays @ of.R[2]), 9.0)


def make(root: Path, *, unit_mm: float = 1.0, scale: int = 1, n: int = N, text: str = "") -> Path:
    """A session of two cameras of which `a` measures an empty floor."""
    write_calibration(root / "calibration.toml", RIG)
    (root / "session.toml").write_text("fps = 25.0\n" + text)
    for c, own in enumerate(RIG):
        for frame in range(N):
            write_picture(root / "images" / own.name / f"{frame:03d}.png", frame_picture(SIZE, frame, c))
    depth = np.kron(floor_depth(RIG["a"]), np.ones((scale, scale)))
    for frame in range(n):
        write_map(root, frame, np.rint(depth * 1000 / unit_mm).astype(np.uint16))
    return root


def write_map(root: Path, frame: int, numbers: np.ndarray) -> None:
    path = root / "depth" / "a" / f"{frame:03d}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), numbers)


def test_numbers_become_metres(tmp_path: Path) -> None:
    session = open_session(make(tmp_path / "s"))
    assert list(session.depth_sources) == ["a"]
    with depth_of(session) as reader:
        maps = list(reader)
    assert [frame for frame, _ in maps] == list(range(N))
    (first,) = maps[0][1]
    assert first.dtype == np.float32
    np.testing.assert_allclose(first, floor_depth(RIG["a"]), atol=0.00051)  # half a millimetre


@pytest.mark.parametrize(("unit_mm", "scale"), [(10.0, 1), (0.2, 1), (1.0, 2)])
def test_unit_and_scale_are_those_that_are_said(tmp_path: Path, unit_mm: float, scale: int) -> None:
    text = f"[depth]\nunit_mm = {unit_mm}\nscale = {scale}\n"
    session = open_session(make(tmp_path / "s", unit_mm=unit_mm, scale=scale, text=text))
    with depth_of(session, [1]) as reader:
        ((frame, (found,)),) = list(reader)
    assert frame == 1
    np.testing.assert_allclose(found, floor_depth(RIG["a"]), atol=0.00051 * max(unit_mm, 1.0))


def test_a_reduced_camera_takes_the_reading_at_the_middle_of_its_pixels(tmp_path: Path) -> None:
    session = open_session(make(tmp_path / "s"))
    small = CameraRig((RIG["a"].reduced(2),))
    with DepthReader(session.depth_sources, small, [0], session.depth) as reader:
        ((_, (found,)),) = list(reader)
    whole = np.rint(floor_depth(RIG["a"]) * 1000) / 1000
    np.testing.assert_allclose(found, whole[1::2, 1::2], atol=1e-4)


def test_a_map_that_lacks_half_a_pixel_is_read_to_its_end(tmp_path: Path) -> None:
    odd = Camera("a", (97, 65), RIG["a"].K, np.zeros(4), RIG["a"].R, RIG["a"].t)
    units = DepthUnits(scale=0.5)
    assert units.size_of(odd.size) == (48, 32)
    numbers = np.arange(48 * 32, dtype=np.uint16).reshape(32, 48)
    write_map(tmp_path, 0, numbers)
    with DepthReader({"a": tmp_path / "depth" / "a"}, CameraRig((odd,)), [0], units) as reader:
        ((_, (found,)),) = list(reader)
    assert found.shape == (65, 97)
    np.testing.assert_allclose(found[::2, ::2][:32, :48] * 1000, numbers, rtol=1e-5)
    np.testing.assert_allclose(found[-1, -1] * 1000, numbers[-1, -1], rtol=1e-5)


@pytest.mark.parametrize(
    ("stored_mm", "said_mm", "better"),
    [
        (10.0, 1.0, "unit_mm = 10"),
        (1.0, 1000.0, "unit_mm = 1"),
        (0.2, 1.0, "unit_mm = 0.2"),
        (1.0, 0.1, "unit_mm = 1"),
    ],
)
def test_a_wrong_unit_is_recognised_by_the_floor(
    tmp_path: Path, stored_mm: float, said_mm: float, better: str
) -> None:
    root = make(tmp_path / "s", unit_mm=stored_mm, text=f"[depth]\nunit_mm = {said_mm}\n")
    with pytest.raises(MocapError, match="the floor would lie at") as caught:
        open_session(root)
    assert caught.value.camera == "a"
    assert better in caught.value.remedy


def test_where_no_floor_is_read_the_unit_is_believed(tmp_path: Path) -> None:
    root = make(tmp_path / "s")
    for frame in range(N):
        write_map(root, frame, np.zeros(SIZE[::-1], np.uint16))
    session = open_session(root)
    (found,) = [f for f in check_session(session) if f.message.startswith("depth: ")]
    assert (found.severity, found.camera) == ("warning", "a")
    assert "0 % of its pixels" in found.message


def test_check_measures_the_floor(tmp_path: Path) -> None:
    root = make(tmp_path / "s")
    found = [f for f in check_session(open_session(root)) if f.message.startswith("depth")]
    assert [f.severity for f in found] == ["ok"]
    assert "floor at 100.0 %" in found[0].message
    for frame in range(N):  # as of a camera that was calibrated 12 % too high
        write_map(root, frame, np.rint(floor_depth(RIG["a"]) * 1120).astype(np.uint16))
    found = [f for f in check_session(open_session(root)) if f.message.startswith("depth")]
    assert [f.severity for f in found] == ["warning"]


@pytest.mark.parametrize("wall_m", [4.0, 9.0])
def test_maps_that_are_upside_down_are_named(tmp_path: Path, wall_m: float) -> None:
    """Where a far wall stands above the floor another unit would fit as well."""
    make(tmp_path)
    for path in sorted((tmp_path / "depth" / "a").iterdir()):
        depth = np.minimum(floor_depth(RIG["a"]), wall_m)[::-1]
        cv2.imwrite(str(path), np.rint(1000 * depth).astype(np.uint16))
    if wall_m > 5.0:
        with pytest.raises(MocapError, match="upside down"):
            open_session(tmp_path)
    else:
        said = [f for f in check_session(open_session(tmp_path)) if "upside down" in f.message]
        assert [(f.severity, f.camera) for f in said] == [("error", "a")]


def test_pictures_that_were_made_to_look_at_are_refused(tmp_path: Path) -> None:
    root = make(tmp_path / "s")
    write_map(root, 0, np.full(SIZE[::-1], 90, np.uint8))
    with pytest.raises(MocapError, match="16 bits in one channel, this picture has 8 in 1") as caught:
        open_session(root)
    assert (caught.value.camera, caught.value.frame) == ("a", 0)
    write_map(root, 0, np.full((*SIZE[::-1], 3), 90, np.uint16))
    with pytest.raises(MocapError, match="16 in 3"):
        open_session(root)


def test_a_bad_map_further_on_is_named_when_it_is_read(tmp_path: Path) -> None:
    root = make(tmp_path / "s")
    write_map(root, 2, np.full(SIZE[::-1], 90, np.uint8))
    session = open_session(root)
    with pytest.raises(MocapError, match="made to look at") as caught, depth_of(session) as reader:
        list(reader)
    assert (caught.value.camera, caught.value.frame) == ("a", 2)
    file = root / "depth" / "a" / "002.png"
    file.write_bytes(file.read_bytes()[:40])
    with pytest.raises(MocapError, match="cannot be read") as caught, depth_of(session) as reader:
        list(reader)
    assert (caught.value.camera, caught.value.frame) == ("a", 2)


def test_another_size_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="192 x 128, expected 96 x 64") as caught:
        open_session(make(tmp_path / "s", scale=2))
    assert "[depth] scale" in caught.value.remedy


def test_missing_maps_are_named(tmp_path: Path) -> None:
    root = make(tmp_path / "gap")
    (root / "depth" / "a" / "002.png").unlink()
    with pytest.raises(MocapError, match=r"after 001\.png comes 003\.png") as caught:
        open_session(root)
    assert (caught.value.camera, caught.value.frame) == ("a", 2)
    with pytest.raises(MocapError, match="different numbers of frames") as caught:
        open_session(make(tmp_path / "short", n=N - 1))
    assert "a (depth)" in str(caught.value.camera)
    empty = make(tmp_path / "empty", n=0)
    (empty / "depth" / "a").mkdir(parents=True)
    with pytest.raises(MocapError, match="holds no depth map"):
        open_session(empty)


def test_a_camera_that_is_not_calibrated_is_refused(tmp_path: Path) -> None:
    root = make(tmp_path / "s")
    (root / "depth" / "a").rename(root / "depth" / "kinect")
    with pytest.raises(MocapError, match="depth/ has kinect, which the calibration does not know"):
        open_session(root)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("depth = 3", "depth is no table"),
        ("[depth]\nunit = 1.0", "depth has 'unit'"),
        ("[depth]\nunit_mm = 0", r"depth\.unit_mm is 0"),
        ('[depth]\nunit_mm = "mm"', r"depth\.unit_mm"),
        ("[depth]\nscale = true", r"depth\.scale"),
        ("[depth]\nscale = 1e9", r"depth\.scale"),
    ],
)
def test_wrong_settings_are_named(tmp_path: Path, text: str, key: str) -> None:
    with pytest.raises(MocapError, match=key):
        open_session(make(tmp_path / "s", text=text))
