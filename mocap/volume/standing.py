"""What stands in a room, as depth cameras measure it: it hides people from every camera that looks at it.

Where the masks show nobody again and again, the farthest reading of a depth camera is the empty scene. What of it lies
above the floor, where people may be, is furniture; painted into all cameras it is what `OccluderLearner` would learn
from silhouettes, at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig, Occluders, VoxelGrid
from mocap.volume.components import connected_components
from mocap.volume.occluders import CELL_PX, EMPTY, VOXEL_M, painted

DepthMap = NDArray[np.float32]
Cells = NDArray[np.uint8]

_FLOOR_M = 0.15  # readings of the floor lie lower: five deviations at 4 m
_MIN_LOOKS = 5  # in which a cell shows nobody
_MIN_SHARE = 0.5  # and their share: a person who never moves is no furniture
_MIN_LITRES = 2.0  # of a thing's visible side in voxels of 5 cm: 20 x 20 cm


class StandingScene:
    """Collects depth maps frame by frame; memory is constant.

    rig : all cameras.  names : those with depth.  grid : where persons may be.
    """

    def __init__(self, rig: CameraRig, names: Sequence[str], grid: VoxelGrid) -> None:
        self._rig, self._names = rig, tuple(names)
        self._space = VoxelGrid.from_bounds(grid.origin, grid.upper, max(VOXEL_M, grid.voxel_size_m))
        shapes = [(rig[name].size[1] // CELL_PX, rig[name].size[0] // CELL_PX) for name in self._names]
        # The farthest and the second farthest reading of each cell without anybody; one may be a mistake.
        self._far = [np.zeros((2, *shape), dtype=np.float32) for shape in shapes]
        self._n_empty = [np.zeros(shape, dtype=np.int32) for shape in shapes]
        self._n_looks = 0

    def add(self, cells: Sequence[Cells], depth: Sequence[DepthMap]) -> None:
        """Take one frame.  cells : the masks of all cameras as of `masks_by_cells`.  depth : of those with depth."""
        self._n_looks += 1
        of = dict(zip(self._rig.names, cells, strict=True))
        for name, own, far, n in zip(self._names, depth, self._far, self._n_empty, strict=True):
            h, w = n.shape
            middle = own[CELL_PX // 2 :: CELL_PX, CELL_PX // 2 :: CELL_PX][:h, :w]
            is_empty = (of[name] == EMPTY) & (middle > 0)
            n += is_empty
            read = np.where(is_empty, middle, np.float32(0))
            far[1] = np.maximum(far[1], np.minimum(far[0], read))
            far[0] = np.maximum(far[0], read)

    def occluders(self) -> Occluders:
        """What stands in the way of each camera by the maps so far."""
        points = [np.zeros((0, 3))]
        for name, far, n in zip(self._names, self._far, self._n_empty, strict=True):
            v, u = np.nonzero((n >= max(_MIN_LOOKS, _MIN_SHARE * self._n_looks)) & (far[1] > 0))
            uv = np.column_stack([u, v]) * CELL_PX + CELL_PX // 2
            points.append(self._rig[name].unproject(uv.astype(np.float64), far[1][v, u].astype(np.float64)))
        return painted(
            self._rig, self._space.centers(self._things(np.concatenate(points))), self._space.voxel_size_m
        )

    def _things(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """Voxels (N,) of what is large enough to be a thing, of points (M, 3) m."""
        space = self._space
        subs = np.floor((points - space.origin) / space.voxel_size_m).astype(np.int64)
        inside = np.all((subs >= 0) & (subs < space.shape), axis=1) & (points[:, 2] > _FLOOR_M)
        voxels = np.unique(np.ravel_multi_index(tuple(subs[inside].T), space.shape)).astype(np.int32)
        labels, n = connected_components(voxels, space)
        litres = np.bincount(labels, minlength=n) * space.voxel_size_m**3 * 1000.0
        return np.asarray(voxels[litres[labels] >= _MIN_LITRES])


def nearest_of(first: Occluders, second: Occluders) -> Occluders:
    """What either of two says, cell by cell."""
    maps = dict(first.depth_m)
    for name, depth in second.depth_m.items():
        maps[name] = np.minimum(maps[name], depth) if name in maps else depth
    return Occluders(maps, CELL_PX)
