"""Angles of a run against a truth: errors in closed form, and the truth of a synthetic person out of its file."""

import numpy as np
import pytest

from mocap.compare.angles import angle_errors, true_angles
from mocap.data import AngleSeries
from mocap.errors import MocapError
from mocap.synth.figure import JOINT, JOINTS, PARENTS, make_figure, rotation_about


def series(values_deg: np.ndarray, first: int = 0, std_deg: float | None = None) -> AngleSeries:
    frames = np.arange(first, first + len(values_deg))
    std = None if std_deg is None else np.full((len(frames), 1), np.deg2rad(std_deg))
    values = np.deg2rad(values_deg)[:, None]
    return AngleSeries(1, ("left_knee_flexion",), frames, frames / 30.0, values, std)


def test_errors_are_taken_apart_over_the_common_frames() -> None:
    truth = np.linspace(0.0, 60.0, 12)
    wobble = np.tile([3.0, -3.0], 5)
    (error,) = angle_errors(series(truth[2:] + 4.0 + wobble, first=2, std_deg=3.0), series(truth))
    assert error.frames == 10
    assert error.offset_deg == pytest.approx(4.0)
    assert error.rmse_after_offset_deg == pytest.approx(3.0)
    assert error.rmse_deg == pytest.approx(5.0)
    # Errors are 7 and 1 degrees, the region reaches 4.9.
    assert error.coverage_90_percent == pytest.approx(50.0)


def test_a_whole_turn_is_no_error() -> None:
    (error,) = angle_errors(series(np.array([179.0])), series(np.array([-179.0])))
    assert error.rmse_deg == pytest.approx(2.0)


def test_what_only_one_side_knows_is_left_out() -> None:
    none = series(np.array([np.nan, np.nan]))
    assert angle_errors(none, series(np.array([1.0, 2.0]))) == []


def write_truth(folder, **changes) -> None:
    figure = make_figure(1.7, "male", 1.0, rng=np.random.default_rng(1))
    rotations = np.tile(np.eye(3, dtype=np.float32), (3, len(JOINTS), 1, 1))
    rotations[:, JOINT["right_knee"]] = rotation_about(1, np.array([0.2, 0.4, 0.6]))
    arrays = {
        "joints": np.array(JOINTS),
        "parents": PARENTS,
        "offsets_m": figure.offsets,
        "rotations": rotations,
        "inside": np.array([True, False, True]),
    }
    arrays = {name: value for name, value in (arrays | changes).items() if value is not None}
    np.savez_compressed(folder / "pose_2.npz", **arrays)


def test_the_truth_of_a_synthetic_person(tmp_path) -> None:
    write_truth(tmp_path)
    (truth,) = true_angles(tmp_path, 30.0)
    assert truth.person == 2
    assert truth.frames.tolist() == [0, 2]
    assert truth.of("right_knee_flexion") == pytest.approx([0.2, 0.6], abs=1e-6)
    assert truth.of("left_knee_flexion") == pytest.approx([0.0, 0.0], abs=1e-6)


def test_a_truth_of_an_earlier_version_is_named(tmp_path) -> None:
    write_truth(tmp_path, parents=None)
    with pytest.raises(MocapError, match=r"lacks parents.*make the session again"):
        true_angles(tmp_path, 30.0)
    assert true_angles(tmp_path / "nothing", 30.0) == []
