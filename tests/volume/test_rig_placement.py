"""Cameras placed from nothing by somebody who walks: an upright body of known height, filmed by cameras in a ring."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from eval.bench.scene import ring
from eval.refine_rig import pair_angles_deg, place_errors
from mocap.data import Camera, CameraRig
from mocap.volume.rig_placement import Placement, place_rig

Array = NDArray[np.float64]
Way = Callable[[float], tuple[float, float]]

RIG = ring(5, (640, 480))
T, FPS = 120, 25.0
HEIGHT_M = 1.8
NOISE_PX = 0.3
_RNG = np.random.default_rng(8)
_TRUNK = _RNG.normal(0, 1, (200, 3))
_TRUNK = _TRUNK / np.linalg.norm(_TRUNK, axis=1, keepdims=True) * (0.16, 0.24, 0.5) + (0, 0, 1.1)
_HEAD = _RNG.normal(0, 1, (100, 3))
_HEAD = _HEAD / np.linalg.norm(_HEAD, axis=1, keepdims=True) * (0.09, 0.08, 0.13) + (0, 0, HEIGHT_M - 0.13)


def eight(time_s: float) -> tuple[float, float]:
    return 1.0 * np.sin(1.1 * time_s), 0.8 * np.sin(2.2 * time_s + 0.4)


def spot(_: float) -> tuple[float, float]:
    return 0.0, 0.0


def walker(time_s: float, way: Way) -> Array:
    """Points (N, 3) m of somebody with a trunk, a head and two feet in turn, who looks where he goes."""
    x, y = way(time_s)
    u, v = way(time_s + 0.1)
    turn = np.arctan2(v - y, u - x)
    step = 0.2 * np.sin(2 * np.pi * time_s)
    feet = [
        (sign * step + toe, side, up)
        for sign, side in ((1, 0.1), (-1, -0.1))
        for toe in (-0.08, 0.1)
        for up in (0.0, 0.08)
    ]
    R = Rotation.from_rotvec([0, 0, turn]).as_matrix()
    # With both feet on the floor he is less tall than with one.
    bob = 1 - 0.02 * np.sin(2 * np.pi * time_s) ** 2
    upper = np.concatenate([_TRUNK, _HEAD]) * (1, 1, bob)
    return np.concatenate([upper, np.array(feet)]) @ R.T + (x, y, 0)


def film(rig: CameraRig, way: Way = eight) -> list[list[Array]]:
    """What every camera sees in every frame."""
    noise = np.random.default_rng(7)
    seen: list[list[Array]] = []
    for camera in rig:
        hulls = []
        for k in range(T):
            uv, _ = camera.project(walker(k / FPS, way))
            hull = cv2.convexHull(uv.astype(np.float32)).reshape(-1, 2).astype(np.float64)
            hulls.append(hull + noise.normal(0, NOISE_PX, hull.shape))
        seen.append(hulls)
    return seen


def lost(rig: CameraRig) -> CameraRig:
    """The lenses of a rig, and places that mean nothing."""
    return CameraRig(tuple(replace(camera, R=np.eye(3), t=np.zeros(3)) for camera in rig))


def placed(rig: CameraRig, **given: float) -> Placement:
    found = place_rig(lost(rig), film(rig), given.get("height_m", HEIGHT_M))
    assert found is not None
    return found


def check_right(found: Placement, truth: CameraRig) -> None:
    """Angles, places, scale, upright and on the floor."""
    rig = found.refinement.rig
    places, scale = place_errors(rig, truth)
    assert pair_angles_deg(rig, truth).max() < 0.5
    assert places.max() < 0.03
    assert abs(scale) < 0.025
    for own, true in zip(rig, truth, strict=True):
        assert np.degrees(np.arccos(own.R[:, 2] @ true.R[:, 2])) < 1.0
        assert own.center[2] == pytest.approx(true.center[2], abs=0.06)


@pytest.fixture(scope="module")
def ringed() -> Placement:
    return placed(RIG)


def test_cameras_stand_where_they_stand(ringed: Placement) -> None:
    check_right(ringed, RIG)
    assert ringed.n_agree == ringed.n_begun == len(RIG)
    assert ringed.walked_m > 0.7


def test_the_world_is_the_walkers(ringed: Placement) -> None:
    first = ringed.refinement.rig[0]
    assert first.center[0] == pytest.approx(0.0, abs=0.01)
    assert first.center[1] < 0
    way = np.median(ringed.refinement.points[:, :2], axis=0)
    np.testing.assert_allclose(way, 0.0, atol=0.15)


def test_the_height_sets_the_scale(ringed: Placement) -> None:
    twice = placed(RIG, height_m=2 * HEIGHT_M)
    a, b = (np.array([c.center for c in p.refinement.rig]) for p in (ringed, twice))
    sizes = [np.linalg.norm(centers - centers.mean(axis=0)) for centers in (a, b)]
    assert sizes[1] / sizes[0] == pytest.approx(2.0, rel=0.02)
    np.testing.assert_allclose(b[:, 2], 2 * a[:, 2], atol=0.05)


def test_a_camera_on_its_side() -> None:
    roll = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()
    own = RIG[1]
    side = Camera(own.name, (480, 640), own.K[[1, 0, 2]][:, [1, 0, 2]], own.dist, roll @ own.R, roll @ own.t)
    rig = CameraRig((RIG[0], side, *RIG.cameras[2:]))
    check_right(placed(rig), rig)


def test_who_stands_still_places_nothing() -> None:
    found = place_rig(lost(RIG), film(RIG, spot), HEIGHT_M)
    assert found is None or found.walked_m < 0.3


def test_a_camera_that_sees_nobody_is_no_start_and_no_end() -> None:
    seen = film(RIG)
    seen[2] = [np.zeros((0, 2))] * T
    assert place_rig(lost(RIG), seen, HEIGHT_M) is None


def test_hulls_that_do_not_belong_to_the_rig() -> None:
    seen = film(RIG)
    with pytest.raises(ValueError, match="4 cameras"):
        place_rig(lost(RIG), seen[:4], HEIGHT_M)
    with pytest.raises(ValueError, match="expected"):
        place_rig(lost(RIG), [*seen[:4], seen[4][:-1]], HEIGHT_M)
