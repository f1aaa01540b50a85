"""Find a board in one picture, or say why it was not found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.calibrate.board import Board
from mocap.io.checkerboard import find_board, quadrangles, refined_corners

Grey = NDArray[np.uint8]
Why = Literal["not in view", "blurred", "too small", "over-exposed", "another board"]

# Corners of a part of a board that still fix its pose.
MIN_CORNERS = 6
# A square, and a bit of a marker, of fewer pixels cannot be told from its neighbours.
_MIN_SQUARE_PX, _MIN_BIT_PX = 3.0, 1.5
# Share of a region's pixels that are as bright as the sensor can say.
_MAX_BURNT = 0.75
# Slope of the steepest pixels as a share of the board's contrast: a sharp edge rises by half of it per pixel, one that
# is smeared over five pixels by a fifth.
_SHARP_SLOPE = 0.2
# OpenCV's refinement of tags counts pixels from their upper left corner; here a pixel's centre is a whole number.
_TAG_PIXEL_CENTRE = 0.5


@dataclass(frozen=True, eq=False)
class Sighting:
    """Corners of known places in one picture: points (N, 3) m of the board or the world, uv (N, 2) px.

    is_mirrored : it is the mirror image of the board that was found.
    """

    points: Array
    uv: Array
    is_mirrored: bool = False


def find_corners(board: Board, grey: Grey) -> Sighting | Why:
    """The board in a picture (H, W), or in a word why it was not found.

    A checkerboard is found whole; of boards with numbers MIN_CORNERS corners are enough.  One that is the mirror image
    of such a board is its back, on which it is printed again, corner upon corner: cameras that face each other see it.
    """
    if board.kind == "checkerboard":
        uv = find_board(grey, (board.columns, board.rows))
        return Sighting(board.points, uv) if uv is not None else _why_not(board, grey)
    for is_mirrored in (False, True):
        numbers, uv = _numbered(board, np.ascontiguousarray(grey[:, ::-1]) if is_mirrored else grey)
        if len(numbers) >= MIN_CORNERS and not _is_line(board.points[numbers]):
            if is_mirrored:
                uv[:, 0] = grey.shape[1] - 1 - uv[:, 0]
            return Sighting(board.points[numbers], uv, is_mirrored)
    return _why_not(board, grey)


def _numbered(board: Board, grey: Grey) -> tuple[NDArray[np.int64], Array]:
    """Numbers and places of the corners of a board with numbers."""
    return _charuco(board, grey) if board.kind == "charuco" else _tags(board, grey)


def _charuco(board: Board, grey: Grey) -> tuple[NDArray[np.int64], Array]:
    picture = 255 - grey if board.print.is_negative else grey
    uv, numbers, _, _ = board.marker_detector.detectBoard(picture)
    if numbers is None:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    found = np.ravel(numbers).astype(np.int64)
    corners = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
    # The detector's own windows reach into the markers, which pulls corners by up to 0.3 px.
    margin_m = (1 - board.print.marker_share) / 2 * board.side_m
    reach_px = margin_m * _smallest_scale(board.points[found, :2], corners)
    return found, refined_corners(grey, corners, reach_px)


def _smallest_scale(points: Array, uv: Array) -> float:
    """Pixels per metre along the direction in which a board is foreshortened most; 0 for less than three corners."""
    if len(uv) < 3:
        return 0.0
    centred = points - points.mean(axis=0)
    by_place = np.linalg.lstsq(centred, uv - uv.mean(axis=0), rcond=None)[0]
    return float(np.linalg.svd(by_place, compute_uv=False)[-1])


def _tags(board: Board, grey: Grey) -> tuple[NDArray[np.int64], Array]:
    """Four corners of every tag."""
    corners, tags, _ = board.marker_detector.detectMarkers(grey)
    known = [
        (int(tag), quad)
        for tag, quad in zip(np.ravel(tags) if tags is not None else (), corners, strict=True)
        if tag < board.columns * board.rows
    ]
    if not known:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    numbers = np.concatenate([4 * tag + np.arange(4) for tag, _ in known])
    corners_px = np.concatenate([quad.reshape(4, 2) for _, quad in known]).astype(np.float64)
    return numbers, corners_px - _TAG_PIXEL_CENTRE


def _is_line(points: Array) -> bool:
    """Whether corners lie in one row, which fixes no pose."""
    return bool(np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-6) < 2)


def _why_not(board: Board, grey: Grey) -> Why:
    """The likeliest reason, judged on the most spotted bright region of the picture."""
    found = quadrangles(grey)
    if not found:
        return "over-exposed" if float((grey >= 254).mean()) > _MAX_BURNT else "not in view"
    region = found[0]
    inside = np.zeros_like(grey)
    cv2.fillConvexPoly(inside, np.rint(region).astype(np.int32), 1)
    values = grey[inside > 0]
    if float((values >= 254).mean()) > _MAX_BURNT:
        return "over-exposed"
    sides = np.linalg.norm(region - np.roll(region, -1, axis=0), axis=1)
    # The region holds the white border too, some half a square on each side.
    px_per_m = sides.min() / (min(board.size_m) + board.side_m)
    if px_per_m * board.detail_m < (_MIN_BIT_PX if board.has_numbers else _MIN_SQUARE_PX):
        return "too small"
    contrast = float(np.quantile(values, 0.95)) - float(np.quantile(values, 0.05))
    slope = cv2.magnitude(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)) / 8
    if float(np.quantile(slope[inside > 0], 0.99)) < _SHARP_SLOPE * contrast:
        return "blurred"
    return "another board"
