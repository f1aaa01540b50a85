"""The marker pipeline on drawn detections of a person whose body and markers the pipeline does not know."""

from __future__ import annotations

import json
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from marker_world import FPS, MarkerWorld, marker_world, write_marker_session

from mocap.data import LANDMARKS
from mocap.errors import MocapError
from mocap.io.session import open_session
from mocap.io.tables import read_landmarks_csv, read_tracks_csv
from mocap.likelihood.markers import marker_views, observe
from mocap.pipeline.chains import observation_kind
from mocap.pipeline.config import Config, load_config
from mocap.pipeline.keys import stage_keys
from mocap.pipeline.pose_settings import make_marker_tools
from mocap.pipeline.run import run_session
from mocap.pose.marker import MarkerTools
from mocap.pose.marker_person import finish_markers, flesh_centroids, follow_markers
from mocap.pose.marker_start import height_from_points, points_of_frames, steady_points
from mocap.pose.result import PersonPoses

SETTINGS = (
    "pose.n_layers=2",
    "pose.n_particles=40",
    "pose.n_start_frames=1",
    "pose.n_first_poses=3",
    "markers.n_hypotheses=2",
    "markers.fit_frames=10",
    "markers.noise_px=0.7",
)
# Noise of 0.7 px is some 10 mm, markers sit up to 2 cm beside their places; a lost limb would add tens.
MEAN_ERROR_M = 0.030
N_FRAMES = 24


def config(*more: str, preset: str = "default") -> Config:
    return load_config(preset, (*SETTINGS, *more))


def tools_of(height_m: float) -> MarkerTools:
    return make_marker_tools(config(), FPS, height_m)


def follow(world: MarkerWorld, *more: str, seed: int = 0, preset: str = "default") -> PersonPoses | None:
    views = marker_views(world.rig)
    observations = [observe(views, d) for d in world.detections]
    found = follow_markers(
        range(len(observations)),
        lambda frame: observations[frame],
        lambda height_m: make_marker_tools(config(*more, preset=preset), FPS, height_m),
        height_m=None,
        seed=seed,
    )
    return None if found is None else finish_markers(found)


@cache
def followed() -> PersonPoses:
    found = follow(marker_world(N_FRAMES))
    assert found is not None
    return found


def error(poses: PersonPoses, world: MarkerWorld) -> np.ndarray:
    return np.linalg.norm(poses.landmarks - world.landmarks[poses.frames], axis=2)


def test_a_person_is_found_and_followed_without_being_told_anything() -> None:
    world, poses = marker_world(N_FRAMES), followed()
    assert error(poses, world).mean() < MEAN_ERROR_M
    assert abs(poses.body.height_m - world.body.height_m) < 0.03
    assert poses.observed.mean() > 0.9
    np.testing.assert_array_equal(poses.frames, np.arange(N_FRAMES))
    assert np.isfinite(poses.landmarks).all()


def test_covariances_are_proper_and_hold_the_truth() -> None:
    world, poses = marker_world(N_FRAMES), followed()
    assert np.linalg.eigvalsh(poses.landmark_covariance).min() > 0
    d = poses.landmarks - world.landmarks
    squared = np.einsum("tlr,tlrs,tls->tl", d, np.linalg.inv(poses.landmark_covariance), d)
    # 6.25 is the 90 % quantile of chi-squared with three degrees of freedom.
    assert (squared < 6.25).mean() > 0.6


@pytest.mark.slow
def test_same_seed_same_numbers() -> None:
    world = marker_world(12)
    a, b = follow(world), follow(world)
    assert a is not None
    assert b is not None
    np.testing.assert_array_equal(a.states, b.states)


def test_published_filter_alone_runs_on_the_same_data() -> None:
    """Some tens of evaluations instead of thousands: it must run and say how sure it is, not be accurate."""
    found = follow(marker_world(12), preset="reference_markers")
    assert found is not None
    assert np.isfinite(found.landmarks).all()
    assert np.nanmin(found.ess_share) > 0
    assert np.linalg.eigvalsh(found.landmark_covariance).min() > 0


@pytest.mark.slow
def test_empty_frames_are_carried_on_and_flagged() -> None:
    world = marker_world(N_FRAMES)
    views = marker_views(world.rig)
    empty = [np.zeros((0, 2))] * len(world.rig)
    gap = range(14, 19)
    observations = [observe(views, empty if i in gap else d) for i, d in enumerate(world.detections)]
    found = follow_markers(range(N_FRAMES), lambda f: observations[f], tools_of, height_m=None, seed=0)
    assert found is not None
    poses = finish_markers(found)
    assert not poses.observed[list(gap)].any()
    assert np.isfinite(poses.landmarks).all()
    assert any("too few detections in 5 of 24 frames" in w for w in poses.warnings)
    variance = np.einsum("tlcc->t", poses.landmark_covariance)
    assert variance[16] > 2 * variance[8]


def test_no_detections_and_pure_noise_are_nobody() -> None:
    world = marker_world(12)
    views = marker_views(world.rig)
    nothing = observe(views, [np.zeros((0, 2))] * len(world.rig))
    assert follow_markers(range(12), lambda f: nothing, tools_of, height_m=None, seed=0) is None
    rng = np.random.default_rng(0)
    noise = [observe(views, [rng.uniform([0, 0], [319, 247], (8, 2)) for _ in world.rig]) for _ in range(12)]
    assert follow_markers(range(12), lambda f: noise[f], tools_of, height_m=None, seed=0) is None


