"""A surface of triangles with a colour at every corner."""

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
