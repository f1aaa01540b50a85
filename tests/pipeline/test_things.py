"""Things that were tracked as persons are left out of what a run gives, and the run says so."""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from small_session import FPS, small_session
from two_persons import N_FRAMES, SETTINGS, two_persons_run, two_persons_session

from mocap.pipeline.config import load_config
from mocap.pipeline.edits.model import with_edit
from mocap.pipeline.finished import open_run
from mocap.pipeline.record import RunResult
from mocap.pipeline.run import run_session
from mocap.pipeline.stages import pose as pose_stage
from mocap.pose.method import ThingSettings
from mocap.pose.thing import Look, is_thing
from mocap.products.hulls import read_hulls


@pytest.fixture
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return two_persons_session(tmp_path_factory.getbasetemp())


@pytest.fixture
def out(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path) -> Path:
    return Path(shutil.copytree(two_persons_run(tmp_path_factory.getbasetemp()), tmp_path / "out"))


@pytest.fixture
def thing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Person 2 is like nobody, keeps his colours and has no head."""
    monkeypatch.setattr(pose_stage, "is_like_nobody", lambda xyz, *_: xyz[:, 0].mean() < 0)
    monkeypatch.setattr(pose_stage, "is_thing", lambda *_: True)


def anew(session: Path, out: Path, *settings: str) -> RunResult:
    """Poses once more, on what lies in the store."""
    for product in (out / "store.zarr").glob("pose*"):
        shutil.rmtree(product)
    config = load_config("default", (*SETTINGS, *settings))
    return run_session(session, out, config=config, resume=True)


def persons_of(path: Path) -> set[int]:
    with path.open(newline="") as file:
        return {int(row["person"]) for row in csv.DictReader(file)}


def test_a_thing_is_in_no_table_and_is_told_of(session: Path, out: Path, thing: None) -> None:
    before = (out / "landmarks.csv").read_text().splitlines()
    assert persons_of(out / "tracks.csv") == persons_of(out / "landmarks.csv") == {1, 2}
    result = anew(session, out)
    assert persons_of(out / "tracks.csv") == persons_of(out / "landmarks.csv") == {1}
    after = (out / "landmarks.csv").read_text().splitlines()
    assert after[1:] == [row for row in before[1:] if row.split(",")[2] == "1"]
    told = [words for words in result.record.warnings if "left out" in words]
    assert len(told) == 1
    assert re.search(r"at \(-0\.[789]\d, -?0\.\d\d\) m in frames 0-9 was tracked as person 2", told[0])
    assert not any(words.startswith("person 2:") for words in result.record.warnings)
    opened = open_run(out, session)
    assert opened.found.tracks is not None
    assert opened.found.tracks.persons == (1,)


def test_whose_poses_are_put_right_by_hand_is_no_thing(session: Path, out: Path, thing: None) -> None:
    text = with_edit("", {"do": "bad", "person": 2, "frames": "4:6"})
    (out / "edits.toml").write_text(text)
    result = anew(session, out)
    assert persons_of(out / "tracks.csv") == persons_of(out / "landmarks.csv") == {1, 2}
    assert not any("left out" in words for words in result.record.warnings)


@pytest.mark.parametrize(("least_s", "n_left"), [(N_FRAMES / FPS, 1), ((N_FRAMES + 1) / FPS, 2)])
def test_who_was_there_for_a_moment_is_not_asked(
    session: Path, out: Path, thing: None, least_s: float, n_left: int
) -> None:
    result = anew(session, out, f"method.thing.least_s={least_s}")
    assert len(result.poses) == n_left


def test_nobody_is_left(session: Path, out: Path, thing: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pose_stage, "is_like_nobody", lambda *_: True)
    result = anew(session, out)
    assert persons_of(out / "tracks.csv") == persons_of(out / "landmarks.csv") == set()
    assert sum("left out" in words for words in result.record.warnings) == 2


def test_who_walks_does_not_keep_his_colours(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Look] = []

    def judged(looks: Sequence[Look], voxel_size_m: float, numbers: ThingSettings) -> bool:
        asked.extend(looks)
        return is_thing(looks, voxel_size_m, numbers)

    monkeypatch.setattr(pose_stage, "is_like_nobody", lambda *_: True)
    monkeypatch.setattr(pose_stage, "is_thing", judged)
    config = load_config("default", (*SETTINGS, "method.thing.least_s=0"))
    session = small_session(tmp_path_factory.getbasetemp())
    result = run_session(session, tmp_path / "out", config=config, frames=(0, 6), until="pose")
    assert [poses.person for poses in result.poses] == [1]
    assert len(asked) == 6
    for (frame, hull), look in zip(read_hulls(result.found.store), asked, strict=True):
        row = np.isin(hull.voxels, look.surface)
        assert row.sum() == len(look.surface) > 100, frame
        assert (hull.is_surface & (hull.n_views > 0))[row].all()
        np.testing.assert_array_equal(hull.rgb[row], look.rgb)
        assert len(look.centers) > len(look.surface)
        assert np.isin(look.surface, hull.grid.voxels_of(look.centers)).all()
