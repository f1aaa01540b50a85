"""Things that were tracked as persons: a box or a chair where the empty scene had nothing.

A volume does not say what it is of, and people keep still as well. But nobody keeps as still as a thing, and no pose of
a body explains one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.pose.method import ThingSettings
from mocap.pose.result import FollowedPerson

Array = NDArray[np.float64]
# Rows of the voxels on a hull's surface (N,), and their colours (N, 3), grey levels.
Look = tuple[NDArray[np.int32], NDArray[np.uint8]]


def is_like_nobody(followed: FollowedPerson, xyz: Array, numbers: ThingSettings) -> bool:
    """Whether somebody who was followed stays in one place all the time, and has no pose that explains his volumes.

    xyz : (T, 3) m, his track.
    """
    fps = followed.tools.fps
    misfit = followed.series.misfit.sum(axis=1)[followed.series.blind_std == 0]
    if len(xyz) < numbers.least_s * fps or not len(misfit):
        return False
    away_m = np.linalg.norm(xyz[:, :2] - np.median(xyz[:, :2], axis=0), axis=1)
    stays = np.quantile(away_m, numbers.stays_share) < numbers.stays_m
    return bool(stays and np.median(misfit) > numbers.misfit_nats)


def colour_change(looks: Sequence[Look], seen_share: float) -> float | None:
    """How much the colours of a surface change over several looks, grey levels; None where none of it stays.

    Of every voxel that is on the surface in `seen_share` of the looks the median distance from its usual colour, in the
    mean over channels and voxels: who passes before a thing hides it in some of the looks only.
    """
    n = len(looks)
    if n == 0:
        return None
    voxels, at = np.unique(np.concatenate([v for v, _ in looks]), return_inverse=True)
    colours = np.full((len(voxels), n, 3), np.nan, dtype=np.float32)
    look = np.repeat(np.arange(n), [len(v) for v, _ in looks])
    colours[at.reshape(-1), look] = np.concatenate([rgb for _, rgb in looks])
    lasting = colours[np.isfinite(colours[:, :, 0]).sum(axis=1) >= max(2.0, seen_share * n)]
    if not len(lasting):
        return None
    off = np.abs(lasting - np.nanmedian(lasting, axis=1, keepdims=True)).mean(axis=2)
    return float(np.nanmedian(off, axis=1).mean())


def keeps_its_colours(looks: Sequence[Look], numbers: ThingSettings) -> bool:
    """Whether all of a surface keeps its colours, as a thing does and nobody who breathes and looks about."""
    change = colour_change(looks, numbers.seen_share)
    return change is not None and change < numbers.colour_levels
