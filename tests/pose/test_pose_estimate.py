"""Smoothing of poses, their uncertainty, and the point estimates: closed forms and one-sided bounds."""

from dataclasses import fields, replace

import numpy as np
import pytest
from flesh_voxels import make_flesh
from marker_world import marching

from mocap.body import landmarks_of, load_body_model, scale_body
from mocap.body.average import mean_state
from mocap.data import LANDMARKS
from mocap.filters import ParticleState, initial_particles
from mocap.filters.apf import apf_step
from mocap.filters.scout import limbs_of
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose.deviation import (
    FrameSeries,
    fit_covariance,
    fit_information,
    landmark_covariances,
    landmark_kind,
    limb_misfit,
    widened,
)
from mocap.pose.follow import FramePose, note, point_estimate, unbroken
from mocap.pose.method import UNCERTAINTY, DeviationSettings, Method
from mocap.pose.smooth import smooth_motion

BODY = scale_body(load_body_model("anthropometric"), 1.77)
LAYOUT = BODY.layout
FPS = 30.0
T = 22


def series_of(states: np.ndarray, **changes: np.ndarray) -> FrameSeries:
    series = FrameSeries.of_length(len(states), BODY)
    return replace(series, **({"states": states, "misfit": np.ones_like(series.misfit)} | changes))


