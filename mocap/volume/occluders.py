"""Occluders: where something that stands still hides people from a camera, learnt from silhouettes alone.

Where the other cameras say that a person is and a camera sees background, something may stand between; where it sees
the person, nothing does. Either way the statement holds for everything on the ray before the person, so a grid over
the room counts it: a voxel that blocked again and again, and through which next to nobody was ever seen, is an
occluder. Their nearest depths, camera by camera, are the maps: a camera cannot judge what lies behind.
After Guan, Franco and Pollefeys, "3D occlusion inference from silhouette cues" (2007); counts take the place of their
probabilities.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig, Occluders, VoxelGrid
from mocap.volume import _mask_kernels
from mocap.volume import _occluder_kernels as kernels
from mocap.volume.carve import MIN_VOTES, Carver, pixels_in_all, pixels_of_points
from mocap.volume.components import connected_components
from mocap.volume.surface import surface_voxels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
DepthMap = NDArray[np.float32]
Cells = NDArray[np.uint8]
Votes = NDArray[np.uint16]
Voxels = NDArray[np.int32]
Rays = tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]  # of _rays_of

EMPTY, PARTLY, FULL = 0, 1, 2  # of a cell, how much is foreground
# Picture pixels per cell of the maps: an edge is known no better than to a voxel of 5 cm.
CELL_PX = _mask_kernels.CELL_PX
VOXEL_M = 0.05
MIN_CAMERAS = 3  # of two, no other one says that somebody is where one sees nobody
_MOST_ENTRIES = 8_000_000  # voxels times cameras of the grid of votes: 64 MB of tables
# Twice the most that rooms without furniture give to any voxel (decision 34).
_MIN_BLOCKED = 2
# Cameras from which a voxel must have hidden somebody to be believed by another: their rays cross in it.
_CROSSING = 2
# A thing is large, or smaller with voxels that are sure: a table and a cabinet have 100 and 250 litres, up to 30 votes.
_LARGE_LITRES = 8.0
_SURE_BLOCKED = 8
_MIN_LITRES = 2.0
_FREE_PER_BLOCKED = 9  # at least nine votes of ten: silhouettes have frayed edges
# How far a person must have gone to give evidence again: a hole in a mask goes with the person.
_STEP_M = 0.05
# Who walks about says better than the floor where things begin and end: from so many squares in which somebody was.
_SQUARE_M, _SQUARES_WALKED = 0.4, 8
# Who is in a place for half of the time stays there; who walks round a room is for a fifth of it in any place. His
# limbs reach so far from the middle of him.
_STAYS_SHARE, _REACH_M = 0.5, 0.4
# Who stays gives evidence again after so many looks: what is never seen of him cannot be judged.
AGAIN_LOOKS = 6
_PERSON_LITRES = 20.0
BLOCKED_MARGIN_M = 0.1  # how far before the core of a person his own surface may lie
MANY_CAMERAS = 6  # of so many hulls forgive one
# Cameras whose foreground nothing surer explains; the rays of two cross in many places. Of four cameras two: one sees
# nothing, and to another one side of somebody explains what it sees of the other. Of three for the same reasons one.
_MIN_NEEDING = 3
# Legs that too few cameras see for a volume. Who ends above this height without touching the floor is cut off; one
# camera must show him at this share of the lower half of the heights below, so that who jumps is whole.
_CUT_OFF_M, _CUT_OFF_TOP_M = 0.35, 0.9
_SHOWN_SHARE = 0.6
_WAIST_M = 0.3  # the lowest part of what is seen, under which the legs are
_STRIDE_M = 0.4  # from there to a foot
_HIP_M = 0.2  # half the width of what is taken for legs
# Share of a mask outside the silhouette of a hull that allows most cameras to be wrong. Healthy masks have hardly any.
_ASTRAY_SHARE = 0.1
# A camera is odd when so much of its mask is astray and it misses somebody besides; who alone sees what furniture hides
# from the others misses nobody. When it is odd in a tenth of its frames, and in more than a few, it has moved: what it
# misses is no furniture. Healthy ones are in up to 5 % (4 of 20 frames), those turned by 3 degrees in 32 to 100 %.
_ODD_SHARE, _OFTEN, _FEW_FRAMES = 0.025, 0.1, 4


class OccluderLearner:
    """Collects votes frame by frame: `add` frames in any order and number, `occluders` whenever they are wanted.

    grid : where persons may be.  things : centres (N, 3) m of cubes of VOXEL_M in which something is known to stand,
    asked where nobody walks about; they may be set at any time.
    Memory is constant: votes and tables of one grid. Not thread-safe.
    Raises ValueError for fewer than MIN_CAMERAS cameras.
    """

    def __init__(self, rig: CameraRig, grid: VoxelGrid) -> None:
        if len(rig) < MIN_CAMERAS:
            raise ValueError(f"occluders can be told from at least {MIN_CAMERAS} cameras, got {len(rig)}")
        self._rig = CameraRig(tuple(camera.reduced(CELL_PX) for camera in rig))
        side = max(VOXEL_M, grid.voxel_size_m)
        self.things = np.zeros((0, 3))
        self._n_faulty = max(1, len(rig) // 2)
        self._n_usual = 1 if len(rig) >= MANY_CAMERAS else 0
        self._carver = Carver(self._rig, VoxelGrid.from_bounds(grid.origin, grid.upper, side))
        self._space = _space_of(rig, grid, side)
        self._tables = [_rays_of(camera, self._space) for camera in self._rig]
        self.n_free = np.zeros(self._space.n_voxels, dtype=np.uint16)
        # Of each camera by itself: it knows no more than that something stands somewhere on its ray.
        self.n_blocked = np.zeros((len(rig), self._space.n_voxels), dtype=np.uint16)
        self._places, self._looked = np.zeros((0, 12)), np.zeros(0, dtype=np.int64)
        self._n_looks = 0
        # Looks in which somebody was surely over each place of the floor.
        self._n_over = np.zeros(self._carver.grid.shape[:2], dtype=np.uint16)
        # Frames that have said something, and of each camera those of them in which it was odd.
        self._n_telling, self._n_odd = 0, np.zeros(len(rig), dtype=np.int64)
        self._was_blocked = [np.zeros(camera.size[::-1], dtype=np.uint8) for camera in self._rig]
        # The farthest and the second farthest depth at which each cell has shown a person; one may be a mistake.
        self._seen_m = [np.full((2, *camera.size[::-1]), -np.inf, dtype=np.float32) for camera in self._rig]

    def add(self, cells: Sequence[Cells]) -> bool:
        """Take one frame; returns whether it has said anything new.

        cells : the masks as of `masks_by_cells`, (h, w) uint8 per camera.
        """
        self._n_looks += 1
        masks = [own == FULL for own in cells]
        grid, n = self._carver.grid, len(self._rig)
        # Cones of two of three cameras cross in many places; who is needed there is told below.
        voxels = self._carver.carve(
            masks, n_faulty_views=self._n_faulty, min_views=min(4, n), min_votes=min(MIN_VOTES, n - 1)
        )
        is_core, is_new = self._cores(voxels)
        if not is_core.any():
            return False
        squares = _squares(self._rig, grid.centers(voxels), grid.voxel_size_m)
        sees = np.array([own.ravel()[cell] for own, cell in zip(masks, squares.cell, strict=True)])
        sees &= squares.cell >= 0
        objects = (squares.cell >= 0) & ~sees
        is_sure = is_core & self._is_needed(masks, squares, sees, objects.sum(axis=0))
        for below in self._cut_off(voxels, is_sure & (objects.sum(axis=0) <= self._n_usual)):
            self._vote_of_legs(cells, below)
        columns = np.unique(grid.subscripts(voxels[is_sure])[:, :2], axis=0)
        self._n_over[tuple(columns.T)] += 1
        is_sure &= is_new
        if not is_sure.any():
            return False
        everything = np.ones(len(voxels), dtype=np.bool_)
        self._n_telling += 1
        for c, own in enumerate(cells):
            near = squares.nearest(c, is_sure)
            missed = squares.nearest(c, is_sure & objects[c])
            verdict = np.full(own.shape, kernels.NO_VOTE, dtype=np.uint8)
            verdict[np.isfinite(near) & masks[c]] = kernels.FREE
            is_empty = cv2.dilate(own, np.ones((3, 3), np.uint8)) == EMPTY
            verdict[np.isfinite(missed) & is_empty] = kernels.BLOCKED
            is_covered = np.isfinite(squares.nearest(c, everything))
            n_astray, n_seen = np.count_nonzero(masks[c] & ~is_covered), np.count_nonzero(masks[c])
            self._n_odd[c] += n_astray > _ODD_SHARE * n_seen and (verdict == kernels.BLOCKED).any()
            # Who sees somebody elsewhere has moved, lags, or others see too little.
            if n_astray <= _ASTRAY_SHARE * n_seen:
                self._vote(c, near, verdict)
        return True

    @property
    def has_found(self) -> bool:
        """Whether something hides somebody by the votes so far, perhaps by those of cameras that have moved."""
        return len(solid_voxels(self._space, self.n_free, self.n_blocked)) > 0

    def occluders(self) -> Occluders:
        """The maps of all cameras from the votes so far: for each cell the nearest solid voxel that hides somebody.

        What hid somebody from this camera itself counts when it stands behind whoever the cell has shown. What hid
        somebody from two others counts until the cell has shown somebody behind it. What is known to stand counts where
        people stay in their places, in cells that have shown nobody: hulls of things are larger than things, and those
        who walk about say better where they begin and end; where some walk, it counts before those who stay alone.
        """
        has_moved = self._n_odd > max(_OFTEN * self._n_telling, _FEW_FRAMES)
        n_blocked = np.where(has_moved[:, None], np.uint16(0), self.n_blocked)
        solid = solid_voxels(self._space, self.n_free, n_blocked)
        squares = _squares(self._rig, self._space.centers(solid), self._space.voxel_size_m)
        things = _squares(self._rig, self.things, VOXEL_M)
        squares_walked = len(np.unique(np.floor(self._places[:, :2] / _SQUARE_M), axis=0))
        is_asked = len(self.things) and squares_walked >= _SQUARES_WALKED
        stay = _squares(self._rig, self._who_stays(), VOXEL_M) if is_asked else None
        has_blocked = n_blocked[:, solid] > 0
        is_crossed = np.count_nonzero(has_blocked, axis=0) >= _CROSSING
        maps = {}
        for c, (camera, seen) in enumerate(zip(self._rig, self._seen_m, strict=True)):
            told, own = squares.nearest(c, is_crossed), squares.nearest(c, has_blocked[c], beyond=seen[1])
            told[told < seen[1]] = np.inf
            stands = things.nearest(c)
            stands[np.isfinite(seen[1])] = np.inf
            if stay is not None:
                somebody = stay.nearest(c)
                stands[~np.isfinite(somebody) | (stands > somebody + _REACH_M)] = np.inf
            # Voxels near a camera are larger than the cells in which it knows something.
            own[cv2.dilate(self._was_blocked[c], np.ones((3, 3), np.uint8)) == 0] = np.inf
            maps[camera.name] = np.minimum(np.minimum(told, own), stands)
        return Occluders(maps, CELL_PX)

    def _who_stays(self) -> Array:
        """Points (N, 3) m, a voxel apart, of where those who keep to their places may be."""
        grid = self._carver.grid
        stays = (self._n_over > 0) & (self._n_over >= _STAYS_SHARE * self._n_looks)
        reach = round(_REACH_M / grid.voxel_size_m)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        columns = cv2.dilate(stays.view(np.uint8), disc) > 0
        return grid.centers(np.flatnonzero(np.broadcast_to(columns[:, :, None], grid.shape)).astype(np.int32))

    def _vote(self, c: int, near: DepthMap, verdict: Cells) -> None:
        """Count a camera's verdicts (h, w) on what lies before the depths (h, w) m of somebody."""
        shown = np.where(verdict == kernels.FREE, near, np.float32(-np.inf))
        self._was_blocked[c] |= verdict == kernels.BLOCKED
        seen = self._seen_m[c]
        seen[1] = np.maximum(seen[1], np.minimum(seen[0], shown))
        seen[0] = np.maximum(seen[0], shown)
        kernels.vote_along_rays(
            near.ravel(), verdict.ravel(), *self._tables[c], BLOCKED_MARGIN_M, self.n_free, self.n_blocked[c]
        )

    def _cut_off(self, voxels: Voxels, is_sure: NDArray[np.bool_]) -> Iterator[Array]:
        """For everybody whose volume ends above the floor, points (N, 3) m below it, down to the floor: his legs are
        on both sides of them.  voxels : of a generous hull, with those that are surely somebody's.
        """
        grid = self._carver.grid
        labels, _ = connected_components(voxels, grid)
        for k in np.unique(labels[is_sure]):
            points = grid.centers(voxels[is_sure & (labels == k)])
            low, top = points[:, 2].min(), points[:, 2].max()
            if low > _CUT_OFF_M and top > _CUT_OFF_TOP_M:
                waist = points[points[:, 2] < low + _WAIST_M].mean(axis=0)
                heights = np.arange(2 * grid.voxel_size_m, low, grid.voxel_size_m)
                yield np.column_stack([np.tile(waist[:2], (len(heights), 1)), heights])

    def _vote_of_legs(self, cells: Sequence[Cells], below: Array) -> None:
        """Votes of all cameras on what lies before legs, where one at least shows them.  below : of `_cut_off`."""
        found = [_legs_in(own, camera, below) for own, camera in zip(cells, self._rig, strict=True)]
        if max(legs.shown_share for legs in found) < _SHOWN_SHARE:
            return
        for c, legs in enumerate(found):
            self._vote(c, legs.near, legs.verdict)

    def _cores(self, voxels: Voxels) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which voxels (N,) of a generous hull lie inside somebody, and which inside somebody who stands where none has
        given evidence."""
        grid = self._carver.grid
        labels, n_found = connected_components(voxels, grid)
        litres = np.bincount(labels, minlength=n_found) * grid.voxel_size_m**3 * 1000.0
        is_inner = ~surface_voxels(voxels, grid)
        is_core, is_new = np.zeros((2, len(voxels)), dtype=np.bool_)
        for k in np.flatnonzero(litres >= _PERSON_LITRES):
            own = is_inner & (labels == k)
            is_core |= own
            if own.any() and self._is_new(grid.centers(voxels[own])):
                is_new |= own
        return is_core, is_new

    def _is_needed(
        self,
        masks: Sequence[Mask],
        squares: _Squares,
        sees: NDArray[np.bool_],
        n_objecting: NDArray[np.int64],
    ) -> NDArray[np.bool_]:
        """Which voxels (N,) of a generous hull must be somebody's: a phantom, where rays of two cross, need not."""
        is_needed = np.zeros(len(n_objecting), dtype=np.bool_)
        kernels.needed_voxels(
            squares.cell, squares.half + 1, sees, n_objecting,
            min(_MIN_NEEDING, len(self._rig) - 2),
            np.array([camera.size[0] for camera in self._rig]),
            np.cumsum([0, *(own.size for own in masks)]),
            np.concatenate([own.ravel() for own in masks]), is_needed,
        )  # fmt: skip
        return is_needed

    def _is_new(self, points: Array) -> bool:
        """Whether nobody has given evidence near where points (N, 3) m are; from now on somebody has.

        Near is told by the mean and the square root of the covariance: where two persons in one piece of hull walk
        round each other, the mean stays.
        """
        middle = points.mean(axis=0)
        variances, axes = np.linalg.eigh((points - middle).T @ (points - middle) / len(points))
        place = np.concatenate([middle, ((axes * np.sqrt(np.maximum(variances, 0.0))) @ axes.T).ravel()])
        near = np.linalg.norm(self._places - place, axis=1) < _STEP_M
        if (self._looked[near] > self._n_looks - AGAIN_LOOKS).any():
            return False
        self._places = np.vstack([self._places[~near], place])
        self._looked = np.append(self._looked[~near], self._n_looks)
        return True


