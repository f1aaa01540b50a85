"""Runs that are killed at any instant: what is finished is kept, and a resumed run ends with the same bytes."""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_session import SETTINGS, copy_session, digests, mocap, set_options, small_session

N_KILLS = 12
# Besides the outputs a folder holds what differs from run to run: times, hidden files, and the order of compression.
_VARYING = ("run.json", "report.html", "scene.rrd")


@pytest.mark.slow
def test_killed_runs_resume_to_the_same_bytes(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    session = copy_session(small_session(tmp_path_factory.getbasetemp()), tmp_path / "session", masks=True)
    words = ["run", str(session), *set_options((*SETTINGS, "output.formats=bvh,trc"))]
    began = time.monotonic()
    _run([*words, "-o", str(tmp_path / "whole")]).wait(timeout=300)
    takes_s = time.monotonic() - began
    whole = _content(tmp_path / "whole")
    assert "landmarks.csv" in whole

    rng = random.Random(7)
    out = tmp_path / "killed"
    n_killed = 0
    for _ in range(N_KILLS):
        # Each goes on from where the one before was killed, so that late stages and outputs are hit too.
        process = _run([*words, "-o", str(out), "--resume"])
        try:
            process.wait(timeout=rng.uniform(0.2, 1.0) * takes_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(timeout=60)
            n_killed += 1
        if (out / "run.json").exists():
            assert _content(out) == whole  # old or new, nothing in between
            for path in (out / "run.json", *(out / "store.zarr").glob("pose")):
                _remove(path)
    assert n_killed >= N_KILLS // 3

    said = mocap(*words, "-o", out, "--resume")
    assert said.code == 0, said.err
    assert _content(out) == whole
    assert not list(out.rglob("*.partial"))


def _run(words: list[str]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "mocap", *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def _content(out: Path) -> dict[str, str]:
    return {
        name: digest
        for name, digest in digests(out).items()
        if not name.startswith(".") and "/." not in name and name not in _VARYING
    }


def _remove(path: Path) -> None:
    shutil.rmtree(path) if path.is_dir() else path.unlink()
