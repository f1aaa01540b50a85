"""A second look at masks, all cameras together: what was taken for a shadow and is a person, and the other way round.

Dark trousers before a dark floor have the colour of the floor in shadow, and one picture cannot tell them apart. The
other cameras can: a shadow lies on a surface that they see unoccupied, and they see it as dark as this one does. At
somebody's feet the floor is as dark as a person: there the others see nobody just above it.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig, VoxelGrid
from mocap.volume.carve import Carver, pixels_of_points
from mocap.volume.floor import floor_behind
from mocap.volume.residuals import squares
from mocap.volume.surface import surface_voxels

Mask = NDArray[np.bool_]
Array = NDArray[np.float64]
Voxels = NDArray[np.int32]

# With five cameras hulls that forgive two of them are so fat that shadows fall inside (room: IoU 0.952 to 0.948).
LEAST_CAMERAS = 6
_BLIND = 1  # cameras that may see nothing at all where a person is: a table stands before them
_FLOOR_M = 0.06  # what lies lower is not told from a shadow on the floor
_RIM_PX = 1  # of the drawn volume, which is up to a voxel too wide
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


class SecondLook:
    """The cameras of a rig on one grid, asked which shadows are none.

    Not to be shared between threads. Raises ValueError for fewer than LEAST_CAMERAS cameras.
    """

    def __init__(self, rig: CameraRig, grid: VoxelGrid) -> None:
        if len(rig) < LEAST_CAMERAS:
            raise ValueError(f"rig: expected at least {LEAST_CAMERAS} cameras, got {len(rig)}")
        self._rig, self._grid = rig, grid
        self._carver = Carver(rig, grid)
        floor = _floor_of(grid)
        self._floor = [_Places(camera, floor, pixels_of_points(camera, floor)) for camera in rig]
        self._before_floor = [places.drawn(grid.voxel_size_m) for places in self._floor]

    def masks(self, masks: Sequence[Mask], shadows: Sequence[Mask], doubtful: Sequence[Mask]) -> list[Mask]:
        """The masks of one instant, with what turned out to be no shadow, and without what turned out to be one.

        masks, shadows : (H, W) bool per camera, apart from each other. A shadow becomes foreground inside the volume
        that all cameras but one see as person or shadow, and more than half as person; before a wall, where no floor
        tells, that all see so. Not where it lies on the floor, which is so where as many other cameras see shadow as
        see the empty floor.

        doubtful : (H, W) bool per camera, what of the mask has a shadow's darkness and colour. It goes where it shows
        the floor at somebody's feet: outside that volume, where more than two of the others see nobody from 4 cm
        above the floor on, and no more than one sees the floor bare.
        """
        person = self._drawn_person(masks, shadows)
        floor = self._drawn_shadow(masks, shadows)
        whole = [
            mask | _mostly(shadow & there & ~lying, shadow)
            for mask, shadow, there, lying in zip(masks, shadows, person, floor, strict=True)
        ]
        seen = [mask | shadow for mask, shadow in zip(whole, shadows, strict=True)]
        return [
            mask & ~self._contact_shadow(c, whole, seen, mask & doubt & ~there)
            for c, (mask, doubt, there) in enumerate(zip(whole, doubtful, person, strict=True))
        ]

    def _contact_shadow(self, c: int, masks: Sequence[Mask], seen: Sequence[Mask], asked: Mask) -> Mask:
        """Which of the asked pixels (H, W) of a camera show the floor at somebody's feet, as the others see it.

        seen : (H, W) bool per camera, mask or shadow.
        """
        pixels, floor = floor_behind(self._rig[c], self._grid, np.flatnonzero(asked))
        n_bare, n_others = self._votes_against(c, floor, seen)
        shows = (n_bare <= _BARE) & (n_others >= _LEAST_OTHERS)
        pixels, floor = pixels[shows], floor[shows]
        for height in _FEET_M:
            eye = self._rig[c].center
            above = floor + height / eye[2] * (eye - floor)
            is_empty = self._votes_against(c, above, masks)[0] > _MISSING
            pixels, floor = pixels[is_empty], floor[is_empty]
        out = np.zeros_like(asked)
        out.ravel()[pixels] = True
        return _with_remains(out, masks[c])

    def _votes_against(
        self, c: int, points: Array, masks: Sequence[Mask]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Numbers (N,) of other cameras that see a point (N, 3) m outside their mask, and that see it at all."""
        n_against, n_seeing = np.zeros((2, len(points)), dtype=np.int64)
        for k, (camera, mask) in enumerate(zip(self._rig, masks, strict=True)):
            if k != c:
                pixels = pixels_of_points(camera, points)
                n_seeing += pixels >= 0
                n_against += (pixels >= 0) & ~mask.ravel()[pixels]
        return n_against, n_seeing

    def _drawn_person(self, masks: Sequence[Mask], shadows: Sequence[Mask]) -> list[Mask]:
        """Where each camera would see the volume that can be nothing but a person."""
        either = [mask | shadow for mask, shadow in zip(masks, shadows, strict=True)]
        voxels = self._carver.carve(either, n_faulty_views=_BLIND)
        pixels = self._carver.pixels(voxels)
        against = np.zeros(len(voxels), dtype=np.int64)
        for c, mask in enumerate(masks):
            against += (pixels[:, c] >= 0) & ~mask.ravel()[pixels[:, c]]
        high = self._grid.centers(voxels)[:, 2] > _FLOOR_M
        keep = high & (against <= (len(masks) - 1) // 2)
        voxels, pixels = voxels[keep], pixels[keep]
        # Before a wall nobody says whether a shadow lies there: then no camera may speak against the person.
        clear = np.zeros(len(voxels), dtype=np.int64)
        for c, mask in enumerate(either):
            clear += (pixels[:, c] >= 0) & ~mask.ravel()[pixels[:, c]]
        sure = self._drawn(voxels[clear == 0], pixels[clear == 0])
        return [
            some & (floor | all_agree)
            for some, floor, all_agree in zip(
                self._drawn(voxels, pixels), self._before_floor, sure, strict=True
            )
        ]

    def _drawn(self, voxels: Voxels, pixels: NDArray[np.int32]) -> list[Mask]:
        """A volume as each camera would see it, without the rim.  pixels : (N, C) of its voxels."""
        outer = surface_voxels(voxels, self._grid)
        points, pixels = self._grid.centers(voxels[outer]), pixels[outer]
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _RIM_PX + 1,) * 2)
        drawn = []
        for c, camera in enumerate(self._rig):
            there = _Places(camera, points, pixels[:, c]).drawn(self._grid.voxel_size_m)
            drawn.append(cv2.erode(there.view(np.uint8), disc).view(np.bool_))
        return drawn

    def _drawn_shadow(self, masks: Sequence[Mask], shadows: Sequence[Mask]) -> list[Mask]:
        """Where each camera would see what the others say is a shadow on the floor."""
        dark = [
            (floor.pixels >= 0) & shadow.ravel()[floor.pixels]
            for shadow, floor in zip(shadows, self._floor, strict=True)
        ]
        some = np.flatnonzero(np.logical_or.reduce(dark))
        dark = [one[some] for one in dark]
        clear = [
            (floor.pixels[some] >= 0) & ~mask.ravel()[floor.pixels[some]] & ~one
            for mask, one, floor in zip(masks, dark, self._floor, strict=True)
        ]
        all_dark, all_clear = (np.sum(votes, axis=0, dtype=np.int64) for votes in (dark, clear))
        drawn = []
        for c, floor in enumerate(self._floor):
            n_dark = all_dark - dark[c]
            lies = (n_dark >= 1) & (n_dark >= all_clear - clear[c])
            drawn.append(floor.drawn(self._grid.voxel_size_m, some[lies]))
        return drawn


