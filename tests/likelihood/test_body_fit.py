"""The compiled descent against its twin in numpy, the sum against its terms, and what is missing."""

from dataclasses import replace

import numpy as np
import pytest
from flesh_voxels import Flesh, make_flesh
from outline_world import bent, make_rig, outlines_of, problem_of

from mocap.body import neutral_state
from mocap.filters.refine import RefineSettings, refine
from mocap.likelihood.residuals import BodyFit, SumProblem, SurfaceFitSettings, SurfaceProblem, hull_surface
from mocap.likelihood.residuals import _descent_kernels as kernels
from mocap.pose.volume import pack_volume

USUAL_WEIGHT = 1e-5  # m^2 per hull point and nat


@pytest.fixture(scope="module")
def fit(flesh: Flesh) -> BodyFit:
    return body_fit(flesh)


def body_fit(flesh: Flesh) -> BodyFit:
    """Hull surface and outlines of a bent body; the hull is its own flesh."""
    state = bent(flesh)
    hull = flesh.hull(state)
    volume = pack_volume(flesh.grid, hull, 1.0)
    surface = hull_surface(hull.voxels, hull.is_surface, flesh.grid, volume)
    outlines = outlines_of(flesh, state, make_rig())
    return BodyFit(
        SurfaceProblem(flesh.body, flesh.table, surface, SurfaceFitSettings()),
        problem_of(flesh, outlines),
        0.8,
        2.5,
    )


def starts(flesh: Flesh) -> np.ndarray:
    rng = np.random.default_rng(4)
    return bent(flesh) + 0.1 * rng.normal(size=(5, flesh.body.layout.n_columns))


def test_the_sum_is_that_of_its_terms(flesh: Flesh, fit: BodyFit) -> None:
    assert fit.outlines is not None
    both = SumProblem(((0.8, fit.surface), (2.5, fit.outlines)))
    for state in starts(flesh):
        for a, b in zip(fit.normal_equations(state), both.normal_equations(state), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("n_threads", [1, 3])
@pytest.mark.parametrize(("n_iterations", "reach"), [(1, 1.0), (12, 1.0), (1, 1.6), (7, 1.6)])
def test_the_descent_is_that_of_its_twin(
    flesh: Flesh, fit: BodyFit, n_threads: int, n_iterations: int, reach: float
) -> None:
    fit = replace(fit, usual_weight=USUAL_WEIGHT)
    layout = flesh.body.layout
    std = np.where(np.arange(layout.n_columns) < 3, 0.1, 0.5)
    settings = RefineSettings(prior_std=std, n_iterations=n_iterations, reach=reach)
    expected = [refine(fit, state, settings)[0] for state in starts(flesh)]
    found = fit.descended(
        starts(flesh),
        prior_std=std,
        residual_std_m=settings.residual_std_m,
        n_iterations=n_iterations,
        tolerance=settings.tolerance,
        reach=reach,
        n_threads=n_threads,
    )
    np.testing.assert_allclose(found, expected, atol=1e-7)
    costs = [fit.normal_equations(s)[0] for s in found]
    before = [fit.normal_equations(np.clip(s, layout.lower, layout.upper))[0] for s in starts(flesh)]
    assert np.mean(costs) < np.mean(before)
    assert np.all((found >= layout.lower) & (found <= layout.upper))


def test_unusual_angles_cost_half_a_nat_at_their_deviation() -> None:
    """Closed form: 1/2 (x / std)^2 nats in the columns that have a deviation, with its gradient."""
    flesh = make_flesh("girdle", 1.75, 0.04)
    fit = body_fit(flesh)
    body = flesh.body
    state = np.where(np.isfinite(body.usual_std), 0.1, neutral_state(body))
    pulled = replace(fit, usual_weight=USUAL_WEIGHT)
    a, b = fit.normal_equations(state), pulled.normal_equations(state)
    weight = USUAL_WEIGHT * fit.surface.n_points
    is_usual = np.isfinite(body.usual_std)
    assert {body.layout.names[i] for i in np.flatnonzero(is_usual)} >= {"waist_x", "left_clavicle_z"}
    share = np.where(is_usual, state / body.usual_std, 0.0)
    assert b[0] - a[0] == pytest.approx(0.5 * weight * float(share @ share), rel=1e-9)
    np.testing.assert_allclose(b[1] - a[1], np.diag(weight / body.usual_std**2), atol=1e-9)
    np.testing.assert_allclose(b[2] - a[2], weight * share / body.usual_std, atol=1e-9)


def test_without_outlines_or_hull_the_rest_counts(flesh: Flesh, fit: BodyFit) -> None:
    state = starts(flesh)[0]
    alone = BodyFit(fit.surface, None, 1.0, 7.0)
    np.testing.assert_allclose(alone.normal_equations(state)[1], fit.surface.normal_equations(state)[1])
    nothing = replace(fit.surface.hull, points=np.zeros((0, 3)), normals=np.zeros((0, 3)))
    empty = replace(fit.surface, hull=nothing)
    assert BodyFit(empty, None).normal_equations(state)[0] == 0.0
    assert fit.outlines is not None
    only = BodyFit(empty, fit.outlines, 1.0, 2.0).normal_equations(state)
    np.testing.assert_allclose(only[2], 2.0 * fit.outlines.normal_equations(state)[2])


def test_the_step_solves_the_damped_equations_in_the_free_columns() -> None:
    rng = np.random.default_rng(0)
    J = rng.normal(size=(30, 9))
    H, g = J.T @ J, rng.normal(size=9)
    free = np.array([1, 1, 0, 1, 0, 1, 1, 1, 0], dtype=np.bool_)
    for solve in (kernels.damped_step, kernels.damped_step.py_func):
        step = np.full(9, 7.0)
        assert solve(H, g, 0.2, free, np.zeros((9, 9)), step)
        A = (H + 0.2 * np.diag(np.diag(H)))[np.ix_(free, free)]
        np.testing.assert_allclose(step[free], -np.linalg.solve(A, g[free]), rtol=1e-9)
        assert not step[~free].any()
        assert not solve(-H, g, 0.0, free, np.zeros((9, 9)), step)


def test_the_prior_pulls_the_short_way_across_the_seam() -> None:
    start, x = np.array([0.1 - np.pi, 0.2]), np.array([np.pi - 0.1, 0.5])
    H, g = np.zeros((2, 2)), np.zeros(2)
    cost = kernels.add_prior(x, start, np.array([2.0, 3.0]), np.array([True, False]), H, g)
    assert cost == pytest.approx(0.5 * (2.0 * 0.2**2 + 3.0 * 0.3**2))
    np.testing.assert_allclose(g, [-0.4, 0.9])
    np.testing.assert_allclose(H, np.diag([2.0, 3.0]))