def test_steady_points_are_markers() -> None:
    world = marker_world(N_FRAMES)
    views = marker_views(world.rig)
    points_of = points_of_frames(lambda f: observe(views, world.detections[f]))
    found = steady_points(points_of, 10, range(N_FRAMES))
    assert len(found) >= 8
    nearest = np.linalg.norm(found[:, None] - world.points[10][None], axis=2).min(axis=1)
    assert np.quantile(nearest, 0.8) < 0.03
    height = height_from_points([steady_points(points_of, f, range(N_FRAMES)) for f in range(0, N_FRAMES, 4)])
    assert height == pytest.approx(world.body.height_m, abs=0.06)
    assert height_from_points([np.zeros((0, 3))]) is None


def test_flesh_centroids_move_with_the_body() -> None:
    world = marker_world(12)
    moved = world.states.copy()
    moved[:, :3] += [0.3, -0.2, 0.1]
    difference = flesh_centroids(world.body, moved) - flesh_centroids(world.body, world.states)
    np.testing.assert_allclose(difference, np.tile([0.3, -0.2, 0.1], (12, 1)), atol=1e-12)


# --- whole runs ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_marker_session(marker_world(12), tmp_path_factory.mktemp("markers") / "session")


@pytest.fixture(scope="module")
def out(session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One whole run with the tables, exports and report of a marker session without pictures."""
    folder = tmp_path_factory.mktemp("out")
    plain = config(
        'output.formats=["bvh", "trc", "report"]', "output.report_frames=1", "output.report_cameras=2"
    )
    run_session(session, folder, config=plain)
    return folder


def test_a_run_on_detections_writes_what_a_run_on_videos_writes(out: Path) -> None:
    names = {p.name for p in out.iterdir()}
    assert {"run.json", "tracks.csv", "landmarks.csv", "pose.npz", "report.html"} <= names
    assert {"person_1.bvh", "person_1.trc", "store.zarr"} <= names
    (motion,) = read_landmarks_csv(out / "landmarks.csv")
    assert motion.landmarks.shape == (12, len(LANDMARKS), 3)
    tracks = read_tracks_csv(out / "tracks.csv")
    assert np.linalg.norm(tracks.xyz[:, :2] - motion.landmarks[:, 0, :2], axis=1).max() < 0.25
    about = json.loads((out / "run.json").read_text())
    assert set(about["stages"]) >= {"detect", "pose"}
    assert about["numbers"]["detect"]["source"] == "detections"
    assert about["scores"]["mean_error_mm"] < 60.0
    assert "detections" in (out / "report.html").read_text()


def test_the_stored_body_is_the_fitted_one(out: Path) -> None:
    from mocap.body import landmarks_of
    from mocap.io.store import StageStore
    from mocap.products.poses import stored_poses

    (poses,) = stored_poses(StageStore(out / "store.zarr"))
    np.testing.assert_allclose(landmarks_of(poses.body, poses.states), poses.landmarks, atol=1e-9)


def test_resume_reuses_what_has_not_changed(session: Path, out: Path, tmp_path: Path) -> None:
    again = tmp_path / "out"
    shutil.copytree(out, again)
    plain = config("output.formats=[]")
    result = run_session(session, again, config=plain, resume=True)
    assert set(result.reused) == {"detect", "pose"}
    assert (again / "landmarks.csv").read_bytes() == (out / "landmarks.csv").read_bytes()
    opened = open_session(session)
    before, after = (stage_keys(opened, plain, seed, "markers") for seed in (0, 1))
    assert before["detect"] == after["detect"]
    assert before["pose"] != after["pose"]


def test_changed_detections_are_read_again(session: Path, out: Path, tmp_path: Path) -> None:
    copy, again = tmp_path / "session", tmp_path / "out"
    shutil.copytree(session, copy)
    shutil.copytree(out, again)
    path = copy / "detections" / "cam_1.csv"
    path.write_text(path.read_text() + "11,20.0,20.0\n")
    result = run_session(copy, again, config=config("output.formats=[]"), resume=True, until="segment")
    assert result.reused == ()


def test_auto_takes_markers_only_where_there_are_detections(session: Path, tmp_path: Path) -> None:
    opened = open_session(session)
    assert observation_kind(opened, config()) == "markers"
    with pytest.raises(MocapError, match="marker detections alone"):
        observation_kind(opened, config("observation=voxels"))


@pytest.mark.slow
def test_two_persons_are_warned_about(tmp_path: Path) -> None:
    session = write_marker_session(marker_world(12), tmp_path / "two", shifted=1.4)
    result = run_session(session, tmp_path / "out", config=config("output.formats=[]"))
    assert len(result.poses) == 1
    assert any("more than one person" in w for w in result.warnings)


def test_a_marker_set_that_does_not_fit_the_body_stops_before_any_work(session: Path, tmp_path: Path) -> None:
    path = tmp_path / "set.toml"
    path.write_text(
        "name = 'x'\n[[marker]]\nname = 'a'\njoint = 'tail'\npart = 'torso'\noffset = [0, 0, 0]\n"
    )
    out = tmp_path / "out"
    with pytest.raises(MocapError, match="tail"):
        run_session(session, out, config=config(f"body.marker_set={path}"))
    assert not (out / "run.json").exists()
