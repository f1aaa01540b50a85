"""Edits by hand of runs on keypoints or markers alone: the same verbs, and nobody is followed again without need."""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from keypoint_world import keypoint_world, write_keypoint_session
from marker_world import marker_world, write_marker_session

from mocap.data import LANDMARKS
from mocap.errors import MocapError
from mocap.io.tables import read_landmarks_csv, read_tracks_csv
from mocap.pipeline.config import Config, load_config
from mocap.pipeline.edits.model import with_edit
from mocap.pipeline.finished import check_edits, doubts_in, run_again
from mocap.pipeline.run import run_session
from mocap.pipeline.stages import keypoint_pose, markers

TABLES = ("pose.npz", "landmarks.csv", "tracks.csv")
BRIEF = ("output.formats=[]", "pose.n_start_frames=1", "pose.n_particles=40")
FEW = ("pose.n_layers=2", "pose.n_first_poses=3", "markers.n_hypotheses=2", "markers.fit_frames=8")
N_FRAMES = 12
WRIST = LANDMARKS.index("left_wrist")


def config(kind: str) -> Config:
    return load_config("default", (*BRIEF, *(FEW if kind == "markers" else ())))


@cache
def made(base: Path, kind: str) -> tuple[Path, Path]:
    """A session and a run on it. Never change them: copy them."""
    root = base / f"edits_{kind}"
    if kind == "markers":
        session = write_marker_session(marker_world(N_FRAMES), root / "session")
    else:
        session = write_keypoint_session(keypoint_world(N_FRAMES, apart_m=1.1), root / "session")
    run_session(session, root / "out", config=config(kind))
    return session, root / "out"


@pytest.fixture
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.getbasetemp()


def copy_of(base: Path, kind: str, tmp_path: Path) -> tuple[Path, Path]:
    session, out = made(base, kind)
    return session, Path(shutil.copytree(out, tmp_path / "out"))


def edit(out: Path, **values: object) -> None:
    path = out / "edits.toml"
    path.write_text(with_edit(path.read_text() if path.exists() else "", values))


def tables(out: Path) -> dict[str, bytes]:
    return {name: (out / name).read_bytes() for name in TABLES}


