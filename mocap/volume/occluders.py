"""Occluders: where something that stands still hides people from a camera, learnt from silhouettes alone.

Where the other cameras say that a person is and a camera sees background, something may stand between; where it sees
the person, nothing does. Either way the statement holds for everything on the ray before the person, so a grid over
the room counts it: a voxel that blocked again and again, and through which next to nobody was ever seen, is an
occluder. Their nearest depths, camera by camera, are the maps: a camera cannot judge what lies behind.
After Guan, Franco and Pollefeys, "3D occlusion inference from silhouette cues" (2007); counts take the place of their
probabilities.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig, Occluders, VoxelGrid
from mocap.volume import _occluder_kernels as kernels
from mocap.volume.carve import MIN_VOTES, Carver, pixels_of_points
from mocap.volume.components import connected_components
from mocap.volume.surface import surface_voxels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
DepthMap = NDArray[np.float32]
Cells = NDArray[np.uint8]
Votes = NDArray[np.uint16]
Voxels = NDArray[np.int32]

EMPTY, PARTLY, FULL = 0, 1, 2  # of a cell, how much is foreground
CELL_PX = 4  # picture pixels per cell of the maps; an edge is known no better than to a voxel of 5 cm
VOXEL_M = 0.05
MIN_CAMERAS = 4  # with three, a camera that is hidden leaves two, and two cones cross in many places
_MOST_ENTRIES = 8_000_000  # voxels times cameras of the grid of votes: 64 MB of tables
_N_LOOKS = 2
# Fewer votes than 5 know more of what is hidden for a moment, and of what is not there; 6 miss a third of a column.
_MIN_BLOCKED = 5
# A thing is large, or smaller with voxels that are sure. In rooms without furniture frayed silhouettes leave 1.1 litres
# and 8 votes at most (two realistic walks of 98 and 120 frames); a table and a cabinet 130 and 240 litres, up to 28.
_LARGE_LITRES = 8.0
_SURE_BLOCKED = 12
_MIN_LITRES = 2.0
_FREE_PER_BLOCKED = 9  # at least nine votes of ten: silhouettes have frayed edges
_STEP_M = (
    0.05  # how far a person must have gone to give evidence again: a hole in a mask goes with the person
)
_PERSON_LITRES = 20.0
BLOCKED_MARGIN_M = 0.1  # how far before the core of a person his own surface may lie
_MIN_NEEDING = 3  # cameras whose foreground nothing surer explains; the rays of two cross in many places
# Share of a mask outside the silhouette of a hull that allows most cameras to be wrong. Healthy masks have hardly any.
_ASTRAY_SHARE = 0.3


class OccluderLearner:
    """Collects votes frame by frame: `add` frames in any order and number, `occluders` whenever they are wanted.

    grid : where persons may be.  known : occluders that are known already; they make the hulls whole that vote, so a
    second look at a clip with the occluders of the first finds what the first had no hull for.
    Memory is constant: votes and tables of one grid. Not thread-safe.
    Raises ValueError for fewer than MIN_CAMERAS cameras.
    """

    def __init__(self, rig: CameraRig, grid: VoxelGrid, known: Occluders | None = None) -> None:
        if len(rig) < MIN_CAMERAS:
            raise ValueError(f"occluders can be told from at least {MIN_CAMERAS} cameras, got {len(rig)}")
        self._rig = CameraRig(tuple(_reduced(camera) for camera in rig))
        side = max(VOXEL_M, grid.voxel_size_m)
        known = None if known is None or known.is_empty else known
        self._n_faulty = max(1, (len(rig) - 1) // 2) if known is None else 1
        self._carver = Carver(
            self._rig,
            VoxelGrid.from_bounds(grid.origin, grid.upper, side),
            occluders=None if known is None else known.on_cells(),
        )
        self._space = _space_of(rig, grid, side)
        self._tables = [_rays_of(camera, self._space) for camera in self._rig]
        self.n_free = np.zeros(self._space.n_voxels, dtype=np.uint16)
        self.n_blocked = np.zeros(self._space.n_voxels, dtype=np.uint16)
        self._places = np.zeros((0, 3))
        # The farthest and the second farthest depth at which each cell has shown a person; one may be a mistake.
        self._seen_m = [np.full((2, *camera.size[::-1]), -np.inf, dtype=np.float32) for camera in self._rig]

    def add(self, cells: Sequence[Cells]) -> bool:
        """Take one frame; returns whether it has said anything new.

        cells : the masks as of `masks_by_cells`, (h, w) uint8 per camera.
        """
        hull, core, objects = self._persons([c == FULL for c in cells])
        if len(core) == 0:
            return False
        side = self._carver.grid.voxel_size_m
        for c, (camera, own, table, seen) in enumerate(
            zip(self._rig, cells, self._tables, self._seen_m, strict=True)
        ):
            silhouette = np.isfinite(_nearest_depth(camera, hull, side))
            if np.count_nonzero((own == FULL) & ~silhouette) > _ASTRAY_SHARE * np.count_nonzero(own == FULL):
                continue  # it sees somebody, elsewhere: it has moved, lags, or others see too little
            near = _nearest_depth(camera, core, side)
            missed = _nearest_depth(camera, core[objects[:, c]], side)
            verdict = np.full(own.shape, kernels.NO_VOTE, dtype=np.uint8)
            verdict[np.isfinite(near) & (own == FULL)] = kernels.FREE
            shown = np.where(verdict == kernels.FREE, near, np.float32(-np.inf))
            seen[1] = np.maximum(seen[1], np.minimum(seen[0], shown))
            seen[0] = np.maximum(seen[0], shown)
            is_empty = cv2.dilate(own, np.ones((3, 3), np.uint8)) == EMPTY
            verdict[np.isfinite(missed) & is_empty] = kernels.BLOCKED
            kernels.vote_along_rays(
                near.ravel(), verdict.ravel(), *table, BLOCKED_MARGIN_M, self.n_free, self.n_blocked
            )
        return True

    def occluders(self) -> Occluders:
        """The maps of all cameras from the votes so far, without cells that have shown somebody behind them."""
        side = self._space.voxel_size_m
        points = self._space.centers(solid_voxels(self._space, self.n_free, self.n_blocked))
        maps = {}
        for camera, seen in zip(self._rig, self._seen_m, strict=True):
            depth = _nearest_depth(camera, points, side)
            depth[depth < seen[1]] = np.inf
            maps[camera.name] = depth
        return Occluders(maps, CELL_PX)

    def _persons(self, masks: Sequence[Mask]) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Voxels (N, 3) m of a generous hull; inner ones (K, 3) m that are surely somebody's, of those who stand where
        none has given evidence; and which cameras (K, C) see nothing but background there.
        """
        grid, n = self._carver.grid, len(self._rig)
        voxels = self._carver.carve(
            masks, n_faulty_views=self._n_faulty, min_views=min(4, n), min_votes=min(MIN_VOTES, n)
        )
        hull = grid.centers(voxels)
        pixels = self._carver.pixels(voxels)
        sees = np.column_stack([mask.ravel()[p] for mask, p in zip(masks, pixels.T, strict=True)])
        sees &= pixels >= 0
        objects = (pixels >= 0) & ~sees
        is_sure = self._is_needed(masks, hull, pixels, sees, objects.sum(axis=1))
        labels, n_found = connected_components(voxels, grid)
        litres = np.bincount(labels, minlength=n_found) * grid.voxel_size_m**3 * 1000.0
        is_core = is_sure & ~surface_voxels(voxels, grid)
        rows = [np.zeros(0, dtype=np.int64)]
        for k in np.flatnonzero(litres >= _PERSON_LITRES):
            own = np.flatnonzero(is_core & (labels == k))
            if len(own) and self._is_new(hull[own].mean(axis=0)):
                rows.append(own)
        core = np.concatenate(rows)
        return hull, hull[core], objects[core]

    def _is_needed(
        self,
        masks: Sequence[Mask],
        hull: Array,
        pixels: NDArray[np.int32],
        sees: NDArray[np.bool_],
        n_objecting: NDArray[np.int64],
    ) -> NDArray[np.bool_]:
        """Which voxels (N,) must be somebody's, because nothing that fewer cameras object to explains the foreground.

        Voxels to which nobody objects are. What they leave over in the masks must be explained by others, those to
        which one camera objects first, and so on. A phantom, where rays to two persons cross, is not needed.
        """
        side = self._carver.grid.voxel_size_m
        is_needed = n_objecting == 0
        newly = is_needed
        left = [mask.copy() for mask in masks]
        for level in range(1, int(n_objecting.max(initial=0)) + 1):
            for c, camera in enumerate(self._rig):
                shape = np.isfinite(_nearest_depth(camera, hull[newly & sees[:, c]], side)).view(np.uint8)
                left[c] &= cv2.dilate(shape, np.ones((3, 3), np.uint8)) == 0
            needing = np.column_stack([own.ravel()[p] for own, p in zip(left, pixels.T, strict=True)]) & sees
            newly = (n_objecting == level) & (needing.sum(axis=1) >= _MIN_NEEDING)
            is_needed = is_needed | newly
        return is_needed

    def _is_new(self, place: Array) -> bool:
        """Whether nobody has given evidence near a place (3,) m; from now on somebody has."""
        if len(self._places) and np.linalg.norm(self._places - place, axis=1).min() < _STEP_M:
            return False
        self._places = np.vstack([self._places, place])
        return True


