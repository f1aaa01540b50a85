"""Accelerations and jitter by parabola and cubic, where differences are exact."""

import numpy as np
import pytest

from mocap.metrics import smoothness_scores

FPS = 25.0
FRAMES = np.arange(40)
T = FRAMES / FPS


def path(*coefficients):
    """(40, 2, 3) m: two landmarks that move along x by a polynomial in time."""
    x = np.zeros((40, 2, 3))
    for k, c in enumerate(coefficients):
        x[..., 0] += c * T[:, None] ** k
    return x


def test_polynomials_have_their_derivatives():
    s = smoothness_scores(path(1, 2, 3), path(0, -1, 1), FRAMES, FPS)
    assert s.acceleration_error_m_s2 == pytest.approx(4.0)
    assert (s.jitter_estimate_m_s3, s.jitter_truth_m_s3) == (pytest.approx(0, abs=1e-6),) * 2
    assert smoothness_scores(path(0, 0, 0, 2), path(), FRAMES, FPS).jitter_estimate_m_s3 == pytest.approx(12)


def test_a_constant_offset_and_a_common_motion_change_nothing():
    rng = np.random.default_rng(1)
    x, y = path(0, 1, 2) + rng.normal(0, 0.01, (40, 2, 3)), path(0, 1, 2)
    a, b = smoothness_scores(x, y, FRAMES, FPS), smoothness_scores(x + 0.4, y, FRAMES + 7, FPS)
    assert a.acceleration_error_m_s2 == pytest.approx(b.acceleration_error_m_s2)
    assert a.jitter_estimate_m_s3 > 10 * a.jitter_truth_m_s3


def test_gaps_break_the_run():
    """Across a hole in the frame numbers the body jumps; that is no acceleration."""
    x = path(0, 1)
    keep = np.r_[0:10, 20:40]
    assert smoothness_scores(
        x[keep], 0 * x[keep], FRAMES[keep], FPS
    ).acceleration_error_m_s2 == pytest.approx(0.0, abs=1e-9)
    x[15] = np.nan
    assert smoothness_scores(x, 0 * x, FRAMES, FPS).acceleration_error_m_s2 == pytest.approx(0, abs=1e-9)
    few = smoothness_scores(x[:2], x[:2], FRAMES[:2], FPS)
    assert (few.acceleration_error_m_s2, few.jitter_estimate_m_s3) == (None, None)
    with pytest.raises(ValueError, match="fps"):
        smoothness_scores(x, x, FRAMES, 0.0)
    with pytest.raises(ValueError, match="frames"):
        smoothness_scores(x, x, FRAMES[:-1], FPS)
