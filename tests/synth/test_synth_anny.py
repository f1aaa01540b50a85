"""Bodies of the optional package anny; most of this runs only where it is installed."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from mocap.data import LANDMARKS, VoxelGrid
from mocap.errors import MocapError
from mocap.synth.body import Body, mesh_volume_and_centroid
from mocap.synth.figure import JOINT, forward_kinematics, landmarks_of
from mocap.synth.motions import MOTIONS
from mocap.synth.motions.anatomy import pose_of
from mocap.synth.scene import scene_from_dict
from mocap.synth.session import synthesise
from mocap.synth.voxelise import solid_voxels
from mocap.synth.world import build_world

PEOPLE = [(1.78, "male", False), (1.64, "female", False), (1.15, "female", True)]
STATURE_M = 0.01  # halving the interval of a shape number 18 times leaves less


def _scene(**person: object) -> dict[str, object]:
    return {
        "name": "x",
        "seed": 3,
        "n_frames": 2,
        "persons": [{"seed": 5, "motion": {"kind": "stand"}, **person}],
    }


@pytest.fixture(scope="module", params=PEOPLE, ids=lambda p: f"{p[1]}-{p[0]}")
def body(request: pytest.FixtureRequest) -> Body:
    pytest.importorskip("anny", reason="bodies of the kind anny need the extra anny")
    from mocap.synth.anny_body import build_anny_body

    stature, sex, is_child = request.param
    return build_anny_body(stature, sex, 1.0, rng=np.random.default_rng(2), is_child=is_child)


def _standing(body: Body) -> tuple[np.ndarray, np.ndarray]:
    root = np.array([[0.0, 0.0, body.figure.standing_height_m]])
    return forward_kinematics(body.figure.offsets, pose_of({}, 1), root)


def test_the_person_stands_on_the_floor_as_tall_as_wanted(body: Body) -> None:
    position, rotation = _standing(body)
    vertices, _ = body.pose(position[0], rotation[0])
    assert abs(vertices[:, 2].min()) < 0.005
    assert abs(np.ptp(vertices[:, 2]) - body.figure.stature_m) < STATURE_M
    points = dict(zip(LANDMARKS, landmarks_of(body.figure, position, rotation)[0], strict=True))
    assert abs(points["head"][2] - vertices[:, 2].max()) < STATURE_M
    assert points["left_hip"][1] > 0 > points["right_hip"][1]
    assert 10 < mesh_volume_and_centroid(vertices, body.faces)[0] * 1000 / body.figure.stature_m**2 < 30


def test_rest_pose_returns_the_rest_mesh(body: Body) -> None:
    vertices, normals = body.pose(body.rest_position, body.rest_rotation)
    assert np.allclose(vertices, body.vertices, atol=1e-9)
    assert np.allclose(normals, body.normals, atol=1e-9)
    assert np.allclose(body.weights.sum(axis=1), 1)


def test_limbs_are_straight_in_the_neutral_pose_and_joints_inside(body: Body) -> None:
    offsets = body.figure.offsets
    for side in ("left", "right"):
        for joint in ("elbow", "wrist", "knee", "ankle"):
            assert np.allclose(offsets[JOINT[f"{side}_{joint}"]][:2], 0, atol=1e-9)
    position, rotation = _standing(body)
    vertices, _ = body.pose(position[0], rotation[0])
    grid = VoxelGrid.from_bounds(vertices.min(axis=0) - 0.05, vertices.max(axis=0) + 0.05, 0.01)
    solid = solid_voxels(vertices, body.faces, grid)
    points = landmarks_of(body.figure, position, rotation)[0]
    inner = np.array([n != "head" for n in LANDMARKS])
    assert np.isin(grid.voxels_of(points[inner]), solid).all()


def test_anny_people_move_and_fall(body: Body) -> None:
    for name in ("gesture", "fall"):
        extra = {"body": body, "start_s": 0.5} if name == "fall" else {}
        pose = MOTIONS[name](
            body.figure, 50, 15.0, position=(0, 0), heading_rad=0.3, rng=np.random.default_rng(1), **extra
        )
        position, rotation = forward_kinematics(body.figure.offsets, pose.rotations, pose.root_position)
        for frame in range(0, 50, 10):
            assert body.pose(position[frame], rotation[frame])[0][:, 2].min() > -0.01


def test_scene_files_choose_the_body(body: Body) -> None:
    actor = build_world(scene_from_dict(_scene(body="anny", height_m=1.7))).actors[0]
    assert actor.body.figure.stature_m == 1.7
    assert actor.body.parts == ()


@pytest.mark.parametrize("dress", [{"clothes": "skirt"}, {"hair": "afro"}])
def test_what_anny_cannot_wear_is_refused(dress: dict[str, str]) -> None:
    with pytest.raises(MocapError, match=r"persons\.0: .*bodies of the kind anny"):
        scene_from_dict(_scene(body="anny", **dress))


def test_a_missing_package_names_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mocap.synth import anny_body

    anny_body._model.cache_clear()
    monkeypatch.setitem(sys.modules, "anny", None)
    with pytest.raises(MocapError, match=r"mocap-volumes\[anny\]"):
        build_world(scene_from_dict(_scene(body="anny")))
    with pytest.raises(MocapError, match=r"persons\.0\.body"):
        synthesise(scene_from_dict(_scene()), tmp_path / "s", body="clay")
