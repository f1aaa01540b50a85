"""The reliability diagram: honest, overconfident and cautious deviations, and the coverage it repeats."""

import numpy as np
import pytest

from mocap.metrics import coverage_scores, reliability

# 12,000 landmarks: standard error of a coverage is at most 0.46 points; the largest of 19 levels stays below 2.
TOLERANCE = 2.0


def claims(seed, factor=1.0):
    rng = np.random.default_rng(seed)
    std = rng.uniform(0.005, 0.08, (800, 15, 3))
    truth = rng.normal(0, 1, std.shape)
    return truth + factor * std * rng.standard_normal(std.shape), truth, std


def test_honest_deviations_lie_on_the_diagonals():
    r = reliability(*claims(1))
    np.testing.assert_allclose(r.coverage_percent, r.level_percent, atol=TOLERANCE)
    np.testing.assert_allclose(r.found_mm, r.claimed_mm, rtol=0.06)
    assert r.calibration_error_percent < 1.0
    assert r.std_factor == pytest.approx(1.0, abs=0.02)
    assert np.all(np.diff(r.claimed_mm) > 0)
    assert r.n == 12000


@pytest.mark.parametrize("factor", [0.4, 2.5])
def test_the_factor_of_wrong_deviations_is_found(factor):
    """Deviations too small by a factor must be multiplied by it; afterwards they are honest."""
    x, y, std = claims(2, factor)
    r = reliability(x, y, std)
    assert r.std_factor == pytest.approx(factor, rel=0.02)
    assert r.calibration_error_percent > 15
    assert reliability(x, y, r.std_factor * std).calibration_error_percent < 1.0
    sign = 1 if factor < 1 else -1
    assert (sign * (r.coverage_percent - r.level_percent) > 0).all()


def test_it_repeats_the_coverage_scores():
    x, y, std = claims(3, 1.3)
    r = reliability(x, y, std, levels=(0.5, 0.9))
    for level, coverage in zip((0.5, 0.9), r.coverage_percent, strict=True):
        assert coverage == pytest.approx(coverage_scores(x, y, std, level).coverage_percent)


def test_too_little_to_say():
    x, y, std = claims(4)
    assert reliability(x, y, np.full_like(std, np.nan)) is None
    assert reliability(x[:1, :9], y[:1, :9], std[:1, :9]) is None
    assert reliability(x[:1, :10], y[:1, :10], std[:1, :10]).n == 10
    with pytest.raises(ValueError, match="levels"):
        reliability(x, y, std, levels=(0.5, 1.0))
    with pytest.raises(ValueError, match="shapes"):
        reliability(x, y, std[:4])
