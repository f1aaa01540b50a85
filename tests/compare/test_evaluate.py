"""All scores at once: keys, association of persons, frames, units, and nothing at all."""

import json

import numpy as np
import pytest

from mocap.compare import associate_persons, evaluate
from mocap.compare.units import length_unit
from mocap.data import LANDMARKS, Motion, Tracks
from mocap.metrics import volume_scores

KEYS = [
    "mean_error_mm",
    "std_error_mm",
    "mmtp_mm",
    "mmta_percent",
    "epsilon_mm",
    "epsilon_opt_mm",
    "angle_mean_deg",
    "angle_std_deg",
    "motp_mm",
    "mota_percent",
    "misses",
    "false_positives",
    "mismatches",
    "volume_iou",
    "coverage_90_percent",
    "frames",
]
FPS = 25.0
T = 30


def body(person, x=0.0, frames=None, noise=0.0, rng=None, scale=1.0, std=None, observed=None):
    """A figure that walks along y at the given x."""
    frames = np.arange(T) if frames is None else np.asarray(frames)
    rest = np.random.default_rng(0).normal([0.0, 0.0, 1.0], 0.25, (15, 3))
    landmarks = rest + np.array([x, 0, 0]) + frames[:, None, None] * np.array([0, 0.05, 0])
    if rng is not None:
        landmarks = landmarks + rng.normal(0, noise, landmarks.shape)
    spread = None if std is None else np.full_like(landmarks, std)
    seen = None if observed is None else np.full(landmarks.shape[:2], observed)
    return Motion(person, frames, frames / FPS, scale * landmarks, spread, seen)


def tracks_of(motions):
    frame = np.concatenate([m.frames for m in motions])
    person = np.concatenate([np.full(len(m), m.person) for m in motions])
    xyz = np.concatenate([m.landmarks.mean(axis=1) for m in motions])
    return Tracks(frame, person, frame / FPS, xyz)


def test_perfect_estimate_has_every_key_and_is_json():
    truth = [body(1), body(2, 2.0)]
    scores = evaluate(truth, truth, tracks_of(truth), tracks_of(truth), volume_scores([1, 2], [2, 3]))
    assert list(scores)[: len(KEYS)] == KEYS
    assert json.loads(json.dumps(scores, allow_nan=False)) == scores
    assert scores["mean_error_mm"] == scores["std_error_mm"] == scores["motp_mm"] == 0.0
    assert scores["mmta_percent"] == scores["mota_percent"] == 100.0
    assert scores["angle_mean_deg"] == pytest.approx(0.0, abs=1e-6)
    assert (scores["misses"], scores["false_positives"], scores["mismatches"]) == (0, 0, 0)
    assert scores["volume_iou"] == pytest.approx(1 / 3)
    assert scores["coverage_90_percent"] is None
    assert scores["epsilon_opt_mm"] is None  # all errors are equal
    assert (scores["frames"], scores["persons_matched"], scores["unit_warning"]) == (T, 2, None)
    assert scores["per_landmark_mm"] == dict.fromkeys(LANDMARKS, 0.0)


def test_errors_that_nobody_was_told_of():
    truth = [body(1)]
    for observed, n_silent in ((True, 15 * T), (False, 0), (None, 15 * T)):
        scores = evaluate([body(1, x=0.3, std=0.02, observed=observed)], truth, None, None)
        assert scores["silent_errors"] == n_silent
        assert scores["silent_error_percent"] == (100.0 if n_silent else 0.0)
    assert evaluate([body(1, x=0.3)], truth, None, None)["silent_error_percent"] is None


def test_noise_of_known_size_and_honest_deviations():
    rng = np.random.default_rng(8)
    truth = [body(1)]
    estimate = [body(1, noise=0.02, rng=rng, std=0.02)]
    scores = evaluate(estimate, truth, None, None)
    # Mean length of a 3D Gaussian of deviation s is s * sqrt(8 / pi); 450 landmarks.
    assert scores["mean_error_mm"] == pytest.approx(20 * np.sqrt(8 / np.pi), abs=2.0)
    assert scores["coverage_90_percent"] == pytest.approx(90, abs=6)
    assert scores["mota_percent"] is None
    assert 20 < scores["epsilon_opt_mm"] < 100
    assert scores["mmta_percent"] == 100.0


