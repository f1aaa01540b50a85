"""Cameras put right by tangents of silhouettes: points on a body that walks, filmed by cameras that stand elsewhere."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from eval.bench.scene import ring
from eval.refine_rig import disturbed, pair_angles_deg, place_errors
from mocap.data import CameraRig
from mocap.volume.rig_refinement import RefinementSettings, refine_rig, scaled

Array = NDArray[np.float64]

RIG = ring(5, (640, 480))
T, FPS = 150, 30.0
NOISE_PX = 0.3
SHAPE = np.random.default_rng(4).normal(0.0, 1.0, (60, 3)) * (0.15, 0.2, 0.4)
# What refinement is for: errors of 2 degrees and 3 cm come down to these.
ANGLE_DEG, PLACE_M = 0.3, 0.01


def body_at(time_s: float, *, walks: bool = True) -> Array:
    """Points (60, 3) m of somebody who turns, and walks or not."""
    turn = 0.9 * time_s
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    if not walks:
        return SHAPE + np.array([0, 0, 0.95])
    return SHAPE @ R.T + (0.7 * np.sin(0.8 * time_s), 0.5 * np.sin(1.3 * time_s + 1), 0.95)


def film(rig: CameraRig = RIG, *, walks: bool = True) -> list[list[Array]]:
    """What every camera sees in every frame."""
    noise = np.random.default_rng(7)
    seen: list[list[Array]] = []
    for camera in rig:
        hulls = []
        for k in range(T):
            uv, _ = camera.project(body_at(k / FPS, walks=walks))
            hull = cv2.convexHull(uv.astype(np.float32)).reshape(-1, 2).astype(np.float64)
            hulls.append(hull + noise.normal(0, NOISE_PX, hull.shape))
        seen.append(hulls)
    return seen


def wrong(seed: int = 1) -> CameraRig:
    return disturbed(RIG, 2.0, 0.03, np.random.default_rng(seed))


def test_two_degrees_and_three_centimetres() -> None:
    found = refine_rig(wrong(), film())
    places, _ = place_errors(found.rig, RIG)
    assert pair_angles_deg(wrong(), RIG).mean() > 1.5
    assert pair_angles_deg(found.rig, RIG).max() < ANGLE_DEG
    assert places.max() < PLACE_M
    assert found.apart_after_m < 0.1 * found.apart_before_m


def test_the_world_stays_where_the_cameras_were_said_to_stand() -> None:
    found = refine_rig(wrong(), film())
    before, after = (np.array([c.center for c in rig]) for rig in (wrong(), found.rig))
    # A shift of 3 cm of five cameras, averaged, is what the middle of the rig may move by at most; it does not at all.
    np.testing.assert_allclose(after.mean(axis=0), before.mean(axis=0), atol=2e-3)
    sizes = [np.linalg.norm(c - c.mean(axis=0)) for c in (before, after)]
    assert sizes[1] == pytest.approx(sizes[0], rel=2e-3)


def test_a_world_that_is_turned_and_shifted_gives_the_same_cameras_in_that_world() -> None:
    turn = cv2.Rodrigues(np.array([0.0, 0.0, 0.7]))[0]
    shift = np.array([2.0, -1.0, 0.0])
    first = wrong()
    elsewhere = CameraRig(
        tuple(replace(c, R=c.R @ turn.T, t=-c.R @ turn.T @ (turn @ c.center + shift)) for c in first)
    )
    a, b = refine_rig(first, film()).rig, refine_rig(elsewhere, film()).rig
    for own, other in zip(a, b, strict=True):
        np.testing.assert_allclose(turn @ own.center + shift, other.center, atol=1e-4)
        np.testing.assert_allclose(own.R @ turn.T, other.R, atol=1e-4)


def test_stated_deviations_cover_the_error() -> None:
    errors, stated = [], []
    for seed in range(4):
        found = refine_rig(wrong(seed), film())
        errors += list(place_errors(found.rig, RIG)[0])
        stated += [np.sqrt(3) * move.shift_std_m for move in found.moves.values()]
    assert np.mean(np.array(errors) < 2.5 * np.array(stated)) > 0.9
    assert np.median(stated) < 0.01


def test_right_cameras_stay() -> None:
    found = refine_rig(RIG, film())
    assert max(move.shift_m for move in found.moves.values()) < PLACE_M
    assert found.apart_after_m == pytest.approx(found.apart_before_m, rel=0.1)


def test_who_stands_still_says_little() -> None:
    still, walking = (refine_rig(wrong(), film(walks=walks)) for walks in (False, True))
    assert max(move.share_left for move in walking.moves.values()) < 0.4
    assert max(move.share_left for move in still.moves.values()) > 0.5


def test_a_camera_that_sees_nobody_keeps_its_place() -> None:
    seen = film()
    seen[2] = [np.zeros((0, 2))] * T
    found = refine_rig(wrong(), seen)
    name = RIG.names[2]
    assert found.moves[name].n_tangents == 0
    assert found.moves[name].share_left > 0.9
    assert found.moves[name].turn_deg == pytest.approx(0.0, abs=1e-6)
    # The size of the whole rig is held, so that it grows a little where others shrink.
    assert found.moves[name].shift_m < 0.005
    others = [n for n in RIG.names if n != name]
    # Four cameras have six pairs where five have ten.
    assert pair_angles_deg(found.rig.subset(others), RIG.subset(others)).mean() < ANGLE_DEG


def test_outlines_that_the_border_cuts_are_not_compared() -> None:
    whole = refine_rig(RIG, film())
    # Everything that reaches into the lower half of a picture is cut off there.
    low = CameraRig(tuple(replace(c, size=(c.size[0], c.size[1] // 2)) for c in RIG))
    cut = refine_rig(
        low, [[np.minimum(h, (1e9, c.size[1] - 1)) for h in own] for c, own in zip(low, film(), strict=True)]
    )
    assert sum(m.n_tangents for m in cut.moves.values()) < 0.7 * sum(
        m.n_tangents for m in whole.moves.values()
    )


def test_nobody_at_all() -> None:
    found = refine_rig(RIG, [[np.zeros((0, 2))] * 3] * len(RIG))
    assert np.isnan(found.apart_after_m)
    assert len(found.points) == 0


def test_a_bias_of_the_masks_is_reflected_in_the_deviations() -> None:
    trusting, doubting = (
        refine_rig(wrong(), film(), RefinementSettings(bias_m=bias)).moves for bias in (1e-4, 0.02)
    )
    assert all(trusting[n].shift_std_m < doubting[n].shift_std_m for n in RIG.names)


def test_a_larger_rig_sees_the_same() -> None:
    larger = scaled(RIG, 1.1)
    point = np.array([0.4, -0.3, 1.2])
    below = np.array([c.center for c in RIG]).mean(axis=0) * (1, 1, 0)
    for small, large in zip(RIG, larger, strict=True):
        np.testing.assert_allclose(small.project(point)[0], large.project(below + 1.1 * (point - below))[0])


def test_other_numbers_of_cameras_or_frames() -> None:
    for seen in (film()[:-1], [own[: T - k] for k, own in enumerate(film())]):
        with pytest.raises(ValueError, match="refine_rig"):
            refine_rig(RIG, seen)
