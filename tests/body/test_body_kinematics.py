"""Forward kinematics: kernel against products of exponentials, and what no pose can change."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap.body import (
    Body,
    cones_of,
    joint_transforms,
    landmarks_of,
    load_body_model,
    neutral_state,
    scale_body,
    skeleton_of,
)
from mocap.body._kernels import forward_kinematics, transforms_kernel
from mocap.body.kinematics import cones_of_particles, point_jacobian, transforms_by_exponentials
from mocap.data import LANDMARKS
from mocap.geometry.rigid import matrix_from_twist

BODIES = {
    name: scale_body(load_body_model(name), 1.72) for name in ("anthropometric", "girdle", "thesis", "whole")
}


def random_states(body: Body, n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    low = np.where(np.isfinite(body.layout.lower), body.layout.lower, -3.0)
    high = np.where(np.isfinite(body.layout.upper), body.layout.upper, 3.0)
    return low + rng.random((n, len(low))) * (high - low)


@pytest.mark.parametrize("name", BODIES)
def test_kernel_is_the_product_of_exponentials(name: str) -> None:
    body = BODIES[name]
    states = random_states(body, 17)
    R, t = joint_transforms(body, states)
    for i, state in enumerate(states):
        R_slow, t_slow = transforms_by_exponentials(body, state)
        np.testing.assert_allclose(R[i], R_slow, atol=1e-12)
        np.testing.assert_allclose(t[i], t_slow, atol=1e-12)
    np.testing.assert_allclose(R @ R.swapaxes(-1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)


def test_the_order_of_the_factors_matters() -> None:
    """The source says that it does not (reading guide 18); two twists with axes that meet prove it wrong."""
    a = matrix_from_twist(np.array([1.0, 0.0, 0.0]), np.zeros(3), 0.7)
    b = matrix_from_twist(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.2, 0.0]), -1.1)
    assert np.abs(a @ b - b @ a).max() > 0.1


def test_rotations_of_a_joint_are_applied_in_the_order_of_the_file() -> None:
    """Closed form: the left shoulder's frame is Rx Ry Rz of the waist's."""
    body = BODIES["anthropometric"]
    state = np.zeros(body.layout.n_columns)
    angles = [0.4, -0.9, 0.6]
    for axis, angle in zip("xyz", angles, strict=True):
        state[body.layout.names.index(f"left_shoulder_{axis}")] = angle
    R, _ = joint_transforms(body, state[None])
    expected = Rotation.from_euler("XYZ", angles).as_matrix()
    np.testing.assert_allclose(R[0, body.joints.index("left_shoulder")], expected, atol=1e-12)


@pytest.mark.parametrize("name", BODIES)
def test_derivatives_of_points_are_differences(name: str) -> None:
    body, step = BODIES[name], 1e-6
    state = random_states(body, 1, seed=3)[0]
    _, derivatives, _ = point_jacobian(body, state, body.landmark_joint, body.landmark_offset)
    steps = step * np.eye(len(state))
    difference = (landmarks_of(body, state + steps) - landmarks_of(body, state - steps)) / (2 * step)
    np.testing.assert_allclose(derivatives, np.moveaxis(difference, 0, -1), atol=1e-8)


@pytest.mark.parametrize("name", ["thesis", "whole"])
def test_python_twin_of_the_kernels(name: str) -> None:
    body = BODIES[name]
    states = random_states(body, 3, seed=8)
    R, t = joint_transforms(body, states)
    R_py, t_py = np.empty_like(R), np.empty_like(t)
    for n in range(3):
        forward_kinematics.py_func(states[n], *body.chain, R_py[n], t_py[n])
    np.testing.assert_allclose(R_py, R, atol=1e-13)
    np.testing.assert_allclose(t_py, t, atol=1e-13)
    R_py[:], t_py[:] = 0, 0
    transforms_kernel.py_func(states, body.chain, R_py, t_py)
    np.testing.assert_allclose(t_py, t, atol=1e-13)


@given(seed=st.integers(0, 10_000))
def test_limb_lengths_do_not_depend_on_the_pose(seed: int) -> None:
    body = BODIES["anthropometric"]
    states = np.vstack([np.zeros(body.layout.n_columns), random_states(body, 4, seed)])
    points = landmarks_of(body, states)
    rigid = (
        ("neck", "head"),
        ("left_shoulder", "left_elbow"),
        ("left_elbow", "left_wrist"),
        ("right_shoulder", "neck"),
        ("left_shoulder", "right_shoulder"),
        ("pelvis", "neck"),
        ("pelvis", "right_hip"),
        ("left_hip", "right_hip"),
        ("right_hip", "right_knee"),
        ("right_knee", "right_ankle"),
    )
    for a, b in rigid:
        length = np.linalg.norm(points[:, LANDMARKS.index(a)] - points[:, LANDMARKS.index(b)], axis=1)
        np.testing.assert_allclose(length, length[0], atol=1e-12)


def test_the_root_moves_everything_rigidly() -> None:
    """Invariance: turning and shifting the root is a rigid motion of all landmarks."""
    body = BODIES["anthropometric"]
    state = random_states(body, 1, seed=3)[0]
    yaw = body.layout.names.index("root_yaw")
    moved = state.copy()
    turn = Rotation.from_rotvec([0, 0, 0.8]).as_matrix()
    moved[:3] = turn @ state[:3] + [0.3, -1.0, 0.2]
    moved[yaw] += 0.8
    a, b = landmarks_of(body, np.stack([state, moved]))
    np.testing.assert_allclose(b, a @ turn.T + [0.3, -1.0, 0.2], atol=1e-12)


def test_signs_of_the_joints() -> None:
    """Knees bend backwards, elbows forwards, arms hang, facing +x: what the names promise."""
    body = BODIES["anthropometric"]
    names = body.layout.names

    def at(**angles: float) -> dict[str, np.ndarray]:
        state = np.zeros(body.layout.n_columns)
        for name, value in angles.items():
            state[names.index(name)] = value
        return dict(zip(LANDMARKS, landmarks_of(body, state[None])[0], strict=True))

    rest = at()
    assert rest["left_wrist"][1] > rest["left_shoulder"][1] > 0 > rest["right_shoulder"][1]
    assert (
        rest["head"][2] > rest["neck"][2] > rest["pelvis"][2] > rest["left_knee"][2] > rest["left_ankle"][2]
    )
    bent = at(left_knee_y=1.0, right_knee_y=1.0, left_elbow_z=-1.0, right_elbow_z=1.0)
    for side in ("left", "right"):
        assert bent[f"{side}_ankle"][0] < bent[f"{side}_knee"][0] - 0.1
        assert bent[f"{side}_wrist"][0] > bent[f"{side}_elbow"][0] + 0.1
    strided = at(right_hip_y=-0.5)
    assert strided["right_knee"][0] > 0.1
    neutral = landmarks_of(body, neutral_state(body)[None])[0]
    assert neutral[LANDMARKS.index("left_wrist"), 2] < neutral[LANDMARKS.index("left_shoulder"), 2] - 0.3


@pytest.mark.parametrize("name", BODIES)
def test_neutral_pose_is_legal_and_stands_on_the_floor(name: str) -> None:
    body = BODIES[name]
    state = neutral_state(body)
    assert np.all(state >= body.layout.lower)
    assert np.all(state <= body.layout.upper)
    start, end = cones_of(body, state)
    lowest = min(float((e[:, 2] - body.cones.radii[:, i]).min()) for i, e in enumerate((start, end)))
    assert lowest == pytest.approx(0.0, abs=1e-12)


def test_skeleton_gives_the_landmarks_back() -> None:
    """Two implementations: local rotations chained by the skeleton against the landmarks of the states."""
    body = BODIES["anthropometric"]
    states = random_states(body, 5, seed=11)
    skeleton = skeleton_of(body, states, 3)
    points = skeleton.global_positions()
    landmarks = landmarks_of(body, states)
    for name in ("left_knee", "right_elbow", "neck", "left_hip"):
        np.testing.assert_allclose(
            points[:, skeleton.names.index(name)], landmarks[:, LANDMARKS.index(name)], atol=1e-12
        )
    _, t = joint_transforms(body, states)
    np.testing.assert_allclose(points, t, atol=1e-12)
    leaves = {skeleton.names[j] for j in skeleton.end_offsets}
    assert leaves == {"neck", "left_elbow", "right_elbow", "left_knee", "right_knee"}
    wrist = skeleton.end_offsets[skeleton.names.index("left_elbow")]
    np.testing.assert_allclose(wrist, body.landmark_offset[LANDMARKS.index("left_wrist")])


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"states has shape \(27,\)"):
        joint_transforms(BODIES["thesis"], np.zeros(27))
    with pytest.raises(ValueError, match="expected"):
        joint_transforms(BODIES["thesis"], np.zeros((2, 26)))


def test_nan_reaches_only_what_hangs_on_the_joint() -> None:
    state = np.zeros((1, 27))
    state[0, BODIES["thesis"].layout.names.index("left_elbow_z")] = np.nan
    points = landmarks_of(BODIES["thesis"], state)[0]
    reached = [LANDMARKS.index("left_elbow"), LANDMARKS.index("left_wrist")]
    assert np.isnan(points[reached]).any(axis=1).all()
    assert np.isfinite(np.delete(points, reached, axis=0)).all()


@pytest.mark.parametrize("name", BODIES)
def test_some_cones_of_many_states_are_those_of_the_whole_body(name: str) -> None:
    """They are placed by the joints above them alone."""
    body = BODIES[name]
    states = random_states(body, 5)
    for part in range(body.layout.n_parts):
        which = body.cones.part == part
        start, end = cones_of_particles(body, states, which)
        for i, state in enumerate(states):
            every_start, every_end = cones_of(body, state)
            np.testing.assert_allclose(start[i], every_start[which], atol=1e-12)
            np.testing.assert_allclose(end[i], every_end[which], atol=1e-12)
