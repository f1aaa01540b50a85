"""Motions: planted feet, natural joints, constant limbs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_synth.figure import JOINT, Figure, forward_kinematics, landmarks_of, make_figure
from data_synth.motions import MOTIONS, Path, Pose, solve_two_bones, walk
from mocap.data import LANDMARKS

FPS = 50.0
N_FRAMES = 110
MAX_SLIDE_M = 0.005


@pytest.fixture(scope="module")
def figure() -> Figure:
    return make_figure(1.72, "female", 1.0, rng=np.random.default_rng(8))


def _pose(figure: Figure, name: str, seed: int = 2) -> Pose:
    rng = np.random.default_rng(seed)
    if name == "walk":
        path = Path((0.2, -0.1), (1.2, 0.9), 1.0, seed % 2 == 1)
        return walk(figure, N_FRAMES, FPS, path=path, speed_m_s=1.1, rng=rng)
    return MOTIONS[name](figure, N_FRAMES, FPS, position=(0.2, -0.1), heading_rad=0.8, rng=rng)


@pytest.fixture(scope="module", params=sorted(MOTIONS))
def named(request: pytest.FixtureRequest, figure: Figure) -> tuple[str, Pose]:
    return request.param, _pose(figure, request.param)


def test_standing_feet_do_not_slide(named: tuple[str, Pose], figure: Figure) -> None:
    name, pose = named
    position, _ = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    assert pose.contact.any(axis=0).all()
    if name != "walk":
        assert pose.contact.all()
    for i, side in enumerate(("left", "right")):
        for joint in ("ankle", "toe"):
            at = position[:, JOINT[f"{side}_{joint}"]]
            change = np.flatnonzero(np.diff(pose.contact[:, i].astype(int)) != 0) + 1
            for run in np.split(np.arange(len(at)), change):
                if pose.contact[run[0], i]:
                    assert np.linalg.norm(at[run] - at[run[0]], axis=1).max() < MAX_SLIDE_M


def test_feet_never_sink_and_one_foot_bears(named: tuple[str, Pose], figure: Figure) -> None:
    _, pose = named
    position, _ = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    ankles = position[:, [JOINT["left_ankle"], JOINT["right_ankle"]], 2]
    assert ankles.min() > 0.9 * figure.ankle_height_m
    assert ankles.min(axis=1).max() < figure.ankle_height_m + 0.09


def test_limb_lengths_are_constant(named: tuple[str, Pose], figure: Figure) -> None:
    _, pose = named
    position, rotation = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    points = landmarks_of(figure, position, rotation)
    at = {n: points[:, i] for i, n in enumerate(LANDMARKS)}
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist")):
        for side in ("left", "right"):
            length = np.linalg.norm(at[f"{side}_{a}"] - at[f"{side}_{b}"], axis=1)
            assert np.ptp(length) < 1e-9


def test_rotations_are_rotations_and_smooth(named: tuple[str, Pose]) -> None:
    _, pose = named
    R = pose.rotations
    assert np.allclose(R @ R.swapaxes(-1, -2), np.eye(3), atol=1e-9)
    step = Rotation.from_matrix((R[1:] @ R[:-1].swapaxes(-1, -2)).reshape(-1, 3, 3)).magnitude()
    # 1,500 degrees per second is a fast punch or the ankle at push-off.
    assert np.rad2deg(step.max()) * FPS < 1500


def test_knees_and_elbows_bend_the_right_way(named: tuple[str, Pose]) -> None:
    _, pose = named
    for side in ("left", "right"):
        knee = Rotation.from_matrix(pose.rotations[:, JOINT[f"{side}_knee"]]).as_rotvec()
        elbow = Rotation.from_matrix(pose.rotations[:, JOINT[f"{side}_elbow"]]).as_rotvec()
        assert knee[:, 1].min() > -1e-6
        assert np.rad2deg(knee[:, 1].max()) < 135  # a deep crouch; people reach 140
        assert elbow[:, 1].max() < 1e-6
        assert np.abs(knee[:, [0, 2]]).max() < 1e-6  # hinges: no twist, no sideways bend
        assert np.abs(elbow[:, [0, 2]]).max() < 1e-6


def test_walk_covers_the_ground_and_arms_oppose_legs(figure: Figure) -> None:
    path = Path((0.0, 0.0), (0.0, 0.0), 0.0, False)
    pose = walk(figure, 150, FPS, path=path, speed_m_s=1.2, rng=np.random.default_rng(1))
    travelled = pose.root_position[-1, 0] - pose.root_position[0, 0]
    assert abs(travelled - 1.2 * 149 / FPS) < 0.01
    position, _ = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    root = position[:, 0, 0]
    foot = position[:, JOINT["left_ankle"], 0] - root
    same = position[:, JOINT["left_wrist"], 0] - root
    other = position[:, JOINT["right_wrist"], 0] - root
    assert np.corrcoef(foot, other)[0, 1] > 0.7
    assert np.corrcoef(foot, same)[0, 1] < -0.7
    rise = np.ptp(pose.root_position[:, 2])
    assert 0.02 < rise < 0.07  # normal gait: 3 to 5 cm
    knee = Rotation.from_matrix(pose.rotations[:, JOINT["left_knee"]]).as_rotvec()[:, 1]
    assert 45 < np.rad2deg(knee.max()) < 75  # swing flexion of normal gait: about 60 degrees
    assert np.rad2deg(knee.min()) < 15


def test_other_seeds_give_other_variations(figure: Figure) -> None:
    a, b = _pose(figure, "gesture", 2), _pose(figure, "gesture", 3)
    assert np.array_equal(a.rotations, _pose(figure, "gesture", 2).rotations)
    assert np.abs(a.rotations - b.rotations).max() > 0.1


def test_path_runs_at_constant_speed_and_heads_along_itself() -> None:
    path = Path((0.3, 0.1), (1.4, 0.8), 0.5, True)
    s = np.linspace(0, 9, 400)
    point, heading = path.at(s)
    step = np.diff(point, axis=0)
    assert np.allclose(np.linalg.norm(step, axis=1), s[1], rtol=2e-3)
    middle = 0.5 * (heading[1:] + heading[:-1])
    assert np.allclose(step / s[1], np.column_stack([np.cos(middle), np.sin(middle)]), atol=5e-3)


def test_two_bones_reach_their_target() -> None:
    rng = np.random.default_rng(4)
    root, pole = rng.normal(size=(17, 3)), rng.normal(size=(17, 3))
    direction = rng.normal(size=(17, 3))
    target = root + direction / np.linalg.norm(direction, axis=1, keepdims=True) * rng.uniform(
        0.2, 0.65, (17, 1)
    )
    for hinge in (1.0, -1.0):
        first, second = solve_two_bones(root, target, 0.4, 0.3, pole, hinge=hinge)
        assert np.allclose(root - 0.4 * first[:, :, 2] - 0.3 * second[:, :, 2], target)
        bend = Rotation.from_matrix(first.swapaxes(1, 2) @ second).as_rotvec()
        assert np.all(hinge * bend[:, 1] > 0)
        elbow = root - 0.4 * first[:, :, 2] - 0.5 * (root + target)
        assert np.all(np.sum(elbow * pole, axis=1) > -1e-9) or hinge < 0
