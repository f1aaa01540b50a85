"""Videos with the bodies drawn in, replay and scene, out of a session with pictures and a body that stands in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_session import CAMERAS, FPS, N_FRAMES, SIZE, read_clip, small_session

from mocap.body import landmarks_of, load_body_model, neutral_state, scale_body
from mocap.body.initial import HeightEstimate
from mocap.errors import MocapError
from mocap.io.session import Session, open_session
from mocap.io.session.reading import pictures_of
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv
from mocap.io.video import FrameReader
from mocap.pipeline import pictures
from mocap.pipeline.config import OutputConfig
from mocap.pipeline.finished import check_cameras
from mocap.pipeline.overlay_video import overlay_videos
from mocap.pipeline.pictures import read_pictures
from mocap.pipeline.record import Found
from mocap.pipeline.replay import charts_of, person_summary, replay_of, speeds_m_s
from mocap.pose.angles import angles_of
from mocap.pose.contacts import Contacts
from mocap.pose.method import AngleSettings, Method
from mocap.pose.result import PersonPoses
from mocap.pose.steps import Gait, Stance, Step

BODY = scale_body(load_body_model("girdle"), 1.7)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Found:
    """A standing body carried along with the true pelvis; in frame 5 nobody is found."""
    session = open_session(small_session(tmp_path_factory.getbasetemp()))
    (truth,) = read_landmarks_csv(session.root / "truth" / "landmarks.csv")
    states = np.tile(neutral_state(BODY), (N_FRAMES, 1))
    states[:, :2] = truth.landmarks[:, 0, :2]
    keep = np.arange(N_FRAMES) != 5
    places = landmarks_of(BODY, states)[keep]
    n = len(places)
    poses = PersonPoses(
        person=1,
        body=BODY,
        height=HeightEstimate(1.7, True),
        frames=np.flatnonzero(keep),
        states=states[keep],
        landmarks=places,
        landmark_covariance=np.tile(1e-4 * np.eye(3), (n, places.shape[1], 1, 1)),
        observed=np.ones(places.shape[:2], dtype=bool),
        log_likelihood=np.zeros(n),
        ess_share=np.ones(n),
        start_frame=0,
        first_pose="",
    )
    store = StageStore(tmp_path_factory.mktemp("store") / "store.zarr")
    # As from keypoints: without hulls, of which there are none here.
    return Found(session, store, "keypoints", None, (poses,), Method())


def test_every_camera_has_a_video_with_the_body_in_it(found: Found, tmp_path: Path) -> None:
    written = overlay_videos(found, tmp_path, cameras=("cam_1", "cam_3"))
    assert [path.name for path in written] == ["overlay_cam_1.mp4", "overlay_cam_3.mp4"]
    assert sorted(p.name for p in tmp_path.iterdir()) == [path.name for path in written]
    filmed = read_clip(found.session.image_sources["cam_1"])
    shown = read_clip(written[0])
    assert len(shown) == N_FRAMES
    assert shown[0].shape == (SIZE[1], SIZE[0], 3)
    reader = cv2.VideoCapture(str(written[0]))
    assert reader.get(cv2.CAP_PROP_FPS) == pytest.approx(FPS)
    reader.release()
    changed = [np.abs(a.astype(int) - b).max(axis=2) > 60 for a, b in zip(shown, filmed, strict=True)]
    drawn = [int(c[40:].sum()) for c in changed]  # below the label
    assert drawn[5] < 0.2 * min(d for i, d in enumerate(drawn) if i != 5)


def test_masks_alone_have_no_video(found: Found, tmp_path: Path) -> None:
    from dataclasses import replace

    bare = replace(found, session=replace(found.session, image_sources={}))
    with pytest.raises(MocapError, match="no pictures"):
        overlay_videos(bare, tmp_path)
    shown = read_pictures(bare, report=OutputConfig())
    assert shown.sheets.files == shown.scene == ()
    assert {picture.shape for picture in shown.whole[0].values()} == {(SIZE[1], SIZE[0], 3)}


def test_a_camera_that_is_not_there_is_named(found: Found) -> None:
    with pytest.raises(MocapError, match="--cameras: there is no camera 'cam_9'"):
        check_cameras(found, ("cam_9",), "--cameras")
    check_cameras(found, None, "--cameras")


def test_the_scene_holds_the_pictures_that_were_asked_for(found: Found) -> None:
    assert [set(coded.files) for coded in read_pictures(found, scene=["cam_2"]).scene] == [
        {"cam_2"}
    ] * N_FRAMES
    assert read_pictures(found, scene=[]).scene == ()
    every = read_pictures(found, scene=None)
    assert [(coded.frame, set(coded.files)) for coded in every.scene] == [
        (frame, set(CAMERAS)) for frame in range(N_FRAMES)
    ]
    assert not every.whole, "without a report nothing is kept large"


def test_clips_are_read_once_for_report_and_scene(found: Found, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = [read_pictures(found, report=OutputConfig()), read_pictures(found, scene=None)]
    read: list[int] = []

    def counted(session: Session, frames: Sequence[int], names: Sequence[str]) -> FrameReader:
        read.extend(frames)
        return pictures_of(session, frames, names)

    monkeypatch.setattr(pictures, "pictures_of", counted)
    both = read_pictures(found, report=OutputConfig(), scene=None, n_threads=2)
    assert sorted(read) == [0, *range(N_FRAMES)], "the first one twice: it tells how large they may be"
    assert both.sheets.files == alone[0].sheets.files
    assert [c.files for c in both.scene] == [c.files for c in alone[1].scene]
    assert both.whole.keys() == alone[0].whole.keys()


def test_the_replay_has_every_frame_and_every_camera(found: Found) -> None:
    replay = replay_of(found, read_pictures(found, report=OutputConfig()).sheets)
    assert replay.frames.tolist() == replay.picture_frames.tolist() == list(range(N_FRAMES))
    assert len(replay.tiles) == len(CAMERAS)
    (person,) = replay.persons
    assert np.isnan(person.landmarks[5]).all()
    assert np.isfinite(person.landmarks[6]).all()
    sheet = cv2.imdecode(np.frombuffer(replay.sheets[0], np.uint8), cv2.IMREAD_COLOR)
    assert all(x + w <= sheet.shape[1] and y + h <= sheet.shape[0] for x, y, w, h in replay.tiles)


def test_pictures_get_fewer_when_there_is_little_room(found: Found) -> None:
    full = read_pictures(found, report=OutputConfig()).sheets
    limit = sum(len(s) for s in full.files) // 4
    small = read_pictures(found, report=OutputConfig(), sheet_bytes=limit).sheets
    assert 1 <= len(small.files) == len(small.frames) < N_FRAMES
    assert sum(len(s) for s in small.files) * 4 / 3 <= limit
    assert small.tiles[0][2] < full.tiles[0][2], "smaller before they get fewer"
    assert replay_of(found, small).frames.tolist() == list(range(N_FRAMES))


def test_speed_and_curves_have_gaps_where_nobody_was(found: Found) -> None:
    (poses,) = found.poses
    speed, std = speeds_m_s(poses, FPS)
    # A span reaches one frame to both sides: the ends, and the neighbours of the gap, are unknown.
    assert np.isnan(speed).tolist() == [int(f) in (0, 4, 6, N_FRAMES - 1) for f in poses.frames]
    assert 0.5 < np.nanmean(speed) < 1.6  # a walk
    assert std == pytest.approx(np.sqrt(2) * 0.006 * FPS / 2)
    heel_and_toe = np.tile([0.9, 0.1, 0.2, 0.3], (len(poses.frames), 1))
    gait = Gait(1, Contacts(heel_and_toe, np.zeros(4), np.zeros_like(heel_and_toe)))
    charts = charts_of(poses, angles_of(poses, FPS, AngleSettings()), gait, FPS)
    (contact,) = [c for c in charts if c.title == "Foot on the floor"]
    assert [(c.label, np.nanmax(c.values)) for c in contact.curves] == [("left", 0.9), ("right", 0.3)]
    without = charts_of(poses, angles_of(poses, FPS, AngleSettings()), Gait(1, None), FPS)
    assert {c.title for c in charts} - {c.title for c in without} == {"Foot on the floor"}
    instant = replace(poses, frames=poses.frames[:1])
    assert charts_of(instant, angles_of(poses, FPS, AngleSettings()), gait, FPS) == [], (
        "no lines, no empty grids"
    )
    assert {"Speed over the floor", "Hip flexion", "Knee flexion", "Pelvis tilt"} <= {c.title for c in charts}
    for chart in charts:
        assert chart.frames.tolist() == list(range(N_FRAMES))
        assert all(np.isnan(curve.values[5]) for curve in chart.curves)


def test_the_summary_is_a_table_to_paste(found: Found) -> None:
    (poses,) = found.poses
    angles = angles_of(poses, FPS, AngleSettings())
    lines = person_summary(poses, angles, Gait(1, None), FPS).split("\n")
    words = dict(line.split("\t", 1) for line in lines)
    assert "cadence" not in words
    still = Contacts(np.ones((2, 4)), np.zeros(4), np.ones((2, 4)))
    stance = Stance("left", 0, 1, 0.3, 0.3, (0.0, 0.0))
    gait = Gait(1, still, (stance,), (Step(stance, 0.61, 0.1, 0.5, 0.7, 0.4, 1.2),))
    told = dict(line.split("\t", 1) for line in person_summary(poses, angles, gait, FPS).split("\n"))
    assert told["cadence"] == "120 per minute"
    assert told["step length"] == "0.61 m"
    assert words["person"] == "1"
    assert words["body height"] == "1.70 m"
    assert words["followed"].startswith(f"{N_FRAMES - 1} frames")
    assert words["left knee flexion"].startswith("0\t0\t0\t")
