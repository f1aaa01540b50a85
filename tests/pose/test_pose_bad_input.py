"""Bad input for the pose: nothing seen for seconds, fewer cameras, embraces, wrong beginnings.

The pose comes back, or it is said that it is not known: `observed` is false or the deviations grow. Nothing is silently
wrong, and nothing is NaN.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
from flesh_voxels import Flesh, make_flesh
from marker_world import marching
from small_session import CAMERAS, PLAIN, copy_session, small_session

from mocap.body import landmarks_of
from mocap.body.initial import HeightEstimate
from mocap.io.tables import read_landmarks_csv
from mocap.pipeline.config import LikelihoodConfig, PoseConfig, load_config
from mocap.pipeline.pose_settings import make_tools
from mocap.pipeline.run import run_session
from mocap.pose.person import VolumeClip, follow_person
from mocap.pose.result import PersonPoses
from mocap.pose.volume import PersonHull, VolumeObservation
from mocap.volume import surface_voxels

FPS = 12.5
VOXEL_M = 0.04
HEIGHT_M = 1.74
POSE = PoseConfig(n_layers=4, n_particles=120, n_start_frames=2, n_first_poses=6, smooth_lag_frames=4)
SEED = 1


@lru_cache(maxsize=1)
def flesh() -> Flesh:
    return make_flesh("anthropometric", HEIGHT_M, VOXEL_M)


def walk(n: int) -> np.ndarray:
    return marching(flesh().body, n, FPS)


def moved(states: np.ndarray, x: float, y: float, turn: float = 0.0) -> np.ndarray:
    """The same motion, turned about its place and somewhere else."""
    out = states.copy()
    c, s = np.cos(turn), np.sin(turn)
    out[:, :2] = states[:, :2] @ np.array([[c, s], [-s, c]]) + [x, y]
    yaw = flesh().body.layout.names.index("root_yaw")
    out[:, yaw] = (states[:, yaw] + turn + np.pi) % (2 * np.pi) - np.pi
    return out


def hulls(states: np.ndarray) -> list[PersonHull]:
    return [flesh().hull(s, margin_m=VOXEL_M) for s in states]


def followed(
    hull_of: Callable[[int], PersonHull | None], n: int, xyz: np.ndarray, *, is_size_fitted: bool = False
) -> PersonPoses:
    tools = make_tools(flesh().grid, FPS, HEIGHT_M, "anthropometric", POSE, LikelihoodConfig(), 1)
    clip = VolumeClip(1, np.arange(n), xyz, VolumeObservation(tools, hull_of))
    return follow_person(clip, HeightEstimate(HEIGHT_M, True), seed=SEED, is_size_fitted=is_size_fitted)


def centres(found: list[PersonHull | None]) -> np.ndarray:
    """Track of a person; interpolated where there is no hull, as the tracker does it."""
    rows = [i for i, h in enumerate(found) if h is not None]
    xyz = np.array([flesh().grid.centers(found[i].voxels).mean(axis=0) for i in rows])  # type: ignore[union-attr]
    return np.stack([np.interp(np.arange(len(found)), rows, xyz[:, k]) for k in range(3)], axis=1)


@dataclass(frozen=True)
class Judged:
    """error_m, std_m : (T, 15); std_m the root of the mean variance per axis."""

    error_m: np.ndarray
    std_m: np.ndarray


def judged(poses: PersonPoses, truth: np.ndarray) -> Judged:
    error = np.linalg.norm(poses.landmarks - landmarks_of(flesh().body, truth), axis=2)
    return Judged(error, np.sqrt(np.einsum("tlcc->tl", poses.landmark_covariance) / 3))


def assert_nothing_unflagged(poses: PersonPoses) -> None:
    assert np.isfinite(poses.states).all()
    assert np.isfinite(poses.landmarks).all()
    assert np.isfinite(poses.landmark_covariance).all()
    assert np.linalg.eigvalsh(poses.landmark_covariance).min() > 0
    assert not poses.observed[np.isnan(poses.log_likelihood)].any()


GONE_S = 2.4


@pytest.mark.slow
def test_nothing_is_seen_for_seconds_and_the_person_returns_elsewhere() -> None:
    """18 frames, 2.4 s without volume, then 14 frames a metre away and turned by 80 degrees."""
    n_gone = round(GONE_S * FPS)
    states = walk(18 + n_gone + 14)
    states[18 + n_gone :] = moved(states[18 + n_gone :], 0.7, 0.5, np.deg2rad(80))
    found: list[PersonHull | None] = [
        None if 18 <= i < 18 + n_gone else flesh().hull(s, margin_m=VOXEL_M) for i, s in enumerate(states)
    ]
    poses = followed(lambda f: found[f], len(states), centres(found))
    assert_nothing_unflagged(poses)
    gone = slice(18, 18 + n_gone)
    assert not poses.observed[gone].any()
    result = judged(poses, states)
    middle = 18 + n_gone // 2
    assert result.std_m[middle].min() > 0.3, "nobody knows where the person is after a second"
    assert np.median(result.error_m[: 18 - 2]) < 0.03
    # It comes back: the last frames are as good as the first, or what is wrong is said.
    last = slice(len(states) - 5, len(states))
    wrong = result.error_m[last] > 0.15
    assert wrong.mean() < 0.25
    said = ~poses.observed[last] | (result.std_m[last] > result.error_m[last] / 4)
    assert said[wrong].mean() > 0.5 if wrong.any() else True
    assert any("no usable volume" in w for w in poses.warnings)


@pytest.mark.slow
def test_an_embrace_is_survived() -> None:
    """Another person stands breast to breast for ten frames, and both are one lump that is given to the first."""
    states = walk(34)
    states[:, :2] = 0.0
    yaw = flesh().body.layout.names.index("root_yaw")
    states[:, yaw] = 0.2
    other = moved(states[:1], 0.0, 0.0, np.pi)[0]
    found: list[PersonHull | None] = []
    hugging = range(14, 24)
    for i, state in enumerate(states):
        hull = flesh().hull(state, margin_m=VOXEL_M)
        if i in hugging:
            neighbour = other.copy()
            neighbour[:2] = [0.34 * np.cos(0.2), 0.34 * np.sin(0.2)]
            both = np.union1d(hull.voxels, flesh().hull(neighbour, margin_m=VOXEL_M).voxels).astype(np.int32)
            hull = PersonHull(both, surface_voxels(both, flesh().grid))
        found.append(hull)
    poses = followed(lambda f: found[f], len(states), centres(found))
    assert_nothing_unflagged(poses)
    result = judged(poses, states)
    apart = [i for i in range(len(states)) if i not in hugging and i not in range(24, 28)]
    assert np.median(result.error_m[apart]) < 0.03
    assert (result.error_m[apart] > 0.15).mean() < 0.1
    during = list(hugging)
    assert result.error_m[during].mean() < 0.4, "the first person is not left for the second"
    # What is far off while they embrace is not claimed to be well known.
    off = result.error_m[during] > 0.2
    if off.any():
        silent = off & poses.observed[during] & (result.std_m[during] < result.error_m[during] / 4)
        assert not silent.any()
    assert any("explains less than 60 % of the volume" in w for w in poses.warnings)


@pytest.mark.slow
def test_walking_backwards_from_an_odd_pose() -> None:
    """The displacement says the wrong direction and no usual pose fits: arms up, a knee bent, going backwards."""
    states = walk(26)
    names = flesh().body.layout.names
    t = np.arange(len(states)) / FPS
    states[:, 0], states[:, 1] = 0.5 - 0.5 * t, 0.0
    states[:, names.index("root_yaw")] = 0.0
    for name, value in (("right_shoulder_x", -1.0), ("left_shoulder_x", 0.3), ("left_elbow_z", -1.2)):
        states[:, names.index(name)] = value
    found = hulls(states)
    poses = followed(lambda f: found[f], len(states), centres(list(found)))
    assert_nothing_unflagged(poses)
    faces = np.cos(poses.states[:, names.index("root_yaw")])
    is_said = any("which way the person faces" in w for w in poses.warnings)
    assert is_said or (faces > 0.7).mean() > 0.9
    if not is_said:
        assert np.median(judged(poses, states).error_m) < 0.03


@pytest.mark.slow
def test_a_volume_of_few_cameras_is_less_well_known() -> None:
    """From frame 12 on the hull is 12 cm fatter all around, as from two or three cameras: deviations grow."""
    states = walk(24)
    found = [flesh().hull(s, margin_m=VOXEL_M if i < 12 else 0.12) for i, s in enumerate(states)]
    poses = followed(lambda f: found[f], len(states), centres(list(found)))
    assert_nothing_unflagged(poses)
    result = judged(poses, states)
    assert np.median(result.error_m[:10]) < 0.03
    # Where in so fat a hull the body is cannot be known; that it is not known must be said, of every landmark.
    wrong = result.error_m[14:] > 0.2
    said = ~poses.observed[14:] | (result.std_m[14:] > result.error_m[14:] / 5)
    assert (said | ~wrong).mean() > 0.95
    assert np.median(result.std_m[14:]) > 5 * np.median(result.std_m[:10])
    assert any("explains less than 60 % of the volume" in w for w in poses.warnings)


def test_half_of_the_cameras_go_dark(tmp_path_factory: pytest.TempPathFactory) -> None:
    """The masks of two of four cameras are empty from frame 3 on: the run ends, and says that it saw nobody."""
    session = copy_session(
        small_session(tmp_path_factory.getbasetemp()),
        tmp_path_factory.mktemp("dark") / "session",
        masks=True,
        n_frames=6,
    )
    for camera in CAMERAS[:2]:
        for frame in range(3, 6):
            path = session / "masks" / camera / f"{frame:04d}.png"
            cv2.imwrite(str(path), np.zeros_like(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)))
    out = session.parent / "out"
    config = load_config("default", (*PLAIN, "output.formats=[]", "volume.on_bad_camera=ignore"))
    result = run_session(session, out, config=config, until="pose")
    (poses,) = result.poses
    assert_nothing_unflagged(poses)
    dark = poses.frames >= 3
    assert poses.observed[~dark].mean() > 0.5
    assert not poses.observed[dark].any()
    std = np.sqrt(np.einsum("tlcc->tl", poses.landmark_covariance))
    if dark.any():
        assert std[dark].min() > np.median(std[~dark])
    (motion,) = read_landmarks_csv(out / "landmarks.csv")
    assert np.isfinite(motion.landmarks).all()


@pytest.mark.slow
def test_size_is_fitted_to_a_person_who_never_stands_upright() -> None:
    """Knees and trunk bent all the time: the head stays 12 cm below the height, and the size is found all the same."""
    states = walk(16)
    names = flesh().body.layout.names
    for name, value in (
        ("right_hip_y", -0.9),
        ("left_hip_y", -0.8),
        ("right_knee_y", 1.1),
        ("left_knee_y", 1.0),
        ("root_pitch", 0.25),
    ):
        states[:, names.index(name)] += value
    states = np.clip(states, flesh().body.layout.lower, flesh().body.layout.upper)
    found = [flesh().hull(s, margin_m=0.5 * VOXEL_M) for s in states]
    tools = make_tools(flesh().grid, FPS, 0.93 * HEIGHT_M, "anthropometric", POSE, LikelihoodConfig(), 1)
    observation = VolumeObservation(tools, lambda f: found[f])
    clip = VolumeClip(1, np.arange(len(states)), centres(list(found)), observation)
    height = HeightEstimate(0.93 * HEIGHT_M, True)
    poses = follow_person(clip, height, seed=SEED, is_size_fitted=True)
    assert poses.height.height_m == poses.body.height_m
    assert abs(poses.height.height_m - HEIGHT_M) < 0.5 * 0.07 * HEIGHT_M
    assert replace(poses, warnings=()).person == 1


@pytest.mark.slow
def test_frames_without_a_track_count_as_absence() -> None:
    """The tracker leaves out the frames between two visits: the person comes back turned, and is searched for anew."""
    n_gone = round(GONE_S * FPS)
    states = walk(14 + 10)
    states[14:] = moved(states[14:], 0.7, 0.5, np.deg2rad(150))
    frames = np.concatenate([np.arange(14), 14 + n_gone + np.arange(10)])
    row_of = {int(f): i for i, f in enumerate(frames)}
    found = hulls(states)
    tools = make_tools(flesh().grid, FPS, HEIGHT_M, "anthropometric", POSE, LikelihoodConfig(), 1)
    xyz = np.array([flesh().grid.centers(h.voxels).mean(axis=0) for h in found])
    clip = VolumeClip(1, frames, xyz, VolumeObservation(tools, lambda f: found[row_of[f]]))
    poses = follow_person(clip, HeightEstimate(HEIGHT_M, True), seed=SEED)
    assert_nothing_unflagged(poses)
    assert np.median(judged(poses, states).error_m[-5:]) < 0.05
