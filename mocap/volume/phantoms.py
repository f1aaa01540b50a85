"""Phantoms: volumes where rays to several persons cross, which no silhouette needs.

Silhouettes of several persons leave more volume than theirs; what is nobody's has no pixels of its own, see `Covered`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Mask
from mocap.data import CameraRig, VoxelGrid
from mocap.data.covered import LEAST_CAMERAS, Covered
from mocap.data.voxels import Voxels
from mocap.volume.components import connected_components

# Pieces that could be taken for somebody; smaller ones are hands, or crumbs.
_LEAST_LITRES = 5.0
# Of a piece's pixels, the median over cameras: next to none of a phantom, most of a person (decision 62).
_LEAST_SHARE = 0.1
_N_POINTS = 1500  # of a piece's surface that are looked at


def phantoms(
    voxels: Voxels,
    is_surface: NDArray[np.bool_],
    grid: VoxelGrid,
    rig: CameraRig,
    masks: Sequence[Mask],
) -> NDArray[np.bool_]:
    """Which voxels (N,) belong to pieces that explain nothing: (N,) bool.

    is_surface : (N,).  masks : (H, W) bool per camera of the rig. The piece that explains least goes first, since two
    phantoms may explain each other's pixels; one piece stays in any case, and all with fewer than four cameras.
    """
    labels, n = connected_components(voxels, grid)
    litres = np.bincount(labels, minlength=n) * grid.voxel_size_m**3 * 1000.0
    judged: list[int] = np.flatnonzero(litres >= _LEAST_LITRES).tolist()
    gone = np.zeros(n, dtype=np.bool_)
    if len(judged) < 2 or len(rig) < LEAST_CAMERAS:
        return np.take(gone, labels)
    rows = _spread(labels, is_surface, n)
    covered = Covered(rig, grid.centers(voxels[rows]), labels[rows], n, masks)
    while len(judged) > 1:
        shares = [covered.own_share(piece, gone) for piece in judged]
        least = int(np.argmin(shares))
        if shares[least] >= _LEAST_SHARE:
            break
        gone[judged.pop(least)] = True
    return np.take(gone, labels)


def _spread(labels: NDArray[np.integer], is_surface: NDArray[np.bool_], n: int) -> NDArray[np.int64]:
    """Rows of some surface voxels of every piece."""
    rows = np.flatnonzero(is_surface)
    of_piece = [rows[np.equal(labels[rows], piece)] for piece in range(n)]
    return np.concatenate([own[:: max(1, len(own) // _N_POINTS)] for own in of_piece])
