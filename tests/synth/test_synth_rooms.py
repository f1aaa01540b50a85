"""Rigs, furniture, walls, and the meeting-room scenes."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")

from mocap.data import CameraRig
from mocap.errors import MocapError
from mocap.io.tables import read_landmarks_csv, read_tracks_csv
from mocap.synth import list_scenes, load_scene, synthesise
from mocap.synth.furniture import furniture_boxes
from mocap.synth.markers import Sight
from mocap.synth.meetings import APART_M, SIZE_M, TABLE_M, n_encounters, root_paths
from mocap.synth.render import CameraView
from mocap.synth.rigs import make_rig
from mocap.synth.rooms import Room, box_corners, make_room
from mocap.synth.scene import Scene, scene_from_dict
from mocap.synth.world import World, build_world

W, H = 160, 120
# Bodies are built with their own girth, which moves a hip by less than this against the plan.
PLAN_M = 0.05


def _scene(**more: object) -> Scene:
    document: dict[str, object] = {
        "name": "room",
        "seed": 51,
        "n_frames": 4,
        "rig": {"kind": "corners_ceiling", "size_px": [W, H]},
        "room": {"size_m": list(SIZE_M), "capture_m": [[-2.4, -1.9, 0.0], [2.4, 1.9, 2.2]]},
    }
    return scene_from_dict({**document, **more})


def _room(*furniture: dict[str, Any]) -> Room:
    boxes, tint = furniture_boxes(_scene(room={"furniture": list(furniture)}).room.furniture)
    return make_room(SIZE_M, floor="carpet", furniture=boxes, tint=tint, rng=np.random.default_rng(1))


def _rig(**config: Any) -> CameraRig:
    scene = _scene(rig=config)
    return make_rig(scene.rig, _room(), rng=np.random.default_rng(3))


# --- rigs ---------------------------------------------------------------------------------------------------


def test_corners_and_ceiling() -> None:
    rig = _rig(kind="corners_ceiling", size_px=[W, H])
    assert rig.names == tuple(f"cam_{i}" for i in range(5))
    half = np.array(SIZE_M[:2]) / 2
    quadrants = {tuple(np.sign(rig[i].center[:2]).astype(int).tolist()) for i in range(4)}
    assert len(quadrants) == 4
    for i in range(4):
        assert np.all(half - np.abs(rig[i].center[:2]) < 0.25)
        assert 2.0 < rig[i].center[2] < SIZE_M[2]
    assert rig[4].R[2, 2] < -0.99  # looks down
    assert np.linalg.det(rig[4].R) > 0.999
    for camera in rig:
        uv, _ = camera.project(np.array([[0.0, 0.0, 1.0]]))
        assert camera.contains(uv).all()


def test_given_cameras_are_exact() -> None:
    cameras = [
        {"name": "a", "position_m": [2.0, 1.0, 1.5], "target_m": [0.0, 0.0, 1.0], "focal_px": 320.0},
        {"name": "b", "position_m": [0.5, 0.2, 2.6], "target_m": [0.5, 0.2, 0.0], "roll_deg": 90.0},
    ]
    rig = _rig(kind="given", cameras=cameras, size_px=[W, H], lens="fisheye")
    assert rig.names == ("a", "b")
    for camera, config in zip(rig, cameras, strict=True):
        assert np.allclose(camera.center, config["position_m"])
        uv, _ = camera.project(np.array([config["target_m"]]))
        assert np.allclose(uv, [[W / 2 - 0.5, H / 2 - 0.5]])
        assert camera.is_fisheye
    assert rig["a"].K[0, 0] == 320.0 * W / 640
    level = rig["a"].R @ [0.0, 0.0, 1.0]
    assert abs(level[0]) < 1e-9  # up in the world is up in the picture
    assert level[1] < 0


def test_a_rig_without_kind_is_a_ring() -> None:
    assert scene_from_dict({"name": "x", "seed": 1, "rig": {"n_cameras": 3}}).rig.kind == "ring"
    assert scene_from_dict({"name": "x", "seed": 1}).rig.kind == "ring"


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ({"rig": {"kind": "dome"}}, "rig: "),
        ({"rig": {"kind": "corners_ceiling", "n_cameras": 4}}, "rig.n_cameras: unknown key"),
        ({"rig": {"kind": "given", "cameras": []}}, "rig.cameras: "),
        (
            {"rig": {"kind": "given", "cameras": [{"name": "a", "position_m": [0, 0, 1]}]}},
            "rig.cameras.0.target_m: Field required",
        ),
        ({"rig": {"lens": "broken"}}, "rig.lens: "),
        (
            {"room": {"furniture": [{"kind": "chair", "center_m": [0, 0], "legs": 3}]}},
            "room.furniture.0.legs",
        ),
        ({"room": {"furniture": [{"kind": "sofa"}]}}, "room.furniture.0: "),
        ({"room": {"furniture": [{"kind": "table", "center_m": [0, 0], "size_m": [0.1, 1]}]}}, "size_m"),
        ({"markers": {"detection_rate": 1.2}}, "markers.detection_rate: "),
        ({"markers": {"colour": "red"}}, "markers.colour: unknown key"),
        ({"picture": {"n_subframes": 1}}, "picture.n_subframes: "),
    ],
)
def test_mistakes_are_named_by_their_path(section: dict[str, Any], expected: str) -> None:
    with pytest.raises(MocapError) as caught:
        scene_from_dict({"name": "x", "seed": 1, **section})
    assert expected in str(caught.value)


# --- furniture ----------------------------------------------------------------------------------------------


def test_table_stands_on_its_legs() -> None:
    room = _room({"kind": "table", "center_m": [0.5, -0.2], "size_m": [1.6, 0.8], "height_m": 0.74})
    corners = room.furniture
    assert len(corners) == 5
    everything = corners.reshape(-1, 3)
    assert np.allclose(everything.min(axis=0), [0.5 - 0.8, -0.2 - 0.4, 0.0])
    assert np.allclose(everything.max(axis=0), [0.5 + 0.8, -0.2 + 0.4, 0.74])
    assert (corners[1:, :, 2].min(axis=1) == 0).all()
    assert corners[0, :, 2].min() > 0.6
    solid = _room({"kind": "table", "center_m": [0.5, -0.2], "solid": True}).furniture
    assert len(solid) == 1


def test_chair_has_its_back_behind_the_person() -> None:
    for heading in (0.0, 90.0, -150.0):
        chair = {"kind": "chair", "center_m": [0.3, 0.4], "heading_deg": heading, "seat_height_m": 0.44}
        back, seat, *legs = _room(chair).furniture
        front = np.array([np.cos(np.deg2rad(heading)), np.sin(np.deg2rad(heading))])
        assert ((back[:, :2] - [0.3, 0.4]) @ front < -0.2).all()
        assert np.isclose(seat[:, 2].max(), 0.44)
        assert np.abs((seat[:, :2] - [0.3, 0.4]) @ front).max() < 0.26
        assert len(legs) == 4


def test_a_turned_box_is_the_turned_corners() -> None:
    lower, upper = np.array([-0.2, -0.1, 0.0]), np.array([0.3, 0.4, 0.5])
    plain = box_corners(lower, upper)
    turned = box_corners(lower, upper, middle=np.array([1.0, 2.0, 0.0]), turn_rad=np.pi / 2)
    assert np.allclose(turned, np.column_stack([1.0 - plain[:, 1], 2.0 + plain[:, 0], plain[:, 2]]))


# --- walls --------------------------------------------------------------------------------------------------


def _at_the_wall(x: float) -> World:
    person = {"seed": 4, "motion": {"kind": "stand", "position_m": [x, 0.0]}}
    return build_world(_scene(persons=[person], n_frames=1))


def test_who_is_outside_is_invisible_and_throws_no_shadow() -> None:
    world = _at_the_wall(3.4)
    for camera in world.rig:
        view = CameraView(camera, world.room)
        picture, mask = view.render(world.at(0), world.things, world.looks)
        assert not mask.any()
        assert np.array_equal(picture, view.empty)


def test_who_is_hidden_by_furniture_still_throws_his_shadow() -> None:
    person = {"seed": 4, "motion": {"kind": "stand", "position_m": [-1.2, 0.0]}}
    room = {
        "size_m": list(SIZE_M),
        "furniture": [{"lower_m": [-0.9, -0.9, 0.0], "upper_m": [-0.8, 0.9, 2.4]}],
    }
    rig = {
        "kind": "given",
        "cameras": [{"name": "a", "position_m": [2.0, 0.0, 1.2], "target_m": [-1.2, 0.0, 1.0]}],
        "size_px": [W, H],
    }
    world = build_world(_scene(persons=[person], n_frames=1, room=room, rig=rig))
    view = CameraView(world.rig[0], world.room)
    picture, mask = view.render(world.at(0), world.things, world.looks)
    assert not mask.any()
    assert not np.array_equal(picture, view.empty)


def test_who_stands_in_the_wall_is_cut_by_it() -> None:
    inside, cut = _at_the_wall(2.0), _at_the_wall(2.5)
    for k in (0, 1):
        moment = cut.at(0)
        assert moment.crosses_wall
        view = CameraView(cut.rig[k], cut.room)
        _, mask = view.render(moment, cut.things, cut.looks)
        full = CameraView(inside.rig[k], inside.room).silhouette(inside.at(0, with_light=False))
        assert 0 < mask.sum() < full.sum()


def test_truth_knows_a_person_only_while_it_is_inside(tmp_path: Path) -> None:
    motion = {
        "kind": "route",
        "speed_m_s": 1.5,
        "waypoints": [{"at_m": [3.6, 0.0]}, {"at_m": [-0.5, 0.0]}],
    }
    scene = _scene(
        persons=[{"seed": 4, "motion": motion}, {"seed": 8, "motion": {"kind": "stand"}}],
        n_frames=12,
        fps=6.0,
        masks_only=True,
        truth_voxels=False,
        markers={"false_positives": 2.0},
    )
    folder = synthesise(scene, tmp_path / "door", workers=1)
    assert not (folder / "truth" / "voxels.npz").exists()
    tracks = read_tracks_csv(folder / "truth" / "tracks.csv")
    heads = read_tracks_csv(folder / "truth" / "heads.csv")
    first = tracks.frame[tracks.person == 1]
    assert 0 < len(first) < 12
    assert np.array_equal(first, np.arange(first[0], 12))  # once inside, it stays
    assert (np.abs(tracks.xyz[:, 0]) < 2.4).all()
    assert np.array_equal(heads.frame, tracks.frame)
    assert np.array_equal(heads.person, tracks.person)
    above = heads.xyz[:, 2] - tracks.xyz[:, 2]
    assert ((above > 0.4) & (above < 0.9)).all()
    motions = {m.person: m for m in read_landmarks_csv(folder / "truth" / "landmarks.csv")}
    assert np.array_equal(motions[1].frames, first)
    assert len(motions[2].frames) == 12
    with np.load(folder / "truth" / "views" / "cam_0.npz") as views:
        assert (views["landmark_state"][0, 0] == Sight.NOT_THERE).all()
        assert np.isnan(views["box_px"][0, 0]).all()
        assert (views["landmark_state"][11, 0] != Sight.NOT_THERE).all()
    with np.load(folder / "truth" / "pose_1.npz") as pose:
        assert np.array_equal(np.flatnonzero(pose["inside"]), first)


# --- meetings -----------------------------------------------------------------------------------------------


def _meetings() -> list[str]:
    return [n for n in list_scenes() if n.startswith("meeting_")]


def test_there_are_meetings_enough() -> None:
    short = [n for n in _meetings() if "long" not in n]
    assert sum("test" in n for n in short) >= 4
    assert sum("test" not in n for n in short) >= 4
    for name in short:
        scene = load_scene(name)
        assert scene.n_frames / scene.fps == 20.0
        assert 3 <= len(scene.persons) <= 5
        assert len(scene.rig.names) == 5
        assert {p.kind for p in scene.room.furniture} == {"table", "chair"}
    assert {len(load_scene(n).persons) for n in short} == {3, 4, 5}
    for name in set(_meetings()) - set(short):
        scene = load_scene(name)
        assert scene.masks_only
        assert scene.n_frames / scene.fps >= 60.0


@pytest.mark.parametrize("name", [n for n in list_scenes() if n.startswith("meeting_") and "long" not in n])
def test_people_come_meet_sit_and_go_and_run_into_nothing(name: str) -> None:
    scene = load_scene(name)
    paths = np.array(root_paths(scene))
    half = np.array(SIZE_M[:2]) / 2
    inside = np.all(np.abs(paths) < half, axis=2)
    assert (~inside[:, 0]).any()  # somebody comes in
    assert (~inside[:, -1]).any()  # somebody leaves
    assert any(w.sit for p in scene.persons for w in p.motion.waypoints)
    n_met = 0
    for a, b in itertools.combinations(range(len(paths)), 2):
        distance = np.linalg.norm(paths[a] - paths[b], axis=1)
        both = inside[a] & inside[b]
        assert (distance[both] > APART_M - PLAN_M).all()
        n_met += n_encounters(np.where(both, distance, np.inf), 1.1)
    assert n_met >= len(paths)
    shirts = np.array([p.colours.shirt for p in scene.persons], dtype=float)
    gaps = np.linalg.norm(shirts[:, None] - shirts[None], axis=2)[np.triu_indices(len(shirts), 1)]
    assert gaps.min() > 40
    for piece in scene.room.furniture:
        if piece.kind == "table":
            corners = piece.boxes().reshape(-1, 3)
            near = TABLE_M - PLAN_M
            low, high = corners.min(axis=0)[:2] - near, corners.max(axis=0)[:2] + near
            assert not np.all((paths > low) & (paths < high), axis=2).any()


def test_crossing_persons_pass_closely_and_differ_in_colour() -> None:
    for name in ("crossing_01", "crossing_test_01"):
        scene = load_scene(name)
        a, b = root_paths(scene)
        distance = np.linalg.norm(a - b, axis=1)
        assert 0.45 < distance.min() < 0.8
        assert n_encounters(distance, 0.95) >= 4
        shirts = [np.array(p.colours.shirt, dtype=float) for p in scene.persons]
        assert np.linalg.norm(shirts[0] - shirts[1]) > 100
