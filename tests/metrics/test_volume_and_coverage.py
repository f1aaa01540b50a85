"""Voxel overlap in closed form; coverage of Gaussian errors at its level."""

import numpy as np
import pytest

from mocap.metrics import coverage_scores, silent_errors, sum_volume_scores, volume_scores

# Standard error of a coverage of 90 % from 12,000 landmarks is 0.27 points; four of them.
COVERAGE_TOLERANCE = 1.1


def test_overlap_of_two_ranges():
    s = volume_scores(np.arange(0, 60), np.arange(40, 140))
    assert (s.iou, s.precision, s.recall) == (20 / 140, 20 / 60, 20 / 100)
    same = volume_scores(np.array([5, 3, 3, 9]), np.array([9, 5, 3]))
    assert (same.iou, same.precision, same.recall) == (1.0, 1.0, 1.0)
    both = sum_volume_scores([s, same])
    assert (both.n_estimate, both.n_truth, both.n_common) == (63, 103, 23)


def test_empty_sets():
    none = np.zeros(0, np.int32)
    s = volume_scores(none, np.arange(5))
    assert (s.iou, s.precision, s.recall) == (0.0, None, 0.0)
    assert volume_scores(none, none).iou is None
    assert sum_volume_scores([]).iou is None


def test_honest_covariances_cover_at_their_level_and_proud_ones_do_not():
    rng = np.random.default_rng(2)
    std = rng.uniform(0.005, 0.08, (800, 15, 3))
    truth = rng.normal(0, 1, std.shape)
    estimate = truth + std * rng.standard_normal(std.shape)
    for level in (0.5, 0.9):
        s = coverage_scores(estimate, truth, std, level)
        assert s.coverage_percent == pytest.approx(100 * level, abs=2 * COVERAGE_TOLERANCE)
        assert s.n == 12000
    assert coverage_scores(estimate, truth, std / 2).coverage_percent < 60
    assert coverage_scores(estimate, truth, 2 * std).coverage_percent > 99


def test_boundary_of_the_region():
    """Chi-square with three degrees of freedom: 6.2514 at 90 %."""
    truth = np.zeros((1, 2, 3))
    estimate = truth.copy()
    estimate[0, :, 0] = np.sqrt([6.2513, 6.2515]) * 0.03
    s = coverage_scores(estimate, truth, np.full_like(truth, 0.03))
    assert s.coverage_percent == 50.0
    assert s.sharpness_mm == pytest.approx(30 * np.sqrt(6.2514), rel=1e-4)


def test_unknown_and_certain_landmarks():
    truth = np.zeros((2, 3, 3))
    std = np.full_like(truth, np.nan)
    assert coverage_scores(truth, truth, std).coverage_percent is None
    std[0, 0] = 0.0
    assert coverage_scores(truth, truth, std).coverage_percent == 100.0
    assert coverage_scores(truth + 0.01, truth, std).coverage_percent == 0.0
    with pytest.raises(ValueError, match="shapes"):
        coverage_scores(truth, truth, std[:1])
    with pytest.raises(ValueError, match="level"):
        coverage_scores(truth, truth, std, 1.0)


def test_a_large_error_is_silent_unless_it_is_flagged_or_inside_its_region():
    truth = np.zeros((1, 5, 3))
    estimate = truth.copy()
    estimate[0, :, 0] = [0.099, 0.2, 0.2, 0.2, 0.2]
    std = np.full_like(truth, 0.02)
    std[0, 2] = 0.2
    observed = np.array([[True, True, True, False, True]])
    s = silent_errors(estimate, truth, std, observed)
    assert (s.n_silent, s.n_large, s.percent) == (2, 4, 50.0)
    estimate[0, 4] = np.nan
    assert silent_errors(estimate, truth, std, observed).n_large == 3
    assert silent_errors(truth, truth, std, observed).percent is None
    assert silent_errors(truth + 1.0, truth, np.full_like(std, np.nan), observed).percent is None
