"""Anatomical angles: every one alone, by name, sign and mirror image; singular poses; skeletons that rest otherwise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap.body import load_body_model, scale_body
from mocap.body.model import body_presets
from mocap.metrics.anatomy import (
    ANATOMICAL_ANGLES,
    ISB_FROM_OURS,
    JOINTS,
    anatomical_angles,
    segment_frames,
    standing_rotations,
    world_rotations,
)
from mocap.synth.figure import JOINT as FIGURE_JOINT
from mocap.synth.figure import JOINTS as FIGURE_JOINTS
from mocap.synth.figure import PARENTS, make_figure

EXACT = 1e-9  # closed forms in float64
FIGURE = make_figure(1.75, "female", 1.0, rng=np.random.default_rng(0))

# Movement of one joint of an upright figure whose arms hang, palms to the thighs -> the angle that it is.  Axes: x
# forward, y left, z up.  The words beside are what an onlooker sees.
MOVEMENTS = [
    ("left_hip", "y", -0.6, "left_hip_flexion", 0.6),  # thigh to the front
    ("right_hip", "y", -0.6, "right_hip_flexion", 0.6),
    ("left_hip", "x", 0.3, "left_hip_adduction", -0.3),  # left leg to the left
    ("right_hip", "x", -0.3, "right_hip_adduction", -0.3),  # right leg to the right
    ("left_hip", "z", -0.2, "left_hip_rotation", 0.2),  # left toes to the right: inwards
    ("right_hip", "z", 0.2, "right_hip_rotation", 0.2),
    ("left_knee", "y", 0.9, "left_knee_flexion", 0.9),  # heel to the back
    ("right_knee", "y", 0.9, "right_knee_flexion", 0.9),
    ("left_ankle", "y", -0.3, "left_ankle_dorsiflexion", 0.3),  # toes up
    ("right_ankle", "y", 0.3, "right_ankle_dorsiflexion", -0.3),
    ("left_ankle", "x", -0.2, "left_ankle_inversion", 0.2),  # left sole to the right
    ("right_ankle", "x", 0.2, "right_ankle_inversion", 0.2),
    ("left_toe", "y", -0.3, "left_mtp_extension", 0.3),  # heel off, toes down
    ("right_toe", "y", -0.3, "right_mtp_extension", 0.3),
    ("spine", "y", 0.4, "trunk_flexion", 0.4),  # forwards
    ("spine", "x", 0.2, "trunk_bending", 0.2),  # to the right
    ("spine", "z", 0.2, "trunk_rotation", 0.2),  # to the left
    ("chest", "y", 0.4, "trunk_flexion", 0.4),
    ("chest", "x", 0.2, "trunk_bending", 0.2),
    ("chest", "z", 0.2, "trunk_rotation", 0.2),
    ("head", "y", 0.3, "neck_flexion", 0.3),
    ("neck", "x", -0.3, "neck_bending", -0.3),
    ("neck", "z", -0.5, "neck_rotation", -0.5),
    ("left_shoulder", "y", -0.7, "left_shoulder_flexion", 0.7),  # arm to the front
    ("right_shoulder", "y", -0.7, "right_shoulder_flexion", 0.7),
    ("left_shoulder", "x", 0.7, "left_shoulder_adduction", -0.7),  # arm to the left
    ("right_shoulder", "x", -0.7, "right_shoulder_adduction", -0.7),
    ("right_shoulder", "z", 0.4, "right_shoulder_rotation", 0.4),  # inwards
    ("left_shoulder", "z", -0.4, "left_shoulder_rotation", 0.4),
    ("left_elbow", "y", -1.1, "left_elbow_flexion", 1.1),
    ("right_elbow", "y", -1.1, "right_elbow_flexion", 1.1),
    ("right_elbow", "z", 0.5, "right_elbow_pronation", 0.5),  # palm to the back
    ("left_elbow", "z", -0.5, "left_elbow_pronation", 0.5),
    ("left_elbow", "x", 0.2, "left_elbow_carrying", 0.2),  # forearm away from the body
    ("right_wrist", "x", 0.3, "right_wrist_flexion", 0.3),  # palm to the forearm
    ("left_wrist", "x", -0.3, "left_wrist_flexion", 0.3),
    ("right_wrist", "y", 0.2, "right_wrist_deviation", 0.2),  # little finger to the forearm
    ("pelvis", "z", 2.0, "pelvis_rotation", 2.0),  # whole body to the left
    ("pelvis", "y", 0.2, "pelvis_tilt", 0.2),  # forwards
    ("pelvis", "x", 0.1, "pelvis_obliquity", 0.1),  # right side down
]


def angles_of_figure(**turns):
    """Angles of a standing figure with joints turned: joint = rotation."""
    local = np.tile(np.eye(3), (1, len(FIGURE_JOINTS), 1, 1))
    for joint, rotation in turns.items():
        local[0, FIGURE_JOINT[joint]] = rotation.as_matrix()
    frames = segment_frames(FIGURE_JOINTS, FIGURE.offsets, world_rotations(PARENTS, local))
    return {name: float(value[0]) for name, value in anatomical_angles(frames).items()}


@pytest.mark.parametrize(("joint", "axis", "turn", "angle", "value"), MOVEMENTS)
def test_one_movement_is_one_angle(joint, axis, turn, angle, value):
    angles = angles_of_figure(**{joint: Rotation.from_euler(axis, turn)})
    assert angles[angle] == pytest.approx(value, abs=EXACT)
    # The trunk bends where its upper or its lower spine does.
    half = angle.replace("trunk", {"spine": "lumbar", "chest": "thoracic"}.get(joint, ""))
    assert (angles[half] if joint in ("spine", "chest") else value) == pytest.approx(value, abs=EXACT)
    others = {n: v for n, v in angles.items() if n not in (angle, half) and not _is_second_sequence(n)}
    assert others == pytest.approx(dict.fromkeys(others, 0.0), abs=EXACT)


def _is_second_sequence(name):
    return name.endswith(("shoulder_plane", "shoulder_elevation", "shoulder_axial_rotation"))


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(
    ("axis", "sign", "plane"), [("y", -1.0, np.pi / 2), ("x", 1.0, 0.0)], ids=["to the front", "to the side"]
)
def test_an_arm_is_raised_in_a_plane(side, axis, sign, plane):
    sign *= 1.0 if axis == "y" or side == "left" else -1.0
    angles = angles_of_figure(**{f"{side}_shoulder": Rotation.from_euler(axis, sign * 0.8)})
    assert angles[f"{side}_shoulder_elevation"] == pytest.approx(0.8, abs=EXACT)
    assert angles[f"{side}_shoulder_plane"] == pytest.approx(plane, abs=EXACT)


def test_all_angles_are_zero_at_rest():
    angles = {n: v for n, v in angles_of_figure().items() if not _is_second_sequence(n)}
    assert set(angles) <= set(ANATOMICAL_ANGLES)
    assert len(angles) == len(ANATOMICAL_ANGLES) - 6
    assert angles == pytest.approx(dict.fromkeys(angles, 0.0), abs=EXACT)


ROTATION = st.tuples(*[st.floats(-1.2, 1.2)] * 3).map(lambda v: Rotation.from_rotvec(v))


@settings(max_examples=30, deadline=None)
@given(ROTATION, ROTATION, ROTATION)
def test_the_mirror_image_has_the_same_angles_on_the_other_side(hip, shoulder, trunk):
    def mirrored(rotation):
        flip = np.diag([1.0, -1.0, 1.0])
        return Rotation.from_matrix(flip @ rotation.as_matrix() @ flip)

    one = angles_of_figure(left_hip=hip, left_shoulder=shoulder, spine=trunk)
    other = angles_of_figure(
        right_hip=mirrored(hip), right_shoulder=mirrored(shoulder), spine=mirrored(trunk)
    )
    for name, value in one.items():
        twin = name.replace("left_", "x_").replace("right_", "left_").replace("x_", "right_")
        is_of_spine = name.partition("_")[0] in ("trunk", "lumbar", "thoracic")
        sign = -1.0 if is_of_spine and not name.endswith("flexion") else 1.0
        assert np.cos(other[twin] - sign * value) == pytest.approx(1.0, abs=1e-6), name


@settings(max_examples=30, deadline=None)
@given(ROTATION, st.floats(-np.pi, np.pi))
def test_joint_angles_do_not_depend_on_where_the_body_faces(hip, heading):
    one = angles_of_figure(left_hip=hip)
    other = angles_of_figure(left_hip=hip, pelvis=Rotation.from_euler("z", heading))
    for name in one:
        if not name.startswith("pelvis"):
            assert np.cos(other[name] - one[name]) == pytest.approx(1.0, abs=1e-9), name
    assert other["pelvis_obliquity"] == pytest.approx(0.0, abs=EXACT)


@settings(max_examples=30, deadline=None)
@given(ROTATION)
def test_the_angles_of_a_right_joint_give_its_rotation_back(hip):
    angles = angles_of_figure(right_hip=hip)
    (joint,) = (j for j in JOINTS if j.name == "right_hip")
    again = Rotation.from_euler(joint.sequence, [angles[name] for name in joint.names]).as_matrix()
    assert ISB_FROM_OURS.T @ again @ ISB_FROM_OURS == pytest.approx(hip.as_matrix(), abs=1e-9)


def test_in_a_singular_pose_the_last_angle_is_zero_and_the_others_say_it_all():
    # The arm straight to the side: flexion and rotation turn about one axis.
    lifted = Rotation.from_euler("y", -0.3) * Rotation.from_euler("x", -np.pi / 2)
    angles = angles_of_figure(right_shoulder=lifted)
    assert angles["right_shoulder_adduction"] == pytest.approx(-np.pi / 2, abs=1e-6)
    assert angles["right_shoulder_rotation"] == 0.0
    assert angles["right_shoulder_flexion"] == pytest.approx(0.3, abs=1e-6)
    assert angles["right_shoulder_elevation"] == pytest.approx(np.pi / 2, abs=1e-6)


def test_an_unknown_orientation_is_an_unknown_angle():
    frames = {"pelvis": np.tile(np.eye(3), (2, 1, 1)), "left_thigh": np.tile(np.eye(3), (2, 1, 1))}
    frames["left_thigh"][1] = np.nan
    angles = anatomical_angles(frames)
    assert np.isfinite(angles["left_hip_flexion"]).tolist() == [True, False]
    assert "left_knee_flexion" not in angles


@pytest.mark.parametrize("preset", body_presets())
def test_arms_of_bodies_that_rest_as_a_t_are_turned_down(preset):
    body = scale_body(load_body_model(preset), 1.75)
    standing = standing_rotations(body.joints, body.offset)
    for side in ("left", "right"):
        down = standing[f"{side}_upper_arm"] @ body.offset[body.joints.index(f"{side}_elbow")]
        assert down / np.linalg.norm(down) == pytest.approx([0.0, 0.0, -1.0], abs=1e-9)
