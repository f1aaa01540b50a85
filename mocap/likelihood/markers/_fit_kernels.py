"""Detections that belong to markers, and how they pull a body, as compiled code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mocap.body._kernels import Chain, chain_axes

_SLIP_ROUNDS = 4


class Projected(NamedTuple):
    """Markers in all views.  uv : (M, C, 2) px.  depth : (M, C) m.  in_view : (M, C) bool, whether the picture holds
    it."""

    uv: NDArray[np.float64]
    depth: NDArray[np.float64]
    in_view: NDArray[np.bool_]


class Belief(NamedTuple):
    """What a detection is worth against the prediction.  std_m : how far off a predicted marker may be.  noise_px : of
    a detection.  worth : (C,) nats that a detection exactly on the point is worth against clutter."""

    std_m: float
    noise_px: float
    worth: NDArray[np.float64]


class RobustNoise(NamedTuple):
    """Noise of a detection, px, and the error in standard deviations at which it loses three quarters of its pull
    (Geman-McClure)."""

    noise_px: float
    scale: float


class Movement(NamedTuple):
    """How a body in one pose can move.  t : (J, 3) m and axes : (n_dofs, 3), of `chain_axes`.  dof_joint, dof_column :
    (n_dofs,).  moves : (J, n_dofs) bool, which rotations move which joint frame."""

    t: NDArray[np.float64]
    axes: NDArray[np.float64]
    dof_joint: NDArray[np.int64]
    dof_column: NDArray[np.int64]
    moves: NDArray[np.bool_]


class MarkedBody(NamedTuple):
    """A body with markers.  chain : of `chain_axes`.  moves : (J, n_dofs) bool, which rotations move which joint
    frame.  joint : (M,).  offset : (M, 3) m.  slack_m : (M,)."""

    chain: Chain
    moves: NDArray[np.bool_]
    joint: NDArray[np.int64]
    offset: NDArray[np.float64]
    slack_m: NDArray[np.float64]


class MatchedViews(NamedTuple):
    """Pictures whose detections are given to markers.  P : (C, 3, 4).  lower, upper : (C, 2) px, of the pictures.
    uv : (Q, 2) px.  chosen : (M, C) rows of uv, -1 = none.  in_view : (M, C) bool."""

    P: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    uv: NDArray[np.float64]
    chosen: NDArray[np.int64]
    in_view: NDArray[np.bool_]


@njit(cache=True, nogil=True)
def project_markers(points, P, lower, upper, projected, depth, in_view):
    """Fill projected (M, C, 2) px, depth (M, C) m and in_view (M, C) bool of points (M, 3) m."""
    for m in range(points.shape[0]):
        x, y, z = points[m]
        for c in range(P.shape[0]):
            w = P[c, 2, 0] * x + P[c, 2, 1] * y + P[c, 2, 2] * z + P[c, 2, 3]
            depth[m, c] = w
            in_view[m, c] = False
            if not w > 1e-6:
                continue
            u = (P[c, 0, 0] * x + P[c, 0, 1] * y + P[c, 0, 2] * z + P[c, 0, 3]) / w
            v = (P[c, 1, 0] * x + P[c, 1, 1] * y + P[c, 1, 2] * z + P[c, 1, 3]) / w
            projected[m, c, 0] = u
            projected[m, c, 1] = v
            in_view[m, c] = u >= lower[c, 0] and u <= upper[c, 0] and v >= lower[c, 1] and v <= upper[c, 1]


@njit(cache=True, nogil=True)
def nearest_detections(projected, in_view, uv, first, gate, chosen):
    """Fill chosen (M, C): the closest detection within gate (M, C) px, -1 = none; one detection serves one marker,
    the one that is closest to it."""
    n_markers, n_views = in_view.shape
    owner = np.full(uv.shape[0], -1)
    owner_2 = np.empty(uv.shape[0])
    for c in range(n_views):
        for m in range(n_markers):
            chosen[m, c] = -1
            if not in_view[m, c]:
                continue
            best = -1
            best_2 = gate[m, c] * gate[m, c]
            for q in range(first[c], first[c + 1]):
                du = projected[m, c, 0] - uv[q, 0]
                dv = projected[m, c, 1] - uv[q, 1]
                d = du * du + dv * dv
                if d < best_2:
                    best = q
                    best_2 = d
            if best >= 0 and (owner[best] < 0 or best_2 < owner_2[best]):
                if owner[best] >= 0:
                    chosen[owner[best], c] = -1
                owner[best] = m
                owner_2[best] = best_2
                chosen[m, c] = best


@njit(cache=True, nogil=True)
def _two_view_point(P_a, ua, va, P_b, ub, vb, x):
    """Least-squares point of two detections into x (3,); False when their rays are parallel."""
    N = np.zeros((3, 3))
    h = np.zeros(3)
    for k in range(4):
        P = P_a if k < 2 else P_b
        at = (ua, va, ub, vb)[k]
        row = k % 2
        r0 = P[row, 0] - at * P[2, 0]
        r1 = P[row, 1] - at * P[2, 1]
        r2 = P[row, 2] - at * P[2, 2]
        b = -(P[row, 3] - at * P[2, 3])
        N[0, 0] += r0 * r0
        N[0, 1] += r0 * r1
        N[0, 2] += r0 * r2
        N[1, 1] += r1 * r1
        N[1, 2] += r1 * r2
        N[2, 2] += r2 * r2
        h[0] += r0 * b
        h[1] += r1 * b
        h[2] += r2 * b
    N[1, 0] = N[0, 1]
    N[2, 0] = N[0, 2]
    N[2, 1] = N[1, 2]
    return _solve3(N, h, x)


@njit(cache=True, nogil=True)
def _solve3(N, h, x):
    """x = N^-1 h of a symmetric N by cofactors; False when N is singular."""
    c00 = N[1, 1] * N[2, 2] - N[1, 2] * N[2, 1]
    c01 = N[1, 2] * N[2, 0] - N[1, 0] * N[2, 2]
    c02 = N[1, 0] * N[2, 1] - N[1, 1] * N[2, 0]
    det = N[0, 0] * c00 + N[0, 1] * c01 + N[0, 2] * c02
    scale = N[0, 0] * N[1, 1] * N[2, 2]
    if not abs(det) > 1e-9 * abs(scale):
        return False
    # N is symmetric, and so is its inverse.
    c11 = N[0, 0] * N[2, 2] - N[0, 2] * N[2, 0]
    c12 = N[0, 2] * N[1, 0] - N[0, 0] * N[1, 2]
    c22 = N[0, 0] * N[1, 1] - N[0, 1] * N[1, 0]
    x[0] = (c00 * h[0] + c01 * h[1] + c02 * h[2]) / det
    x[1] = (c01 * h[0] + c11 * h[1] + c12 * h[2]) / det
    x[2] = (c02 * h[0] + c12 * h[1] + c22 * h[2]) / det
    return True


@njit(cache=True, nogil=True)
def _detections_near(m, seen, detections, gate, near, near_first):
    """Detections within the gate of a marker's projections, view by view, into near (Q,) and near_first (C + 1,)."""
    uv, first = detections
    n_views = near_first.shape[0] - 1
    n = 0
    for c in range(n_views):
        near_first[c] = n
        if not seen.in_view[m, c]:
            continue
        for q in range(first[c], first[c + 1]):
            du = seen.uv[m, c, 0] - uv[q, 0]
            dv = seen.uv[m, c, 1] - uv[q, 1]
            if du * du + dv * dv < gate[m, c] * gate[m, c]:
                near[n] = q
                n += 1
    near_first[n_views] = n


