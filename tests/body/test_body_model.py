"""Body files: the published numbers, symmetry, and what a bad file says."""

import re
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from mocap.body import Body, body_presets, landmarks_of, load_body_model, neutral_state, scale_body
from mocap.body.model import MAX_PARTS
from mocap.data import ALL_LANDMARKS, BONES, LANDMARKS, bones_between
from mocap.errors import MocapError

PI = np.pi
PRESETS = ("anthropometric", "girdle", "thesis", "whole")

# CF Table 6.1 in the frame of reading guide 8: x forward, y left, z up.
TABLE_6_1_LIMITS = {
    "neck_x": (-PI / 2, PI / 2),
    "neck_y": (-PI / 2, PI / 2),
    "right_shoulder_x": (-PI, PI),
    "right_shoulder_y": (-3 * PI / 4, PI / 2),
    "right_shoulder_z": (-PI / 2, PI),
    "right_elbow_z": (0, PI),
    "left_shoulder_x": (-PI, PI),
    "left_shoulder_y": (-PI / 2, 3 * PI / 4),
    "left_shoulder_z": (-PI, PI / 2),
    "left_elbow_z": (-PI, 0),
    "right_hip_x": (-PI / 2, PI / 3),
    "right_hip_y": (-PI, PI / 2),
    "right_hip_z": (-PI / 4, PI / 4),
    "right_knee_y": (0, PI),
    "left_hip_x": (-PI / 3, PI / 2),
    "left_hip_y": (-PI, PI / 2),
    "left_hip_z": (-PI / 4, PI / 4),
    "left_knee_y": (0, PI),
    "waist_x": (-PI / 4, PI / 4),
    "waist_y": (-PI / 4, PI / 2),
    "waist_z": (-PI / 8, PI / 8),
}
# Length over height; the left lower leg is 0.24, not the misprinted 0.26 (reading guide 8).
TABLE_6_1_LENGTHS = {
    ("neck", "head"): 0.16,
    ("right_shoulder", "right_elbow"): 0.20,
    ("right_elbow", "right_wrist"): 0.20,
    ("left_shoulder", "left_elbow"): 0.20,
    ("left_elbow", "left_wrist"): 0.20,
    ("right_hip", "right_knee"): 0.26,
    ("right_knee", "right_ankle"): 0.24,
    ("left_hip", "left_knee"): 0.26,
    ("left_knee", "left_ankle"): 0.24,
    ("pelvis", "neck"): 0.33,
}


def body(name: str, height_m: float = 1.8) -> Body:
    return scale_body(load_body_model(name), height_m)


def bone(points: np.ndarray, a: str, b: str) -> float:
    return float(np.linalg.norm(points[LANDMARKS.index(a)] - points[LANDMARKS.index(b)]))


def test_presets_are_listed() -> None:
    assert body_presets() == PRESETS


@pytest.mark.parametrize("name", PRESETS)
def test_joint_limits_are_table_6_1(name: str) -> None:
    """Our bodies give both shoulder twists the union of the printed ranges (they cannot both be right); two have a
    shoulder girdle besides, one of them feet and hands that move, and arms that cannot be turned backwards."""
    layout = body(name).layout
    joints = {
        "girdle": ("clavicle",),
        "whole": ("clavicle", "ankle", "wrist", "mtp", "forearm", "thorax"),
    }.get(name, ())
    more = {n for n in layout.names if any(joint in n for joint in joints)}
    assert len(more) == {"girdle": 4, "whole": 19}.get(name, 0)
    assert layout.n_columns == 27 + len(more)
    assert set(layout.names[6:]) == set(TABLE_6_1_LIMITS) | more
    for column, (low, high) in TABLE_6_1_LIMITS.items():
        i = layout.names.index(column)
        if name != "thesis" and column.endswith("shoulder_y"):
            low, high = -0.75 * np.pi, 0.75 * np.pi
        if name in ("girdle", "whole") and column.endswith("shoulder_z"):
            low, high = max(low, -0.75 * np.pi), min(high, 0.75 * np.pi)
        assert layout.lower[i] == pytest.approx(low, abs=1e-12), column
        assert layout.upper[i] == pytest.approx(high, abs=1e-12), column


@pytest.mark.parametrize("name", PRESETS)
def test_fine_columns_are_those_of_feet_and_hands(name: str) -> None:
    b = body(name)
    fine = {column for column, is_fine in zip(b.layout.names, b.is_fine, strict=True) if is_fine}
    assert fine == {c for c in b.layout.names if any(j in c for j in ("ankle", "mtp", "wrist", "forearm"))}
    assert len(fine) == (12 if name == "whole" else 0)


def test_lengths_of_the_thesis_body_are_table_6_1() -> None:
    height = 1.83
    points = landmarks_of(body("thesis", height), np.zeros((1, 27)))[0]
    for (a, b), share in TABLE_6_1_LENGTHS.items():
        assert bone(points, a, b) == pytest.approx(share * height, abs=1e-12), (a, b)


