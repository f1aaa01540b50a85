"""Phantoms: volumes where rays to several persons cross, which no silhouette needs.

Silhouettes of several persons leave more volume than theirs: a place is occupied when every camera sees somebody there,
be it the one or the other. Such a volume is found by what it explains. In most cameras all of its pixels are
somebody else's; a person has pixels of his own in nearly every camera.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Mask
from mocap.data import Camera, CameraRig, VoxelGrid
from mocap.data.voxels import Voxels
from mocap.volume.components import connected_components

# Pieces that could be taken for somebody; smaller ones are hands, or crumbs.
_LEAST_LITRES = 5.0
# Of a piece's pixels, the median over cameras: next to none of a phantom, most of a person (decision 62).
_LEAST_SHARE = 0.1
# Both rays of a person may go through phantoms; of three cameras persons were taken too (decision 62).
_LEAST_CAMERAS = 4
_N_POINTS = 1500  # of a piece's surface that are looked at
_LEAST_POINTS = 20  # in a silhouette, for a camera to have a say
_CELL = 0.01  # of the picture's width: what is nearer than this is the same place of a silhouette


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
    if len(judged) < 2 or len(rig) < _LEAST_CAMERAS:
        return np.take(gone, labels)
    rows = _spread(labels, is_surface, n)
    views = [
        _View(camera, grid.centers(voxels[rows]), labels[rows], n, mask)
        for camera, mask in zip(rig, masks, strict=True)
    ]
    while len(judged) > 1:
        shares = [_median([view.own_share(piece, gone) for view in views]) for piece in judged]
        least = int(np.argmin(shares))
        if shares[least] >= _LEAST_SHARE:
            break
        gone[judged.pop(least)] = True
    return np.take(gone, labels)


class _View:
    """What the pieces cover in one picture, in cells of about a voxel."""

    def __init__(
        self, camera: Camera, points: Array, labels: NDArray[np.integer], n: int, mask: Mask
    ) -> None:
        height, width = mask.shape
        side = max(1.0, _CELL * width)
        uv, _ = camera.project(points)
        inside = camera.contains(uv)
        at = np.round(uv[inside]).astype(np.int64)
        self._piece = labels[inside]
        columns = int(width / side) + 1
        self._cell = (at[:, 1] / side).astype(np.int64) * columns + (at[:, 0] / side).astype(np.int64)
        self._is_seen = mask[at[:, 1], at[:, 0]]
        self._covers = np.zeros((n, (int(height / side) + 1) * columns), dtype=np.bool_)
        self._covers[self._piece, self._cell] = True

    def own_share(self, piece: int, gone: NDArray[np.bool_]) -> float:
        """Share of a piece's pixels in the silhouettes that no other piece covers, NaN where it hardly has any."""
        own = self._cell[(self._piece == piece) & self._is_seen]
        if len(own) < _LEAST_POINTS:
            return float("nan")
        others = np.logical_not(gone)
        others[piece] = False
        is_covered = np.take(self._covers[others].any(axis=0), own)
        return 1.0 - float(is_covered.mean())


def _spread(labels: NDArray[np.integer], is_surface: NDArray[np.bool_], n: int) -> NDArray[np.int64]:
    """Rows of some surface voxels of every piece."""
    rows = np.flatnonzero(is_surface)
    of_piece = [rows[np.equal(labels[rows], piece)] for piece in range(n)]
    return np.concatenate([own[:: max(1, len(own) // _N_POINTS)] for own in of_piece])


def _median(shares: list[float]) -> float:
    """Of the cameras that have a say; without any, nothing speaks against the piece."""
    known = [share for share in shares if not np.isnan(share)]
    return float(np.median(known)) if known else 1.0
