"""Boards that other programs print are recognised in the pictures: their markers, their colours, their first square."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from printed_board import CORNER_TOLERANCE_PX, MARGIN_M, PX_PER_M, frontal

from mocap.calibrate import find_board_views
from mocap.calibrate.board import Board, Print
from mocap.calibrate.detect import Sighting, find_corners
from mocap.calibrate.filmed import as_filmed
from mocap.errors import MocapError
from mocap.io.fiducials import FAMILIES, LEAST_MARKERS, OURS, fiducials_in

OURS_PRINTED = Board("charuco", 5, 6, 0.04)
PRINTS = (
    Print(),
    Print("4x4", 0.9),
    Print("4x4", is_negative=True),
    Print("6x6", 0.6, begins_white=True),
    Print("7x7", 0.5, is_negative=True, begins_white=True),
    Print("AprilTag 36h11"),
    Print("ArUco original", 0.65),
)
# Half a pixel at the corners of markers of thirty.
SHARE_TOLERANCE = 0.025


@pytest.mark.parametrize("printed", PRINTS, ids=str)
def test_the_print_of_a_board_is_read_from_a_picture(printed: Print) -> None:
    board = replace(OURS_PRINTED, print=printed)
    picture = frontal(board)
    found = as_filmed(OURS_PRINTED, picture)
    assert found is not None
    assert replace(found.print, marker_share=printed.marker_share) == printed
    assert found.print.marker_share == pytest.approx(printed.marker_share, abs=SHARE_TOLERANCE)
    corners = find_corners(found, picture)
    assert isinstance(corners, Sighting)
    assert len(corners.uv) == len(board.points)
    places = (corners.points[:, :2] + np.array(board.size_m) / 2 + MARGIN_M) * PX_PER_M - 0.5
    assert np.abs(corners.uv - places).max() < CORNER_TOLERANCE_PX
    assert not corners.is_mirrored


@pytest.mark.parametrize("printed", PRINTS, ids=str)
def test_the_drawing_of_every_print_is_that_of_opencv(printed: Print) -> None:
    """Two drawings of the same board; their edges may differ by a pixel."""
    board = replace(OURS_PRINTED, print=printed)
    picture = board.image(2000.0)
    theirs = board._pattern.generateImage(picture.shape[::-1], marginSize=0)
    theirs = 255 - theirs if printed.is_negative else theirs
    differ = cv2.erode((picture != theirs).astype(np.uint8), np.ones((3, 3), np.uint8))
    assert not differ.any()


def test_our_own_board_is_our_own_whatever_the_lens_does() -> None:
    """Seen aslant, where one picture would say another share: the default, so that its corners are sought as ever."""
    picture = frontal(OURS_PRINTED)
    height, width = picture.shape
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float32)
    aslant = corners * [0.8, 0.9] + np.array([[30, 10], [5, 40], [25, 5], [10, 20]])
    warp = cv2.getPerspectiveTransform(corners, aslant.astype(np.float32))
    found = as_filmed(OURS_PRINTED, cv2.warpPerspective(picture, warp, (width, height), borderValue=90))
    assert found == OURS_PRINTED


@pytest.mark.parametrize("board", [OURS_PRINTED, Board("aprilgrid", 4, 3, 0.04)], ids=str)
def test_the_back_of_a_board_is_its_mirror_image(board: Board) -> None:
    picture = frontal(board)
    front = find_corners(board, picture)
    back = find_corners(board, np.ascontiguousarray(picture[:, ::-1]))
    assert isinstance(front, Sighting)
    assert isinstance(back, Sighting)
    assert back.is_mirrored
    assert not front.is_mirrored
    np.testing.assert_allclose(back.points, front.points)
    np.testing.assert_allclose(back.uv[:, 0], picture.shape[1] - 1 - front.uv[:, 0], atol=1e-6)
    np.testing.assert_allclose(back.uv[:, 1], front.uv[:, 1], atol=1e-6)


@pytest.mark.parametrize("begins_white", [False, True])
def test_rows_of_another_length_are_named(begins_white: bool) -> None:
    picture = frontal(replace(OURS_PRINTED, print=Print("4x4", begins_white=begins_white)))
    with pytest.raises(MocapError, match="5 squares in a row, not 6") as caught:
        as_filmed(Board("charuco", 6, 5, 0.04), picture)
    assert "write --board charuco:5xROWS" in str(caught.value)


def test_markers_that_stand_otherwise_are_no_board() -> None:
    """The squares of a board shuffled: markers of the right family in places that no print has."""
    picture = OURS_PRINTED.image(1000.0)
    side, rows = 40, np.arange(6)[::-1]
    shuffled = np.concatenate(
        [picture[side * row : side * (row + 1)] for row in np.roll(rows[[0, 2, 4, 1, 3, 5]], 1)]
    )
    assert fiducials_in(np.pad(shuffled, 40, constant_values=255)) is not None
    assert as_filmed(OURS_PRINTED, np.pad(shuffled, 40, constant_values=255)) is None
    assert as_filmed(OURS_PRINTED, np.full((300, 400), 90, np.uint8)) is None


@pytest.mark.parametrize("shown", [LEAST_MARKERS - 1, LEAST_MARKERS])
def test_a_few_markers_are_an_accident(shown: int) -> None:
    room = np.full((200, 600), 255, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(FAMILIES["6x6"][0])
    for k in range(shown):
        room[60:140, 40 + 120 * k : 120 + 120 * k] = cv2.aruco.generateImageMarker(dictionary, 3 * k, 80)
    seen = fiducials_in(room)
    if shown < LEAST_MARKERS:
        assert seen is None
    else:
        assert seen is not None
        assert (seen.family, seen.numbers.tolist()) == ("6x6", [0, 3, 6, 9])
        np.testing.assert_allclose(seen.corners[:, 0, 0], [40, 160, 280, 400], atol=1.0)
        assert fiducials_in(room, 9) is None


def test_a_number_that_is_seen_twice_is_nobodys() -> None:
    room = np.full((200, 760), 255, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(FAMILIES[OURS][0])
    for k, number in enumerate((1, 2, 3, 5, 4, 5)):
        room[60:140, 40 + 120 * k : 120 + 120 * k] = cv2.aruco.generateImageMarker(dictionary, number, 80)
    seen = fiducials_in(room)
    assert seen is not None
    assert seen.numbers.tolist() == [1, 2, 3, 4]
    room[:, 480:640] = 255  # without the four
    assert fiducials_in(room) is None


@given(st.integers(1, 60), st.integers(1, 60), st.integers(0, 255))
def test_pictures_of_any_size_have_an_answer(height: int, width: int, level: int) -> None:
    assert as_filmed(OURS_PRINTED, np.full((height, width), level, np.uint8)) is None


def clips(folder: Path, pictures: dict[str, list[np.ndarray]]) -> Iterator[tuple[str, Path]]:
    for name, frames in pictures.items():
        (folder / name).mkdir()
        for frame, picture in enumerate(frames):
            cv2.imwrite(str(folder / name / f"{frame:03d}.png"), picture)
        yield name, folder / name


def test_clips_are_searched_for_the_board_that_they_show(tmp_path: Path) -> None:
    """The first camera sees nothing, then the back; the second the front: both find the same corners."""
    printed = replace(OURS_PRINTED, print=Print("4x4", is_negative=True))
    front = cv2.resize(frontal(printed), None, fx=0.7, fy=0.7, interpolation=cv2.INTER_AREA)
    nothing = np.full_like(front, 90)
    shown = {"back": [nothing, front[:, ::-1]], "front": [front, nothing], "both": [front, front[:, ::-1]]}
    views = find_board_views(dict(clips(tmp_path, shown)), OURS_PRINTED)
    assert views.board == printed
    assert views.n_views() == {"back": 1, "front": 1, "both": 2}
    assert views.only_mirrored() == ["back"]
    assert str(views.board) == "charuco 5 x 6 (markers 4x4, 0.75 of a square, negative)"
    np.testing.assert_allclose(views.seen[1]["back"].points, views.seen[0]["front"].points)
