"""Errors in the picture: both poses projected into calibrated cameras, in pixels (the 2D case of CF 5.3.1)."""

from __future__ import annotations

import numpy as np

from mocap.arrays import Array
from mocap.data import CameraRig
from mocap.metrics.points import PointScores, point_scores

EPSILON_PX = 10.0


def projected(landmarks: Array, rig: CameraRig) -> Array:
    """Pixels of landmarks (T, M, 3) m, world, in each camera, (C, T, M, 2); NaN behind a camera or unknown."""
    landmarks = np.asarray(landmarks, dtype=np.float64)
    shape = landmarks.shape[:2]
    return np.stack([camera.project(landmarks.reshape(-1, 3))[0].reshape(*shape, 2) for camera in rig])


def pixels_to_score(estimate: Array, truth: Array, rig: CameraRig) -> tuple[Array, Array]:
    """Both poses in each camera, (C, T, M, 2) px; the truth is NaN outside the picture, where nothing is scored.

    estimate, truth : (T, M, 3) m, world, NaN = unknown.
    """
    x, y = projected(estimate, rig), projected(truth, rig)
    inside = np.stack([camera.contains(uv) for camera, uv in zip(rig, y, strict=True)])
    return x, np.where(inside[..., None], y, np.nan)


def image_scores(
    estimate: Array, truth: Array, rig: CameraRig, epsilon_px: float = EPSILON_PX
) -> tuple[PointScores, dict[str, PointScores]]:
    """Point scores in pixels over all cameras together, and of each camera.

    estimate, truth : (T, M, 3) m, world, NaN = unknown. A landmark counts in the cameras whose picture holds the true
    one. The fields named `_mm` are pixels here. Raises ValueError for epsilon_px <= 0.
    """
    if not epsilon_px > 0:
        raise ValueError(f"epsilon_px must be positive, got {epsilon_px}")
    # point_scores multiplies by a thousand: it expects metres and speaks of millimetres.
    x, y = (pixels / 1000.0 for pixels in pixels_to_score(estimate, truth, rig))
    each = {camera.name: point_scores(x[c], y[c], epsilon_px) for c, camera in enumerate(rig)}
    return point_scores(np.concatenate(x), np.concatenate(y), epsilon_px), each
