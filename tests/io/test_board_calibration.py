"""Calibration on a board: rendered clips of known cameras, and what is said when it cannot be done."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from small_session import mocap

from eval.board_calibration import FLOOR_FRAME, SIZE, SQUARE_M, drawn_views, errors, looking_rig, positions
from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.io.board_calibration import (
    BoardViews,
    board_clips,
    calibrate_on_board,
)
from mocap.io.calibration import read_calibration

Array = NDArray[np.float64]

N_PICTURES = 15
# `python -m eval.board_calibration`, 40 seeds with 0.1 px of noise: at worst 0.79 % and 20 mm.
FOCAL_TOLERANCE = 0.01
PLACE_TOLERANCE_M = 0.03


def picture(camera: Camera, R: Array, t: Array) -> NDArray[np.uint8]:
    """The board as the camera sees it: every pixel's ray is cut with the board's plane."""
    w, h = camera.size
    fine = 3
    u, v = np.meshgrid(np.arange(float(w)), np.arange(float(h)))
    rays = camera.rays(np.column_stack([u.ravel(), v.ravel()]))
    along = ((t - camera.center) @ R[:, 2]) / (rays @ R[:, 2])
    local = (camera.center + along[:, None] * rays - t) @ R[:, :2] / SQUARE_M
    # The position on the board changes smoothly, so that it may be interpolated between pixels.
    local = cv2.resize(
        local.reshape(h, w, 2), None, fx=fine, fy=fine, interpolation=cv2.INTER_LINEAR
    ).reshape(-1, 2)
    cell = np.floor(np.clip(local, -99, 99) + (np.array(SIZE) + 1) / 2).astype(int)
    squares = np.array(SIZE) + 1
    is_board = ((cell >= 0) & (cell < squares)).all(axis=1)
    is_border = (np.abs(local) < squares / 2 + 0.7).all(axis=1)
    grey = np.where(is_border, 235, 90)
    grey[is_board] = np.where(cell[is_board].sum(axis=1) % 2 == 0, 25, 235)
    shrunk = grey.reshape(h, fine, w, fine).mean(axis=(1, 3))
    return cv2.cvtColor(np.rint(shrunk).astype(np.uint8), cv2.COLOR_GRAY2BGR)


def write_clips(folder: Path, n: int = N_PICTURES, seed: int = 2) -> CameraRig:
    rig = looking_rig()
    for frame, (R, t) in enumerate(positions(n, rng=np.random.default_rng(seed))):
        for camera in rig:
            (folder / camera.name).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / camera.name / f"{frame:03d}.png"), picture(camera, R, t))
    return rig


def check_against(found: CameraRig, truth: CameraRig) -> None:
    focal, place = errors(found, truth)
    assert focal < FOCAL_TOLERANCE
    assert place < PLACE_TOLERANCE_M


def test_known_cameras_are_found_from_pictures(tmp_path: Path) -> None:
    """The whole command, from clips to calibration.toml."""
    truth = write_clips(tmp_path / "board")
    clips = board_clips(tmp_path / "board")
    assert list(clips) == ["left", "middle", "right"]
    path = tmp_path / "calibration.toml"
    said = mocap(
        *("calibrate", tmp_path / "board", "-o", path, "--board", "7x5", "--square-mm", 1000 * SQUARE_M),
        *("--floor-frame", FLOOR_FRAME),
    )
    assert said.code == 0, said.err
    check_against(read_calibration(path).rig, truth)
    assert float(re.search(r"Corners are off by (\S+) px", said.out)[1]) < 0.3  # type: ignore[index]
    assert f"right: {N_PICTURES} views" in said.out
    assert "warning" not in said.out
    # A number too large: nothing is found, nothing is written, and the camera is named.
    for wrong, message in (
        (("--board", "8x6", "--floor-frame", FLOOR_FRAME), "was found in 0 frames"),
        (("--board", "7x5", "--floor-frame", 99), f"have frames 0 to {N_PICTURES - 1}"),
        (("--board", "seven", "--floor-frame", 0), "cannot read the board"),
        (("--board", "2x5", "--floor-frame", 0), "a board of 2 x 5"),
    ):
        said = mocap(
            "calibrate",
            tmp_path / "board",
            "-o",
            tmp_path / "no.toml",
            "--square-mm",
            120,
            "--frames",
            6,
            *wrong,
        )
        assert said.code == 2
        assert message in said.err
    assert not (tmp_path / "no.toml").exists()


@pytest.mark.parametrize("seed", range(2))
def test_numbering_by_chance_does_not_matter(seed: int) -> None:
    rig = looking_rig()
    views = drawn_views(rig, 25, rng=np.random.default_rng(seed), noise_px=0.1)
    found = calibrate_on_board(views, square_m=SQUARE_M, floor_frame=FLOOR_FRAME)
    check_against(found.rig, rig)
    # Noise of 0.1 px per axis, less what the fit takes up.
    assert 0.1 < found.rms_px < 0.16


def test_the_board_sets_the_scale() -> None:
    views = drawn_views(looking_rig(), 25, rng=np.random.default_rng(5), noise_px=0.05)
    one, two = (calibrate_on_board(views, square_m=k * SQUARE_M, floor_frame=FLOOR_FRAME) for k in (1.0, 2.0))
    for a, b in zip(one.rig, two.rig, strict=True):
        assert b.center == pytest.approx(2 * a.center, rel=1e-4, abs=1e-4)
        np.testing.assert_allclose(b.K, a.K, rtol=1e-4)


def test_a_view_that_fits_nothing_is_left_out() -> None:
    rig = looking_rig()
    views = drawn_views(rig, 25, rng=np.random.default_rng(1), noise_px=0.05)
    frame = next(f for f, seen in views.corners.items() if f != FLOOR_FRAME and len(seen) == 3)
    other = next(f for f, seen in views.corners.items() if f > frame and len(seen) == 3)
    views.corners[frame]["right"] = views.corners[other]["right"]  # a clip that hangs for a frame
    found = calibrate_on_board(views, square_m=SQUARE_M, floor_frame=FLOOR_FRAME)
    assert found.n_views_of["right"] == sum("right" in seen for seen in views.corners.values()) - 1
    check_against(found.rig, rig)


def test_what_is_said_when_it_cannot_be_done(tmp_path: Path) -> None:
    rig = looking_rig()
    views = drawn_views(rig, 25, rng=np.random.default_rng(1), noise_px=0.05)
    with pytest.raises(ValueError, match="square_m must be positive"):
        calibrate_on_board(views, square_m=0.0, floor_frame=FLOOR_FRAME)
    with pytest.raises(MocapError, match="sees the board in the floor frame"):
        calibrate_on_board(views, square_m=SQUARE_M, floor_frame=99)
    rare = {
        f: {n: uv for n, uv in seen.items() if n != "right" or f < 4} for f, seen in views.corners.items()
    }
    with pytest.raises(MocapError, match="was found in") as caught:
        calibrate_on_board(
            BoardViews(SIZE, views.picture_size, rare, 25), square_m=SQUARE_M, floor_frame=FLOOR_FRAME
        )
    assert caught.value.camera == "right"
    apart = {
        f: {n: uv for n, uv in seen.items() if (n == "right") == (f % 2 == 0)}
        for f, seen in views.corners.items()
    }
    with pytest.raises(MocapError, match="at the same time as the others") as caught:
        calibrate_on_board(
            BoardViews(SIZE, views.picture_size, apart, 25), square_m=SQUARE_M, floor_frame=FLOOR_FRAME
        )
    assert caught.value.camera == "right"
    with pytest.raises(MocapError, match="no clips of two or more cameras"):
        board_clips(tmp_path)
