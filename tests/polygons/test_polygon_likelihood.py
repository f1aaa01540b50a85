"""Colour likelihood of polygons: closed forms, the kernel against its twins, what makes no sense."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap.data.problem import StateLayout
from mocap.polygons import _kernels as kernels
from mocap.polygons.likelihood import (
    PolygonLikelihoodSettings,
    PolygonProblem,
    colour_bins,
    mark_runs,
    part_histograms,
    polygon_scores,
    polygon_scores_numpy,
    random_walk_std,
)
from mocap.polygons.tree import PolygonTree, star_tree, with_loose_joints

# Both sum 24 products of numbers below 1 in another order.
ROUNDING = 1e-12
HEIGHT, WIDTH = 61, 83


def one_square(half: float = 10.0) -> PolygonTree:
    layout = StateLayout(
        names=("x", "y", "theta"),
        lower=np.full(3, -np.inf),
        upper=np.full(3, np.inf),
        is_circular=np.array([False, False, True]),
        parts=("root",),
        part_of_column=np.zeros(3, dtype=np.int64),
        parent_of_part=np.array([-1]),
    )
    corners = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return PolygonTree(layout, np.zeros((1, 2)), np.zeros(1), corners, np.array([0, 4]))


def picture(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Blocks of colour with noise, and a foreground."""
    coarse = rng.integers(0, 256, (9, 11, 3))
    image = np.kron(coarse, np.ones((7, 8, 1)))[:HEIGHT, :WIDTH] + rng.integers(-9, 10, (HEIGHT, WIDTH, 3))
    return np.clip(image, 0, 255).astype(np.uint8), rng.random((HEIGHT, WIDTH)) < 0.6


