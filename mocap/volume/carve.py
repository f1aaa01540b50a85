"""Shape from silhouette: which voxels project into the foreground of the cameras that see them.

A voxel is occupied when at least `min_views` cameras have it in their picture and at most `n_faulty_views` cameras
vote background. What a camera does that does not have the voxel in its picture is the policy `outside`:

abstain     it has no vote (the default: a head that leaves one picture is kept by the others);
background  it votes background, so that a voxel outside a picture needs tolerance, as outside a room's edge.

A camera that has the voxel in its picture, but behind an occluder, has no vote either. Then at least `min_votes`
cameras must vote foreground; where nobody speaks against a voxel and fewer do, it is unknown.

The soft volume counts foreground votes instead of deciding.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig, Occluders, VoxelGrid
from mocap.geometry.projection import max_normalised_radius
from mocap.volume import _carve_kernels, _mask_kernels, _occluder_kernels
from mocap.volume._carve_kernels import Blocks, InnerBlocks, Integrals, Rule, Silhouettes, Tables

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Voxels = NDArray[np.int32]
Outside = Literal["abstain", "background"]

MAX_TABLE_MB = 700
MAX_CAMERAS = 62  # camera sets are bits of a signed 64-bit number
_MIN_VIEWS = 4
MIN_VOTES = 3  # cones of two cameras cross in many places


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
        rounded = np.floor(uv + (0.5 + _carve_kernels.TIE_PX))
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
    p = np.zeros(_carve_kernels.N_PARAMETERS)
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
    out = np.empty(len(points_world), dtype=np.int32)
    _project(camera, np.ascontiguousarray(np.asarray(points_world, dtype=np.float64).T), out)
    return out


def pixels_in_all(rig: CameraRig, points_world: Array) -> NDArray[np.int32]:
    """`pixels_of_points` of every camera, (C, n) int32."""
    out = np.empty((len(rig), len(points_world)), dtype=np.int32)
    xyz = np.ascontiguousarray(points_world.T)
    for camera, own in zip(rig, out, strict=True):
        _project(camera, xyz, own)
    return out


def _project(camera: Camera, xyz: Array, out: NDArray[np.int32]) -> None:
    """Pixels of points xyz (3, n) m, world, into out (n,)."""
    parameters = camera_parameters(camera)
    if parameters is None:
        out[:] = nearest_pixel(camera.project(xyz.T)[0], camera.size)
        return
    kernel = _carve_kernels.fisheye_pixels if camera.is_fisheye else _carve_kernels.pinhole_pixels
    kernel(xyz[0], xyz[1], xyz[2], parameters, camera.size[0], camera.size[1], out)


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


def _rules(
    n_cameras: int,
    n_faulty_views: int,
    min_views: int | None,
    min_votes: int | None,
    outside: str,
    occluders: Occluders | None,
) -> Rule:
    """The rules of one carving, checked."""
    needed = _check_votes(n_cameras, n_faulty_views, min_views, outside)
    is_strict = outside == "background"
    if occluders is not None and is_strict:
        raise ValueError("outside: background excludes occluders, behind which cameras abstain")
    votes = needed - n_faulty_views
    if min_votes is not None:
        _check_min_votes(n_cameras, min_votes)
        votes = min_votes
    elif occluders is not None:
        votes = min(MIN_VOTES, votes)
    counts_votes = min_votes is not None or occluders is not None
    return Rule(n_faulty_views, needed, votes, is_strict, counts_votes)


def _check_votes(n_cameras: int, n_faulty_views: int, min_views: int | None, outside: str) -> int:
    if not 0 <= n_faulty_views < n_cameras:
        raise ValueError(
            f"n_faulty_views: expected 0 .. {n_cameras - 1} for {n_cameras} cameras, got {n_faulty_views}"
        )
    needed = default_min_views(n_cameras) if min_views is None else min_views
    if not 1 <= needed <= n_cameras:
        raise ValueError(f"min_views: expected 1 .. {n_cameras} for {n_cameras} cameras, got {needed}")
    if outside not in ("abstain", "background"):
        raise ValueError(f"outside: expected abstain or background, got {outside!r}")
    return needed


def _check_min_votes(n_cameras: int, min_votes: int) -> None:
    if not 1 <= min_votes <= n_cameras:
        raise ValueError(f"min_votes: expected 1 .. {n_cameras} for {n_cameras} cameras, got {min_votes}")


def _votes_of_planes(
    rig: CameraRig, grid: VoxelGrid, masks: Sequence[Mask], occluders: Occluders | None = None
) -> Iterator[tuple[Voxels, NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]:
    """Per plane of constant x: voxels, cameras that have each in the picture, that can judge it, and that see it as
    foreground.
    """
    per_plane = grid.shape[1] * grid.shape[2]
    for ix in range(grid.shape[0]):
        voxels = np.arange(ix * per_plane, (ix + 1) * per_plane, dtype=np.int32)
        centers = grid.centers(voxels)
        n_inside, n_seen, n_foreground = np.zeros((3, per_plane), dtype=np.int64)
        for camera, mask in zip(rig, masks, strict=True):
            pixels = nearest_pixel(camera.project(centers)[0], camera.size)
            n_inside += pixels >= 0
            seen = pixels >= 0
            if occluders is not None:
                seen &= ~occluders.hides(camera, centers)
            n_seen += seen
            n_foreground += seen & mask.ravel()[np.maximum(pixels, 0)]
        yield voxels, n_inside, n_seen, n_foreground


def carve_bruteforce(
    rig: CameraRig,
    grid: VoxelGrid,
    masks: Sequence[Mask],
    *,
    n_faulty_views: int,
    min_views: int | None = None,
    min_votes: int | None = None,
    outside: Outside = "abstain",
    occluders: Occluders | None = None,
) -> Voxels:
    """Occupied voxels by projecting every voxel centre into every mask: the definition, slow.

    masks : one (H, W) bool per camera, in rig order.  n_faulty_views : cameras that may vote background.
    min_views : cameras that must have the voxel in their picture; default_min_views if None.  min_votes : cameras that
    must vote foreground; if None, what the other two numbers ask for, but never more than MIN_VOTES with occluders.
    outside : "abstain" = a camera that does not see the voxel has no vote, "background" = it votes background.
    occluders : behind them a camera has no vote.
    Returns (N,) int32 linear indices, ascending; empty masks give N = 0.
    Raises ValueError or TypeError for masks that do not fit the rig or numbers out of range.
    Source: CF 2.2.4 (shape from silhouette, with tolerance to faulty segmentations).
    """
    check_masks(rig, masks)
    rules = _rules(len(rig), n_faulty_views, min_views, min_votes, outside, occluders)
    found = []
    for voxels, n_inside, n_seen, n_foreground in _votes_of_planes(rig, grid, masks, occluders):
        n_voters = len(rig) if rules.is_strict else n_seen
        is_in = (n_inside >= rules.min_views) & (n_voters - n_foreground <= n_faulty_views)
        found.append(voxels[is_in & (n_foreground >= rules.min_votes)])
    return np.concatenate(found)


def unknown_bruteforce(
    rig: CameraRig,
    grid: VoxelGrid,
    masks: Sequence[Mask],
    occluders: Occluders,
    *,
    n_faulty_views: int,
    min_views: int | None = None,
) -> Voxels:
    """Voxels that nobody speaks against and too few can judge, by projecting every centre: the definition, slow.

    Arguments and errors as of carve_bruteforce. Such a voxel lies in min_views pictures and behind an occluder in at
    least one; at most n_faulty_views cameras vote background, too few foreground. Returns (N,) int32, ascending.
    """
    check_masks(rig, masks)
    rules = _rules(len(rig), n_faulty_views, min_views, None, "abstain", occluders)
    found = []
    for voxels, n_inside, n_seen, n_foreground in _votes_of_planes(rig, grid, masks, occluders):
        is_open = (n_inside >= rules.min_views) & (n_seen < n_inside) & (n_foreground < rules.min_votes)
        found.append(voxels[is_open & (n_seen - n_foreground <= n_faulty_views)])
    return np.concatenate(found)


@dataclass(frozen=True, eq=False)
class VoteVolume:
    """Soft volume: how many cameras vote foreground, for the voxels with at least a given number of votes.

    voxels : (N,) int32 linear indices, ascending.  n_votes, n_seen : (N,) uint8, cameras that see the voxel as
    foreground, and that see it at all.
    """

    grid: VoxelGrid
    voxels: Voxels
    n_votes: NDArray[np.uint8]
    n_seen: NDArray[np.uint8]

    @property
    def share(self) -> NDArray[np.float32]:
        """Votes over views, (N,) in (0, 1]."""
        return np.divide(self.n_votes, self.n_seen, dtype=np.float32)

    def at_least(self, share: float, min_views: int) -> Voxels:
        """Voxels that this share of the cameras that see them calls foreground; at least min_views see them."""
        return self.voxels[(self.n_votes >= share * self.n_seen) & (self.n_seen >= min_views)]


def votes_bruteforce(
    rig: CameraRig, grid: VoxelGrid, masks: Sequence[Mask], *, min_votes: int = 1
) -> VoteVolume:
    """Voxels with at least min_votes foreground votes, by projecting every centre: the definition, slow.

    masks : one (H, W) bool per camera, in rig order. Empty masks give no voxels.
    Raises ValueError or TypeError for masks that do not fit the rig or a min_votes out of range.
    """
    check_masks(rig, masks)
    _check_min_votes(len(rig), min_votes)
    parts = []
    for voxels, _, n_seen, n_foreground in _votes_of_planes(rig, grid, masks):
        keep = n_foreground >= min_votes
        parts.append((voxels[keep], n_foreground[keep].astype(np.uint8), n_seen[keep].astype(np.uint8)))
    return VoteVolume(grid, *(np.concatenate(column) for column in zip(*parts, strict=True)))


class _Level:
    """Blocks of one size: pixel boxes (nb, C, 4), who sees all or some of each, most views of one voxel."""

    def __init__(
        self,
        counts: tuple[int, int, int],
        box: NDArray[np.int16],
        sees_all: NDArray[np.int64],
        sees_some: NDArray[np.int64],
        high: NDArray[np.uint8],
    ) -> None:
        self.counts = counts
        self.box, self.sees_all, self.sees_some, self.high = box, sees_all, sees_some, high

    @property
    def blocks(self) -> Blocks:
        """The blocks as kernels take them."""
        return Blocks(self.box, self.sees_all, self.sees_some, self.high, np.array(self.counts))

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
            gather(self.high, np.maximum, 0),
        )


class _Pool:
    """Exact tables of the blocks of 16 that have been looked into, as many as fit."""

    def __init__(self, capacity: int, n_cameras: int) -> None:
        # Untouched pages of these buffers cost nothing.
        self.capacity, self.n_used = capacity, 0
        self.table = np.empty((capacity, 64, n_cameras, 64), dtype=np.int32)
        self.n_seen, self.n_hidden = np.empty((2, capacity, 64, 64), dtype=np.uint8)
        self.box4, self.all4, self.some4, self.high4 = _block_arrays(capacity, 64, n_cameras)
        self.box8, self.all8, self.some8, self.high8 = _block_arrays(capacity, 8, n_cameras)


def _block_arrays(capacity: int, n: int, n_cameras: int) -> tuple[np.ndarray, ...]:
    return (
        np.empty((capacity, n, n_cameras, 4), dtype=np.int16),
        np.empty((capacity, n), dtype=np.int64),
        np.empty((capacity, n), dtype=np.int64),
        np.empty((capacity, n), dtype=np.uint8),
    )


def _pool_bytes(n_cameras: int) -> int:
    """Bytes of the tables of one block of 16."""
    return 64 * (64 * (4 * n_cameras + 2)) + 72 * (8 * n_cameras + 17)


class Carver:
    """Look-up tables of one rig and one grid, with which every frame is carved in milliseconds.

    The result equals carve_bruteforce voxel by voxel. For blocks of 16 voxels a side, bounds on the pixels are
    computed at once by interval arithmetic; exact pixels of a block's voxels are computed when a silhouette
    first falls on it, and kept. So start-up is quick, and memory grows with the space that is visited, up to
    max_table_mb (10^6 bytes); beyond it tables are discarded and computed again, which costs time only.
    occluders : behind them a camera has no vote in `carve`; None = nothing stands in anybody's way.
    Not thread-safe: it holds work buffers; threads need one each.
    Raises ValueError when the rig has more than 62 cameras or pictures of more than 32767 pixels a side.
    """

    def __init__(
        self,
        rig: CameraRig,
        grid: VoxelGrid,
        *,
        occluders: Occluders | None = None,
        max_table_mb: float = MAX_TABLE_MB,
    ) -> None:
        if len(rig) > MAX_CAMERAS:
            raise ValueError(f"a Carver takes at most {MAX_CAMERAS} cameras, got {len(rig)}")
        if max(max(c.size) for c in rig) > 32767:
            raise ValueError("a Carver takes pictures of at most 32767 pixels a side")
        self.rig, self.grid = rig, grid
        self.occluders = None if occluders is None or occluders.is_empty else occluders
        self._large = self._enclose()
        self._huge = self._large.doubled().doubled()
        n_blocks = len(self._large.high)
        self._slot = np.full(n_blocks, -1, dtype=np.int32)
        affordable = int(max_table_mb * 1e6 / _pool_bytes(len(rig)))
        self._pool = _Pool(max(1, min(n_blocks, affordable)), len(rig))
        self._prepare_images()

    @property
    def table_mb(self) -> float:
        """Memory of the exact tables so far, MB (10^6 bytes)."""
        return self._pool.n_used * _pool_bytes(len(self.rig)) / 1e6

    def _enclose(self) -> _Level:
        """Blocks of 16 with bounds that hold for their voxels without looking at each."""
        counts = tuple(-(-n // 16) for n in self.grid.shape)
        subs = np.stack(np.unravel_index(np.arange(math.prod(counts)), counts), axis=1) * 16
        last = np.minimum(subs + 15, np.array(self.grid.shape) - 1)
        lower = self.grid.origin + (subs + 0.5) * self.grid.voxel_size_m
        upper = self.grid.origin + (last + 0.5) * self.grid.voxel_size_m
        box = np.empty((len(subs), len(self.rig), 4), dtype=np.int16)
        sees_all = np.zeros(len(subs), dtype=np.int64)
        sees_some = np.zeros(len(subs), dtype=np.int64)
        for c, camera in enumerate(self.rig):
            width, height = camera.size
            parameters = camera_parameters(camera)
            if parameters is None:
                box[:, c] = 0, width - 1, 0, height - 1
                sees_some |= 1 << c
                continue
            _carve_kernels.enclose_blocks(
                lower, upper, parameters, width, height, c, box, sees_all, sees_some
            )
            # Until the exact tables say which voxels are hidden.
            sees_all[self._may_hide(camera, box[:, c])] &= ~np.int64(1 << c)
        high = np.bitwise_count(sees_some).astype(np.uint8)
        return _Level((counts[0], counts[1], counts[2]), box, sees_all, sees_some, high)

    def _may_hide(self, camera: Camera, box: NDArray[np.int16]) -> NDArray[np.bool_]:
        """Pixel boxes (B, 4), u0, u1, v0, v1, in which something stands at whatever depth, (B,)."""
        depth_m = None if self.occluders is None else self.occluders.of(camera)
        if self.occluders is None or depth_m is None:
            return np.zeros(len(box), dtype=np.bool_)
        n_standing = cv2.integral(np.isfinite(depth_m).view(np.uint8))
        # What is left of the picture beside the last whole cell belongs to that.
        last = np.array(depth_m.shape)[[1, 1, 0, 0]] - 1
        u0, u1, v0, v1 = (np.clip(box // self.occluders.cell_px, 0, last) + np.array([0, 1, 0, 1])).T
        return n_standing[v1, u1] + n_standing[v0, u0] > n_standing[v0, u1] + n_standing[v1, u0]

    def _batches(self, blocks: NDArray[np.int32]) -> Iterator[NDArray[np.int32]]:
        """The blocks of 16 in groups whose tables are all there when a group is handed out."""
        pool = self._pool
        missing = blocks[self._slot[blocks] < 0]
        if pool.n_used + len(missing) <= pool.capacity:
            self._build(missing)
            yield blocks
            return
        for first in range(0, len(blocks), pool.capacity):
            self._slot[:] = -1
            pool.n_used = 0
            group = blocks[first : first + pool.capacity]
            self._build(group)
            yield group

    def _build(self, blocks: NDArray[np.int32]) -> None:
        """Exact tables of blocks of 16 that have none; their bounds are replaced by the exact ones."""
        pool, large = self._pool, self._large
        counts, shape = np.array(large.counts), np.array(self.grid.shape)
        xyz = np.empty((3, 4096))
        is_real = np.empty(4096, dtype=np.uint8)
        pixels = np.empty(4096, dtype=np.int32)
        for block in blocks:
            t = pool.n_used
            pool.n_used += 1
            _carve_kernels.block_centers(
                block, counts, shape, self.grid.origin, self.grid.voxel_size_m, *xyz, is_real
            )
            pool.n_seen[t] = 0
            pool.n_hidden[t] = 0
            pool.all4[t] = 0
            pool.some4[t] = 0
            for c, camera in enumerate(self.rig):
                _project(camera, xyz, pixels)
                self._hide(camera, xyz, pixels)
                _carve_kernels.enter_pixels(
                    pixels, is_real, c, camera.size[0],
                    pool.table[t], pool.n_seen[t], pool.n_hidden[t], pool.box4[t], pool.all4[t], pool.some4[t],
                )  # fmt: skip
            large.sees_all[block], large.sees_some[block], large.high[block] = _carve_kernels.sum_up_block(
                pool.n_seen[t], pool.n_hidden[t], pool.box4[t], pool.all4[t], pool.some4[t], pool.high4[t],
                pool.box8[t], pool.all8[t], pool.some8[t], pool.high8[t], large.box[block],
            )  # fmt: skip
            self._slot[block] = t

    def _hide(self, camera: Camera, xyz: Array, pixels: NDArray[np.int32]) -> None:
        """Mark the pixels of points (3, n) m that lie behind an occluder."""
        depth_m = None if self.occluders is None else self.occluders.of(camera)
        if self.occluders is not None and depth_m is not None:
            axis = np.array([*camera.R[2], camera.t[2]])
            _occluder_kernels.hide_pixels(
                pixels, *xyz, axis, camera.size[0], self.occluders.cell_px, depth_m, _carve_kernels.HIDDEN
            )

    def _prepare_images(self) -> None:
        widths = np.array([c.size[0] for c in self.rig], dtype=np.int64)
        heights = np.array([c.size[1] for c in self.rig], dtype=np.int64)
        # One pixel stands before each mask: index -1, "not seen", reads it.
        self._mask_start = np.concatenate([[0], np.cumsum(widths * heights + 1)])[:-1] + 1
        self._masks = np.zeros(int(np.sum(widths * heights + 1)), dtype=np.uint8)
        sizes = (widths + 1) * (heights + 1)
        self._integral_start = np.concatenate([[0], np.cumsum(sizes)])[:-1].astype(np.int64)
        self._integral = np.zeros(int(sizes.sum()), dtype=np.int32)
        # Rectangle of each mask's foreground, u0, u1, v0, v1 inclusive: only it is copied and integrated.
        self._rect = np.tile(np.array([0, -1, 0, -1], dtype=np.int64), (len(self.rig), 1))

    def _load(self, masks: Sequence[Mask], unseen: int) -> None:
        """Copy the masks and integrate them.  unseen : what a camera votes that does not see a voxel."""
        check_masks(self.rig, masks)
        self._masks[self._mask_start - 1] = unseen
        for c, (camera, mask) in enumerate(zip(self.rig, masks, strict=True)):
            width, height = camera.size
            begin = int(self._mask_start[c])
            own = self._masks[begin : begin + width * height].reshape(height, width)
            _mask_kernels.copy_foreground(np.ascontiguousarray(mask).view(np.uint8), own, self._rect[c])
            u0, u1, v0, v1 = self._rect[c].tolist()
            if u1 < 0:
                continue
            h, w = v1 + 1 - v0, u1 + 1 - u0
            begin = int(self._integral_start[c])
            sums = self._integral[begin : begin + (w + 1) * (h + 1)].reshape(h + 1, w + 1)
            cv2.integral(own[v0 : v1 + 1, u0 : u1 + 1], sums, cv2.CV_32S)

    @property
    def _silhouettes(self) -> Silhouettes:
        """The masks of the frame that was loaded, as kernels take them."""
        integrals = Integrals(self._integral, self._integral_start, self._rect)
        return Silhouettes(integrals, self._masks, self._mask_start)

    @property
    def _tables(self) -> Tables:
        """The exact tables as kernels take them."""
        pool = self._pool
        return Tables(
            self._slot,
            InnerBlocks(pool.box8, pool.all8, pool.some8, pool.high8),
            InnerBlocks(pool.box4, pool.all4, pool.some4, pool.high4),
            pool.table,
            pool.n_seen,
            pool.n_hidden,
        )

    def carve(
        self,
        masks: Sequence[Mask],
        *,
        n_faulty_views: int,
        min_views: int | None = None,
        min_votes: int | None = None,
        outside: Outside = "abstain",
    ) -> Voxels:
        """Occupied voxels of one frame; arguments, result and errors as of carve_bruteforce.

        Source: CF 2.2.4; coarse to fine after the octree idea quoted there, on integral images.
        """
        rule = _rules(len(self.rig), n_faulty_views, min_views, min_votes, outside, self.occluders)
        self._load(masks, 0 if rule.is_strict else 1)
        large, silhouettes = self._large.blocks, self._silhouettes
        blocks = np.empty(len(large.high), dtype=np.int32)
        n = _carve_kernels.survey(self._huge.blocks, large, silhouettes.integrals, rule, blocks)
        found = []
        for group in self._batches(blocks[:n]):
            out = np.empty(4096 * len(group), dtype=np.int32)
            n = _carve_kernels.carve_blocks(
                group, large, self._tables, silhouettes, rule, np.array(self.grid.shape), out
            )
            found.append(out[:n].copy())
        return np.sort(np.concatenate(found)) if found else np.zeros(0, dtype=np.int32)

    def unknown(
        self,
        masks: Sequence[Mask],
        lower_sub: NDArray[np.integer],
        upper_sub: NDArray[np.integer],
        *,
        n_faulty_views: int,
        min_views: int | None = None,
    ) -> Voxels:
        """Voxels of a box that nobody speaks against and too few can judge, as unknown_bruteforce.

        lower_sub, upper_sub : (3,) voxel subscripts, upper exclusive; the box may exceed the grid. Without occluders
        there are none.
        """
        rule = _rules(len(self.rig), n_faulty_views, min_views, None, "abstain", self.occluders)
        lower = np.maximum(lower_sub, 0)
        upper = np.minimum(upper_sub, self.grid.shape)
        if self.occluders is None or np.any(lower >= upper):
            return np.zeros(0, dtype=np.int32)
        self._load(masks, 0)
        large, silhouettes = self._large.blocks, self._silhouettes
        blocks = np.empty(len(large.high), dtype=np.int32)
        n = _carve_kernels.survey(
            self._huge.blocks, large, silhouettes.integrals, rule._replace(min_votes=0), blocks
        )
        corner = 16 * np.stack(np.unravel_index(blocks[:n], self._large.counts), axis=1)
        blocks = blocks[:n][((corner < upper) & (corner + 16 > lower)).all(axis=1)]
        room, found = (np.array(self.grid.shape), lower, upper), []
        for group in self._batches(blocks):
            out = np.empty(4096 * len(group), dtype=np.int32)
            n = _carve_kernels.unknown_voxels(group, large, self._tables, self._silhouettes, rule, room, out)
            found.append(out[:n].copy())
        return np.sort(np.concatenate(found))

    def votes(self, masks: Sequence[Mask], *, min_votes: int = 1) -> VoteVolume:
        """Soft volume of one frame; arguments, result and errors as of votes_bruteforce.

        Blocks in which fewer than min_votes cameras find any foreground are skipped. The cost grows with the
        voxels that remain: with min_votes = 1 those are all the viewing cones.
        """
        _check_min_votes(len(self.rig), min_votes)
        self._load(masks, 0)
        large, silhouettes = self._large.blocks, self._silhouettes
        blocks = np.empty(len(large.high), dtype=np.int32)
        n = _carve_kernels.survey_votes(self._huge.blocks, large, silhouettes.integrals, min_votes, blocks)
        parts = []
        for group in self._batches(blocks[:n]):
            out = np.empty(4096 * len(group), dtype=np.int32)
            n_votes = np.empty(len(out), dtype=np.uint8)
            n_seen = np.empty(len(out), dtype=np.uint8)
            n = _carve_kernels.vote_blocks(
                group,
                large,
                self._tables,
                silhouettes,
                min_votes,
                np.array(self.grid.shape),
                (out, n_votes, n_seen),
            )
            parts.append((out[:n].copy(), n_votes[:n].copy(), n_seen[:n].copy()))
        none = (np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.uint8), np.zeros(0, dtype=np.uint8))
        voxels, n_votes, n_seen = (np.concatenate(column) for column in zip(none, *parts, strict=True))
        order = np.argsort(voxels)
        return VoteVolume(self.grid, voxels[order], n_votes[order], n_seen[order])

    def pixels(self, voxels: Voxels) -> NDArray[np.int32]:
        """Flat pixel index of each voxel in each camera, (N, C) int32; -1 outside the view."""
        return np.ascontiguousarray(pixels_in_all(self.rig, self.grid.centers(voxels)).T)

    def judged_pixels(self, voxels: Voxels, pixels: NDArray[np.int32]) -> NDArray[np.int32]:
        """The pixels (N, C) of voxels (N,), -1 also where a voxel lies behind an occluder."""
        judged = pixels.copy()
        xyz = np.ascontiguousarray(self.grid.centers(voxels).T)
        for c, camera in enumerate(self.rig):
            own = np.ascontiguousarray(pixels[:, c])
            self._hide(camera, xyz, own)
            judged[:, c] = np.maximum(own, -1)
        return judged

    def n_seen(self, voxels: Voxels) -> NDArray[np.uint8]:
        """How many cameras have each voxel in their picture, (N,) uint8."""
        return np.count_nonzero(self.pixels(voxels) >= 0, axis=1).astype(np.uint8)
