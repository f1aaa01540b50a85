"""Keypoints as a likelihood: derivatives against differences, costs against each other, and what has no say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from keypoint_world import keypoint_world
from numpy.typing import NDArray

from mocap.body.markers import marker_positions
from mocap.data.keypoints import KEYPOINTS, N_KEYPOINTS
from mocap.filters.refine import RefineSettings, refine
from mocap.geometry.triangulation import triangulate_agreeing
from mocap.likelihood.keypoints import KeypointProblem, KeypointSettings, KeypointViews
from mocap.likelihood.markers import marker_views, undistort

Array = NDArray[np.float64]
DIFFERENCE = 1e-6
# Central differences of a cost of some hundred nats.
CLOSE = 1e-4


def exact_views(frame: int = 3) -> KeypointViews:
    world = keypoint_world()
    uv = np.stack([undistort(c, world.figures[frame][i][0][:, :2]) for i, c in enumerate(world.rig)])
    noise = 2.0 + np.linspace(0.0, 3.0, uv.shape[0] * uv.shape[1]).reshape(uv.shape[:2])
    return KeypointViews(marker_views(world.rig).P, uv, noise)


def problem(views: KeypointViews | None = None, scale: float = 3.0) -> KeypointProblem:
    world = keypoint_world()
    return KeypointProblem(world.body, world.markers, views or exact_views(), KeypointSettings(scale))


def off(size: float = 0.05) -> Array:
    world = keypoint_world()
    state = world.states[0][3]
    return np.asarray(state + size * np.random.default_rng(1).uniform(-1, 1, state.shape))


@pytest.mark.parametrize("scale", [3.0, 1e4])
def test_the_gradient_is_that_of_the_cost(scale: float) -> None:
    p, state = problem(scale=scale), off()
    _, _, g = p.normal_equations(state)
    for d in range(len(state)):
        step = np.zeros_like(state)
        step[d] = DIFFERENCE
        slope = (p.normal_equations(state + step)[0] - p.normal_equations(state - step)[0]) / (2 * DIFFERENCE)
        assert slope == pytest.approx(g[d], rel=CLOSE, abs=CLOSE * np.abs(g).max())


def test_the_matrix_is_made_of_the_derivatives_of_the_pixels() -> None:
    """Without robustness: J^T J over noise^2 with J by differences of the projection, distortion taken out."""
    p, state = problem(scale=1e6), off()
    world, views = keypoint_world(), p.views

    def pixels(x: Array) -> Array:
        points = np.column_stack(
            [marker_positions(world.body, world.markers, x[None])[0], np.ones(N_KEYPOINTS)]
        )
        uvw = np.einsum("crk,nk->cnr", views.P, points)
        return np.asarray((uvw[..., :2] / uvw[..., 2:]) / views.noise_px[..., None])

    J = np.stack(
        [
            (pixels(state + DIFFERENCE * e) - pixels(state - DIFFERENCE * e))[views.has_say].ravel()
            / (2 * DIFFERENCE)
            for e in np.eye(len(state))
        ],
        axis=1,
    )
    expected = J.T @ J + np.diag(p.usual_information)
    np.testing.assert_allclose(
        p.normal_equations(state)[1], expected, rtol=CLOSE, atol=CLOSE * np.abs(expected).max()
    )


def test_both_kernels_give_one_cost() -> None:
    p, states = problem(), np.stack([off(0.02), off(0.3)])
    for state in states:
        points = marker_positions(p.body, p.markers, state[None])[0]
        assert p.costs(state[None])[0].sum() == pytest.approx(p.pulls(points)[0], rel=1e-12)
    assert p.log_likelihood(states).sum(axis=1) == pytest.approx(
        -p.settings.worth * p.costs(states).sum(axis=1)
    )


def test_exact_keypoints_give_the_exact_pose() -> None:
    """Where nothing else pulls: without what angles are usual."""
    world = keypoint_world()
    p = replace(problem(), settings=KeypointSettings(usual_weight=0.0))
    found, _ = refine(
        p, off(0.03), RefineSettings(np.full(len(off()), 1e3), 1.0, n_iterations=60, tolerance=0.0)
    )
    truth = marker_positions(world.body, world.markers, world.states[0][3][None])
    np.testing.assert_allclose(marker_positions(world.body, world.markers, found[None]), truth, atol=1e-5)


def test_a_view_without_a_keypoint_has_no_say() -> None:
    views, state = exact_views(), off()
    uv = views.uv.copy()
    uv[1] = np.nan
    uv[:, KEYPOINTS.index("left_knee")] = np.nan
    less = problem(KeypointViews(views.P, uv, views.noise_px))
    moved = problem(KeypointViews(views.P, np.where(np.isnan(uv), np.nan, views.uv), views.noise_px * 1.0))
    assert less.costs(state[None])[0, KEYPOINTS.index("left_knee")] == 0.0
    assert less.normal_equations(state)[0] == moved.normal_equations(state)[0]
    assert less.normal_equations(state)[0] < problem().normal_equations(state)[0]


def test_no_keypoint_costs_more_than_its_limit() -> None:
    p = problem()
    far = off()
    far[:3] += 50.0
    limit = 0.5 * p.settings.scale**2 * p.views.n_views
    assert (p.costs(far[None])[0] <= limit + 1e-9).all()
    behind = problem(KeypointViews(-p.views.P, p.views.uv, p.views.noise_px))
    assert behind.costs(off()[None])[0] == pytest.approx(limit)


def test_views_that_are_wrong_are_left_out_of_a_point() -> None:
    world, views = keypoint_world(), exact_views()
    uv = views.uv.copy()
    knee = KEYPOINTS.index("right_knee")
    uv[2, knee] += [60.0, -35.0]
    truth = marker_positions(world.body, world.markers, world.states[0][3][None])[0]
    found = triangulate_agreeing(views.P, uv, 3.0 * views.noise_px)
    seen = (np.isfinite(uv).all(axis=2).sum(axis=0) >= 2) & np.isfinite(found.points).all(axis=1)
    assert seen.all()
    np.testing.assert_allclose(found.points, truth, atol=1e-6)
    assert not found.agrees[2, knee]
    assert found.error[2, knee] > 1.0
    assert found.agrees.sum() == np.isfinite(uv).all(axis=2).sum() - 1


def test_two_views_that_do_not_meet_give_no_point() -> None:
    views = exact_views()
    uv = views.uv[:2].copy()
    uv[1] += [0.0, 80.0]
    found = triangulate_agreeing(views.P[:2], uv, 3.0 * views.noise_px[:2])
    assert np.isnan(found.points).all()
    assert not found.agrees.any()


def test_a_head_of_which_no_point_is_named_is_held_upright() -> None:
    """Nothing else would hold it: searches would leave it where they have drawn it."""
    views, p = exact_views(), problem()
    face = [
        k
        for k, name in enumerate(KEYPOINTS)
        if name.rpartition("_")[2] in ("nose", "head", "neck", "eye", "ear")
    ]
    uv = views.uv.copy()
    uv[:, face] = np.nan
    state = keypoint_world().states[0][3].copy()
    neck = [name.startswith("neck_") for name in p.layout.names]
    state[neck] = 0.6
    blind = replace(p, views=replace(views, uv=uv))
    found, _ = refine(
        blind, state, RefineSettings(np.full(len(state), 0.5), residual_std_m=1.0, n_iterations=20)
    )
    assert np.abs(found[neck]).max() < 0.4
    seen, _ = refine(p, state, RefineSettings(np.full(len(state), 0.5), residual_std_m=1.0, n_iterations=20))
    true = keypoint_world().states[0][3][neck]
    assert np.abs(seen[neck] - true).max() < 0.05, "where a face is seen it tells"
