"""Legs that masks have lost: a part of somebody hangs in the air, and what carries it must be straight below."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import VoxelGrid

Voxels = NDArray[np.int32]

# Hulls that begin lower are of somebody who jumps: up to 0.25 m in random scenes of jumps.
_IN_THE_AIR_M = 0.4
# Hulls of more extent are whole: somebody on a table, on a ladder or at a bar.
_WHOLE_M = 1.4
_HEM_M = 0.15  # above the lowest place: trousers are lost from the hem of a shirt on, arms reach lower than neither
_STRIDE_M = 0.15  # from below the hem to the feet
_STRAY = 0.002  # share of the voxels that may lie lower


def lost_legs(person: Voxels, grid: VoxelGrid) -> Voxels:
    """Voxels straight below a person's hull that hangs in the air, as far as legs can be: ascending, without his own.

    person : (N,) int32, voxels of one person. Nothing for who stands on the floor z = 0, jumps, or hangs in the air
    with all of himself. Whether his legs are there no hull says: masks that have lost them show the floor.
    """
    nothing = person[:0]
    if not len(person):
        return nothing
    height = grid.centers(person)[:, 2]
    lowest = float(np.quantile(height, _STRAY))
    if lowest < _IN_THE_AIR_M or height.max() - lowest > _WHOLE_M:
        return nothing
    hem = grid.dense(person[height < lowest + _HEM_M]).any(axis=2).astype(np.uint8)
    reach = round(_STRIDE_M / grid.voxel_size_m)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    below = np.zeros(grid.shape, dtype=np.bool_)
    n = int((lowest - grid.origin[2]) / grid.voxel_size_m)
    below[:, :, :n] = cv2.dilate(hem, disc)[:, :, None] > 0
    return np.setdiff1d(np.flatnonzero(below.ravel()), person).astype(np.int32)
