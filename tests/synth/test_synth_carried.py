"""Things that synthetic people carry: where they are, what is seen of them, and that the truth is of people alone."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")

from mocap.errors import MocapError
from mocap.synth.carried import KINDS, carried, with_both_hands
from mocap.synth.figure import JOINT, SIDES, forward_kinematics, make_figure, rotation_about
from mocap.synth.motions import Pose
from mocap.synth.motions.anatomy import joint_angles, pose_of
from mocap.synth.persons import Load
from mocap.synth.render import CameraView
from mocap.synth.scene import Scene, scene_from_dict
from mocap.synth.views import Witness
from mocap.synth.world import World, build_world

BROWN = np.array([0.1, 0.05, 0.02])
FIGURE = make_figure(1.75, "male", 1.0, rng=np.random.default_rng(3))


def posed(kind: str, hand: str = "right", **angles: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners (V, 3) and normals of something on somebody who stands at the origin, and his joints (J, 3)."""
    root = np.array([[0.0, 0.0, FIGURE.standing_height_m]])
    position, rotation = forward_kinematics(FIGURE.offsets, pose_of(angles, 1), root)
    vertices, normals = carried(kind, hand, FIGURE, BROWN).pose(position[0], rotation[0])
    return vertices, normals, position[0]


def world(carries: list[dict], persons: int = 1, motion: dict | None = None) -> World:
    person = {"height_m": 1.75}
    scene: Scene = scene_from_dict(
        {
            "name": "small",
            "seed": 21,
            "n_frames": 3 if motion is None else 60,
            "rig": {"n_cameras": 3, "size_px": [320, 240], "focal_px": 250.0},
            "persons": [
                {**person, "seed": 5 + i, "motion": motion or {"kind": "stand", "position_m": [0.9 * i, 0.0]}}
                | ({"carries": carries} if i == persons - 1 else {})
                for i in range(persons)
            ],
        }
    )
    return build_world(scene)


def test_a_scene_knows_the_kinds() -> None:
    assert set(KINDS) == set(Load.model_fields["kind"].annotation.__args__)  # type: ignore[union-attr]
    with pytest.raises(MocapError, match=r"persons\.0\.carries\.0\.kind"):
        world([{"kind": "anvil"}])


@pytest.mark.parametrize("kind", KINDS)
def test_meshes_are_fine_and_look_outwards(kind: str) -> None:
    vertices, normals, _ = posed(kind)
    corners = vertices.reshape(-1, 3, 3)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert edges.max() < 0.0301
    assert edges.min() > 1e-5
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    # By the divergence theorem: a mesh that looks inwards has a negative volume.
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    assert np.einsum("fi,fi->", corners.mean(axis=1), area) / 3 > 0
    assert np.einsum("fi,fi->f", area, normals[::3]).min() > 0


@pytest.mark.parametrize(("kind", "length_m"), [("stick", 0.85), ("racket", 0.61)])
def test_what_a_hanging_arm_holds_points_forward_and_a_little_down(kind: str, length_m: float) -> None:
    for hand, side in (("right", -1.0), ("left", 1.0)):
        vertices, _, joints = posed(kind, hand)
        fist = joints[JOINT[f"{hand}_wrist"]] + (0, 0, -0.105)
        tip = vertices[np.linalg.norm(vertices - fist, axis=1).argmax()] - fist
        assert np.sign(fist[1]) == side
        assert np.linalg.norm(tip) == pytest.approx(length_m, abs=0.03)
        assert np.degrees(np.arctan2(-tip[2], tip[0])) == pytest.approx(20.0, abs=3.0)


def test_a_bag_hangs_and_a_stick_does_not() -> None:
    raised = {"right_shoulder_flexion": 80.0}
    for kind, is_lower in (("bag", True), ("stick", False)):
        vertices, _, joints = posed(kind, **raised)
        hand = joints[JOINT["right_wrist"], 2]
        assert joints[JOINT["right_elbow"], 2] - hand < 0.2, "the arm is not raised"
        assert (vertices[:, 2].max() < hand + 0.03) == is_lower
    assert np.ptp(posed("bag", **raised)[0][:, 2]) == pytest.approx(np.ptp(posed("bag")[0][:, 2]), abs=1e-3)


def test_a_rucksack_is_behind_the_chest_and_as_large_as_who_wears_it() -> None:
    vertices, _, joints = posed("rucksack")
    chest, neck = joints[JOINT["chest"]], joints[JOINT["neck"]]
    assert vertices[:, 0].max() < chest[0]
    assert np.abs(vertices[:, 1].mean()) < 0.01
    assert vertices[:, 2].max() < neck[2]
    child = make_figure(1.1, "male", 1.0, rng=np.random.default_rng(3), is_child=True)
    small = carried("rucksack", "right", child, BROWN).vertices
    large = carried("rucksack", "right", FIGURE, BROWN).vertices
    assert np.ptp(small, axis=0) == pytest.approx(np.ptp(large, axis=0) * 1.1 / 1.75)


