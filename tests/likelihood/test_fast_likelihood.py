"""The fast likelihood: equal to the exact one where nothing is sampled, close to it everywhere else."""

from dataclasses import replace

import numpy as np
import pytest
from flesh_voxels import Flesh, make_flesh

from mocap.body import neutral_state
from mocap.data import VoxelGrid
from mocap.likelihood.voxels import (
    PackedVolume,
    VoxelLikelihoodSettings,
    VoxelProblem,
    factorised_log_likelihood,
    fast_part_scores,
    part_scores,
)
from mocap.likelihood.voxels._fast_kernels import fast_scores_kernel, picked_on_path
from mocap.likelihood.voxels.exact import SURFACE_MAX
from mocap.likelihood.voxels.fast import _FILLED, fast_sample, segment_map, spread_sample
from mocap.pose.volume import pack_volume

FIELDS = ("out", "double", "occupied", "surface")
ALL = 100_000  # more points than any part has: nothing is left out
ROUNDING = 1e-12  # shares are summed in another order


def scatter(flesh: Flesh, n: int, std_m: float, std_rad: float, seed: int = 0) -> np.ndarray:
    truth = neutral_state(flesh.body)
    std = np.where(np.arange(27) < 3, std_m, std_rad)
    noise = np.random.default_rng(seed).normal(size=(n, 27)) * std
    return np.clip(truth + noise, flesh.body.layout.lower, flesh.body.layout.upper)


@pytest.fixture(scope="module")
def volume(coarse_flesh: Flesh) -> PackedVolume:
    return pack_volume(coarse_flesh.grid, coarse_flesh.hull(neutral_state(coarse_flesh.body)), 1.0)


@pytest.mark.parametrize(("std_m", "std_rad"), [(0.0, 0.0), (0.03, 0.1), (1.5, 3.0)])
def test_all_points_give_the_exact_scores(
    coarse_flesh: Flesh, volume: PackedVolume, std_m: float, std_rad: float
) -> None:
    """All but double occupancy, which is an expectation."""
    args = coarse_flesh.body, coarse_flesh.table, volume, scatter(coarse_flesh, 17, std_m, std_rad)
    fast, exact = fast_part_scores(*args, n_points=ALL), part_scores(*args)
    for field in ("out", "occupied", "surface"):
        np.testing.assert_allclose(getattr(fast, field), getattr(exact, field), atol=ROUNDING, err_msg=field)


# Over 60 seeds with 40 grids each: at most 0.24 in one part of one state (three parts in one place are counted
# twice), 0.032 in a part's mean over the states, and -0.002 in the mean of all: no bias.
DOUBLE_ONE = 0.3
DOUBLE_MEAN = 0.045
DOUBLE_BIAS = 0.015


def test_double_occupancy_is_the_mean_over_placements_of_the_grid(coarse_flesh: Flesh) -> None:
    """The exact score depends on how the grid falls on the parts; the fast one is its expectation."""
    flesh = coarse_flesh
    states = scatter(flesh, 12, 0.05, 0.4, seed=3)
    rng = np.random.default_rng(8)
    crop = np.zeros((90, 80, 64), dtype=np.uint8)
    grids = [
        VoxelGrid(
            flesh.grid.origin + rng.uniform(-0.5, 0.5, 3) * flesh.grid.voxel_size_m, flesh.grid.shape, 0.04
        )
        for _ in range(40)
    ]
    volumes = [PackedVolume(crop, np.array([-4, -5, -3]), grid) for grid in grids]
    exact = np.mean([part_scores(flesh.body, flesh.table, v, states).double for v in volumes], axis=0)
    fast = fast_part_scores(flesh.body, flesh.table, volumes[0], states, n_points=ALL).double
    assert exact.max() > 0.4, "the states must exercise double occupancy"
    assert np.abs(fast - exact).max() < DOUBLE_ONE
    assert np.abs((fast - exact).mean(axis=0)).max() < DOUBLE_MEAN
    assert abs((fast - exact).mean()) < DOUBLE_BIAS


# Smallest values over 20 seeds: 0.986 and 0.73; means 0.992 and 0.90.
PEARSON = 0.98
TOP_TENTH = 0.7


