"""Marker likelihood: closed forms, invariances, bounds, and the kernel against its numpy twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from marker_world import detect, marching, other_body, ring

from mocap.body import Body, neutral_state
from mocap.body.markers import Markers, marker_positions
from mocap.data import CameraRig
from mocap.geometry.epipolar import symmetric_epipolar_distance
from mocap.likelihood.markers import (
    MarkerFitProblem,
    MarkerFitSettings,
    MarkerLikelihoodSettings,
    MarkerObservation,
    MarkerProblem,
    marker_scores_numpy,
    marker_views,
    observe,
    undistort,
)

# Undistorted pixels come out of an iteration of 1e-12 in normalised coordinates; the table of squares is float32.
SCORE_TOLERANCE = 1e-6
STEP = 1e-6
NOISY = {"rate": 0.7, "n_false": 6, "noise_px": 1.5}


def settings(weight: float, *, gate_px: float = 14.0, factorised: bool = True) -> MarkerLikelihoodSettings:
    return MarkerLikelihoodSettings(gate_px=gate_px, reprojection_weight=weight, factorised=factorised)


def pose(body: Body) -> np.ndarray:
    return marching(body, 3)[2]


def seen(
    rig: CameraRig, body: Body, markers: Markers, state: np.ndarray, **kwargs: float
) -> MarkerObservation:
    points = marker_positions(body, markers, state[None])[0]
    wanted = {"rate": 1.0, "n_false": 0, "noise_px": 0.0, **kwargs}
    found = detect(rig, points, rng=np.random.default_rng(3), **wanted)  # type: ignore[arg-type]
    return observe(marker_views(rig), found)


def problem(
    weight: float, state: np.ndarray | None = None, *, gate_px: float = 14.0, **kwargs: float
) -> MarkerProblem:
    body, markers = other_body()
    state = pose(body) if state is None else state
    return MarkerProblem(
        body, markers, seen(ring(), body, markers, state, **kwargs), settings(weight, gate_px=gate_px)
    )


def spread(p: MarkerProblem, n: int = 9) -> np.ndarray:
    """Particles around the true pose, some far off."""
    std = 0.1 * np.linspace(0.1, 4.0, n)[:, None] * np.ones(p.layout.n_columns)
    start = np.tile(pose(p.body), (n, 1))
    noise = np.random.default_rng(1).standard_normal(start.shape)
    return np.clip(start + std * noise, p.layout.lower, p.layout.upper)


@pytest.mark.parametrize("weight", [0.0, 0.4, 1.0])
def test_kernel_and_numpy_twin_agree(weight: float) -> None:
    p = problem(weight, **NOISY)
    states = spread(p)
    expected = marker_scores_numpy(p.body, p.markers, p.observation, p.settings, states)
    np.testing.assert_allclose(p.scores(states), expected, atol=SCORE_TOLERANCE)
    assert np.ptp(expected) > 0.3


def test_perfect_detections_at_the_true_pose_cost_nothing() -> None:
    for weight in (0.0, 0.5, 1.0):
        p = problem(weight)
        np.testing.assert_allclose(p.scores(pose(p.body)[None]), 0.0, atol=SCORE_TOLERANCE)
        np.testing.assert_allclose(p.log_likelihood(pose(p.body)[None]), 0.0, atol=SCORE_TOLERANCE)


def test_printed_cost_is_flat_inside_the_gate_and_the_reprojection_term_is_not() -> None:
    body, _ = other_body()
    moved = pose(body)
    moved[0] += (
        0.02  # some two pixels, the gate is fourteen, markers lie further apart than that in most views
    )
    printed, reprojection = problem(0.0), problem(1.0)
    best = [k for k, n in enumerate(printed.markers.names) if n in ("head", "left_knee")]
    assert printed.scores(moved[None])[0, best] == pytest.approx(0.0, abs=SCORE_TOLERANCE)
    assert np.all(reprojection.scores(moved[None])[0, best] > 0.05)


def test_score_of_one_marker_is_the_root_mean_square_over_pairs() -> None:
    """Two views, one detection each, beside the projections: the closed forms of both terms."""
    body, markers = other_body()
    one = Markers(("head",), markers.joint[:1], markers.part[:1], markers.offset[:1], markers.slack_m[:1])
    rig = ring(2, dist=np.zeros(4))
    views = marker_views(rig)
    state = neutral_state(body)
    points = marker_positions(body, one, state[None])[0]
    uv = [camera.project(points)[0] for camera in rig]
    off = [np.array([[3.0, -1.0]]), np.array([[-2.0, 4.0]])]
    observation = observe(views, [a + b for a, b in zip(uv, off, strict=True)])
    gate = 10.0
    distance = symmetric_epipolar_distance(views.F[0, 1], uv[0] + off[0], uv[1] + off[1])[0]
    for weight, expected in (
        (0.0, distance / (np.sqrt(8.0) * gate)),
        (1.0, np.sqrt((10.0 + 20.0) / 2) / gate),
    ):
        p = MarkerProblem(body, one, observation, settings(weight, gate_px=gate))
        assert p.scores(state[None])[0, 0] == pytest.approx(expected, rel=1e-5)


def test_a_marker_seen_in_one_view_or_none_costs_one() -> None:
    body, markers = other_body()
    rig = ring()
    views = marker_views(rig)
    state = pose(body)
    uv, _ = rig[0].project(marker_positions(body, markers, state[None])[0])
    nothing = [np.zeros((0, 2))] * len(rig)
    in_one = observe(views, [uv, *nothing[1:]])
    n_seen = len(rig)
    np.testing.assert_allclose(MarkerProblem(body, markers, in_one, settings(0.0)).scores(state[None]), 1.0)
    # The reprojection term: perfect in one view of five, the gate's width in the others.
    expected = np.sqrt((n_seen - 1) / n_seen)
    np.testing.assert_allclose(
        MarkerProblem(body, markers, in_one, settings(1.0)).scores(state[None]),
        expected,
        atol=SCORE_TOLERANCE,
    )
    empty = observe(views, nothing)
    for weight in (0.0, 0.5, 1.0):
        np.testing.assert_allclose(
            MarkerProblem(body, markers, empty, settings(weight)).scores(state[None]), 1.0
        )


def test_a_camera_that_looks_away_has_no_say() -> None:
    body, markers = other_body()
    state = pose(body)
    turn = np.diag([-1.0, 1.0, -1.0])
    first, *others = ring()
    rig = CameraRig((replace(first, R=turn @ first.R, t=turn @ first.t), *others))
    uv = [camera.project(marker_positions(body, markers, state[None])[0])[0] for camera in rig]
    assert np.isnan(uv[0]).all()
    p = MarkerProblem(body, markers, observe(marker_views(rig), uv), settings(1.0))
    np.testing.assert_allclose(p.scores(state[None]), 0.0, atol=SCORE_TOLERANCE)


def test_scores_lie_between_zero_and_one_whatever_the_detector_does() -> None:
    for weight in (0.0, 0.5, 1.0):
        p = problem(weight, rate=0.3, n_false=30, noise_px=6.0)
        far = spread(p, 12)
        far[0] = np.nan
        far[1, :3] = 1e6
        score = p.scores(far)
        assert np.all((score >= 0.0) & (score <= 1.0))
        np.testing.assert_array_equal(score[:2], 1.0)
        assert np.all(np.isfinite(p.log_likelihood(far)))


def test_one_false_detection_costs_a_bounded_amount() -> None:
    p = problem(0.5, **NOISY)
    state = pose(p.body)
    base = float(p.log_likelihood(state[None]).sum())
    worst = base
    views = p.observation.views
    for shift in (1.0, 5.0, 13.0, 200.0):
        uv = [p.observation.of_view(c).copy() for c in range(views.n_views)]
        uv[0][0] += shift
        changed = replace(p.observation, uv=np.concatenate(uv))
        worst = min(worst, float(replace(p, observation=changed).log_likelihood(state[None]).sum()))
    # One marker's score changes by at most 1, and with it its part's mean by at most 1.
    assert base - worst <= 0.5 / p.settings.sigma**2


def test_order_of_detections_and_cameras_is_irrelevant() -> None:
    p = problem(0.5, **NOISY)
    views, rng = p.observation.views, np.random.default_rng(0)
    # Two detections at equal distance are told apart by their order; there are none here.
    shuffled = [rng.permutation(p.observation.of_view(c)) for c in range(views.n_views)]
    again = replace(p, observation=replace(p.observation, uv=np.concatenate(shuffled)))
    states = spread(p)
    np.testing.assert_allclose(again.scores(states), p.scores(states), atol=SCORE_TOLERANCE)

    order = [3, 0, 4, 1, 2]
    turned = marker_views(CameraRig(tuple(views.rig[c] for c in order)))
    uv = [p.observation.of_view(c) for c in order]
    first = np.concatenate([[0], np.cumsum([len(u) for u in uv])]).astype(np.int64)
    other = replace(p, observation=MarkerObservation(turned, np.concatenate(uv), first))
    np.testing.assert_allclose(other.scores(states), p.scores(states), atol=SCORE_TOLERANCE)


def test_distortion_makes_no_difference() -> None:
    """The same world through other lenses: raw detections differ, scores do not."""
    body, markers = other_body()
    state = pose(body)
    points = marker_positions(body, markers, state[None])[0]
    scores = []
    for dist in (np.zeros(4), np.array([-0.2, 0.05, 0.001, -0.002])):
        rig = ring(dist=dist)
        observation = observe(marker_views(rig), [camera.project(points)[0] for camera in rig])
        p = MarkerProblem(body, markers, observation, settings(0.5))
        scores.append(p.scores(spread(p)[:4]))
    # What lies within a gate of the picture's border may be in view of one lens and not of the other; nothing does.
    np.testing.assert_allclose(scores[0], scores[1], atol=1e-4)


def test_undistorted_pixels_are_those_of_the_ideal_pinhole() -> None:
    camera = ring()[1]
    points = np.random.default_rng(0).uniform([-0.5, -0.5, 0.3], [0.5, 0.5, 1.6], (11, 3))
    x = (points @ camera.R.T + camera.t) @ camera.K.T
    np.testing.assert_allclose(undistort(camera, camera.project(points)[0]), x[:, :2] / x[:, 2:], atol=1e-6)


def test_cameras_in_one_place_make_no_pair() -> None:
    body, markers = other_body()
    rig = ring(3)
    twin = replace(rig[0], name="twin")
    doubled = CameraRig((rig[0], twin, rig[1]))
    views = marker_views(doubled)
    assert not views.is_pair[0, 1]
    assert views.is_pair[0, 2]
    points = marker_positions(body, markers, pose(body)[None])[0]
    p = MarkerProblem(body, markers, observe(views, [c.project(points)[0] for c in doubled]), settings(0.0))
    score = p.scores(pose(body)[None])
    assert np.all(np.isfinite(score))
    np.testing.assert_allclose(score, 0.0, atol=SCORE_TOLERANCE)


def test_parts_are_columns_of_the_whole() -> None:
    p = problem(0.5, **NOISY)
    states = spread(p)
    whole = p.log_likelihood(states)
    assert whole.shape == (len(states), p.layout.n_parts)
    chosen = [4, 0, 7]
    np.testing.assert_allclose(p.log_likelihood(states, parts=chosen, given=(1, 2)), whole[:, chosen])
    pooled = replace(p, settings=settings(0.5, factorised=False)).log_likelihood(states)
    assert pooled.shape == (len(states), 1)
    np.testing.assert_allclose(pooled[:, 0], -0.5 * p.scores(states).mean(axis=1) ** 2)


def test_a_part_without_markers_says_nothing() -> None:
    p = problem(1.0, **NOISY)
    head = p.layout.parts.index("head")
    keep = p.markers.part != head
    m = p.markers
    bare = Markers(
        tuple(n for n, k in zip(m.names, keep, strict=True) if k),
        m.joint[keep],
        m.part[keep],
        m.offset[keep],
        m.slack_m[keep],
    )
    value = replace(p, markers=bare).log_likelihood(spread(p))
    np.testing.assert_array_equal(value[:, head], 0.0)
    np.testing.assert_array_equal(replace(p, markers=bare).log_likelihood(spread(p), parts=[head]), 0.0)


def test_wrong_input_is_named() -> None:
    p = problem(1.0)
    with pytest.raises(ValueError, match="states has shape"):
        p.scores(np.zeros((2, 5)))
    with pytest.raises(ValueError, match="detections of 2 cameras, the rig has 5"):
        observe(p.observation.views, [np.zeros((0, 2))] * 2)
    with pytest.raises(ValueError, match=r"cam_0: detections have shape \(3,\)"):
        observe(p.observation.views, [np.zeros(3), *[np.zeros((0, 2))] * 4])
    with pytest.raises(ValueError, match="gate_px"):
        MarkerLikelihoodSettings(gate_px=0.0)
    with pytest.raises(ValueError, match="reprojection_weight"):
        MarkerLikelihoodSettings(reprojection_weight=1.5)


# --- the residual form --------------------------------------------------------------------------------------


def fit(slack_m: float = 0.0, **kwargs: float) -> tuple[MarkerFitProblem, np.ndarray]:
    body, markers = other_body()
    markers = replace(markers, slack_m=np.full(len(markers), slack_m))
    state = pose(body)
    observation = seen(ring(), body, markers, state, **kwargs)
    return MarkerFitProblem(body, markers, observation, MarkerFitSettings(noise_px=1.0)), state


def moved(p: MarkerFitProblem, state: np.ndarray, by: float) -> np.ndarray:
    noise = by * np.random.default_rng(2).standard_normal(state.shape)
    return np.clip(state + noise, p.layout.lower, p.layout.upper)


@pytest.mark.parametrize("slack_m", [0.0, 0.004])
def test_gradient_is_that_of_the_cost(slack_m: float) -> None:
    p, state = fit(slack_m, **NOISY)
    at = moved(p, state, 0.01)
    p = p.matched_at(at)
    _, H, g = p.normal_equations(at)
    numeric = np.array(
        [
            (p.normal_equations(at + STEP * e)[0] - p.normal_equations(at - STEP * e)[0]) / (2 * STEP)
            for e in np.eye(len(at))
        ]
    )
    # With slack the most likely slip is found by a few rounds of reweighting, not to the last digit.
    tolerance = 1e-5 if slack_m == 0.0 else 0.05
    np.testing.assert_allclose(g, numeric, atol=tolerance * np.abs(numeric).max())
    np.testing.assert_allclose(H, H.T, atol=1e-9 * np.abs(H).max())
    assert np.linalg.eigvalsh(H)[0] > -1e-9 * np.abs(H).max()


def test_true_pose_is_the_minimum_on_perfect_detections() -> None:
    p, state = fit()
    cost, _, g = p.normal_equations(state)
    assert cost == pytest.approx(0.0, abs=1e-8)
    assert np.abs(g).max() < 1e-3
    for by in (0.002, 0.01, 0.03):
        assert p.normal_equations(moved(p, state, by))[0] > cost


def test_cost_is_bounded_by_that_of_seeing_nothing() -> None:
    p, state = fit(0.01, **NOISY)
    limit = 0.5 * p.settings.scale**2 * len(p.markers) * p.observation.views.n_views
    for by in (0.0, 0.05, 0.5):
        assert 0.0 <= p.matched_at(state).normal_equations(moved(p, state, by))[0] <= limit + 1e-9


def test_agreement_finds_true_detections_among_false_ones() -> None:
    """Five centimetres off and amid clutter, the closest detections are mostly false, those that agree mostly true."""
    body, markers = other_body()
    rig = ring()
    state = pose(body)
    points = marker_positions(body, markers, state[None])[0]
    truth = [camera.project(points)[0] for camera in rig]
    rng = np.random.default_rng(4)
    found = [
        np.concatenate([uv, rng.uniform(uv.min(axis=0), uv.max(axis=0), (25, 2))]) for uv in truth
    ]  # markers come first: detection k of a view is marker k
    p = MarkerFitProblem(
        body, markers, observe(marker_views(rig), found), MarkerFitSettings(noise_px=1.0, reach_m=0.15)
    )
    off = state.copy()
    off[:2] += [0.04, -0.03]
    matched = p.matched_at(off)
    assert matched.matches is not None
    chosen = matched.matches.chosen
    own = p.observation.first[:-1][None] + np.arange(len(markers))[:, None]
    right = (chosen == own).sum() / (chosen >= 0).sum()
    assert right > 0.8
    # No detection serves two markers.
    taken = chosen[chosen >= 0]
    assert len(taken) == len(set(taken.tolist()))


def test_no_detections_leave_the_pose_alone() -> None:
    p, state = fit()
    empty = observe(p.observation.views, [np.zeros((0, 2))] * p.observation.views.n_views)
    blind = replace(p, observation=empty)
    for q in (blind, blind.matched_at(state)):
        cost, H, g = q.normal_equations(state)
        assert cost > 0
        assert not H.any()
        assert not g.any()
