"""Runs on volumes and keypoints together: what silhouettes lack is made good before the volume is carved."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from keypoint_world import keypoint_world, write_keypoint_session

from mocap.body.markers import marker_positions
from mocap.data.keypoints import KEYPOINTS, MIRRORED, Figures
from mocap.io.session import check_session, open_session
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.pipeline.stages.pose import hulls_of_person
from mocap.products.hulls import stored_grid
from mocap.products.keypoints import PRODUCT, keypoint_row, known_points
from mocap.products.poses import stored_poses
from mocap.products.tracks import stored_tracks
from mocap.volume import ConsistencyMonitor
from mocap.volume.known_persons import flesh_along
from mocap.volume.residuals import silhouette

N_FRAMES, FRAME = 8, 5
FILES_M = 2e-4  # what digits of pixels in files leave of a point
LOW_M = 0.7  # below it a cabinet hides the person from the second camera
WORLD = keypoint_world(N_FRAMES, n_cameras=3)
POINTS = marker_positions(WORLD.body, WORLD.markers, WORLD.states[0])


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three cameras, of which the second never sees the legs; its keypoints are guesses that happen to be right."""
    root = write_keypoint_session(WORLD, tmp_path_factory.mktemp("fused") / "session")
    for c, camera in enumerate(WORLD.rig):
        (root / "masks" / camera.name).mkdir(parents=True)
        for frame, person in enumerate(POINTS):
            flesh = flesh_along(person)[0]
            seen = flesh[flesh[:, 2] > LOW_M] if c == 1 else flesh
            mask = 255 * silhouette(camera, seen, 0.12).astype(np.uint8)
            cv2.imwrite(str(root / "masks" / camera.name / f"{frame:06d}.png"), mask)
    return root


def run(session: Path, out: Path, kind: str, until: str = "track", occluders: str = "ignore") -> StageStore:
    """occluders : silhouettes of a few frames tell of the cabinet, too, if they may."""
    settings = (
        f"observation={kind}",
        f"volume.occluders={occluders}",
        "output.formats=[]",
        "pose.n_start_frames=1",
    )
    config = load_config("default", settings)
    run_session(session, out, config=config, until=until)
    return StageStore(next(out.rglob("carve")).parent)


def test_keypoints_of_another_clip_are_named_and_leave_volume_and_poses_as_they_are(
    session: Path, tmp_path: Path
) -> None:
    """Somebody half a metre beside the person: half of him is in its silhouettes, which would hold both."""
    other = tmp_path / "session"
    away = POINTS + np.array([-0.5, 0.5, 0.0])
    seen = [
        [np.column_stack([camera.project(p)[0], np.full(len(p), 0.9)]) for camera in WORLD.rig] for p in away
    ]
    write_keypoint_session(replace(WORLD, figures=tuple([[own] for own in frame] for frame in seen)), other)
    (other / "masks").symlink_to(session / "masks")
    fused, alone = (run(other, tmp_path / kind, kind, "pose") for kind in ("fused", "voxels"))
    for (_, a), (_, b) in zip(fused.reader("carve"), alone.reader("carve"), strict=True):
        np.testing.assert_array_equal(a["voxels"], b["voxels"])
    for own, without in zip(stored_poses(fused), stored_poses(alone), strict=True):
        np.testing.assert_array_equal(own.landmarks, without.landmarks)
    said = json.loads((tmp_path / "fused" / "run.json").read_text(encoding="utf-8"))
    assert "are of another clip than the pictures" in json.dumps(said)


def test_keypoints_with_left_and_right_exchanged_turn_nobody_about(session: Path, tmp_path: Path) -> None:
    """A tool that names sides as a mirror does: what it says of arms and legs is of the other ones."""
    other = tmp_path / "session"
    figures = tuple([[figure[MIRRORED] for figure in own] for own in frame] for frame in WORLD.figures)
    write_keypoint_session(replace(WORLD, figures=figures), other)
    (other / "masks").symlink_to(session / "masks")
    fused, alone = (run(other, tmp_path / kind, kind, "pose") for kind in ("fused", "voxels"))
    for own, without in zip(stored_poses(fused), stored_poses(alone), strict=True):
        np.testing.assert_array_equal(own.landmarks, without.landmarks)
    said = (tmp_path / "fused" / "run.json").read_text(encoding="utf-8")
    assert "without keypoints whose left and right seem exchanged" in said


