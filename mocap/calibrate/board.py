"""Boards: what is printed, where its corners are, and how it is written on the command line.

All of them are drawn from the same list of black rectangles: on paper, and in the pictures of tests.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Indices
from mocap.errors import MocapError
from mocap.io.fiducials import OURS, TAGS, dictionary_of

Kind = Literal["checkerboard", "charuco", "aprilgrid"]
KINDS: tuple[Kind, ...] = ("checkerboard", "charuco", "aprilgrid")
# A tag's distance to the next, as a share of its side.
GAP_SHARE = 0.3
_FEWEST, _MOST = 3, 50


@dataclass(frozen=True)
class Print:
    """How a ChArUco board is printed; by default as `mocap board` does it.  Other programs print other boards.

    family : of its markers, one of `mocap.io.fiducials.FAMILIES`.  marker_share : a marker's side, as a share of its
    square.  is_negative : black and white exchanged.  begins_white : the upper left square is white though rows are
    even, as OpenCV before 4.6 drew it.
    """

    family: str = OURS
    marker_share: float = 0.75
    is_negative: bool = False
    begins_white: bool = False

    def __str__(self) -> str:
        words = f"markers {self.family}, {self.marker_share:.2f} of a square"
        return words + ", negative" * self.is_negative + ", begins white" * self.begins_white


@dataclass(frozen=True)
class Board:
    """A flat calibration target.

    columns, rows : inner corners of a checkerboard, squares of a ChArUco board, tags of an AprilTag grid.
    side_m : of a square; of a tag.  print : of a ChArUco board.
    """

    kind: Kind
    columns: int
    rows: int
    side_m: float
    print: Print = Print()

    def __post_init__(self) -> None:
        if not self.side_m > 0:
            raise ValueError(f"side_m must be positive, got {self.side_m}")

    def __str__(self) -> str:
        unusual = f" ({self.print})" if self.print != Print() else ""
        return f"{self.kind} {self.columns} x {self.rows}{unusual}"

    @property
    def has_numbers(self) -> bool:
        """Whether every corner says which one it is: then a part of the board is enough."""
        return self.kind != "checkerboard"

    @property
    def n_squares(self) -> tuple[int, int]:
        """Squares along and down a board of squares."""
        more = 1 if self.kind == "checkerboard" else 0
        return self.columns + more, self.rows + more

    @property
    def pitch_m(self) -> float:
        """From one square or tag to the next."""
        return self.side_m * (1 + GAP_SHARE) if self.kind == "aprilgrid" else self.side_m

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of what is printed, m."""
        if self.kind == "aprilgrid":
            return tuple(n * self.pitch_m - GAP_SHARE * self.side_m for n in (self.columns, self.rows))  # type: ignore[return-value]
        across, down = self.n_squares
        return across * self.side_m, down * self.side_m

    @property
    def detail_m(self) -> float:
        """Side of the smallest thing that must be seen: a square, or a bit of a marker."""
        if self.kind == "checkerboard":
            return self.side_m
        share = self.print.marker_share if self.kind == "charuco" else 1.0
        return share * self.side_m / (self._dictionary.markerSize + 2)

    @cached_property
    def points(self) -> Array:
        """Corners (N, 3) m about the middle of the board, z = 0: x along the rows, y down the columns."""
        if self.kind == "aprilgrid":
            corners = np.concatenate(self._pattern.getObjPoints()).astype(np.float64)[:, :2]
        else:
            across, down = self.n_squares
            grid = np.meshgrid(np.arange(1.0, across), np.arange(1.0, down))
            corners = np.column_stack([axis.ravel() for axis in grid]) * self.side_m
        flat = np.zeros((len(corners), 3))
        flat[:, :2] = corners - np.array(self.size_m) / 2
        return flat

    @cached_property
    def marker_detector(self) -> Any:
        """OpenCV's detector of a board with numbers."""
        if self.kind == "charuco":
            return cv2.aruco.CharucoDetector(self._pattern)
        parameters = cv2.aruco.DetectorParameters()
        # Lines fitted to a tag's edges: 0.1 px, where the other refinements pull corners 0.4 px into the tag.
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
        return cv2.aruco.ArucoDetector(self._dictionary, parameters)

    @property
    def black(self) -> NDArray[np.float64]:
        """Black rectangles (K, 4) m: x, y of the upper left corner in the printed board, width, height."""
        squares = [] if self.kind == "aprilgrid" else self._black_squares()
        bits = self._black_bits() if self.has_numbers else []
        return np.array([*squares, *bits])

    def image(self, px_per_m: float, margin_m: float = 0.0) -> NDArray[np.uint8]:
        """The printed board with a white margin, grey values."""
        size = np.rint((np.array(self.size_m) + 2 * margin_m) * px_per_m).astype(int)
        picture = np.full((size[1], size[0]), 255, dtype=np.uint8)
        for x, y, w, h in self.black:
            edges = np.array([x, y, x + w, y + h]) + margin_m
            left, top, right, bottom = np.rint(edges * px_per_m).astype(int)
            picture[top:bottom, left:right] = 0
        return 255 - picture if self.print.is_negative else picture

    @cached_property
    def _dictionary(self) -> Any:
        family = self.print.family if self.kind == "charuco" else TAGS
        return dictionary_of(family, self.columns * self.rows)

    def marker_corners(self, numbers: Indices) -> Array:
        """Corners (N, 4, 2) m of markers of a ChArUco board, from its upper left corner."""
        return np.array([self._pattern.getObjPoints()[number] for number in numbers])[..., :2]

    @cached_property
    def _pattern(self) -> Any:
        if self.kind == "charuco":
            marker_m = self.print.marker_share * self.side_m
            pattern = cv2.aruco.CharucoBoard(
                (self.columns, self.rows), self.side_m, marker_m, self._dictionary
            )
            pattern.setLegacyPattern(self.print.begins_white)
            return pattern
        gap_m = GAP_SHARE * self.side_m
        return cv2.aruco.GridBoard((self.columns, self.rows), self.side_m, gap_m, self._dictionary)

    def _black_squares(self) -> list[tuple[float, float, float, float]]:
        across, down = self.n_squares
        side = self.side_m
        first = 1 if self.print.begins_white and down % 2 == 0 else 0
        return [
            (x * side, y * side, side, side)
            for y in range(down)
            for x in range(across)
            if (x + y) % 2 == first
        ]

    def _black_bits(self) -> list[tuple[float, float, float, float]]:
        """The dark modules of all markers, each in its place."""
        n_modules = self._dictionary.markerSize + 2
        rectangles = []
        for number, corners in zip(self._pattern.getIds(), self._pattern.getObjPoints(), strict=True):
            bits = cv2.aruco.generateImageMarker(self._dictionary, int(number), n_modules)
            (left, top), right = corners[0][:2], corners[1][0]
            module = float(right - left) / n_modules
            rectangles += [
                (float(left) + x * module, float(top) + y * module, module, module)
                for y, x in np.argwhere(bits < 128)
            ]
        return rectangles


def board_from_text(text: str, side_mm: float) -> Board:
    """`9x6`, `checkerboard:9x6` (inner corners), `charuco:8x6` (squares), `aprilgrid:6x4` (tags).

    side_mm : of a square, of a tag.  Raises MocapError for anything else, and for counts below 3 or above 50.
    """
    kind, _, counts = text.strip().lower().rpartition(":")
    columns, _, rows = counts.partition("x")
    kind = kind or "checkerboard"
    if kind not in KINDS or not (columns.strip().isdecimal() and rows.strip().isdecimal()):
        raise MocapError(
            f"cannot read the board {text!r}",
            remedy="write 9x6 for a checkerboard of so many inner corners (columns x rows), charuco:8x6 (squares) or "
            "aprilgrid:6x4 (tags)",
        )
    size = int(columns), int(rows)
    if min(size) < _FEWEST or max(size) > _MOST:
        raise MocapError(
            f"a board of {size[0]} x {size[1]}",
            remedy=f"use one of {_FEWEST} to {_MOST}; a checkerboard is counted by its inner corners, not squares",
        )
    return Board(kind, *size, side_mm / 1000)  # type: ignore[arg-type]
