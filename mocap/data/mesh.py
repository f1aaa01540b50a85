"""Surfaces of triangles, and clouds of points, with a colour at every corner and point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array


@dataclass(frozen=True, eq=False)
class ColouredMesh:
    """vertices : (V, 3) m, world.  faces : (F, 3) int, anticlockwise from outside.  rgb : (V, 3) uint8, sRGB."""

    vertices: Array
    faces: NDArray[np.int64]
    rgb: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class ColouredCloud:
    """points : (N, 3) m, world.  rgb : (N, 3) uint8, sRGB."""

    points: Array
    rgb: NDArray[np.uint8]
