"""How a ChArUco board is printed that pictures show: other programs print other markers than `mocap board`."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.calibrate.board import Board, Print
from mocap.errors import MocapError
from mocap.io.fiducials import Fiducials, fiducials_in

# Sides of markers that are tried, as a share of a square's.
_SHARES = np.arange(0.40, 0.96, 0.01)
# A share so near to that of our own boards is that of our own: one picture tells it to some hundredths.
_SAME_SHARE = 0.03
# How far, in squares, corners of markers may lie from where the print has them: distortion bends a whole board by less.
_MOST_APART = 0.15
# Squares in a row that are tried when those of the board do not explain the markers.
_COLUMNS = range(3, 13)


def as_filmed(board: Board, grey: NDArray[np.uint8]) -> Board | None:
    """The ChArUco board as it is printed, by a picture (H, W); None when the picture does not show it.

    Raises MocapError when the markers stand in rows of another length.
    """
    seen = fiducials_in(grey, board.columns * board.rows // 2)
    if seen is None:
        return None
    if found := _fitted(board, seen):
        share = found.print.marker_share
        usual = Print().marker_share
        share = usual if abs(share - usual) <= _SAME_SHARE else round(share, 2)
        return replace(found, print=replace(found.print, marker_share=share))
    for columns in _COLUMNS:
        # Rows for all that is seen, and an even number: where the first square matters.
        rows = 2 * -(-(int(seen.numbers.max()) + 1) // columns)
        if _fitted(replace(board, columns=columns, rows=rows), seen):
            raise MocapError(
                f"the clips show a ChArUco board with {columns} squares in a row, not {board.columns}",
                remedy=f"write --board charuco:{columns}xROWS, ROWS the squares from top to bottom",
            )
    return None


def _fitted(shape: Board, seen: Fiducials) -> Board | None:
    """A board of this shape in the print that explains best where markers are; None when none does."""
    tried = [
        replace(shape, print=Print(seen.family, float(share), seen.is_negative, begins_white))
        for begins_white, share in product((False, True), _SHARES)
    ]
    apart = [_apart(each.marker_corners(seen.numbers) / each.side_m, seen.corners) for each in tried]
    best = int(np.argmin(apart))
    return tried[best] if apart[best] <= _MOST_APART else None


def _apart(squares: Array, px: Array) -> float:
    """How far corners (N, 4, 2) px lie from those of a plane (N, 4, 2), root mean square in units of the plane."""
    places, seen = squares.reshape(-1, 2), px.reshape(-1, 2)
    plane_from_picture, _ = cv2.findHomography(seen, places)
    if plane_from_picture is None:
        return np.inf
    mapped = cv2.perspectiveTransform(seen[None], plane_from_picture)[0]
    return float(np.sqrt(np.mean(np.sum((mapped - places) ** 2, axis=1))))
