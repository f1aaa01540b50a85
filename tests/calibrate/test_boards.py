"""Boards: what is printed is what is looked for, on paper and in pictures."""

from __future__ import annotations

import re
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from printed_board import CORNER_TOLERANCE_PX, MARGIN_M, PX_PER_M, frontal

from mocap.calibrate.board import Board, board_from_text
from mocap.calibrate.detect import Sighting, find_corners
from mocap.calibrate.printed import PAPERS, largest_side_mm, write_board
from mocap.errors import MocapError

BOARDS = (Board("checkerboard", 7, 5, 0.04), Board("charuco", 6, 5, 0.04), Board("aprilgrid", 4, 3, 0.04))


@pytest.mark.parametrize("board", BOARDS, ids=str)
def test_corners_are_found_where_they_are_printed(board: Board) -> None:
    found = find_corners(board, frontal(board))
    assert isinstance(found, Sighting)
    assert len(found.uv) == len(board.points)
    places = (found.points[:, :2] + np.array(board.size_m) / 2 + MARGIN_M) * PX_PER_M - 0.5
    if board.has_numbers:
        assert np.abs(found.uv - places).max() < CORNER_TOLERANCE_PX
    else:  # from either end
        ends = [np.abs(order - places).max() for order in (found.uv, found.uv[::-1])]
        assert min(ends) < CORNER_TOLERANCE_PX


@pytest.mark.parametrize("board", [b for b in BOARDS if b.has_numbers], ids=str)
def test_a_part_of_a_board_with_numbers_is_enough(board: Board) -> None:
    picture = frontal(board)
    picture[:, : picture.shape[1] // 2] = 90
    found = find_corners(board, picture)
    assert isinstance(found, Sighting)
    assert len(board.points) > len(found.uv) >= 6
    assert found.points[:, 0].min() > -1e-9 - 0.5 * board.pitch_m


@pytest.mark.parametrize("board", BOARDS[1:], ids=str)
def test_the_drawing_is_that_of_opencv(board: Board) -> None:
    """Two drawings of the same board; their edges may differ by a pixel."""
    picture = board.image(2000.0)
    theirs = board._pattern.generateImage(picture.shape[::-1], marginSize=0)
    differ = cv2.erode((picture != theirs).astype(np.uint8), np.ones((3, 3), np.uint8))
    assert not differ.any()


def test_why_a_board_was_not_found() -> None:
    board = BOARDS[0]
    picture = frontal(board)
    room = np.full((600, 800), 90, dtype=np.uint8)
    h, w = picture.shape
    room[50 : 50 + h, 60 : 60 + w] = picture
    assert isinstance(find_corners(board, room), Sighting)
    assert find_corners(board, np.full((600, 800), 90, dtype=np.uint8)) == "not in view"
    assert find_corners(Board("checkerboard", 8, 6, 0.04), room) == "another board"
    markers = np.full((600, 800), 90, dtype=np.uint8)
    half = cv2.resize(frontal(BOARDS[1]), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    markers[200 : 200 + half.shape[0], 300 : 300 + half.shape[1]] = half
    assert isinstance(find_corners(BOARDS[1], markers), Sighting)
    assert find_corners(BOARDS[1], cv2.blur(markers, (9, 9))) == "blurred"
    small = np.full((600, 800), 90, dtype=np.uint8)
    tiny = cv2.resize(half, None, fx=0.12, fy=0.12, interpolation=cv2.INTER_AREA)
    small[300 : 300 + tiny.shape[0], 400 : 400 + tiny.shape[1]] = tiny
    assert find_corners(BOARDS[1], small) == "too small"
    assert find_corners(board, np.full((600, 800), 255, dtype=np.uint8)) == "over-exposed"


@given(arrays(np.uint8, st.tuples(st.integers(1, 40), st.integers(1, 40))), st.sampled_from(BOARDS))
def test_any_picture_has_an_answer(picture: np.ndarray, board: Board) -> None:
    found = find_corners(board, picture)
    assert isinstance(found, (Sighting, str))


@pytest.mark.parametrize(
    ("text", "kind", "size"),
    [
        ("9x6", "checkerboard", (9, 6)),
        ("ChArUco:8X5", "charuco", (8, 5)),
        ("aprilgrid:6x4", "aprilgrid", (6, 4)),
    ],
)
def test_boards_are_read(text: str, kind: str, size: tuple[int, int]) -> None:
    board = board_from_text(text, 35.0)
    assert (board.kind, (board.columns, board.rows), board.side_m) == (kind, size, 0.035)


@pytest.mark.parametrize(
    "text", ["", "seven", "7", "7x", "x5", "circles:7x5", "7x5x3", "-7x5", "7.5x5", "²x5"]
)
def test_what_is_no_board_is_refused(text: str) -> None:
    with pytest.raises(MocapError, match="cannot read the board"):
        board_from_text(text, 35.0)


@pytest.mark.parametrize("text", ["2x5", "5x51", "charuco:1x9"])
def test_boards_of_odd_size_are_refused(text: str) -> None:
    with pytest.raises(MocapError, match="a board of"):
        board_from_text(text, 35.0)


@pytest.mark.parametrize("board", BOARDS, ids=str)
@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_the_printed_page_has_the_size_of_the_paper_and_the_squares_theirs(
    tmp_path: Path, board: Board, paper: str
) -> None:
    side_mm = min(largest_side_mm(board, paper), 25)
    board = Board(board.kind, board.columns, board.rows, side_mm / 1000)
    write_board(tmp_path / "a.pdf", board, paper)
    write_board(tmp_path / "b.pdf", board, paper)
    content = (tmp_path / "a.pdf").read_bytes()
    assert content == (tmp_path / "b.pdf").read_bytes()
    box = [float(v) for v in re.search(rb"/MediaBox \[ ?0 0 (\S+) (\S+?) ?\]", content).groups()]  # type: ignore[union-attr]
    assert sorted(box) == pytest.approx([v / 25.4 * 72 for v in PAPERS[paper]], abs=0.01)
    first = board.black[0]
    assert _first_square_points(content) == pytest.approx(1000 * first[2] / 25.4 * 72, abs=0.02)


def _first_square_points(content: bytes) -> float:
    """Width of the second closed path of four corners in the page's drawing, points; the first is the page."""
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", content, re.DOTALL)
    drawing = b"\n".join(_inflated(s) for s in streams)
    paths = re.findall(rb"(\S+) (\S+) m\s+(\S+) (\S+) l\s+(\S+) (\S+) l\s+(\S+) (\S+) l\s+h", drawing)
    numbers = np.array([float(v) for v in paths[1]]).reshape(4, 2)
    return float(np.ptp(numbers[:, 0]))


def _inflated(stream: bytes) -> bytes:
    try:
        return zlib.decompress(stream)
    except zlib.error:
        return stream


def test_a_board_larger_than_the_paper_is_refused_with_the_size_that_fits(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="does not fit on a4") as caught:
        write_board(tmp_path / "a.pdf", Board("charuco", 8, 6, 0.05), "a4")
    fits = int(re.search(r"--square-mm (\d+)", caught.value.remedy)[1])  # type: ignore[index, arg-type]
    write_board(tmp_path / "a.pdf", Board("charuco", 8, 6, fits / 1000), "a4")
    with pytest.raises(MocapError, match="does not fit"):
        write_board(tmp_path / "a.pdf", Board("charuco", 8, 6, (fits + 1) / 1000), "a4")
