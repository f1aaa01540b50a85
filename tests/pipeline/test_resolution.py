"""Large pictures are reduced to what the voxels can use, and everything that is read with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.io.calibration import write_calibration
from mocap.io.session import Session, open_session
from mocap.io.video import FrameReader, MaskReader, iter_camera
from mocap.pipeline.config import load_config
from mocap.pipeline.resolution import at_useful_size
from mocap.pipeline.stages.segment import region_of_interest

FOCAL_PX_AT_640 = 550.0
N = 2


def camera_at(i: int, size: tuple[int, int]) -> Camera:
    a, focal = 2.0 * i, FOCAL_PX_AT_640 * max(size) / 640
    K = np.array([[focal, 0.0, size[0] / 2 - 0.5], [0.0, focal, size[1] / 2 - 0.5], [0.0, 0.0, 1.0]])
    R = np.array([[-np.sin(a), np.cos(a), 0.0], [0.0, 0.0, -1.0], [-np.cos(a), -np.sin(a), 0.0]])
    centre = np.array([3.4 * np.cos(a), 3.4 * np.sin(a), 1.0])
    return Camera(f"cam_{i}", size, K, np.array([0.02, -0.01, 0.0, 0.0]), R, -R @ centre)


@pytest.fixture
def session(tmp_path: Path) -> Session:
    """Three cameras of 1443 x 1080 whose pictures hold a white square in the upper left."""
    size = (1443, 1080)
    write_calibration(tmp_path / "calibration.toml", CameraRig(tuple(camera_at(i, size) for i in range(3))))
    for i in range(3):
        for folder in ("images", "background", "masks"):
            (tmp_path / folder / f"cam_{i}").mkdir(parents=True)
            for f in range(N):
                picture = np.full((size[1], size[0], 3), 0 if folder == "masks" else 90, dtype=np.uint8)
                picture[100:301, 200:400] = 255
                assert cv2.imwrite(str(tmp_path / folder / f"cam_{i}" / f"{f}.png"), picture)
    (tmp_path / "session.toml").write_text(
        "fps = 10\n[roi_px]\ncam_0 = [[0, 0], [700, 0], [700, 1079], [0, 1079]]\n"
    )
    return open_session(tmp_path)


def sized(size: tuple[int, int], *settings: str, kind: str = "voxels", session: Session) -> tuple[int, int]:
    rig = CameraRig(tuple(camera_at(i, size) for i in range(3)))
    return at_useful_size(replace(session, rig=rig), load_config(settings=settings), kind).rig[0].size


def test_a_voxel_stays_some_pixels_wide_and_small_pictures_stay(session: Session) -> None:
    assert sized((640, 480), session=session) == (640, 480)
    assert sized((1280, 960), session=session) == (640, 480)
    assert sized((1920, 1080), session=session) == (640, 360)
    assert sized((1080, 1920), session=session) == (360, 640)
    assert sized((3840, 2160), session=session) == (640, 360)
    fine = "volume.voxel_size_m=0.01"
    assert sized((3840, 2160), fine, session=session) == (960, 540)
    assert sized((3840, 2160), fine, "segmentation.pixels_per_voxel=2.5", session=session) == (1280, 720)
    assert sized((640, 480), "volume.voxel_size_m=0.05", session=session) == (640, 480)


def test_nothing_is_reduced_where_points_are_the_evidence_or_nobody_wants_it(session: Session) -> None:
    large = (1920, 1080)
    assert sized(large, "segmentation.pixels_per_voxel=0", session=session) == large
    for kind in ("markers", "keypoints", "fused"):
        assert sized(large, kind=kind, session=session) == large


def test_a_reduced_camera_sees_the_same_points_in_pictures_that_are_read_reduced(session: Session) -> None:
    small = at_useful_size(session, load_config(), "voxels")
    assert small.rig[0].size == (721, 540)
    with FrameReader(small.image_sources, small.rig, range(N)) as reader:
        pictures = [p for _, p in reader]
    again = list(iter_camera(small.background_sources["cam_0"], small.rig[0]))
    for picture in (*pictures[0], pictures[1][2], again[1]):
        assert picture.shape == (540, 721, 3)
    # The square's corner pixels: where a point seen there by the large camera is seen by the small one.
    for large, reduced, picture in zip(session.rig, small.rig, pictures[0], strict=True):
        point = large.unproject(np.array([[299.5, 199.5]]), np.array([3.0]))
        uv, _ = reduced.project(point)
        np.testing.assert_allclose(uv, [[149.5, 99.5]], atol=1e-6)
        white = picture[:, :, 0] > 200
        rows, columns = np.flatnonzero(white.any(axis=1)), np.flatnonzero(white.any(axis=0))
        assert (rows[0], rows[-1], columns[0], columns[-1]) == (50, 149, 100, 199)
        assert picture[150, 150, 0] in range(170, 176), "half of these pixels' square is white"


def test_masks_and_regions_are_reduced_by_what_most_of_a_square_is(session: Session) -> None:
    small = at_useful_size(session, load_config(), "voxels")
    with MaskReader(session.mask_sources, small.rig, range(N)) as reader:
        _, masks = next(iter(reader))
    assert masks[0].dtype == np.bool_
    assert masks[0].shape == (540, 721)
    rows, columns = np.flatnonzero(masks[0].any(axis=1)), np.flatnonzero(masks[0].any(axis=0))
    assert (rows[0], rows[-1], columns[0], columns[-1]) == (50, 150, 100, 199)
    region = region_of_interest(small, small.rig[0])
    assert region is not None
    assert region.shape == (540, 721)
    assert region[:, :350].all()
    assert not region[:, 351:].any()


def test_pictures_of_another_size_than_calibrated_are_told_in_the_size_that_was_filmed(
    session: Session,
) -> None:
    small = at_useful_size(session, load_config(), "voxels")
    assert cv2.imwrite(
        str(session.root / "images" / "cam_1" / "1.png"), np.zeros((540, 721, 3), dtype=np.uint8)
    )
    with FrameReader(small.image_sources, small.rig, range(N)) as reader, pytest.raises(MocapError) as raised:
        list(reader)
    assert "721 x 540" in str(raised.value)
    assert "1443 x 1080" in str(raised.value)
