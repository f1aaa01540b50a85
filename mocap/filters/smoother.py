"""Fixed-interval smoothing of a trajectory whose single frames have their own information matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.geometry.rigid import wrap_angle

Array = NDArray[np.float64]

_UNKNOWN_STD = 3.0  # of the first state around its estimate, m and rad
_UNKNOWN_SPEED_STD = 0.5  # per frame


def smooth_states(
    states: Array, information: Array, acceleration_std: Array, is_circular: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """States over time under white accelerations, each frame weighed by what it knows.

    states : (T, D).  information : (T, D, D), inverse covariances; 0 = a column of which the frame says nothing.
    acceleration_std : (D,) per frame squared.  is_circular : (D,).
    Returns the smoothed states (T, D) and their covariances (T, D, D). Circular columns come back wrapped to
    (-pi, pi]. A Kalman filter on position and velocity, then the Rauch-Tung-Striebel recursion.
    Source: Rauch, Tung and Striebel 1965.
    """
    T, D = states.shape
    if information.shape != (T, D, D) or acceleration_std.shape != (D,):
        raise ValueError(
            f"information {information.shape} and acceleration_std {acceleration_std.shape} do not fit states "
            f"{states.shape}"
        )
    if T == 0:
        return states.copy(), np.zeros((0, D, D))
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
    out, out_P = filtered.copy(), filtered_P.copy()
    for i in range(T - 2, -1, -1):
        back = np.linalg.solve(predicted_P[i + 1], F @ filtered_P[i]).T
        out[i] = filtered[i] + back @ (out[i + 1] - predicted[i + 1])
        out_P[i] = filtered_P[i] + back @ (out_P[i + 1] - predicted_P[i + 1]) @ back.T
    smoothed = out[:, :D]
    smoothed[:, is_circular] = wrap_angle(smoothed[:, is_circular])
    return smoothed, out_P[:, :D, :D]
