"""Depth cameras registered by the room, and the room fused: what Open3D is needed for."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap.data import Camera
from mocap.data.depth import DepthNoise
from mocap.errors import MissingExtra
from mocap.volume.depth_fusion import fused_surface
from mocap.volume.depth_registration import Registration, register_depth
from mocap.volume.measured_room import RoomView, without_edges
from tests.volume.boxed_room import FLOOR, FURNITURE, Box, camera_at, view_of

NOISE = DepthNoise()
# Of a camera 3 m away with a fifth of a look's noise, registered on half a square metre of furniture: found 0.2 mm.
PLACE_M, DIRECTION_DEG = 0.005, 0.1


def room(boxes: Sequence[Box], turns_deg: Sequence[float]) -> list[RoomView]:
    rng = np.random.default_rng(0)
    views = [view_of(camera_at(f"cam_{t}", t), boxes, rng=rng) for t in turns_deg]
    return [replace(v, depth_m=without_edges(v.depth_m, NOISE)) for v in views]


def moved(camera: Camera, shift_m: Sequence[float], turn_deg: float) -> Camera:
    R = camera.R @ Rotation.from_euler("z", turn_deg, degrees=True).as_matrix()
    return replace(camera, R=R, t=-R @ (camera.center + np.array(shift_m)))


def registered(
    boxes: Sequence[Box], turns_deg: Sequence[float], shift_m: Sequence[float], turn_deg: float
) -> tuple[Registration | None, Camera]:
    own, *others = room(boxes, turns_deg)
    wrong = replace(own, camera=moved(own.camera, shift_m, turn_deg))
    return register_depth(wrong, others, NOISE), own.camera


@pytest.mark.usefixtures("open3d")
def test_a_camera_comes_back_from_anywhere_to_where_it_stands() -> None:
    found, true = registered((FLOOR, *FURNITURE), (35, 80), (1.5, 2.0, 0.4), 130.0)
    assert found is not None
    assert np.linalg.norm(found.camera.center - true.center) < PLACE_M
    turn = Rotation.from_matrix(found.camera.R @ true.R.T).magnitude()
    assert np.degrees(turn) < DIRECTION_DEG
    assert found.fixed > 0.02
    assert found.before < 0.01
    assert found.residual_m < 0.006
    assert found.shared_m2 > 0.3
    assert found.shift_m == pytest.approx(np.linalg.norm([1.5, 2.0, 0.4]), abs=0.01)


@pytest.mark.usefixtures("open3d")
def test_a_bare_floor_gives_no_place_and_one_box_leaves_it_open() -> None:
    assert registered((FLOOR,), (35, 80), (0.1, 0.0, 0.0), 5.0)[0] is None
    one, _ = registered((FLOOR, FURNITURE[0]), (35, 80), (0.1, 0.0, 0.0), 5.0)
    assert one is None or one.fixed < 0.005  # its top and one side in common


@pytest.mark.usefixtures("open3d")
def test_the_fused_room_is_where_the_boxes_are_in_their_greys() -> None:
    views = [view_of(camera_at(f"cam_{t}", t), (FLOOR, FURNITURE[0])) for t in (0, 70, 140)]
    mesh = fused_surface(views, voxel_m=0.03)
    on_top = mesh.vertices[(mesh.vertices[:, 2] > 1.1)]
    assert len(on_top) > 50
    lower, upper = FURNITURE[0]
    inner = np.all(
        (on_top[:, :2] > np.array(lower[:2]) + 0.1) & (on_top[:, :2] < np.array(upper[:2]) - 0.1), axis=1
    )
    off = on_top[inner, 2] - upper[2]
    assert abs(off.mean()) < 0.003
    assert np.abs(off).max() < 0.015  # half a voxel
    grey = mesh.rgb[mesh.vertices[:, 2] > 1.1][inner]
    assert np.abs(grey.astype(int) - 100).max() <= 2
    # Outwards is anticlockwise: the top's triangles look up.
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    top = (a[:, 2] > 1.15) & (np.abs(normals[:, 2]) > 0.9 * np.linalg.norm(normals, axis=1))
    assert (normals[top, 2] > 0).mean() > 0.95


def test_without_open3d_the_message_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    views = room((FLOOR,), (35,))
    with pytest.raises(MissingExtra, match=r"fusing depth maps needs Open3D.*\[open3d\]"):
        fused_surface(views)
    with pytest.raises(MissingExtra, match=r"registering a depth camera needs Open3D"):
        register_depth(views[0], views, NOISE)
    with pytest.raises(ValueError, match="others"):
        register_depth(views[0], [], NOISE)