def no_occluders() -> Occluders:
    """Nothing stands anywhere."""
    return Occluders({}, CELL_PX)


def learn_occluders(rig: CameraRig, grid: VoxelGrid, masks_of_frames: Iterable[Sequence[Mask]]) -> Occluders:
    """Occluders of a recording: one look at its frames as they are, and a second with what the first has found.

    masks_of_frames : per frame one (H, W) bool per camera, in rig order. Fewer than MIN_CAMERAS cameras tell nothing.
    """
    found = no_occluders()
    if len(rig) < MIN_CAMERAS:
        return found
    frames = [masks_by_cells(masks) for masks in masks_of_frames]
    for _ in range(_N_LOOKS):
        learner = OccluderLearner(rig, grid, found)
        for cells in frames:
            learner.add(cells)
        found = learner.occluders()
        if found.is_empty:
            break
    return found


def solid_voxels(space: VoxelGrid, n_free: Votes, n_blocked: Votes) -> Voxels:
    """Voxels that something fills or hides, (N,) int32 ascending, from the votes (n_voxels,) for and against."""
    blocked = n_blocked.astype(np.int64)
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
        h, w = mask.shape[0] // CELL_PX, mask.shape[1] // CELL_PX
        part = np.ascontiguousarray(mask[: h * CELL_PX, : w * CELL_PX]).view(np.uint8) * np.uint8(255)
        mean = cv2.resize(part, (w, h), interpolation=cv2.INTER_AREA)
        reduced.append((mean > 0).view(np.uint8) + (mean >= 128).view(np.uint8))
    return reduced