def test_legs_that_one_camera_does_not_see_are_in_the_volume(session: Path, tmp_path: Path) -> None:
    ankle = POINTS[FRAME, KEYPOINTS.index("left_ankle")]
    opened = open_session(session)
    for kind, occluders, has_legs in (
        ("voxels", "ignore", False), ("voxels", "learn", True), ("fused", "ignore", True),
    ):  # fmt: skip
        store = run(session, tmp_path / f"{kind}-{occluders}", kind, occluders=occluders)
        tracks = stored_tracks(store, opened.fps)
        hull = hulls_of_person(opened, store, int(tracks.person[0]))(FRAME)
        assert hull is not None
        centres = stored_grid(store).centers(hull.voxels)
        assert (np.linalg.norm(centres - ankle, axis=1).min() < 0.06) == has_legs
    known = known_points(store, opened.fps)
    np.testing.assert_allclose(known[FRAME], POINTS[FRAME][None], atol=FILES_M)


def test_where_a_silhouette_is_cut_off_nobody_is_pulled_in(session: Path, tmp_path: Path) -> None:
    """Rays of the outline along the cut would draw the legs up to it."""
    opened = open_session(session)
    store = run(session, tmp_path, "fused")
    person = int(stored_tracks(store, opened.fps).person[0])
    n_at_cut = {}
    for name, known in (("masks alone", {}), ("keypoints", known_points(store, opened.fps))):
        hull = hulls_of_person(opened, store, person, known=known)(FRAME)
        assert hull is not None
        assert hull.outlines is not None
        found = hull.outlines()
        in_second = found.camera == 1
        down = found.normals[in_second] @ np.array([0.0, 0.0, -1.0])
        thigh = POINTS[FRAME, KEYPOINTS.index("left_hip")] * [1, 1, 0] + [0, 0, LOW_M]
        away = np.cross(thigh - found.origins[in_second], found.directions[in_second])
        near = np.linalg.norm(away, axis=1) < 0.2
        n_at_cut[name] = int((near & (down > 0.7)).sum())
    assert n_at_cut["masks alone"] >= 4
    assert n_at_cut["keypoints"] == 0


def test_points_that_are_lost_for_a_moment_lie_between_their_neighbours(tmp_path: Path) -> None:
    """Views on which nobody agrees for up to half a second; what is lost for longer, or at an end, is not known."""
    store = StageStore(tmp_path)
    points = np.zeros((12, len(KEYPOINTS), 3))
    points[:, :, 0] = 0.1 * np.arange(12)[:, None]
    points[3:5, 0] = np.nan
    points[2:9, 1] = np.nan
    points[10:, 2] = np.nan
    uv, confidence = np.zeros((2, len(KEYPOINTS), 2)), np.ones((2, len(KEYPOINTS)))
    figures = Figures(uv, confidence, np.array([0, 1]))
    with store.writer(PRODUCT, "key") as out:
        for frame in range(12):
            of = np.array([1, 1]) if frame != 11 else np.array([1, 0])
            out.append(frame, **keypoint_row(figures, of, {1: points[frame]} if frame != 6 else {}))
    found = known_points(store, fps=10.0)
    assert sorted(found) == list(range(12))
    x = np.array([found[frame][0, :, 0] for frame in range(11)])
    np.testing.assert_allclose(x[:, 0], 0.1 * np.arange(11))
    assert np.isnan(x[2:9, 1]).all()
    np.testing.assert_allclose(x[9:, 1], [0.9, 1.0])
    assert np.isnan(x[10, 2])
    # In the last frame one camera alone shows the person: how far away is a guess.
    assert found[11].shape == (0, len(KEYPOINTS), 3)


@pytest.mark.parametrize("kind", ["voxels", "fused"])
def test_cameras_are_judged_by_every_frame(
    kind: str, session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged: list[int] = []
    add = ConsistencyMonitor.add

    def noted(self: ConsistencyMonitor, frame: int, *seen: Any) -> None:
        judged.append(frame)
        add(self, frame, *seen)

    monkeypatch.setattr(ConsistencyMonitor, "add", noted)
    run(session, tmp_path / "out", kind)
    assert judged[:N_FRAMES] == list(range(N_FRAMES))


def test_of_few_cameras_coarse_volumes_are_told_where_there_are_some(session: Path, tmp_path: Path) -> None:
    alone = write_keypoint_session(WORLD, tmp_path / "session")
    (beside,), none = (
        [f for f in check_session(open_session(root)) if "volumes are coarse" in f.message]
        for root in (session, alone)
    )
    assert "--observation fused" in beside.remedy
    assert none == []