def test_bins_are_the_upper_bits_of_each_channel() -> None:
    image = np.array([[[0, 31, 32], [255, 224, 223]]], dtype=np.uint8)
    empty = np.zeros((1, 2), dtype=bool)
    assert colour_bins(image, empty).tolist() == [[0 + 0 * 8 + 1 * 64, 7 + 7 * 8 + 6 * 64]]
    assert colour_bins(image).tolist() == [[64 + 512, 7 + 56 + 384 + 512]]
    for r in range(0, 256, 17):
        grey = np.full((1, 1, 3), r, dtype=np.uint8)
        assert colour_bins(grey, empty[:, :1])[0, 0] == (r // 32) * 73


def test_a_square_in_two_colours_has_the_distance_of_the_closed_form() -> None:
    """A shift by s of 20 columns onto the background: BC = (sqrt(1 - s / 20) + 2) / 3 where one channel differs."""
    image = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    image[20:40, 30:50, 0] = 255
    tree = one_square()
    bins = colour_bins(image)
    center = np.array(
        [[39.5 + 0.1, 29.5 + 0.1, 0.0]]
    )  # corners beside pixel centres, so that nothing depends on ties
    reference, area = part_histograms(tree, bins, center)
    assert area[0, 0] == 400
    assert reference[0, 0].sum() == pytest.approx(1.0)
    shift = np.array([0, 1, 5, 13, 20, 25])
    states = center + np.column_stack([shift, 0 * shift, 0 * shift])
    squared, _ = polygon_scores(tree, bins, reference[0], states)
    inside = np.clip(1 - shift / 20, 0, 1)
    np.testing.assert_allclose(squared[:, 0], 1 - (np.sqrt(inside) + 2) / 3, atol=ROUNDING)
    problem = PolygonProblem(tree, bins, reference[0])
    np.testing.assert_allclose(problem.log_likelihood(states), -50 * squared, atol=1e-10)


def test_the_silhouette_term_counts_pixels_off_the_foreground() -> None:
    image = np.full((HEIGHT, WIDTH, 3), 77, dtype=np.uint8)
    foreground = np.zeros((HEIGHT, WIDTH), dtype=bool)
    foreground[:, :40] = True
    tree = one_square()
    bins = colour_bins(image, foreground)
    states = np.array([[39.6, 29.6, 0.0], [29.0, 29.6, 0.0], [60.0, 29.6, 0.0]])
    reference = part_histograms(tree, bins, states[:1])[0][0]
    squared, uncovered = polygon_scores(tree, bins, reference, states)
    np.testing.assert_allclose(squared, 0.0, atol=ROUNDING)
    assert uncovered[:, 0].tolist() == [0.5, 0.0, 1.0]
    with_term = PolygonProblem(tree, bins, reference, PolygonLikelihoodSettings(lambda_silhouette=8.0))
    np.testing.assert_allclose(with_term.log_likelihood(states)[:, 0], [-4, 0, -8], atol=1e-10)
    without = PolygonProblem(tree, bins, reference)
    np.testing.assert_allclose(without.log_likelihood(states)[:, 0], 0.0, atol=1e-10)


@given(seed=st.integers(0, 2**32 - 1))
def test_the_kernel_equals_the_crossing_number_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bins = colour_bins(*picture(rng))
    tree = star_tree(int(rng.integers(1, 5)), int(rng.integers(1, 4)))
    if seed % 2:
        tree, _ = with_loose_joints(tree)
    states = rng.normal(size=(3, tree.layout.n_columns)) * 0.7
    states[:, 0] += rng.uniform(-20, WIDTH + 20, 3)
    states[:, 1] += rng.uniform(-20, HEIGHT + 20, 3)
    reference = rng.dirichlet(np.ones(24), tree.layout.n_parts)
    ours = polygon_scores(tree, bins, reference, states)
    theirs = polygon_scores_numpy(tree, bins, reference, states)
    np.testing.assert_allclose(ours[0], theirs[0], atol=ROUNDING)
    np.testing.assert_allclose(ours[1], theirs[1], atol=ROUNDING)


def test_marked_runs_change_no_bit() -> None:
    """Runs longer than the mark can say, runs that the border of the picture ends, and single pixels."""
    rng = np.random.default_rng(9)
    image = np.repeat(rng.integers(0, 256, (HEIGHT, 4, 3)), (140, 1, 40, 75), axis=1).astype(np.uint8)
    image[:, 200:220] = rng.integers(0, 256, (HEIGHT, 20, 3))
    bins = colour_bins(image, np.arange(256) % 97 < 70 + np.zeros((HEIGHT, 1)))
    marked = mark_runs(bins)
    np.testing.assert_array_equal(marked & np.uint16(1023), bins)
    assert (marked >> 10).max() == 63
    assert not (marked[:, -1] >> 10).any()
    np.testing.assert_array_equal(marked[:, :-1] >> 10 > 0, bins[:, :-1] == bins[:, 1:])
    np.testing.assert_array_equal(mark_runs(marked), marked)
    tree = star_tree(4, 3)
    states = rng.normal(size=(40, tree.layout.n_columns))
    states[:, 0] += rng.uniform(-20, 276, 40)
    states[:, 1] += rng.uniform(-20, HEIGHT + 20, 40)
    reference = rng.dirichlet(np.ones(24), tree.layout.n_parts)
    for ours, plain in zip(
        polygon_scores(tree, marked, reference, states),
        polygon_scores(tree, bins, reference, states),
        strict=True,
    ):
        np.testing.assert_array_equal(ours, plain)
    theirs = polygon_scores_numpy(tree, marked, reference, states[:4])
    np.testing.assert_allclose(polygon_scores(tree, marked, reference, states[:4]), theirs, atol=ROUNDING)


def test_the_kernel_without_the_compiler_says_the_same() -> None:
    rng = np.random.default_rng(3)
    bins = colour_bins(*picture(rng))
    x, y = np.array([20.3, 60.9, 55.2, 11.7]), np.array([-4.2, 7.7, 40.1, 71.3])
    compiled, plain = np.zeros(26, dtype=np.int64), np.zeros(26, dtype=np.int64)
    assert kernels.count_polygon(x, y, bins, compiled) == kernels.count_polygon.py_func(x, y, bins, plain)
    np.testing.assert_array_equal(compiled, plain)
    assert plain.sum() > 0


def test_polygons_that_share_a_border_share_no_pixel_and_leave_none_out() -> None:
    bins = colour_bins(*picture(np.random.default_rng(4)))
    whole, left, right = (np.zeros(26, dtype=np.int64) for _ in range(3))
    x, y = np.array([10.2, 50.0, 63.0, 21.4]), np.array([8.8, 5.0, 44.0, 50.1])
    split = (
        np.array([[10.2, 50.0, 63.0], [8.8, 5.0, 44.0]]),
        np.array([[10.2, 63.0, 21.4], [8.8, 44.0, 50.1]]),
    )
    areas = [kernels.count_polygon(x, y, bins, whole)[0]]
    areas += [
        kernels.count_polygon(s[0], s[1], bins, h)[0] for s, h in zip(split, (left, right), strict=True)
    ]
    assert areas[0] == areas[1] + areas[2]
    np.testing.assert_array_equal(whole, left + right)


def test_area_on_whole_pixels_holds_the_left_and_the_upper_border() -> None:
    """Corners on pixel centres: columns 2 to 5 and rows 3 to 7, in both senses of rotation and by the twin."""
    bins = colour_bins(np.zeros((12, 12, 3), dtype=np.uint8))
    bins[3:8, 2:6] = 1
    x, y = np.array([2.0, 6.0, 6.0, 2.0]), np.array([3.0, 3.0, 8.0, 8.0])
    for order in (slice(None), slice(None, None, -1)):
        counts = np.zeros(26, dtype=np.int64)
        area, _ = kernels.count_polygon(x[order].copy(), y[order].copy(), bins, counts)
        assert area == 20
        assert counts[1] == 20, "of the marked pixels, all and no other"
    reference = np.zeros((1, 24))
    reference[0, [1, 8, 16]] = 1 / 3
    squared, _ = polygon_scores_numpy(one_square(2.0), bins, reference, np.array([[4.0, 5.0, 0.0]]))
    assert squared[0, 0] == pytest.approx(0.0, abs=ROUNDING)


def test_area_in_pixels_is_that_of_the_polygon() -> None:
    """One-sided: pixels and area differ by at most the perimeter."""
    tree = star_tree(4, 3)
    bins = colour_bins(np.zeros((300, 320, 3), dtype=np.uint8))
    states = np.random.default_rng(5).normal(size=(11, tree.layout.n_columns))
    states[:, :2] += 150.0
    _, area = part_histograms(tree, bins, states)
    for p in range(tree.layout.n_parts):
        c = tree.corners_of(p)
        following = np.roll(c, -1, axis=0)
        exact = 0.5 * abs(np.sum(c[:, 0] * following[:, 1] - c[:, 1] * following[:, 0]))
        assert np.all(np.abs(area[:, p] - exact) <= np.linalg.norm(following - c, axis=1).sum())


def test_some_parts_are_scored_as_all_are_and_in_the_order_asked_for() -> None:
    rng = np.random.default_rng(6)
    tree = star_tree(3, 4)
    problem = PolygonProblem(
        tree, colour_bins(*picture(rng)), rng.dirichlet(np.ones(24), tree.layout.n_parts)
    )
    states = rng.normal(size=(5, tree.layout.n_columns)) + 30.0
    every = problem.log_likelihood(states)
    assert every.shape == (5, 10)
    order = [7, 0, 3]
    np.testing.assert_array_equal(problem.log_likelihood(states, order, given=[1, 2]), every[:, order])
    assert problem.log_likelihood(states, []).shape == (5, 0)
    with pytest.raises(ValueError, match="parts"):
        problem.log_likelihood(states, [10])


def test_outside_the_picture_and_without_numbers() -> None:
    rng = np.random.default_rng(7)
    tree = one_square()
    bins = colour_bins(*picture(rng))
    reference = part_histograms(tree, bins, np.array([[30.0, 30.0, 0.0]]))[0][0]
    problem = PolygonProblem(tree, bins, reference)
    states = np.array(
        [
            [-500.0, 20, 0],
            [30, 1e12, 0],
            [1e300, -1e300, 0],
            [np.nan, 30, 0],
            [30, np.inf, 0],
            [30, 30, np.nan],
        ]
    )
    with np.errstate(all="raise"):
        values = problem.log_likelihood(states)[:, 0]
    np.testing.assert_allclose(values[:3], -50.0)
    assert np.all(np.isneginf(values[3:]))


def test_half_outside_loses_what_is_outside() -> None:
    tree = one_square()
    bins = colour_bins(np.full((HEIGHT, WIDTH, 3), 200, dtype=np.uint8))
    states = np.array([[-0.4, 29.6, 0.0], [30.6, 29.6, 0.0]])
    reference = part_histograms(tree, bins, states[1:])[0][0]
    squared, _ = polygon_scores(tree, bins, reference, states)
    np.testing.assert_allclose(squared[:, 0], [1 - np.sqrt(0.5), 0.0], atol=ROUNDING)


def test_the_walk_is_a_gaussian_and_leaves_still_columns_alone() -> None:
    tree = star_tree(2, 3)
    rng = np.random.default_rng(8)
    problem = PolygonProblem(tree, colour_bins(*picture(rng)), np.full((5, 24), 1 / 24))
    std = random_walk_std(tree.layout)
    assert std[:3].tolist() == [1.0, 1.0, 0.025]
    std[[1, 4]] = 0.0
    particles = rng.normal(size=(4001, tree.layout.n_columns)) * 40
    moved = problem.propagate(particles, std, rng=rng)
    np.testing.assert_array_equal(moved[:, [1, 4]], particles[:, [1, 4]])
    step = (moved - particles)[:, std > 0] / std[std > 0]
    # 4 standard errors of mean and standard deviation of 4001 draws.
    assert np.all(np.abs(step.mean(axis=0)) < 4 / np.sqrt(4001))
    assert np.all(np.abs(step.std(axis=0) - 1) < 4 / np.sqrt(2 * 4001))


@pytest.mark.parametrize("kwargs", [{"lambda_colour": -1.0}, {"lambda_silhouette": float("nan")}])
def test_senseless_settings_are_refused(kwargs: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(kwargs))):
        PolygonLikelihoodSettings(**kwargs)


def test_wrong_pictures_are_refused() -> None:
    with pytest.raises(ValueError, match="image"):
        colour_bins(np.zeros((5, 7), dtype=np.uint8))
    with pytest.raises(ValueError, match="foreground"):
        colour_bins(np.zeros((5, 7, 3), dtype=np.uint8), np.zeros((7, 5), dtype=bool))