def painted(rig: CameraRig, points: Array, side: float) -> Occluders:
    """What cubes of one side, m, around points (N, 3) m hide from each camera."""
    small = CameraRig(tuple(camera.reduced(CELL_PX) for camera in rig))
    squares, every = _squares(small, points, side), np.ones(len(points), dtype=np.bool_)
    return Occluders({camera.name: squares.nearest(c, every) for c, camera in enumerate(rig)}, CELL_PX)


def no_occluders() -> Occluders:
    """Nothing stands anywhere."""
    return Occluders({}, CELL_PX)


def learn_occluders(rig: CameraRig, grid: VoxelGrid, masks_of_frames: Iterable[Sequence[Mask]]) -> Occluders:
    """Occluders of a recording.

    masks_of_frames : per frame one (H, W) bool per camera, in rig order. Fewer than MIN_CAMERAS cameras tell nothing.
    """
    if len(rig) < MIN_CAMERAS:
        return no_occluders()
    learner = OccluderLearner(rig, grid)
    for masks in masks_of_frames:
        learner.add(masks_by_cells(masks))
    return learner.occluders()


def solid_voxels(space: VoxelGrid, n_free: Votes, n_blocked: Votes) -> Voxels:
    """Voxels that something fills or hides, (N,) int32 ascending, from votes: of all cameras that nothing is there,
    (n_voxels,), and of each that something is, (C, n_voxels).
    """
    blocked = n_blocked.sum(axis=0, dtype=np.int64)
    is_solid = (blocked >= _MIN_BLOCKED) & (blocked > _FREE_PER_BLOCKED * n_free.astype(np.int64))
    voxels = np.flatnonzero(is_solid).astype(np.int32)
    labels, n = connected_components(voxels, space)
    litres = np.bincount(labels, minlength=n) * space.voxel_size_m**3 * 1000.0
    n_sure = np.bincount(labels, weights=blocked[voxels] >= _SURE_BLOCKED, minlength=n)
    is_thing = (litres >= _LARGE_LITRES) | ((litres >= _MIN_LITRES) & (n_sure > 0))
    return voxels[is_thing[labels]]


