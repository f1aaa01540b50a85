"""The true voxels of a synthetic session: truth/voxels.npz."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import VoxelGrid
from mocap.errors import MocapError
from mocap.files import load_arrays

_ARRAYS = ("origin_m", "shape", "voxel_size_m", "offsets", "voxels")


@dataclass(frozen=True, eq=False)
class TrueVoxels:
    """Voxels inside the persons, frame by frame.

    offsets : (T + 1,) places in `voxels` where frames begin.  voxels : (N,) int32 linear indices into `grid`.
    """

    grid: VoxelGrid
    offsets: NDArray[np.int64]
    voxels: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def at(self, frame: int) -> NDArray[np.int32]:
        """Linear indices of the voxels of one frame."""
        return self.voxels[self.offsets[frame] : self.offsets[frame + 1]]


def read_true_voxels(path: Path) -> TrueVoxels:
    """Read voxels.npz; MocapError for a damaged archive, missing arrays, or voxels outside their grid."""
    arrays = load_arrays(path, "the true voxels", wanted=_ARRAYS)

    def wrong(message: str) -> MocapError:
        return MocapError(
            f"bad true voxels: {message}", path=path, remedy="make the session again: mocap synth"
        )

    if missing := [name for name in _ARRAYS if name not in arrays]:
        raise wrong(f"array {missing[0]} is missing")
    origin, shape, size, offsets, voxels = (arrays[name] for name in _ARRAYS)
    if (
        origin.shape != (3,)
        or shape.shape != (3,)
        or size.shape != ()
        or offsets.ndim != 1
        or voxels.ndim != 1
    ):
        raise wrong("an array has another shape than it must have")
    if any(a.dtype.kind not in "iu" for a in (shape, offsets, voxels)) or origin.dtype.kind != "f":
        raise wrong("an array holds another kind of numbers than it must hold")
    n_voxels = int(np.prod(shape.astype(object)))
    if shape.min() < 1 or n_voxels > np.iinfo(np.int32).max:
        raise wrong(f"a grid of {tuple(shape.tolist())} voxels")
    steps = offsets.astype(np.int64)
    if not len(steps) or steps[0] != 0 or steps[-1] > len(voxels) or (np.diff(steps) < 0).any():
        raise wrong("the offsets do not fit the voxels")
    places = voxels.astype(np.int64)
    if len(places) and not 0 <= places.min() <= places.max() < n_voxels:
        raise wrong("a voxel lies outside the grid")
    try:
        nx, ny, nz = (int(n) for n in shape)
        grid = VoxelGrid(origin.astype(np.float64), (nx, ny, nz), float(size))
    except ValueError as error:
        raise wrong(str(error)) from error
    return TrueVoxels(grid, steps, places.astype(np.int32))
