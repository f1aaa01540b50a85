"""The surface of a body that moves with its joints, as animation formats want it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array


@dataclass(frozen=True, eq=False)
class Skin:
    """A triangle mesh on a skeleton at rest (no rotations, the root at the origin).

    vertices : (V, 3) m.  normals : (V, 3), outward.  faces : (F, 3) int, counter-clockwise from outside.
    joints : (V, 4) int, the joints that move a vertex, and weights : (V, 4) their shares, which sum to 1.
    """

    vertices: Array
    normals: Array
    faces: NDArray[np.int64]
    joints: NDArray[np.int64]
    weights: Array