@pytest.fixture
def followed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The persons that were followed anew."""
    who: list[int] = []
    keypoints, wearer = keypoint_pose.follow_keypoints, markers.follow_markers
    monkeypatch.setattr(
        keypoint_pose,
        "follow_keypoints",
        lambda seen, *rest, **named: who.append(seen.person) or keypoints(seen, *rest, **named),
    )
    monkeypatch.setattr(
        markers,
        "follow_markers",
        lambda *rest, **named: who.append(named["person"]) or wearer(*rest, **named),
    )
    return who


@pytest.mark.parametrize("kind", ["keypoints", "markers"])
def test_edits_of_poses_follow_nobody_again_and_a_run_anew_gives_the_same(
    kind: str, base: Path, tmp_path: Path, followed: list[int]
) -> None:
    session, out = copy_of(base, kind, tmp_path)
    followed.clear()
    right = tables(out)
    before = np.load(out / "pose.npz")
    place = before["person_1_landmarks_m"][6, WRIST] + (0.0, 0.0, 0.06)
    edit(out, do="pin", person=1, landmark="left_wrist", frame=6, place_m=place.tolist())
    edit(out, do="bad", person=1, frames="2:4")
    edit(out, do="exchange", person=1, frames="9:", sides="arms")
    result = run_again(out, session)
    assert followed == []
    assert any("3 edits by hand" in warning for warning in result.warnings)
    after = np.load(out / "pose.npz")
    pinned = after["person_1_landmarks_m"][6, WRIST]
    # A frame is smoothed with its neighbours, whose arm the evidence keeps where it was.
    assert np.linalg.norm(pinned - place) < 0.045, "the pin pulls"
    assert not after["person_1_observed"][2:4].any()
    assert after["person_1_observed"][6, WRIST]
    spread = [np.trace(z["person_1_landmark_covariance_m2"][3, WRIST]) for z in (before, after)]
    assert spread[1] > spread[0], "what is bridged is less sure"
    fresh = tmp_path / "fresh"
    fresh.mkdir()
    shutil.copy(out / "edits.toml", fresh)
    run_session(session, fresh, config=config(kind))
    assert tables(fresh) == tables(out)
    followed.clear()
    (out / "edits.toml").unlink()
    run_again(out, session)
    assert followed == []
    assert tables(out) == right


def test_two_people_in_keypoints_change_numbers_and_back(
    base: Path, tmp_path: Path, followed: list[int]
) -> None:
    session, out = copy_of(base, "keypoints", tmp_path)
    followed.clear()
    right = tables(out)
    one, two = read_landmarks_csv(out / "landmarks.csv")
    edit(out, do="swap", persons=[1, 2])
    run_again(out, session)
    assert sorted(followed) == [1, 2]
    swapped = read_landmarks_csv(out / "landmarks.csv")
    for found, was in zip(swapped, (two, one), strict=True):
        assert np.linalg.norm(found.landmarks - was.landmarks, axis=2).max() < 0.05
    tracks = read_tracks_csv(out / "tracks.csv")
    assert np.abs(tracks.of(1).xyz[:, :2] - two.landmarks[:, 0, :2]).max() < 0.2, "tracks are called alike"
    edit(out, do="swap", persons=[1, 2])
    run_again(out, session)
    assert tables(out) == right


@pytest.mark.parametrize(
    ("kind", "persons", "new"),
    [
        pytest.param("keypoints", [1, 2], 3, id="keypoints"),
        pytest.param("markers", [1], 2, id="markers", marks=pytest.mark.slow),
    ],
)
def test_split_merge_and_delete(
    kind: str, persons: list[int], new: int, base: Path, tmp_path: Path, followed: list[int]
) -> None:
    session, out = copy_of(base, kind, tmp_path)
    followed.clear()
    right = tables(out)
    edit(out, do="split", person=persons[-1], frames="6:")
    run_again(out, session)
    assert sorted(followed) == [persons[-1], new], "the others are taken from the store"
    poses = np.load(out / "pose.npz")
    assert poses["persons"].tolist() == [*persons, new]
    assert poses[f"person_{new}_frames"].tolist() == list(range(6, N_FRAMES))
    edit(out, do="merge", persons=[persons[-1], new])
    run_again(out, session)
    assert tables(out) == right
    edit(out, do="delete", person=persons[-1], frames="3:5")
    run_again(out, session)
    left = np.load(out / "pose.npz")[f"person_{persons[-1]}_frames"].tolist()
    assert left == [0, 1, 2, *range(5, N_FRAMES)]
    assert sorted(set(read_tracks_csv(out / "tracks.csv").of(persons[-1]).frame.tolist())) == left


@pytest.mark.parametrize(
    ("kind", "values", "words"),
    [
        ("markers", {"do": "swap", "persons": [1, 2]}, ["no person 2", "there are 1"]),
        ("keypoints", {"do": "merge", "persons": [1, 2]}, ["both there in 12 frames from 0 on"]),
        (
            "keypoints",
            {"do": "pin", "person": 1, "landmark": "head", "frame": 3, "place_m": [3, 3, 1]},
            ["cannot reach", "head"],
        ),
    ],
)
def test_what_cannot_be_is_said_before_the_file_is_written(
    kind: str, values: dict[str, object], words: list[str], base: Path, tmp_path: Path
) -> None:
    from mocap.pipeline.edits.model import parse_edits

    _, out = copy_of(base, kind, tmp_path)
    with pytest.raises(MocapError) as caught:
        check_edits(out, parse_edits(with_edit("", values), out / "edits.toml"))
    for word in words:
        assert word in str(caught.value)
    assert doubts_in(out) is not None