def test_a_crate_is_held_by_both_hands_whatever_the_arms_would_do() -> None:
    """The hands lie along its sides, and it is before the trunk."""
    for motion in ({"kind": "walk"}, {"kind": "gesture"}):
        w = world([{"kind": "crate"}], motion=motion)
        (actor,), (crate,) = w.actors, w.actors[0].loads
        size = crate.vertices.max(axis=0) - crate.vertices.min(axis=0)
        angles = joint_angles(actor.pose.rotations)
        for k in range(0, len(actor.position), 10):
            position, rotation = actor.position[k], actor.rotation[k]
            vertices, _ = crate.pose(position, rotation)
            assert np.ptp(vertices[:, 2]) == pytest.approx(size[2]), "it stays upright"
            turn = rotation[JOINT["chest"]]
            heading = rotation_about(2, np.arctan2(turn[1, 0], turn[0, 0]))
            middle = 0.5 * (vertices @ heading).max(axis=0) + 0.5 * (vertices @ heading).min(axis=0)
            for side, sign in SIDES:
                hand = position[JOINT[f"{side}_wrist"]] @ heading - middle
                assert abs(hand[0]) < size[0] / 2
                assert -0.02 < sign * hand[1] - size[1] / 2 < 0.06
                assert abs(hand[2]) < size[2] / 2
            flesh, _ = actor.body.pose(position, rotation)
            between_hands = size / 2 - (0.0, 0.06, 0.0)  # the fingers are round its edges
            assert not (np.abs(flesh @ heading - middle) < between_hands).all(axis=1).any(), (motion, k)
        for side, _ in SIDES:
            assert (
                30.0 < angles[f"{side}_elbow_flexion"].min() <= angles[f"{side}_elbow_flexion"].max() < 120.0
            )
            assert angles[f"{side}_shoulder_elevation"].max() < 60.0


def test_hands_that_hold_a_crate_are_straight() -> None:
    root = np.array([[0.0, 0.0, FIGURE.standing_height_m]])
    rotations = pose_of({"left_wrist_flexion": 40.0, "right_wrist_side": 20.0}, 1)
    held = with_both_hands(FIGURE, Pose(root, rotations, np.ones((1, 2), dtype=np.bool_)))
    for side, _ in SIDES:
        np.testing.assert_array_equal(held.rotations[:, JOINT[f"{side}_wrist"]], np.eye(3)[None])
    assert not np.allclose(rotations[:, JOINT["left_wrist"]], np.eye(3)), "the motion itself is as it was"


def test_it_is_seen_and_the_truth_is_of_people_alone() -> None:
    laden, bare = world([{"kind": "rucksack"}, {"kind": "bag"}]), world([])
    a, b = laden.at(0.0, with_light=False), bare.at(0.0, with_light=False)
    more = []
    for name in bare.rig.names:
        with_it, without = (
            CameraView(w.rig[name], w.room).silhouette(at) for w, at in ((laden, a), (bare, b))
        )
        assert not (without & ~with_it).any()
        more.append(with_it.sum() / without.sum())
    assert min(more) > 1.02
    assert max(more) > 1.15
    np.testing.assert_array_equal(laden.actors[0].landmarks, bare.actors[0].landmarks)
    for mine, his in zip(a.of(0), b.of(0), strict=True):
        np.testing.assert_array_equal(mine, his)


def test_its_colour_is_that_of_the_scene() -> None:
    red, blue = (
        world([{"kind": "bag", "colour": colour}]) for colour in ([255.0, 0.0, 0.0], [0.0, 0.0, 255.0])
    )
    name = red.rig.names[0]
    pictures = []
    for w in (red, blue):
        picture, _ = CameraView(w.rig[name], w.room).render(w.at(0.0), w.things, w.looks)
        pictures.append(picture.astype(np.float64))
    differs = np.abs(pictures[0] - pictures[1]).max(axis=2) > 30
    assert differs.any()
    assert pictures[0][differs][:, 0].mean() > pictures[0][differs][:, 2].mean() + 30
    assert pictures[1][differs][:, 2].mean() > pictures[1][differs][:, 0].mean() + 30


def test_what_somebody_carries_hides_him_and_others() -> None:
    """The owner of a face of the second person's rucksack is the second person."""
    w = world([{"kind": "rucksack"}], persons=2)
    posed = w.at(0.0, with_light=False)
    first = posed.first_vertex[posed.things.index(2)]
    face = int(np.flatnonzero((posed.faces >= first).all(axis=1))[0])
    assert w.owner_of_thing(posed, face) == 1
    assert w.ball_of_face(posed, face) == -1
    witness = Witness(w)
    for name in w.rig.names:
        witness.look(CameraView(w.rig[name], w.room), posed, 0.0, is_off=False)
    assert len(witness.landmark_states) == 3
