"""Log-weights, effective sample size and resampling schemes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mocap.filters.estimate import weighted_mean
from mocap.filters.resampling import RESAMPLING, multinomial, stratified, systematic
from mocap.filters.weights import effective_sample_size, normalise_log_weights, survival_rate

LOG_WEIGHTS = hnp.arrays(
    np.float64, st.integers(1, 40), elements=st.floats(-1e5, 1e5) | st.just(-np.inf) | st.just(np.nan)
)
WEIGHTS = hnp.arrays(np.float64, st.integers(1, 30), elements=st.just(0.0) | st.floats(1e-6, 1.0)).filter(
    lambda w: w.sum() > 0
)


@given(lw=LOG_WEIGHTS)
def test_weights_sum_to_one_and_ess_lies_between_one_and_n(lw: np.ndarray) -> None:
    W, log_mean = normalise_log_weights(lw)
    assert W.sum() == pytest.approx(1.0)
    assert np.all(W >= 0)
    ess = effective_sample_size(W)
    assert 1.0 <= ess <= len(W)
    assert 0 < survival_rate(W) <= 1
    dead = ~np.isfinite(lw)
    if not dead.all():
        assert np.all(W[dead] == 0)
        assert np.isfinite(log_mean)
    else:
        assert log_mean == -np.inf
        np.testing.assert_allclose(W, 1 / len(W))


@given(lw=LOG_WEIGHTS, shift=st.floats(-1e4, 1e4))
def test_a_constant_factor_only_moves_the_mean(lw: np.ndarray, shift: float) -> None:
    """Invariance. 1e5 + 1e4 leaves 1e-11 of relative precision in the differences."""
    W, log_mean = normalise_log_weights(lw)
    W2, log_mean2 = normalise_log_weights(lw + shift)
    np.testing.assert_allclose(W2, W, atol=1e-9)
    if np.isfinite(log_mean):
        assert log_mean2 - log_mean == pytest.approx(shift, abs=1e-9)


def test_log_mean_weight_is_the_closed_form() -> None:
    W, log_mean = normalise_log_weights(np.log([1.0, 2.0, 5.0, 4.0]))
    np.testing.assert_allclose(W, np.array([1, 2, 5, 4]) / 12)
    assert log_mean == pytest.approx(np.log(3.0))


def test_ess_of_known_weights() -> None:
    """A reference library once printed this formula upside down."""
    assert effective_sample_size(np.full(8, 1 / 8)) == pytest.approx(8.0)
    assert effective_sample_size(np.array([0.0, 1.0, 0.0])) == 1.0
    assert effective_sample_size(np.array([0.5, 0.5, 0.0, 0.0])) == pytest.approx(2.0)
    assert survival_rate(np.array([0.5, 0.5, 0.0, 0.0])) == pytest.approx(0.5)


def test_no_weights_and_infinite_weights_are_mistakes() -> None:
    with pytest.raises(ValueError, match="empty"):
        normalise_log_weights(np.array([]))
    with pytest.raises(ValueError, match="inf"):
        normalise_log_weights(np.array([0.0, np.inf]))


@given(weights=WEIGHTS, n=st.integers(1, 60), seed=st.integers(0, 999))
def test_systematic_counts_are_floor_or_ceil(weights: np.ndarray, n: int, seed: int) -> None:
    counts = np.bincount(systematic(weights, n, rng=np.random.default_rng(seed)), minlength=len(weights))
    expected = n * weights / weights.sum()
    # An expectation that is whole but for rounding may be taken one more or one less.
    assert np.all(counts >= np.floor(expected - 1e-9))
    assert np.all(counts <= np.ceil(expected + 1e-9))


@given(
    weights=WEIGHTS, n=st.integers(1, 60), seed=st.integers(0, 999), name=st.sampled_from(sorted(RESAMPLING))
)
def test_every_scheme_returns_sorted_particles_of_positive_weight(
    weights: np.ndarray, n: int, seed: int, name: str
) -> None:
    ancestors = RESAMPLING[name](weights, n, rng=np.random.default_rng(seed))
    assert ancestors.shape == (n,)
    assert np.all(weights[ancestors] > 0)
    assert np.all(np.diff(ancestors) >= 0)


class _Fixed:
    """Draws one number for ever."""

    def __init__(self, value: float) -> None:
        self.value = value

    def random(self, size: int | None = None) -> np.ndarray | float:
        return self.value if size is None else np.full(size, self.value)


@pytest.mark.parametrize("name", sorted(RESAMPLING))
def test_trailing_zero_weights_are_never_reached(name: str) -> None:
    """The largest draw below one is where a cumulative walk runs over the end."""
    weights = np.array([0.1] * 7 + [0.3, 0.0, 0.0])
    ancestors = RESAMPLING[name](weights, 11, rng=_Fixed(np.nextafter(1.0, 0.0)))
    assert ancestors.max() == 7


@pytest.mark.parametrize("name", sorted(RESAMPLING))
def test_leading_zero_weights_are_never_reached(name: str) -> None:
    """A draw of exactly zero lies on the border of the first weight."""
    ancestors = RESAMPLING[name](np.array([0.0, 0.0, 0.5, 0.5]), 4, rng=_Fixed(0.0))
    assert ancestors.min() == 2


@pytest.mark.parametrize("scheme", [systematic, stratified, multinomial])
def test_schemes_are_unbiased(scheme: object) -> None:
    """Mean counts over 4000 seeds against n W; the bound is five multinomial standard errors."""
    weights, n, runs = np.array([0.05, 0.0, 0.5, 0.15, 0.3]), 7, 4000
    rng = np.random.default_rng(12)
    counts = np.zeros(5)
    for _ in range(runs):
        counts += np.bincount(scheme(weights, n, rng=rng), minlength=5)  # type: ignore[operator]
    bound = 5 * np.sqrt(n * weights * (1 - weights) / runs) + 1e-12
    assert np.all(np.abs(counts / runs - n * weights) <= bound)


def test_impossible_weights_are_refused() -> None:
    for bad in ([], [0.0, 0.0], [0.5, -0.1], [np.nan, 1.0], [[0.5, 0.5]]):
        with pytest.raises(ValueError, match="weights"):
            systematic(np.array(bad), 3, rng=np.random.default_rng(0))


def test_circular_mean() -> None:
    """Angles on both sides of the seam average to the seam, not to zero."""
    particles = np.array([[0.0, 3.0], [2.0, -3.0], [7.0, np.pi]])
    mean = weighted_mean(particles, np.array([0.5, 0.5, 0.0]), np.array([False, True]))
    assert mean[0] == pytest.approx(1.0)
    assert np.cos(mean[1]) == pytest.approx(-1.0)
    plain = weighted_mean(particles, np.array([0.5, 0.25, 0.25]), np.array([False, False]))
    np.testing.assert_allclose(plain, [2.25, 0.75 + np.pi / 4])
