"""Errors in pixels: a known shift in front of a known camera."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap.data import Camera, CameraRig
from mocap.metrics import image_scores

K = np.array([[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]])


def camera(name, R=None, t=(0, 0, 4)):
    return Camera(name, (640, 480), K, np.zeros(5), np.eye(3) if R is None else R, np.array(t, float))


def test_a_shift_across_the_optical_axis_is_focal_length_over_depth():
    rig = CameraRig((camera("front"), camera("far", t=(0, 0, 8))))
    truth = np.random.default_rng(0).uniform(-0.5, 0.5, (6, 15, 3)) * [1, 1, 0]
    together, each = image_scores(truth + np.array([0.02, 0, 0]), truth, rig, epsilon_px=2.0)
    assert each["front"].mean_mm == pytest.approx(500 * 0.02 / 4)
    assert each["far"].mean_mm == pytest.approx(500 * 0.02 / 8)
    assert (each["front"].mmta_percent, each["far"].mmta_percent) == (0.0, 100.0)
    assert together.mmta_percent == pytest.approx(50.0)
    assert together.mean_mm == pytest.approx((2.5 + 1.25) / 2)


def test_a_shift_along_the_axis_is_hardly_seen_and_a_common_motion_not_at_all():
    rng = np.random.default_rng(1)
    truth = rng.uniform(-0.3, 0.3, (4, 15, 3))
    estimate = truth + rng.normal(0, 0.02, truth.shape)
    rig = CameraRig((camera("a"), camera("b", Rotation.from_euler("y", 1.0).as_matrix())))
    R, t = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 1, 3)
    moved = CameraRig(tuple(Camera(c.name, c.size, c.K, c.dist, c.R @ R.T, c.t - c.R @ R.T @ t) for c in rig))
    a = image_scores(estimate, truth, rig)[0]
    b = image_scores(estimate @ R.T + t, truth @ R.T + t, moved)[0]
    assert a.mean_mm == pytest.approx(b.mean_mm)
    along = image_scores(truth + np.array([0, 0, 0.01]), truth, rig.subset(["a"]))[0].mean_mm
    across = image_scores(truth + np.array([0.01, 0, 0]), truth, rig.subset(["a"]))[0].mean_mm
    assert along < 0.2 * across


def test_only_what_the_picture_holds_is_scored():
    rig = CameraRig((camera("a"),))
    truth = np.zeros((1, 3, 3))
    truth[0, 1, 0] = 9.0  # beside the picture
    truth[0, 2, 2] = -9.0  # behind the camera
    estimate = truth.copy()
    estimate[0, 0] = np.nan
    scores, _ = image_scores(estimate, truth, rig)
    assert (scores.n_scored, scores.n_missing, scores.mmta_percent) == (1, 1, 0.0)
    with pytest.raises(ValueError, match="epsilon_px"):
        image_scores(estimate, truth, rig, 0.0)