@pytest.mark.parametrize("name", PRESETS)
def test_variance_factors_are_table_6_2(name: str) -> None:
    """Distal parts halve (empty, surface); the torso too, and doubles the double occupancy (reading guide 11)."""
    b = body(name)
    for part, factors in zip(b.layout.parts, b.variance, strict=True):
        if part.endswith(("forearm", "shank")):
            assert factors.tolist() == [1.0, 1.0, 0.5, 0.5]
        elif part == "torso":
            assert factors.tolist() == [1.0, 2.0, 0.5, 0.5]
        else:
            assert factors.tolist() == [1.0, 1.0, 1.0, 1.0]


@pytest.mark.parametrize("name", PRESETS)
def test_only_the_root_yaw_is_circular_and_positions_are_free(name: str) -> None:
    layout = body(name).layout
    assert np.flatnonzero(layout.is_circular).tolist() == [layout.names.index("root_yaw")]
    free = ~np.isfinite(layout.lower) & ~np.isfinite(layout.upper)
    assert np.flatnonzero(free).tolist() == [0, 1, 2, layout.names.index("root_yaw")]


@pytest.mark.parametrize("name", PRESETS)
def test_left_is_the_mirror_image_of_right(name: str) -> None:
    """Joints, flesh, landmarks and limits mirror in y; rotations about x and z change their sign."""
    b = body(name)
    layout = b.layout

    def other(text: str) -> str:
        return re.sub(r"^(left|right)", lambda m: {"left": "right", "right": "left"}[m[1]], text)

    mirror = np.array([1.0, -1.0, 1.0])
    for j, joint in enumerate(b.joints):
        twin = b.joints.index(other(joint))
        np.testing.assert_allclose(b.offset[twin], b.offset[j] * mirror, atol=1e-12)
        if b.parent[j] >= 0:
            assert b.joints[b.parent[twin]] == other(b.joints[b.parent[j]])
    for i, column in enumerate(layout.names):
        twin = layout.names.index(other(column))
        assert b.max_speed[twin] == b.max_speed[i]
        bounds = sorted([layout.lower[i], layout.upper[i]])
        if "shoulder_y" in column and name == "thesis":
            continue  # the table gives the two twists opposite ranges; a mirror would keep the sign
        if column[-1] in "xz" and column not in ("root_x", "root_z"):
            bounds = sorted([-bounds[0], -bounds[1]])
        assert [layout.lower[twin], layout.upper[twin]] == pytest.approx(bounds, abs=1e-12), column
    cones = {
        (b.joints[j], *np.round(np.concatenate([s, e, r]), 9))
        for j, s, e, r in zip(b.cones.joint, b.cones.start, b.cones.end, b.cones.radii, strict=True)
    }
    mirrored = {
        (other(b.joints[j]), *np.round(np.concatenate([s * mirror, e * mirror, r]), 9))
        for j, s, e, r in zip(b.cones.joint, b.cones.start, b.cones.end, b.cones.radii, strict=True)
    }
    assert {tuple(0.0 if x == 0 else x for x in c) for c in cones} == {
        tuple(0.0 if x == 0 else x for x in c) for c in mirrored
    }
    points = landmarks_of(b, np.zeros((1, b.layout.n_columns)))[0]
    for name_, p in zip(b.landmarks, points, strict=True):
        np.testing.assert_allclose(points[b.landmarks.index(other(name_))], p * mirror, atol=1e-12)


@pytest.mark.parametrize("name", PRESETS)
def test_every_length_is_proportional_to_the_height(name: str) -> None:
    small, tall = body(name, 1.5), body(name, 2.0)
    for a, b in (
        (small.offset, tall.offset),
        (small.cones.radii, tall.cones.radii),
        (small.cones.end, tall.cones.end),
    ):
        np.testing.assert_allclose(a / 1.5, b / 2.0, atol=1e-12)
    state = np.zeros((1, small.layout.n_columns))
    np.testing.assert_allclose(landmarks_of(small, state) / 1.5, landmarks_of(tall, state) / 2.0, atol=1e-12)


def test_the_default_body_is_as_tall_as_the_person() -> None:
    """From the soles to the crown within 2 %."""
    b = body("anthropometric", 1.80)
    state = neutral_state(b)
    crown = landmarks_of(b, state[None])[0, LANDMARKS.index("head"), 2]
    assert crown == pytest.approx(1.80, rel=0.02)


def test_columns_belong_to_the_first_part_they_move() -> None:
    layout = body("anthropometric").layout
    for column, part in (
        ("root_x", "torso"),
        ("root_yaw", "torso"),
        ("waist_x", "torso"),
        ("neck_x", "head"),
        ("left_shoulder_z", "left_upper_arm"),
        ("right_elbow_z", "right_forearm"),
        ("right_hip_y", "right_thigh"),
        ("left_knee_y", "left_shank"),
    ):
        i = layout.names.index(column)
        assert layout.parts[layout.part_of_column[i]] == part


