"""The empty floor as all cameras together know it: what a person hides of it from one, others see.

Shoes that stand in their place are background to every statistic over one camera's clip. But the floor behind them lies
open to cameras on the other side, which see its colours.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Mask
from mocap.data import Camera, CameraRig, VoxelGrid
from mocap.volume.carve import pixels_of_points

Array = NDArray[np.float64]
Colours = NDArray[np.float32]

_LEAST_HEIGHT_M = 0.08  # of a camera: from lower it sees the floor as a line
_PLACE_M = 0.02  # a pixel of 640 x 480 sees a centimetre of the floor
_LEAST_CAMERAS = 3  # that see a place of the floor empty: one of two is not outvoted
_USUAL_LEVELS = 15.0  # from which on a picture differs, where cameras agree
_DISAGREEMENTS = 4.0  # median differences between the cameras that a picture must differ by
_SOLE_M = 0.3  # what is farther from all that is known is not painted in
_MOST_LEVELS = 60.0  # a place about which cameras agree no better is not known: it shines


class FloorPlaces:
    """The places of the floor under a grid, and which of them each pixel of a rig's cameras shows.

    place_m : side of what has one colour.
    """

    def __init__(self, rig: CameraRig, grid: VoxelGrid, *, place_m: float = _PLACE_M) -> None:
        centers, self.shape = _places_of(grid, place_m)
        self.reach = round(_SOLE_M / place_m)
        self.pixels = [pixels_of_points(camera, centers) for camera in rig]
        self.of_pixels = [_places_in(camera, grid, self.shape, place_m) for camera in rig]


class Floor:
    """The colours of a floor, from pictures of all cameras.

    pictures : (K, H, W, 3) uint8 per camera, of K instants.  free : (H, W) bool for each camera and instant, where the
    picture may show the empty room.
    Every place has the median colour of the cameras that ever saw it free, each in its own light.
    """

    def __init__(
        self,
        places: FloorPlaces,
        pictures: Sequence[NDArray[np.uint8]],
        free: Sequence[Sequence[Mask]],
    ) -> None:
        shown = np.stack([_shown(*own) for own in zip(pictures, free, places.pixels, strict=True)])
        known = np.isfinite(shown[..., 0]).sum(axis=0) >= _LEAST_CAMERAS
        self._colour = np.zeros((shown.shape[1], 3), dtype=np.float32)
        self._limit = np.full(shown.shape[1], -1.0, dtype=np.float32)
        self._gains = np.ones((len(shown), 3), dtype=np.float32)
        if known.any():
            self._agree(known, shown[:, known])
            self._paint_in(places.shape, places.reach)
        self._places = places.of_pixels

    def _agree(self, known: NDArray[np.bool_], shown: Colours) -> None:
        """Light of the cameras, colours and limits of the known places (P,) from what is shown of them (C, N, 3)."""
        middle = np.nanmedian(shown, axis=0)
        for gain, own in zip(self._gains, shown, strict=True):
            sees = np.isfinite(own[:, 0])
            if sees.any():
                gain[:] = np.median((own[sees] + 1) / (middle[sees] + 1), axis=0)
        even = shown / self._gains[:, None]
        colour = np.nanmedian(even, axis=0)
        disagreement = np.nanmedian(np.abs(even - colour).max(axis=2), axis=0)
        limit = np.maximum(_USUAL_LEVELS, _DISAGREEMENTS * disagreement)
        self._colour[known] = colour
        self._limit[known] = np.where(limit <= _MOST_LEVELS, limit, -1.0)

    def _paint_in(self, shape: tuple[int, int], reach: int) -> None:
        """Colours of what lies under soles, from so many places around."""
        known = (self._limit >= 0).reshape(shape)
        near = cv2.dilate(known.astype(np.uint8), np.ones((2 * reach + 1,) * 2, np.uint8)) > 0
        picture = np.clip(np.round(self._colour), 0, 255).astype(np.uint8).reshape(*shape, 3)
        # Of all that is not known: what is farther away has no colour to lend.
        painted = cv2.inpaint(picture, (~known).astype(np.uint8), 3, cv2.INPAINT_TELEA)
        fill = (near & ~known).ravel()
        self._colour[fill] = painted.reshape(-1, 3)[fill]
        self._limit[fill] = _USUAL_LEVELS

    def behind(self, c: int) -> tuple[Colours, NDArray[np.float32]]:
        """What camera c would see of the bare floor, (H, W, 3), and by how much a picture differs from it, (H, W) grey
        levels; -1 where the floor is not known.
        """
        place = self._places[c]
        return (self._colour * self._gains[c])[place], np.where(
            place >= 0, self._limit[place], np.float32(-1)
        )


def floor_behind(
    camera: Camera, grid: VoxelGrid, pixels: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Array]:
    """Those of a camera's flat pixels that show the floor under a grid, and its points (N, 3) m there.

    A camera lower than people's feet are high shows none.
    """
    v, u = np.divmod(pixels, camera.size[0])
    rays = camera.rays(np.column_stack([u, v]).astype(np.float64))
    down = (rays[:, 2] < 0) & (camera.center[2] > _LEAST_HEIGHT_M)
    pixels, rays = pixels[down], rays[down]
    points = camera.center - camera.center[2] / rays[:, 2:] * rays
    columns = (points - grid.origin)[:, :2] / grid.voxel_size_m
    inside = ((columns >= 0) & (columns < grid.shape[:2])).all(axis=1)
    return pixels[inside], points[inside]


def _places_of(grid: VoxelGrid, place_m: float) -> tuple[Array, tuple[int, int]]:
    """Places (N, 3) m of the floor under a grid, and how many there are along x and y."""
    extent = (grid.upper - grid.origin)[:2]
    n_x, n_y = (int(np.ceil(length / place_m - 1e-6)) for length in extent)
    x, y = np.meshgrid(np.arange(n_x) + 0.5, np.arange(n_y) + 0.5, indexing="ij")
    xy = grid.origin[:2] + place_m * np.column_stack([x.ravel(), y.ravel()])
    return np.column_stack([xy, np.zeros(len(xy))]), (n_x, n_y)


def _shown(pictures: NDArray[np.uint8], free: Sequence[Mask], pixels: NDArray[np.int32]) -> Colours:
    """Median colour (N, 3) at pixels (N,), -1 = outside, of the pictures (K, H, W, 3) that are free there; else NaN."""
    soft = np.stack([cv2.blur(picture, (3, 3)).reshape(-1, 3)[pixels] for picture in pictures])
    is_free = np.stack([mask.ravel()[pixels] for mask in free]) & (pixels >= 0)
    ever = is_free.any(axis=0)
    out = np.full((len(pixels), 3), np.nan, dtype=np.float32)
    out[ever] = np.nanmedian(
        np.where(is_free[:, ever, None], soft[:, ever].astype(np.float32), np.nan), axis=0
    )
    return out


def _places_in(camera: Camera, grid: VoxelGrid, shape: tuple[int, int], place_m: float) -> NDArray[np.int32]:
    """The place of the floor that each pixel shows, (H, W); -1 where it shows none."""
    width, height = camera.size
    pixels, points = floor_behind(camera, grid, np.arange(width * height))
    at = np.minimum(((points - grid.origin)[:, :2] / place_m).astype(np.int64), np.array(shape) - 1)
    out = np.full(width * height, -1, dtype=np.int32)
    out[pixels] = at[:, 0] * shape[1] + at[:, 1]
    return out.reshape(height, width)
