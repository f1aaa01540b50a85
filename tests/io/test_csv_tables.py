"""The CSV tables come back as written, and a bad line is named."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from mocap.data import LANDMARKS, Motion, Tracks
from mocap.errors import MocapError
from mocap.io.tables import (
    read_detections_csv,
    read_landmarks_csv,
    read_tracks_csv,
    write_detections_csv,
    write_landmarks_csv,
    write_tracks_csv,
)

# Half of the last decimal that is written.
DECIMALS = 5.1e-7


def motion(person: int, n: int, *, is_estimate: bool) -> Motion:
    rng = np.random.default_rng(person)
    landmarks = rng.normal(size=(n, len(LANDMARKS), 3))
    landmarks[1, 4] = np.nan
    std = rng.random((n, len(LANDMARKS), 3)) if is_estimate else None
    observed = rng.random((n, len(LANDMARKS))) < 0.5 if is_estimate else None
    frames = np.arange(n, dtype=np.int64) * 2 + person
    return Motion(person, frames, frames / 25.0, landmarks, std, observed)


@pytest.mark.parametrize("is_estimate", [True, False])
def test_landmarks_round_trip(tmp_path: Path, is_estimate: bool) -> None:
    motions = [motion(3, 4, is_estimate=is_estimate), motion(1, 6, is_estimate=is_estimate)]
    path = tmp_path / "deep" / "landmarks.csv"
    write_landmarks_csv(path, motions)
    header = path.read_text().split("\n")[0]
    expected = "frame,time_s,person,landmark,x_m,y_m,z_m"
    assert header == expected + (",std_x_m,std_y_m,std_z_m,observed" if is_estimate else "")
    read = read_landmarks_csv(path)
    assert [m.person for m in read] == [1, 3]
    for a, b in zip(read, reversed(motions), strict=True):
        np.testing.assert_array_equal(a.frames, b.frames)
        np.testing.assert_allclose(a.time_s, b.time_s, atol=DECIMALS)
        np.testing.assert_allclose(a.landmarks, b.landmarks, atol=DECIMALS)
        if is_estimate:
            assert a.std is not None
            assert b.std is not None
            np.testing.assert_allclose(a.std, b.std, atol=DECIMALS)
            np.testing.assert_array_equal(a.observed, b.observed)
        else:
            assert a.std is None
            assert a.observed is None


def test_estimate_beside_motion_without_uncertainty(tmp_path: Path) -> None:
    write_landmarks_csv(tmp_path / "l.csv", [motion(1, 3, is_estimate=True), motion(2, 3, is_estimate=False)])
    one, two = read_landmarks_csv(tmp_path / "l.csv")
    assert one.std is not None
    assert one.observed is not None
    assert two.std is None
    assert two.observed is None


def test_tracks_round_trip_and_sorting(tmp_path: Path) -> None:
    frame, person = np.array([4, 2, 2]), np.array([1, 7, 3])
    tracks = Tracks(frame, person, frame / 30, np.arange(9.0).reshape(3, 3) / 7)
    write_tracks_csv(tmp_path / "t.csv", tracks)
    read = read_tracks_csv(tmp_path / "t.csv")
    assert read.frame.tolist() == [2, 2, 4]
    assert read.person.tolist() == [3, 7, 1]
    np.testing.assert_allclose(read.xyz, tracks.xyz[[2, 1, 0]], atol=DECIMALS)


def test_empty_tables(tmp_path: Path) -> None:
    empty = np.array([], dtype=np.int64)
    write_tracks_csv(tmp_path / "t.csv", Tracks(empty, empty, empty.astype(float), np.zeros((0, 3))))
    assert len(read_tracks_csv(tmp_path / "t.csv")) == 0
    assert read_tracks_csv(tmp_path / "t.csv").xyz.shape == (0, 3)
    write_landmarks_csv(tmp_path / "l.csv", [])
    assert read_landmarks_csv(tmp_path / "l.csv") == []


def test_tracks_with_covariance_and_status_round_trip(tmp_path: Path) -> None:
    variance = np.array([[0.04, 0.01, 0.0225], [0.0009, 0.0016, 0.0025]])
    tracks = Tracks(
        np.array([3, 4]),
        np.array([2, 2]),
        np.array([0.3, 0.4]),
        np.array([[1.0, 2.0, 0.9], [1.1, 2.0, 0.9]]),
        variance[:, :, None] * np.eye(3),
        np.array([True, False]),
    )
    write_tracks_csv(tmp_path / "t.csv", tracks)
    lines = (tmp_path / "t.csv").read_text().splitlines()
    assert lines[0] == "frame,time_s,person,x_m,y_m,z_m,std_x_m,std_y_m,std_z_m,status"
    assert lines[1].endswith(",0.200000,0.100000,0.150000,confirmed")
    assert lines[2].endswith(",coasting")
    read = read_tracks_csv(tmp_path / "t.csv")
    assert read.covariance is not None
    np.testing.assert_allclose(read.covariance, tracks.covariance, atol=1e-9)
    np.testing.assert_array_equal(read.observed, tracks.observed)
    np.testing.assert_array_equal(read.of(2).observed, tracks.observed)


def test_tracks_of_a_truth_know_neither(tmp_path: Path) -> None:
    write_tracks_csv(tmp_path / "t.csv", Tracks(np.array([0]), np.array([1]), np.zeros(1), np.zeros((1, 3))))
    assert (tmp_path / "t.csv").read_text().splitlines()[0] == "frame,time_s,person,x_m,y_m,z_m"
    read = read_tracks_csv(tmp_path / "t.csv")
    assert (read.covariance, read.observed) == (None, None)


def test_unknown_status_is_named(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("frame,time_s,person,x_m,y_m,z_m,status\n0,0,1,0,0,0,asleep\n")
    with pytest.raises(MocapError, match="status is 'asleep'"):
        read_tracks_csv(tmp_path / "t.csv")


def test_column_order_is_free_and_more_columns_do_no_harm(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("\ufeffperson,frame, x_m,y_m,z_m,time_s,note\r\n2,5,1,2,3,0.5,hello\r\n")
    read = read_tracks_csv(tmp_path / "t.csv")
    assert (read.frame[0], read.person[0], read.time_s[0]) == (5, 2, 0.5)
    assert read.xyz[0].tolist() == [1, 2, 3]


def test_detections_round_trip(tmp_path: Path) -> None:
    write_detections_csv(tmp_path / "d.csv", np.array([3, 1, 3]), np.array([[1.5, 2], [3, 4], [5, 6.25]]))
    frame, uv = read_detections_csv(tmp_path / "d.csv")
    assert frame.tolist() == [1, 3, 3]
    assert uv.tolist() == [[3, 4], [1.5, 2], [5, 6.25]]


LANDMARK_HEADER = "frame,time_s,person,landmark,x_m,y_m,z_m\n"


@pytest.mark.parametrize(
    ("table", "text", "message"),
    [
        ("tracks", "frame,time_s,person,x_m,y_m\n", "line 1: column z_m is missing"),
        ("tracks", "", "line 1: column frame"),
        ("tracks", "frame,time_s,person,x_m,y_m,z_m\n0,0,1,0,0,0\n1,0,1,0,zero,0\n", "line 3: y_m is 'zero'"),
        ("tracks", "frame,time_s,person,x_m,y_m,z_m\n0,0,1,0,0,nan\n", "line 2: z_m is 'nan'"),
        ("tracks", "frame,time_s,person,x_m,y_m,z_m\n0,0,1,0,0\n", "line 2: 5 fields, expected 6"),
        (
            "tracks",
            "frame,time_s,person,x_m,y_m,z_m\n0,0,1,0,0,0\n0,0,1,0,0,0\n",
            "line 3: frame 0 of person 1",
        ),
        ("tracks", "frame,time_s,person,x_m,y_m,z_m\n0.5,0,1,0,0,0\n", "line 2: frame is '0.5'"),
        ("landmarks", LANDMARK_HEADER + "0,0,1,nose,0,0,0\n", "line 2: unknown landmark 'nose'"),
        ("landmarks", LANDMARK_HEADER + "0,0,1,head,0,0,inf\n", "line 2: z_m is 'inf'"),
        ("landmarks", LANDMARK_HEADER + "0,0,1,head,0,0,0\n\n0,0,1,head,0,0,0\n", "line 4: head of person 1"),
        ("landmarks", LANDMARK_HEADER.strip() + ",observed\n0,0,1,head,0,0,0,maybe\n", "line 2: observed"),
        ("landmarks", "frame,frame,time_s,person,landmark,x_m,y_m,z_m\n", "line 1: a column is there twice"),
        ("detections", "frame,u_px\n", "line 1: column v_px is missing"),
    ],
)
def test_bad_tables_name_the_line(tmp_path: Path, table: str, text: str, message: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    reader = {"tracks": read_tracks_csv, "landmarks": read_landmarks_csv, "detections": read_detections_csv}[
        table
    ]
    with pytest.raises(MocapError) as caught:
        reader(path)
    assert message in str(caught.value)
    assert caught.value.path == path


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="cannot be read"):
        read_tracks_csv(tmp_path / "none.csv")
    (tmp_path / "b.csv").write_bytes(bytes(range(128, 256)))
    with pytest.raises(MocapError, match="not a CSV"):
        read_tracks_csv(tmp_path / "b.csv")


def test_disk_full_leaves_the_old_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "t.csv"
    path.write_text("old")

    def full(*_args: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    one = np.array([1])
    with pytest.raises(MocapError, match="disk is full") as caught:
        write_tracks_csv(path, Tracks(one, one, one / 2, np.zeros((1, 3))))
    assert caught.value.path == path
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["t.csv"]
