"""Pixels of people: a sample of the silhouettes with its colours, and the rays through it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data.camera import Camera, CameraRig
from mocap.likelihood._outline_kernels import are_near, pixels_of_points
from mocap.likelihood.appearance import PixelRays, colour_bins_of_pixels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_PIXELS_ACROSS = 80  # lattice points over a picture's width
_MOST_RAYS = 1600


@dataclass(frozen=True, eq=False)
class SilhouettePixels:
    """A sample of the foreground of all cameras in one frame.

    camera : (M,) uint8 index.  uv : (M, 2) int16, column and row.  rgb : (M, 3) uint8.
    """

    camera: NDArray[np.uint8]
    uv: NDArray[np.int16]
    rgb: NDArray[np.uint8]


def lattice_step(width: int) -> int:
    """Pixels between the points of a camera's sampling lattice."""
    return max(1, round(width / _PIXELS_ACROSS))


def sample_silhouettes(
    masks: Sequence[Mask],
    pictures: Sequence[NDArray[np.uint8]] | None,
    used: Sequence[bool] | NDArray[np.bool_] | None = None,
) -> SilhouettePixels:
    """Foreground pixels on a lattice, with the mean colour of the 3 x 3 pixels around them.

    masks : (H, W) bool per camera.  pictures : (H, W, 3) uint8 RGB per camera; None gives no pixels.  used : (C,),
    cameras to take; None = all.
    """
    cameras, places, colours = [], [], []
    for c, mask in enumerate(masks):
        if pictures is None or (used is not None and not used[c]):
            continue
        step = lattice_step(mask.shape[1])
        first = max(1, step // 2)
        row, col = np.nonzero(mask[first:-1:step, first:-1:step])
        row, col = first + step * row, first + step * col
        around = [pictures[c][row + dv, col + du].astype(np.uint16) for dv in (-1, 0, 1) for du in (-1, 0, 1)]
        cameras.append(np.full(len(row), c, dtype=np.uint8))
        places.append(np.column_stack([col, row]).astype(np.int16))
        colours.append((np.sum(around, axis=0) // 9).astype(np.uint8))
    return SilhouettePixels(
        np.concatenate([*cameras, np.zeros(0, dtype=np.uint8)]),
        np.concatenate([*places, np.zeros((0, 2), dtype=np.int16)]),
        np.concatenate([*colours, np.zeros((0, 3), dtype=np.uint8)]),
    )


def person_rays(
    rig: CameraRig,
    pixels: SilhouettePixels,
    hull_points: Array,
    other_points: Array | None = None,
) -> PixelRays:
    """Rays through those pixels that show one person.

    hull_points : (N, 3) m, surface of the person's hull: only pixels near its projection count.  other_points : (K, 3)
    m, hulls of the other persons: pixels near theirs do not, for who stands in front is not known here.
    """
    cameras: list[NDArray[np.int64]] = []
    directions: list[Array] = []
    colours: list[NDArray[np.uint8]] = []
    for c, camera in enumerate(rig):
        own = pixels.camera == c
        if not own.any():
            continue
        width, height = camera.size
        reach = lattice_step(width)
        ray = camera.rays(pixels.uv[own].astype(np.float64))
        rgb = pixels.rgb[own]
        # Compared where a camera without distortion would see hull and pixels.
        ideal = ray @ camera.R.T @ camera.K.T
        cell = np.rint(ideal[:, :2] / ideal[:, 2:]).astype(np.int64)
        corner, shape = np.zeros(2, dtype=np.int64), (height, width)
        keep = are_near(cell, _seen_at(camera, hull_points), corner, shape, reach)
        if other_points is not None and len(other_points):
            keep &= ~are_near(cell, _seen_at(camera, other_points), corner, shape, reach)
        cameras.append(np.full(int(keep.sum()), c, dtype=np.int64))
        directions.append(ray[keep])
        colours.append(rgb[keep])
    rays = PixelRays(
        np.array([camera.center for camera in rig]),
        np.concatenate([*cameras, np.zeros(0, dtype=np.int64)]),
        np.concatenate([*directions, np.zeros((0, 3))]),
        colour_bins_of_pixels(np.concatenate([*colours, np.zeros((0, 3), dtype=np.uint8)])),
    )
    return rays.every(-(-len(rays) // _MOST_RAYS))


def _seen_at(camera: Camera, points: Array) -> NDArray[np.int64]:
    return pixels_of_points(points, camera.R, camera.t, camera.K, *camera.size)
