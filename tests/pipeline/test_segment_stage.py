"""The segmentation stage on a session of drawn pictures: regions of interest, numbers, advice, keys."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.io.calibration import write_calibration
from mocap.io.session import open_session
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.keys import stage_keys
from mocap.pipeline.stage import Job
from mocap.pipeline.stages.segment import SEGMENT, region_of_interest, segment_report
from mocap.pipeline.walk import run_stage
from mocap.products.masks import masks_from_arrays

SIZE = (96, 80)
NAMES = ("left", "middle", "right")
N_FRAMES = 7


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Three cameras that see the same: a dark block that wanders, and in `left` a lamp that blinks in its middle."""
    K = np.array([[90.0, 0.0, 47.5], [0.0, 90.0, 39.5], [0.0, 0.0, 1.0]])
    cameras = []
    for i, name in enumerate(NAMES):
        a = 2.0 * i
        R = np.array([[-np.sin(a), np.cos(a), 0.0], [0.0, 0.0, -1.0], [-np.cos(a), -np.sin(a), 0.0]])
        centre = np.array([3 * np.cos(a), 3 * np.sin(a), 1.2])
        cameras.append(Camera(name, SIZE, K, np.zeros(5), R, -R @ centre))
    write_calibration(tmp_path / "calibration.toml", CameraRig(tuple(cameras)))
    rng = np.random.default_rng(3)
    for name in NAMES:
        for folder, n in (("background", 5), ("images", N_FRAMES)):
            for f in range(n):
                picture = np.full((SIZE[1], SIZE[0], 3), 120.0)
                if folder == "images":
                    picture[20:60, 22 + 2 * f : 46 + 2 * f] = (40, 30, 90)
                    if name == "left" and f % 2:
                        picture[34:46, 36:44] = (
                            120.0  # always inside the block, and away from what its sides uncover
                        )
                path = tmp_path / folder / name / f"{f:03d}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                noisy = np.clip(picture + rng.normal(0, 1.5, picture.shape), 0, 255).astype(np.uint8)
                assert cv2.imwrite(str(path), noisy)
    (tmp_path / "session.toml").write_text("fps = 10\n")
    return tmp_path


def segmented(root: Path, out: Path) -> tuple[StageStore, np.ndarray]:
    session = open_session(root)
    store = StageStore(out)
    run_stage(SEGMENT, Job(session, load_config(), store, "key", n_threads=2))
    masks = [masks_from_arrays(arrays, session) for _, arrays in store.reader("segment")]
    return store, np.array(masks)


def test_report_names_the_camera_that_flickers(root: Path, tmp_path: Path) -> None:
    store, masks = segmented(root, tmp_path / "store.zarr")
    assert masks.shape == (N_FRAMES, len(NAMES), SIZE[1], SIZE[0])
    report = segment_report(Job(open_session(root), load_config(), store))
    numbers = report.numbers["cameras"]
    assert set(numbers) == set(NAMES)
    assert numbers["middle"]["flicker"] == 0.0
    assert numbers["left"]["flicker"] > 0.02
    assert numbers["left"]["shadow_share"] == 0.0
    assert numbers["left"]["residual"] is None
    assert [w for w in report.warnings if "flicker" in w] == [
        w for w in report.warnings if w.startswith("camera left:") and "flicker" in w
    ]
    assert any("flicker" in w for w in report.warnings)


def test_shadows_are_as_dark_as_the_recording_says(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = open_session(root)
    for f in range(N_FRAMES):  # a shadow of two thirds of the light
        path = root / "images" / "right" / f"{f:03d}.png"
        picture = cv2.imread(str(path)).astype(np.float64)
        picture[20:60, 22 + 2 * f : 46 + 2 * f] = 80.0
        assert cv2.imwrite(str(path), picture.astype(np.uint8))
    for darkest, expected in ((0.5, 0), (0.7, 900)):
        monkeypatch.setattr(
            "mocap.pipeline.stages.segment.with_shadows_of",
            lambda *some, darkest=darkest: replace(some[2], shadow_darkest=darkest),
        )
        store, masks = segmented(root, tmp_path / f"{darkest}.zarr")
        report = segment_report(Job(session, load_config(), store))
        assert report.numbers["shadow_darkest"] == darkest
        assert np.count_nonzero(masks[3, 2]) == pytest.approx(expected, rel=0.2)


def blacken(root: Path, names: tuple[str, ...], frames: range) -> None:
    for name in names:
        for f in frames:
            path = root / "images" / name / f"{f:03d}.png"
            assert cv2.imwrite(str(path), np.full((SIZE[1], SIZE[0], 3), 3, np.uint8))


def test_where_the_light_goes_out_nobody_is_seen(root: Path, tmp_path: Path) -> None:
    """The frames before and after are those of a recording in which it does not."""
    _, lit = segmented(root, tmp_path / "lit.zarr")
    dark = range(2, 5)
    blacken(root, NAMES, dark)
    store, masks = segmented(root, tmp_path / "dark.zarr")
    assert not masks[dark].any()
    others = [f for f in range(N_FRAMES) if f not in dark]
    np.testing.assert_array_equal(masks[others], lit[others])
    warnings = segment_report(Job(open_session(root), load_config(), store)).warnings
    assert sum("fills most of the picture in 43%" in w for w in warnings) == len(NAMES)


def test_one_covered_lens_empties_no_frame(root: Path, tmp_path: Path) -> None:
    """Its mask is full, so that it votes nobody away."""
    _, lit = segmented(root, tmp_path / "lit.zarr")
    blacken(root, NAMES[:1], range(2, 5))
    _, masks = segmented(root, tmp_path / "dark.zarr")
    assert masks[2:5, 0].all()
    np.testing.assert_array_equal(masks[:, 1:], lit[:, 1:])


def test_region_of_interest_from_a_picture_and_a_polygon(root: Path, tmp_path: Path) -> None:
    before = stage_keys(open_session(root), load_config(), 0)["segment"]
    picture = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    picture[:, :48] = 255
    (root / "roi").mkdir()
    assert cv2.imwrite(str(root / "roi" / "left.png"), picture)
    drawn = stage_keys(open_session(root), load_config(), 0)["segment"]
    (root / "session.toml").write_text("fps = 10\n[roi_px]\nright = [[0, 40], [95, 40], [95, 79], [0, 79]]\n")
    session = open_session(root)
    assert len({before, drawn, stage_keys(session, load_config(), 0)["segment"]}) == 3
    np.testing.assert_array_equal(region_of_interest(session, session.rig["left"]), picture > 0)
    assert region_of_interest(session, session.rig["middle"]) is None
    _, masks = segmented(root, tmp_path / "store.zarr")
    assert not masks[:, 0, :, 48:].any()
    assert masks[:, 0, :, :48].any()
    assert masks[:, 1, :, 48:].any()
    assert not masks[:, 2, :40].any()
    assert masks[:, 2, 40:].any()


def test_a_region_that_holds_nothing_is_refused(root: Path) -> None:
    (root / "roi").mkdir()
    assert cv2.imwrite(str(root / "roi" / "middle.png"), np.zeros((SIZE[1], SIZE[0]), np.uint8))
    session = open_session(root)
    with pytest.raises(MocapError, match="holds no pixel") as caught:
        region_of_interest(session, session.rig["middle"])
    assert caught.value.camera == "middle"
    assert cv2.imwrite(str(root / "roi" / "middle.png"), np.full((SIZE[1], SIZE[0] + 1), 255, np.uint8))
    with pytest.raises(MocapError):
        region_of_interest(session, session.rig["middle"])
