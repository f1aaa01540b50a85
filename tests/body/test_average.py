"""The mean of poses as rotations: against scipy, against the arithmetic mean, and inside the limits."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap.body import joint_transforms, landmarks_of, load_body_model, neutral_state, scale_body
from mocap.body.average import mean_rotation, mean_state

BODY = scale_body(load_body_model("anthropometric"), 1.7)
NAMES = BODY.layout.names


def spread_states(scale: float, n: int = 40, seed: int = 2) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    states = neutral_state(BODY) + scale * rng.standard_normal((n, len(NAMES)))
    weights = rng.random(n)
    return np.clip(states, BODY.layout.lower, BODY.layout.upper), weights / weights.sum()


def test_the_mean_rotation_is_scipys() -> None:
    R = Rotation.random(17, random_state=3)
    weights = np.random.default_rng(0).random(17)
    np.testing.assert_allclose(mean_rotation(R.as_matrix(), weights), R.mean(weights).as_matrix(), atol=1e-9)


def test_rotations_that_cancel_out_have_no_mean() -> None:
    turns = Rotation.from_rotvec(np.pi / 2 * np.arange(4)[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    flips = turns @ Rotation.from_rotvec([np.pi, 0, 0]).as_matrix()
    with pytest.raises(ValueError, match="no mean"):
        mean_rotation(np.concatenate([turns, flips]), np.full(8, 0.125))
    with pytest.raises(ValueError, match="no mean"):
        mean_rotation(turns, np.zeros(4))


def test_the_mean_of_equal_poses_is_the_pose() -> None:
    states, _ = spread_states(0.3, n=1)
    np.testing.assert_allclose(
        mean_state(BODY, np.repeat(states, 5, axis=0), np.full(5, 0.2), states[0]), states[0], atol=1e-9
    )


def test_every_joint_turns_by_the_mean_rotation() -> None:
    """Where no limit is met, the local rotations of the mean state are the means of the local rotations."""
    states, weights = spread_states(0.05)
    middle = states + 0.0
    for column in range(3, len(NAMES)):  # away from all limits
        low, high = BODY.layout.lower[column], BODY.layout.upper[column]
        if np.isfinite(low):
            middle[:, column] += 0.5 * (low + high) - states[:, column].mean()
            middle[:, column] = np.clip(middle[:, column], low + 1e-3, high - 1e-3)
    mean = mean_state(BODY, middle, weights, weights @ middle)
    R, _ = joint_transforms(BODY, middle)
    own, _ = joint_transforms(BODY, mean[None])
    for joint in ("root", "right_shoulder", "left_hip"):
        j = BODY.joints.index(joint) if joint in BODY.joints else 0
        p = BODY.parent[j]
        local = R[:, j] if p < 0 else np.einsum("nkr,nkc->nrc", R[:, p], R[:, j])
        local_own = own[0, j] if p < 0 else own[0, p].T @ own[0, j]
        np.testing.assert_allclose(local_own, mean_rotation(local, weights), atol=2e-5)


def test_yaw_on_both_sides_of_the_seam() -> None:
    """Facing 170 and -170 degrees is facing 180, and the landmarks of the mean stand between those of the two."""
    states = np.tile(neutral_state(BODY), (2, 1))
    yaw = NAMES.index("root_yaw")
    states[:, yaw] = np.deg2rad([170.0, -170.0])
    mean = mean_state(BODY, states, np.full(2, 0.5), states[0])
    assert np.cos(mean[yaw]) == pytest.approx(-1.0, abs=1e-9)
    between = landmarks_of(BODY, states).mean(axis=0)
    assert np.abs(landmarks_of(BODY, mean[None])[0] - between).max() < 0.01


def test_limits_hold() -> None:
    for seed in range(5):
        states, weights = spread_states(1.5, seed=seed)
        mean = mean_state(BODY, states, weights, weights @ states)
        assert np.all(mean >= BODY.layout.lower)
        assert np.all(mean <= BODY.layout.upper)
