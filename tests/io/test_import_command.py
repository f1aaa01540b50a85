"""`mocap import` on the command line: which recordings there are, one of them as a session, and mistakes."""

from __future__ import annotations

from pathlib import Path

import public_sets as write
import pytest
from small_session import mocap


def test_a_recording_becomes_a_session(tmp_path: Path) -> None:
    write.totalcapture(tmp_path / "set")
    listed = mocap("import", "totalcapture", tmp_path / "set")
    assert (listed.code, listed.out) == (0, "s1/acting1\n")
    done = mocap("import", "totalcapture", tmp_path / "set", "-o", tmp_path / "session")
    assert done.code == 0, done.err
    for line in (
        "cam1: TC_S1_acting1_cam1.mp4, 128 x 72, 13 frames",
        "truth: 1 person, 13 frames at 60 frames/s, 14 landmarks",
        "note: the truth has no head",
        f"Next: mocap check {tmp_path / 'session'}",
    ):
        assert line in done.out
    assert "warning" not in done.out
    scored = mocap("eval", tmp_path / "session" / "truth", tmp_path / "session")
    assert scored.code == 0, scored.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["totalcapture", "{set}", "--take", "s1/acting2", "-o", "{out}"], "no recording s1/acting2: s1/acting1"),
        (["totalcapture", "{none}", "-o", "{out}"], "no such folder"),
        (["human36m", "{set}", "-o", "{out}"], "holds no recording of Human3.6M"),
        (["humanevo", "{set}", "-o", "{out}"], "did you mean 'humaneva'?"),
        (["totalcapture", "{set}", "-o", "{set}"], "the folder is not empty"),
    ],
)  # fmt: skip
def test_mistakes(tmp_path: Path, arguments: list[str], message: str) -> None:
    write.totalcapture(tmp_path / "set")
    places = {"set": tmp_path / "set", "none": tmp_path / "none", "out": tmp_path / "session"}
    done = mocap("import", *(argument.format(**places) for argument in arguments))
    assert done.code == 2
    assert message in done.err
    assert not (tmp_path / "session").exists()
