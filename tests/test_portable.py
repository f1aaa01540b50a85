"""What differs between systems: the package runs where modules of one system are missing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from marker_world import marker_world, write_marker_session

import mocap
from mocap import portable
from mocap.io.video import clip_info

BLOCKED = ("resource", "fcntl", "pwd", "grp", "termios")


def test_memory_of_this_process_and_machine() -> None:
    peak = portable.peak_memory_mb()
    total = portable.total_memory_bytes()
    assert peak is not None
    assert total is not None
    assert 10 < peak < total / 1e6


@pytest.mark.parametrize(("system", "expected_mb"), [("linux", 2000.0), ("darwin", 2000.0 / 1024)])
def test_units_of_the_system(system: str, expected_mb: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Linux counts kB, macOS bytes."""
    resource = pytest.importorskip("resource")

    class Usage:
        ru_maxrss = 2000 * 1024

    monkeypatch.setattr(resource, "getrusage", lambda who: Usage)
    monkeypatch.setattr(portable.sys, "platform", system)
    assert portable.peak_memory_mb() == pytest.approx(expected_mb, abs=0.06)


def test_processes_that_are_there_and_not() -> None:
    assert portable.is_running(os.getpid())
    done = subprocess.Popen([sys.executable, "-c", ""])
    done.wait()
    assert not portable.is_running(done.pid)
    assert not portable.is_running(2**40)


@pytest.mark.skipif(os.name == "nt", reason="signals of Unix")
def test_signals_are_raised_where_nobody_ignores_them() -> None:
    before = {n: signal.getsignal(n) for n in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)}
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)

    def work() -> None:
        with portable.stoppable():
            signal.raise_signal(signal.SIGHUP)  # as under nohup
            signal.raise_signal(signal.SIGTERM)

    try:
        with pytest.raises(portable.Stopped, match="SIGTERM") as caught:
            work()
        assert caught.value.number == signal.SIGTERM
        assert not isinstance(caught.value, Exception)
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_a_file_is_locked_once(tmp_path: Path) -> None:
    with (tmp_path / "a").open("w") as one, (tmp_path / "a").open("w") as two:
        assert portable.lock_file(one)
        assert portable.lock_file(two) is False
    with (tmp_path / "a").open("w") as three:
        assert portable.lock_file(three)


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are Unicode there")
def test_a_video_whose_name_is_no_utf_8_is_written_and_read(tmp_path: Path) -> None:
    """OpenCV would end the process: a Latin name, or any with an umlaut under an ASCII locale."""
    path = tmp_path / os.fsdecode(b"\xe4.mp4")
    with portable.utf8_name(path) as name:
        writer = cv2.VideoWriter(name, cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (64, 48))
    for _ in range(3):
        writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    found = clip_info(path)
    assert (found.n_frames, found.size) == (3, (64, 48))
    assert not Path(name).parent.exists()


def test_a_name_in_utf_8_stays_what_it_is(tmp_path: Path) -> None:
    path = tmp_path / "\u00e4.mp4"
    with portable.utf8_name(path) as name:
        assert name == str(path)


def test_a_run_without_the_modules_of_one_system(tmp_path: Path) -> None:
    """As on Windows, where they do not exist."""
    session = write_marker_session(marker_world(6), tmp_path / "session")
    code = f"""
import sys
for name in {BLOCKED!r}:
    sys.modules[name] = None
import mocap.pipeline.cluster, mocap.cli
from mocap import load_config, run_session
from mocap.portable import lock_file, peak_memory_mb
assert peak_memory_mb() is None
result = run_session({str(session)!r}, {str(tmp_path / "out")!r}, config=load_config(), until="segment")
print(result.status, result.record.peak_memory_mb)
"""
    environment = {**os.environ, "PYTHONPATH": str(Path(mocap.__file__).parents[1])}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "complete until segment None"
    assert (tmp_path / "out" / "run.json").is_file()
