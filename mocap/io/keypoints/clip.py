"""Keypoints of one camera while they are read: figures by frame, from whatever a file calls them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data.keypoints import KEYPOINTS, N_KEYPOINTS
from mocap.errors import MocapError
from mocap.io.keypoints.names import known_of
from mocap.io.tables import MOST_OF

Array = NDArray[np.float64]

# A body needs a few points; a file that names fewer of them is of something else.
_LEAST_KNOWN = 4
# More people than this in one picture are no keypoints of a recording.
_MOST_FIGURES = 100


@dataclass
class CameraKeypoints:
    """The figures of one camera.  of_frame : frame -> list of (K, 3): u px, v px, confidence; NaN = not found."""

    path: Path
    of_frame: dict[int, list[Array]] = field(default_factory=dict)

    def add(self, frame: int, points: Array) -> None:
        """A figure (K, 3); one without a single point is nobody."""
        figures = self.of_frame.setdefault(frame, [])
        if np.isfinite(points[:, :2]).all(axis=1).any():
            figures.append(points)
        if len(figures) > _MOST_FIGURES:
            raise bad(self.path, f"more than {_MOST_FIGURES} persons in one picture", frame)

    @property
    def n_frames(self) -> int:
        """Frames up to the last one that the file tells of."""
        return max(self.of_frame, default=-1) + 1


def new_figure() -> Array:
    """A figure (K, 3) without points."""
    return np.full((N_KEYPOINTS, 3), math.nan)


def placed(figure: Array, row: int, u: float, v: float, confidence: float) -> None:
    """Put a point into a figure (K, 3); coordinates that are not finite and confidence 0 mean that it was not found."""
    if math.isfinite(u) and math.isfinite(v) and confidence > 0:
        figure[row] = u, v, min(confidence, 1.0)


def known_rows(names: Sequence[str], path: Path) -> list[int | None]:
    """Rows of KEYPOINTS of a file's names, None = left out; MocapError when hardly any is known."""
    rows = known_of(names)
    if sum(row is not None for row in rows) < _LEAST_KNOWN:
        raise MocapError(
            f"the keypoints are called {', '.join(names[:8])}: fewer than {_LEAST_KNOWN} of them are known",
            path=path,
            remedy=f"call them as here: {', '.join(KEYPOINTS)}",
        )
    return rows


def finite_or_none(value: object, path: Path, frame: int) -> float:
    """A coordinate or confidence; NaN for one that is missing, MocapError for what is no number or reaches too far."""
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise bad(path, f"{value!r} is no number", frame)
    if abs(value) > MOST_OF["px"] and math.isfinite(value):
        raise bad(path, f"{value!r}: no picture reaches that far", frame)
    return float(value)


def bad(path: Path, message: str, frame: int | None = None) -> MocapError:
    """The error for a file of keypoints that cannot be."""
    return MocapError(
        f"keypoints cannot be read: {message}",
        path=path,
        frame=frame,
        remedy="write the file again with the tool it comes from, or see docs/keypoints.md for what is read",
    )
