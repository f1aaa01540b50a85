"""What `mocap check` finds, and the checkerboard measure behind it against a rendered board."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from io_samples import frame_picture, look_at, write_video

from mocap.data import Camera, CameraRig
from mocap.io import check_session, open_session
from mocap.io.calibration import write_calibration
from mocap.io.checkerboard import find_board, find_boards, measure_board, triangulate

SHARED = Path(__file__).resolve().parents[3] / "shared"
SQUARE_M = 0.12
BOARD = (7, 5)
# Corners of the rendered board are found to about 0.1 px; 2-3 px is what one degree of tilt makes.
GOOD_PX, BAD_PX = 0.4, 1.0


def board_picture(camera: Camera, center: np.ndarray) -> np.ndarray:
    """A checkerboard with a white border, lying flat at `center`, seen by a camera without distortion."""
    px = 30
    columns, rows = BOARD[0] + 1, BOARD[1] + 1
    pattern = (np.indices((rows, columns)).sum(axis=0) % 2 * 255).astype(np.uint8)
    picture = np.kron(pattern, np.ones((px, px), np.uint8))
    picture = cv2.copyMakeBorder(picture, px, px, px, px, cv2.BORDER_CONSTANT, value=255)
    # Picture pixel (x, y) of the board lies at world center + (x, -y) scaled: printed side up.
    scale = SQUARE_M / px
    h, w = picture.shape
    to_world = np.array([[scale, 0, -scale * (w - 1) / 2], [0, -scale, scale * (h - 1) / 2], [0, 0, 1]])
    plane = np.column_stack([camera.R[:, 0], camera.R[:, 1], camera.R @ center + camera.t])
    view = cv2.warpPerspective(
        picture, camera.K @ plane @ to_world, camera.size, flags=cv2.INTER_AREA, borderValue=90
    )
    return np.repeat(cv2.GaussianBlur(view, (3, 3), 0.6)[..., None], 3, axis=2)


@pytest.fixture(scope="module")
def board_rig() -> CameraRig:
    cameras = []
    for i, (x, y, z) in enumerate([(2.4, 0.3, 2.2), (-1.6, 1.9, 2.4), (-0.6, -2.3, 2.0)]):
        c = look_at(f"c{i}", np.array([x, y, z]), (512 + 16 * i, 384), focal=420.0)
        cameras.append(Camera(c.name, c.size, c.K, np.zeros(4), c.R, c.t))
    return CameraRig(tuple(cameras))


@pytest.fixture(scope="module")
def board_clips(board_rig: CameraRig, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("board") / "checkerboard"
    for camera in board_rig:
        centers = [np.array([0.05 * k, -0.04 * k, 0.1]) for k in range(4)]
        write_video(folder / f"{camera.name}.mp4", [board_picture(camera, c) for c in centers])
    return {camera.name: folder / f"{camera.name}.mp4" for camera in board_rig}


def test_triangulation_is_exact_without_noise(board_rig: CameraRig) -> None:
    points = np.random.default_rng(2).uniform((-0.5, -0.5, 0.5), (0.5, 0.5, 1.5), (9, 3))
    pixels = [camera.project(points)[0] for camera in board_rig]
    np.testing.assert_allclose(triangulate(list(board_rig), pixels), points, atol=1e-9)


def test_true_calibration_measures_the_board(board_rig: CameraRig, board_clips: dict[str, Path]) -> None:
    found = find_boards(board_clips)
    assert found is not None
    size, views = found
    assert size == BOARD
    measure = measure_board(board_rig, size, views, square_m=SQUARE_M)
    assert measure is not None
    assert measure.rms_px < GOOD_PX
    assert measure.rms_true_size_px is not None
    assert measure.rms_true_size_px < GOOD_PX
    assert measure.square_m == pytest.approx(SQUARE_M, rel=0.01)
    assert set(measure.rms_px_of) == set(board_rig.names)


def test_turned_camera_and_wrong_scale_show(board_rig: CameraRig, board_clips: dict[str, Path]) -> None:
    found = find_boards(board_clips, BOARD, n_frames=2)
    assert found is not None
    tilt = cv2.Rodrigues(np.radians([0.8, 0.0, 0.0]))[0]
    c = board_rig[1]
    turned = CameraRig(
        (board_rig[0], Camera(c.name, c.size, c.K, c.dist, tilt @ c.R, tilt @ c.t), board_rig[2])
    )
    bad = measure_board(turned, *found)
    assert bad is not None
    assert bad.rms_px > BAD_PX
    larger = CameraRig(tuple(Camera(c.name, c.size, c.K, c.dist, c.R, c.t * 1.3) for c in board_rig))
    scaled = measure_board(larger, *found, square_m=SQUARE_M)
    assert scaled is not None
    assert scaled.rms_px < GOOD_PX
    assert scaled.square_m == pytest.approx(1.3 * SQUARE_M, rel=0.01)
    assert scaled.rms_true_size_px is not None
    assert scaled.rms_true_size_px > 3 * BAD_PX


def test_no_board_no_corners() -> None:
    assert find_board(np.random.default_rng(1).integers(0, 255, (60, 80), dtype=np.uint8), (7, 5)) is None


def test_check_compares_calibrations(
    board_rig: CameraRig, board_clips: dict[str, Path], tmp_path: Path
) -> None:
    root = tmp_path / "session"
    root.mkdir()
    (root / "checkerboard").symlink_to(board_clips["c0"].parent)
    (root / "session.toml").write_text(f"checkerboard = {list(BOARD)}\ncheckerboard_square_m = {SQUARE_M}\n")
    worse = CameraRig(tuple(Camera(c.name, c.size, c.K, c.dist, c.R, c.t * 1.1) for c in board_rig))
    write_calibration(root / "calibration.toml", board_rig)
    write_calibration(root / "calibration_old.toml", worse)
    for i, camera in enumerate(board_rig):
        write_video(
            root / "videos" / f"{camera.name}.mp4", [frame_picture(camera.size, f, i) for f in range(3)]
        )
    findings = check_session(open_session(root))
    assert any(
        f.severity == "ok" and "calibration_old.toml" in f.message and "worse" in f.message for f in findings
    )
    findings = check_session(open_session(root, calibration=root / "calibration_old.toml"))
    assert any(f.severity == "warning" and "scale is wrong by +10" in f.message for f in findings)
    assert any(
        f.severity == "warning" and "calibration.toml" in f.message and "better" in f.message
        for f in findings
    )


def test_check_of_a_plain_session(make_session: Callable[..., Path]) -> None:
    findings = check_session(open_session(make_session(12)))
    assert not [f for f in findings if f.severity == "error"]
    texts = " ".join(f.message for f in findings)
    for expected in (
        "3 cameras back, cam_10, cam_2",
        "seen by all cameras",
        "12 frames per camera",
        "no background/",
    ):
        assert expected in texts


def test_cameras_that_look_apart(tmp_path: Path) -> None:
    a = look_at("a", np.array([2.0, 0.0, 1.5]), (64, 48))
    flip = np.diag([-1.0, 1.0, -1.0])  # turned round: looks away from the middle
    b = look_at("b", np.array([-2.0, 0.0, 1.5]), (64, 48))
    b = Camera("b", b.size, b.K, b.dist, flip @ b.R, -flip @ b.R @ b.center)
    write_calibration(tmp_path / "calibration.toml", CameraRig((a, b)))
    a_turned = flip @ a.R
    rig = CameraRig((Camera("a", a.size, a.K, a.dist, a_turned, -a_turned @ a.center), b))
    write_calibration(tmp_path / "calibration.toml", rig)
    for i, camera in enumerate(rig):
        write_video(tmp_path / "videos" / f"{camera.name}.mp4", [frame_picture(camera.size, 0, i)] * 2)
    findings = check_session(open_session(tmp_path))
    errors = [f for f in findings if f.severity == "error"]
    assert len(errors) == 1
    assert "no place" in errors[0].message
    assert errors[0].remedy


def sides_of(tmp_path: Path, *azimuths_deg: float, height_m: float = 1.5) -> list[str]:
    """What the check says of the sides that cameras look from, which stand at some azimuths round the middle."""
    root = tmp_path / "-".join(f"{a:.0f}" for a in azimuths_deg)
    cameras = []
    for i, azimuth in enumerate(np.radians(azimuths_deg)):
        center = np.array([2.5 * np.cos(azimuth), 2.5 * np.sin(azimuth), height_m])
        cameras.append(look_at(f"c{i}", center, (64, 48)))
        write_video(root / "videos" / f"c{i}.mp4", [frame_picture((64, 48), 0, i)] * 2)
    write_calibration(root / "calibration.toml", CameraRig(tuple(cameras)))
    findings = check_session(open_session(root))
    said = [f.message for f in findings if f.severity == "warning"]
    assert not [text for text in said if "m3 are seen by" in text], "they see one place together"
    return [text for text in said if "degrees" in text]


def test_cameras_at_one_side_are_told_from_opposite_ones(tmp_path: Path) -> None:
    (beside,) = sides_of(tmp_path, 10.0, 25.0)
    assert "nearly the same side (widest angle" in beside
    for apart in (150.0, 180.0):
        (opposite,) = sides_of(tmp_path, 0.0, apart)
        said = re.match(r"the two cameras stand (\d+) degrees apart, opposite", opposite)
        assert said is not None
        assert abs(float(said[1]) - apart) < 5
        assert "same side" not in opposite
    (line,) = sides_of(tmp_path, 0.0, 8.0, 176.0)
    assert "all cameras stand in one line, up to 1" in line


def test_pairs_and_triples_that_serve_get_no_warning(tmp_path: Path) -> None:
    assert sides_of(tmp_path, 0.0, 60.0) == []
    assert sides_of(tmp_path, 0.0, 135.0) == []
    assert sides_of(tmp_path, 0.0, 90.0, 180.0) == []
    assert sides_of(tmp_path, 0.0, 180.0, height_m=4.0) == []  # one from above never mirrors the other


@pytest.mark.shared
def test_seated_calibrations_are_told_apart() -> None:
    if not SHARED.is_dir():
        pytest.skip("the reference material is not beside the checkout")
    root = SHARED / "real" / "seated"
    findings = check_session(open_session(root))
    assert any("calibration_as_found.toml" in f.message and "worse" in f.message for f in findings)
    assert not [f for f in findings if f.severity != "ok"]
    findings = check_session(open_session(root, calibration=root / "calibration_as_found.toml"))
    assert any(f.severity == "warning" and "better than calibration_as_found" in f.message for f in findings)
