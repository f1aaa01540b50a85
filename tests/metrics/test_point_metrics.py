"""Point metrics by hand, by bound and by invariance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap.data import LANDMARKS
from mocap.metrics import (
    epsilon_lilliefors,
    epsilon_qq,
    epsilon_search,
    landmark_offsets,
    lost_wrist_percent,
    offset_corrected,
    pck_auc_percent,
    pck_percent,
    point_errors,
    point_scores,
    quantile_line,
    with_offsets,
)
from mocap.metrics.points import torso_rotation

SEEDS = st.integers(0, 2**32 - 1)


def body(T, rng):
    """Landmarks (T, 15, 3) m of a rigid figure that walks and turns."""
    x = np.zeros((15, 3))
    for name, xyz in {
        "pelvis": (0, 0, 0.95), "neck": (0, 0, 1.45), "head": (0, 0, 1.75),
        "left_shoulder": (0, 0.2, 1.42), "left_elbow": (0.05, 0.25, 1.15), "left_wrist": (0.2, 0.25, 0.95),
        "right_shoulder": (0, -0.2, 1.42), "right_elbow": (0.05, -0.25, 1.15), "right_wrist": (0.1, -0.25, 0.9),
        "left_hip": (0, 0.1, 0.93), "left_knee": (0.1, 0.1, 0.5), "left_ankle": (0.05, 0.1, 0.1),
        "right_hip": (0, -0.1, 0.93), "right_knee": (0.05, -0.1, 0.5), "right_ankle": (-0.1, -0.1, 0.1),
    }.items():  # fmt: skip
        x[LANDMARKS.index(name)] = xyz
    turn = Rotation.from_rotvec(np.linspace(0, 3, T)[:, None] * [0, 0, 1]).as_matrix()
    return np.einsum("tij,mj->tmi", turn, x) + rng.normal(0, 0.5, (T, 1, 3)) * [1, 1, 0]


def test_hand_computed_scores():
    truth = np.zeros((2, 3, 3))
    estimate = np.zeros((2, 3, 3))
    estimate[0, :, 0] = [0.010, 0.020, 0.300]  # frame mean 110
    estimate[1, :, 1] = [0.030, 0.040, 0.080]  # frame mean 50
    s = point_scores(estimate, truth, 100.0)
    assert s.mean_mm == pytest.approx(80.0)
    assert s.std_mm == pytest.approx(30.0)
    assert s.mmtp_mm == pytest.approx(36.0)  # (10 + 20 + 30 + 40 + 80) / 5
    assert s.mmtp_std_mm == pytest.approx(np.std([10, 20, 30, 40, 80]))
    assert s.mmta_percent == pytest.approx(100 * 5 / 6)
    assert (s.n_scored, s.n_matched, s.n_missing, s.n_frames) == (6, 5, 0, 2)
    np.testing.assert_allclose(s.landmark_mean_mm, [20, 30, 190])
    np.testing.assert_allclose(s.landmark_mmta_percent, [100, 100, 50])
    np.testing.assert_allclose(pck_percent(estimate, truth, [15, 40, 1000]), [100 / 6, 400 / 6, 100])


def test_poor_pose_of_the_source_is_told_from_a_good_one():
    """CF Figure 5.3: one lost hand moves the mean and its deviation, but not MMTP."""
    rng = np.random.default_rng(1)
    truth = body(40, rng)
    good = truth + rng.normal(0, 0.01, truth.shape)
    poor = good.copy()
    poor[:, LANDMARKS.index("left_wrist")] += [0.5, 0, 0]
    a, b = point_scores(good, truth, 50.0), point_scores(poor, truth, 50.0)
    assert a.mmta_percent == 100.0
    assert b.mmta_percent == pytest.approx(100 * 14 / 15)
    assert b.mean_mm > a.mean_mm + 30
    assert b.mmtp_mm == pytest.approx(a.mmtp_mm, abs=1.0)


def test_missing_estimates_count_against_mmta_and_not_in_the_mean():
    truth = np.zeros((2, 4, 3))
    estimate = np.full((2, 4, 3), 0.01)
    estimate[0, 1] = np.nan
    estimate[1] = np.nan
    s = point_scores(estimate, truth)
    assert s.mean_mm == pytest.approx(10 * np.sqrt(3))
    assert s.mmta_percent == pytest.approx(100 * 3 / 8)
    assert s.n_missing == 5


def test_unknown_truth_is_not_scored():
    truth = np.zeros((1, 4, 3))
    truth[0, 2, 0] = np.nan
    s = point_scores(np.zeros((1, 4, 3)), truth)
    assert (s.n_scored, s.n_missing, s.mmta_percent) == (3, 0, 100.0)
    assert np.isnan(s.landmark_mean_mm[2])


@pytest.mark.parametrize("T", [0, 3])
def test_nothing_to_compare_gives_none(T):
    nothing = np.full((T, 15, 3), np.nan)
    for truth in (nothing, np.zeros_like(nothing)):
        s = point_scores(nothing, truth)
        assert (s.mean_mm, s.std_mm, s.mmtp_mm, s.mmtp_std_mm) == (None,) * 4
    assert point_scores(nothing, nothing).mmta_percent is None
    assert lost_wrist_percent(nothing, nothing) is None
    assert np.isnan(pck_percent(nothing, nothing, [10.0])).all()
    assert epsilon_lilliefors(nothing) is None


def test_far_estimates_have_no_match_and_no_mmtp():
    s = point_scores(np.ones((3, 4, 3)), np.zeros((3, 4, 3)))
    assert (s.mmta_percent, s.mmtp_mm) == (0.0, None)
    assert s.mean_mm == pytest.approx(1000 * np.sqrt(3))


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_invariances_and_bounds(seed):
    rng = np.random.default_rng(seed)
    truth = rng.normal(0, 1, (6, 15, 3))
    estimate = truth + rng.normal(0, 0.06, truth.shape)
    estimate[rng.random((6, 15)) < 0.1] = np.nan
    s = point_scores(estimate, truth)
    assert s.mmtp_mm <= s.epsilon_mm
    assert s.mmtp_std_mm < s.epsilon_mm
    perfect = point_scores(truth, truth)
    assert (perfect.mean_mm, perfect.std_mm, perfect.mmta_percent) == (0.0, 0.0, 100.0)

    R, t = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 5, 3)
    moved = point_scores(estimate @ R.T + t, truth @ R.T + t)
    assert moved.mean_mm == pytest.approx(s.mean_mm)
    assert moved.n_matched == s.n_matched
    landmarks, frames = rng.permutation(15), rng.permutation(6)
    mixed = point_scores(estimate[frames][:, landmarks], truth[frames][:, landmarks])
    assert (mixed.mean_mm, mixed.std_mm) == (pytest.approx(s.mean_mm), pytest.approx(s.std_mm))
    assert mixed.mmta_percent == s.mmta_percent
    np.testing.assert_allclose(mixed.landmark_mean_mm, s.landmark_mean_mm[landmarks])

    thresholds = np.sort(rng.uniform(1, 300, 8))
    mmta = [point_scores(estimate, truth, e).mmta_percent for e in thresholds]
    assert np.all(np.diff(mmta) >= 0)
    np.testing.assert_allclose(pck_percent(estimate, truth, thresholds), mmta)


def test_lost_wrists_count_frames_with_either_wrist():
    truth = np.zeros((5, 15, 3))
    estimate = truth.copy()
    estimate[0, LANDMARKS.index("left_wrist"), 0] = 0.151
    estimate[1, LANDMARKS.index("right_wrist")] = np.nan
    estimate[2, LANDMARKS.index("right_wrist"), 2] = 0.149
    estimate[3, LANDMARKS.index("left_ankle")] = 9.0
    assert lost_wrist_percent(estimate, truth) == pytest.approx(40.0)


@pytest.mark.parametrize("reference", ["world", "torso"])
def test_constant_offset_is_removed_exactly(reference):
    rng = np.random.default_rng(3)
    truth = body(25, rng)
    offset = rng.normal(0, 0.04, (15, 3))
    if reference == "world":
        estimate = truth + offset
    else:
        # A rotation about z only leaves the torso axes equal if torso landmarks keep their definition.
        for name in ("pelvis", "neck", "left_hip", "right_hip"):
            offset[LANDMARKS.index(name)] = 0.0
        turn = Rotation.from_rotvec(np.linspace(0, 3, 25)[:, None] * [0, 0, 1]).as_matrix()
        estimate = truth + np.einsum("tij,mj->tmi", turn, offset)
    assert point_errors(estimate, truth).max() > 30
    assert point_errors(offset_corrected(estimate, truth, 10, reference), truth).max() < 1e-9


def test_offset_learns_from_the_first_frames_only_and_survives_gaps():
    rng = np.random.default_rng(4)
    truth = body(20, rng)
    estimate = truth + 0.03
    estimate[0] = np.nan
    estimate[:, 4] = np.nan
    changed = estimate.copy()
    changed[10:] += 0.5
    a = offset_corrected(estimate, truth, 10, "world")
    b = offset_corrected(changed, truth, 10, "world")
    np.testing.assert_allclose(np.delete(b - a, 4, axis=1)[10:], 0.5)
    assert np.isnan(a[0]).all()
    assert np.isnan(a[:, 4]).all()
    assert np.nanmax(point_errors(a, truth)) < 1e-9
    late = np.full_like(truth, np.nan)
    late[12:] = truth[12:] + 0.03
    np.testing.assert_array_equal(offset_corrected(late, truth, 10, "world"), late)
    with pytest.raises(ValueError, match="frame_of_reference"):
        offset_corrected(estimate, truth, 10, "camera")


@pytest.mark.parametrize("search", [epsilon_lilliefors, epsilon_qq])
def test_epsilon_separates_a_gaussian_from_its_outliers(search):
    """Over 40 seeds both searches lay within 76..150 here; the outliers start at 250."""
    rng = np.random.default_rng(5)
    inliers = rng.normal(60, 12, 900)
    outliers = rng.uniform(250, 600, 150)
    epsilon = search(np.concatenate([inliers, outliers]))
    assert 70 < epsilon < 250
    assert epsilon in inliers


@pytest.mark.parametrize("search", [epsilon_lilliefors, epsilon_qq])
def test_epsilon_of_clean_errors_keeps_most_and_respects_the_minimum_fraction(search):
    errors = np.abs(np.random.default_rng(6).normal(60, 12, 500))
    assert np.mean(errors <= search(errors)) > 0.9
    skewed = np.random.default_rng(7).exponential(50, 500)
    for fraction in (0.5, 0.8):
        assert np.mean(skewed <= search(skewed, fraction)) >= fraction
    assert search(errors[:19]) is None
    assert search(np.full(100, 3.0)) is None
    with pytest.raises(ValueError, match="min_fraction"):
        search(errors, 0.0)


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match="expected the same"):
        point_scores(np.zeros((2, 15, 3)), np.zeros((3, 15, 3)))
    with pytest.raises(ValueError, match="epsilon_mm"):
        point_scores(np.zeros((2, 15, 3)), np.zeros((2, 15, 3)), 0.0)


def test_the_worked_example_of_the_source():
    """CF Figure 5.3 (c): 10 of 13 landmarks matched, MMTP 46.35, MMTA 0.77 and mean 51.22 fit together."""
    error = np.array([46.35] * 10 + [67.45] * 3)
    estimate = np.zeros((1, 13, 3))
    estimate[0, :, 0] = error / 1000.0
    s = point_scores(estimate, np.zeros_like(estimate), 50.0)
    assert s.mean_mm == pytest.approx(51.22, abs=0.005)
    assert s.mmtp_mm == pytest.approx(46.35)
    assert round(s.mmta_percent) == 77


def test_the_deviations_of_the_worked_example_cannot_be():
    """Numbers between 0 and 50 with mean 48.91 deviate by at most sqrt((50 - m) m) = 7.3; CF Figure 5.3 (b) prints
    16.21 and MMTA 1. Of three above 50 with mean 67.45, and ten up to 50 with mean 46.35, no deviation of 24.37
    comes."""
    mean = 48.91
    assert np.sqrt((50.0 - mean) * mean) < 16.21 / 2
    between = 10 / 13 * (46.35 - 51.22) ** 2 + 3 / 13 * (67.45 - 51.22) ** 2
    matched = (50.0 - 46.35) * 46.35
    lost = (2 * (50.0 - 67.45) ** 2 + (3 * 67.45 - 100.0 - 67.45) ** 2) / 3
    assert np.sqrt(between + 10 / 13 * matched + 3 / 13 * lost) < 24.37 - 3


@pytest.mark.parametrize("limit", [40.0, 150.0])
def test_area_under_the_curve_is_the_area_under_the_curve(limit):
    rng = np.random.default_rng(10)
    truth = rng.normal(0, 1, (7, 5, 3))
    estimate = truth + rng.normal(0, 0.04, truth.shape)
    estimate[1, 2] = np.nan
    at = np.linspace(0, limit, 20001)
    area = np.trapezoid(pck_percent(estimate, truth, at), at) / limit
    assert pck_auc_percent(estimate, truth, limit) == pytest.approx(area, abs=0.02)
    assert pck_auc_percent(truth, truth) == 100.0
    assert pck_auc_percent(np.full_like(truth, np.nan), truth) == 0.0
    assert pck_auc_percent(truth, np.full_like(truth, np.nan)) is None
    with pytest.raises(ValueError, match="limit_mm"):
        pck_auc_percent(truth, truth, 0.0)


def test_search_curves_agree_with_scipy():
    from scipy import stats

    rng = np.random.default_rng(11)
    errors = np.concatenate([rng.normal(60, 12, 300), rng.uniform(250, 600, 50), [np.nan]])
    search = epsilon_search(errors)
    for i in (0, len(search.epsilon_mm) // 2, -1):
        subset = np.sort(errors[errors <= search.epsilon_mm[i]])
        ks = stats.kstest(subset, "norm", args=(subset.mean(), subset.std(ddof=1))).statistic
        assert search.lilliefors[i] == pytest.approx(ks)
        line, mine = stats.linregress(quantile_line(subset).quantiles, subset), quantile_line(subset)
        assert (mine.slope_mm, mine.intercept_mm) == (
            pytest.approx(line.slope),
            pytest.approx(line.intercept),
        )
        assert search.r2[i] == pytest.approx(line.rvalue**2) == pytest.approx(mine.r2)
    assert search.by_lilliefors_mm == epsilon_lilliefors(errors)
    assert search.by_r2_mm == epsilon_qq(errors)
    assert not search.at_bound
    assert search.lilliefors.min() == search.lilliefors[search.epsilon_mm == search.by_lilliefors_mm][0]


def test_skewed_errors_have_their_optimum_at_the_bound_and_few_have_none():
    errors = np.random.default_rng(12).exponential(30, 2000)
    assert epsilon_search(errors).at_bound
    assert epsilon_search(errors[:19]) is None
    assert epsilon_search(np.full(50, 2.0)) is None
    assert quantile_line(errors[:2]) is None
    assert quantile_line(np.full(9, 2.0)) is None


def test_offsets_learnt_apart_are_applied_apart():
    rng = np.random.default_rng(13)
    truth = body(30, rng)
    R = torso_rotation(truth, "hip")
    offset = rng.normal(0, 0.04, (15, 3))
    for name in ("pelvis", "neck", "left_hip", "right_hip"):
        offset[LANDMARKS.index(name)] = 0.0
    estimate = truth - np.einsum("tij,mj->tmi", R, offset)
    estimate[3, 4] = np.nan
    estimate[:, 8] = np.nan
    learnt = landmark_offsets(estimate[:6], truth[:6])
    np.testing.assert_allclose(np.delete(learnt, 8, axis=0), np.delete(offset, 8, axis=0), atol=1e-12)
    assert np.isnan(learnt[8]).all()
    assert np.nanmax(point_errors(with_offsets(estimate[6:], learnt), truth[6:])) < 1e-9
