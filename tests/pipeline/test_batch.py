"""Batches: which folders are sessions, one whole run for each, a table, and nothing is run twice."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import pytest
from small_session import copy_session, mocap, small_session

from mocap.errors import MocapError
from mocap.pipeline.cluster import find_sessions

SETTINGS = (
    "volume.voxel_size_m=0.05",
    "pose.n_layers=1",
    "pose.n_particles=40",
    "pose.n_start_frames=1",
    "pose.n_first_poses=1",
    'output.formats=["bvh"]',
)


def test_sessions_and_folders_of_sessions(tmp_path: Path) -> None:
    for name in ("all/walk/masks", "all/box/videos", "all/notes", "one/images"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "all" / "only_calibrated").mkdir()
    (tmp_path / "all" / "only_calibrated" / "calibration.json").touch()
    found = find_sessions([tmp_path / "all", tmp_path / "one", tmp_path / "all" / "walk"])
    assert [p.name for p in found] == ["box", "only_calibrated", "walk", "one"]
    with pytest.raises(MocapError, match="is no session and holds none"):
        find_sessions([tmp_path / "all" / "notes"])
    with pytest.raises(MocapError, match="no such folder"):
        find_sessions([tmp_path / "nothing"])


def test_a_batch_is_one_run_for_each_and_is_not_repeated(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    whole = small_session(tmp_path_factory.getbasetemp())
    for name, n in (("a", 2), ("b", 3)):
        copy_session(whole, tmp_path / "sessions" / name, masks=True, n_frames=n)
    shutil.copytree(tmp_path / "sessions" / "a", tmp_path / "sessions" / "broken")
    (tmp_path / "sessions" / "broken" / "calibration.toml").write_text("nothing = 1\n")
    out = tmp_path / "out"
    command = ("batch", tmp_path / "sessions", "-o", out, "--workers", 0)
    command += tuple(word for setting in SETTINGS for word in ("--set", setting))

    said = mocap(*command)
    assert said.code == 1
    assert "3 sessions into" in said.out
    assert "failed: session broken" in said.out
    with (out / "table.csv").open(encoding="utf-8", newline="") as stream:
        table = list(csv.DictReader(stream))
    assert [(r["session"], r["status"], r["n_frames"]) for r in table] == [
        ("a", "done", "2"),
        ("b", "done", "3"),
        ("broken", "failed", ""),
    ]
    assert float(table[1]["mean_error_mm"]) > 0
    for name in ("a", "b"):
        assert (out / "runs" / name / "person_1.bvh").is_file()
    before = {p: p.stat().st_mtime_ns for p in out.glob("runs/*/run.json")}
    assert len(before) == 2
    tables = {
        name: (out / name).read_bytes() for name in ("table.csv", "table.json", "summary.csv", "table.html")
    }

    (out / "runs" / "a" / "run.json").unlink()  # somebody has removed a result: only that one is made again
    assert mocap(*command).code == 1
    after = {p: p.stat().st_mtime_ns for p in before}
    assert [p.parent.name for p in before if before[p] != after[p]] == ["a"]
    assert {name: (out / name).read_bytes() for name in tables} == tables
