"""Colours of voxels: which cameras see a voxel, and the colour they give it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig, Hull, VoxelGrid
from mocap.volume import _kernels
from mocap.volume.carve import pixels_in_all
from mocap.volume.surface import check_voxels

Voxels = NDArray[np.int32]
Image = NDArray[np.uint8]
Visibility = Literal["line", "zbuffer"]

# Voxels this close (Chebyshev) to the start of a line of sight never block it.
SKIP_VOXELS = 1
# The depth buffer: side of the square that a voxel covers, how far behind the nearest voxel another still counts as
# seen, both in voxels, and picture pixels per cell. Where the agreement with the line walk was best.
SPLAT_VOXELS = 1.2
DEPTH_TOLERANCE_VOXELS = 1.5
SHRINK = 2


def visible_views(
    voxels: Voxels,
    is_surface: NDArray[np.bool_],
    grid: VoxelGrid,
    rig: CameraRig,
    visibility: Visibility = "line",
) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
    """Cameras with direct vision of each voxel, and the pixel where they see it.

    voxels : (N,) int32 ascending, all occupied voxels of the frame (they block).  is_surface : (N,) bool.
    visibility : "line" walks from the voxel to the optical centre; "zbuffer" draws the surface voxels as squares
    into a depth buffer per camera and asks which lie nearest.
    Returns visible (N, C) bool, false for voxels that are not on the surface or not in a camera's picture,
    and pixels (N, C) int32, flat index v * width + u, -1 where the voxel is not on the surface or not in the
    picture.
    Source: CF 2.2.4 (line from the voxel to the optical centre, all elements empty).
    Departs from it: the 26 neighbours of the voxel do not block (on a surface seen at a grazing angle the
    neighbour would nearly always), the line is the exact voxel traversal instead of Bresenham's, and it ends
    at the bounding box of all occupied voxels, behind which nothing can block.
    """
    outer, outer_visible, outer_pixels = _surface_views(voxels, is_surface, grid, rig, visibility)
    visible = np.zeros((len(voxels), len(rig)), dtype=np.bool_)
    pixels = np.full((len(voxels), len(rig)), -1, dtype=np.int32)
    visible[outer] = outer_visible
    pixels[outer] = outer_pixels
    return visible, pixels


def _surface_views(
    voxels: Voxels, is_surface: NDArray[np.bool_], grid: VoxelGrid, rig: CameraRig, visibility: Visibility
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int32]]:
    """Positions (S,) of the surface voxels in the list, their visibility (S, C) and pixels (S, C)."""
    if visibility not in ("line", "zbuffer"):
        raise ValueError(f"visibility: expected line or zbuffer, got {visibility!r}")
    v = check_voxels(voxels, grid)
    outer = np.flatnonzero(is_surface)
    visible = np.zeros((len(outer), len(rig)), dtype=np.bool_, order="F")
    if len(outer) == 0:
        return outer, visible, np.empty((0, len(rig)), dtype=np.int32, order="F")
    subs, lower, upper = _kernels.subscripts_and_bounds(v, grid.shape[1], grid.shape[2])
    outer_subs = subs[outer]
    centers = grid.origin + (outer_subs + 0.5) * grid.voxel_size_m
    pixels = pixels_in_all(rig, centers).T
    if visibility == "line":
        crop = np.full(tuple(upper - lower + 2), 2, dtype=np.uint8)
        crop[1:-1, 1:-1, 1:-1] = 0
        _kernels.fill_crop(subs, lower - 1, crop)
        eyes = (np.array([camera.center for camera in rig]) - grid.origin) / grid.voxel_size_m
        _kernels.line_of_sight(outer_subs, pixels, crop, lower - 1, eyes, SKIP_VOXELS, visible)
        return outer, visible, pixels
    for c, camera in enumerate(rig):
        width, height = camera.size
        buffer = np.full((-(-height // SHRINK), -(-width // SHRINK)), np.inf, dtype=np.float32)
        half_at_1m = 0.5 * SPLAT_VOXELS * grid.voxel_size_m * max(camera.K[0, 0], camera.K[1, 1])
        depth = centers @ camera.R[2] + camera.t[2]
        tolerance = DEPTH_TOLERANCE_VOXELS * grid.voxel_size_m
        _kernels.nearest_in_picture(
            pixels[:, c], depth, width, half_at_1m, SHRINK, tolerance, buffer, visible[:, c]
        )
    return outer, visible, pixels


def colour_hull(
    voxels: Voxels,
    is_surface: NDArray[np.bool_],
    grid: VoxelGrid,
    rig: CameraRig,
    images: Sequence[Image] | None,
    visibility: Visibility = "line",
) -> Hull:
    """Hull with the number of cameras that see each voxel and the mean colour in them.

    voxels : (N,) int32 ascending.  is_surface : (N,) bool.  images : one (H, W, 3) uint8 RGB per camera, or
    None. Without images rgb is zero. Interior voxels (n_views 0) have rgb zero; N = 0 gives an empty hull.
    visibility : as of visible_views.
    Raises ValueError for images that do not fit the rig.
    Source: CF 2.2.4 (voxel coloring).
    """
    if images is not None:
        expected = [(c.size[1], c.size[0], 3) for c in rig]
        got = [np.shape(image) for image in images]
        if got != expected or any(image.dtype != np.uint8 for image in images):
            raise ValueError(f"images: expected uint8 of shapes {expected}, got {got}")
    outer, visible, pixels = _surface_views(voxels, is_surface, grid, rig, visibility)
    sums = np.zeros((len(outer), 3), dtype=np.int32)
    count = np.zeros(len(outer), dtype=np.int32)
    for c in range(len(rig)):
        if images is None:
            count += visible[:, c]
        else:
            # A read-only array would make the compiler build the kernel a second time.
            flat = np.require(images[c], np.uint8, ("C", "W")).reshape(-1, 3)
            _kernels.add_colours(flat, pixels[:, c], visible[:, c], sums, count)
    n_views = np.zeros(len(voxels), dtype=np.uint8)
    n_views[outer] = count
    rgb = np.zeros((len(voxels), 3), dtype=np.uint8)
    divisor = np.maximum(count, 1)[:, None]
    rgb[outer] = (sums + divisor // 2) // divisor
    return Hull(grid, np.ascontiguousarray(voxels, dtype=np.int32), np.asarray(is_surface), n_views, rgb)