def masks_by_cells(masks: Sequence[Mask]) -> list[Cells]:
    """Masks (H, W) bool reduced to cells (h, w) uint8: EMPTY, PARTLY (less than half) or FULL foreground."""
    reduced = []
    for mask in masks:
        counts = np.empty((mask.shape[0] // CELL_PX, mask.shape[1] // CELL_PX), dtype=np.uint8)
        _mask_kernels.count_in_cells(np.ascontiguousarray(mask).view(np.uint8), counts)
        reduced.append((counts > 0).view(np.uint8) + (counts >= CELL_PX**2 // 2).view(np.uint8))
    return reduced


@dataclass(frozen=True, eq=False)
class _Legs:
    """What a camera shows below somebody's waist: verdict and depth (h, w) of what surely hides or shows legs, and the
    share of the lower half of the heights at which it shows anything."""

    near: DepthMap
    verdict: Cells
    shown_share: float


def _legs_in(cells: Cells, camera: Camera, below: Array) -> _Legs:
    """What a camera, of the cells, shows at points (N, 3) m under somebody's waist."""
    at = pixels_of_points(camera, below)
    depth = below @ camera.R[2] + camera.t[2]
    per_m = camera.K[0, 0] / np.maximum(depth, _STRIDE_M)
    stride, hip = np.ceil(_STRIDE_M * per_m).astype(int), np.ceil(_HIP_M * per_m).astype(int)
    near = np.full(cells.shape, np.inf, dtype=np.float32)
    verdict = np.full(cells.shape, kernels.NO_VOTE, dtype=np.uint8)
    shows = np.zeros(len(below), dtype=np.bool_)
    for i in np.flatnonzero(at >= 0):
        v, u = divmod(int(at[i]), camera.size[0])
        rows = slice(max(v - 1, 0), v + 2)
        inner = rows, slice(max(u - hip[i], 0), u + hip[i] + 1)
        near[inner] = depth[i] - _HIP_M
        if (cells[rows, max(u - stride[i], 0) : u + stride[i] + 1] != EMPTY).any():
            shows[i] = True
            verdict[inner] = np.where(cells[inner] == FULL, kernels.FREE, kernels.NO_VOTE)
        else:
            verdict[inner] = kernels.BLOCKED
    return _Legs(near, verdict, float(shows[: -(-len(below) // 2)].mean()))


def _space_of(rig: CameraRig, grid: VoxelGrid, side: float) -> VoxelGrid:
    """The grid of votes: the room and everything between it and the cameras, as fine as memory allows."""
    centers = np.array([camera.center for camera in rig])
    lower = np.minimum(grid.origin, centers.min(axis=0))
    upper = np.maximum(grid.upper, centers.max(axis=0))
    fitting = (float(np.prod(upper - lower)) * len(rig) / _MOST_ENTRIES) ** (1 / 3)
    return VoxelGrid.from_bounds(lower, upper, max(side, fitting))


def _rays_of(camera: Camera, space: VoxelGrid) -> Rays:
    """The voxels of a space by the cells that see them: first, rows of sort_by_cell, and the rows' depths."""
    points = space.centers(np.arange(space.n_voxels, dtype=np.int32))
    cell = pixels_of_points(camera, points)
    first = np.empty(camera.size[0] * camera.size[1] + 1, dtype=np.int64)
    rows = np.empty(int(np.count_nonzero(cell >= 0)), dtype=np.int32)
    kernels.sort_by_cell(cell, first, rows)
    depth = (points @ camera.R[2] + camera.t[2]).astype(np.float32)[rows]
    return first, rows, depth


@dataclass(frozen=True, eq=False)
class _Squares:
    """Cubes as the cameras see them: squares of cells.

    cell : (C, N) int32, of the middle, -1 outside the picture.  half : (C, N) int32, half the side less half a cell.
    depth : (C, N) float32 m.  sizes : of the pictures, cells.
    """

    cell: NDArray[np.int32]
    half: NDArray[np.int32]
    depth: NDArray[np.float32]
    sizes: tuple[tuple[int, int], ...]

    def nearest(
        self, c: int, is_painted: NDArray[np.bool_] | None = None, beyond: DepthMap | None = None
    ) -> DepthMap:
        """Depth (h, w) m of the nearest of some cubes (N,) bool in camera c, None = all; inf where there is none.

        beyond : (h, w) m, which those that count exceed; None = all count.
        """
        if is_painted is None:
            is_painted = np.ones(self.depth.shape[1], dtype=np.bool_)
        near = np.full(self.sizes[c][::-1], np.inf, dtype=np.float32)
        floor = np.full_like(near, -np.inf) if beyond is None else beyond
        kernels.paint_nearest(self.cell[c], self.depth[c], self.half[c], is_painted, floor, near)
        return near


def _squares(rig: CameraRig, points: Array, side: float) -> _Squares:
    """Cubes of one side, m, around points (N, 3) m."""
    cell = pixels_in_all(rig, points)
    depth = np.array([points @ camera.R[2] + camera.t[2] for camera in rig])
    focal = np.array([max(camera.K[0, 0], camera.K[1, 1]) for camera in rig])
    half = np.floor(0.5 * side * focal[:, None] / np.maximum(depth, side) + 0.5).astype(np.int32)
    return _Squares(cell, half, depth.astype(np.float32), tuple(camera.size for camera in rig))
