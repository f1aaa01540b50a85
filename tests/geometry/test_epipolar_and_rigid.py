"""Epipolar geometry, twists and angles against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from mocap.geometry.epipolar import epipolar_lines, fundamental_matrix, symmetric_epipolar_distance
from mocap.geometry.projection import project_points
from mocap.geometry.rigid import (
    matrix_from_rotation_vector,
    matrix_from_twist,
    rotation_vector_from_matrix,
    wrap_angle,
)

K_A = np.array([[610.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
K_B = np.array([[455.0, 1.5, 300.0], [0.0, 470.0, 210.0], [0.0, 0.0, 1.0]])
R_A, T_A = np.eye(3), np.array([0.0, 0.0, 4.0])
R_B = Rotation.from_euler("xyz", [0.1, 0.8, -0.2]).as_matrix()
T_B = np.array([-0.5, 0.2, 4.5])


def two_views(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    points = np.random.default_rng(3).uniform(-1, 1, (n, 3))

    def see(K: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
        x = (points @ R.T + t) @ K.T
        return x[:, :2] / x[:, 2:]

    return fundamental_matrix(K_A, R_A, T_A, K_B, R_B, T_B), see(K_A, R_A, T_A), see(K_B, R_B, T_B)


def test_corresponding_points_satisfy_the_epipolar_constraint() -> None:
    F, a, b = two_views(40)
    ones = np.ones((40, 1))
    value = np.einsum("ni,ij,nj->n", np.hstack([b, ones]), F, np.hstack([a, ones]))
    scale = np.linalg.norm(np.hstack([b, ones]), axis=1) * np.linalg.norm(np.hstack([a, ones]), axis=1)
    np.testing.assert_allclose(value / scale, 0.0, atol=1e-14)
    assert np.linalg.matrix_rank(F, tol=1e-12) == 2
    assert np.linalg.norm(F) == pytest.approx(1.0)


def test_projection_and_fundamental_matrix_share_one_convention() -> None:
    F, _, _ = two_views(1)
    point = np.array([[0.3, -0.6, 0.4]])
    uv_a, _ = project_points(point, K_A, np.zeros(4), R_A, T_A)
    K_square = np.array([[455.0, 0.0, 300.0], [0.0, 470.0, 210.0], [0.0, 0.0, 1.0]])
    F = fundamental_matrix(K_A, R_A, T_A, K_square, R_B, T_B)
    uv_b, _ = project_points(point, K_square, np.zeros(4), R_B, T_B)
    assert symmetric_epipolar_distance(F, uv_a, uv_b)[0] == pytest.approx(0.0, abs=1e-9)


def test_symmetric_distance_is_the_root_of_both_point_to_line_distances() -> None:
    F, a, b = two_views(7)
    shifted = b + np.random.default_rng(1).normal(0, 3.0, b.shape)
    expected = []
    for p, q in zip(a, shifted, strict=True):
        la, lb = F @ [*p, 1.0], F.T @ [*q, 1.0]
        d1 = (la @ [*q, 1.0]) / np.hypot(la[0], la[1])
        d2 = (lb @ [*p, 1.0]) / np.hypot(lb[0], lb[1])
        expected.append(np.sqrt(d1**2 + d2**2))
    np.testing.assert_allclose(symmetric_epipolar_distance(F, a, shifted), expected, rtol=1e-9)
    np.testing.assert_allclose(
        symmetric_epipolar_distance(F, a, shifted), symmetric_epipolar_distance(F.T, shifted, a), rtol=1e-9
    )
    lines = epipolar_lines(F, a)
    np.testing.assert_allclose(np.hypot(lines[:, 0], lines[:, 1]), 1.0)


def test_one_optical_centre_has_no_epipolar_geometry() -> None:
    with pytest.raises(ValueError, match="optical centre"):
        fundamental_matrix(K_A, R_A, T_A, K_B, R_B @ R_A, R_B @ T_A)


@given(
    angle=st.floats(-7, 7),
    axis=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 0.1),
    point=st.tuples(*[st.floats(-2, 2)] * 3),
)
def test_twist_is_the_matrix_exponential(
    angle: float, axis: tuple[float, ...], point: tuple[float, ...]
) -> None:
    """Closed form: expm of the 4 x 4 twist with v = -omega x q."""
    w, q = np.array(axis) / np.linalg.norm(axis), np.array(point)
    twist = np.zeros((4, 4))
    twist[:3, :3] = [[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]
    twist[:3, 3] = -np.cross(w, q)
    np.testing.assert_allclose(matrix_from_twist(w, q, angle), expm(twist * angle), atol=1e-11)


def test_twist_leaves_its_axis_alone() -> None:
    w, q = np.array([0.0, 0.6, 0.8]), np.array([0.3, -1.0, 2.0])
    T = matrix_from_twist(w, q, 1.234)
    for s in (-1.0, 0.0, 2.5):
        np.testing.assert_allclose(T @ [*(q + s * w), 1.0], [*(q + s * w), 1.0], atol=1e-12)


def test_rotation_vectors_round_trip() -> None:
    v = np.random.default_rng(0).uniform(-1.7, 1.7, (2, 5, 3))
    m = matrix_from_rotation_vector(v)
    assert m.shape == (2, 5, 3, 3)
    np.testing.assert_allclose(rotation_vector_from_matrix(m), v, atol=1e-12)


@given(angle=st.floats(-60, 60), turns=st.integers(-5, 5))
def test_wrapping(angle: float, turns: int) -> None:
    wrapped = float(wrap_angle(angle))
    assert -np.pi < wrapped <= np.pi
    assert np.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-9)
    again = float(wrap_angle(angle + 2 * np.pi * turns))
    assert np.cos(again - wrapped) == pytest.approx(1.0, abs=1e-9)


def test_wrapping_at_the_seam() -> None:
    np.testing.assert_allclose(
        wrap_angle(np.array([np.pi, -np.pi, 3 * np.pi, 0.0])), [np.pi, np.pi, np.pi, 0]
    )
