"""The true voxels of a synthetic session: truth/voxels.npz."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import VoxelGrid
from mocap.errors import MocapError
from mocap.files import load_arrays

# Array -> axes, length where it is fixed (0 = any), kinds of numbers.
_ARRAYS = {
    "origin_m": (1, 3, "f"),
    "shape": (1, 3, "iu"),
    "voxel_size_m": (0, 0, "f"),
    "offsets": (1, 0, "iu"),
    "voxels": (1, 0, "iu"),
}


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
    arrays = load_arrays(path, "the true voxels", wanted=tuple(_ARRAYS))
    mistake = next(_mistakes(arrays), None)
    if mistake is None:
        nx, ny, nz = (int(n) for n in arrays["shape"])
        try:
            grid = VoxelGrid(arrays["origin_m"], (nx, ny, nz), float(arrays["voxel_size_m"]))
        except ValueError as error:
            mistake = str(error)
    if mistake is not None:
        raise MocapError(
            f"bad true voxels: {mistake}", path=path, remedy="make the session again: mocap synth"
        )
    return TrueVoxels(grid, arrays["offsets"].astype(np.int64), arrays["voxels"].astype(np.int32))


def _mistakes(arrays: dict[str, NDArray[Any]]) -> Iterator[str]:
    """What is wrong with the arrays of the file, the first thing first."""
    if missing := [name for name in _ARRAYS if name not in arrays]:
        yield f"array {missing[0]} is missing"
    for name, (n_axes, n, kinds) in _ARRAYS.items():
        array = arrays[name]
        if array.ndim != n_axes or (n and array.shape != (n,)) or array.dtype.kind not in kinds:
            yield f"{name} holds {array.dtype} of shape {array.shape}"
    yield from _mistakes_of_voxels(arrays["shape"], arrays["offsets"], arrays["voxels"])


def _mistakes_of_voxels(shape: NDArray[Any], steps: NDArray[Any], voxels: NDArray[Any]) -> Iterator[str]:
    n_voxels = math.prod(int(n) for n in shape)
    if int(shape.min()) < 1 or n_voxels > np.iinfo(np.int32).max:
        yield f"a grid of {tuple(shape.tolist())} voxels"
    if not len(steps) or steps[0] != 0 or int(steps.max()) > len(voxels) or (steps[1:] < steps[:-1]).any():
        yield "the offsets do not fit the voxels"
    if len(voxels) and not 0 <= int(voxels.min()) <= int(voxels.max()) < n_voxels:
        yield "a voxel lies outside the grid"
