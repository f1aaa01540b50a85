"""A second look at masks, all cameras together: what was taken for a shadow and is a person, and the other way round.

Dark trousers before a dark floor have the colour of the floor in shadow, and one picture cannot tell them apart. The
other cameras can: a shadow lies on a surface that they see unoccupied, and they see it as dark as this one does. At
somebody's feet the floor is as dark as a person: there the others see nobody just above it.

Cameras that see no colours take most of a person for a shadow, each in its place: of them other rules hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig, VoxelGrid
from mocap.volume import _second_look_kernels as kernels
from mocap.volume.carve import Carver, pixels_in_all
from mocap.volume.floor import floor_behind
from mocap.volume.residuals import FOOTPRINT
from mocap.volume.surface import surface_voxels

Mask = NDArray[np.bool_]
Array = NDArray[np.float64]
Pixels = NDArray[np.int32]
Box = NDArray[np.int64]

# With five cameras hulls that forgive two of them are so fat that shadows fall inside (room: IoU 0.952 to 0.948).
LEAST_CAMERAS, LEAST_GREY_CAMERAS = 6, 4
# Of a picture 640 pixels wide. Gaps of so much are closed inside the volume, where a shirt is as bright as the wall.
_GREY_CLOSING_PX = 9
_FLOOR_M = 0.06  # what lies lower is not told from a shadow on the floor
# At these heights over a contact shadow nobody is; from there on the volume of persons tells.
_FEET_M = (0.04, 0.06, 0.08)
# Nobody is where more than so many of the others see none. IoU with 1 and 2: walk 0.928 and 0.927, dev:cross 0.935 and
# 0.936, where parts of a person are missing in two masks (eval.segmentation.kinds, four frames, all cameras).
_MISSING = 2
_BARE = 1  # others that may see the floor bare: from more of them furniture hides the feet, and the shadow
_LEAST_OTHERS = 4  # that have the floor in their pictures
# Of the shadow within 15 x 15 pixels about one, what must lie inside the volume: a shadow on the floor reaches beyond.
_MOSTLY, _AROUND_PX = 0.7, 15
_REMAINS_PX = 5  # side of the square in which more than half of the mask must go for the rest to go with it
# Pixels of a camera whose floor is kept, 112 bytes each with seven cameras: feet stay where they are for a while.
_MOST_KEPT = 1 << 15


class _Rule(NamedTuple):
    """How many cameras may say what of a place where a person is.

    n_blind : see nothing at all: a table stands before them, or he is as bright as what is behind him.  n_against : do
    not see a person.  n_blind_before_wall : see nothing where no floor tells a shadow from him.  closing_px : of the
    gaps in masks that are closed inside the volume; 0 = none.
    """

    n_blind: int
    n_against: int
    n_blind_before_wall: int
    closing_px: int


def least_cameras(*, are_grey: bool) -> int:
    """Cameras that a second look takes.  are_grey : they see no colours."""
    return LEAST_GREY_CAMERAS if are_grey else LEAST_CAMERAS


def _rule_of(n_cameras: int, *, are_grey: bool) -> _Rule:
    if are_grey:
        return _Rule((n_cameras - 1) // 3, n_cameras - 2, max(0, n_cameras - 5), _GREY_CLOSING_PX)
    return _Rule(1, (n_cameras - 1) // 2, 0, 0)


class SecondLook:
    """The cameras of a rig on one grid, asked which shadows are none.

    are_grey : the cameras see no colours.
    Not to be shared between threads: it holds work buffers. Raises ValueError for fewer than `least_cameras`.
    """

    def __init__(self, rig: CameraRig, grid: VoxelGrid, *, are_grey: bool = False) -> None:
        if len(rig) < (least := least_cameras(are_grey=are_grey)):
            raise ValueError(f"rig: expected at least {least} cameras, got {len(rig)}")
        self._rule = _rule_of(len(rig), are_grey=are_grey)
        self._rig, self._grid = rig, grid
        self._carver = Carver(rig, grid)
        sizes = [camera.size[::-1] for camera in rig]
        self._start = np.cumsum([1, *(h * w + 1 for h, w in sizes)])[:-1]
        self._bits = np.zeros(sum(h * w + 1 for h, w in sizes), dtype=np.uint8)
        self._bits[self._start - 1] = kernels.MASK
        self._flat = np.split(self._bits, self._start[1:] - 1)
        self._pictures = [flat[1:].reshape(size) for flat, size in zip(self._flat, sizes, strict=True)]
        self._either = [np.zeros(size, dtype=np.bool_) for size in sizes]
        self._boxes = np.tile(np.array([0, -1, 0, -1]), (len(rig), 1))
        self._axes = np.array([[*camera.R[2], camera.t[2]] for camera in rig])
        focal = np.array([max(camera.K[0, 0], camera.K[1, 1]) for camera in rig])
        self._half_at_1m = 0.5 * FOOTPRINT * grid.voxel_size_m * focal
        self._floor = _floor_of(grid)
        self._floor_pixels = pixels_in_all(rig, self._floor)
        self._draw(self._floor_pixels, self._floor, kernels.FLOOR)
        self._feet = [_Feet(rig, grid, c) for c in range(len(rig))]

    def masks(
        self,
        masks: Sequence[Mask],
        shadows: Sequence[Mask],
        doubtful: Sequence[Mask],
        boxes: Sequence[tuple[int, int, int, int]] | None = None,
    ) -> list[Mask]:
        """The masks of one instant, with what turned out to be no shadow, and without what turned out to be one.

        masks, shadows : (H, W) bool per camera, apart from each other. A shadow becomes foreground inside the volume
        that all cameras but one see as person or shadow, and more than half as person; before a wall, where no floor
        tells, that all see so. Without colours all but a third see the one, two the other; before a wall all but those
        above five; and gaps are closed inside. Not where it lies on the floor, which is so where as many other cameras
        see shadow as see the empty floor.

        doubtful : (H, W) bool per camera, what of the mask has a shadow's darkness and colour. It goes where it shows
        the floor at somebody's feet: outside that volume, where more than two of the others see nobody from 4 cm
        above the floor on, and no more than one sees the floor bare.

        boxes : u0, u1, v0, v1, inclusive, of each camera: outside it has neither mask nor shadow; None = not known.
        """
        for picture, box, either in zip(self._pictures, self._boxes, self._either, strict=True):
            kernels.forget(box, picture, either)
        known = [_box_of(*own) for own in zip(masks, shadows, strict=True)] if boxes is None else boxes
        self._boxes[:] = known
        within = self._boxes.copy()
        asked = [
            self._enter(c, box, *own)
            for c, (box, *own) in enumerate(zip(within, masks, shadows, doubtful, strict=True))
        ]
        self._draw_person()
        self._draw_shadow([len(shadow) > 0 for shadow, _ in asked])
        for picture, (shadow, _) in zip(self._pictures, asked, strict=True):
            kernels.shadows_of_persons(picture, shadow, _AROUND_PX // 2, _MOSTLY)
        out = [
            self._without_contact_shadow(c, box, doubt)
            for c, (box, (_, doubt)) in enumerate(zip(within, asked, strict=True))
        ]
        if not self._rule.closing_px:
            return out
        return [self._closed(*own) for own in zip(self._pictures, out, strict=True)]

    def _closed(self, picture: NDArray[np.uint8], mask: Mask) -> Mask:
        """The mask (H, W) of a camera with the gaps closed that show the volume."""
        side = round(self._rule.closing_px * mask.shape[1] / 640) | 1
        closed = cv2.morphologyEx(mask.view(np.uint8), cv2.MORPH_CLOSE, np.ones((side, side), np.uint8)) > 0
        return mask | (closed & ((picture & kernels.VOLUME) != 0))

    def _enter(self, c: int, box: Box, mask: Mask, shadow: Mask, doubtful: Mask) -> tuple[Pixels, Pixels]:
        """Take what a camera shows inside a box; the flat pixels of its shadows, and of what is doubtful."""
        lists = np.empty((2, mask.size), dtype=np.int32)
        n, m = kernels.enter_masks(
            mask, shadow, doubtful, box, self._pictures[c], self._either[c], lists[0], lists[1]
        )
        return lists[0, :n], lists[1, :m]

    def _without_contact_shadow(self, c: int, box: Box, doubtful: Pixels) -> Mask:
        """The mask (H, W) of a camera without the floor at somebody's feet, as the others see it."""
        picture = self._pictures[c]
        mask = np.zeros(picture.shape, dtype=np.uint8)
        kernels.copy_mask(picture, box, mask)
        asked = np.empty(len(doubtful), dtype=np.int32)
        asked = asked[: kernels.on_no_person(picture, doubtful, asked)]
        is_shadow = np.empty(len(asked), dtype=np.bool_)
        kernels.contact_shadows(
            *self._feet[c].seen_by_others(asked), self._bits, self._start,
            (_BARE, _LEAST_OTHERS, _MISSING), is_shadow,
        )  # fmt: skip
        kernels.remove(picture, asked, is_shadow, _REMAINS_PX // 2, mask)
        return mask.view(np.bool_)

    def _draw_person(self) -> None:
        """Draw the volume that can be nothing but a person, and what of it nobody speaks against."""
        voxels = self._carver.carve(self._either, n_faulty_views=self._rule.n_blind)
        points = self._grid.centers(voxels)
        voxels, points = voxels[points[:, 2] > _FLOOR_M], points[points[:, 2] > _FLOOR_M]
        pixels = pixels_in_all(self._rig, points)
        against, clear = np.empty((2, len(voxels)), dtype=np.int64)
        kernels.count_against(pixels, self._bits, self._start, kernels.MASK, against)
        # Before a wall nobody says whether a shadow lies there: then no camera, without
        # colours no more than the rule says, may speak against the person.
        kernels.count_against(pixels, self._bits, self._start, kernels.MASK | kernels.SHADOW, clear)
        is_person = against <= self._rule.n_against
        for some, bit in (
            (is_person, kernels.VOLUME),
            (is_person & (clear <= self._rule.n_blind_before_wall), kernels.SURE),
        ):
            outer = surface_voxels(voxels[some], self._grid)
            self._draw(pixels[:, np.flatnonzero(some)[outer]], points[some][outer], bit)

    def _draw_shadow(self, is_dark: Sequence[bool]) -> None:
        """Draw for each camera what the others say is a shadow on the floor.  is_dark : cameras that see any shadow."""
        dark = np.zeros(len(self._floor), dtype=np.int64)
        for c, (pixels, picture) in enumerate(zip(self._floor_pixels, self._flat, strict=True)):
            if is_dark[c]:
                kernels.mark_shadows(pixels, picture, 1 << c, dark)
        places, lying = np.empty(len(self._floor), dtype=np.int64), np.empty_like(self._floor_pixels)
        n = kernels.lying_shadows(self._floor_pixels, self._bits, self._start, dark, places, lying)
        self._draw(lying[:, :n], self._floor[places[:n]], kernels.LYING)

    def _draw(self, pixels: NDArray[np.int32], points: Array, bit: np.uint8) -> None:
        """Draw voxels around points (N, 3) m as each camera sees them.  pixels : (C, N) of the points."""
        for c, picture in enumerate(self._pictures):
            kernels.draw_cubes(
                np.ascontiguousarray(pixels[c]),
                points,
                self._axes[c],
                self._half_at_1m[c],
                bit,
                picture,
                self._boxes[c],
            )


class _Feet:
    """What the other cameras see of the floor behind a camera's pixels, and of the places just above it.

    It does not change, so it is kept of every pixel that was asked for, up to a number.
    """

    def __init__(self, rig: CameraRig, grid: VoxelGrid, c: int) -> None:
        self._rig, self._grid, self._c = rig, grid, c
        self._row = np.full(rig[c].size[0] * rig[c].size[1], -1, dtype=np.int32)
        self._seen = np.empty((_MOST_KEPT, 1 + len(_FEET_M), len(rig)), dtype=np.int32)
        self._n_kept = 0

    def seen_by_others(self, pixels: Pixels) -> tuple[Pixels, Pixels]:
        """Rows (N,) of flat pixels, and for each row the pixels (K, C) of others that see the floor there and the K - 1
        places above; -1 = none does, as where a pixel shows no floor.
        """
        new = pixels[self._row[pixels] < 0]
        if self._n_kept + len(new) > len(self._seen):
            self._row[:] = -1
            self._n_kept, new = 0, pixels
            if len(new) > len(self._seen):
                self._seen = np.empty((len(new), *self._seen.shape[1:]), dtype=np.int32)
        if len(new):
            rows = slice(self._n_kept, self._n_kept + len(new))
            self._row[new] = np.arange(rows.start, rows.stop)
            self._n_kept = rows.stop
            self._seen[rows] = -1
            shown, floor = floor_behind(self._rig[self._c], self._grid, new.astype(np.int64))
            eye = self._rig[self._c].center
            places = np.concatenate([floor + height / eye[2] * (eye - floor) for height in (0.0, *_FEET_M)])
            seen = pixels_in_all(self._rig, places).reshape(len(self._rig), 1 + len(_FEET_M), len(floor))
            seen[self._c] = -1
            self._seen[self._row[shown]] = seen.transpose(2, 1, 0)
        return self._row[pixels], self._seen


def _box_of(mask: Mask, shadow: Mask) -> tuple[int, int, int, int]:
    """u0, u1, v0, v1, inclusive, of what either holds; 0, -1, 0, -1 for nothing."""
    u, v, w, h = cv2.boundingRect((mask | shadow).view(np.uint8))
    return u, u + w - 1, v, v + h - 1


def _floor_of(grid: VoxelGrid) -> Array:
    """Points of the floor z = 0 under the grid, (N, 3) m, a voxel's side apart."""
    nx, ny, _ = grid.shape
    columns = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"), axis=-1).reshape(-1, 2)
    xy = grid.origin[:2] + (columns + 0.5) * grid.voxel_size_m
    return np.column_stack([xy, np.zeros(len(xy))])
