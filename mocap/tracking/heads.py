"""Heads of people who touch: a volume that is too large for one of them is several."""

from __future__ import annotations

import cv2
import numpy as np

from mocap.arrays import Array, Indices

_LEAST_TOP_M = 1.0  # what is lower is no head of somebody who stands or sits on a chair
# Between what two persons hide from each other a hull may be as high as shoulders are; heads rise above that.
_RISE_M = 0.15
_FINGERS_M = 0.06  # radius; what is thinner is no head
ABOVE_M = 0.1  # over a head, whose top is found a little lower than it is: that belongs to who is taller
_FAR_M = 1e3  # beyond any room
# Shoulders: within this of the head's axis, a fifth of the height under its top (a slab of so much), a section of so
# much of the height's square. Heads of two who touch have 1.3 times as much and more, hands held up 0.64 at most
# (decision 114).
_ASIDE_M = 0.25
_DOWN = 0.2
_SLAB_M = 0.06
_SECTION = 0.018


def heads_of(centers: Array, voxel_size_m: float) -> Array:
    """Tops (H, 3) m of the heads of one connected volume, the highest first.

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
            heads.append((*(origin + voxel_size_m * (peak - 1)), height))
        is_free &= ~around
    return np.array(heads).reshape(-1, 3)


def nearest_head(centers: Array, heads: Array) -> Indices:
    """Which of the heads (H, 3) m is nearest to each voxel, (N,): in the plane, and of those that it is not above."""
    gap = np.linalg.norm(centers[:, None, :2] - heads[:, :2], axis=2)
    is_above = centers[:, None, 2] > heads[:, 2] + ABOVE_M
    return np.asarray((gap + _FAR_M * is_above).argmin(axis=1))


def has_shoulders(body: Array, head: Array, voxel_size_m: float) -> bool:
    """Whether what is under a head is as wide as shoulders are; a hand that is held up has a forearm there.

    body : (N, 3) m, centres of the voxels that are nearest to this head.  head : (3,) m, its top.
    """
    aside = np.hypot(body[:, 0] - head[0], body[:, 1] - head[1])
    top = body[aside <= max(_FINGERS_M, voxel_size_m), 2].max(initial=0.0) + voxel_size_m / 2
    n_layers = max(1, round(_SLAB_M / voxel_size_m))
    layer = np.floor((body[:, 2] - (1 - _DOWN) * top) / voxel_size_m + n_layers / 2)
    in_slab = (aside <= _ASIDE_M) & (layer >= 0) & (layer < n_layers)
    section = in_slab.sum() * voxel_size_m**2 / n_layers
    return bool(section >= _SECTION * top**2)
