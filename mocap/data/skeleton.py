"""An animated skeleton, as animation formats want it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Joints of one person over time with local rotations.

    names : J joint names, parents before children.  parents : (J,) int, -1 for the root.
    offsets : (J, 3) m, joint origin in the parent's frame at rest (body frame: x forward, y left, z up).
    end_offsets : joint index -> (3,) m, tip of a leaf segment in that joint's frame.
    rotations : (T, J, 3, 3) local rotation of each joint against its parent; the root's against the world.
    root_position : (T, 3) m, world.
    """

    person: int
    names: tuple[str, ...]
    parents: NDArray[np.int64]
    offsets: Array
    end_offsets: dict[int, Array]
    rotations: Array
    root_position: Array

    def global_positions(self) -> Array:
        """Joint origins in the world frame, (T, J, 3) m."""
        T, J = self.rotations.shape[:2]
        position = np.zeros((T, J, 3))
        rotation = np.zeros((T, J, 3, 3))
        for j in range(J):
            p = int(self.parents[j])
            if p < 0:
                position[:, j] = self.root_position
                rotation[:, j] = self.rotations[:, j]
            else:
                position[:, j] = position[:, p] + rotation[:, p] @ self.offsets[j]
                rotation[:, j] = rotation[:, p] @ self.rotations[:, j]
        return position
