"""Inverse kinematics on the reference skeleton: exact on a body of constant sizes, steadier on a noisy one."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap.compare import Pair
from mocap.compare.detail import angles_on_reference_skeleton
from mocap.data import FURTHER_LANDMARKS, LANDMARKS
from mocap.metrics import ANGLES, angle_differences, fit_reference_skeleton, joint_angles
from mocap.metrics.points import torso_rotation
from mocap.metrics.reference import SEGMENTS, _forward, _jacobian, _moved, _sizes, _start

AT = LANDMARKS.index
# Over 40 seeds the fit took off 14.7-24.4 % of the mean angle error that 20 mm of noise cause, and left 21.8-23.6 mm:
# 20 sqrt(3) mm times the square root of (45 - 25) / 45.
LEAST_GAIN = 0.10
RESIDUAL_MM = (21.0, 24.5)


def walk(T, rng):
    """A body of constant segment lengths in random poses, (T, 15, 3) m."""
    x = np.zeros((T, 15, 3))
    for t in range(T):
        R = Rotation.from_rotvec(rng.normal([0, 0, rng.uniform(-3, 3)], 0.4))
        S = R * Rotation.from_euler("z", rng.uniform(-0.6, 0.6))
        p = rng.normal(0, 1, 3)
        x[t, AT("pelvis")] = p
        x[t, AT("neck")] = neck = p + R.apply([0, 0, 0.5])
        x[t, AT("head")] = neck + 0.28 * unit(S.apply([0, 0, 1]) + rng.normal(0, 0.2, 3))
        for side, sign in (("left", 1), ("right", -1)):
            x[t, AT(f"{side}_hip")] = hip = p + R.apply([0, 0.09 * sign, -0.02])
            x[t, AT(f"{side}_shoulder")] = shoulder = neck + S.apply([0, 0.19 * sign, -0.04])
            for start, names, lengths in (
                (hip, ("knee", "ankle"), (0.43, 0.41)),
                (shoulder, ("elbow", "wrist"), (0.3, 0.26)),
            ):
                direction = unit(rng.normal([0, 0, -1], 0.5))
                for name, length in zip(names, lengths, strict=True):
                    start = start + length * direction
                    x[t, AT(f"{side}_{name}")] = start
                    direction = unit(direction + rng.normal(0, 0.5, 3))
    return x


def unit(v):
    return v / np.linalg.norm(v)


def test_a_body_of_constant_sizes_is_fitted_exactly():
    """Two ways to the same angles: closed form from the landmarks, and the fit."""
    x = walk(30, np.random.default_rng(1))
    fit = fit_reference_skeleton(x)
    np.testing.assert_allclose(fit.landmarks, x, atol=1e-9)
    np.testing.assert_allclose(fit.angles, joint_angles(x), atol=1e-7)
    assert fit.residual_mm.max() < 1e-6
    assert fit.lengths_m["left_knee"] == pytest.approx(0.43)
    assert fit.lengths_m["right_wrist"] == pytest.approx(0.26)


def test_landmarks_off_the_body_are_pulled_back_to_it():
    """Segments of the fit have one length each, and the fit is no farther from the data than the true body."""
    rng = np.random.default_rng(2)
    x = walk(60, rng)
    noisy = x + rng.normal(0, 0.02, x.shape)
    fit = fit_reference_skeleton(noisy)
    for end, begin in SEGMENTS.items():
        length = np.linalg.norm(fit.landmarks[:, AT(end)] - fit.landmarks[:, AT(begin)], axis=1)
        np.testing.assert_allclose(length, fit.lengths_m[end], atol=1e-9)
    assert RESIDUAL_MM[0] < fit.residual_mm.mean() < RESIDUAL_MM[1]
    truth = joint_angles(x)
    direct = angle_differences(joint_angles(noisy), truth).mean_deg
    fitted = angle_differences(fit.angles, truth).mean_deg
    assert fitted < (1 - LEAST_GAIN) * direct


def test_the_fit_is_a_minimum():
    """At the solution the gradient vanishes, and no small step comes closer."""
    rng = np.random.default_rng(3)
    x = walk(5, rng) + rng.normal(0, 0.03, (5, 15, 3))
    best = (fit_reference_skeleton(x).residual_mm ** 2).copy()
    R, S = torso_rotation(x, "hip"), torso_rotation(x, "shoulder")
    sizes = _sizes(x, R, S)
    fitted = fit_reference_skeleton(x).landmarks
    state = _start(fitted, torso_rotation(fitted, "hip"), torso_rotation(fitted, "shoulder"))
    np.testing.assert_allclose(_forward(state, sizes), fitted, atol=1e-6)
    J, bases = _jacobian(state, sizes)
    gradient = np.einsum("tmic,tmi->tc", J, fitted - x)
    assert np.abs(gradient).max() < 1e-5
    for _ in range(20):
        step = rng.normal(0, 1e-3, (5, J.shape[3]))
        away = _forward(_moved(state, step, bases), sizes)
        assert (1e6 * ((away - x) ** 2).sum(axis=(1, 2)) / 15 >= best - 1e-6).all()


def test_the_jacobian_is_the_derivative():
    rng = np.random.default_rng(4)
    x = walk(7, rng) + rng.normal(0, 0.02, (7, 15, 3))
    R, S = torso_rotation(x, "hip"), torso_rotation(x, "shoulder")
    state, sizes = _start(x, R, S), _sizes(x, R, S)
    J, bases = _jacobian(state, sizes)
    h = 1e-6
    for i in range(J.shape[3]):
        step = np.zeros((7, J.shape[3]))
        step[:, i] = h
        difference = _forward(_moved(state, step, bases), sizes) - _forward(
            _moved(state, -step, bases), sizes
        )
        np.testing.assert_allclose(J[..., i], difference / (2 * h), atol=1e-7)


def test_place_heading_and_size_do_not_matter():
    rng = np.random.default_rng(5)
    x = walk(10, rng) + rng.normal(0, 0.02, (10, 15, 3))
    R, t = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 3, 3)
    a, b = fit_reference_skeleton(x), fit_reference_skeleton(1.3 * x @ R.T + t)
    np.testing.assert_allclose(a.angles, b.angles, atol=1e-5)


def test_what_is_unknown_stays_unknown_and_disturbs_nothing():
    x = walk(12, np.random.default_rng(6))
    lost = x.copy()
    lost[2, AT("left_wrist")] = np.nan
    lost[3, AT("left_elbow")] = np.nan
    lost[4, AT("right_hip")] = np.nan
    lost[5] = np.nan
    fit = fit_reference_skeleton(lost)
    names = list(ANGLES)
    expected = joint_angles(x)
    elbow, knee = names.index("left_elbow"), names.index("right_knee")
    assert np.isnan(fit.angles[[2, 3, 5], elbow]).all()
    np.testing.assert_allclose(fit.angles[[2, 3], knee], expected[[2, 3], knee], atol=1e-6)
    assert np.isnan(fit.angles[[4, 5]]).all()
    assert np.isnan(fit.residual_mm[[4, 5]]).all()
    nothing = fit_reference_skeleton(np.full((3, 15, 3), np.nan))
    assert np.isnan(nothing.angles).all()
    assert np.isnan(nothing.lengths_m["head"])
    assert fit_reference_skeleton(x[:0]).angles.shape == (0, 15)
    no_legs = x.copy()
    no_legs[:, [AT("left_ankle"), AT("left_knee")]] = np.nan
    np.testing.assert_allclose(fit_reference_skeleton(no_legs).angles[:, knee], expected[:, knee], atol=1e-6)
    with pytest.raises(ValueError, match="landmarks"):
        fit_reference_skeleton(np.zeros((3, 14, 3)))


def test_scores_take_only_matched_landmarks():
    x = walk(8, np.random.default_rng(7))
    y = x.copy()
    y[:, AT("left_wrist")] += 0.5
    further = np.full((8, len(FURTHER_LANDMARKS), 3), np.nan)
    pair = Pair(1, np.arange(8), y, x, np.full_like(x, np.nan), np.ones(x.shape[:2], bool), further, further)
    gated, open_ = (angles_on_reference_skeleton([pair], e) for e in (100.0, None))
    assert np.isnan(gated.per_angle_deg[list(ANGLES).index("left_elbow")])
    assert open_.per_angle_deg[list(ANGLES).index("left_elbow")] > 1.0
    assert gated.mean_deg == pytest.approx(0.0, abs=1e-5)
    assert angles_on_reference_skeleton([], 100.0).mean_deg is None
