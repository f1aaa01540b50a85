"""Pixels of silhouettes: a sample of the foreground with its colours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_PIXELS_ACROSS = 80  # lattice points over a picture's width


@dataclass(frozen=True, eq=False)
class SilhouettePixels:
    """A sample of the foreground of all cameras in one frame.

    camera : (M,) uint8 index.  uv : (M, 2) int16, column and row.  rgb : (M, 3) uint8.
    """

    camera: NDArray[np.uint8]
    uv: NDArray[np.int16]
    rgb: NDArray[np.uint8]


def lattice_step(width: int) -> int:
    """Pixels between the points of a camera's sampling lattice."""
    return max(1, round(width / _PIXELS_ACROSS))
