"""Residual, weighted and adaptive systematic resampling, and all schemes beside another library's."""

from types import ModuleType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mocap.filters.resampling import (
    RESAMPLING,
    adaptive_systematic,
    multinomial,
    residual,
    stratified,
    systematic,
    weighted,
    weighted_then_equal,
)

WEIGHTS = hnp.arrays(np.float64, st.integers(1, 30), elements=st.just(0.0) | st.floats(1e-6, 1.0)).filter(
    lambda w: w.sum() > 0
)
UNEVEN = np.array([0.05, 0.0, 0.5, 0.15, 0.3])
RUNS = 4000
# Mean counts over RUNS draws lie within five standard errors of what they should be.
N_ERRORS = 5


@given(weights=WEIGHTS, n=st.integers(1, 60), seed=st.integers(0, 999))
def test_residual_keeps_the_whole_part_of_every_expectation(weights: np.ndarray, n: int, seed: int) -> None:
    counts = np.bincount(residual(weights, n, rng=np.random.default_rng(seed)), minlength=len(weights))
    assert counts.sum() == n
    assert np.all(counts >= np.floor(n * weights / weights.sum() - 1e-9))
    assert np.all(counts[weights == 0] == 0)


def test_residual_draws_nothing_when_all_expectations_are_whole() -> None:
    ancestors = residual(np.array([0.5, 0.0, 0.25, 0.25]), 8, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(ancestors, [0, 0, 0, 0, 2, 2, 3, 3])


@pytest.mark.parametrize("scheme", [residual, adaptive_systematic])
def test_new_schemes_are_unbiased(scheme: object) -> None:
    n = 7
    rng = np.random.default_rng(12)
    counts = np.zeros(5)
    for _ in range(RUNS):
        counts += np.bincount(scheme(UNEVEN, n, rng=rng), minlength=5)  # type: ignore[operator]
    bound = N_ERRORS * np.sqrt(n * UNEVEN * (1 - UNEVEN) / RUNS) + 1e-12
    assert np.all(np.abs(counts / RUNS - n * UNEVEN) <= bound)


def test_weighted_resampling_is_unbiased_and_looks_elsewhere() -> None:
    """The self-normalised mean of f has a bias of order 1 / n: with n = 500 draws it drowns in the bound."""
    f = np.array([1.0, -5.0, 2.0, 4.0, -3.0])
    exact = UNEVEN @ f
    rng = np.random.default_rng(3)
    means, counts = [], np.zeros(5)
    for _ in range(RUNS // 4):
        ancestors, weights = weighted(UNEVEN, 500, rng=rng, sharpness=4.0)
        assert weights.sum() == pytest.approx(1.0)
        means.append(weights @ f[ancestors])
        counts += np.bincount(ancestors, minlength=5)
    assert abs(np.mean(means) - exact) < N_ERRORS * np.std(means) / np.sqrt(len(means)) + 1e-3
    g = np.exp(4.0 * UNEVEN)
    np.testing.assert_allclose(counts / counts.sum(), g / g.sum(), atol=0.01)


def test_weighted_resampling_divides_the_weights_by_what_it_drew_with() -> None:
    ancestors, weights = weighted(UNEVEN, 40, rng=np.random.default_rng(0))
    expected = UNEVEN[ancestors] / np.exp(20.0 * UNEVEN[ancestors])
    np.testing.assert_allclose(weights, expected / expected.sum(), rtol=1e-12)


def test_weighted_resampling_made_equal_still_follows_the_weights() -> None:
    """It does so as n grows only: what g hardly ever draws comes too seldom at first.

    Over 8 seeds the shares were off by at most 0.011 with 40 draws and 0.0007 with 4000.
    """
    rng, runs = np.random.default_rng(7), 200
    weights = rng.dirichlet(np.full(40, 2.0))
    off = []
    for n in (40, 4000):
        drawn = [np.bincount(weighted_then_equal(weights, n, rng=rng), minlength=40) for _ in range(runs)]
        off.append(np.abs(np.mean(drawn, axis=0) / n - weights).max())
    assert off[1] < 0.001
    assert off[0] < 0.02


@given(weights=WEIGHTS, n=st.integers(1, 40), seed=st.integers(0, 99))
def test_weighted_resampling_never_loses_all_weight(weights: np.ndarray, n: int, seed: int) -> None:
    ancestors, corrected = weighted(weights, n, rng=np.random.default_rng(seed))
    assert corrected.sum() == pytest.approx(1.0)
    assert np.all(corrected >= 0)
    assert np.all(corrected[weights[ancestors] == 0] == 0)


@given(weights=WEIGHTS, n=st.integers(1, 60), seed=st.integers(0, 999))
def test_adaptive_systematic_keeps_the_rank(weights: np.ndarray, n: int, seed: int) -> None:
    """Any number of particles comes out, heaviest first, each floor or ceil of its expectation."""
    ancestors = adaptive_systematic(weights, n, rng=np.random.default_rng(seed))
    assert ancestors.shape == (n,)
    assert np.all(np.diff(weights[ancestors]) <= 0)
    expected = n * weights / weights.sum()
    counts = np.bincount(ancestors, minlength=len(weights))
    assert np.all(counts >= np.floor(expected - 1e-9))
    assert np.all(counts <= np.ceil(expected + 1e-9))


@pytest.mark.parametrize("name", sorted(RESAMPLING))
@pytest.mark.parametrize("factor", [1.0 - 1e-9, 1.0 + 1e-9, 1e-300, 7.0])
def test_sums_other_than_one_are_no_matter(name: str, factor: float) -> None:
    """A sum that is one but for rounding, or not at all, gives the same particles."""
    weights = np.array([0.1] * 7 + [0.3, 0.0])
    exact = RESAMPLING[name](weights, 23, rng=np.random.default_rng(4))
    scaled = RESAMPLING[name](weights * factor, 23, rng=np.random.default_rng(4))
    np.testing.assert_array_equal(scaled, exact)


@pytest.mark.parametrize("name", sorted(RESAMPLING))
def test_one_particle_of_weight_is_all_that_is_left(name: str) -> None:
    ancestors = RESAMPLING[name](np.array([0.0, 0.0, 3.0, 0.0]), 6, rng=np.random.default_rng(1))
    np.testing.assert_array_equal(ancestors, np.full(6, 2))


# Draws that do not fall on a border of the cumulative sum, where libraries may differ.
DRAWS = np.random.default_rng(8).random(64)


class _Replay:
    """Hands out DRAWS: a number, or an array of the first ones."""

    def random(self, size: int | None = None) -> np.ndarray | float:
        return float(DRAWS[0]) if size is None else DRAWS[:size].copy()


@pytest.fixture
def filterpy(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The resampling module of filterpy, fed with the same draws."""
    module = pytest.importorskip(
        "filterpy.monte_carlo.resampling", reason="filterpy, a development dependency, is not installed"
    )
    monkeypatch.setattr(module, "random", _Replay().random)
    return module  # type: ignore[no-any-return]


@pytest.mark.parametrize("seed", range(5))
def test_the_same_draws_give_the_same_particles_as_filterpy(filterpy: ModuleType, seed: int) -> None:
    weights = np.random.default_rng(seed).dirichlet(np.full(37, 0.4))
    replay = _Replay()
    for ours, theirs in (
        (systematic, filterpy.systematic_resample),
        (stratified, filterpy.stratified_resample),
    ):
        np.testing.assert_array_equal(ours(weights, 37, rng=replay), theirs(weights))  # type: ignore[arg-type]
    np.testing.assert_array_equal(
        multinomial(weights, 37, rng=replay),  # type: ignore[arg-type]
        np.sort(filterpy.multinomial_resample(weights)),
    )


def test_residual_differs_from_filterpy_where_that_is_wrong(filterpy: ModuleType) -> None:
    """The copies agree. For the rest, filterpy subtracts counts from weights instead of from N times the weights."""
    weights = np.random.default_rng(0).dirichlet(np.full(37, 0.4))
    theirs = np.bincount(
        filterpy.residual_resample(weights)[: int(np.floor(37 * weights).sum())], minlength=37
    )
    np.testing.assert_array_equal(theirs, np.floor(37 * weights))
    ours = np.bincount(residual(weights, 37, rng=_Replay()), minlength=37)  # type: ignore[arg-type]
    assert np.all(ours >= theirs)