@njit(cache=True, nogil=True)
def _agreement(x, total, P, uv, near, near_first, belief, trial):
    """Score of a point x (3,), from `total` on, and the number of views that agree on it; their detections into trial
    (C,), -1 = none."""
    inverse_2 = 1.0 / (belief.noise_px * belief.noise_px)
    worth = belief.worth
    n_agree = 0
    for c in range(trial.shape[0]):
        trial[c] = -1
        if near_first[c] == near_first[c + 1]:
            continue
        w = P[c, 2, 0] * x[0] + P[c, 2, 1] * x[1] + P[c, 2, 2] * x[2] + P[c, 2, 3]
        if not w > 1e-6:
            continue
        u = (P[c, 0, 0] * x[0] + P[c, 0, 1] * x[1] + P[c, 0, 2] * x[2] + P[c, 0, 3]) / w
        v = (P[c, 1, 0] * x[0] + P[c, 1, 1] * x[1] + P[c, 1, 2] * x[2] + P[c, 1, 3]) / w
        best = worth[c]
        for e in range(near_first[c], near_first[c + 1]):
            du = u - uv[near[e], 0]
            dv = v - uv[near[e], 1]
            half = 0.5 * (du * du + dv * dv) * inverse_2
            if half < best:
                best = half
                trial[c] = near[e]
        if trial[c] >= 0:
            total += worth[c] - best
            n_agree += 1
    return total, n_agree


@njit(cache=True, nogil=True)
def _give_to_one(chosen, score, n_detections):
    """A detection serves one marker: the one whose point has more behind it.  chosen : (M, C).  score : (M,)."""
    owner = np.full(n_detections, -1)
    for m in range(chosen.shape[0]):
        for c in range(chosen.shape[1]):
            q = chosen[m, c]
            if q < 0:
                continue
            if owner[q] < 0:
                owner[q] = m
            elif score[m] > score[owner[q]]:
                chosen[owner[q], c] = -1
                owner[q] = m
            else:
                chosen[m, c] = -1


