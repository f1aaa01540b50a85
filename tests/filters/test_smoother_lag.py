"""The fixed-lag smoother against its definition, the smoother of points against that of states."""

import numpy as np
import pytest

from mocap.filters.smoother import smooth_points, smooth_states

T, D = 23, 3
ACCELERATION = np.array([0.05, 0.2, 0.03])
CIRCULAR = np.array([False, False, True])
STD = np.array([0.3, 0.5, 0.2])


def noisy_path(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A path that bends, its third column an angle that goes around, and noise of STD."""
    t = np.arange(T)[:, None] / T
    path = np.hstack([2 * t, np.sin(3 * t), 5 * t])
    noise = np.random.default_rng(seed).standard_normal((T, D)) * STD
    return path, path + noise


INFORMATION = np.tile(np.diag(STD**-2.0), (T, 1, 1))


def wrapped(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(CIRCULAR, wrapped(a - b), a - b)


def test_a_lag_to_the_end_is_the_fixed_interval() -> None:
    _, noisy = noisy_path()
    whole = smooth_states(noisy, INFORMATION, ACCELERATION, CIRCULAR)
    for lag in (T - 1, T, 10 * T):
        for a, b in zip(
            smooth_states(noisy, INFORMATION, ACCELERATION, CIRCULAR, lag=lag), whole, strict=True
        ):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("lag", [0, 1, 4, T - 2])
def test_every_frame_is_the_last_of_a_shorter_clip(lag: int) -> None:
    """Definition of the fixed lag: frame i from frames 0 .. i + lag, by the fixed-interval smoother."""
    _, noisy = noisy_path(1)
    states, covariance = smooth_states(noisy, INFORMATION, ACCELERATION, CIRCULAR, lag=lag)
    for i in range(T):
        stop = min(T, i + lag + 1)
        expected, expected_P = smooth_states(noisy[:stop], INFORMATION[:stop], ACCELERATION, CIRCULAR)
        np.testing.assert_allclose(difference(states[i], expected[i]), 0, atol=1e-10)
        np.testing.assert_allclose(covariance[i], expected_P[i], atol=1e-10)


def test_more_lag_is_never_less_sure() -> None:
    _, noisy = noisy_path(2)
    previous = np.inf * np.ones((T, D))
    for lag in (0, 1, 2, 5, 11, T):
        _, P = smooth_states(noisy, INFORMATION, ACCELERATION, CIRCULAR, lag=lag)
        variance = np.diagonal(P, axis1=1, axis2=2)
        assert np.all(variance <= previous + 1e-12)
        previous = variance


def test_bad_arguments_are_refused() -> None:
    _, noisy = noisy_path()
    with pytest.raises(ValueError, match="lag must be at least 0, got -1"):
        smooth_states(noisy, INFORMATION, ACCELERATION, CIRCULAR, lag=-1)


M = 4
PUSH = np.array([0.01, 0.03, 0.1, 0.3])


def noisy_points(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Four points on their ways, and a variance for each in each frame; one of them is not seen for a while."""
    rng = np.random.default_rng(seed)
    t = np.arange(T)[:, None, None] / T
    points = np.sin((1 + np.arange(M)[:, None]) * t + np.arange(3)) + 0.05 * rng.standard_normal((T, M, 3))
    variance = rng.uniform(0.03, 0.08, (T, M)) ** 2
    variance[6:11, 2] = np.inf
    return points, variance


@pytest.mark.parametrize("lag", [None, 0, 3, T - 1])
def test_points_are_smoothed_as_states_are(lag: int | None) -> None:
    """Two implementations: all points at once, and one at a time by the smoother of states."""
    points, variance = noisy_points()
    smoothed, out_variance, weights = smooth_points(points, variance, PUSH, lag=lag, degrees=None)
    np.testing.assert_array_equal(weights, 1.0)
    for m in range(M):
        information = np.eye(3) / variance[:, m, None, None]
        states, P = smooth_states(
            points[:, m], information, np.full(3, PUSH[m]), np.zeros(3, dtype=np.bool_), lag=lag
        )
        np.testing.assert_allclose(smoothed[:, m], states, atol=1e-9)
        np.testing.assert_allclose(out_variance[:, m, None, None] * np.eye(3), P, atol=1e-9)


def test_points_that_jump_are_let_go() -> None:
    """The same as smoothing the states of each point anew with the weights that its misfit asks for."""
    points, variance = noisy_points(1)
    points[13:15, 0] += [1.0, -0.5, 0.2]
    smoothed, _, weights = smooth_points(points, variance, PUSH, lag=7, degrees=4.0, n_rounds=3)
    straight = np.zeros(3, dtype=np.bool_)
    for m in range(M):
        weight = np.ones(T)
        for k in range(4):
            information = (weight / variance[:, m])[:, None, None] * np.eye(3)
            states, _ = smooth_states(points[:, m], information, np.full(3, PUSH[m]), straight, lag=7)
            if k < 3:
                misfit = ((points[:, m] - states) ** 2).sum(axis=1) / variance[:, m]
                weight = np.minimum(7.0 / (4.0 + misfit), 1.0)
        np.testing.assert_allclose(smoothed[:, m], states, atol=1e-9)
        np.testing.assert_allclose(weights[:, m], weight, atol=1e-9)
    assert weights[13:15, 0].max() < 0.2


def test_what_is_not_seen_is_bridged_and_less_sure() -> None:
    points, variance = noisy_points(2)
    smoothed, out_variance, _ = smooth_points(points, variance, PUSH, lag=None, degrees=None)
    gone = points.copy()
    gone[6:11, 2] = 99.0
    np.testing.assert_array_equal(smooth_points(gone, variance, PUSH, lag=None, degrees=None)[0], smoothed)
    assert out_variance[8, 2] > 4 * np.delete(out_variance[:, 2], range(5, 12))[2:-2].max()


def test_bad_points_are_refused() -> None:
    points, variance = noisy_points()
    with pytest.raises(ValueError, match="do not fit points"):
        smooth_points(points, variance[1:], PUSH)
    with pytest.raises(ValueError, match="acceleration_std must be positive"):
        smooth_points(points, variance, 0 * PUSH)
    with pytest.raises(ValueError, match="lag must be at least 0, got -2"):
        smooth_points(points, variance, PUSH, lag=-2)
    empty, _, _ = smooth_points(points[:0], variance[:0], PUSH)
    assert empty.shape == (0, M, 3)
