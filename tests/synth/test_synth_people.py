"""Children, clothes, hair and colours of the synthetic people, and what a scene file says about them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import trimesh

from mocap.data import LANDMARKS, VoxelGrid
from mocap.errors import MocapError
from mocap.synth.body import Body, build_body, mesh_volume_and_centroid, trunk_depth
from mocap.synth.figure import (
    CLOTHES,
    HAIR,
    JOINT,
    JOINTS,
    Figure,
    forward_kinematics,
    landmarks_of,
    make_figure,
)
from mocap.synth.flesh import HIPS, flesh_of
from mocap.synth.looks import make_look
from mocap.synth.motions import MOTIONS, Path
from mocap.synth.motions.anatomy import pose_of
from mocap.synth.persons import Person
from mocap.synth.scene import scene_from_dict
from mocap.synth.voxelise import solid_voxels
from mocap.synth.world import build_world

CELL_M = 0.028  # coarser than the default: the tests are about shape, not finish


def _figure(stature_m: float = 1.72, **words: object) -> Figure:
    return make_figure(stature_m, "female", 1.0, rng=np.random.default_rng(3), **words)  # type: ignore[arg-type]


@cache
def _body(
    stature_m: float = 1.72, is_child: bool = False, hair: str = "usual", clothes: str = "fitted"
) -> Body:
    return build_body(_figure(stature_m, is_child=is_child, hair=hair, clothes=clothes), cell_m=CELL_M)


def _standing(figure: Figure, angles: dict[str, float] | None = None) -> tuple[np.ndarray, np.ndarray]:
    root = np.array([[0.0, 0.0, figure.standing_height_m]])
    position, rotation = forward_kinematics(figure.offsets, pose_of(angles or {}, 1), root)
    return position, rotation


@pytest.mark.parametrize("stature", [1.0, 1.25, 1.5])
def test_children_have_large_heads_short_legs_and_their_stature(stature: float) -> None:
    child, adult = _figure(stature, is_child=True), _figure(1.72)
    body = build_body(child, cell_m=CELL_M)
    points = landmarks_of(body.figure, *_standing(body.figure))[0]
    assert 0.0 < points[LANDMARKS.index("head"), 2] - stature < 0.05  # sole and hair

    def legs(figure: Figure) -> float:
        return (figure.thigh_m + figure.shank_m) / figure.stature_m

    def head(figure: Figure) -> float:
        return float(figure.head_top[2]) / figure.stature_m

    assert legs(child) < 0.99 * legs(adult)
    assert head(child) > 1.05 * head(adult)
    assert (
        child.offsets[JOINT["left_elbow"], 2] / stature > adult.offsets[JOINT["left_elbow"], 2] / 1.72 - 0.01
    )
    volume, _ = mesh_volume_and_centroid(body.vertices, body.faces)
    assert 11 < volume * 1000 / stature**2 < 22  # body-mass index of children, clothed


def test_smaller_children_are_more_unlike_adults() -> None:
    ratios = [
        (f.thigh_m + f.shank_m) / f.stature_m
        for f in (
            make_figure(s, "male", 1.0, rng=np.random.default_rng(1), variation=0.0, is_child=True)
            for s in (1.0, 1.2, 1.4, 1.6)
        )
    ]
    assert np.all(np.diff(ratios) > 0.004)
    grown = make_figure(1.6, "male", 1.0, rng=np.random.default_rng(1), variation=0.0)
    assert ratios[-1] == pytest.approx((grown.thigh_m + grown.shank_m) / 1.6)


@pytest.mark.parametrize(
    ("hair", "clothes"), [*((h, "fitted") for h in HAIR), *(("long", c) for c in CLOTHES if c != "fitted")]
)
def test_every_dress_is_one_closed_mesh(hair: str, clothes: str) -> None:
    body = _body(hair=hair, clothes=clothes)
    mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert np.allclose(body.weights.sum(axis=1), 1)
    assert np.mean(np.sum(mesh.vertex_normals * body.normals, axis=1) > 0.7) > 0.97


@pytest.mark.parametrize(
    ("clothes", "lower", "upper", "more"), [("loose", -0.75, 0.1, 1.15), ("skirt", -0.33, -0.10, 1.25)]
)
def test_loose_clothes_are_wider_than_the_limbs_and_keep_the_joints(
    clothes: str, lower: float, upper: float, more: float
) -> None:
    plain, dressed = _body(), _body(clothes=clothes)
    assert np.array_equal(plain.figure.offsets, dressed.figure.offsets)
    volume = [mesh_volume_and_centroid(b.vertices, b.faces)[0] for b in (plain, dressed)]
    assert volume[1] > 1.08 * volume[0]
    width = []
    for body in (plain, dressed):
        position, rotation = _standing(body.figure)
        vertices, _ = body.pose(position[0], rotation[0])
        z = vertices[:, 2] - body.figure.standing_height_m
        between = vertices[(z > lower) & (z < upper) & (np.abs(vertices[:, 1]) < 0.3)]
        width.append(np.percentile(np.abs(between[:, 0] - np.median(between[:, 0])), 90))
    assert width[1] > more * width[0]


def test_a_skirt_moves_with_the_thighs() -> None:
    body = _body(clothes="skirt")
    skirt = next(p for p in body.parts if p.layer == "cloth")
    on_skirt = np.abs(skirt.distance(body.vertices)) < 0.004
    hem = on_skirt & (body.vertices[:, 2] < -0.28)
    front = []
    for flexion in (0.0, 50.0):
        position, rotation = _standing(
            body.figure, {"left_hip_flexion": flexion, "right_hip_flexion": flexion}
        )
        vertices, _ = body.pose(position[0], rotation[0])
        front.append(vertices[hem, 0].mean())
    assert front[1] - front[0] > 0.15
    one, _ = body.pose(*(a[0] for a in _standing(body.figure, {"left_hip_flexion": 50.0})))
    zero, _ = body.pose(*(a[0] for a in _standing(body.figure)))
    moved = (one - zero)[hem, 0]
    left = body.vertices[hem, 1] > 0.06
    right = body.vertices[hem, 1] < -0.06
    assert moved[left].mean() > 5 * abs(moved[right].mean())


def test_shared_bones_are_shares() -> None:
    rng = np.random.default_rng(2)
    figure = _figure(clothes="skirt")
    body = _body(clothes="skirt")
    parts = flesh_of(figure, body.rest_position, body.rest_rotation)
    skirt = next(p for p in parts if p.layer == "cloth")
    assert HIPS in skirt.bones
    weights = skirt.bone_weights(rng.uniform(-0.3, 0.3, (50, 3)))
    assert weights.shape == (50, len(JOINTS))
    assert np.allclose(weights.sum(axis=1), 1)


def test_joints_of_dressed_people_and_children_are_inside() -> None:
    for body in (_body(clothes="loose"), _body(1.1, True), _body(hair="afro", clothes="skirt")):
        pose = MOTIONS["walk"](
            body.figure,
            20,
            30.0,
            path=Path((0, 0), (0, 0), 0.3, False),
            speed_m_s=0.9,
            rng=np.random.default_rng(1),
        )
        position, rotation = forward_kinematics(body.figure.offsets, pose.rotations, pose.root_position)
        vertices, _ = body.pose(position[7], rotation[7])
        points = landmarks_of(body.figure, position, rotation)[7]
        grid = VoxelGrid.from_bounds(vertices.min(axis=0) - 0.05, vertices.max(axis=0) + 0.05, 0.01)
        solid = solid_voxels(vertices, body.faces, grid)
        inner = np.array([n != "head" for n in LANDMARKS])
        assert np.isin(grid.voxels_of(points[inner]), solid).all()
        assert vertices[:, 2].min() > -0.01


@pytest.mark.parametrize("stature", [1.0, 1.35])
def test_children_can_do_everything(stature: float) -> None:
    figure = _figure(stature, is_child=True)
    body = _body(stature, True)
    for name in ("walk", "jog", "throw", "dance", "sit", "fall", "pick_up", "box"):
        rng = np.random.default_rng(4)
        extra: dict[str, object] = {"position": (0.0, 0.0), "heading_rad": 0.5}
        if name in ("walk", "jog"):
            path = Path((0.0, 0.0), (1.0, 0.9), 0.0, False)
            extra = {"path": path, "speed_m_s": 0.8 if name == "walk" else 1.5}
        if name == "sit":
            extra["seat_height_m"] = 0.26
        pose = MOTIONS[name](figure, 60, 20.0, rng=rng, **extra)
        position, rotation = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
        for frame in range(0, 60, 12):
            vertices, _ = body.pose(position[frame], rotation[frame])
            assert vertices[:, 2].min() > -0.012, name
            assert trunk_depth(body, position[frame], rotation[frame]) < 0.03, name


def test_depth_in_the_trunk_is_measured() -> None:
    body = _body()
    out = {f"{s}_shoulder_abduction": 60.0 for s in ("left", "right")}
    position, rotation = _standing(body.figure, out)
    assert trunk_depth(body, position[0], rotation[0]) == 0.0
    through = {"left_shoulder_abduction": 5.0, "left_shoulder_rotation": 80.0, "left_elbow_flexion": 110.0}
    position, rotation = _standing(body.figure, {**out, **through})
    assert trunk_depth(body, position[0], rotation[0]) > 0.03


def test_given_colours_are_where_they_belong() -> None:
    body = _body(hair="long")
    colours = {
        "skin": (0.5, 0.3, 0.2),
        "hair": (0.9, 0.1, 0.1),
        "shirt": (0.1, 0.7, 0.2),
        "trousers": (0.1, 0.1, 0.8),
        "shoes": (0.6, 0.6, 0.1),
    }
    look = make_look(rng=np.random.default_rng(4), sex="female", colours=colours)
    head, chest = body.rest_position[JOINT["head"]], body.rest_position[JOINT["chest"]]
    places = {
        "hair": head + np.array([-0.09, 0.0, 0.08]),
        "skin": head + np.array([0.09, 0.03, 0.0]),
        "shirt": chest + np.array([0.12, 0.0, 0.0]),
        "trousers": body.rest_position[JOINT["left_hip"]] + np.array([0.08, 0.02, -0.1]),
        "shoes": body.rest_position[JOINT["left_toe"]],
    }
    for name, place in places.items():
        nearest = body.vertices[np.argmin(np.linalg.norm(body.vertices - place, axis=1))]
        found = look.albedo(body, nearest[None])[0]
        assert np.abs(found / np.array(colours[name]) - 1).max() < 0.3, name  # fabric varies
    with pytest.raises(ValueError, match="colours"):
        make_look(rng=np.random.default_rng(4), sex="female", colours={"hat": (0, 0, 0)})


def test_sleeves_and_stripes_are_what_the_scene_says() -> None:
    body = _body()
    colours = {"skin": (0.8, 0.1, 0.1), "shirt": (0.1, 0.1, 0.8)}
    look = make_look(rng=np.random.default_rng(4), sex="female", colours=colours)
    wrist, elbow = (body.rest_position[JOINT[f"left_{name}"]] for name in ("wrist", "elbow"))
    forearm = body.vertices[[np.argmin(np.linalg.norm(body.vertices - 0.5 * (wrist + elbow), axis=1))]]
    for sleeves, is_skin in (("short", True), ("long", False)):
        red, _, blue = look.cut(sleeves, None).albedo(body, forearm)[0]
        assert (red > blue) == is_skin
    chest = body.rest_position[JOINT["chest"]] + np.stack(
        [[0.12, 0.0, z] for z in np.arange(0.0, 0.1, 0.005)]
    )
    blues = [look.cut(None, period).albedo(body, chest)[:, 2] for period in (0.0, 0.05)]
    assert np.ptp(blues[1]) > 3 * np.ptp(blues[0])
    assert look.cut(None, None).sleeve == look.sleeve


def test_dress_does_not_change_what_else_is_drawn() -> None:
    plain = make_look(rng=np.random.default_rng(4), sex="female")
    skirt = make_look(rng=np.random.default_rng(4), sex="female", clothes="skirt")
    assert np.array_equal(plain.shirt, skirt.shirt)
    assert np.array_equal(plain.table, skirt.table)
    bald = _body(hair="bald")
    look = make_look(rng=np.random.default_rng(4), sex="female", colours={"hair": (0.9, 0.05, 0.9)})
    top = bald.vertices[[bald.vertices[:, 2].argmax()]]
    assert look.albedo(bald, top)[0, 1] > 0.06


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"stature_m": 1.7, "is_child": True}, "stature_m"),
        ({"stature_m": 1.0}, "stature_m"),
        ({"hair": "green"}, "hair must be one of"),
        ({"clothes": "toga"}, "clothes must be one of"),
    ],
)
def test_impossible_people_are_refused(words: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        _figure(**{"stature_m": 1.6, **words})  # type: ignore[arg-type]


def _scene(**person: object) -> dict[str, object]:
    motion = {"kind": "stand"}
    return {"name": "x", "seed": 3, "n_frames": 2, "persons": [{"seed": 5, "motion": motion, **person}]}


def test_scene_files_dress_people() -> None:
    scene = scene_from_dict(
        _scene(
            child=True,
            hair="bun",
            clothes="loose",
            colours={"shirt": "wall", "skin": "floor", "hair": [255, 0, 0]},
        )
    )
    world = build_world(scene)
    actor = world.actors[0]
    assert actor.body.figure.is_child
    assert 1.0 <= actor.body.figure.stature_m <= 1.5
    assert (actor.body.figure.hair, actor.body.figure.clothes) == ("bun", "loose")
    assert np.array_equal(actor.look.shirt, world.room.wall_rgb)
    assert np.array_equal(actor.look.skin, world.room.floor_rgb)
    assert np.allclose(actor.look.hair, [1, 0, 0])
    assert actor.look.stripes_m == 0


@pytest.mark.parametrize(
    ("person", "message"),
    [
        ({"height_m": 1.1}, "persons.0: Value error, height_m must lie in 1.2 .. 2.2"),
        ({"child": True, "height_m": 1.8}, "persons.0: Value error, height_m must lie in 0.95 .. 1.6"),
        ({"hair": "green"}, "persons.0.hair"),
        ({"colours": {"hat": "wall"}}, "persons.0.colours.hat: unknown key"),
        ({"colours": {"shirt": [300, 0, 0]}}, "persons.0.colours.shirt"),
        ({"motion": {"kind": "sit", "seat_height_m": 3}}, "persons.0.motion.seat_height_m"),
        (
            {"motion": {"kind": "route", "waypoints": [{"at_m": [0, 0], "sit": True}]}},
            "persons.0.motion.waypoints.0: Value error",
        ),
        ({"motion": {"kind": "route", "waypoints": []}}, "persons.0.motion.waypoints"),
    ],
)
def test_bad_persons_are_named_by_their_path(person: dict[str, object], message: str) -> None:
    with pytest.raises(MocapError) as caught:
        scene_from_dict(_scene(**person))
    assert message in str(caught.value)


def test_what_a_body_cannot_do_names_the_person() -> None:
    scene = scene_from_dict(_scene(child=True, height_m=1.0, motion={"kind": "sit", "seat_height_m": 0.5}))
    with pytest.raises(MocapError, match=r"persons\.0\.motion: seat_height_m must be at most"):
        build_world(scene)


def test_defaults_of_a_person() -> None:
    person = Person.model_validate({"seed": 1, "motion": {"kind": "dance"}})
    assert (person.child, person.hair, person.clothes) == (False, "usual", "fitted")
    assert all(colour is None for _, colour in person.colours)
