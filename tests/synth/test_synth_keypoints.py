"""Simulated keypoints: their statistics are those that were asked for, and a session has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap.data import LANDMARKS, Camera, Motion
from mocap.data.keypoints import KEYPOINTS
from mocap.synth.keypoints import ERRORS, KINDS, KeypointConfig, simulated_keypoints, trunk_frame
from mocap.synth.scene import scene_from_dict

R = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])  # from x = 4, along -x
CAMERA = Camera(
    "c",
    (640, 480),
    np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]]),
    np.zeros(4),
    R,
    -R @ [4.0, 0, 1.0],
)
T = 4000


def standing() -> Motion:
    """Somebody who looks along x, as many frames as statistics need."""
    places = {"pelvis": (0, 0, 1.0), "neck": (0, 0, 1.5), "head": (0, 0, 1.75)}
    for side, y in (("left", 1), ("right", -1)):
        for kind, (out, up) in {
            "shoulder": (0.18, 1.42),
            "elbow": (0.22, 1.15),
            "wrist": (0.24, 0.9),
        }.items():
            places[f"{side}_{kind}"] = (0, y * out, up)
        for kind, up in {"hip": 0.95, "knee": 0.5, "ankle": 0.1}.items():
            places[f"{side}_{kind}"] = (0, y * 0.1, up)
    landmarks = np.tile(np.array([places[n] for n in LANDMARKS]), (T, 1, 1))
    return Motion(1, np.arange(T), np.arange(T) / 30, landmarks)


def found(**more: float) -> np.ndarray:
    config = KeypointConfig.model_validate(more)
    return simulated_keypoints(standing(), CAMERA, config, rng=np.random.default_rng(6))


def errors_m(points: np.ndarray, kind: str) -> np.ndarray:
    """Errors (2, T, 2) m of both sides, with what is right mirrored."""
    out = []
    for side, mirror in (("left", 1.0), ("right", -1.0)):
        true = CAMERA.project(standing().landmarks[:, LANDMARKS.index(f"{side}_{kind}")])[0]
        error = (points[:, KEYPOINTS.index(f"{side}_{kind}"), :2] - true) * 4.0 / 500.0
        out.append(error * [mirror, 1.0])
    return np.array(out)


def test_the_trunk_looks_forward() -> None:
    np.testing.assert_allclose(trunk_frame(standing().landmarks[0]), np.eye(3), atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_errors_are_those_of_the_kind(kind: str) -> None:
    own = errors_m(found(missed=0, exchanged=0), kind)
    bias = np.median(own.reshape(-1, 2), axis=0)
    # The camera looks at the person's front: its u is the person's left, its v is down. Of 8000 numbers that hang
    # together over some ten frames the median is known to 1 mm.
    np.testing.assert_allclose(bias, [ERRORS[kind].bias_m[1], -ERRORS[kind].bias_m[2]], atol=0.005)
    left = own - bias
    far = np.abs(left).max(axis=2) > 4.5 * ERRORS[kind].std_m
    std = 1.4826 * np.median(np.abs(left))
    assert std == pytest.approx(ERRORS[kind].std_m, rel=0.3)  # far points widen it by up to a fifth
    assert 0.3 * ERRORS[kind].far_share < far.mean() < 1.4 * ERRORS[kind].far_share
    calm = ~(far[:, 1:] | far[:, :-1])
    pairs = left[:, :-1][calm], left[:, 1:][calm]
    assert (pairs[0] * pairs[1]).mean() / (pairs[0] ** 2).mean() == pytest.approx(
        ERRORS[kind].correlation, abs=0.12
    )


def test_points_are_missed_and_sides_exchanged_as_often_as_asked_for() -> None:
    points = found(missed=0.1, exchanged=0.2, error_scale=0)
    own = points[:, [KEYPOINTS.index(f"left_{k}") for k in KINDS], :2]
    assert np.isnan(own[..., 0]).mean() == pytest.approx(0.1, abs=0.01)
    true = CAMERA.project(standing().landmarks[:, LANDMARKS.index("left_shoulder")])[0]
    wrong = np.abs(own[:, 0] - true).max(axis=1) > 10
    assert wrong.mean() == pytest.approx(0.2 * 0.9, abs=0.03)
    names = {f"{s}_{k}" for s in ("left", "right") for k in KINDS}
    assert {n for k, n in enumerate(KEYPOINTS) if np.isfinite(points[:, k]).any()} == names


def test_a_session_has_them(tmp_path: Path) -> None:
    pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")
    from mocap.io.session import open_session
    from mocap.io.session.reading import keypoints_of
    from mocap.synth import synthesise

    scene = scene_from_dict(
        {
            "name": "s",
            "seed": 21,
            "n_frames": 3,
            "masks_only": True,
            "truth_voxels": False,
            "rig": {"n_cameras": 3, "size_px": [160, 120]},
            "keypoints": {},
            "persons": [
                {"seed": 5, "motion": {"kind": "stand"}},
                {"seed": 6, "motion": {"kind": "stand", "position_m": [0.8, 0.6]}},
            ],
        }
    )
    figures = keypoints_of(open_session(synthesise(scene, tmp_path / "s", workers=1)))
    assert [len(figures[frame]) for frame in range(3)] == [6, 6, 6]
