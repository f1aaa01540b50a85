"""A regular voxel grid and the sparse hull that lives on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.data import _voxel_kernels

Voxels = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """Cubes of side voxel_size_m; voxel (0, 0, 0) has its lower corner at `origin`.

    origin : (3,) m, world.  shape : (nx, ny, nz).  A voxel's linear index is C order:
    (ix * ny + iy) * nz + iz, kept as int32.
    """

    origin: Array
    shape: tuple[int, int, int]
    voxel_size_m: float

    def __post_init__(self) -> None:
        origin = np.array(self.origin, dtype=np.float64)
        if origin.shape != (3,) or not np.all(np.isfinite(origin)):
            raise ValueError(f"origin must be 3 finite numbers, got {self.origin!r}")
        origin.flags.writeable = False
        object.__setattr__(self, "origin", origin)
        nx, ny, nz = (int(n) for n in self.shape)
        object.__setattr__(self, "shape", (nx, ny, nz))
        if min(self.shape) < 1 or not self.voxel_size_m > 0:
            raise ValueError(f"empty grid: shape {self.shape}, voxel size {self.voxel_size_m}")
        if self.n_voxels >= 2**31:
            raise ValueError(f"grid of {self.shape} voxels is too large; use larger voxels or a smaller room")

    @classmethod
    def from_bounds(cls, lower: Array, upper: Array, voxel_size_m: float) -> VoxelGrid:
        """Grid that covers the box lower..upper, each (3,) m."""
        extent = np.asarray(upper, dtype=np.float64) - np.asarray(lower, dtype=np.float64)
        if not np.all(extent > 0):
            raise ValueError(f"room bounds are empty: lower {lower}, upper {upper}")
        n = np.ceil(extent / voxel_size_m - 1e-9).astype(int)
        return cls(np.asarray(lower), (int(n[0]), int(n[1]), int(n[2])), voxel_size_m)

    def __reduce__(self) -> tuple[type[VoxelGrid], tuple[Array, tuple[int, int, int], float]]:
        # Made anew where another process takes it: its origin is read-only there too, for which kernels are compiled.
        return VoxelGrid, (self.origin, self.shape, self.voxel_size_m)

    @property
    def n_voxels(self) -> int:
        return self.shape[0] * self.shape[1] * self.shape[2]

    @property
    def upper(self) -> Array:
        """Upper corner of the room, (3,) m."""
        return self.origin + np.array(self.shape) * self.voxel_size_m

    def subscripts(self, voxels: Voxels) -> NDArray[np.int32]:
        """(ix, iy, iz) of linear indices: (N,) -> (N, 3) int32."""
        # Read-only arrays would make the compiler build the kernel a second time.
        v = np.require(voxels, np.int32, ("C", "W"))
        out = np.empty((len(v), 3), dtype=np.int32)
        _voxel_kernels.subscripts_of(v, self.shape[1], self.shape[2], out)
        return out

    def linear(self, subscripts: NDArray[np.integer]) -> Voxels:
        """Linear indices of (N, 3) subscripts, which must lie inside the grid."""
        s = np.asarray(subscripts)
        _, ny, nz = self.shape
        return ((s[:, 0] * ny + s[:, 1]) * nz + s[:, 2]).astype(np.int32)

    def centers(self, voxels: Voxels) -> Array:
        """Voxel centres, (N,) -> (N, 3) m, world."""
        v = np.require(voxels, np.int32, ("C", "W"))
        out = np.empty((len(v), 3))
        _voxel_kernels.centers_of(v, self.shape[1], self.shape[2], self.origin, self.voxel_size_m, out)
        return out

    def voxels_of(self, points_world: Array) -> Voxels:
        """Linear indices (M,) of the voxels that hold the points (M, 3) m; -1 outside the grid or NaN."""
        p = (np.asarray(points_world, dtype=np.float64) - self.origin) / self.voxel_size_m
        with np.errstate(invalid="ignore"):
            inside = np.all((p >= 0) & (p < np.array(self.shape)), axis=1)
        out = np.full(len(p), -1, dtype=np.int32)
        out[inside] = self.linear(np.floor(p[inside]).astype(np.int64))
        return out

    def is_below_ceiling(self, points_world: Array) -> NDArray[np.bool_]:
        """Whether points (M, 3) m lie between the walls and below the ceiling of the grid, or under its floor, (M,)."""
        above = np.array(points_world)
        above[:, 2] = np.maximum(above[:, 2], self.origin[2])
        return self.voxels_of(above) >= 0

    def at_walls(self, voxels: Voxels) -> NDArray[np.bool_]:
        """Which of the voxels (N,) are the last before a side of the grid: lower x, upper x, lower y, upper y and the
        top, (5, N); the floor is none.
        """
        x, y, z = self.subscripts(voxels).T
        nx, ny, nz = self.shape
        return np.stack([x == 0, x == nx - 1, y == 0, y == ny - 1, z == nz - 1])

    def dense(self, voxels: Voxels) -> NDArray[np.bool_]:
        """The same set as a dense (nx, ny, nz) bool array."""
        volume = np.zeros(self.n_voxels, dtype=np.bool_)
        volume[voxels] = True
        return volume.reshape(self.shape)


@dataclass(frozen=True, eq=False)
class Hull:
    """Occupied voxels of one frame, sparse, with what is known of each.

    voxels : (N,) int32 linear indices, ascending.
    is_surface : (N,) bool, some 6-neighbour is empty.
    n_views : (N,) uint8, cameras with direct vision of the voxel; 0 = interior (CF 2.2.4).
    rgb : (N, 3) uint8, mean colour over those cameras; 0 where n_views is 0.
    """

    grid: VoxelGrid
    voxels: Voxels
    is_surface: NDArray[np.bool_]
    n_views: NDArray[np.uint8]
    rgb: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.voxels)

    @property
    def volume_litres(self) -> float:
        return len(self.voxels) * self.grid.voxel_size_m**3 * 1000.0

    @property
    def centers(self) -> Array:
        """(N, 3) m, world."""
        return self.grid.centers(self.voxels)

    def select(self, keep: NDArray[np.bool_]) -> Hull:
        """The voxels where keep (N,) is true."""
        return Hull(self.grid, self.voxels[keep], self.is_surface[keep], self.n_views[keep], self.rgb[keep])
