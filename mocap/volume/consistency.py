"""Consistency of masks: each mask against the hull that the other cameras carve, over time.

A silhouette of the others' hull holds the person, so a healthy camera's mask lies inside it. When the camera has
moved, its mask sticks out; when it lags, the mask fits the hull of another frame. The hull of the others is carved
with one faulty view allowed, so that one bad camera does not spoil the evidence about the good ones.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig, Occluders, VoxelGrid
from mocap.volume import _kernels, _mask_kernels
from mocap.volume.carve import Carver, check_masks
from mocap.volume.components import connected_components
from mocap.volume.rig_agreement import MaskSample
from mocap.volume.synchrony import Silhouettes, silhouette_hull

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Image = NDArray[np.uint8]
Small = NDArray[np.uint8]
Voxels = NDArray[np.int32]

MAX_LAG_FRAMES = 8
SHRINK = _mask_kernels.CELL_PX  # picture pixels per cell of the small masks
_FOOTPRINT = 1.2  # width of a painted voxel, as in residuals.py
_MIN_VIEWS = 4
MIN_CELLS = 12  # a silhouette with fewer cells says nothing
_TOUCH_SHARE = 0.1  # of the hull's silhouette that a mask must cover to be the same person's
_LIMITS = (float(MIN_CELLS), _TOUCH_SHARE)
_OPEN_SHARE = (
    0.5  # of a hull in the picture, that no occluder hides, below which a camera is not judged by it
)
_SAMPLE_STEPS = (16, 4)  # every so many rows and columns of a picture are looked at
_MAX_SNAPSHOTS = 96
# Whole masks: 24 of seven cameras of 640 x 480 are 6 MB of bits, and 12 to 24 frames tell a shift of 2 cm.
_MAX_SAMPLES = 24
# Outlines are kept as convex hulls, a few kB a frame, of frames that follow each other, as clocks are told from motion:
# 1.6 s at 30 frames a second, some times over the recording.
_BURST_FRAMES, _MAX_BURSTS = 48, 8
_MAX_OUTLINES = 48  # frames of them that are looked at: as many as `mocap check` takes
# Of a volume, at the room's side: less is a hand, or the corner of what few cameras leave of the rays.
_CUT_SHARE = 0.02
# Of the largest part of a volume; smaller ones are no person, but what hangs between the rays of two persons behind
# tables: up to 0.15. A child of 1.1 m has 0.22 of a man's volume.
_LEAST_PART = 0.2
# Of a clock that counts frames: what smooths curves is measured for pictures of about this rate.
FRAME_S = 1 / 30


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One frame at reduced resolution.

    masks, hulls : (C, h, w) uint8; hulls as of paint_left_out.  pictures : (C, h, w) uint8, the green channel, or None.
    """

    frame: int
    masks: Small
    hulls: Small
    pictures: Small | None


@dataclass(frozen=True, eq=False)
class Glimpse:
    """What is looked at of the pictures of one frame: their green, which says of light what all of it would.

    samples : of each camera (rows, columns) uint8, pixels of a lattice.  small : (C, h, w) uint8, reduced pictures, in
    the frames of which a snapshot is kept; None in others.
    """

    samples: tuple[Small, ...]
    small: Small | None


@dataclass(frozen=True, eq=False)
class SilhouetteEvidence:
    """Numbers per frame and camera that camera faults are told by.

    frames : (T,) int.  uncovered : (T, C, 2 W + 1) share of the mask outside the silhouette of the others' hull of
    W frames later .. W frames earlier (index W + lag for a camera that lags `lag` frames); 1 when the mask misses
    the silhouette, NaN when there is no such frame or nobody in the picture.  strict : the same for the hull that
    allows no faulty view.  mask_cells, hull_cells : (T, C) size of mask and silhouette, in cells of 4 x 4 px.
    change : (T, C) share of the mask that is new or gone since the last frame, NaN without a mask.
    picture_change, brightness, contrast : (T, C) mean absolute difference to the last picture, mean and standard
    deviation, grey levels; NaN without pictures.  snapshots : some frames, evenly spread.
    is_furnished : something is known to stand before people.
    """

    names: tuple[str, ...]
    frames: NDArray[np.int64]
    uncovered: NDArray[np.float32]
    strict: NDArray[np.float32]
    mask_cells: NDArray[np.int32]
    hull_cells: NDArray[np.int32]
    expected_cells: NDArray[np.int32]
    change: NDArray[np.float32]
    picture_change: NDArray[np.float32]
    brightness: NDArray[np.float32]
    contrast: NDArray[np.float32]
    snapshots: tuple[Snapshot, ...]
    is_furnished: bool = False


