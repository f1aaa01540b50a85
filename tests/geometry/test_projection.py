"""Projection and back: closed forms, OpenCV as the second implementation, and the fold of the distortion."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap.geometry._projection_kernels import MIN_DEPTH_M
from mocap.geometry.projection import max_normalised_radius, project_points, rays_from_pixels

K = np.array([[520.0, 0.0, 321.5], [0.0, 505.0, 238.25], [0.0, 0.0, 1.0]])
R = Rotation.from_euler("zyx", [0.3, -0.7, 1.9]).as_matrix()
T = np.array([0.2, -0.4, 3.1])
NONE = np.zeros(5)
BARREL = np.array([-0.28, 0.07, 0.0, 0.0, 0.0])
TANGENTIAL = np.array([-0.21, 0.05, 0.0012, -0.0009, 0.01])
FISHEYE = np.array([-0.013, 0.006, -0.002, 0.0003])

# Undistortion is iterative; 1e-12 in the normalised plane is the criterion, 2e-9 what is left in pixels.
ROUND_TRIP_PX = 1e-6


def points_before_camera(n: int, spread: float = 0.9) -> np.ndarray:
    rng = np.random.default_rng(5)
    cam = np.column_stack([rng.uniform(-spread, spread, (n, 2)), np.ones(n)]) * rng.uniform(0.7, 6.0, (n, 1))
    return (cam - T) @ R


def test_pinhole_is_the_closed_form() -> None:
    points = points_before_camera(50)
    cam = points @ R.T + T
    expected = cam[:, :2] / cam[:, 2:] * [K[0, 0], K[1, 1]] + [K[0, 2], K[1, 2]]
    uv, depth = project_points(points, K, NONE, R, T)
    np.testing.assert_allclose(uv, expected, atol=1e-9)
    np.testing.assert_allclose(depth, cam[:, 2], atol=1e-12)


def test_radial_distortion_is_one_plus_k1_r2_plus_k2_r4() -> None:
    """The slip of the source (k2 r^2) would fail here (reading guide 1)."""
    k1, k2 = BARREL[:2]
    points = points_before_camera(40)
    cam = points @ R.T + T
    xy = cam[:, :2] / cam[:, 2:]
    r2 = (xy**2).sum(axis=1, keepdims=True)
    expected = xy * (1 + k1 * r2 + k2 * r2**2) * [K[0, 0], K[1, 1]] + [K[0, 2], K[1, 2]]
    uv, _ = project_points(points, K, BARREL, R, T)
    ok = np.isfinite(uv[:, 0])
    assert ok.sum() > 30
    np.testing.assert_allclose(uv[ok], expected[ok], atol=1e-9)


RATIONAL = np.array([0.1, -0.2, 0.01, 0.003, 0.05, 0.02, 0.01, 0.003])
TILTED = np.array([*RATIONAL, 0.01, -0.02, 0.005, 0.004, 0.03, -0.02])


@pytest.mark.parametrize("dist", [NONE, BARREL, TANGENTIAL, RATIONAL, TILTED])
def test_agrees_with_opencv(dist: np.ndarray) -> None:
    points = points_before_camera(30, spread=0.5)
    rvec, _ = cv2.Rodrigues(R)
    expected, _ = cv2.projectPoints(points.reshape(-1, 1, 3), rvec, T, K, dist)
    uv, _ = project_points(points, K, dist, R, T)
    np.testing.assert_allclose(uv, expected.reshape(-1, 2), atol=1e-8)


def test_fisheye_agrees_with_opencv() -> None:
    points, dist = points_before_camera(30, spread=0.8), np.array([0.05, -0.02, 0.003, 0.001])
    rvec, _ = cv2.Rodrigues(R)
    expected, _ = cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), rvec, T, K, dist)
    uv, _ = project_points(points, K, dist, R, T, is_fisheye=True)
    np.testing.assert_allclose(uv, expected.reshape(-1, 2), atol=1e-8)


def test_fisheye_is_the_closed_form() -> None:
    points = points_before_camera(45, spread=3.0)
    cam = points @ R.T + T
    theta = np.arctan2(np.hypot(cam[:, 0], cam[:, 1]), cam[:, 2])
    t2 = theta**2
    k = FISHEYE
    distorted = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    direction = cam[:, :2] / np.linalg.norm(cam[:, :2], axis=1, keepdims=True)
    expected = direction * distorted[:, None] * [K[0, 0], K[1, 1]] + [K[0, 2], K[1, 2]]
    uv, _ = project_points(points, K, FISHEYE, R, T, is_fisheye=True)
    np.testing.assert_allclose(uv, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("dist", "is_fisheye", "spread"),
    [(NONE, False, 0.9), (BARREL, False, 0.6), (TANGENTIAL, False, 0.6), (FISHEYE, True, 0.9)],
)
def test_rays_lead_back_to_the_points(dist: np.ndarray, is_fisheye: bool, spread: float) -> None:
    points = points_before_camera(33, spread)
    uv, _ = project_points(points, K, dist, R, T, is_fisheye=is_fisheye)
    rays = rays_from_pixels(uv, K, dist, R, is_fisheye=is_fisheye)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, atol=1e-12)
    center = -R.T @ T
    again, _ = project_points(center + 2.7 * rays, K, dist, R, T, is_fisheye=is_fisheye)
    np.testing.assert_allclose(again, uv, atol=ROUND_TRIP_PX)


def test_behind_the_camera_and_nan_give_nan_but_depth() -> None:
    cam = np.array([[0.1, 0.2, -2.0], [0.0, 0.0, 0.0], [0.0, 0.0, MIN_DEPTH_M / 2], [np.nan, 0.0, 1.0]])
    uv, depth = project_points((cam - T) @ R, K, BARREL, R, T)
    assert np.isnan(uv).all()
    np.testing.assert_allclose(depth[:3], cam[:3, 2], atol=1e-12)


def test_empty_input_and_batch_shapes() -> None:
    uv, depth = project_points(np.zeros((0, 3)), K, BARREL, R, T)
    assert uv.shape == (0, 2)
    assert depth.shape == (0,)
    uv, depth = project_points(points_before_camera(24).reshape(2, 3, 4, 3), K, NONE, R, T)
    assert uv.shape == (2, 3, 4, 2)
    assert depth.shape == (2, 3, 4)
    assert rays_from_pixels(np.zeros((0, 2)), K, NONE, R).shape == (0, 3)
    assert rays_from_pixels(uv, K, NONE, R).shape == (2, 3, 4, 3)


def test_nan_pixels_give_nan_rays() -> None:
    uv = np.array([[100.0, 50.0], [np.nan, np.nan]])
    for is_fisheye, dist in ((False, BARREL), (True, FISHEYE)):
        rays = rays_from_pixels(uv, K, dist, R, is_fisheye=is_fisheye)
        assert np.isfinite(rays[0]).all()
        assert np.isnan(rays[1]).all()


@pytest.mark.parametrize("k1", [-0.05, -0.2, -0.45])
def test_fold_of_one_coefficient_is_the_closed_form(k1: float) -> None:
    """d/dr (r + k1 r^3) = 0 at r = 1 / sqrt(-3 k1)."""
    fold = max_normalised_radius(np.array([k1, 0.0, 0.0, 0.0]), False)
    assert fold == pytest.approx(1 / np.sqrt(-3 * k1), rel=2e-3)
    theta = max_normalised_radius(np.array([k1, 0.0, 0.0, 0.0]), True)
    assert theta == pytest.approx(1 / np.sqrt(-3 * k1), rel=2e-3)


def test_no_distortion_never_folds() -> None:
    assert max_normalised_radius(NONE, False) == np.inf
    assert max_normalised_radius(np.zeros(4), True) == np.inf
    assert max_normalised_radius(np.array([0.1, 0.02, 0.0, 0.0]), False) == np.inf


def test_a_point_beyond_the_fold_does_not_appear_in_the_picture() -> None:
    """k1 = -0.45 folds at r = 0.86 and comes back to the centre at r = 1.49: OpenCV shows such a point, we do not."""
    dist = np.array([-0.45, 0.0, 0.0, 0.0])
    point = np.array([[1.45, 0.0, 1.0]])
    shown, _ = cv2.projectPoints(point.reshape(1, 1, 3), np.zeros(3), np.zeros(3), K, dist)
    assert 0 < shown[0, 0, 0] < 640
    uv, depth = project_points(point, K, dist, np.eye(3), np.zeros(3))
    assert np.isnan(uv).all()
    assert depth[0] == 1.0


@given(
    k1=st.floats(-0.5, 0.3),
    k2=st.floats(-0.2, 0.3),
    azimuth=st.floats(0, 2 * np.pi),
    radius=st.floats(-2.0, 1.5).map(lambda e: 10.0**e),
)
def test_farther_out_never_lands_further_in(k1: float, k2: float, azimuth: float, radius: float) -> None:
    """Invariance: along a ray from the axis, pixels move outwards or vanish; nothing folds back in."""
    dist = np.array([k1, k2, 0.0, 0.0])
    r = radius * np.array([1.0, 1.05, 1.3, 2.0, 10.0])
    cam = np.column_stack([r * np.cos(azimuth), r * np.sin(azimuth), np.ones(5)])
    uv, _ = project_points(cam, np.eye(3), dist, np.eye(3), np.zeros(3))
    distance = np.hypot(uv[:, 0], uv[:, 1])
    seen = np.isfinite(distance)
    assert np.all(np.diff(seen.astype(int)) <= 0), "a point beyond an unseen one is seen"
    assert np.all(np.diff(distance[seen]) >= -1e-9)


@pytest.mark.parametrize(("k1", "k2"), [(-0.5, 0.05), (0.1, -0.05), (-0.011, 0.0)])
def test_fold_of_two_coefficients_is_the_closed_form(k1: float, k2: float) -> None:
    """1 + 3 k1 r^2 + 5 k2 r^4 = 0; the last one folds far outside any usual picture, at r = 5.5."""
    roots = np.roots([5 * k2, 3 * k1, 1.0] if k2 else [3 * k1, 1.0])
    expected = np.sqrt(min(r.real for r in roots if abs(r.imag) < 1e-12 and r.real > 0))
    assert max_normalised_radius(np.array([k1, k2, 0.0, 0.0]), False) == pytest.approx(expected, rel=1e-2)
    if expected < np.pi:
        assert max_normalised_radius(np.array([k1, k2, 0.0, 0.0]), True) == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("k4", [-0.05, 0.2, 0.6])
def test_fold_of_a_rational_model_is_where_its_derivative_vanishes(k4: float) -> None:
    """f = r (1 + k1 s) / (1 + k4 s), s = r^2: the numerator of f' is 1 + (3 k1 - k4) s + k1 k4 s^2."""
    k1 = -0.2
    fold = max_normalised_radius(np.array([k1, 0.0, 0.0, 0.0, 0.0, k4, 0.0, 0.0]), False)
    roots = np.roots([k1 * k4, 3 * k1 - k4, 1.0])
    expected = np.sqrt(min(r.real for r in roots if abs(r.imag) < 1e-12 and r.real > 0))
    assert fold == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("is_fisheye", [False, True])
def test_strong_distortion_shows_nothing_beyond_its_fold(is_fisheye: bool) -> None:
    dist = np.array([-0.5, 0.05, 0.0, 0.0])
    fold = max_normalised_radius(dist, is_fisheye)
    reach = np.array([0.98, 1.02, 1.3]) * fold
    across = np.tan(reach) if is_fisheye else reach
    points = np.column_stack([across, np.zeros(3), np.ones(3)])
    uv, _ = project_points(points, K, dist, np.eye(3), np.zeros(3), is_fisheye=is_fisheye)
    assert np.isfinite(uv[0]).all()
    assert np.isnan(uv[1:]).all()
