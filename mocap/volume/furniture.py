"""What stands in an empty room, told by the floor: nothing stands on the way to a place of the floor that is seen.

Cameras that see a place of the floor bare agree about its colour. Where a camera shows another colour there, something
stands in its way; where three do, and none sees bare floor through it, it stands. Nobody has to walk behind it first,
as `OccluderLearner` wants. It is space carving, in which the floor carves: Kutulakos and Seitz, "A theory of shape by
space carving" (2000).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import largest_channel
from mocap.data import CameraRig, VoxelGrid
from mocap.volume.carve import pixels_in_all
from mocap.volume.components import connected_components
from mocap.volume.floor import Floor, FloorPlaces
from mocap.volume.occluders import VOXEL_M
from mocap.volume.residuals import silhouette
from mocap.volume.surface import surface_voxels

Array = NDArray[np.float64]
Colours = NDArray[np.uint8]

# Room beside the grid whose floor is asked too: over a table at its edge cameras look at the floor behind.
_AROUND_M = 1.5
_PLACE_M = 0.04  # of the floor
# That see something else than floor: rays of two cross beside things, and clouds hang there (`dev:furnished`).
_LEAST_CAMERAS = 3
_LEAST_HEIGHT_M = 0.05  # a carpet hides nobody
# Of a thing: a chair has 20. Beside walls three cameras see skirting boards for things, of up to 6.5 litres in 76 sets
# of four and five cameras of rooms without furniture, and once 11.
_LEAST_LITRES = 8.0
# Levels by which a thing may differ from row to row, shade and grain and all; walls differ from wood by 40 and more. Of
# five sets of four cameras before columns and cupboards 8, 10, 12 and 20 find 2.35, 2.46, 2.52 and 2.71 m3 above what
# the floor tells, and 0.31, 0.39, 0.45 and 0.83 m3 beside it (decision 136).
_SAME_LOOK = 10
# Of the look, from row to row: 0.5 finds 2.51 m3 above in those sets and 0.48 beside, 0.8 2.46 and 0.39, 0.95 1.89 and
# 0.30.
_KEPT = 0.8
_GAP_PX = 3  # of what is not floor: pixels in it have the floor's colour by chance
_UNKNOWN, _BARE, _OTHER = 0, 1, 2


def things_on_floor(rig: CameraRig, grid: VoxelGrid, empty: Sequence[Colours]) -> Array:
    """Centres (N, 3) m of the cubes of VOXEL_M in which something stands, N = 0 for none.

    rig : cameras of the pictures' size.  grid : where persons may be.  empty : (H, W, 4) uint8 RGBA per camera, what it
    shows while nobody is there; alpha 0 where that is not known.
    Only what has another colour than the floor behind it is found, and what goes on straight above that in the same
    colour; nothing of what is seen against walls alone. Of few cameras the hull of a thing is larger than it is.
    """
    around = np.array([_AROUND_M, _AROUND_M, 0.0])
    room = VoxelGrid.from_bounds(grid.origin - around, grid.upper + around, VOXEL_M)
    pictures = [picture[..., :3] for picture in empty]
    known = [picture[..., 3] > 0 for picture in empty]
    places = FloorPlaces(rig, room, place_m=_PLACE_M)
    floor = Floor(places, [picture[None] for picture in pictures], [[mask] for mask in known])
    shown = [_shown(*pair, *floor.behind(c)) for c, pair in enumerate(zip(pictures, known, strict=True))]

    space = VoxelGrid.from_bounds(grid.origin, grid.upper, VOXEL_M)
    voxels = np.arange(space.n_voxels, dtype=np.int32)
    centers = space.centers(voxels)
    is_high = centers[:, 2] > _LEAST_HEIGHT_M
    voxels, centers = voxels[is_high], centers[is_high]
    n_other, is_bare = np.zeros(len(voxels), dtype=np.int64), np.zeros(len(voxels), dtype=np.bool_)
    for own, pixels in zip(shown, pixels_in_all(rig, centers), strict=True):
        seen = np.where(pixels >= 0, own.ravel()[pixels], _UNKNOWN)
        n_other += seen == _OTHER
        is_bare |= seen == _BARE
    things = voxels[(n_other >= _LEAST_CAMERAS) & ~is_bare]
    labels, n = connected_components(things, space)
    litres = np.bincount(labels, minlength=n) * VOXEL_M**3 * 1000.0
    things = things[(litres >= _LEAST_LITRES)[labels]]
    higher = _higher(rig, space, things, list(zip(pictures, known, shown, strict=True)))
    return space.centers(np.union1d(things, higher).astype(np.int32))


def _higher(
    rig: CameraRig,
    space: VoxelGrid,
    things: NDArray[np.int32],
    views: Sequence[tuple[Colours, NDArray[np.bool_], Colours]],
) -> NDArray[np.int32]:
    """Voxels straight above things in which three cameras see the same thing go on, and none that looks there anything
    else: a column is seen against the floor below, and against walls above.

    views : per camera its picture, where that is known, and what it shows, as of `_shown`.
    """
    is_thing = space.dense(things)
    n_high = is_thing.shape[2]
    top = n_high - is_thing[:, :, ::-1].argmax(axis=2)
    is_above = is_thing.any(axis=2, keepdims=True) & (np.arange(n_high) >= top[:, :, None])
    voxels = np.flatnonzero(is_above.ravel()).astype(np.int32)
    if not len(voxels):
        return voxels
    outside = space.centers(things[surface_voxels(things, space)])
    n_same, is_refuted = np.zeros(len(voxels), dtype=np.int64), np.zeros(len(voxels), dtype=np.bool_)
    rows = pixels_in_all(rig, space.centers(voxels))
    for camera, pixels, (picture, known, shown) in zip(rig, rows, views, strict=True):
        is_else = shown == _OTHER
        thing = silhouette(camera, outside, VOXEL_M) & is_else
        same = (is_else | _going_on(picture, thing, known & (shown != _BARE))).ravel()[pixels]
        is_seen = (pixels >= 0) & known.ravel()[pixels]
        n_same += is_seen & same
        is_refuted |= is_seen & ~same
    return voxels[(n_same >= _LEAST_CAMERAS) & ~is_refuted]


def _going_on(picture: Colours, thing: NDArray[np.bool_], free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A thing (H, W) in a picture with what is above it and looks like what is below, row by row.  free : where it can
    go on."""
    soft = cv2.blur(picture, (3, 3)).astype(np.float32)
    same = thing.copy()
    look = np.where(thing[..., None], soft, np.inf)  # of what goes on: an edge is not climbed step by step
    columns = np.arange(picture.shape[1])
    for v in range(len(picture) - 2, -1, -1):
        beside = np.pad(look[v + 1], ((1, 1), (0, 0)), constant_values=np.inf)  # edges lean in a picture
        below = np.stack([beside[i : i + len(columns)] for i in range(3)])
        off = largest_channel(np.abs(below - soft[v]))
        nearest = off.argmin(axis=0)
        goes_on = free[v] & ~thing[v] & (off.min(axis=0) < _SAME_LOOK)
        same[v] |= goes_on
        look[v, goes_on] = (_KEPT * below[nearest, columns] + (1 - _KEPT) * soft[v])[goes_on]
    return same


def _shown(
    picture: Colours, known: NDArray[np.bool_], floor: NDArray[np.float32], limit: NDArray[np.float32]
) -> Colours:
    """Whether each pixel (H, W) of a picture shows bare floor or something else; unknown where it cannot be told.

    floor, limit : as of `Floor.behind`.
    """
    differs = largest_channel(np.abs(cv2.blur(picture, (3, 3)) - floor)) > limit
    differs = (
        cv2.morphologyEx(differs.view(np.uint8), cv2.MORPH_CLOSE, np.ones((_GAP_PX, _GAP_PX), np.uint8)) > 0
    )
    return np.where(known & (limit >= 0), np.where(differs, _OTHER, _BARE), _UNKNOWN).astype(np.uint8)
