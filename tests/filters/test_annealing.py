"""The annealing schedule: exponents that hit the survival rate, and noise that shrinks."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mocap.filters.annealing import annealed, layer_scales, next_beta, survival_at

LOG_LIKELIHOODS = hnp.arrays(
    np.float64, st.integers(5, 60), elements=st.floats(-1e4, 0) | st.sampled_from([-np.inf, np.nan, -3.0])
)
# The root is found to 1e-4 of the survival rate.
HIT = 2e-4


@given(ll=LOG_LIKELIHOODS, target=st.floats(0.1, 0.95))
def test_beta_hits_the_target_or_says_why_not(ll: np.ndarray, target: float) -> None:
    beta = next_beta(ll, target)
    alive = np.isfinite(ll)
    assert 0 <= beta <= 1e6
    if beta == 0:
        assert alive.mean() <= target
    elif beta == 1e6:
        assert survival_at(ll, beta) >= target * (1 - HIT)
    else:
        assert survival_at(ll, beta) == pytest.approx(target, rel=HIT)


@given(ll=LOG_LIKELIHOODS)
def test_survival_falls_with_beta(ll: np.ndarray) -> None:
    rates = [survival_at(ll, b) for b in (0.0, 1e-3, 0.1, 1.0, 30.0)]
    if np.isfinite(ll).any():
        assert np.all(np.diff(rates[1:]) <= 1e-12)


@given(ll=LOG_LIKELIHOODS, low=st.floats(0.1, 0.5), more=st.floats(0.05, 0.4))
def test_a_lower_target_needs_a_higher_beta(ll: np.ndarray, low: float, more: float) -> None:
    assume(np.isfinite(ll).mean() > low + more)
    assert next_beta(ll, low) >= next_beta(ll, low + more) * (1 - 1e-6)


@given(ll=LOG_LIKELIHOODS, factor=st.floats(0.01, 100.0), shift=st.floats(-1e3, 1e3))
def test_scaling_the_log_likelihood_scales_beta_back(ll: np.ndarray, factor: float, shift: float) -> None:
    """Invariance: the annealed weights do not know the scale of the likelihood."""
    alive = np.isfinite(ll)
    assume(alive.mean() > 0.5)
    assume(np.ptp(ll[alive]) > 1.0)
    a, b = next_beta(ll, 0.4), next_beta(factor * ll + shift, 0.4)
    assume(max(a, b) < 1e6)
    assert survival_at(ll, b * factor) == pytest.approx(survival_at(ll, a), rel=2 * HIT)


def test_two_likelihoods_have_a_closed_form() -> None:
    """ESS / N of weights (1, x) is (1 + x)^2 / (2 (1 + x^2)); for 0.8, x solves 3 x^2 - 10 x + 3 = 0: x = 1/3."""
    beta = next_beta(np.array([0.0, -2.0]), 0.8)
    assert beta == pytest.approx(np.log(3.0) / 2.0, rel=1e-3)


def test_degenerate_cases() -> None:
    assert next_beta(np.full(9, -4.0), 0.5) == 1e6
    assert next_beta(np.full(9, -4.0) + 1e-9 * np.arange(9), 0.5) == 1e6
    assert next_beta(np.array([0.0] + [-1e-9] * 8), 0.9) == 1e6
    assert next_beta(np.full(9, -np.inf), 0.5) == 0.0
    assert next_beta(np.full(9, np.nan), 0.5) == 0.0
    mostly_dead = np.full(10, -np.inf)
    mostly_dead[:4] = [-1.0, -2.0, -3.0, -4.0]
    assert next_beta(mostly_dead, 0.5) == 0.0
    for target in (0.0, 1.0, -0.2, float("nan")):
        with pytest.raises(ValueError, match="target"):
            next_beta(np.zeros(3), target)


def test_first_layer_has_all_the_noise_and_each_later_one_alpha_of_its_covariance() -> None:
    """Reading guide 2: P_L = P_0, P_m = alpha P_(m+1)."""
    scales = layer_scales(5, 0.3)
    assert scales[0] == 1.0
    np.testing.assert_allclose(scales[1:] ** 2 / scales[:-1] ** 2, 0.3)
    assert layer_scales(1, 0.5).tolist() == [1.0]


def test_zero_likelihoods_stay_zero_whatever_the_exponent() -> None:
    for beta in (0.0, 0.5, 1e6):
        np.testing.assert_array_equal(
            annealed(np.array([-np.inf, -2.0, np.nan]), beta), [-np.inf, -2.0 * beta, -np.inf]
        )
