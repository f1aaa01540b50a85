"""Angles of the reference skeleton: a pose built from known angles gives them back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap.data import LANDMARKS
from mocap.metrics import ANGLES, angle_scores, joint_angles

AT = LANDMARKS.index


def figure(*, elbow=0.0, knee=0.0, swing_leg=0.0, twist=0.0, arm_up=0.0, scale=1.0):
    """T-pose, x forward, y left, z up, with the named angles set; (1, 15, 3) m."""
    x = np.zeros((15, 3))
    x[AT("neck")], x[AT("head")] = (0, 0, 0.5), (0, 0, 0.8)
    turn = Rotation.from_euler("z", twist)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        shoulder = np.array([0, 0.2 * sign, 0.5])
        hip = np.array([0, 0.1 * sign, 0.0])
        arm = Rotation.from_euler("x", sign * arm_up)
        upper = arm.apply([0, 0.3 * sign, 0])
        fore = arm.apply(Rotation.from_euler("z", -sign * elbow).apply([0, 0.25 * sign, 0]))
        leg = Rotation.from_euler("y", -swing_leg)
        thigh = leg.apply([0, 0, -0.45])
        shank = leg.apply(Rotation.from_euler("y", knee).apply([0, 0, -0.4]))
        x[AT(f"{side}_shoulder")] = turn.apply(shoulder)
        x[AT(f"{side}_elbow")] = turn.apply(shoulder + upper)
        x[AT(f"{side}_wrist")] = turn.apply(shoulder + upper + fore)
        x[AT(f"{side}_hip")], x[AT(f"{side}_knee")] = hip, hip + thigh
        x[AT(f"{side}_ankle")] = hip + thigh + shank
    x[AT("head")] = turn.apply(x[AT("head")])
    return scale * x[None]


def angle(pose, name):
    return joint_angles(pose)[0, list(ANGLES).index(name)]


def test_t_pose_is_all_zero():
    np.testing.assert_allclose(joint_angles(figure()), 0.0, atol=1e-12)


@pytest.mark.parametrize("value", [-2.5, -0.3, 0.2, 1.5, 3.0])
def test_each_angle_is_read_back_alone(value):
    bend = abs(value)
    cases = {
        "torso_twist": (figure(twist=value), value),
        "left_elbow": (figure(elbow=bend), bend),
        "right_knee": (figure(knee=bend), bend),
        "left_hip_front": (figure(swing_leg=value), -value),
        "left_shoulder_up": (figure(arm_up=value), value),
        "right_shoulder_up": (figure(arm_up=value), -value),
    }
    for name, (pose, expected) in cases.items():
        assert angle(pose, name) == pytest.approx(expected, abs=1e-9), name
        others = [n for n in ANGLES if n[-5:] != name[-5:]]
        for other in others:
            assert angle(pose, other) == pytest.approx(0.0, abs=1e-9), (name, other)


def test_error_of_a_bent_knee_is_shared_by_all_angles():
    s = angle_scores(figure(knee=0.3), figure())
    assert s.mean_deg == pytest.approx(2 * np.degrees(0.3) / 15)
    assert s.per_angle_deg[list(ANGLES).index("left_knee")] == pytest.approx(np.degrees(0.3))


def test_differences_are_wrapped():
    """A twist of +175 and one of -175 degrees are 10 degrees apart."""
    s = angle_scores(figure(twist=np.radians(175)), figure(twist=np.radians(-175)))
    assert s.per_angle_deg[0] == pytest.approx(10.0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_place_size_and_heading_do_not_matter(seed):
    rng = np.random.default_rng(seed)
    pose = figure(elbow=1.0, knee=0.5, swing_leg=0.4, twist=0.2, arm_up=-1.0)
    R, t = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 3, 3)
    moved = rng.uniform(0.5, 2.0) * (pose @ R.T) + t
    np.testing.assert_allclose(joint_angles(moved), joint_angles(pose), atol=1e-9)
    assert angle_scores(moved, pose).mean_deg == pytest.approx(0.0, abs=1e-6)


def test_only_matched_landmarks_are_compared():
    truth = figure()
    estimate = truth.copy()
    estimate[0, AT("left_wrist")] += [0.0, 0.0, 0.4]
    assert angle_scores(estimate, truth).mean_deg > 1.0
    gated = angle_scores(estimate, truth, epsilon_mm=100.0)
    assert gated.mean_deg == pytest.approx(0.0, abs=1e-6)
    assert np.isnan(gated.per_angle_deg[list(ANGLES).index("left_elbow")])


def test_unknown_and_degenerate_landmarks_are_left_out():
    truth = np.repeat(figure(), 3, axis=0)
    estimate = truth.copy()
    estimate[0] = np.nan
    estimate[1, AT("left_elbow")] = estimate[1, AT("left_shoulder")]
    s = angle_scores(estimate, truth)
    assert s.n_frames == 2
    assert s.mean_deg == pytest.approx(0.0, abs=1e-6)
    nothing = angle_scores(np.full_like(truth, np.nan), truth)
    assert (nothing.mean_deg, nothing.std_deg, nothing.n_frames) == (None, None, 0)
    assert angle_scores(truth[:0], truth[:0]).mean_deg is None
    with pytest.raises(ValueError, match="landmarks"):
        joint_angles(np.zeros((2, 14, 3)))


@pytest.mark.parametrize("twist", [-0.6, 0.9])
def test_legs_are_seen_from_the_hips_and_arms_from_the_shoulders(twist):
    pose = figure(twist=twist, swing_leg=0.4, arm_up=0.7)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        assert angle(pose, f"{side}_hip_front") == pytest.approx(-0.4)
        assert angle(pose, f"{side}_hip_side") == pytest.approx(0.0, abs=1e-9)
        assert angle(pose, f"{side}_shoulder_up") == pytest.approx(sign * 0.7)
        assert angle(pose, f"{side}_shoulder_front") == pytest.approx(0.0, abs=1e-9)
