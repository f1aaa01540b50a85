"""Curves, alignments, held-out offsets and actions together: keys, JSON, invariances."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap.compare import Action, detailed_scores, evaluate, matched_pairs
from mocap.data import LANDMARKS, Motion

FPS = 25.0
T = 60


def motion(person, seed, noise=0.0, std=None, x=0.0):
    """A rigid body that walks and turns, with noise of its own seed."""
    rng = np.random.default_rng(99)
    rest = rng.normal([0.0, 0.0, 1.0], 0.25, (15, 3))
    at = LANDMARKS.index
    for name, place in {
        "pelvis": (0, 0, 0.95), "neck": (0, 0, 1.45), "left_hip": (0, 0.1, 0.93), "right_hip": (0, -0.1, 0.93),
        "left_shoulder": (0, 0.2, 1.42), "right_shoulder": (0, -0.2, 1.42),
    }.items():  # fmt: skip
        rest[at(name)] = place
    turn = Rotation.from_rotvec(np.linspace(0, 2, T)[:, None] * [0, 0, 1]).as_matrix()
    landmarks = np.einsum("tij,mj->tmi", turn, rest) + np.linspace(0, 2, T)[:, None, None] * [0, 1, 0]
    landmarks += np.random.default_rng(seed).normal(0, noise, landmarks.shape) + np.array([x, 0, 0])
    spread = None if std is None else np.full_like(landmarks, std)
    return Motion(person, np.arange(T), np.arange(T) / FPS, landmarks, spread)


def changed(m, **what):
    from dataclasses import replace

    return replace(m, **what)


def scores(estimate, truth, **more):
    return detailed_scores(matched_pairs(estimate, truth), FPS, **more)


def flat(tree, prefix=""):
    """Dotted name -> number of everything in a tree of scores."""
    out = {}
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        if isinstance(value, dict | list):
            out |= flat(value, f"{prefix}{key}.")
        else:
            out[f"{prefix}{key}"] = value
    return out


TRUTH = [motion(1, 0), motion(2, 1, x=3.0)]
ESTIMATE = [motion(1, 2, 0.03, 0.03), motion(2, 3, 0.02, 0.03, x=3.0)]


def test_everything_is_json_and_agrees_with_evaluate():
    s = scores(ESTIMATE, TRUTH)
    assert json.loads(json.dumps(s, allow_nan=False)) == s
    whole = evaluate(ESTIMATE, TRUTH, None, None)
    assert s["aligned"]["none"]["mean_error_mm"] == whole["mean_error_mm"]
    assert s["epsilon_search"]["by_lilliefors_mm"] == whole["epsilon_opt_mm"]
    assert s["epsilon_search"]["by_r2_mm"] == whole["epsilon_qq_mm"]
    assert s["angles"]["direct"]["mean_deg"] == whole["angle_mean_deg"]
    at = s["reliability"]["level_percent"].index(90.0)
    assert s["reliability"]["coverage_percent"][at] == pytest.approx(whole["coverage_90_percent"])
    assert {n: row["mean_mm"] for n, row in s["per_landmark"].items()} == pytest.approx(
        whole["per_landmark_mm"]
    )
    row = s["sweep"]["epsilon_mm"].index(100.0)
    assert s["sweep"]["mmta_percent"][row] == whole["mmta_percent"]
    assert np.all(np.diff(s["sweep"]["mmta_percent"]) >= 0)
    assert np.all(np.diff([v for v in s["sweep"]["mmtp_mm"] if v is not None]) >= 0)


def test_a_rigid_motion_of_both_a_shift_in_time_and_new_names_change_nothing():
    R, t = Rotation.from_rotvec([0.3, -0.5, 1.0]).as_matrix(), np.array([1.0, 2.0, -3.0])
    before = flat(scores(ESTIMATE, TRUTH, actions=[Action("all", 0, T)]))

    def both(change):
        return [change(m) for m in ESTIMATE], [change(m) for m in TRUTH]

    moved = both(lambda m: changed(m, landmarks=m.landmarks @ R.T + t))
    later = both(lambda m: changed(m, frames=m.frames + 500, time_s=m.time_s + 20))
    renamed = [changed(m, person=9 - m.person) for m in ESTIMATE][::-1], TRUTH
    for (e, y), first in ((moved, 0), (later, 500), (renamed, 0)):
        after = flat(scores(e, y, actions=[Action("all", first, first + T)]))
        assert after.keys() == before.keys()
        for key, value in before.items():
            # A region of three equal deviations does not turn, so the coverage stays too.
            same = value if isinstance(value, str | None) else pytest.approx(value, rel=1e-6, abs=1e-6)
            assert after[key] == same, key


def test_perfect_estimates():
    s = scores(TRUTH, TRUTH)
    for row in s["aligned"].values():
        assert row["mean_error_mm"] == pytest.approx(0.0, abs=1e-9)
        assert row["mmta_percent"] == 100.0
        assert row["pck_auc_percent"] == pytest.approx(100.0)
    assert s["acceleration_error_m_s2"] == 0.0
    assert s["jitter_estimate_m_s3"] == s["jitter_truth_m_s3"]
    assert s["angles"]["inverse_kinematics"]["mean_deg"] == 0.0
    assert s["epsilon_search"] is None
    assert s["reliability"] is None


def test_offsets_are_learnt_on_the_first_share_and_scored_on_the_rest():
    """Another definition of the head goes away; a mistake that begins later stays."""
    R = Rotation.from_rotvec(np.linspace(0, 2, T)[:, None] * [0, 0, 1]).as_matrix()
    shift = np.zeros((15, 3))
    shift[LANDMARKS.index("head")] = [0.05, 0.0, -0.12]
    bodily = changed(TRUTH[0], landmarks=TRUTH[0].landmarks + np.einsum("tij,mj->tmi", R, shift))
    found = scores([bodily], TRUTH[:1], learn_share=0.3)["offset_calibration"]
    assert (found["frames_learnt"], found["frames_scored"], found["learn_share"]) == (18, T - 18, 0.3)
    assert found["before"]["mean_error_mm"] == pytest.approx(130.0 / 15)
    assert found["after"]["mean_error_mm"] == pytest.approx(0.0, abs=1e-6)
    assert found["offset_forward_left_up_mm"]["head"] == pytest.approx([-50.0, 0.0, 120.0])
    late = bodily.landmarks.copy()
    late[18:] += [0.0, 0.0, 0.1]
    found = scores([changed(bodily, landmarks=late)], TRUTH[:1], learn_share=0.3)["offset_calibration"]
    assert found["after"]["mean_error_mm"] == pytest.approx(100.0)
    short = changed(TRUTH[0], frames=np.arange(2), time_s=np.zeros(2), landmarks=TRUTH[0].landmarks[:2])
    assert scores([short], [short])["offset_calibration"] is None
    with pytest.raises(ValueError, match="learn_share"):
        scores([bodily], TRUTH[:1], learn_share=1.0)


def test_actions_split_the_frames():
    worse = TRUTH[0].landmarks.copy()
    worse[40:] += [0.05, 0.0, 0.0]
    estimate = [changed(TRUTH[0], landmarks=worse), TRUTH[1]]
    actions = [
        Action("walk", 0, 19), Action("jump", 40, T - 1), Action("walk", 20, 39), Action("never", 900, 950),
        Action("one", 40, 49, 1),
    ]  # fmt: skip
    table = scores(estimate, TRUTH, actions=actions)["per_action"]
    assert list(table) == ["walk", "jump", "never", "one"]
    assert [row["frames"] for row in table.values()] == [80, 40, 0, 10]
    assert table["walk"]["mean_error_mm"] == 0.0
    assert table["jump"]["mean_error_mm"] == pytest.approx(25.0)
    assert table["one"]["mean_error_mm"] == pytest.approx(50.0)
    assert table["never"]["mean_error_mm"] is None
    assert scores(estimate, TRUTH)["per_action"] is None


def test_nothing_estimated_nothing_true():
    for estimate, truth in (([], TRUTH), (TRUTH, []), ([], [])):
        s = scores(estimate, truth, actions=[Action("a", 0, 9)])
        assert json.dumps(s, allow_nan=False)
        assert s["aligned"]["procrustes"]["mean_error_mm"] is None
        assert s["offset_calibration"] is None
    assert detailed_scores(matched_pairs(ESTIMATE, TRUTH), None)["acceleration_error_m_s2"] is None
