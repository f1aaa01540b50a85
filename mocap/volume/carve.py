"""Shape from silhouette: which voxels project into the foreground of the cameras that see them.

A camera that does not have a voxel in its picture does not vote on it. A voxel is occupied when at least
`min_views` cameras see it and at most `n_faulty_views` of those vote background.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig, VoxelGrid
from mocap.geometry.projection import max_normalised_radius
from mocap.volume import _kernels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Voxels = NDArray[np.int32]

MAX_TABLE_MB = 700
MAX_CAMERAS = 62  # camera sets are bits of a signed 64-bit number
_MIN_VIEWS = 4


def default_min_views(n_cameras: int) -> int:
    """Cameras that must see a voxel before it can be occupied: 4, or all of fewer than 4."""
    return min(_MIN_VIEWS, n_cameras)


def nearest_pixel(uv: Array, size: tuple[int, int]) -> NDArray[np.int64]:
    """Flat index v * width + u of the pixel that holds uv; -1 outside the picture or NaN.

    uv : (n, 2) px.  size : (width, height) px. Returns (n,).
    Halves round up, and so does what is within 1e-7 px below a half: in a symmetric rig many voxel centres
    fall exactly between two pixels, and the last bit of a projection must not decide about them.
    """
    width, height = size
    with np.errstate(invalid="ignore"):
        rounded = np.floor(uv + (0.5 + _kernels.TIE_PX))
        inside = (
            (rounded[:, 0] >= 0) & (rounded[:, 0] < width) & (rounded[:, 1] >= 0) & (rounded[:, 1] < height)
        )
    pixels = np.full(len(uv), -1, dtype=np.int64)
    pixels[inside] = rounded[inside, 1].astype(np.int64) * width + rounded[inside, 0].astype(np.int64)
    return pixels


@lru_cache(maxsize=256)
def camera_parameters(camera: Camera) -> Array | None:
    """The camera as one (26,) row for the kernel, or None when its distortion model is not compiled."""
    n_compiled = 4 if camera.is_fisheye else 8
    if np.any(camera.dist[n_compiled:] != 0):
        return None
    p = np.zeros(26)
    p[:9] = camera.R.ravel()
    p[9:12] = camera.t
    p[12:16] = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    n = min(len(camera.dist), n_compiled)
    p[16 : 16 + n] = camera.dist[:n]
    p[24] = max_normalised_radius(camera.dist, camera.is_fisheye)
    p[25] = float(camera.is_fisheye)
    return p


def pixels_of_points(camera: Camera, points_world: Array) -> NDArray[np.int32]:
    """Flat index v * width + u of the pixel nearest to each projected point; -1 outside the camera's view.

    points_world : (n, 3) m, world. Returns (n,) int32. Same as nearest_pixel(camera.project(...)), faster.
    """
    parameters = camera_parameters(camera)
    if parameters is None:
        return nearest_pixel(camera.project(points_world)[0], camera.size).astype(np.int32)
    out = np.empty(len(points_world), dtype=np.int32)
    points = np.ascontiguousarray(points_world, dtype=np.float64)
    _kernels.pixels_of_points(points, parameters, camera.size[0], camera.size[1], out)
    return out


def check_masks(rig: CameraRig, masks: Sequence[Mask]) -> None:
    """Raise ValueError/TypeError unless there is one bool mask (H, W) per camera of the rig."""
    if len(masks) != len(rig):
        raise ValueError(f"masks: expected one per camera ({len(rig)}), got {len(masks)}")
    for camera, mask in zip(rig, masks, strict=True):
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            raise TypeError(f"mask of camera {camera.name}: expected a bool array, got {_kind(mask)}")
        if mask.shape != (camera.size[1], camera.size[0]):
            raise ValueError(
                f"mask of camera {camera.name}: expected shape {(camera.size[1], camera.size[0])}, "
                f"got {mask.shape}"
            )


def _kind(value: object) -> str:
    return f"an array of {value.dtype}" if isinstance(value, np.ndarray) else type(value).__name__


def _check_votes(n_cameras: int, n_faulty_views: int, min_views: int | None) -> int:
    if not 0 <= n_faulty_views < n_cameras:
        raise ValueError(
            f"n_faulty_views: expected 0 .. {n_cameras - 1} for {n_cameras} cameras, got {n_faulty_views}"
        )
    needed = default_min_views(n_cameras) if min_views is None else min_views
    if not 1 <= needed <= n_cameras:
        raise ValueError(f"min_views: expected 1 .. {n_cameras} for {n_cameras} cameras, got {needed}")
    return needed


def carve_bruteforce(
    rig: CameraRig,
    grid: VoxelGrid,
    masks: Sequence[Mask],
    *,
    n_faulty_views: int,
    min_views: int | None = None,
) -> Voxels:
    """Occupied voxels by projecting every voxel centre into every mask: the definition, slow.

    masks : one (H, W) bool per camera, in rig order.  n_faulty_views : seeing cameras that may vote
    background.
    min_views : cameras that must see the voxel; default_min_views if None.
    Returns (N,) int32 linear indices, ascending; empty masks give N = 0.
    Raises ValueError or TypeError for masks that do not fit the rig or numbers out of range.
    Source: CF 2.2.4 (shape from silhouette, with tolerance to faulty segmentations).
    """
    check_masks(rig, masks)
    needed = _check_votes(len(rig), n_faulty_views, min_views)
    per_plane = grid.shape[1] * grid.shape[2]
    found = []
    for ix in range(grid.shape[0]):
        voxels = np.arange(ix * per_plane, (ix + 1) * per_plane, dtype=np.int32)
        centers = grid.centers(voxels)
        n_seen = np.zeros(per_plane, dtype=np.int64)
        n_background = np.zeros(per_plane, dtype=np.int64)
        for camera, mask in zip(rig, masks, strict=True):
            pixels = nearest_pixel(camera.project(centers)[0], camera.size)
            seen = pixels >= 0
            n_seen += seen
            n_background += seen & ~mask.ravel()[np.maximum(pixels, 0)]
        found.append(voxels[(n_seen >= needed) & (n_background <= n_faulty_views)])
    return np.concatenate(found)


class _Level:
    """Blocks of one size: pixel boxes (nb, C, 4), who sees them, range of the number of views per voxel."""

    def __init__(
        self,
        counts: tuple[int, int, int],
        box: NDArray[np.int16],
        sees_all: NDArray[np.int64],
        sees_some: NDArray[np.int64],
        low: NDArray[np.uint8],
        high: NDArray[np.uint8],
    ) -> None:
        self.counts = counts
        self.box, self.sees_all, self.sees_some = box, sees_all, sees_some
        self.low, self.high = low, high

    def arrays(self) -> tuple[np.ndarray, ...]:
        return self.box, self.sees_all, self.sees_some, self.low, self.high

    def doubled(self) -> _Level:
        """Blocks of twice the side."""
        nx, ny, nz = ((n + 1) // 2 for n in self.counts)

        def gather(values: np.ndarray, ufunc: np.ufunc, neutral: int) -> np.ndarray:
            full = np.full((2 * nx, 2 * ny, 2 * nz, *values.shape[1:]), neutral, dtype=values.dtype)
            full[: self.counts[0], : self.counts[1], : self.counts[2]] = values.reshape(
                *self.counts, *values.shape[1:]
            )
            eight = full.reshape(nx, 2, ny, 2, nz, 2, *values.shape[1:])
            return ufunc.reduce(ufunc.reduce(ufunc.reduce(eight, axis=5), axis=3), axis=1).reshape(
                nx * ny * nz, *values.shape[1:]
            )

        box = np.empty((nx * ny * nz, *self.box.shape[1:]), dtype=np.int16)
        for k in range(4):
            lower = k % 2 == 0
            side = np.ascontiguousarray(self.box[:, :, k])
            box[:, :, k] = gather(side, np.minimum if lower else np.maximum, 32767 if lower else -1)
        return _Level(
            (nx, ny, nz),
            box,
            gather(self.sees_all, np.bitwise_and, -1),
            gather(self.sees_some, np.bitwise_or, 0),
            gather(self.low, np.minimum, 255),
            gather(self.high, np.maximum, 0),
        )


class Carver:
    """Tables of one rig and one grid, built once, with which every frame is carved in milliseconds.

    The result equals carve_bruteforce voxel by voxel. Not thread-safe: it holds work buffers; threads need
    one each.
    Raises ValueError when the tables would exceed 700 MB or the rig has more than 62 cameras.
    """

    def __init__(self, rig: CameraRig, grid: VoxelGrid) -> None:
        self.rig, self.grid = rig, grid
        n_cameras = len(rig)
        nx, ny, nz = (-(-n // 4) for n in grid.shape)
        needed_mb = self.table_megabytes(n_cameras, grid)
        if needed_mb > MAX_TABLE_MB:
            raise ValueError(
                f"carving tables for {grid.shape[0]} x {grid.shape[1]} x {grid.shape[2]} = {grid.n_voxels:,} "
                f"voxels and {n_cameras} cameras need {needed_mb:.0f} MB, more than {MAX_TABLE_MB} MB; "
                "use larger voxels or smaller room bounds"
            )
        if n_cameras > MAX_CAMERAS:
            raise ValueError(f"a Carver takes at most {MAX_CAMERAS} cameras, got {n_cameras}")
        if max(max(c.size) for c in rig) > 32767:
            raise ValueError("a Carver takes pictures of at most 32767 pixels a side")
        n_blocks = nx * ny * nz
        self._table = np.empty((n_blocks, n_cameras, 64), dtype=np.int32)
        self._n_seen = np.zeros((n_blocks, 64), dtype=np.uint8)
        self._levels = self._fill(nx, ny, nz)
        self._width = np.array([c.size[0] for c in rig], dtype=np.int64)
        self._prepare_images()
        # Untouched pages of this buffer cost nothing.
        self._found = np.empty(grid.n_voxels, dtype=np.int32)

    @staticmethod
    def table_megabytes(n_cameras: int, grid: VoxelGrid) -> float:
        """Memory of the tables of a Carver, MB (10^6 bytes), before they are built."""
        n_blocks = int(np.prod([-(-n // 4) for n in grid.shape]))
        return n_blocks * (64 * (4 * n_cameras + 1) + 10 * n_cameras + 24) / 1e6

    def _fill(self, nx: int, ny: int, nz: int) -> tuple[_Level, _Level, _Level]:
        n_blocks = nx * ny * nz
        box = np.empty((n_blocks, len(self.rig), 4), dtype=np.int16)
        sees_all = np.zeros(n_blocks, dtype=np.int64)
        sees_some = np.zeros(n_blocks, dtype=np.int64)
        per_plane = self.grid.shape[1] * self.grid.shape[2]
        for bx in range(nx):
            planes = min(4, self.grid.shape[0] - 4 * bx)
            first = 4 * bx * per_plane
            centers = self.grid.centers(np.arange(first, first + planes * per_plane, dtype=np.int32))
            for c, camera in enumerate(self.rig):
                pixels = pixels_of_points(camera, centers).reshape(planes, *self.grid.shape[1:])
                _kernels.fill_blocks(
                    pixels, bx, ny, nz, c, camera.size[0],
                    self._table, box, self._n_seen, sees_all, sees_some,
                )  # fmt: skip
        # Padding voxels count 0 views: they can never be occupied, but make `low` 0 in the last blocks.
        low, high = self._n_seen.min(axis=1), self._n_seen.max(axis=1)
        small = _Level((nx, ny, nz), box, sees_all, sees_some, low, high)
        middle = small.doubled()
        return small, middle, middle.doubled()

    def _prepare_images(self) -> None:
        heights = np.array([c.size[1] for c in self.rig], dtype=np.int64)
        # One foreground pixel stands before each mask: index -1, "not seen", reads it and casts no vote.
        self._mask_start = np.concatenate([[0], np.cumsum(self._width * heights + 1)])[:-1] + 1
        self._masks = np.ones(int(np.sum(self._width * heights + 1)), dtype=np.uint8)
        sizes = (self._width + 1) * (heights + 1)
        self._integral_start = np.concatenate([[0], np.cumsum(sizes)])[:-1].astype(np.int64)
        self._integral = np.zeros(int(sizes.sum()), dtype=np.int32)
        self._mask_views, self._integral_views = [], []
        for c, camera in enumerate(self.rig):
            w, h = camera.size
            m, i = int(self._mask_start[c]), int(self._integral_start[c])
            self._mask_views.append(self._masks[m : m + w * h].reshape(h, w))
            self._integral_views.append(self._integral[i : i + (w + 1) * (h + 1)].reshape(h + 1, w + 1))

    def carve(self, masks: Sequence[Mask], *, n_faulty_views: int, min_views: int | None = None) -> Voxels:
        """Occupied voxels of one frame; arguments, result and errors as of carve_bruteforce.

        Source: CF 2.2.4; coarse to fine after the octree idea quoted there, on integral images.
        """
        check_masks(self.rig, masks)
        needed = _check_votes(len(self.rig), n_faulty_views, min_views)
        for mask, own, integral in zip(masks, self._mask_views, self._integral_views, strict=True):
            own[...] = mask
            cv2.integral(own, integral, cv2.CV_32S)
        small, middle, large = self._levels
        n = _kernels.carve_blocks(
            *small.arrays(), *middle.arrays(), *large.arrays(),
            np.array(small.counts), np.array(middle.counts), np.array(large.counts),
            np.array(self.grid.shape), self._table, self._n_seen, self._masks, self._mask_start,
            self._integral, self._integral_start, self._width, n_faulty_views, needed, self._found,
        )  # fmt: skip
        return np.sort(self._found[:n])

    def pixels(self, voxels: Voxels) -> NDArray[np.int32]:
        """Flat pixel index of each voxel in each camera, (N, C) int32; -1 outside the view."""
        block, within = self._address(voxels)
        return self._table[block, :, within]

    def n_seen(self, voxels: Voxels) -> NDArray[np.uint8]:
        """How many cameras have each voxel in their picture, (N,) uint8."""
        block, within = self._address(voxels)
        return self._n_seen[block, within]

    def _address(self, voxels: Voxels) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        s = self.grid.subscripts(voxels).astype(np.int64)
        b, d = s >> 2, s & 3
        _, ny, nz = self._levels[0].counts
        return (b[:, 0] * ny + b[:, 1]) * nz + b[:, 2], (d[:, 0] * 4 + d[:, 1]) * 4 + d[:, 2]
