"""`--expected-persons`, and wrong settings of the tracker."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from small_session import SETTINGS, copy_session, mocap, set_options


@pytest.fixture
def masks(session: Path, tmp_path: Path) -> Path:
    return copy_session(session, tmp_path / "session", masks=True, n_frames=4)


def test_expected_persons_reaches_the_run(masks: Path, tmp_path: Path) -> None:
    for command in (("track",), ("run", "--until", "track")):
        out = tmp_path / command[0]
        said = mocap(
            command[0], masks, "-o", out, *command[1:], "--expected-persons", 2, *set_options(SETTINGS)
        )
        assert said.code == 0, said.err
        about = json.loads((out / "run.json").read_text())
        assert about["config"]["tracking"]["expected_persons"] == 2
        assert about["numbers"]["track"]["n_persons"] == 1
        assert (out / "tracks.csv").read_text().splitlines()[1].endswith(",confirmed")


def test_nobody_is_no_number_of_persons(tmp_path: Path) -> None:
    said = mocap("track", tmp_path, "-o", tmp_path / "out", "--expected-persons", 0)
    assert said.code == 2
    assert "--expected-persons" in said.err


def test_wrong_settings_of_the_tracker_are_named(masks: Path, tmp_path: Path) -> None:
    for setting, words in (
        ("tracking.tracker=kalman", "naive"),
        ("tracking.expected_persons=0", "greater than or equal to 1"),
        ("tracking.voxel_size_m=0.01", "finer than the volume"),
    ):
        said = mocap("track", masks, "-o", tmp_path / "out", *set_options((*SETTINGS, setting)))
        assert said.code == 2
        assert setting.partition("=")[0] in said.err
        assert words in said.err
        assert "Traceback" not in said.err
