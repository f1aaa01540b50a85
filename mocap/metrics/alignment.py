"""An estimate laid over its truth frame by frame: at the root, by a rigid motion, by a similarity.

What is left afterwards is the error of the pose alone. A landmark that either side does not know (NaN) takes
no part in the fit.
"""

from __future__ import annotations

import numpy as np

from mocap.arrays import Array
from mocap.data import LANDMARKS

_MIN_POINTS = 3  # fewer points fix no rotation


def root_aligned(estimate: Array, truth: Array) -> Array:
    """The estimate moved so that its root lies on the true one, (T, 15, 3) m; NaN in frames without a root.

    estimate, truth : (T, 15, 3) m, world, order LANDMARKS. The root is the pelvis where both sides know it, and
    else the midpoint of the hips.
    """
    estimate, truth = _checked(estimate, truth)
    if truth.shape[1] != len(LANDMARKS):
        raise ValueError(f"truth has {truth.shape[1]} landmarks, expected {len(LANDMARKS)}")
    shift = truth - estimate
    hips = [LANDMARKS.index("left_hip"), LANDMARKS.index("right_hip")]
    root = shift[:, LANDMARKS.index("pelvis")]
    known = np.isfinite(root).all(axis=1, keepdims=True)
    root = np.where(known, root, shift[:, hips].mean(axis=1))
    return estimate + root[:, None]


def procrustes_aligned(estimate: Array, truth: Array, *, with_scale: bool = True) -> Array:
    """The estimate after the rotation, shift and scale that fit it to the truth best, frame by frame.

    estimate, truth : (T, M, 3) m. with_scale : False = rigid, sizes are kept.  Frames with fewer than three common
    landmarks are NaN. The least-squares solution in closed form; a mirrored body is never mirrored back.
    """
    estimate, truth = _checked(estimate, truth)
    known = np.all(np.isfinite(estimate + truth), axis=2)
    usable = known.sum(axis=1) >= _MIN_POINTS
    out = np.full_like(estimate, np.nan)
    if not usable.any():
        return out
    x, y, w = estimate[usable], truth[usable], known[usable][:, :, None].astype(np.float64)
    count = w.sum(axis=1)
    x_mean = np.where(w > 0, x, 0.0).sum(axis=1) / count
    y_mean = np.where(w > 0, y, 0.0).sum(axis=1) / count
    x0 = np.where(w > 0, x - x_mean[:, None], 0.0)
    y0 = np.where(w > 0, y - y_mean[:, None], 0.0)
    U, S, Vt = np.linalg.svd(np.einsum("tmi,tmj->tij", y0, x0))
    sign = np.ones_like(S)
    sign[:, 2] = np.sign(np.linalg.det(U @ Vt))
    R = (U * sign[:, None]) @ Vt
    scale = np.ones(len(x))
    if with_scale:
        size = (x0**2).sum(axis=(1, 2))
        scale = np.where(size > 0, (S * sign).sum(axis=1) / np.where(size > 0, size, 1.0), 1.0)
    out[usable] = scale[:, None, None] * np.einsum("tij,tmj->tmi", R, x - x_mean[:, None]) + y_mean[:, None]
    return out


def _checked(estimate: Array, truth: Array) -> tuple[Array, Array]:
    estimate = np.asarray(estimate, dtype=np.float64)
    truth = np.asarray(truth, dtype=np.float64)
    if estimate.shape != truth.shape or truth.ndim != 3 or truth.shape[2] != 3:
        raise ValueError(
            f"estimate has shape {estimate.shape}, truth {truth.shape}, expected the same (T, M, 3)"
        )
    return estimate, truth