def test_names_and_order_of_persons_do_not_matter():
    rng = np.random.default_rng(9)
    truth = [body(1), body(2, 1.0), body(3, -1.5)]
    estimate = [body(p, m.landmarks[0, :, 0].mean() - truth[0].landmarks[0, :, 0].mean(), noise=0.01, rng=rng)
                for p, m in zip((9, 4, 7), truth, strict=True)]  # fmt: skip
    a = evaluate(estimate, truth, tracks_of(estimate), tracks_of(truth))
    b = evaluate(estimate[::-1], truth, tracks_of(estimate), tracks_of(truth))
    assert a == b
    assert [e.person for e, _ in associate_persons(estimate[::-1], truth)] == [9, 4, 7]
    assert a["mmta_percent"] == 100.0


def test_missing_persons_frames_and_extra_persons():
    truth = [body(1), body(2, 2.0)]
    estimate = [body(5, frames=np.arange(15)), body(6, 9.0, frames=np.arange(100, 110))]
    scores = evaluate(estimate, truth, tracks_of(estimate[:1]), tracks_of(truth))
    assert scores["mmta_percent"] == pytest.approx(25.0)
    assert (scores["persons_matched"], scores["extra_persons"]) == (1, 1)
    assert scores["landmarks_missing"] == 45 * 15
    assert scores["misses"] == 45
    assert scores["mean_error_mm"] == 0.0
    part = evaluate(estimate, truth[:1], tracks_of(estimate[:1]), tracks_of(truth[:1]), frames=range(15))
    assert (part["mmta_percent"], part["mota_percent"], part["frames"]) == (100.0, 100.0, 15)


def test_a_long_good_motion_beats_a_short_perfect_one():
    truth = [body(1)]
    short, good = body(1, frames=[3]), body(2, 0.03)
    assert associate_persons([short, good], truth)[0][0] is good


def test_constant_offset_is_reported_apart():
    truth = [body(1)]
    scores = evaluate([body(1, 0.04)], truth, None, None)
    assert scores["mean_error_mm"] == pytest.approx(40.0)
    assert scores["mean_error_after_offset_mm"] == pytest.approx(0.0, abs=1e-6)
    assert scores["mean_error_after_world_offset_mm"] == pytest.approx(0.0, abs=1e-6)
    few = evaluate([body(1, 0.04)], truth, None, None, frames=range(10))
    assert few["mean_error_after_offset_mm"] is None


@pytest.mark.parametrize(("scale", "unit"), [(1000.0, "mm"), (100.0, "cm")])
def test_unit_mistake_is_named(scale, unit):
    scores = evaluate([body(1)], [body(1, scale=scale)], None, None)
    assert f"the truth looks like {unit} read as m" in scores["unit_warning"]
    assert scores["mmta_percent"] == 0.0
    assert "the estimate looks" in evaluate([body(1, scale=scale)], [body(1)], None, None)["unit_warning"]
    assert length_unit(body(1, scale=scale).landmarks) == unit


def test_length_unit_needs_a_body():
    assert length_unit(np.full((3, 15, 3), np.nan)) == "unknown"
    assert length_unit(np.zeros((3, 15, 3))) == "unknown"
    assert length_unit(np.zeros((0, 15, 3))) == "unknown"


@pytest.mark.parametrize("estimate", [[], [body(1, frames=np.arange(50, 60))]])
def test_nothing_estimated(estimate):
    truth = [body(1)]
    scores = evaluate(estimate, truth, None, tracks_of(truth))
    assert scores["mean_error_mm"] is None
    assert (scores["mmta_percent"], scores["mota_percent"], scores["misses"]) == (0.0, 0.0, T)
    assert scores["lost_wrist_percent"] == 100.0
    json.dumps(scores, allow_nan=False)


def test_no_truth_at_all():
    scores = evaluate([body(1)], [], None, None)
    assert scores["frames"] == 0
    assert all(scores[key] is None for key in KEYS if key not in ("epsilon_mm", "frames"))
    tracks_only = evaluate([], [], tracks_of([body(1)]), tracks_of([body(1)]))
    assert (tracks_only["frames"], tracks_only["mota_percent"]) == (T, 100.0)
