"""Smoothing of a trajectory whose single frames have their own information matrices: fixed interval or fixed lag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.geometry.rigid import wrap_angle

Array = NDArray[np.float64]

_UNKNOWN_STD = 3.0  # of the first state around its estimate, m and rad
_UNKNOWN_SPEED_STD = 0.5  # per frame


@dataclass(frozen=True, eq=False)
class _Forward:
    """The Kalman filter's pass: predicted and filtered moments, (T, 2D) and (T, 2D, 2D), and the gains of the way back,
    (T - 1, 2D, 2D)."""

    predicted: Array
    filtered: Array
    covariance: Array
    predicted_covariance: Array
    back: Array


def smooth_states(
    states: Array,
    information: Array,
    acceleration_std: Array,
    is_circular: NDArray[np.bool_],
    *,
    lag: int | None = None,
) -> tuple[Array, Array]:
    """States over time under white accelerations, each frame weighed by what it knows.

    states : (T, D).  information : (T, D, D), inverse covariances; 0 = a column of which the frame says nothing.
    acceleration_std : (D,) per frame squared.  is_circular : (D,).  lag : how many later frames a frame may look at;
    None = all of them, 0 = the filter alone.
    Returns the smoothed states (T, D) and their covariances (T, D, D). Circular columns come back wrapped to
    (-pi, pi]. A Kalman filter on position and velocity, then the Rauch-Tung-Striebel recursion, which with a lag
    begins anew from the last frame that each frame may look at.
    Source: Rauch, Tung and Striebel 1965.
    """
    T, D = states.shape
    if information.shape != (T, D, D) or acceleration_std.shape != (D,):
        raise ValueError(
            f"information {information.shape} and acceleration_std {acceleration_std.shape} do not fit states "
            f"{states.shape}"
        )
    if lag is not None and lag < 0:
        raise ValueError(f"lag must be at least 0, got {lag}")
    if T == 0:
        return states.copy(), np.zeros((0, D, D))
    forward = _filter(states, information, acceleration_std, is_circular)
    if lag is None or lag >= T - 1:
        out, out_P = _whole_way_back(forward)
    else:
        out, out_P = _some_way_back(forward, lag)
    smoothed = out[:, :D]
    smoothed[:, is_circular] = wrap_angle(smoothed[:, is_circular])
    return smoothed, out_P[:, :D, :D]


def _filter(
    states: Array, information: Array, acceleration_std: Array, is_circular: NDArray[np.bool_]
) -> _Forward:
    T, D = states.shape
    F = np.eye(2 * D)
    F[:D, D:] = np.eye(D)
    push = np.vstack([0.5 * np.diag(acceleration_std), np.diag(acceleration_std)])
    Q = push @ push.T
    z = np.concatenate([states[0], np.zeros(D)])
    P = np.diag(np.concatenate([np.full(D, _UNKNOWN_STD**2), np.full(D, _UNKNOWN_SPEED_STD**2)]))
    predicted, predicted_P = np.empty((T, 2 * D)), np.empty((T, 2 * D, 2 * D))
    filtered, filtered_P = np.empty_like(predicted), np.empty_like(predicted_P)
    for i in range(T):
        if i > 0:
            z, P = F @ z, F @ P @ F.T + Q
        predicted[i], predicted_P[i] = z, P
        d = states[i] - z[:D]
        d = np.where(is_circular, wrap_angle(d), d)
        # Information may be singular, so its inverse, the usual form of the gain, may not exist.
        gain = np.linalg.solve((np.eye(D) + P[:D, :D] @ information[i]).T, (P[:, :D] @ information[i]).T).T
        z = z + gain @ d
        P = P - gain @ P[:D]
        P = 0.5 * (P + P.T)
        filtered[i], filtered_P[i] = z, P
    back = np.array([np.linalg.solve(predicted_P[i + 1], F @ filtered_P[i]).T for i in range(T - 1)]).reshape(
        -1, 2 * D, 2 * D
    )
    return _Forward(predicted, filtered, filtered_P, predicted_P, back)


def _whole_way_back(forward: _Forward) -> tuple[Array, Array]:
    out, out_P = forward.filtered.copy(), forward.covariance.copy()
    for i in range(len(out) - 2, -1, -1):
        back = forward.back[i]
        out[i] += back @ (out[i + 1] - forward.predicted[i + 1])
        out_P[i] += back @ (out_P[i + 1] - forward.predicted_covariance[i + 1]) @ back.T
    return out, out_P


def _some_way_back(forward: _Forward, lag: int) -> tuple[Array, Array]:
    """Every frame from the one `lag` frames later, all frames side by side."""
    T = len(forward.filtered)
    rows = np.arange(T)
    last = np.minimum(rows + lag, T - 1)
    out, out_P = forward.filtered[last], forward.covariance[last]
    for k in range(1, lag + 1):
        going = rows[last - k >= rows]
        i = last[going] - k
        back = forward.back[i]
        ahead = out[going] - forward.predicted[i + 1]
        ahead_P = out_P[going] - forward.predicted_covariance[i + 1]
        out[going] = forward.filtered[i] + np.einsum("tcd,td->tc", back, ahead)
        out_P[going] = forward.covariance[i] + back @ ahead_P @ back.transpose(0, 2, 1)
    return out, out_P


def smooth_points(
    points: Array,
    variance: Array,
    acceleration_std: Array,
    *,
    lag: int | None = None,
    degrees: float | None = 4.0,
    n_rounds: int = 3,
) -> tuple[Array, Array, Array]:
    """Points over time, each on its own, with the same variance along all axes: what `smooth_states` would give for
    one point at a time, many times faster.

    points : (T, M, 3) m.  variance : (T, M) m^2; infinite = the frame says nothing of the point.  acceleration_std :
    (M,) m per frame squared, > 0.  lag : as in `smooth_states`.  degrees : of freedom of Student's t, by which a
    frame's place of a point is weighed, so that jumps are let go; None = as a Gaussian.
    Returns points (T, M, 3), their variances (T, M) and the weights (T, M) that the frames ended with, at most 1.
    Source: Rauch, Tung and Striebel 1965, reweighted by the E step of Lange, Little and Taylor 1989.
    """
    T, M = points.shape[:2]
    if variance.shape != (T, M) or acceleration_std.shape != (M,):
        raise ValueError(
            f"variance {variance.shape} and acceleration_std {acceleration_std.shape} do not fit points {points.shape}"
        )
    if not np.all(acceleration_std > 0):
        raise ValueError("acceleration_std must be positive")
    if lag is not None and lag < 0:
        raise ValueError(f"lag must be at least 0, got {lag}")
    weights = np.ones((T, M))
    if T == 0:
        return points.copy(), variance.copy(), weights
    information = 1.0 / variance
    smoothed, out_variance = _smooth_points_once(points, information, acceleration_std**2, lag)
    if degrees is None:
        return smoothed, out_variance, weights
    for _ in range(n_rounds):
        misfit = ((points - smoothed) ** 2).sum(axis=2) * information
        weights = np.minimum((degrees + 3.0) / (degrees + misfit), 1.0)
        smoothed, out_variance = _smooth_points_once(points, information * weights, acceleration_std**2, lag)
    return smoothed, out_variance, weights


def _smooth_points_once(points: Array, information: Array, q: Array, lag: int | None) -> tuple[Array, Array]:
    """One pass.  q : (M,) variance of the acceleration. Moments of place and speed are kept as (T, M, 2, 3) and, of the
    covariance, (T, M, 2, 2)."""
    T, M = points.shape[:2]
    F = np.array([[1.0, 1.0], [0.0, 1.0]])
    Q = q[:, None, None] * np.array([[0.25, 0.5], [0.5, 1.0]])
    predicted, filtered = np.empty((T, M, 2, 3)), np.empty((T, M, 2, 3))
    predicted_P, filtered_P = np.empty((T, M, 2, 2)), np.empty((T, M, 2, 2))
    z = np.stack([points[0], np.zeros((M, 3))], axis=1)
    P = np.tile(np.diag([_UNKNOWN_STD**2, _UNKNOWN_SPEED_STD**2]), (M, 1, 1))
    for i in range(T):
        if i > 0:
            z, P = F @ z, F @ P @ F.T + Q
        predicted[i], predicted_P[i] = z, P
        gain = P[:, :, 0] * (information[i] / (1.0 + P[:, 0, 0] * information[i]))[:, None]
        z = z + gain[:, :, None] * (points[i] - z[:, 0])[:, None]
        P = P - gain[:, :, None] * P[:, :1]
        filtered[i], filtered_P[i] = z, P
    # P F^T P_next^-1, the inverse of a 2 x 2 written out.
    ahead = predicted_P[1:]
    det = ahead[..., 0, 0] * ahead[..., 1, 1] - ahead[..., 0, 1] * ahead[..., 1, 0]
    inverse = np.stack([ahead[..., 1, 1], -ahead[..., 0, 1], -ahead[..., 1, 0], ahead[..., 0, 0]], axis=-1)
    inverse = inverse.reshape(*ahead.shape) / det[..., None, None]
    back = filtered_P[:-1] @ F.T @ inverse
    rows = np.arange(T)
    reach = T - 1 if lag is None else min(lag, T - 1)
    if reach == T - 1:
        out, out_P = filtered.copy(), filtered_P.copy()
        for i in range(T - 2, -1, -1):
            out[i] += back[i] @ (out[i + 1] - predicted[i + 1])
            out_P[i] += back[i] @ (out_P[i + 1] - predicted_P[i + 1]) @ back[i].transpose(0, 2, 1)
        return out[:, :, 0], out_P[:, :, 0, 0]
    last = np.minimum(rows + reach, T - 1)
    out, out_P = filtered[last], filtered_P[last]
    for k in range(1, reach + 1):
        going = rows[last - k >= rows]
        i = last[going] - k
        out[going] = filtered[i] + back[i] @ (out[going] - predicted[i + 1])
        out_P[going] = filtered_P[i] + back[i] @ (out_P[going] - predicted_P[i + 1]) @ back[i].transpose(
            0, 1, 3, 2
        )
    return out[:, :, 0], out_P[:, :, 0, 0]
