"""Voxels of one frame as a tracker sees them: which are occupied, their component, surface and colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocap.arrays import Array
from mocap.data import VoxelGrid
from mocap.tracking import _kernels


@dataclass(frozen=True, eq=False)
class FrameVoxels:
    """The observation of one frame; N = 0 is a frame in which nobody is seen.

    frame : number of the frame; numbers may have gaps.  centers : (N, 3) m, world, on a lattice of the tracker's
    voxel size, in any order.  labels : (N,) int, connected component of each voxel, negative = ignore.
    is_surface : (N,) bool; None = all.  rgb : (N, 3) uint8; None = no colours.  has_colour : (N,) bool, voxels whose
    rgb is known; None = all when there is rgb.
    """

    frame: int
    centers: Array
    labels: NDArray[np.integer]
    is_surface: NDArray[np.bool_] = None  # type: ignore[assignment]
    rgb: NDArray[np.uint8] = None  # type: ignore[assignment]
    has_colour: NDArray[np.bool_] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        centers = np.ascontiguousarray(self.centers, dtype=np.float64)
        if centers.ndim != 2 or centers.shape[1] != 3:
            raise ValueError(f"centers has shape {centers.shape}, expected (N, 3)")
        n = len(centers)
        rgb: ArrayLike = np.zeros((n, 3)) if self.rgb is None else self.rgb
        coloured: ArrayLike = self.has_colour
        if self.has_colour is None:
            coloured = np.full(n, self.rgb is not None)
        surface: ArrayLike = np.ones(n) if self.is_surface is None else self.is_surface
        values = {
            "centers": centers,
            "labels": np.asarray(self.labels),
            "is_surface": np.asarray(surface, dtype=np.bool_),
            "rgb": np.ascontiguousarray(rgb, dtype=np.uint8),
            "has_colour": np.asarray(coloured, dtype=np.bool_),
        }
        for name, value in values.items():
            expected = (n, 3) if name in ("centers", "rgb") else (n,)
            if value.shape != expected:
                raise ValueError(f"{name} has shape {value.shape}, expected {expected}")
            object.__setattr__(self, name, value)
        object.__setattr__(self, "frame", int(self.frame))

    def __len__(self) -> int:
        return len(self.centers)

    @classmethod
    def of_grid(
        cls,
        frame: int,
        grid: VoxelGrid,
        voxels: NDArray[np.int32],
        labels: NDArray[np.integer],
        is_surface: NDArray[np.bool_] | None = None,
        rgb: NDArray[np.uint8] | None = None,
        has_colour: NDArray[np.bool_] | None = None,
    ) -> FrameVoxels:
        """The observation of linear indices voxels (N,) int32 of a grid; the rest as above."""
        centers = np.empty((len(voxels), 3))
        v = np.require(voxels, np.int32, ("C", "W"))
        origin = np.array(grid.origin)
        _kernels.voxel_centers(v, grid.shape[1], grid.shape[2], origin, grid.voxel_size_m, centers)
        return cls(frame, centers, labels, is_surface, rgb, has_colour)  # type: ignore[arg-type]
