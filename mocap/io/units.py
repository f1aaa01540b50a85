"""Units of length and up axes that files are written in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

METRES_PER_UNIT: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
UNITS = tuple(METRES_PER_UNIT)
# Axis of a file that points up.
AXES = ("x", "-x", "y", "-y", "z", "-z")
# By the axis that points up: rows are our x, y, z (z up) in the axes of the file. Proper rotations: left and right stay
# what they are. Calibrations are turned so; a truth that belongs to one must be turned alike.
Z_UP_FROM: dict[str, NDArray[np.float64]] = {
    "z": np.eye(3),
    "-z": np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]]),
    "y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "-y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "x": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "-x": np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]]),
}


def unit_from_word(word: str) -> str | None:
    """ "m", "cm" or "mm" of a word like "metres"; None when it is no length unit we know."""
    w = word.strip().lower()
    if w in METRES_PER_UNIT:
        return w
    stem = w.removesuffix("s").replace("metre", "meter")
    return {"meter": "m", "centimeter": "cm", "millimeter": "mm"}.get(stem)
