"""Report and scene of a finished run, written again without running anything."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from small_session import SETTINGS, copy_session, mocap, set_options, small_session

N_FRAMES = 2


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `session` and its run in `out`. Never change it: copy it."""
    folder = tmp_path_factory.mktemp("made")
    session = copy_session(
        small_session(tmp_path_factory.getbasetemp()), folder / "session", masks=True, n_frames=N_FRAMES
    )
    said = mocap("run", session, "-o", folder / "out", *set_options(SETTINGS), "--seed", 3)
    assert said.code == 0, said.err
    return folder


def pictures(page: Path) -> list[str]:
    return re.findall(r"data:image/jpeg;base64,[^\"')]+", page.read_text(encoding="utf-8"))


def words(page: Path) -> str:
    """The text of a page up to its list of files, without pictures and times."""
    text = re.sub(r"data:image/[^\"')]+", "", page.read_text(encoding="utf-8"))
    text = text.rsplit("Settings and files", 1)[0]
    return re.sub(r"\d+(\.\d+)?", "#", re.sub(r"<[^>]+>", " ", text))


def test_the_report_is_the_one_of_the_run(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "out", tmp_path / "out")
    first = tmp_path / "out" / "report.html"
    expected = (pictures(first), words(first))
    stages = {p: p.stat().st_mtime_ns for p in (tmp_path / "out").rglob("zarr.json")}
    first.unlink()
    said = mocap("report", tmp_path / "out", made / "session")
    assert said.code == 0, said.err
    assert len(expected[0]) > 0
    assert (pictures(first), words(first)) == expected
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "out").rglob("zarr.json")} == stages
    assert not list((tmp_path / "out").glob("*.part"))
    said = mocap("report", tmp_path / "out", made / "session", "--video")
    assert said.code == 2
    assert "no pictures" in said.err  # a session of masks


def test_the_scene_is_written_again(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rerun", reason="needs the extra view")
    opened: list[list[str]] = []
    told: list[list[str]] = []
    monkeypatch.setattr(subprocess, "Popen", lambda command, **more: opened.append(command))
    monkeypatch.setattr(subprocess, "run", lambda command, **more: told.append(command))
    shutil.copytree(made / "out", tmp_path / "out")
    size = (tmp_path / "out" / "scene.rrd").stat().st_size
    assert str(tmp_path / "out" / "scene.rrd") in mocap("view", tmp_path / "out").out
    (tmp_path / "out" / "scene.rrd").unlink()
    missing = mocap("view", tmp_path / "out")
    assert (missing.code, opened) == (2, [])
    assert "mocap view OUT SESSION" in missing.err
    other = tmp_path / "other.rrd"
    assert mocap("view", tmp_path / "out", made / "session", "-o", other).code == 0
    # Rerun stamps its files with ids of its own and cuts them into chunks by the clock; the content is of one size.
    assert other.stat().st_size == pytest.approx(size, rel=0.25)
    assert opened == []  # no window unless asked
    assert mocap("view", tmp_path / "out", made / "session", "--open").code == 0
    assert opened[0][1:] == ["-m", "rerun", str(tmp_path / "out" / "scene.rrd")]
    assert [command[1:] for command in told] == [["-m", "rerun", "analytics", "disable"]]
    assert "no camera 'cam_9'" in mocap("view", tmp_path / "out", made / "session", "--pictures", "cam_9").err
    assert "needs the session" in mocap("view", tmp_path / "out", "--pictures", "cam_0").err


def test_mistakes(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "out", tmp_path / "out")
    assert "no result of a run" in mocap("report", tmp_path, made / "session").err
    assert "comes before the session" in mocap("report", made / "session", tmp_path / "out").err
    path = tmp_path / "out" / "run.json"
    about = json.loads(path.read_text())
    for change, message in (
        ({"cameras": ["a", "b"]}, "not that of the run: cameras"),
        ({"fps": 12.5}, "not that of the run: fps"),
        ({"until": "carve"}, "has no poses"),
        ({"config": {**about["config"], "old": 1}}, "settings that this version does not know"),
    ):
        path.write_text(json.dumps({**about, **change}))
        said = mocap("report", tmp_path / "out", made / "session")
        assert said.code == 2
        assert message in said.err
    del about["numbers"]
    path.write_text(json.dumps(about))
    assert "says nothing of numbers" in mocap("report", tmp_path / "out", made / "session").err
    assert "needs the session" in mocap("view", tmp_path / "out", "-o", tmp_path / "x.rrd").err
