"""Points from several calibrated views, with and without known correspondence (undistorted pixels)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.geometry.epipolar import epipolar_lines

_SINGULAR = (
    1e-10  # determinant over the product of the diagonal: rays less than a thousandth of a degree apart
)
_LINE_ERRORS = 3.0


@dataclass(frozen=True, eq=False)
class Triangulated:
    """Points found in unlabelled detections.

    points : (K, 3) m, world, best supported first.  n_views : (K,) views that agree.  error_px : (K,) root mean
    square distance of their detections.
    """

    points: Array
    n_views: NDArray[np.int64]
    error_px: Array


def triangulate(P: Array, uv: Array) -> Array:
    """Points seen by V views each, by linear least squares with one reweighting by depth.

    P : (..., V, 3, 4), world (m) to undistorted px.  uv : (..., V, 2) px; NaN = not seen in that view.
    Returns (..., 3) m; NaN where fewer than two views see the point or their rays are parallel.
    """
    seen = np.asarray(np.isfinite(uv).all(axis=-1))
    rows = P[..., :2, :] - np.where(seen[..., None], uv, 0.0)[..., None] * P[..., 2:3, :]
    weight = seen.astype(np.float64)
    n_rows = 2 * uv.shape[-2]
    point = np.full((*uv.shape[:-2], 3), np.nan)
    usable = np.asarray(seen.sum(axis=-1) >= 2)
    # Rows scaled by the inverse depth are errors in pixels; the first pass does not know the depth yet.
    for _ in range(2):
        scaled = rows * weight[..., None, None]
        A = scaled[..., :3].reshape(*uv.shape[:-2], n_rows, 3)
        N = np.einsum("...rc,...rd->...cd", A, A)
        h = -np.einsum("...rc,...r->...c", A, scaled[..., 3].reshape(*uv.shape[:-2], n_rows))
        diagonal = np.einsum("...cc->...c", N)
        usable = np.asarray(usable & (np.abs(np.linalg.det(N)) > _SINGULAR * diagonal.prod(axis=-1)))
        point[usable] = np.linalg.solve(N[usable], h[usable][..., None])[..., 0]
        depth = np.einsum("...vc,...c->...v", P[..., 2, :3], np.nan_to_num(point)) + P[..., 2, 3]
        weight = np.where(seen, 1.0 / np.maximum(np.abs(depth), 1e-6), 0.0)
    point[~usable] = np.nan
    return point


def triangulate_unlabelled(
    P: Array, detections: list[Array], *, max_error_px: float, min_views: int
) -> Triangulated:
    """Points on which the detections of at least min_views views agree, each detection used once.

    P : (C, 3, 4).  detections : per view (n, 2) undistorted px. Every pair of detections of two views proposes a
    point; the one that most views confirm within max_error_px is taken, its detections are used up, and so on.
    A view with nothing near does not count against a point: it may be hidden there.
    Raises ValueError for min_views below 2.
    """
    if min_views < 2:
        raise ValueError(f"min_views must be at least 2, got {min_views}")
    C = len(P)
    proposals = [
        _proposals(P[i], P[j], detections[i], detections[j], max_error_px)
        for i in range(C)
        for j in range(i + 1, C)
    ]
    points = np.concatenate([np.zeros((0, 3)), *proposals])
    confirmed, distance = _confirmations(P, detections, points, max_error_px)
    found: list[Array] = []
    n_views, error = [], []
    used = [np.zeros(len(d) + 1, dtype=np.bool_) for d in detections]  # the last one stands for "none"
    while len(points):
        free = np.column_stack([(confirmed[:, c] >= 0) & ~used[c][confirmed[:, c]] for c in range(C)])
        support = free.sum(axis=1)
        mean = np.where(free, np.minimum(distance, max_error_px) ** 2, 0.0).sum(axis=1) / np.maximum(
            support, 1
        )
        rank = support - mean / (max_error_px**2 + 1.0)
        best = int(rank.argmax())
        if support[best] < min_views:
            break
        views = np.flatnonzero(free[best])
        uv = np.full((C, 2), np.nan)
        uv[views] = [detections[c][confirmed[best, c]] for c in views]
        point = triangulate(P, uv)
        for c in views.tolist():
            used[c][confirmed[best, c]] = True
        if np.isfinite(point).all():
            squared = [float(np.sum((_project(P[c], point[None])[0][0] - uv[c]) ** 2)) for c in views]
            found.append(point)
            n_views.append(len(views))
            error.append(np.sqrt(np.mean(squared)))
        keep = support >= min_views
        points, confirmed, distance = points[keep], confirmed[keep], distance[keep]
    return Triangulated(
        np.array(found).reshape(-1, 3), np.array(n_views, dtype=np.int64), np.array(error, dtype=np.float64)
    )


def _confirmations(
    P: Array, detections: list[Array], points: Array, max_error_px: float
) -> tuple[NDArray[np.int64], Array]:
    """The detection of each view nearest to points (N, 3): its index (N, C), -1 beyond the error, and distance, px."""
    confirmed = np.zeros((len(points), len(P)), dtype=np.int64) - 1
    distance = np.full((len(points), len(P)), np.inf)
    for c, found in enumerate(detections):
        if len(found) and len(points):
            uv, is_before = _project(P[c], points)
            d = np.linalg.norm(uv[:, None] - found[None], axis=2)
            distance[:, c] = np.where(is_before, d.min(axis=1), np.inf)
            confirmed[:, c] = np.where(distance[:, c] <= max_error_px, d.argmin(axis=1), -1)
    return confirmed, distance


def _proposals(P_a: Array, P_b: Array, a: Array, b: Array, max_error_px: float) -> Array:
    """Points of all pairs of detections whose rays meet, (K, 3): both see them within the error."""
    if not len(a) or not len(b):
        return np.zeros((0, 3))
    # A point that both see within the error lies within twice that of both epipolar lines when the cameras are alike.
    F = fundamental_of_projections(P_a, P_b)
    in_b = epipolar_lines(F, a) @ np.column_stack([b, np.ones(len(b))]).T
    in_a = epipolar_lines(F.T, b) @ np.column_stack([a, np.ones(len(a))]).T
    q, r = np.nonzero(
        (np.abs(in_b) <= _LINE_ERRORS * max_error_px) & (np.abs(in_a.T) <= _LINE_ERRORS * max_error_px)
    )
    uv = np.stack([a[q], b[r]], axis=1)
    points = triangulate(np.broadcast_to(np.stack([P_a, P_b]), (len(uv), 2, 3, 4)), uv)
    ok = np.isfinite(points).all(axis=1)
    for k, P in enumerate((P_a, P_b)):
        projected, is_before = _project(P, points)
        ok &= is_before & (np.linalg.norm(projected - uv[:, k], axis=1) <= max_error_px)
    return points[ok]


def fundamental_of_projections(P_a: Array, P_b: Array) -> Array:
    """F (3, 3) with x_b^T F x_a = 0 from two projection matrices; zeros when their centres coincide.

    Source: Hartley and Zisserman, Multiple View Geometry, Eq. 9.1.
    """
    center = np.append(-np.linalg.solve(P_a[:, :3], P_a[:, 3]), 1.0)
    e = P_b @ center
    cross = np.array([[0.0, -e[2], e[1]], [e[2], 0.0, -e[0]], [-e[1], e[0], 0.0]])
    F = cross @ P_b @ np.linalg.pinv(P_a)
    return F / max(float(np.linalg.norm(F)), 1e-300)


def _project(P: Array, points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Pixels (N, 2) of points (N, 3), and whether each lies before the camera."""
    x = points @ P[:, :3].T + P[:, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        return x[:, :2] / x[:, 2:], x[:, 2] > 1e-6


@dataclass(frozen=True, eq=False)
class Agreement:
    """Points that several views name, from the views that agree on each.

    points : (K, 3) m, NaN where fewer than two views agree.  agrees : (C, K), views within the gate of the point.
    error : (C, K) distance of every view's pixel from the point's image, in units of its gate; inf where it has none.
    """

    points: Array
    agrees: NDArray[np.bool_]
    error: Array


def triangulate_agreeing(P: Array, uv: Array, gate_px: Array) -> Agreement:
    """Points of known correspondence, each from the largest set of views that agree within their gates.

    P : (C, 3, 4), world (m) to undistorted px.  uv : (C, K, 2) px, NaN = the view does not see it.  gate_px : (C, K).
    Every pair of views proposes a point; the one with most agreement, sum of 1 - (error / gate)^2 where that is
    positive, is triangulated from the views that agree, twice.
    """
    C, K = uv.shape[:2]
    best, points = np.zeros(K), np.full((K, 3), np.nan)
    for i in range(C):
        for j in range(i + 1, C):
            pair = np.broadcast_to(P[[i, j]], (K, 2, 3, 4))
            proposed = triangulate(pair, np.stack([uv[i], uv[j]], axis=1))
            error = _gated_error(P, uv, gate_px, proposed)
            value = np.maximum(1.0 - error**2, 0.0).sum(axis=0)
            both = (error[i] <= 1.0) & (error[j] <= 1.0)
            better = both & (value > best)
            best[better], points[better] = value[better], proposed[better]
    error = _gated_error(P, uv, gate_px, points)
    for _ in range(2):
        chosen = np.where((error <= 1.0)[..., None], uv, np.nan).transpose(1, 0, 2)
        again = triangulate(np.broadcast_to(P, (K, C, 3, 4)), chosen)
        found = np.asarray(np.isfinite(again).all(axis=1))
        points = np.where(found[:, None], again, points)
        error = _gated_error(P, uv, gate_px, points)
    agrees = error <= 1.0
    points[agrees.sum(axis=0) < 2] = np.nan
    return Agreement(points, agrees & np.isfinite(points).all(axis=1), error)


def _gated_error(P: Array, uv: Array, gate_px: Array, points: Array) -> Array:
    """Distance (C, K) of pixels uv (C, K, 2) from the images of points (K, 3), over the gate; inf where undefined."""
    x = np.einsum("crk,nk->cnr", P[:, :, :3], points) + P[:, None, :, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.linalg.norm(x[..., :2] / x[..., 2:] - uv, axis=-1) / gate_px
        return np.where((x[..., 2] > 1e-6) & np.isfinite(error), error, np.inf)
