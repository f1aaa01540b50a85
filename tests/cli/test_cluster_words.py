"""What `mocap sweep` and `mocap batch` say of their progress, and that every command of ours has help."""

from __future__ import annotations

import signal
from pathlib import Path
from types import SimpleNamespace

import pytest
from small_session import mocap

from mocap.cli import progress
from mocap.cli.progress import cell_progress, duration_text, progress_text
from mocap.pipeline.cluster import Standing
from mocap.portable import Stopped


@pytest.mark.parametrize("command", ["batch", "sweep", "view", "report", "calibrate"])
def test_help_of_every_command(command: str) -> None:
    said = mocap(command, "--help")
    assert said.code == 0
    assert "Usage" in said.out


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.2, "1 s"), (59.4, "59 s"), (80, "1 min 20 s"), (3599.4, "59 min 59 s"), (7500, "2 h 5 min")],
)
def test_durations(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text


def test_progress() -> None:
    assert progress_text(Standing(10, 4, 1, 2, 3, 30.0)) == (
        "4/10 cells, 1 failed, 2 from earlier, 3 workers, about 1 min 30 s left"
    )
    assert progress_text(Standing(10, 2, 0, 2, 0, 30.0)) == "2/10 cells, 2 from earlier"
    assert progress_text(Standing(10, 10, 0, 0, 1, 30.0)) == "10/10 cells, 1 worker"


def test_lines_are_rare_and_the_last_one_comes(capsys: pytest.CaptureFixture[str]) -> None:
    say = cell_progress("sweep")
    for n in range(301):
        say(Standing(300, n, 0, 0, 2, 0.1 * n))
    assert capsys.readouterr().err == "sweep: 300/300 cells, 2 workers\n"


def test_the_time_left_is_that_of_what_was_done_since_the_stage_began(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter([0.0, 5.0, 12.0, 13.0, 60.0])
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    show = progress._lines()
    for done in (100, 110, 124, 126, 200):  # 100 frames were there before: two a second since
        show("pose", done, 200)
    assert capsys.readouterr().err == "pose: 124/200, about 38 s left\npose: 200/200\n"


def test_ctrl_c_says_how_to_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import mocap.pipeline.cluster as cluster

    def stop(*arguments: object, **more: object) -> None:
        raise Stopped(signal.SIGINT)

    monkeypatch.setattr(cluster, "run_sweep", stop)
    (tmp_path / "walk" / "masks").mkdir(parents=True)
    spec = tmp_path / "sweep.toml"
    spec.write_text('sessions = ["walk"]')
    said = mocap("sweep", spec, "-o", tmp_path / "out")
    assert said.code == 130
    assert "repeat the command to go on" in said.err
