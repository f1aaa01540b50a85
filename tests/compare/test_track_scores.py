"""`mocap eval` on tracks without poses: scores of who was where, by counts that can be made by hand."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from small_session import mocap

from mocap.compare import CompareOptions, compare
from mocap.data import Tracks
from mocap.errors import MocapError
from mocap.io.tables import write_tracks_csv

FPS = 20.0


def tracks(*lives: tuple[int, range, float]) -> Tracks:
    """Persons (number, frames, x) who stand still at y = 0."""
    rows = sorted((f, person, x) for person, frames, x in lives for f in frames)
    frame = np.array([r[0] for r in rows], dtype=np.int64)
    xyz = np.array([(r[2], 0.0, 0.9) for r in rows]).reshape(-1, 3)
    return Tracks(frame, np.array([r[1] for r in rows], dtype=np.int64), frame / FPS, xyz)


def session(tmp_path: Path) -> Path:
    """Person 1 in frames 0-39, person 2 in 10-29; nobody in 40-49."""
    truth = tmp_path / "session" / "truth"
    truth.mkdir(parents=True)
    write_tracks_csv(truth / "tracks.csv", tracks((1, range(40), 0.0), (2, range(10, 30), 1.5)))
    return truth.parent


def run(tmp_path: Path, found: Tracks, frames: tuple[int, int] | None = (0, 50)) -> Path:
    out = tmp_path / "out"
    out.mkdir(exist_ok=True)
    write_tracks_csv(out / "tracks.csv", found)
    if frames is not None:
        (out / "run.json").write_text(json.dumps({"frames": frames}))
    return out


def test_misses_false_positives_and_mismatches_are_counted(tmp_path: Path) -> None:
    """Two frames missed, three of a phantom, one exchange of numbers; everything is 3 cm off."""
    found = tracks(
        (7, range(2, 40), 0.03), (8, range(10, 20), 1.53), (9, range(20, 30), 1.53), (5, range(44, 47), -1)
    )
    done = compare(run(tmp_path, found), session(tmp_path))
    scores = done.scores
    assert (scores["misses"], scores["false_positives"], scores["mismatches"]) == (2, 3, 1)
    assert scores["mota_percent"] == pytest.approx(100 * (1 - 6 / 60))
    assert scores["motp_mm"] == pytest.approx(30.0)
    assert 0 < scores["hota_percent"] < 100
    # 38 + 10 frames of 60 belong to one true and one found person: 2 * 48 / (60 + 61).
    assert scores["idf1_percent"] == pytest.approx(100 * 2 * 48 / (60 + 61))
    assert scores["mean_error_mm"] is None
    assert scores["tracks_only"]
    assert scores["estimate"]["persons"] == 4
    assert scores["truth"]["frames"] == 40
    assert "the run has no landmarks.csv" in scores["notes"][0]


def test_frames_that_the_run_did_not_work_on_are_not_scored(tmp_path: Path) -> None:
    there = session(tmp_path)
    found = tracks((1, range(10), 0.0), (9, range(45, 48), 0.0))
    assert compare(run(tmp_path, found, (0, 10)), there).scores["mota_percent"] == 100.0
    assert compare(run(tmp_path, found, (0, 50)), there).scores["false_positives"] == 3
    # Without run.json every frame of either table counts.
    (tmp_path / "out" / "run.json").unlink()
    assert compare(tmp_path / "out", there).scores["misses"] == 30 + 20


def test_numbers_of_frames_can_be_shifted(tmp_path: Path) -> None:
    there = session(tmp_path)
    found = run(tmp_path, tracks((1, range(100, 140), 0.0), (2, range(110, 130), 1.5)), (100, 150))
    with pytest.raises(MocapError, match="no frame in common"):
        compare(found, there)
    for options in (CompareOptions(frame_offset=-100), CompareOptions(time_offset_s=-5.0)):
        scores = compare(found, there, options).scores
        assert (scores["mota_percent"], scores["motp_mm"]) == (100.0, 0.0)
        assert "-100 frames added" in scores["notes"][1]


def test_nobody_was_found(tmp_path: Path) -> None:
    scores = compare(run(tmp_path, tracks()), session(tmp_path)).scores
    assert (scores["mota_percent"], scores["misses"], scores["motp_mm"]) == (0.0, 60, None)


def test_truth_without_poses_is_enough(tmp_path: Path) -> None:
    """A run with poses against a recording of which only positions are known."""
    out = run(tmp_path, tracks((1, range(40), 0.0), (2, range(10, 30), 1.5)))
    (out / "landmarks.csv").write_text("frame,time_s,person,landmark,x_m,y_m,z_m\n")
    scores = compare(out, session(tmp_path)).scores
    assert scores["mota_percent"] == 100.0
    assert "the truth has no landmarks.csv" in scores["notes"][0]


def test_command_prints_table_json_and_page(tmp_path: Path) -> None:
    out, there = run(tmp_path, tracks((1, range(40), 0.05))), session(tmp_path)
    said = mocap("eval", out, there)
    assert said.code == 0, said.err
    for words in (
        "of the tracks alone",
        "MOTP",
        "50.0 mm",
        "MOTA",
        "HOTA",
        "IDF1",
    ):
        assert words in said.out
    assert re.search(r"Misses +20\n +False positives +0\n", said.out)
    assert "epsilon" not in said.out
    page = tmp_path / "page.html"
    said = mocap("eval", out, there, "--json", "--html", page)
    assert json.loads(said.out)["mota_percent"] == pytest.approx(100 * 40 / 60)
    assert "MOTA" in page.read_text()


def test_folder_without_either_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    said = mocap("eval", tmp_path / "empty", session(tmp_path))
    assert said.code == 2
    assert "Traceback" not in said.err
    said = mocap("eval", run(tmp_path, tracks((1, range(4), 0.0))), tmp_path / "empty")
    assert said.code == 2
    assert "Traceback" not in said.err
