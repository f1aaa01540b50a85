"""The smoother against a dense least-squares solution, and its limits."""

from __future__ import annotations

import numpy as np
import pytest

from mocap.filters.smoother import smooth_states

T, D = 12, 3
STRAIGHT = np.zeros(D, dtype=np.bool_)
ACCELERATION = np.array([0.02, 0.05, 0.1])


def walk() -> tuple[np.ndarray, np.ndarray]:
    """A smooth path (T, D), and information matrices (T, D, D) with correlations."""
    rng = np.random.default_rng(0)
    t = np.arange(T)[:, None]
    path = np.sin(0.4 * t + np.arange(D)) + 0.05 * rng.standard_normal((T, D))
    root = rng.standard_normal((T, D, D))
    return path, 80.0 * np.einsum("tij,tkj->tik", root, root)


def dense(path: np.ndarray, information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same as one least-squares problem over positions and velocities of all frames."""
    n = 2 * D
    H, b = np.zeros((T * n, T * n)), np.zeros(T * n)
    start = np.concatenate([np.full(D, 3.0), np.full(D, 0.5)])
    H[:n, :n] += np.diag(start**-2.0)
    b[:D] += path[0] / 9.0
    F = np.eye(n)
    F[:D, D:] = np.eye(D)
    push = np.vstack([0.5 * np.diag(ACCELERATION), np.diag(ACCELERATION)])
    # The accelerations' covariance has rank D; a little of everything makes it invertible.
    W = np.linalg.inv(push @ push.T + 1e-9 * np.eye(n))
    for i in range(T):
        rows = slice(i * n, i * n + D)
        H[rows, rows] += information[i]
        b[rows] += information[i] @ path[i]
        if i:
            A = np.zeros((n, T * n))
            A[:, (i - 1) * n : i * n], A[:, i * n : (i + 1) * n] = -F, np.eye(n)
            H += A.T @ W @ A
    P = np.linalg.inv(H)
    x = (P @ b).reshape(T, n)[:, :D]
    blocks = np.stack([P[i * n : i * n + D, i * n : i * n + D] for i in range(T)])
    return x, blocks


def test_it_solves_the_least_squares_problem() -> None:
    path, information = walk()
    states, covariance = smooth_states(path, information, ACCELERATION, STRAIGHT)
    expected, expected_P = dense(path, information)
    np.testing.assert_allclose(states, expected, atol=1e-4)
    np.testing.assert_allclose(covariance, expected_P, rtol=1e-2, atol=1e-6)


def test_certain_frames_stay_as_they_are() -> None:
    path, _ = walk()
    states, covariance = smooth_states(path, np.tile(1e9 * np.eye(D), (T, 1, 1)), ACCELERATION, STRAIGHT)
    np.testing.assert_allclose(states, path, atol=1e-4)
    assert np.einsum("tii->t", covariance).max() < 1e-6


def test_a_gap_is_bridged_with_growing_uncertainty() -> None:
    t = np.arange(T)[:, None] * np.ones((1, D))
    path = 0.1 * t
    information = np.tile(1e4 * np.eye(D), (T, 1, 1))
    path[4:9] = 77.0  # whatever stands there says nothing
    information[4:9] = 0.0
    states, covariance = smooth_states(path, information, ACCELERATION, STRAIGHT)
    np.testing.assert_allclose(states, 0.1 * t, atol=0.02)
    spread = np.einsum("tii->t", covariance)
    assert spread[6] > spread[4] > spread[2]
    assert np.all(np.linalg.eigvalsh(covariance) > -1e-12)


def test_smoothing_reduces_noise() -> None:
    rng = np.random.default_rng(3)
    clean = 0.5 * np.sin(0.1 * np.arange(60))[:, None] * np.ones((1, D))
    noisy = clean + 0.05 * rng.standard_normal(clean.shape)
    information = np.tile(400.0 * np.eye(D), (60, 1, 1))
    states, _ = smooth_states(noisy, information, np.full(D, 0.01), STRAIGHT)
    assert np.abs(states - clean).mean() < 0.6 * np.abs(noisy - clean).mean()


def test_circular_columns_pass_through_pi() -> None:
    angle = np.arange(T) * 0.3 + 2.5
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    path = np.column_stack([angle, wrapped, angle])
    circular = np.array([False, True, False])
    states, _ = smooth_states(path, np.tile(1e4 * np.eye(D), (T, 1, 1)), ACCELERATION, circular)
    np.testing.assert_allclose(np.cos(states[:, 1]), np.cos(states[:, 0]), atol=1e-3)
    assert np.abs(states[:, 1]).max() <= np.pi


def test_shapes_are_checked_and_nothing_is_nothing() -> None:
    path, information = walk()
    with pytest.raises(ValueError, match="do not fit states"):
        smooth_states(path, information[1:], ACCELERATION, STRAIGHT)
    states, covariance = smooth_states(path[:0], information[:0], ACCELERATION, STRAIGHT)
    assert states.shape == (0, D)
    assert covariance.shape == (0, D, D)
