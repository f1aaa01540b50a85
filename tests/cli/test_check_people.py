"""`mocap check` names what is wrong with a calibration from the people in the clips."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_session import mocap
from test_refine_cameras import RIG, write_session

from mocap.data import CameraRig
from mocap.io.calibration import write_calibration


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = write_session(tmp_path_factory.mktemp("check") / "session")
    write_calibration(root / "calibration.toml", RIG)
    return root


def test_a_right_calibration(session: Path) -> None:
    done = mocap("check", session)
    assert "people agree with the calibration" in done.out


def test_exchanged_clips_are_an_error_with_a_remedy(session: Path, tmp_path: Path) -> None:
    names = RIG.names
    order = (names[0], names[3], names[2], names[1], names[4])
    cameras = (RIG[k] for k in range(len(RIG)))
    renamed = [type(c)(n, c.size, c.K, c.dist, c.R, c.t) for c, n in zip(cameras, order, strict=True)]
    write_calibration(tmp_path / "exchanged.toml", CameraRig(tuple(renamed)))
    done = mocap("check", session, "--calibration", tmp_path / "exchanged.toml")
    assert done.code == 2
    assert "are exchanged" in done.out
    (line,) = [line for line in done.out.splitlines() if "Remedy: exchange the clips" in line]
    assert ". Remedy: exchange the clips" in line
    assert line.endswith(".")
    assert ".." not in line
