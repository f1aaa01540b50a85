"""What a rig will tell of a body, foreseen from where the cameras stand."""

from __future__ import annotations

import numpy as np
import pytest
from marker_world import ring

from mocap.body import Body, load_body_model, neutral_state, scale_body
from mocap.body.kinematics import landmarks_of
from mocap.data import Camera, CameraRig
from mocap.pose.foresight import (
    ForesightSettings,
    aimed,
    foresee,
    next_camera,
    outline_information,
    sees_whole,
)

SETTINGS = ForesightSettings(n_headings=3)
MIDDLE = [(0.0, 0.0)]


@pytest.fixture(scope="module")
def body() -> Body:
    return scale_body(load_body_model("girdle"), 1.75)


def camera_at(azimuth_deg: float, away_m: float = 3.5, height_m: float = 1.2) -> Camera:
    """An upright camera that looks at the middle of a person."""
    angle = np.radians(azimuth_deg)
    eye = np.array([away_m * np.cos(angle), away_m * np.sin(angle), height_m])
    K = np.array([[500.0, 0.0, 319.5], [0.0, 500.0, 239.5], [0.0, 0.0, 1.0]])
    like = Camera("like", (640, 480), K, np.zeros(4), np.eye(3), np.zeros(3))
    return aimed(like, f"at_{azimuth_deg:.0f}", eye, np.array([0.0, 0.0, 0.9]))


def rig_at(*azimuths_deg: float) -> CameraRig:
    return CameraRig(tuple(camera_at(a) for a in azimuths_deg))


def expected_mm(body: Body, *azimuths_deg: float) -> float:
    return 1000 * float(foresee(rig_at(*azimuths_deg), body, MIDDLE, SETTINGS).mean_m[0])


def test_one_camera_tells_across_its_line_of_sight_and_not_along_it(body: Body) -> None:
    state = neutral_state(body)
    along = outline_information(camera_at(0.0), body, state, SETTINGS)[:3, :3]
    across = along[1, 1]
    assert along[0, 0] < 0.05 * across
    assert along[2, 2] > 0  # heads and limbs end somewhere


def test_what_is_told_grows_with_the_picture(body: Body) -> None:
    """Nearer cameras resolve more, as far as the flesh is known."""
    sharp = ForesightSettings(flesh_std_m=0.0)
    near, far = (
        outline_information(camera_at(20.0, m), body, neutral_state(body), sharp) for m in (3.0, 9.0)
    )
    assert np.trace(near[:3, :3]) / np.trace(far[:3, :3]) == pytest.approx(9.0, rel=0.25)


def test_an_arm_before_the_trunk_tells_the_camera_in_front_nothing(body: Body) -> None:
    state = neutral_state(body)
    names = body.layout.names
    for name, value in {"right_elbow_z": 1.0, "right_shoulder_y": 0.5, "right_shoulder_z": 0.6}.items():
        state[names.index(name)] = value
    elbow = names.index("right_elbow_z")
    wrist = landmarks_of(body, state[None])[0, body.landmarks.index("right_wrist")]
    assert wrist[0] > 0.15, "in front"
    assert abs(wrist[1]) < 0.15, "of the trunk"
    front, side = (
        outline_information(camera_at(a), body, state, SETTINGS)[elbow, elbow] for a in (0.0, -90.0)
    )
    assert front < 0.1 * side


def test_two_cameras_serve_best_at_right_angles(body: Body) -> None:
    beside, right, opposite = (expected_mm(body, 0.0, apart) for apart in (20.0, 90.0, 180.0))
    assert right < 0.8 * beside
    assert right < 0.8 * opposite


def test_another_camera_never_makes_it_worse(body: Body) -> None:
    found = [expected_mm(body, *np.arange(n) * 360.0 / 7) for n in (2, 3, 4, 7)]
    assert found == sorted(found, reverse=True)
    assert found[-1] < 0.7 * found[0]


def test_a_camera_that_does_not_see_the_place_tells_nothing(body: Body) -> None:
    pair = rig_at(0.0, 90.0)
    away = camera_at(200.0)
    R = np.diag([-1.0, 1.0, -1.0]) @ away.R  # turned round
    behind = Camera("behind", away.size, away.K, away.dist, R, -R @ away.center)
    both = CameraRig((*pair.cameras, behind))
    assert foresee(both, body, MIDDLE, SETTINGS).mean_m == pytest.approx(
        foresee(pair, body, MIDDLE, SETTINGS).mean_m
    )
    assert not sees_whole(behind, np.zeros((1, 2)), 1.75)[0]


def test_an_aimed_camera_has_its_target_in_the_middle_and_stands_upright() -> None:
    camera = camera_at(70.0)
    uv, depth = camera.project(np.array([[0.0, 0.0, 0.9], [0.0, 0.0, 1.4]]))
    assert uv[0] == pytest.approx([319.5, 239.5])
    assert depth[0] == pytest.approx(np.hypot(3.5, 0.3))
    assert uv[1, 0] == pytest.approx(319.5)
    assert uv[1, 1] < uv[0, 1]
    assert np.allclose(camera.center, [3.5 * np.cos(np.radians(70)), 3.5 * np.sin(np.radians(70)), 1.2])


def test_somebody_is_seen_whole_where_head_and_feet_are_in_the_picture() -> None:
    camera = camera_at(0.0)
    seen = sees_whole(camera, np.array([[0.0, 0.0], [2.6, 0.0], [0.0, 3.0], [6.0, 0.0]]), 1.75)
    assert seen.tolist() == [True, False, False, False]


def test_the_next_camera_goes_where_the_others_do_not_look_from(body: Body) -> None:
    rig = rig_at(0.0, 20.0)
    camera, deviation_m = next_camera(rig, body, (0.0, 0.0), SETTINGS)
    azimuth = np.degrees(np.arctan2(camera.center[1], camera.center[0])) % 180.0
    assert 60.0 <= azimuth <= 150.0
    assert camera.center[2] == pytest.approx(1.2)
    more = foresee(CameraRig((*rig.cameras, camera)), body, MIDDLE, SETTINGS)
    assert deviation_m == pytest.approx(more.mean_m[0])


def test_places_and_landmarks_are_told_apart(body: Body) -> None:
    found = foresee(ring(4, size=(640, 496)), body, [(0.0, 0.0), (1.0, 0.5)], SETTINGS)
    assert found.covariance.shape == (2, len(body.landmarks), 3, 3)
    assert found.deviation_m.shape == (2, len(body.landmarks))
    assert found.mean_m == pytest.approx(np.sqrt((found.deviation_m**2).mean(axis=1)))
    assert np.all(np.linalg.eigvalsh(found.covariance) > 0)
    hip, wrist = (found.names.index(name) for name in ("left_hip", "left_wrist"))
    assert found.deviation_m[0, wrist] > found.deviation_m[0, hip]
