"""Rays through the pixels that show one person."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.data.camera import Camera, CameraRig
from mocap.data.pixels import SilhouettePixels, lattice_step
from mocap.geometry._pixel_kernels import are_near, pixels_of_points
from mocap.likelihood.colours.appearance import PixelRays

_MOST_RAYS = 1600


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
        np.concatenate([*colours, np.zeros((0, 3), dtype=np.uint8)]),
    )
    return rays.every(-(-len(rays) // _MOST_RAYS))


def _seen_at(camera: Camera, points: Array) -> NDArray[np.int64]:
    return pixels_of_points(points, camera.R, camera.t, camera.K, *camera.size)