def _reduced(camera: Camera) -> Camera:
    """The camera of a picture reduced to cells."""
    K = camera.K.copy()
    K[:2] /= CELL_PX
    K[:2, 2] += 0.5 / CELL_PX - 0.5
    size = (camera.size[0] // CELL_PX, camera.size[1] // CELL_PX)
    return replace(camera, K=K, size=size)


def _space_of(rig: CameraRig, grid: VoxelGrid, side: float) -> VoxelGrid:
    """The grid of votes: the room and everything between it and the cameras, as fine as memory allows."""
    centers = np.array([camera.center for camera in rig])
    lower = np.minimum(grid.origin, centers.min(axis=0))
    upper = np.maximum(grid.upper, centers.max(axis=0))
    fitting = (float(np.prod(upper - lower)) * len(rig) / _MOST_ENTRIES) ** (1 / 3)
    return VoxelGrid.from_bounds(lower, upper, max(side, fitting))


def _rays_of(
    camera: Camera, space: VoxelGrid
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
    """The voxels of a space by the cells that see them: first, rows of sort_by_cell, and the rows' depths."""
    points = space.centers(np.arange(space.n_voxels, dtype=np.int32))
    cell = pixels_of_points(camera, points)
    first = np.empty(camera.size[0] * camera.size[1] + 1, dtype=np.int64)
    rows = np.empty(int(np.count_nonzero(cell >= 0)), dtype=np.int32)
    kernels.sort_by_cell(cell, first, rows)
    depth = (points @ camera.R[2] + camera.t[2]).astype(np.float32)[rows]
    return first, rows, depth


def _nearest_depth(camera: Camera, points: Array, side: float) -> DepthMap:
    """Depth (h, w) m of the nearest of cubes of one side around points (N, 3) m; inf where there is none."""
    width, height = camera.size
    near = np.full((height, width), np.inf, dtype=np.float32)
    if len(points):
        uv, depth = camera.project(points)
        half = 0.5 * side * max(camera.K[0, 0], camera.K[1, 1]) / np.maximum(depth, side)
        kernels.paint_nearest(uv, depth, half, near)
    return near
