"""Runs on keypoints alone: from files to poses, tracks and a report."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from keypoint_world import keypoint_world, write_keypoint_session

from mocap.data import ALL_LANDMARKS, LANDMARKS
from mocap.data.keypoints import KEYPOINTS
from mocap.errors import MocapError
from mocap.io.session import open_session
from mocap.io.tables import read_landmarks_csv, read_tracks_csv
from mocap.pipeline.chains import observation_kind
from mocap.pipeline.config import Config, load_config
from mocap.pipeline.run import run_session

# Keypoints without noise: what is left is the weight of usual angles and the smoother.
EXACT_MM = 8.0
NOISY_MM = 30.0
# How far away a foot stands is known to some centimetres, how far an arm reaches along the ray hardly.
LONE_M = 0.15


def config(*settings: str) -> Config:
    return load_config(
        "default", ("output.formats=[]", "pose.n_start_frames=1", "pose.n_particles=50", *settings)
    )


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_keypoint_session(keypoint_world(12), tmp_path_factory.mktemp("keypoints") / "session")


def test_exact_keypoints_give_the_pose_and_what_a_run_writes(session: Path, tmp_path: Path) -> None:
    result = run_session(session, tmp_path, config=config('output.formats=["bvh", "report"]'))
    assert {"run.json", "tracks.csv", "landmarks.csv", "pose.npz", "report.html", "person_1.bvh"} <= {
        p.name for p in tmp_path.iterdir()
    }
    (motion,) = read_landmarks_csv(tmp_path / "landmarks.csv")
    truth = keypoint_world(12).landmarks[0]
    assert motion.names == ALL_LANDMARKS
    assert 1000 * np.linalg.norm(motion.landmarks[:, : len(LANDMARKS)] - truth, axis=2).mean() < EXACT_MM
    assert (
        np.linalg.norm(read_tracks_csv(tmp_path / "tracks.csv").xyz[:, :2] - truth[:, 0, :2], axis=1).max()
        < 0.2
    )
    assert json.loads((tmp_path / "run.json").read_text())["numbers"]["keypoints"]["n_persons"] == 1
    again = run_session(session, tmp_path, config=config(), resume=True)
    assert set(again.reused) == {"keypoints", "pose"}
    assert result.warnings == again.warnings


def test_what_no_keypoint_shows_is_unsure_within_its_limits(tmp_path: Path) -> None:
    """A tool without a face: nothing holds the head, and its deviation must not grow with the length of the clip."""
    world = keypoint_world(60)
    face = [k for k, name in enumerate(KEYPOINTS) if name in FACE]
    blank = [[[_without(p, face) for p in view] for view in frame] for frame in world.figures]
    result = run_session(
        write_keypoint_session(world, tmp_path / "s", blank), tmp_path / "out", config=config()
    )
    (poses,) = result.poses
    std = np.sqrt(np.trace(poses.landmark_covariance, axis1=2, axis2=3) / 3.0)
    head, wrist = (LANDMARKS.index(name) for name in ("head", "left_wrist"))
    assert 3 * std[:, wrist].max() < std[:, head].min()
    assert std[:, head].max() < 0.3, "the neck is as long at the end as in the beginning"
    assert not poses.observed[:, head].any()


FACE = {"nose", "head", "neck", "left_eye", "right_eye", "left_ear", "right_ear"}


def _without(figure: np.ndarray, keypoints: list[int]) -> np.ndarray:
    out = figure.copy()
    out[keypoints] = np.nan
    return out


def test_two_cameras_are_enough_and_threads_change_nothing(tmp_path: Path) -> None:
    world = keypoint_world(12, noise_px=1.0)
    root = write_keypoint_session(world, tmp_path / "session")
    (root / "session.toml").write_text('fps = 25.0\ncameras = ["cam_0", "cam_1"]\nperson_height_m = 1.7\n')
    results = [
        run_session(root, tmp_path / f"out_{n}", config=config(), n_threads=n).poses[0].landmarks
        for n in (1, 2)
    ]
    np.testing.assert_array_equal(*results)
    assert (
        1000 * np.linalg.norm(results[0][:, : len(LANDMARKS)] - world.landmarks[0], axis=2).mean() < NOISY_MM
    )


def test_left_and_right_come_from_the_names(session: Path, tmp_path: Path) -> None:
    poses = run_session(session, tmp_path, config=config(), frames=(0, 4)).poses[0]
    truth = keypoint_world(12).landmarks[0][:4]
    for side, other in (("left", "right"), ("right", "left")):
        own, wrong = (truth[:, LANDMARKS.index(f"{s}_hip")] for s in (side, other))
        found = poses.landmarks[:, LANDMARKS.index(f"{side}_hip")]
        assert (np.linalg.norm(found - own, axis=1) < np.linalg.norm(found - wrong, axis=1)).all()


def test_auto_takes_keypoints_where_there_is_nothing_else(session: Path) -> None:
    opened = open_session(session)
    assert observation_kind(opened, config()) == "keypoints"
    with pytest.raises(MocapError, match="keypoints alone"):
        observation_kind(opened, config("observation=voxels"))
    with pytest.raises(MocapError, match="neither marker detections"):
        observation_kind(opened, config("observation=markers"))


def test_nobody_in_the_keypoints_is_said(tmp_path: Path) -> None:
    """Every camera looks at a person of its own: no two of them agree."""
    world = keypoint_world(12)
    shifted = [
        [[np.c_[p[:, :2] * 0.5 + 40.0 * c, p[:, 2]] for p in view] for c, view in enumerate(f)]
        for f in world.figures
    ]
    result = run_session(
        write_keypoint_session(world, tmp_path / "s", shifted), tmp_path / "out", config=config()
    )
    assert result.poses == ()
    assert any("nobody was found in the keypoints" in w for w in result.warnings)


def test_whom_one_camera_alone_shows_is_followed_by_it(tmp_path: Path) -> None:
    """A detector that gives one person per picture may show the second one to a single camera all the time."""
    world = keypoint_world(40, apart_m=1.1)
    figures = [[[p[1 if c == 0 else 0]] for c, p in enumerate(frame)] for frame in world.figures]
    root = write_keypoint_session(world, tmp_path / "session", figures)
    result = run_session(root, tmp_path / "out", config=config(), until="pose")
    (warning,) = [w for w in result.warnings if "whom no other camera shows" in w]
    assert "person 2 is followed by this camera alone" in warning
    first, second = result.poses
    errors = [
        np.linalg.norm(p.landmarks[:, : len(LANDMARKS)] - truth[p.frames], axis=2)
        for p, truth in zip((first, second), world.landmarks, strict=True)
    ]
    assert 1000 * errors[0].mean() < EXACT_MM
    assert np.median(errors[1]) < LONE_M
    stated = np.sqrt(np.trace(second.landmark_covariance[:, : len(LANDMARKS)], axis1=2, axis2=3).mean())
    assert np.sqrt((errors[1] ** 2).mean()) < 1.5 * stated, "one camera does not see how far away somebody is"