def trembling(scale: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A marching body, and the same with errors in every column."""
    truth = marching(BODY, T, FPS)
    noise = np.random.default_rng(seed).standard_normal(truth.shape)
    noise *= scale * np.where(np.arange(truth.shape[1]) < 3, 0.2, 1.0)
    return truth, np.clip(truth + noise, LAYOUT.lower, LAYOUT.upper)


def error_m(states: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.linalg.norm(landmarks_of(BODY, states) - landmarks_of(BODY, truth), axis=2)


def second_differences(states: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(landmarks_of(BODY, states), 2, axis=0), axis=2).mean())


def test_smoothing_takes_the_trembling_and_not_the_motion() -> None:
    truth, shaky = trembling(0.04)
    smooth = smooth_motion(BODY, series_of(shaky), FPS, 8, Method())
    assert error_m(smooth, truth).mean() < 0.8 * error_m(shaky, truth).mean()
    assert second_differences(smooth) < 0.4 * second_differences(shaky)
    assert np.all(smooth >= LAYOUT.lower)
    assert np.all(smooth <= LAYOUT.upper)


def test_a_motion_without_trembling_stays() -> None:
    truth, _ = trembling(0.0)
    assert error_m(smooth_motion(BODY, series_of(truth), FPS, 8, Method()), truth).max() < 0.004


def test_an_arm_that_is_lost_for_two_frames_comes_back() -> None:
    truth, shaky = trembling(0.01)
    arm = [LAYOUT.names.index(n) for n in ("left_shoulder_x", "left_shoulder_z", "left_elbow_z")]
    lost = (9, 10)
    for i in lost:
        shaky[i, arm] = LAYOUT.lower[arm]
    misfit = np.ones((T, LAYOUT.n_parts))
    limb = next(p for p in limbs_of(LAYOUT) if LAYOUT.parts[p[0]] == "left_upper_arm")
    misfit[np.ix_(lost, limb)] = 8.0
    wrist = LANDMARKS.index("left_wrist")
    before = error_m(shaky, truth)[list(lost), wrist].min()
    assert before > 0.2
    smooth = smooth_motion(BODY, series_of(shaky, misfit=misfit), FPS, 8, Method())
    assert error_m(smooth, truth)[list(lost), wrist].max() < 0.25 * before
    assert error_m(smooth, truth)[:, LANDMARKS.index("right_wrist")].max() < 0.03


def test_a_pose_that_was_carried_on_is_bridged() -> None:
    truth, _ = trembling(0.0)
    held, blind = truth.copy(), np.zeros(T)
    for k, i in enumerate(range(8, 13)):
        held[i], blind[i] = truth[7], 0.02 + 0.03 * (k + 1)
    smooth = smooth_motion(BODY, series_of(held, blind_std=blind), FPS, 10, Method())
    gap = slice(8, 13)
    assert error_m(smooth, truth)[gap].mean() < 0.5 * error_m(held, truth)[gap].mean()


def test_frames_in_which_nobody_was_tracked_are_not_bridged() -> None:
    truth = marching(BODY, T, FPS)
    truth[:, 0] += 1.2 / FPS * np.arange(T)
    truth[11:, 0] += 1.2  # a second later
    frames = np.array([*range(11), *range(41, 41 + T - 11)])
    assert unbroken(frames) == [slice(0, 11), slice(11, T)]
    assert unbroken(frames[:11]) == [slice(0, 11)]
    series = series_of(truth)
    pieces = [smooth_motion(BODY, series.rows(p), FPS, 8, Method()) for p in unbroken(frames)]
    assert error_m(np.concatenate(pieces), truth).max() < 0.01
    assert error_m(smooth_motion(BODY, series, FPS, 8, Method()), truth).max() > 0.1


def test_uncertainty_is_the_fits_and_the_bodys_and_the_limbs() -> None:
    """Closed form where the fit knows the root's place alone, to 1 mm: floor, growth and blind frames add up."""
    states = marching(BODY, 3, FPS)
    misfit = np.zeros((3, LAYOUT.n_parts))
    limb = next(p for p in limbs_of(LAYOUT) if LAYOUT.parts[p[0]] == "right_upper_arm")
    misfit[1, limb[1]] = 4.0
    information = 1e6 * np.eye(LAYOUT.n_columns)
    fits = np.array([fit_covariance(BODY, state, information, DeviationSettings()) for state in states])
    blind = np.array([0.0, 0.0, 0.05])
    series = series_of(states, misfit=misfit, fit_covariance=fits, blind_std=blind)
    covariance = landmark_covariances(BODY, series, DeviationSettings())
    assert np.linalg.eigvalsh(covariance).min() > 0
    variance = np.einsum("tlcc->tl", covariance) / 3
    for m, name in enumerate(LANDMARKS):
        floor, per_nat = UNCERTAINTY[landmark_kind(name)]
        for i in range(3):
            nats = 4.0 if i == 1 and name in ("right_shoulder", "right_elbow", "right_wrist") else 0.0
            own = floor**2 + (per_nat * nats) ** 2 + blind[i] ** 2
            # The fit: 1 mm in the place of the root, and 1 mrad in every angle on the way, less than 3 m in all.
            assert own + 1e-6 * (1 - 1e-3) <= variance[i, m] <= own + 1e-6 + 9e-6


def test_a_hull_that_holds_more_than_the_body_makes_unsure() -> None:
    states = marching(BODY, 4, FPS)
    shares = np.array([0.0, DeviationSettings.usual_unexplained, 0.5, 0.8])
    covariance = landmark_covariances(BODY, series_of(states, unexplained=shares), DeviationSettings())
    variance = np.einsum("tlcc->tl", covariance) / 3
    np.testing.assert_array_equal(variance[0], variance[1])
    assert np.sqrt(variance[2] - variance[0]).min() > 0.1
    assert np.sqrt(variance[3] - variance[0]).min() > np.sqrt(variance[2] - variance[0]).max()


def test_a_frame_that_is_explained_much_worse_than_the_others_makes_unsure() -> None:
    """Twenty nats: a body whose trunk is rigid, and somebody who bends his back."""
    states = marching(BODY, 8, FPS)
    numbers = DeviationSettings()
    fallen = np.array([0.0, 1.0, -2.0, numbers.usual_fall_nats, 20.0, -1.0, 0.0, np.nan])
    of_equal, of_fallen = (
        landmark_covariances(BODY, replace(series_of(states), log_likelihood=-15.0 - nats), numbers)
        for nats in (np.zeros(8), fallen)
    )
    variance = np.einsum("tlcc->tl", of_fallen - of_equal) / 3
    np.testing.assert_array_equal(variance[[0, 1, 2, 3, 5, 6, 7]], 0.0)
    beyond = 20.0 - numbers.usual_fall_nats
    np.testing.assert_allclose(variance[4], (numbers.per_fallen_nat * beyond) ** 2)


def test_limbs_that_are_settled_on_a_texture_are_surer_by_a_share() -> None:
    """An arm in one of two frames; nothing else of that frame, and nothing of the other, has changed. The trunk is
    settled too, and no surer: where joints lie in it no texture tells."""
    states = marching(BODY, 2, FPS)
    settled = np.zeros((2, LAYOUT.n_parts), dtype=np.bool_)
    arm = LAYOUT.parts.index("left_forearm")
    settled[1, [0, arm]] = True
    fits = np.tile(np.diag([1e-4, 4e-4, 9e-4]), (2, len(LANDMARKS), 1, 1))
    numbers = DeviationSettings(settled=0.5)
    plain = landmark_covariances(BODY, series_of(states, fit_covariance=fits), numbers)
    surer = landmark_covariances(BODY, series_of(states, fit_covariance=fits, settled=settled), numbers)
    share = np.sqrt(surer / np.where(plain > 0, plain, 1.0))[..., [0, 1, 2], [0, 1, 2]]
    on_arm = BODY.landmark_parts == arm
    assert [n for n, own in zip(LANDMARKS, on_arm, strict=True) if own] == ["left_elbow", "left_wrist"]
    np.testing.assert_allclose(share[1, on_arm], 0.5)
    np.testing.assert_array_equal(share[1, ~on_arm], 1.0)
    np.testing.assert_array_equal(share[0], 1.0)
    assert 0 < DeviationSettings.settled < 1


@pytest.mark.parametrize("refine", [True, False])
def test_without_refinement_the_particles_spread_counts(refine: bool) -> None:
    pose_settings = PoseConfig(n_layers=3, n_particles=80, refine=refine)
    flesh = make_flesh("anthropometric", 1.74, 0.06)
    body, D = flesh.body, flesh.body.layout.n_columns
    tools = make_tools(flesh.grid, FPS, 1.74, "anthropometric", pose_settings, LikelihoodConfig(), 1)
    state, nowhere = marching(body, 1, FPS)[0], np.zeros(len(LANDMARKS))
    spread = np.tile(np.diag([1e-4, 4e-4, 9e-4]), (len(LANDMARKS), 1, 1))
    pose = FramePose(
        row=0, state=state, landmarks=landmarks_of(body, state[None])[0], information=1e6 * np.eye(D), spread=spread,
        misfit=np.ones(body.layout.n_parts), unexplained=0.3, blind_std=0.1, hidden_std=nowhere + 0.2,
        observed=nowhere > 0, log_likelihood=-1.0, evidence=-2.0, ess_share=0.5, doubtful=nowhere == 0,
    )  # fmt: skip
    series = FrameSeries.of_length(2, tools.body)
    note(series, 1, pose, tools)
    fitted = fit_covariance(tools.body, state, pose.information, DeviationSettings())
    np.testing.assert_array_equal(series.fit_covariance[1], fitted if refine else spread)
    for column in (
        "state",
        "misfit",
        "unexplained",
        "blind_std",
        "hidden_std",
        "observed",
        "doubtful",
        "ess_share",
    ):
        kept = series.states if column == "state" else getattr(series, column)
        np.testing.assert_array_equal(kept[1], getattr(pose, column))
        assert not np.any(kept[0])
    wider = landmark_covariances(BODY, series, DeviationSettings())
    without = landmark_covariances(
        BODY, replace(series, fit_covariance=0 * series.fit_covariance), DeviationSettings()
    )
    np.testing.assert_allclose(wider - without, series.fit_covariance, atol=1e-15)


def test_without_a_fit_there_is_none_of_its_own() -> None:
    states = marching(BODY, 1, FPS)
    nothing = np.zeros((LAYOUT.n_columns,) * 2)
    np.testing.assert_array_equal(fit_covariance(BODY, states[0], nothing, DeviationSettings()), 0.0)


def test_what_is_kept_of_an_hour_is_small() -> None:
    """An hour of one person at 30 frames/s is less than 400 MB."""
    series = FrameSeries.of_length(100, BODY)
    n_bytes = sum(getattr(series, field.name).nbytes for field in fields(series))
    assert n_bytes / 100 * 30 * 3600 < 400e6


def test_the_worse_the_fit_the_less_it_knows() -> None:
    H = np.diag(np.arange(1.0, 6.0))
    good, bad = fit_information(0.01, H, 100, 2.5), fit_information(0.04, H, 100, 2.5)
    np.testing.assert_allclose(good, 4 * bad)
    np.testing.assert_allclose(fit_information(0.02, 2 * H, 200, 2.5), 2 * good)
    np.testing.assert_array_equal(fit_information(0.0, H, 100, 2.5), 0 * H)


def test_the_misfit_of_a_limb_is_its_worst_parts() -> None:
    misfit = np.arange(LAYOUT.n_parts, dtype=np.float64)[None] / 2
    limbs = limb_misfit(LAYOUT, misfit, DeviationSettings.most_misfit_nats)[0]
    for limb in limbs_of(LAYOUT):
        np.testing.assert_array_equal(limbs[limb], misfit[0, limb].max())
    assert limbs[0] == misfit[0, 0]
    assert limb_misfit(LAYOUT, 1e6 * misfit, DeviationSettings.most_misfit_nats).max() < 100
    parts = BODY.landmark_parts
    assert LAYOUT.parts[parts[LANDMARKS.index("left_wrist")]] == "left_forearm"
    assert LAYOUT.parts[parts[LANDMARKS.index("pelvis")]] == "torso"


@pytest.mark.parametrize("kind", ["mean", "rotation_mean", "map"])
def test_point_estimates_of_a_filters_particles(kind: str) -> None:
    flesh = make_flesh("anthropometric", 1.74, 0.06)
    truth = marching(flesh.body, 1, FPS)[0]
    pose = PoseConfig(n_layers=3, n_particles=80, estimate=kind)  # type: ignore[arg-type]
    tools = make_tools(flesh.grid, FPS, 1.74, "anthropometric", pose, LikelihoodConfig(), 1)
    problem = tools.frame(flesh.hull(truth)).voxels
    settings = tools.filter_settings()
    start = initial_particles(problem, truth, 80)
    particles, info = apf_step(problem, start, settings, rng=np.random.default_rng(1))
    found = point_estimate(flesh.body, particles, info, kind)
    if kind == "map":
        assert problem.log_likelihood(found[None]).sum() == pytest.approx(info.best_log_likelihood)
    elif kind == "mean":
        np.testing.assert_array_equal(found, info.estimate)
    else:
        expected = mean_state(flesh.body, particles.particles, particles.weights, info.estimate)
        np.testing.assert_array_equal(found, expected)
        one = ParticleState(particles.particles[:1], np.ones(1))
        np.testing.assert_allclose(
            mean_state(flesh.body, one.particles, one.weights, one.particles[0]), one.particles[0], atol=1e-9
        )
    assert np.linalg.norm(landmarks_of(flesh.body, found[None]) - landmarks_of(flesh.body, truth[None])) < 1.0


def test_a_rig_that_disagrees_widens_every_region() -> None:
    settings = DeviationSettings()
    covariance = np.broadcast_to(np.diag([1e-4, 4e-4, 9e-4]), (2, 15, 3, 3))
    np.testing.assert_array_equal(widened(covariance, 0.0, settings), covariance)
    wider = widened(covariance, 0.03, settings)
    extra = (settings.per_rig_offset * 0.03) ** 2
    np.testing.assert_allclose(wider - covariance, np.broadcast_to(extra * np.eye(3), wider.shape))