class ConsistencyMonitor:
    """Collects evidence frame by frame: `add` every frame in order, with a `glimpse` of its pictures, then `evidence`.

    grid : where persons may be; it is resampled at voxel_size_m, because silhouettes of a coarse hull will do.
    occluders : what stands before people; who is hidden from a camera is not expected in its mask.
    n_frames : how many will be added, as far as is known.
    Memory is constant but for some hundred numbers per frame. Not thread-safe.
    """

    def __init__(
        self,
        rig: CameraRig,
        grid: VoxelGrid,
        occluders: Occluders | None = None,
        *,
        voxel_size_m: float = 0.05,
        n_frames: int = 0,
    ) -> None:
        side = max(voxel_size_m, grid.voxel_size_m)
        self.rig = rig
        self._carver = Carver(rig, VoxelGrid.from_bounds(grid.origin, grid.upper, side), occluders=occluders)
        self._size = (max(c.size[1] for c in rig) // SHRINK, max(c.size[0] for c in rig) // SHRINK)
        self._width = np.array([c.size[0] for c in rig], dtype=np.int64)
        focal = np.array([max(c.K[0, 0], c.K[1, 1]) for c in rig])
        self._half_at_1m = 0.5 * _FOOTPRINT * side * focal
        self._axes = np.array([[*c.R[2], c.t[2]] for c in rig])
        self._recent: deque[_Frame] = deque(maxlen=MAX_LAG_FRAMES + 1)
        self._rows: list[_Row] = []
        self._samples: tuple[Small, ...] | None = None
        self._snapshots = _Spread[Snapshot](_MAX_SNAPSHOTS, n_frames)
        self._small_pictures = _Cadence(_MAX_SNAPSHOTS, n_frames)
        self._samples_of_masks = _Spread[_Packed](_MAX_SAMPLES)
        self._bursts = _Spread[list[list[Array]]](_MAX_BURSTS)
        self._burst: list[list[Array]] | None = None
        self._places: Array = np.zeros((0, 3))

    def glimpse(self, images: Sequence[Image]) -> Glimpse:
        """What `add` wants of the pictures of the next frame, (H, W, 3) uint8 per camera.

        Apart from it because pictures are large: it may be called in another process, as long as it is called for every
        frame.
        """
        down, across = _SAMPLE_STEPS
        samples = tuple(np.ascontiguousarray(image[::down, ::across, 1]) for image in images)
        if not self._small_pictures.takes_next():
            return Glimpse(samples, None)
        small = np.zeros((len(images), *self._size), dtype=np.uint8)
        for own, image in zip(small, images, strict=True):
            h, w = image.shape[0] // SHRINK, image.shape[1] // SHRINK
            green = cv2.extractChannel(image, 1)
            own[:h, :w] = cv2.resize(green, (w, h), interpolation=cv2.INTER_AREA)
        return Glimpse(samples, small)

    def add(self, frame: int, masks: Sequence[Mask], glimpse: Glimpse | None = None) -> None:
        """Take one frame: one mask (H, W) bool per camera and, if there are pictures, what was seen of them."""
        check_masks(self.rig, masks)
        now = _Frame(self._shrunk(masks), self._silhouettes(masks))
        row = _Row(frame, len(self.rig))
        before = self._recent[-1] if self._recent else None
        row.mask_cells[:] = np.count_nonzero(now.masks, axis=(1, 2))
        row.hull_cells[:] = now.hull_cells
        row.expected_cells[:] = now.expected_cells
        if before is not None:
            changed = np.count_nonzero(now.masks ^ before.masks, axis=(1, 2))
            size = np.maximum(row.mask_cells, self._rows[-1].mask_cells)
            with np.errstate(invalid="ignore", divide="ignore"):
                row.change[:] = np.where(size >= MIN_CELLS, changed / size, np.nan)
        if glimpse is not None:
            self._tell_light(glimpse.samples, row)
        self._rows.append(row)
        self._recent.append(now)
        self._compare()
        self._snapshots.add(lambda: Snapshot(frame, now.masks, now.hulls, _own(glimpse)))
        self._outline(masks)
        if len(self._places):
            self._samples_of_masks.add(
                lambda: _Packed(frame, tuple(np.packbits(mask, axis=1) for mask in masks), self._places)
            )

    @property
    def occluders(self) -> Occluders | None:
        """What is known to stand before people."""
        return self._carver.occluders

    def outlines(self) -> list[list[Array]]:
        """Corners (P, 2) px of the convex hulls of the masks of some frames, per camera and frame."""
        frames = [frame for burst in self._bursts.items for frame in burst]
        return [list(own) for own in zip(*frames[:: max(1, len(frames) // _MAX_OUTLINES)], strict=True)]

    def silhouettes(self) -> list[Silhouettes]:
        """What clocks are told from: outlines of frames that follow each other, on a clock that counts frames."""
        bursts = self._bursts.items
        # Apart, so that no lag reaches from one to the next.
        starts = 2 * _BURST_FRAMES * np.arange(len(bursts))
        times = [start + np.arange(2 * _BURST_FRAMES) for start in starts]
        nobody = [np.zeros((0, 2))]
        return [
            Silhouettes(
                FRAME_S * np.concatenate(times),
                [h for b in bursts for h in ([f[c] for f in b] + nobody * (2 * _BURST_FRAMES - len(b)))],
            )
            for c in range(len(self.rig))
        ]

    def mask_samples(self) -> list[MaskSample]:
        """Whole masks of some frames with people, evenly spread."""
        widths = [camera.size[0] for camera in self.rig]
        return [
            MaskSample(
                sample.frame,
                [
                    np.unpackbits(mask, axis=1, count=width).view(np.bool_)
                    for mask, width in zip(sample.masks, widths, strict=True)
                ],
                sample.places,
            )
            for sample in self._samples_of_masks.items
        ]

    def evidence(self) -> SilhouetteEvidence:
        """Everything collected so far."""
        rows, n = self._rows, len(self.rig)

        def column(name: str, *shape: int) -> NDArray:
            values = [getattr(row, name) for row in rows]
            return np.array(values).reshape(len(rows), n, *shape)

        return SilhouetteEvidence(
            names=self.rig.names,
            frames=np.array([row.frame for row in rows], dtype=np.int64),
            uncovered=column("uncovered", 2 * MAX_LAG_FRAMES + 1),
            strict=column("strict", 2 * MAX_LAG_FRAMES + 1),
            mask_cells=column("mask_cells"),
            hull_cells=column("hull_cells"),
            expected_cells=column("expected_cells"),
            change=column("change"),
            picture_change=column("picture_change"),
            brightness=column("brightness"),
            contrast=column("contrast"),
            snapshots=tuple(self._snapshots.items),
            is_furnished=self._carver.occluders is not None,
        )

    def _outline(self, masks: Sequence[Mask]) -> None:
        """Keep the outlines of the newest frame, when its burst is kept."""
        if len(self._rows) % _BURST_FRAMES == 1:
            self._burst = self._bursts.add(list)
        if self._burst is not None:
            self._burst.append([silhouette_hull(mask) for mask in masks])

    def _shrunk(self, masks: Sequence[Mask]) -> Small:
        """(C, h, w) uint8: cells of which at least half is foreground."""
        counts = np.zeros((len(masks), *self._size), dtype=np.uint8)
        for own, mask in zip(counts, masks, strict=True):
            _mask_kernels.count_in_cells(np.ascontiguousarray(mask).view(np.uint8), own)
        return (counts >= SHRINK**2 // 2).view(np.uint8)

    def _silhouettes(self, masks: Sequence[Mask]) -> Small:
        """(C, h, w) uint8 silhouettes of the others' hulls."""
        n = len(self.rig)
        canvas = np.zeros((n, *self._size), dtype=np.uint8)
        # Where things stand about, more is hidden than is known of, and masks break at edges.
        is_furnished = self._carver.occluders is not None
        tolerance = 2 if is_furnished else 1
        # Whatever one camera is left out of, at most one vote more is missing of all.
        voxels = self._carver.carve(
            masks,
            n_faulty_views=min(tolerance + 1, n - 1),
            min_views=min(_MIN_VIEWS, n),
            min_votes=min(2, n) if is_furnished else None,
        )
        voxels = _whole_in_room(voxels, self._carver.grid)
        self._places = np.zeros((0, 3))
        if len(voxels) == 0:
            return canvas
        centers = self._carver.grid.centers(voxels)
        self._places = _corners(centers.min(axis=0), centers.max(axis=0))
        pixels = self._expected_pixels(voxels)
        is_miss = np.empty(pixels.shape, dtype=np.bool_)
        for c, mask in enumerate(masks):
            is_miss[:, c] = (pixels[:, c] >= 0) & ~mask.ravel().take(pixels[:, c], mode="clip")
        depth = centers @ self._axes[:, :3].T + self._axes[:, 3]
        _kernels.paint_left_out(
            pixels, is_miss, depth, self._width, self._half_at_1m, SHRINK, tolerance, canvas
        )
        return canvas

    def _expected_pixels(self, voxels: Voxels) -> NDArray[np.int32]:
        """Where each voxel (N,) is seen, (N, C), -1 = not; nowhere in a camera from which most of them are hidden.

        What is left of somebody who is hidden is too little to judge a camera by: occluders are known to a voxel, and a
        person is seen only in part at their edges.
        """
        pixels = self._carver.pixels(voxels)
        if self._carver.occluders is None:
            return pixels
        n_inside = np.count_nonzero(pixels >= 0, axis=0)
        pixels = self._carver.judged_pixels(voxels, pixels)
        n_open = np.count_nonzero(pixels >= 0, axis=0)
        pixels[:, n_open < _OPEN_SHARE * n_inside] = -1
        return pixels

    def _tell_light(self, samples: tuple[Small, ...], row: _Row) -> None:
        """Brightness, contrast and change of the pictures, as a lattice of their pixels shows them."""
        for c, (now, before) in enumerate(zip(samples, self._samples or samples, strict=True)):
            row.brightness[c], row.contrast[c], change = _kernels.light_of(now, before)
            row.picture_change[c] = np.nan if self._samples is None else change
        self._samples = samples

    def _compare(self) -> None:
        """Fill in what the newest frame says about the lags between it and the frames before."""
        now = self._recent[-1]
        for lag in range(len(self._recent)):
            then, row = self._recent[-1 - lag], self._rows[-1 - lag]
            self._rows[-1].enter(MAX_LAG_FRAMES + lag, now, then)
            if lag:
                row.enter(MAX_LAG_FRAMES - lag, then, now)


_Item = TypeVar("_Item")


class _Cadence:
    """Which of the things that are offered one after the other are taken: those that stay are every `step`-th, at most
    so many, and at least half as many.

    n_expected : how many will be offered, as far as is known: what would not stay is not even taken.
    """

    def __init__(self, most: int, n_expected: int = 0) -> None:
        self.step = 1
        self._most, self._n_offered = most, 0
        self._widen(n_expected)

    def takes_next(self) -> bool:
        """Whether the next one is taken; `step` may double behind it."""
        is_taken = self._n_offered % self.step == 0
        self._n_offered += 1
        self._widen(self._n_offered)
        return is_taken

    def _widen(self, n: int) -> None:
        while -(-n // self.step) >= self._most:
            self.step *= 2


class _Spread(Generic[_Item]):
    """The things that a `_Cadence` takes and leaves."""

    def __init__(self, most: int, n_expected: int = 0) -> None:
        self.items: list[_Item] = []
        self._cadence = _Cadence(most, n_expected)

    def add(self, make: Callable[[], _Item]) -> _Item | None:
        """Offer the next thing, which is made only when it is taken; None when it is not."""
        step = self._cadence.step
        if not self._cadence.takes_next():
            return None
        taken = make()
        self.items.append(taken)
        if self._cadence.step > step:
            self.items = self.items[::2]
        return taken


def _own(glimpse: Glimpse | None) -> Small | None:
    """A copy of the reduced pictures: those of another process lie in memory that is wanted for the next frames."""
    return None if glimpse is None or glimpse.small is None else glimpse.small.copy()


@dataclass(frozen=True, eq=False)
class _Packed:
    """A `MaskSample` with the masks as bits."""

    frame: int
    masks: tuple[NDArray[np.uint8], ...]
    places: Array


def _whole_in_room(voxels: Voxels, grid: VoxelGrid) -> Voxels:
    """Voxels (N,) of what is whole in the room: of somebody who walks out of it masks show more than the volume can.

    With him goes what is too small for a person: a hand that the voxels part from him.
    """
    if len(voxels) == 0:
        return voxels
    columns = grid.subscripts(voxels)[:, :2]
    at_side = ((columns == 0) | (columns == np.array(grid.shape[:2]) - 1)).any(axis=1)
    if not at_side.any():
        return voxels
    component, n = connected_components(voxels, grid)
    size = np.bincount(component, minlength=n)
    is_cut = np.bincount(component[at_side], minlength=n) > _CUT_SHARE * size
    if not is_cut.any():
        return voxels
    is_cut |= size < _LEAST_PART * size[0]  # the first is the largest
    return np.asarray(voxels[~is_cut[component]])


def _corners(lower: Array, upper: Array) -> Array:
    """The corners (8, 3) of a box."""
    return np.array(np.meshgrid(*zip(lower, upper, strict=True))).reshape(3, -1).T


class _Frame:
    """Small masks and silhouettes of a frame, and of each mask the part that meets its silhouette.

    Only regions that touch the hull's silhouette: what else a camera sees, a bystander outside the room or a moving
    curtain, is no evidence.
    """

    def __init__(self, masks: Small, hulls: Small) -> None:
        self.masks, self.hulls = masks, hulls
        self.own = np.zeros_like(masks)
        self.rects = np.empty((len(masks), 4), dtype=np.int64)
        self.cells = np.empty(len(masks), dtype=np.int64)
        work = np.empty(masks[0].size, dtype=np.int32)
        _kernels.regions_met(masks, hulls, self.own, self.rects, self.cells, work)
        self.hull_cells = np.count_nonzero(hulls, axis=(1, 2))
        # What a mask must meet: the tighter silhouette, because a camera that sees foreground everywhere bloats the
        # other one.
        n_tight = np.count_nonzero(hulls & 2, axis=(1, 2))
        self.expected_cells = np.where(n_tight >= MIN_CELLS, n_tight, self.hull_cells)


class _Row:
    """The numbers of one frame, C cameras."""

    def __init__(self, frame: int, n_cameras: int) -> None:
        self.frame = frame
        lags = 2 * MAX_LAG_FRAMES + 1
        self.uncovered = np.full((n_cameras, lags), np.nan, dtype=np.float32)
        self.strict = np.full((n_cameras, lags), np.nan, dtype=np.float32)
        self.mask_cells = np.zeros(n_cameras, dtype=np.int32)
        self.hull_cells = np.zeros(n_cameras, dtype=np.int32)
        self.expected_cells = np.zeros(n_cameras, dtype=np.int32)
        self.change = np.full(n_cameras, np.nan, dtype=np.float32)
        self.picture_change = np.full(n_cameras, np.nan, dtype=np.float32)
        self.brightness = np.full(n_cameras, np.nan, dtype=np.float32)
        self.contrast = np.full(n_cameras, np.nan, dtype=np.float32)

    def enter(self, column: int, own: _Frame, other: _Frame) -> None:
        """Compare the cameras' masks in one frame with the silhouettes of the others' hulls in another."""
        _kernels.uncovered_shares(
            own.own,
            own.cells,
            own.rects,
            other.hulls,
            other.hull_cells,
            other.expected_cells,
            _LIMITS,
            column,
            self.uncovered,
            self.strict,
        )
