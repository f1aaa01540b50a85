"""Volumes and keypoints together: the sum of what both say, and nothing where keypoints are silent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flesh_voxels import Flesh
from marker_world import ring

from mocap.body import landmarks_of, neutral_state
from mocap.body.keypoints import place_keypoints
from mocap.body.markers import marker_positions
from mocap.data import LANDMARKS
from mocap.data.keypoints import KEYPOINTS
from mocap.likelihood.keypoints import KeypointViews
from mocap.likelihood.markers import marker_views
from mocap.pipeline.config import LikelihoodConfig, PoseConfig
from mocap.pipeline.pose_settings import make_tools
from mocap.pose.fused import FusedEvidence, FusedObservation
from mocap.pose.keypoint import agreeing
from mocap.pose.volume import PersonHull, VolumeObservation, VolumeTools

ARM = ("left_upper_arm", "left_forearm")
WRIST = LANDMARKS.index("left_wrist")


@pytest.fixture(scope="module")
def tools(coarse_flesh: Flesh) -> VolumeTools:
    return make_tools(coarse_flesh.grid, 25.0, 1.7, "anthropometric", PoseConfig(), LikelihoodConfig(), 1)


@pytest.fixture(scope="module")
def truth(tools: VolumeTools) -> np.ndarray:
    state = neutral_state(tools.body)
    state[2] = 1.0
    state[tools.body.layout.names.index("left_shoulder_x")] += 0.5
    return state


@pytest.fixture(scope="module")
def hull(coarse_flesh: Flesh, tools: VolumeTools, truth: np.ndarray) -> PersonHull:
    """The hull of a person whose left arm has the colour of the wall."""
    arm = tuple(tools.body.layout.parts.index(name) for name in ARM)
    return coarse_flesh.hull(truth, margin_m=0.02, without=arm)


def views_of(tools: VolumeTools, state: np.ndarray, n_cameras: int = 4) -> KeypointViews:
    """What cameras see of a state: exact keypoints."""
    P = marker_views(ring(n_cameras, (640, 496))).P
    points = marker_positions(tools.body, place_keypoints(tools.body), state[None])[0]
    uvw = np.einsum("crk,nk->cnr", P, np.column_stack([points, np.ones(len(points))]))
    uv = uvw[..., :2] / uvw[..., 2:]
    return KeypointViews(P, uv, np.full(uv.shape[:2], 3.0))


def evidence(tools: VolumeTools, hull: PersonHull, views: KeypointViews | None) -> FusedEvidence:
    observation = FusedObservation(tools, lambda frame: hull, views_of=lambda frame: views)
    prepared = observation.prepare(0)
    assert prepared is not None
    found = observation.evidence(prepared)
    assert isinstance(found, FusedEvidence)
    return found


def moved_arm(tools: VolumeTools, truth: np.ndarray) -> np.ndarray:
    state = truth.copy()
    state[tools.body.layout.names.index("left_shoulder_x")] -= 0.4
    return state


def test_without_keypoints_it_is_the_volume(tools: VolumeTools, truth: np.ndarray, hull: PersonHull) -> None:
    alone = VolumeObservation(tools, lambda frame: hull)
    prepared = alone.prepare(0)
    assert prepared is not None
    volume, fused = alone.evidence(prepared), evidence(tools, hull, None)
    states = [truth, moved_arm(tools, truth)]
    np.testing.assert_array_equal(fused.evidence(states), volume.evidence(states))
    np.testing.assert_array_equal(fused.all_refined(states), volume.all_refined(states))
    np.testing.assert_array_equal(
        fused.search.log_likelihood(np.stack(states)), volume.search.log_likelihood(np.stack(states))
    )
    np.testing.assert_array_equal(fused.fit(truth).information, volume.fit(truth).information)


def test_keypoints_find_an_arm_that_the_volume_lacks(
    tools: VolumeTools, truth: np.ndarray, hull: PersonHull
) -> None:
    start = moved_arm(tools, truth)

    def wrist_error_m(views: KeypointViews | None) -> float:
        found = evidence(tools, hull, views).all_refined([start])[0]
        gap = landmarks_of(tools.body, np.stack([found, truth]))
        return float(np.linalg.norm(gap[0, WRIST] - gap[1, WRIST]))

    assert wrist_error_m(views_of(tools, truth)) < 0.5 * wrist_error_m(None)


def test_evidence_is_the_sum_of_both(tools: VolumeTools, truth: np.ndarray, hull: PersonHull) -> None:
    fused, alone = evidence(tools, hull, views_of(tools, truth)), evidence(tools, hull, None)
    assert fused.keypoints is not None
    states = np.stack([truth, moved_arm(tools, truth)])
    np.testing.assert_allclose(
        fused.evidence(states), alone.evidence(states) + fused.keypoints.evidence(states), rtol=1e-12
    )
    mirrored = truth.copy()
    assert tools.body.yaw_column is not None
    mirrored[tools.body.yaw_column] += np.pi
    gain = fused.evidence([truth])[0] - fused.evidence([mirrored])[0]
    assert gain > alone.evidence([truth])[0] - alone.evidence([mirrored])[0] + 5.0, (
        "left and right have names"
    )


def test_another_body_takes_its_keypoints_along(
    tools: VolumeTools, truth: np.ndarray, hull: PersonHull
) -> None:
    larger = tools.resized(1.1)
    fused = evidence(tools, hull, views_of(tools, truth)).with_tools(larger)
    assert isinstance(fused, FusedEvidence)
    assert fused.keypoints is not None
    assert fused.keypoints.body is larger.body
    assert fused.coarse.evidence([truth]) != evidence(tools, hull, None).coarse.evidence([truth])


def test_views_that_disagree_with_the_others_have_no_say(tools: VolumeTools, truth: np.ndarray) -> None:
    views, numbers = views_of(tools, truth), tools.settings.method.keypoints
    wrist, knee = KEYPOINTS.index("left_wrist"), KEYPOINTS.index("left_knee")
    uv = views.uv.copy()
    uv[2, wrist] += 80.0
    uv[[0, 3], knee] = np.nan
    uv[1, knee] += [0.0, 90.0]  # two views are left, and they do not agree: nobody knows which is wrong
    kept = agreeing(replace(views, uv=uv), numbers).has_say
    expected = np.isfinite(uv).all(axis=2)
    expected[2, wrist] = False
    np.testing.assert_array_equal(kept, expected)


@pytest.mark.parametrize(("n_cameras", "factor"), [(2, 1.0), (4, 2.0), (7, 3.0)])
def test_keypoints_weigh_more_beside_the_loose_volumes_of_few_cameras(
    tools: VolumeTools, truth: np.ndarray, hull: PersonHull, n_cameras: int, factor: float
) -> None:
    views = views_of(tools, truth, n_cameras)
    keypoints = evidence(tools, hull, views).keypoints
    assert keypoints is not None
    np.testing.assert_allclose(keypoints.views.noise_px, factor * views.noise_px)
