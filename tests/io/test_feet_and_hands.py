"""Landmarks of feet and hands in tables, exports and scores, beside the fifteen."""

from pathlib import Path

import numpy as np
import pytest

from mocap.compare import evaluate
from mocap.data import ALL_LANDMARKS, FURTHER_LANDMARKS, LANDMARKS, Motion
from mocap.io.formats.c3d import read_c3d, write_c3d
from mocap.io.formats.table import PoseFile
from mocap.io.formats.trc import read_trc, write_trc
from mocap.io.poses.motions import read_motions
from mocap.io.tables import read_landmarks_csv, write_landmarks_csv

FPS = 30.0
T = 6


def motion(n_landmarks: int, *, shift_m: float = 0.0) -> Motion:
    """A person whose landmarks lie apart; `shift_m` moves those of feet and hands only."""
    rng = np.random.default_rng(7)
    landmarks = rng.uniform(0.0, 2.0, (T, len(ALL_LANDMARKS), 3))
    landmarks[:, len(LANDMARKS) :, 2] += shift_m
    return Motion(1, np.arange(T), np.arange(T) / FPS, landmarks[:, :n_landmarks])


def test_a_motion_has_fifteen_or_all() -> None:
    assert motion(15).names == LANDMARKS
    assert motion(21).names == (*LANDMARKS, *FURTHER_LANDMARKS)
    with pytest.raises(ValueError, match="expected"):
        motion(16)


@pytest.mark.parametrize("n_landmarks", [15, 21])
def test_the_table_gives_back_what_was_written(n_landmarks: int, tmp_path: Path) -> None:
    path = tmp_path / "landmarks.csv"
    write_landmarks_csv(path, [motion(n_landmarks)])
    (read,) = read_landmarks_csv(path)
    np.testing.assert_allclose(read.landmarks, motion(n_landmarks).landmarks, atol=1e-6)
    assert path.read_text().count("left_heel") == (T if n_landmarks == 21 else 0)


def _read_back(found: PoseFile, n_landmarks: int, tolerance_m: float) -> None:
    (read,) = read_motions(found).in_metres(found.unit or "m").motions
    assert read.names == ALL_LANDMARKS[:n_landmarks]
    np.testing.assert_allclose(read.landmarks, motion(n_landmarks).landmarks, atol=tolerance_m)


@pytest.mark.parametrize("n_landmarks", [15, 21])
def test_trc_carries_what_the_body_has(n_landmarks: int, tmp_path: Path) -> None:
    write_trc(tmp_path / "person_1.trc", motion(n_landmarks), FPS)
    _read_back(read_trc(tmp_path / "person_1.trc"), n_landmarks, 1e-6)


@pytest.mark.parametrize("n_landmarks", [15, 21])
def test_c3d_carries_what_the_body_has(n_landmarks: int, tmp_path: Path) -> None:
    pytest.importorskip("ezc3d")
    write_c3d(tmp_path / "person_1.c3d", motion(n_landmarks), FPS)
    _read_back(read_c3d(tmp_path / "person_1.c3d"), n_landmarks, 1e-5)


def test_feet_and_hands_are_scored_apart_from_the_fifteen() -> None:
    truth, feet_off = motion(21), motion(21, shift_m=0.5)
    scores = evaluate([feet_off], [truth], None, None)
    assert scores["mean_error_mm"] == 0.0
    assert scores["landmarks_scored"] == 15 * T
    assert scores["per_further_landmark_mm"] == pytest.approx(dict.fromkeys(FURTHER_LANDMARKS, 500.0))
    for estimate, target in ((motion(15), truth), (truth, motion(15)), (motion(15), motion(15))):
        alone = evaluate([estimate], [target], None, None)
        assert alone["mean_error_mm"] == 0.0
        assert alone["per_further_landmark_mm"] is None


def test_feet_that_one_side_lacks_in_a_frame_are_left_out_there() -> None:
    truth, estimate = motion(21), motion(21, shift_m=0.5)
    estimate.landmarks[:3, LANDMARKS.index("pelvis")] = np.nan
    estimate.landmarks[1:, len(LANDMARKS) + FURTHER_LANDMARKS.index("left_toe")] = np.nan
    estimate.landmarks[:, len(LANDMARKS) + FURTHER_LANDMARKS.index("left_heel")] = np.nan
    scored = evaluate([estimate], [truth], None, None)["per_further_landmark_mm"]
    assert scored["left_toe"] == pytest.approx(500.0)
    assert "left_heel" not in scored
