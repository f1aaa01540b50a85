"""Agreement of hull and silhouettes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig, Hull
from mocap.volume import _kernels
from mocap.volume.carve import check_masks

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Width of a painted voxel: between a face (1) and a space diagonal (1.73); without holes on smooth surfaces.
FOOTPRINT = 1.2


@dataclass(frozen=True, eq=False)
class SilhouetteResiduals:
    """Disagreement of hull and masks, one number per camera, in rig order.

    uncovered : (C,) share of the mask's pixels that the reprojected hull does not reach; NaN for an empty
    mask.
    surplus : (C,) share of the reprojected hull's pixels outside the mask; NaN when no voxel is in the
    picture.
    """

    uncovered: Array
    surplus: Array


def reproject(hull: Hull, camera: Camera) -> Mask:
    """Silhouette (H, W) bool of the hull in a camera: one square per surface voxel, 1.2 voxels wide."""
    return silhouette(camera, hull.grid.centers(hull.voxels[hull.is_surface]), hull.grid.voxel_size_m)


def silhouette(camera: Camera, centers: Array, side_m: float) -> Mask:
    """Silhouette (H, W) bool of cubes around centers (N, 3) m: one square each, 1.2 sides wide."""
    uv, depth = camera.project(centers) if len(centers) else (np.zeros((0, 2)), np.zeros(0))
    return squares(camera, uv, depth, side_m)


def squares(camera: Camera, uv: Array, depth: Array, side_m: float) -> Mask:
    """Squares (H, W) bool, 1.2 sides wide, about pixels uv (N, 2) of cubes at depth (N,) m; NaN is skipped."""
    width, height = camera.size
    canvas = np.zeros((height, width), dtype=np.uint8)
    focal = max(camera.K[0, 0], camera.K[1, 1])
    _kernels.paint_boxes(uv, 0.5 * FOOTPRINT * side_m * focal / np.maximum(depth, 1e-3), canvas)
    return canvas.view(np.bool_)


def silhouette_residuals(hull: Hull, masks: Sequence[Mask], rig: CameraRig) -> SilhouetteResiduals:
    """Share of each mask that the hull misses, and of the reprojected hull that lies outside the mask.

    masks : one (H, W) bool per camera, in rig order. A hull carved strictly from exact masks leaves next to
    nothing uncovered and a surplus of about one voxel around the outline; a camera that has moved or lags
    leaves its mask uncovered while the others' stay covered.
    """
    check_masks(rig, masks)
    uncovered = np.full(len(rig), np.nan)
    surplus = np.full(len(rig), np.nan)
    for c, (camera, mask) in enumerate(zip(rig, masks, strict=True)):
        drawn = reproject(hull, camera)
        both = int(np.count_nonzero(drawn & mask))
        n_mask, n_drawn = int(np.count_nonzero(mask)), int(np.count_nonzero(drawn))
        if n_mask:
            uncovered[c] = 1 - both / n_mask
        if n_drawn:
            surplus[c] = 1 - both / n_drawn
    return SilhouetteResiduals(uncovered, surplus)