@pytest.mark.parametrize(("std_m", "std_rad"), [(0.08, 0.25), (0.03, 0.10), (0.01, 0.03)])
def test_sampled_likelihood_ranks_as_the_exact_one(flesh: Flesh, std_m: float, std_rad: float) -> None:
    """At 2 cm with the default sample: correlation, and the ten per cent that are best."""
    truth = neutral_state(flesh.body)
    volume = pack_volume(flesh.grid, flesh.hull(truth, margin_m=0.02), 1.0)
    args = flesh.body, flesh.table, volume
    exact = VoxelProblem(*args, VoxelLikelihoodSettings())
    fast = VoxelProblem(*args, VoxelLikelihoodSettings(kind="fast"))
    states = scatter(flesh, 300, std_m, std_rad, seed=5)
    a, b = (p.log_likelihood(states).sum(axis=1) for p in (exact, fast))
    assert np.corrcoef(a, b)[0, 1] > PEARSON
    best = [set(np.argsort(-v)[:30].tolist()) for v in (a, b)]
    assert len(best[0] & best[1]) >= TOP_TENTH * 30


def test_more_points_come_closer(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    args = coarse_flesh.body, coarse_flesh.table, volume, scatter(coarse_flesh, 80, 0.05, 0.2)
    exact = part_scores(*args).occupied
    errors = [np.abs(fast_part_scores(*args, n_points=n).occupied - exact).mean() for n in (6, 40, 300)]
    assert errors[0] > errors[1] > errors[2]


def test_python_twin_of_the_kernel() -> None:
    flesh = make_flesh("thesis", 1.7, 0.05)
    volume = pack_volume(flesh.grid, flesh.hull(neutral_state(flesh.body)), 1.0)
    states = scatter(flesh, 3, 0.1, 0.5)
    states[2, :3] = flesh.grid.upper - 0.02
    sample = fast_sample(flesh.table, (4, 0, 3), (2, 9), 30)
    scores = np.zeros((3, 3, 4))
    fast_scores_kernel.py_func(states, flesh.body.chain, sample, volume.box, volume.crop.reshape(-1), scores)
    args = flesh.body, flesh.table, volume, states
    fast = fast_part_scores(*args, n_points=30, parts=(4, 0, 3), given=(2, 9))
    for i, field in enumerate(FIELDS):
        got = 1 - scores[..., i] / SURFACE_MAX if field == "surface" else scores[..., i]
        np.testing.assert_allclose(got, getattr(fast, field), atol=1e-9, err_msg=field)
    assert fast.double.max() > 0
    assert fast.out[2].max() > 0.2


@pytest.mark.parametrize(("parts", "given"), [((3,), ()), ((9, 2, 0), (4, 8)), ((), (1,))])
def test_subsets_and_threads(
    coarse_flesh: Flesh, volume: PackedVolume, parts: tuple[int, ...], given: tuple[int, ...]
) -> None:
    """A subset with all others given is the whole, alone it meets nobody; threads change nothing."""
    args = coarse_flesh.body, coarse_flesh.table, volume, scatter(coarse_flesh, 11, 0.1, 0.5)
    P = coarse_flesh.body.layout.n_parts
    whole = fast_part_scores(*args)
    some = fast_part_scores(*args, parts=parts, given=range(P))
    alone = fast_part_scores(*args, parts=parts)
    between = fast_part_scores(*args, parts=parts, given=given)
    threads = fast_part_scores(*args, parts=parts, given=given, n_threads=3)
    for field in FIELDS:
        np.testing.assert_allclose(getattr(some, field), getattr(whole, field)[:, list(parts)], atol=ROUNDING)
        np.testing.assert_array_equal(getattr(between, field), getattr(threads, field))
    assert np.all(alone.double <= between.double + ROUNDING)
    assert np.all(between.double <= some.double + ROUNDING)


def test_empty_full_and_far(coarse_flesh: Flesh) -> None:
    """Closed form, and states that are not finite: no data, not a crash."""
    body, table = coarse_flesh.body, coarse_flesh.table
    states = np.tile(neutral_state(body), (4, 1))
    states[:, 2] += 0.1
    states[1, :3] = [50.0, -80.0, 9.0]
    states[2, 0] = np.nan
    states[3, 9] = np.nan
    full = np.zeros((60, 61, 62), dtype=np.uint8)
    full[1:-1, 1:-1, 1:-1] = 128 | SURFACE_MAX
    for crop, occupied in ((full, 1.0), (np.zeros_like(full), 0.0)):
        volume = PackedVolume(crop, np.array([10, 8, -3]), coarse_flesh.grid)
        scores = fast_part_scores(body, table, volume, states)
        np.testing.assert_allclose(scores.occupied[0], occupied, atol=ROUNDING)
        np.testing.assert_allclose(scores.surface[0], 1 - occupied, atol=ROUNDING)
        assert np.all(scores.out[0] == 0)
        np.testing.assert_allclose(scores.out[1], 1.0, atol=ROUNDING)
        assert np.all(scores.occupied[1:3] == 0)
        assert all(np.isfinite(getattr(scores, field)).all() for field in FIELDS)


def test_a_sample_is_spread() -> None:
    line = np.stack([np.arange(100.0), np.zeros(100), np.zeros(100)], axis=1)
    rows = spread_sample(line, 7)
    assert len(set(rows.tolist())) == 7
    gaps = np.diff(rows)
    assert gaps.min() >= 10, "no two points together"
    assert gaps.max() <= 20, "no hole"
    np.testing.assert_array_equal(spread_sample(line, 100), np.arange(100))
    np.testing.assert_array_equal(spread_sample(line, 500), np.arange(100))
    assert spread_sample(line[:0], 5).size == 0
    assert spread_sample(line, 0).size == 0


@pytest.mark.parametrize(("n_points", "n_wanted"), [(2, 1), (3, 2), (57, 56), (400, 31)])
def test_the_path_through_halved_boxes_is_that_of_its_twin(n_points: int, n_wanted: int) -> None:
    # Rounded, so that many points are level and the order among equals counts.
    points = np.round(np.random.default_rng(n_points).random((n_points, 3)), 1)
    picks = ((np.arange(n_wanted) + 0.5) * n_points / n_wanted).astype(np.int64)
    picked = picked_on_path(points, picks)
    np.testing.assert_array_equal(picked, picked_on_path.py_func(points, picks))
    assert len(set(picked.tolist())) == n_wanted


def test_the_map_of_a_block_is_the_closed_form() -> None:
    """Trilinear interpolation sums to the number of points; deep inside every voxel is shared, outside none."""
    spacing = 0.02
    lattice = np.stack(np.meshgrid(np.arange(6), np.arange(5), np.arange(4), indexing="ij"), -1).reshape(
        -1, 3
    )
    points = 0.3 + spacing * lattice
    cells, lower, side = segment_map(points, spacing)
    assert side == spacing / 2
    assert cells.max() == round(255 * _FILLED)
    share = cells / (255 * _FILLED)
    assert share.sum() * (side / spacing) ** 3 == pytest.approx(len(points), rel=0.01)
    for face in (cells[0], cells[-1], cells[:, 0], cells[:, -1], cells[:, :, 0], cells[:, :, -1]):
        assert not face.any()

    def at(position: np.ndarray) -> float:
        return float(share[tuple(np.floor((position - lower) / side).astype(int))])

    assert at(np.array([0.36, 0.34, 0.33])) == pytest.approx(1.0, abs=0.01)
    # A quarter of a spacing before the first layer, deep inside along the others: three quarters.
    assert at(np.array([0.3 - 0.004, 0.34, 0.33])) == pytest.approx(0.75, abs=0.01)


def test_bad_input_is_refused(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    args = coarse_flesh.body, coarse_flesh.table, volume
    with pytest.raises(ValueError, match="n_points"):
        fast_part_scores(*args, np.zeros((2, 27)), n_points=0)
    with pytest.raises(ValueError, match="states has shape"):
        fast_part_scores(*args, np.zeros((2, 26)))
    with pytest.raises(ValueError, match="parts and given"):
        fast_part_scores(*args, np.zeros((2, 27)), parts=(0, 0))


def test_factorised_and_global(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    states = scatter(coarse_flesh, 5, 0.05, 0.2)
    args = coarse_flesh.body, coarse_flesh.table, volume
    settings = VoxelLikelihoodSettings(kind="fast", n_points=120)
    parts = VoxelProblem(*args, settings).log_likelihood(states)
    whole = VoxelProblem(*args, replace(settings, factorised=False)).log_likelihood(states)
    assert parts.shape == (5, coarse_flesh.body.layout.n_parts)
    assert whole.shape == (5, 1)
    scores = fast_part_scores(*args, states, n_points=120)
    np.testing.assert_array_equal(parts, factorised_log_likelihood(scores, coarse_flesh.body, settings))
