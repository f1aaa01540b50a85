"""Detections and labels of a session: read, checked, written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from marker_world import ring

from mocap.data.detections import Detections
from mocap.errors import MocapError
from mocap.io.detections import read_detections, read_marker_labels, write_detections

RIG = ring(3)


def some() -> Detections:
    frame = (np.array([0, 0, 2, 5]), np.array([1]), np.zeros(0, dtype=np.int64))
    uv = tuple(np.random.default_rng(0).uniform(10, 200, (len(f), 2)) for f in frame)
    return Detections(RIG.names, tuple(f.astype(np.int64) for f in frame), uv)


def test_detections_survive_a_round_trip(tmp_path: Path) -> None:
    wanted = some()
    write_detections(tmp_path, wanted)
    sources = {n: tmp_path / f"{n}.csv" for n in RIG.names}
    found = read_detections(sources, RIG, range(6))
    for a, b in zip(found.uv, wanted.uv, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)
    assert [len(uv) for uv in found.at(0)] == [2, 0, 0]
    assert [len(uv) for uv in found.at(1)] == [0, 1, 0]
    assert [len(uv) for uv in found.at(3)] == [0, 0, 0]
    assert found.n_total == 5


def test_frames_outside_the_range_and_missing_files_are_left_out(tmp_path: Path) -> None:
    write_detections(tmp_path, some())
    found = read_detections({"cam_0": tmp_path / "cam_0.csv"}, RIG, range(1, 5))
    assert [len(f) for f in found.frame] == [1, 0, 0]


def test_a_detection_outside_the_picture_is_named(tmp_path: Path) -> None:
    path = tmp_path / "cam_1.csv"
    path.write_text("frame,u_px,v_px\n0,10,10\n3,1900,20\n")
    with pytest.raises(MocapError, match="320 x 248") as caught:
        read_detections({"cam_1": path}, RIG, range(6))
    assert caught.value.camera == "cam_1"
    assert caught.value.frame == 3


def test_labels_by_camera(tmp_path: Path) -> None:
    path = tmp_path / "marker_labels.csv"
    path.write_text("frame,camera,u_px,v_px\n4,cam_2,10,20\n4,cam_0,30,40\n4,cam_2,50,60\n")
    found = read_marker_labels(path, RIG)
    assert set(found) == {"cam_0", "cam_2"}
    frame, uv = found["cam_2"]
    np.testing.assert_array_equal(frame, [4, 4])
    np.testing.assert_array_equal(uv, [[10, 20], [50, 60]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frame,camera,u_px,v_px\n", "there are no labels"),
        ("frame,camera,u_px,v_px\n0,cam_9,1,1\n", "cam_9"),
        ("frame,camera,u_px,v_px\n0,cam_0,1,999\n", "outside the picture"),
        ("frame,camera,u_px\n0,cam_0,1\n", "v_px is missing"),
        ("frame,camera,u_px,v_px\n0,cam_0,one,1\n", "not a number"),
    ],
)
def test_bad_labels_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "marker_labels.csv"
    path.write_text(text)
    with pytest.raises(MocapError, match=message):
        read_marker_labels(path, RIG)


def test_detections_check_their_shapes() -> None:
    with pytest.raises(ValueError, match="uv has shape"):
        Detections(("a",), (np.zeros(2, dtype=np.int64),), (np.zeros((3, 2)),))
    with pytest.raises(ValueError, match="not ascending"):
        Detections(("a",), (np.array([2, 1]),), (np.zeros((2, 2)),))
