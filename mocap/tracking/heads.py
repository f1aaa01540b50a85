"""Heads of people who touch: a volume that is too large for one of them is several."""

from __future__ import annotations

import cv2
import numpy as np

from mocap.arrays import Array

_LEAST_TOP_M = 1.0  # what is lower is no head of somebody who stands or sits on a chair
# Between what two persons hide from each other a hull may be as high as shoulders are; heads rise above that.
_RISE_M = 0.15
_FINGERS_M = 0.06  # radius; what is thinner is no head


def heads_of(centers: Array, voxel_size_m: float) -> Array:
    """Places (H, 2) m of the heads of one connected volume, the highest first.

    centers : (N, 3) m of its voxels.
    A head is the highest place of all around from which one cannot come to a higher one without descending by 0.15 m.
    """
    x, y, z = np.ascontiguousarray(centers.T, dtype=np.float32)  # reducing rows of three is ten times slower
    origin = np.array([x.min(), y.min()])
    column, row = (np.rint((c - c.min()) / voxel_size_m).astype(np.int64) + 1 for c in (x, y))
    top = np.zeros((column.max() + 2, row.max() + 2), dtype=np.float32)  # with a rim of nothing
    np.maximum.at(top.ravel(), column * top.shape[1] + row, z + np.float32(voxel_size_m / 2))
    radius = round(_FINGERS_M / voxel_size_m)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    top = cv2.morphologyEx(top, cv2.MORPH_OPEN, disc)
    is_free = np.ones(top.shape, dtype=np.bool_)
    heads = []
    while True:
        rest = np.where(is_free, top, 0.0)
        height = float(rest.max())
        if height < _LEAST_TOP_M:
            break
        _, labels = cv2.connectedComponents((top > height - _RISE_M).astype(np.uint8), connectivity=8)
        around = labels == labels[np.unravel_index(np.argmax(rest), rest.shape)]
        if not (around & ~is_free).any():
            peak = np.argwhere(around & (top > height - voxel_size_m / 2)).mean(axis=0)
            heads.append(origin + voxel_size_m * (peak - 1))
        is_free &= ~around
    return np.array(heads).reshape(-1, 2)
