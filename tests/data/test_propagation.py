"""The truncated Gaussian step against scipy's truncated normal."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from mocap.data.propagation import truncated_gaussian_step

N = 20_000
# Kolmogorov-Smirnov statistic of N draws: largest over 200 seeds was 0.0120; frozen with a margin.
KS_BOUND = 0.016


def draw(at: float, std: float, low: float, high: float, *, seed: int = 0, n: int = N) -> np.ndarray:
    rng = np.random.default_rng(seed)
    step = truncated_gaussian_step(
        np.full((n, 1), at), np.array([std]), np.array([low]), np.array([high]), rng=rng
    )
    return step[:, 0]


@pytest.mark.parametrize(
    ("at", "std", "low", "high"),
    [
        (0.3, 0.5, -0.2, 1.0),
        (0.0, 0.5, 0.0, 3.0),
        (0.0, 5.0, -0.1, 0.2),
        (1.0, 0.3, -np.inf, 1.2),
        (1.0, 0.3, 0.9, np.inf),
        (0.7, 0.2, -np.inf, np.inf),
    ],
)
def test_distribution_is_the_truncated_normal(at: float, std: float, low: float, high: float) -> None:
    expected = stats.truncnorm((low - at) / std, (high - at) / std, loc=at, scale=std)
    x = draw(at, std, low, high)
    assert stats.kstest(x, expected.cdf).statistic < KS_BOUND
    # Four standard errors of the mean.
    assert x.mean() == pytest.approx(expected.mean(), abs=4 * expected.std() / np.sqrt(N))


@given(
    at=st.floats(-1e3, 1e3),
    std=st.floats(0, 1e3),
    low=st.floats(-10, 0) | st.just(-np.inf),
    width=st.floats(0, 10) | st.just(np.inf),
    seed=st.integers(0, 99),
)
def test_never_leaves_the_bounds_and_never_breaks(
    at: float, std: float, low: float, width: float, seed: int
) -> None:
    high = width if low == -np.inf else low + width
    x = draw(at, std, low, high, seed=seed, n=50)
    assert np.isfinite(x).all()
    assert np.all(x >= low)
    assert np.all(x <= high)


def test_std_zero_only_clips() -> None:
    particles = np.array([[-3.0, 0.4, 9.0], [0.1, 0.2, 0.3]])
    lower, upper = np.array([-1.0, -np.inf, 0.0]), np.array([1.0, np.inf, 0.25])
    moved = truncated_gaussian_step(particles, np.zeros(3), lower, upper, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(moved, [[-1.0, 0.4, 0.25], [0.1, 0.2, 0.25]])


def test_a_particle_outside_starts_at_the_nearest_bound() -> None:
    low, high, std = 0.0, 2.0, 0.1
    x = draw(-7.0, std, low, high)
    expected = stats.truncnorm(0.0, (high - low) / std, loc=low, scale=std)
    assert stats.kstest(x, expected.cdf).statistic < KS_BOUND


def test_columns_do_not_disturb_each_other_and_the_input_stays() -> None:
    """Invariance: one column's step does not depend on the others' bounds."""
    particles = np.random.default_rng(4).normal(size=(31, 3))
    kept = particles.copy()
    std = np.array([0.2, 0.0, 0.7])
    wide = np.full(3, np.inf)
    a = truncated_gaussian_step(particles, std, -wide, wide, rng=np.random.default_rng(9))
    tight = np.array([0.1, 0.1, np.inf])
    b = truncated_gaussian_step(particles, std, -tight, tight, rng=np.random.default_rng(9))
    np.testing.assert_array_equal(a[:, 2], b[:, 2])
    np.testing.assert_array_equal(particles, kept)
