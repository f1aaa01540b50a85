"""`mocap board` and `mocap calibrate` as a user calls them, on rendered clips of known cameras."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_session import mocap

from eval.board_calibration import BOARDS, FLOOR_FRAME, errors, looking_rig, picture, positions
from mocap.calibrate import Board, find_clips
from mocap.calibrate.board import Print
from mocap.data import CameraRig
from mocap.errors import MocapError
from mocap.io.calibration import read_calibration, write_calibration

N_PICTURES = 15
# Fifteen pictures of 400 x 300, corners off by some 0.05 px; the ends of a checkerboard look alike.
FOCAL_TOLERANCE = 0.01
PLACE_TOLERANCE_M = 0.02
SIDE_MM = 1000 * BOARDS[0].side_m


def write_clips(folder: Path, board: Board, scale: float = 1.0, seed: int = 2) -> CameraRig:
    rig = looking_rig(scale)
    for frame, (R, t) in enumerate(positions(N_PICTURES, rng=np.random.default_rng(seed))):
        for camera in rig:
            (folder / camera.name).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / camera.name / f"{frame:03d}.png"), picture(camera, board, R, t))
    return rig


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("board")
    write_clips(folder, BOARDS[0])
    return folder


def test_from_clips_to_a_calibration_and_its_page(clips: Path, tmp_path: Path) -> None:
    assert list(find_clips(clips)) == ["left", "middle", "right"]
    path = tmp_path / "calibration.toml"
    said = mocap(
        *(
            "calibrate",
            clips,
            "-o",
            path,
            "--board",
            "7x5",
            "--square-mm",
            SIDE_MM,
            "--floor-frame",
            FLOOR_FRAME,
        )
    )
    assert said.code == 0, said.err
    focal, place = errors(read_calibration(path).rig, looking_rig())
    assert focal < FOCAL_TOLERANCE
    assert place < PLACE_TOLERANCE_M
    assert float(re.search(r"Corners are off by (\S+) px", said.out)[1]) < 0.3  # type: ignore[index]
    assert f"right: {N_PICTURES} views" in said.out
    assert "warning" not in said.out
    page = (tmp_path / "calibration.html").read_text(encoding="utf-8")
    assert page.count("<img src=") == 2
    for words in ("left", "How certain the room is", "checkerboard 7 x 5"):
        assert words in page


def test_a_board_with_numbers_known_lenses_and_known_places(tmp_path: Path) -> None:
    rig = write_clips(tmp_path / "charuco", BOARDS[1], scale=1.6)  # bits of a marker are small
    write_calibration(tmp_path / "lenses.toml", rig)
    points = np.array(
        [[0.5, 0.4, 0.0], [-0.4, 0.5, 0.0], [0.3, -0.6, 0.0], [-0.5, -0.4, 0.9], [0.2, 0.1, 1.2]]
    )
    rows = ["camera,u_px,v_px,x_m,y_m,z_m"]
    for camera in rig:
        for uv, xyz in zip(camera.project(points)[0], points, strict=True):
            rows.append(",".join([camera.name, *map(str, (*uv, *xyz))]))
    (tmp_path / "points.csv").write_text("\n".join(rows) + "\n")
    path = tmp_path / "calibration.toml"
    said = mocap(
        *("calibrate", tmp_path / "charuco", "-o", path, "--board", "charuco:8x6", "--square-mm", SIDE_MM),
        *("--points", tmp_path / "points.csv", "--lenses", tmp_path / "lenses.toml", "--frames", 9),
    )
    assert said.code == 0, said.err
    found = read_calibration(path).rig
    assert errors(found, rig)[1] < PLACE_TOLERANCE_M
    for a, b in zip(found, rig, strict=True):
        np.testing.assert_allclose(a.K, b.K, rtol=1e-9)
    assert "px, given" in (tmp_path / "calibration.html").read_text(encoding="utf-8")


def test_a_board_of_another_program_and_a_clip_that_is_mirrored(tmp_path: Path) -> None:
    """Its print is found and said; a mirrored clip is named, where its remedy would be another."""
    rig = write_clips(tmp_path / "clips", replace(BOARDS[1], print=Print("4x4", is_negative=True)), scale=1.6)
    write_calibration(tmp_path / "lenses.toml", rig)
    path = tmp_path / "calibration.toml"
    call = (
        *("calibrate", tmp_path / "clips", "-o", path, "--board", "charuco:8x6", "--square-mm", SIDE_MM),
        *("--floor-frame", FLOOR_FRAME, "--lenses", tmp_path / "lenses.toml", "--frames", 12),
    )
    said = mocap(*call)
    assert said.code == 0, said.err
    assert "Board: charuco 8 x 6 (markers 4x4, 0.75 of a square, negative), squares of" in said.out
    assert errors(read_calibration(path).rig, rig)[1] < PLACE_TOLERANCE_M
    path.unlink()
    for picture_path in (tmp_path / "clips" / "left").iterdir():
        cv2.imwrite(str(picture_path), cv2.imread(str(picture_path))[:, ::-1])
    said = mocap(*call)
    assert said.code == 2, said.out
    assert "what left saw is the mirror image of the board" in said.err
    assert not path.exists()


def test_mistakes_are_named_and_nothing_is_written(clips: Path, tmp_path: Path) -> None:
    lens_of_one = tmp_path / "one"
    (lens_of_one / "left").mkdir(parents=True)
    cv2.imwrite(str(lens_of_one / "left" / "0.png"), np.zeros((30, 40, 3), np.uint8))
    (tmp_path / "points.csv").write_text("camera,u_px\nleft,3\n")
    floor = ("--floor-frame", FLOOR_FRAME)
    for wrong, message in (
        (("--board", "charuco:8x6", *floor), "write --board 7x5"),
        (("--board", "7x5", "--floor-frame", 99), f"have frames 0 to {N_PICTURES - 1}"),
        (("--board", "seven", *floor), "cannot read the board"),
        (("--board", "2x5", *floor), "a board of 2 x 5"),
        (("--board", "7x5"), "the world is not given"),
        (("--board", "7x5", *floor, "--points", tmp_path / "points.csv"), "given twice"),
        (("--board", "7x5", "--points", tmp_path / "points.csv"), "is missing"),
        (("--board", "7x5", *floor, "--lens", "fishy"), "did you mean 'fisheye'"),
        (("--board", "7x5", *floor, "--lenses", lens_of_one), "no lens for camera middle, right"),
    ):
        said = mocap(
            *("calibrate", clips, "-o", tmp_path / "no.toml", "--square-mm", SIDE_MM, "--frames", 6, *wrong)
        )
        assert said.code == 2, (wrong, said.out)
        assert message in said.err, said.err
        assert "Remedy" in said.err
    assert not (tmp_path / "no.toml").exists()
    assert not (tmp_path / "no.html").exists()
    with pytest.raises(MocapError, match="no clips of two or more cameras"):
        find_clips(tmp_path)


def test_a_board_is_printed(tmp_path: Path) -> None:
    path = tmp_path / "board.pdf"
    said = mocap("board", "-o", path, "--board", "charuco:8x6", "--paper", "a3")
    assert said.code == 0, said.err
    assert path.read_bytes().startswith(b"%PDF")
    assert re.search(r"mocap calibrate CLIPS .* --board charuco:8x6 --square-mm \d+", said.out)
    said = mocap("board", "-o", path, "--paper", "a9")
    assert said.code == 2
    assert "--paper" in said.err
