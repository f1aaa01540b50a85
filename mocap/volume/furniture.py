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
_GAP_PX = 3  # of what is not floor: pixels in it have the floor's colour by chance
_UNKNOWN, _BARE, _OTHER = 0, 1, 2


def things_on_floor(rig: CameraRig, grid: VoxelGrid, empty: Sequence[Colours]) -> Array:
    """Centres (N, 3) m of the cubes of VOXEL_M in which something stands, N = 0 for none.

    rig : cameras of the pictures' size.  grid : where persons may be.  empty : (H, W, 4) uint8 RGBA per camera, what it
    shows while nobody is there; alpha 0 where that is not known.
    Only what has another colour than the floor behind it is found, and nothing of what is seen against walls alone. Of
    few cameras the hull of a thing is larger than it is.
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
    return space.centers(things[(litres >= _LEAST_LITRES)[labels]])


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
