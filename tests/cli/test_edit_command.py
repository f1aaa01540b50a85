"""`mocap edit`: every edit has a form on the command line that adds a table to the file, after a look at the result."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from small_session import mocap
from two_persons import two_persons_run, two_persons_session

from mocap.pipeline.edits.model import KINDS, read_edits


@pytest.fixture
def out(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path) -> Path:
    return Path(shutil.copytree(two_persons_run(tmp_path_factory.getbasetemp()), tmp_path / "out"))


def test_every_edit_can_be_given_listed_and_taken_back(out: Path) -> None:
    wrist = np.load(out / "pose.npz")["person_1_landmarks_m"][5][5]
    at = ",".join(f"{v:.3f}" for v in wrist)
    given = [
        ["split", 2, "--frames", "6:", "--new", 5],
        ["merge", 2, 5],
        ["swap", 1, 2, "--frames", "2:4"],
        ["delete", 2, "--frames", ":1"],
        ["exchange", 1, "--frames", "7:8", "--sides", "legs"],
        ["bad", "--frames", "9:"],
        ["pin", 1, "--landmark", "left_wrist", "--frame", 5, f"--at={at}"],
    ]
    assert {words[0] for words in given} == set(KINDS)
    for words in given:
        said = mocap("edit", out, *words)
        assert said.code == 0, said.err
    edits = read_edits(out / "edits.toml")
    assert [edit.do for edit in edits.edit] == [words[0] for words in given]
    listed = mocap("edit", out, "--list").out
    assert listed.count("line ") == len(given)
    assert "7 edits; to be applied" in listed
    assert "pin" in mocap("edit", out, "--undo").out
    assert mocap("edit", out).out.count("line ") == len(given) - 1


def test_edits_are_applied_with_the_settings_of_the_run(
    tmp_path_factory: pytest.TempPathFactory, out: Path
) -> None:
    session = two_persons_session(tmp_path_factory.getbasetemp())
    assert mocap("edit", out, "bad", 1, "--frames", "4:6").code == 0
    said = mocap("edit", out, "--apply", session)
    assert said.code == 0, said.err
    assert "1 edit by hand is in this result" in said.out
    assert "track    reused" in said.out
    assert not np.load(out / "pose.npz")["person_1_observed"][4:6].any()
    assert mocap("edit", out, "--list").out.splitlines()[-1] == "1 edit"


def test_doubtful_frames_are_listed_most_doubtful_first(out: Path) -> None:
    said = mocap("edit", out, "--doubtful")
    assert said.code == 0
    *rows, last = said.out.splitlines()
    values = [float(row.split()[0]) for row in rows]
    assert values == sorted(values, reverse=True)
    assert last == (
        f"{len(rows)} place{'s' * (len(rows) != 1)} to look at" if rows else "No frame is in doubt."
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["swp", 1, 2], ["EDIT", "did you mean 'swap'"]),
        (["swap", 1], ["swap takes 2 persons, got 1"]),
        (["swap", 1, 9], ["no person 9"]),
        (["split", 1], ["split needs --frames"]),
        (["bad", 1, "--frames", "5"], ["--frames is '5'"]),
        (["swap", 1, 2, "--sides", "legs"], ["swap takes no --sides"]),
        (["exchange", 1, "--sides", "leg"], ["sides", "did you mean 'legs'"]),
        (["pin", 1, "--frame", 3], ["pin needs --landmark"]),
        (["pin", 1, "--landmark", "head", "--frame", 3], ["--at or --seen"]),
        (["pin", 1, "--landmark", "head", "--frame", 3, "--at", "1,2"], ["--at", "expected 3 numbers"]),
        (["pin", 1, "--landmark", "head", "--frame", 3, "--seen", "1,2"], ["--seen", "cam_0=412,233"]),
        (["--sides", "legs"], ["--sides says nothing without an edit"]),
        (["--undo"], ["no edit to take back"]),
        (["swap", 1, 2, "--undo"], ["one after the other"]),
    ],
)
def test_what_cannot_be_is_said_and_nothing_is_written(out: Path, words: list[str], told: list[str]) -> None:
    said = mocap("edit", out, *words)
    assert said.code == 2
    for word in told:
        assert word in said.err
    assert "Remedy" in said.err
    assert not (out / "edits.toml").exists()