class _Places:
    """Points (N, 3) m as a camera sees them: their pixels, flat (N,) with -1 outside its picture, and depths."""

    def __init__(self, camera: Camera, points: Array, pixels: NDArray[np.int32]) -> None:
        self.camera, self.pixels = camera, pixels
        self._depth = points @ camera.R[2] + camera.t[2]

    def drawn(self, side_m: float, chosen: NDArray[np.int64] | slice = slice(None)) -> Mask:
        """Cubes of that side about the chosen points, (H, W) bool."""
        pixels, depth = self.pixels[chosen], self._depth[chosen]
        v, u = np.divmod(pixels[pixels >= 0], self.camera.size[0])
        uv = np.column_stack([u, v]).astype(np.float64)
        return squares(self.camera, uv, depth[pixels >= 0], side_m)


def _floor_of(grid: VoxelGrid) -> Array:
    """Points of the floor z = 0 under the grid, (N, 3) m, a voxel's side apart."""
    nx, ny, _ = grid.shape
    columns = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"), axis=-1).reshape(-1, 2)
    xy = grid.origin[:2] + (columns + 0.5) * grid.voxel_size_m
    return np.column_stack([xy, np.zeros(len(xy))])


def _mostly(found: Mask, shadow: Mask) -> Mask:
    """The part of what was found that is most of the shadow about it."""
    out = np.zeros_like(found)
    window, some, whole = _about(found, shadow, _AROUND_PX)
    out[window] = found[window] & (some >= _MOSTLY * whole)
    return out


def _with_remains(gone: Mask, mask: Mask) -> Mask:
    """What goes of a mask, with what would be left of it between: where more than half of it goes, all does."""
    out = gone.copy()
    window, some, whole = _about(gone, mask, _REMAINS_PX)
    out[window] |= mask[window] & (2 * some > whole)
    return out


def _about(
    found: Mask, whole: Mask, side_px: int
) -> tuple[tuple[slice, slice], NDArray[np.int16], NDArray[np.int16]]:
    """The window within reach of what was found, and the pixels of either mask in a square about each of its pixels."""
    x, y, w, h = cv2.boundingRect(found.view(np.uint8))
    half = side_px // 2 if w else 0
    window = slice(max(y - half, 0), y + h + half), slice(max(x - half, 0), x + w + half)
    if w == 0:
        return window, *np.zeros((2, 0, 0), dtype=np.int16)
    counts = (
        cv2.boxFilter(
            mask[window].view(np.uint8),
            cv2.CV_16S,
            (side_px, side_px),
            normalize=False,
            borderType=cv2.BORDER_CONSTANT,
        )
        for mask in (found, whole)
    )
    return window, *counts
