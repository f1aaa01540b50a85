"""Fitting body and marker offsets to frames: what the detections show is found, the rest stays at its prior."""

from __future__ import annotations

import numpy as np
import pytest
from marker_world import marching, marker_world, other_body

from mocap.body import landmarks_of, load_body_model, scale_body
from mocap.body.kinematics import point_jacobian
from mocap.body.markers import load_marker_set, marker_positions, place_markers
from mocap.likelihood.markers import BundleSettings, MarkerFitSettings, bundle_markers, marker_views, observe

STEP = 1e-6
FIT = MarkerFitSettings(noise_px=0.7, extra_slack_m=0.01, reach_m=0.15)


def test_point_jacobian_is_the_derivative() -> None:
    body, markers = other_body()
    state = marching(body, 4)[3]
    points, J, _ = point_jacobian(body, state, markers.joint, markers.offset)
    np.testing.assert_allclose(points, marker_positions(body, markers, state[None])[0], atol=1e-12)
    numeric = np.stack(
        [
            (
                marker_positions(body, markers, (state + STEP * e)[None])[0]
                - marker_positions(body, markers, (state - STEP * e)[None])[0]
            )
            / (2 * STEP)
            for e in np.eye(len(state))
        ],
        axis=-1,
    )
    np.testing.assert_allclose(J, numeric, atol=1e-8)


def test_bundle_brings_body_and_markers_closer_to_the_person() -> None:
    world = marker_world(24, rate=0.9, n_false=0, noise_px=0.4)
    body = scale_body(load_body_model("anthropometric"), 1.74)  # 6 cm too tall
    markers = place_markers(load_marker_set("markers_20"), body)
    views = marker_views(world.rig)
    rows = list(range(0, 24, 3))
    observations = [observe(views, world.detections[i]) for i in rows]
    start = world.states[rows]
    found = bundle_markers(body, markers, observations, start, FIT, BundleSettings(n_rounds=3))
    true = world.landmarks[rows]
    before = np.linalg.norm(landmarks_of(body, start) - true, axis=2).mean()
    after = np.linalg.norm(landmarks_of(found.body, found.states) - true, axis=2).mean()
    # Detections do not show where a joint lies between its markers: what is left is less than the 2 cm by which the
    # markers sit beside their places.
    assert after < min(before, 0.02)
    at = marker_positions(found.body, found.markers, found.states)
    assert np.linalg.norm(at - world.points[rows], axis=2).mean() < 0.006
    assert abs(found.body.height_m - world.body.height_m) < 0.03
    # Left and right segments stay alike.
    names = found.body.joints
    left, right = (found.body.offset[names.index(f"{s}_knee")] for s in ("left", "right"))
    np.testing.assert_allclose(left, right * [1, -1, 1], atol=1e-12)


def test_a_body_that_is_given_stays_as_it_is() -> None:
    world = marker_world(24, rate=0.9, n_false=0, noise_px=0.4)
    views = marker_views(world.rig)
    rows = [0, 9]
    markers = place_markers(load_marker_set("markers_20"), world.body)
    found = bundle_markers(
        world.body,
        markers,
        [observe(views, world.detections[i]) for i in rows],
        world.states[rows],
        FIT,
        BundleSettings(is_body_free=False, n_rounds=2),
    )
    np.testing.assert_array_equal(found.body.offset, world.body.offset)
    assert np.abs(found.markers.offset - markers.offset).max() > 0.003


def test_without_detections_everything_stays_at_its_prior() -> None:
    body, markers = other_body()
    state = marching(body, 1)
    views = marker_views(marker_world(24).rig)
    empty = observe(views, [np.zeros((0, 2))] * views.n_views)
    found = bundle_markers(body, markers, [empty], state, FIT, BundleSettings())
    np.testing.assert_allclose(found.body.offset, body.offset, atol=1e-12)
    np.testing.assert_allclose(found.markers.offset, markers.offset, atol=1e-12)
    np.testing.assert_allclose(found.states, state, atol=1e-12)


def test_frames_and_states_must_match() -> None:
    body, markers = other_body()
    with pytest.raises(ValueError, match="0 observations and 1 states"):
        bundle_markers(body, markers, [], marching(body, 1), FIT, BundleSettings())