@pytest.mark.parametrize("name", PRESETS)
def test_positions_come_first_and_one_column_turns_the_whole_body(name: str) -> None:
    b = body(name)
    assert np.flatnonzero(b.is_position).tolist() == [0, 1, 2]
    assert b.yaw_column == b.layout.names.index("root_yaw")


def test_landmarks_are_on_the_part_that_carries_them() -> None:
    b = body("anthropometric")
    parts = [b.layout.parts[p] for p in b.landmark_parts]
    assert len(parts) == len(LANDMARKS)
    assert parts[LANDMARKS.index("left_wrist")] == "left_forearm"
    assert parts[LANDMARKS.index("right_ankle")] == "right_shank"
    assert parts[LANDMARKS.index("pelvis")] == "torso"
    assert len(b.part_of_joint) == len(b.joints)


def test_height_must_be_a_length() -> None:
    model = load_body_model("thesis")
    for height in (0.0, -1.7, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="height_m"):
            scale_body(model, height)


def test_bones_connect_known_landmarks() -> None:
    assert {n for pair in BONES for n in pair} == set(ALL_LANDMARKS)
    assert len(bones_between(len(LANDMARKS))) == 14
    assert len(bones_between(len(ALL_LANDMARKS))) == len(BONES)
    with pytest.raises(ValueError, match="17 landmarks"):
        bones_between(17)


THESIS = (resources.files("mocap.body") / "presets" / "thesis.toml").read_text("utf-8")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t + "\n[[", "not a TOML file"),
        (lambda t: t.replace("round_ends = false", "round_edges = false"), "round_edges"),
        (lambda t: t.replace('axis = "z"', 'axis = "w"', 1), "joint.0.dofs.0.axis"),
        (lambda t: t.replace('parent = "waist"', 'parent = "hips"', 1), "parent hips must be defined before"),
        (lambda t: t.replace('name = "neck_y"', 'name = "neck_x"'), "names of dofs are not unique"),
        (lambda t: t.replace('name = "neck_y"', 'name = "root_x"'), "names of dofs are not unique"),
        (lambda t: t.replace('name = "neck"\n', 'name = "waist"\n', 1), "defined twice"),
        (lambda t: t.replace("radii = [0.040, 0.046]", "radii = [0.040, 0.0]"), "radii must be positive"),
        (lambda t: t.replace("radii = [0.040, 0.046]", "radii = [0.040, nan]"), "radii"),
        (lambda t: t.replace("offset = [0.0, 0.0, 0.33]", "offset = [0.0, nan, 0.33]", 1), "offset"),
        (lambda t: t.replace('joint = "neck", from', 'joint = "nose", from'), "unknown joint nose"),
        (lambda t: re.sub(r"\nleft_wrist .*", "", t), "landmarks missing: left_wrist"),
        (lambda t: t.replace('pelvis         = { joint = "root"', 'pelvis         = { joint = "hub"'), "hub"),
        (
            lambda t: t + 'left_heel = { joint = "left_knee", offset = [0.0, 0.0, -0.3] }\n',
            "come all or none; missing: left_toe, left_hand_tip, right_heel",
        ),
        (lambda t: t.replace("limits = [-1.7, 1.7]", "limits = [1.7, -1.7]", 1), "limits"),
        (lambda t: t.replace("limits = [-1.7, 1.7]", "limits = [nan, 1.7]", 1), "limits"),
        (lambda t: t.replace("speed = 3.0", "speed = 0.0", 1), "speed"),
        (lambda t: t.replace("translation_speed = [2.5, 2.5, 1.2]", ""), "translation_speed"),
    ],
)
def test_a_bad_body_file_is_one_clear_error(change: object, message: str, tmp_path: Path) -> None:
    text = change(THESIS)  # type: ignore[operator]
    assert text != THESIS
    path = tmp_path / "mine.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(MocapError, match=re.escape(message)) as error:
        scale_body(load_body_model(path), 1.7)
    assert str(path) in str(error.value)


def test_too_many_parts(tmp_path: Path) -> None:
    extra = "".join(
        f'[[part]]\nname = "p{i}"\nparent = "torso"\nside = "middle"\n'
        'cones = [{ joint = "waist", from = [0.0, 0.0, 0.0], to = [0.0, 0.0, 0.1], radii = [0.05, 0.05] }]\n'
        for i in range(MAX_PARTS)
    )
    path = tmp_path / "many.toml"
    path.write_text(THESIS + extra, "utf-8")
    with pytest.raises(MocapError, match=r"1 to \d+ are supported"):
        load_body_model(path)


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="presets anthropometric, girdle, thesis, whole"):
        load_body_model(tmp_path / "none.toml")
    with pytest.raises(MocapError, match="cannot be read"):
        load_body_model(tmp_path)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00\x80name")
    with pytest.raises(MocapError, match=re.escape(str(binary))):
        load_body_model(binary)


def test_a_copy_of_a_preset_is_the_preset(tmp_path: Path) -> None:
    path = tmp_path / "copy.toml"
    path.write_text(THESIS, "utf-8")
    assert load_body_model(path) == load_body_model("thesis")
