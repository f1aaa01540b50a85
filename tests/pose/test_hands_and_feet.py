"""Hands and feet that move: what hangs bent does not turn the forearm or the shank that carries it."""

from __future__ import annotations

import numpy as np
import pytest
from flesh_voxels import Flesh, make_flesh

from mocap.body import landmarks_of, load_body_model, neutral_state, scale_body
from mocap.data import LANDMARKS
from mocap.likelihood.residuals import BodyFit, SurfaceFitSettings, SurfaceProblem, hull_surface
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose.limb_search import search_limbs
from mocap.pose.start import PoseSearch
from mocap.pose.volume import PersonHull, pack_volume
from mocap.volume import surface_voxels

HEIGHT_M, VOXEL_M = 1.75, 0.02
MOVED = [LANDMARKS.index(name) for name in ("left_wrist", "right_ankle")]
# A hand that hangs bent to the side, further than an anatomical wrist deviates, and a foot that points down.
BENT = {"left_wrist_z": 0.8, "left_wrist_x": 0.4, "right_ankle_y": 0.5}


def test_a_hand_bends_as_far_to_any_side() -> None:
    """Nothing shows how a forearm is turned: which of its two angles is flexion is open."""
    body = scale_body(load_body_model("whole"), HEIGHT_M)
    columns = [i for i, name in enumerate(body.layout.names) if "wrist" in name]
    assert len(columns) == 4
    for values in (body.layout.upper, -body.layout.lower, body.usual_std):
        np.testing.assert_array_equal(values[columns], values[columns[0]])


@pytest.fixture(scope="module")
def truth() -> tuple[Flesh, np.ndarray]:
    flesh = make_flesh("whole", HEIGHT_M, VOXEL_M)
    state = neutral_state(flesh.body)
    for name, angle in BENT.items():
        state[flesh.body.layout.names.index(name)] = angle
    return flesh, state


def errors_mm(name: str, truth: tuple[Flesh, np.ndarray]) -> np.ndarray:
    """Distances (15,) of the landmarks of a body that was moved onto the hull of the true flesh."""
    of, state = truth
    flesh = make_flesh(name, HEIGHT_M, VOXEL_M)
    hull = of.hull(state)
    surface = hull_surface(hull.voxels, hull.is_surface, of.grid, pack_volume(of.grid, hull, 1.0))
    fit = BodyFit(
        SurfaceProblem(flesh.body, flesh.table, surface, SurfaceFitSettings()),
        None,
        usual_weight=1.0 / 90_000.0,
    )
    start = neutral_state(flesh.body)
    start[:3] = state[:3]
    std = np.where(flesh.body.is_position, 0.1, 0.5)
    (found,) = fit.descended(start[None], prior_std=std, residual_std_m=1.0, n_iterations=40, tolerance=1e-6)
    both = landmarks_of(flesh.body, found[None])[0, :15], landmarks_of(of.body, state[None])[0, :15]
    return 1000.0 * np.linalg.norm(both[0] - both[1], axis=1)


def test_a_bent_hand_does_not_turn_its_forearm(truth: tuple[Flesh, np.ndarray]) -> None:
    whole, girdle = errors_mm("whole", truth), errors_mm("girdle", truth)
    assert np.all(whole[MOVED] < 0.6 * girdle[MOVED])


@pytest.mark.parametrize("refine", [True, False])
def test_searches_draw_no_feet_and_hands_where_refinements_set_them(*, refine: bool) -> None:
    """With them the start took a worse pose of somebody on a chair, where the good one was better (decision 61)."""
    flesh = make_flesh("whole", HEIGHT_M, 0.04)
    settings = PoseConfig(refine=refine)
    tools = make_tools(flesh.grid, 30.0, HEIGHT_M, "whole", settings, LikelihoodConfig(), 1)
    still = flesh.body.is_fine & refine
    search = PoseSearch(tools.frame(flesh.hull(neutral_state(flesh.body))), 0, None)
    noises = tools.filter_settings().std, search.std  # type: ignore[attr-defined]
    for noise in noises:
        np.testing.assert_array_equal(noise == 0.0, still)
    assert still.sum() == (12 if refine else 0)


def test_a_foot_that_the_hull_lacks_is_not_observed_though_its_shank_is() -> None:
    flesh = make_flesh("whole", HEIGHT_M, VOXEL_M)
    state = neutral_state(flesh.body)
    tools = make_tools(flesh.grid, 30.0, HEIGHT_M, "whole", PoseConfig(), LikelihoodConfig(), 1)
    hull = flesh.hull(state)
    centers = flesh.grid.centers(hull.voxels)
    landmarks = landmarks_of(flesh.body, state[None])[0]
    ankle = landmarks[LANDMARKS.index("left_ankle")]
    is_foot = (centers[:, 2] < ankle[2]) & (centers[:, 1] > 0.0)
    left = hull.voxels[~is_foot]
    footless = PersonHull(left, surface_voxels(left, flesh.grid))
    unseen = [
        {n for n, o in zip(flesh.body.landmarks, tools.frame(h).fit(state).observed, strict=True) if not o}
        for h in (hull, footless)
    ]
    assert unseen == [set(), {"left_heel", "left_toe"}]


def test_the_search_for_limbs_leaves_a_hand_as_it_is(truth: tuple[Flesh, np.ndarray]) -> None:
    """An arm that was turned away is found with the hand at its angles, which the refinement then sets."""
    flesh = make_flesh("whole", HEIGHT_M, 0.04)
    names = flesh.body.layout.names
    state = neutral_state(flesh.body)
    tools = make_tools(flesh.grid, 30.0, HEIGHT_M, "whole", PoseConfig(), LikelihoodConfig(), 1)
    evidence = tools.frame(flesh.hull(state))
    lost = state.copy()
    lost[names.index("right_shoulder_x")] = -1.2
    found = search_limbs(evidence, lost, max_limbs=2, rng=np.random.default_rng(0))
    before, after = evidence.evidence([lost, found])
    assert after > before + 5.0
    wrist = landmarks_of(flesh.body, np.stack([state, lost, found]))[:, LANDMARKS.index("right_wrist")]
    assert np.linalg.norm(wrist[2] - wrist[0]) < 0.2 * np.linalg.norm(wrist[1] - wrist[0])
