"""What pieces of a volume cover in the pictures of a rig, and how much of that no other piece does.

A place is occupied when every camera sees somebody there, be it the one or the other; so rays to several persons leave
volumes that are nobody's. Such a volume is found by what it explains: in most cameras all of its pixels are somebody
else's, and a person has pixels of his own in nearly every camera.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Mask
from mocap.data.camera import Camera, CameraRig

# Both rays of a person may go through phantoms; of three cameras persons were taken too (decisions 62, 131).
LEAST_CAMERAS = 4
_LEAST_POINTS = 20  # of a piece, for a camera to have a say
_CELL = 0.01  # of the picture's width: what is nearer than this is the same place of a picture


class Covered:
    """What n pieces of a volume cover in the pictures, in cells of about a voxel."""

    def __init__(
        self,
        rig: CameraRig,
        points: Array,
        labels: NDArray[np.integer],
        n: int,
        masks: Sequence[Mask] | None = None,
    ) -> None:
        """points : (N, 3) m, of their surface.  labels : (N,), 0 .. n - 1.

        masks : (H, W) bool per camera of the rig, where alone pixels count; None = everywhere.
        """
        self._views = [
            _View(camera, points, labels, n, None if masks is None else masks[c])
            for c, camera in enumerate(rig)
        ]

    def own_share(self, piece: int, gone: NDArray[np.bool_] | None = None) -> float:
        """Share of what a piece covers that no other does: the median over cameras that see enough of it, 1 without.

        gone : (n,), pieces that do not count.
        """
        shares = [view.own_share(piece, gone) for view in self._views]
        known = [share for share in shares if not np.isnan(share)]
        return float(np.median(known)) if known else 1.0


class _View:
    def __init__(
        self, camera: Camera, points: Array, labels: NDArray[np.integer], n: int, mask: Mask | None
    ) -> None:
        width, height = camera.size
        side = max(1.0, _CELL * width)
        uv, _ = camera.project(points)
        inside = camera.contains(uv)
        at = np.round(uv[inside]).astype(np.int64)
        self._piece = labels[inside]
        columns = int(width / side) + 1
        self._cell = (at[:, 1] / side).astype(np.int64) * columns + (at[:, 0] / side).astype(np.int64)
        self._counts = np.ones(len(at), dtype=np.bool_) if mask is None else mask[at[:, 1], at[:, 0]]
        self._covers = np.zeros((n, (int(height / side) + 1) * columns), dtype=np.bool_)
        self._covers[self._piece, self._cell] = True

    def own_share(self, piece: int, gone: NDArray[np.bool_] | None) -> float:
        """The same in one picture, NaN where the piece hardly is in it."""
        own = self._cell[(self._piece == piece) & self._counts]
        if len(own) < _LEAST_POINTS:
            return float("nan")
        others = np.ones(len(self._covers), dtype=np.bool_) if gone is None else np.logical_not(gone)
        others[piece] = False
        is_covered = np.take(self._covers[others].any(axis=0), own)
        return 1.0 - float(is_covered.mean())