@njit(cache=True, nogil=True)
def agreeing_detections(points, seen, gate, P, is_pair, detections, belief, chosen):
    """Fill chosen (M, C): detections that agree on one point near the predicted marker, -1 = none.

    points : (M, 3) m, predicted.  seen : Projected, theirs.  gate : (M, C) px around its projection.
    Every two detections inside the gates propose a point. Its score is the worth of all views' detections less half
    their squared errors, less half the squared distance to the prediction, in standard deviations; the best point
    with a positive score and two views or more is taken.
    """
    uv = detections.uv
    n_markers, n_views = chosen.shape
    x = np.empty(3)
    near = np.empty(uv.shape[0], np.int64)
    near_first = np.empty(n_views + 1, np.int64)
    trial = np.empty(n_views, np.int64)
    score = np.zeros(n_markers)
    chosen[:] = -1
    for m in range(n_markers):
        _detections_near(m, seen, detections, gate, near, near_first)
        for i in range(n_views):
            for j in range(i + 1, n_views):
                if not is_pair[i, j]:
                    continue
                for q in near[near_first[i] : near_first[i + 1]]:
                    for r in near[near_first[j] : near_first[j + 1]]:
                        if not _two_view_point(P[i], uv[q, 0], uv[q, 1], P[j], uv[r, 0], uv[r, 1], x):
                            continue
                        d_2 = 0.0
                        for k in range(3):
                            d_2 += (x[k] - points[m, k]) ** 2
                        total = -0.5 * d_2 / (belief.std_m * belief.std_m)
                        if total < -4.5:
                            continue
                        total, n_agree = _agreement(x, total, P, uv, near, near_first, belief, trial)
                        if n_agree >= 2 and total > score[m]:
                            score[m] = total
                            chosen[m] = trial
    _give_to_one(chosen, score, uv.shape[0])


@njit(cache=True, nogil=True)
def _pull_of_views(m, seen, detections_of, P, noise, slip, scratch):
    """Robust cost of one marker's detections at a slip (3,) m of it; fills their matrix A (3, 3) and gradient b (3,).

    detections_of : (uv, chosen).  scratch : (A, b, J (2, 3)).
    """
    uv, chosen = detections_of
    projected, depth, in_view = seen
    A, b, J = scratch
    inverse_2 = 1.0 / (noise.noise_px * noise.noise_px)
    scale_2 = noise.scale * noise.scale
    A[:] = 0.0
    b[:] = 0.0
    cost = 0.0
    for c in range(P.shape[0]):
        if not in_view[m, c] or chosen[m, c] < 0:
            continue
        q = chosen[m, c]
        error_2 = 0.0
        for k in range(2):
            residual = projected[m, c, k] - uv[q, k]
            for r in range(3):
                J[k, r] = (P[c, k, r] - projected[m, c, k] * P[c, 2, r]) / depth[m, c]
                residual += J[k, r] * slip[r]
            error_2 += residual * residual * inverse_2
        share = scale_2 / (scale_2 + error_2)
        cost += 0.5 * scale_2 * (1.0 - share)
        weight = share * share * inverse_2
        for k in range(2):
            residual = projected[m, c, k] - uv[q, k]
            for r in range(3):
                b[r] += weight * J[k, r] * residual
                for e in range(3):
                    A[r, e] += weight * J[k, r] * J[k, e]
    return cost


@njit(cache=True, nogil=True)
def marker_pulls(P, seen, uv, chosen, slack_m, noise, information, gradient):
    """Robust cost of the chosen detections, and its matrix (M, 3, 3) and gradient (M, 3) at every marker's point.

    seen : Projected.  chosen : (M, C) rows of uv, -1 = none.  noise : RobustNoise.  A marker in view without a
    detection costs the limit of the robust cost, scale^2 / 2. A marker slips against its part by a Gaussian
    displacement of standard deviation slack_m (M,), the same in all views: the most likely slip counts.
    """
    A = np.empty((3, 3))
    S = np.empty((3, 3))
    b = np.empty(3)
    J = np.empty((2, 3))
    x = np.empty(3)
    slip = np.empty(3)
    cost = 0.0
    for m in range(slack_m.shape[0]):
        s_2 = slack_m[m] * slack_m[m]
        information[m] = 0.0
        gradient[m] = 0.0
        n_seen = 0
        for c in range(P.shape[0]):
            if seen.in_view[m, c] and chosen[m, c] < 0:
                cost += 0.5 * (noise.scale * noise.scale)
            elif seen.in_view[m, c]:
                n_seen += 1
        if n_seen == 0:
            continue
        slip[:] = 0.0
        own = 0.0
        for _ in range(_SLIP_ROUNDS if s_2 > 0.0 else 1):
            own = _pull_of_views(m, seen, (uv, chosen), P, noise, slip, (A, b, J))
            # S = I + s^2 A; with the slip integrated out, S^-1 A is the point's information and S^-1 b its gradient.
            if s_2 > 0.0:
                for r in range(3):
                    own += 0.5 * slip[r] * slip[r] / s_2
            _slipping(A, s_2, S)
            _solve3(S, b, gradient[m])
            for r in range(3):
                slip[r] = -s_2 * gradient[m, r]
        cost += own
        for e in range(3):
            _solve3(S, A[e], x)
            for r in range(3):
                information[m, r, e] = x[r]
    return cost


