"""The second look by its definition, in numpy and OpenCV: the twin of its kernels."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from mocap.data import Camera, CameraRig, VoxelGrid
from mocap.volume.carve import carve_bruteforce, pixels_of_points
from mocap.volume.floor import floor_behind
from mocap.volume.residuals import squares
from mocap.volume.surface import surface_voxels

Array = np.ndarray
Masks = Sequence[np.ndarray]

BLIND, FLOOR_M, FEET_M, MISSING, BARE, LEAST_OTHERS = 1, 0.06, (0.04, 0.06, 0.08), 2, 1, 4
MOSTLY, AROUND_PX, REMAINS_PX = 0.7, 15, 5
GREY_CLOSING_PX = 3  # 9 in a picture 640 pixels wide; these are 240


class LookByDefinition:
    """What `SecondLook` does."""

    def __init__(self, rig: CameraRig, grid: VoxelGrid, *, are_grey: bool = False) -> None:
        self._rig, self._grid = rig, grid
        n = len(rig)
        self._n_blind, self._n_against, self._n_before_wall, self._closing_px = (
            ((n - 1) // 3, n - 2, max(0, n - 5), GREY_CLOSING_PX) if are_grey else (BLIND, (n - 1) // 2, 0, 0)
        )
        floor = _floor_of(grid)
        self._floor = [_Places(camera, floor, pixels_of_points(camera, floor)) for camera in rig]
        self._before_floor = [places.drawn(grid.voxel_size_m) for places in self._floor]

    def masks(self, masks: Masks, shadows: Masks, doubtful: Masks) -> list[Array]:
        person, volume = self._drawn_person(masks, shadows)
        floor = self._drawn_shadow(masks, shadows)
        whole = [
            mask | _mostly(shadow & there & ~lying, shadow)
            for mask, shadow, there, lying in zip(masks, shadows, person, floor, strict=True)
        ]
        seen = [mask | shadow for mask, shadow in zip(whole, shadows, strict=True)]
        clean = [
            mask & ~self._contact_shadow(c, whole, seen, mask & doubt & ~there)
            for c, (mask, doubt, there) in enumerate(zip(whole, doubtful, person, strict=True))
        ]
        if self._closing_px == 0:
            return clean
        square = np.ones((self._closing_px,) * 2, np.uint8)
        return [
            mask | (there & (cv2.morphologyEx(mask.view(np.uint8), cv2.MORPH_CLOSE, square) > 0))
            for mask, there in zip(clean, volume, strict=True)
        ]

    def _contact_shadow(self, c: int, masks: Masks, seen: Masks, asked: Array) -> Array:
        """Which of the asked pixels (H, W) of a camera show the floor at somebody's feet, as the others see it.

        seen : (H, W) bool per camera, mask or shadow.
        """
        pixels, floor = floor_behind(self._rig[c], self._grid, np.flatnonzero(asked))
        n_bare, n_others = self._votes_against(c, floor, seen)
        shows = (n_bare <= BARE) & (n_others >= LEAST_OTHERS)
        pixels, floor = pixels[shows], floor[shows]
        for height in FEET_M:
            eye = self._rig[c].center
            above = floor + height / eye[2] * (eye - floor)
            is_empty = self._votes_against(c, above, masks)[0] > MISSING
            pixels, floor = pixels[is_empty], floor[is_empty]
        out = np.zeros_like(asked)
        out.ravel()[pixels] = True
        return _with_remains(out, masks[c])

    def _votes_against(self, c: int, points: Array, masks: Masks) -> tuple[Array, Array]:
        """Numbers (N,) of other cameras that see a point (N, 3) m outside their mask, and that see it at all."""
        n_against, n_seeing = np.zeros((2, len(points)), dtype=np.int64)
        for k, (camera, mask) in enumerate(zip(self._rig, masks, strict=True)):
            if k != c:
                pixels = pixels_of_points(camera, points)
                n_seeing += pixels >= 0
                n_against += (pixels >= 0) & ~mask.ravel()[pixels]
        return n_against, n_seeing

    def _drawn_person(self, masks: Masks, shadows: Masks) -> tuple[list[Array], list[Array]]:
        """Where each camera would see the volume that can be nothing but a person, and that volume with its rim."""
        either = [mask | shadow for mask, shadow in zip(masks, shadows, strict=True)]
        voxels = carve_bruteforce(self._rig, self._grid, either, n_faulty_views=self._n_blind)
        pixels = np.column_stack([pixels_of_points(c, self._grid.centers(voxels)) for c in self._rig])
        against = np.zeros(len(voxels), dtype=np.int64)
        for c, mask in enumerate(masks):
            against += (pixels[:, c] >= 0) & ~mask.ravel()[pixels[:, c]]
        high = self._grid.centers(voxels)[:, 2] > FLOOR_M
        keep = high & (against <= self._n_against)
        voxels, pixels = voxels[keep], pixels[keep]
        # Before a wall nobody says whether a shadow lies there.
        clear = np.zeros(len(voxels), dtype=np.int64)
        for c, mask in enumerate(either):
            clear += (pixels[:, c] >= 0) & ~mask.ravel()[pixels[:, c]]
        agreed = clear <= self._n_before_wall
        volume, sure = self._drawn(voxels, pixels), self._drawn(voxels[agreed], pixels[agreed])
        return [
            _without_rim(some) & (floor | _without_rim(all_agree))
            for some, floor, all_agree in zip(volume, self._before_floor, sure, strict=True)
        ], volume

    def _drawn(self, voxels: Array, pixels: Array) -> list[Array]:
        """A volume as each camera would see it.  pixels : (N, C) of its voxels."""
        outer = surface_voxels(voxels, self._grid)
        points, pixels = self._grid.centers(voxels[outer]), pixels[outer]
        return [
            _Places(camera, points, pixels[:, c]).drawn(self._grid.voxel_size_m)
            for c, camera in enumerate(self._rig)
        ]

    def _drawn_shadow(self, masks: Masks, shadows: Masks) -> list[Array]:
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

    def __init__(self, camera: Camera, points: Array, pixels: Array) -> None:
        self.camera, self.pixels = camera, pixels
        self._depth = points @ camera.R[2] + camera.t[2]

    def drawn(self, side_m: float, chosen: Array | slice = slice(None)) -> Array:
        """Cubes of that side about the chosen points, (H, W) bool."""
        pixels, depth = self.pixels[chosen], self._depth[chosen]
        v, u = np.divmod(pixels[pixels >= 0], self.camera.size[0])
        uv = np.column_stack([u, v]).astype(np.float64)
        return squares(self.camera, uv, depth[pixels >= 0], side_m)


def _without_rim(drawn: Array) -> Array:
    disc = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
    return cv2.erode(drawn.view(np.uint8), disc).view(np.bool_)


def _floor_of(grid: VoxelGrid) -> Array:
    """Points of the floor z = 0 under the grid, (N, 3) m, a voxel's side apart."""
    nx, ny, _ = grid.shape
    columns = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"), axis=-1).reshape(-1, 2)
    xy = grid.origin[:2] + (columns + 0.5) * grid.voxel_size_m
    return np.column_stack([xy, np.zeros(len(xy))])


def _mostly(found: Array, shadow: Array) -> Array:
    """The part of what was found that is most of the shadow about it."""
    out = np.zeros_like(found)
    window, some, whole = _about(found, shadow, AROUND_PX)
    out[window] = found[window] & (some >= MOSTLY * whole)
    return out


def _with_remains(gone: Array, mask: Array) -> Array:
    """What goes of a mask, with what would be left of it between: where more than half of it goes, all does."""
    out = gone.copy()
    window, some, whole = _about(gone, mask, REMAINS_PX)
    out[window] |= mask[window] & (2 * some > whole)
    return out


def _about(found: Array, whole: Array, side_px: int) -> tuple[tuple[slice, slice], Array, Array]:
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