@njit(cache=True, nogil=True)
def _slipping(A, s_2, S):
    """S = I + s^2 A, (3, 3)."""
    for r in range(3):
        for e in range(3):
            S[r, e] = (1.0 if r == e else 0.0) + s_2 * A[r, e]


@njit(cache=True, nogil=True)
def add_pulls(points, joint, information, gradient, movement, H, g):
    """Carry information (K, 3, 3) and gradient (K, 3) at points (K, 3), rigid with joints, over to the state."""
    t, axes, dof_joint, dof_column, moves = movement
    n_dofs = dof_joint.shape[0]
    columns = np.empty(n_dofs + 3, np.int64)
    V = np.empty((n_dofs + 3, 3))
    for m in range(points.shape[0]):
        A = information[m]
        k = 0
        for r in range(3):
            columns[k] = r
            for e in range(3):
                V[k, e] = 1.0 if r == e else 0.0
            k += 1
        for d in range(n_dofs):
            if not moves[joint[m], d]:
                continue
            rx = points[m, 0] - t[dof_joint[d], 0]
            ry = points[m, 1] - t[dof_joint[d], 1]
            rz = points[m, 2] - t[dof_joint[d], 2]
            V[k, 0] = axes[d, 1] * rz - axes[d, 2] * ry
            V[k, 1] = axes[d, 2] * rx - axes[d, 0] * rz
            V[k, 2] = axes[d, 0] * ry - axes[d, 1] * rx
            columns[k] = dof_column[d]
            k += 1
        for a in range(k):
            g[columns[a]] += V[a, 0] * gradient[m, 0] + V[a, 1] * gradient[m, 1] + V[a, 2] * gradient[m, 2]
            w0 = A[0, 0] * V[a, 0] + A[0, 1] * V[a, 1] + A[0, 2] * V[a, 2]
            w1 = A[1, 0] * V[a, 0] + A[1, 1] * V[a, 1] + A[1, 2] * V[a, 2]
            w2 = A[2, 0] * V[a, 0] + A[2, 1] * V[a, 1] + A[2, 2] * V[a, 2]
            for e in range(k):
                H[columns[a], columns[e]] += V[e, 0] * w0 + V[e, 1] * w1 + V[e, 2] * w2


@njit(cache=True, nogil=True)
def matched_equations(state, body, views, noise, H, g):
    """Add the robust cost's matrix (D, D) and gradient (D,) at a state (D,) to H and g; returns the cost.

    body : MarkedBody.  views : MatchedViews.  noise : RobustNoise.
    """
    n_markers, n_views = views.chosen.shape
    n_joints, n_dofs = body.moves.shape
    R, t, axes = np.empty((n_joints, 3, 3)), np.empty((n_joints, 3)), np.empty((n_dofs, 3))
    chain_axes(state, body.chain, R, t, axes)
    points = np.empty((n_markers, 3))
    for m in range(n_markers):
        j = body.joint[m]
        for r in range(3):
            points[m, r] = (
                R[j, r, 0] * body.offset[m, 0]
                + R[j, r, 1] * body.offset[m, 1]
                + R[j, r, 2] * body.offset[m, 2]
            ) + t[j, r]
    projected, depth = np.empty((n_markers, n_views, 2)), np.empty((n_markers, n_views))
    in_view = np.empty((n_markers, n_views), np.bool_)
    project_markers(points, views.P, views.lower, views.upper, projected, depth, in_view)
    # A fixed set of views: a marker must not gain by leaving the picture.
    for m in range(n_markers):
        for c in range(n_views):
            in_view[m, c] = views.in_view[m, c] and depth[m, c] > 1e-6
    information, gradient = np.empty((n_markers, 3, 3)), np.empty((n_markers, 3))
    seen = Projected(projected, depth, in_view)
    cost = marker_pulls(views.P, seen, views.uv, views.chosen, body.slack_m, noise, information, gradient)
    movement = Movement(t, axes, body.chain.dof_joint, body.chain.dof_column, body.moves)
    add_pulls(points, body.joint, information, gradient, movement, H, g)
    return cost
