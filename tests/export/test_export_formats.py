"""Every export is read back by a reader that shares no code with its writer."""

import importlib.util
import json
import struct
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap.body import body_skin, cones_of, load_body_model, neutral_state, scale_body, skeleton_of
from mocap.body.flesh import cone_distances
from mocap.data import LANDMARKS, Motion, Skeleton
from mocap.errors import MocapError
from mocap.io.formats import EXPORT_CONVENTIONS, renamed, write_bvh, write_c3d, write_glb, write_trc

FPS = 25.0
T = 9
J = 7
TOLERANCE_M = 1e-4  # a tenth of a millimetre, far below what any motion capture resolves


def motion(rng, frames=None):
    frames = np.arange(5, 5 + T) if frames is None else np.asarray(frames)
    return Motion(3, frames, frames / FPS, rng.normal(0, 1, (len(frames), 15, 3)))


def skeleton(rng, n_frames=T):
    """A tree whose joints are not numbered depth first, with two branches and two tips."""
    names = ("pelvis", "spine", "left hip", "head", "left_knee", "right_hip", "right_knee")
    parents = np.array([-1, 0, 0, 1, 2, 0, 5])
    rotations = Rotation.random(n_frames * J, rng=rng).as_matrix().reshape(n_frames, J, 3, 3)
    return Skeleton(
        person=2,
        names=names,
        parents=parents,
        offsets=rng.normal(0, 0.3, (J, 3)),
        end_offsets={3: np.array([0.0, 0.0, 0.2]), 4: np.array([0.1, 0.0, -0.3])},
        rotations=rotations,
        root_position=rng.normal(0, 1, (n_frames, 3)),
    )


def with_nan(s, *frames):
    rotations, root = s.rotations.copy(), s.root_position.copy()
    for f in frames:
        rotations[f, 3] = np.nan
        root[f, 0] = np.nan
    return Skeleton(s.person, s.names, s.parents, s.offsets, s.end_offsets, rotations, root)


def world_from_y_up(points):
    """File (x, y, z) back to the scene's (z, x, y)."""
    return points[..., [2, 0, 1]]


def world_from_animation(points):
    """File (x, y, z) of BVH and glTF back to the scene's (x, -z, y), as Blender does it."""
    return points[..., [0, 2, 1]] * [1, -1, 1]


# ---------------------------------------------------------------------------------------------------- TRC


def read_trc(path):
    """Frames (T,), times (T,), names, points (T, M, 3) as in the file, header fields."""
    lines = path.read_text().split("\n")
    assert lines[-1] == ""
    fields = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=True))
    names = [name for name in lines[3].split("\t")[2:] if name]
    n = len(names)
    assert lines[4].split("\t")[2:] == [f"{axis}{i + 1}" for i in range(n) for axis in "XYZ"]
    rows = [line.split("\t") for line in lines[5:-1]]
    assert all(len(row) == 2 + 3 * n for row in rows)
    table = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows])
    table = table.reshape(-1, 2 + 3 * n)
    return table[:, 0], table[:, 1], names, table[:, 2:].reshape(-1, n, 3), fields


def test_trc_round_trip(tmp_path):
    m = motion(np.random.default_rng(1))
    m.landmarks[2, 4] = np.nan
    path = tmp_path / "person_3.trc"
    write_trc(path, m, FPS)
    frames, time_s, names, points, fields = read_trc(path)
    np.testing.assert_array_equal(frames, m.frames)
    np.testing.assert_allclose(time_s, m.time_s, atol=1e-6)
    assert tuple(names) == LANDMARKS
    np.testing.assert_allclose(world_from_y_up(points), m.landmarks, atol=1e-6)
    assert np.isnan(points[2, 4]).all()
    assert (fields["Units"], fields["DataRate"], fields["NumFrames"]) == ("m", "25", str(T))
    assert (fields["NumMarkers"], fields["OrigDataStartFrame"]) == ("15", "5")
    assert path.read_text().startswith("PathFileType\t4\t(X/Y/Z)\tperson_3.trc\n")


def test_trc_is_y_up_and_right_handed(tmp_path):
    m = motion(np.random.default_rng(1))
    m.landmarks[0, :3] = np.eye(3)  # scene x, y, z
    write_trc(tmp_path / "a.trc", m, FPS)
    _, _, _, points, _ = read_trc(tmp_path / "a.trc")
    np.testing.assert_array_equal(points[0, 2], [0, 1, 0])  # scene up is file y
    assert np.linalg.det(points[0, :3]) == 1.0


def test_trc_fills_missing_frames_with_blank_rows(tmp_path):
    m = motion(np.random.default_rng(2), frames=[4, 5, 9])
    write_trc(tmp_path / "a.trc", m, FPS)
    frames, time_s, _, points, fields = read_trc(tmp_path / "a.trc")
    np.testing.assert_array_equal(frames, range(4, 10))
    np.testing.assert_allclose(time_s, frames / FPS, atol=1e-6)
    assert fields["NumFrames"] == "6"
    np.testing.assert_array_equal(np.isnan(points).all(axis=(1, 2)), [0, 0, 1, 1, 1, 0])


def test_trc_without_frames_is_a_header(tmp_path):
    write_trc(tmp_path / "a.trc", motion(np.random.default_rng(2), frames=[]), FPS)
    assert len(read_trc(tmp_path / "a.trc")[0]) == 0


# ---------------------------------------------------------------------------------------------------- C3D


def test_c3d_round_trip(tmp_path):
    ezc3d = pytest.importorskip("ezc3d")
    m = motion(np.random.default_rng(3), frames=[5, 6, 8])
    m.landmarks[1, 7] = np.nan
    path = tmp_path / "person_3.c3d"
    write_c3d(path, m, FPS)
    c = ezc3d.c3d(str(path))
    point = c["parameters"]["POINT"]
    assert point["LABELS"]["value"] == list(LANDMARKS)
    assert (point["UNITS"]["value"], point["RATE"]["value"][0]) == (["mm"], FPS)
    assert (point["X_SCREEN"]["value"], point["Y_SCREEN"]["value"]) == (["+X"], ["+Z"])
    assert c["header"]["points"]["first_frame"] == 5
    xyz = c["data"]["points"][:3].transpose(2, 1, 0) / 1000.0
    assert xyz.shape == (4, 15, 3)
    expected = np.insert(m.landmarks, 2, np.nan, axis=0)
    known = np.isfinite(expected).all(axis=2)
    np.testing.assert_allclose(xyz[known], expected[known], atol=1e-6)
    np.testing.assert_array_equal(c["data"]["meta_points"]["residuals"][0].T == -1, ~known)


def test_c3d_without_its_package_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    with pytest.raises(MocapError, match=r"\[export\]"):
        write_c3d(tmp_path / "a.c3d", motion(np.random.default_rng(3)), FPS)
    assert not list(tmp_path.iterdir())


def test_c3d_without_frames_is_refused(tmp_path):
    pytest.importorskip("ezc3d")
    with pytest.raises(MocapError, match="no frames"):
        write_c3d(tmp_path / "a.c3d", motion(np.random.default_rng(3), frames=[]), FPS)


# ---------------------------------------------------------------------------------------------------- BVH


def axis_rotation(axis, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return {
        "X": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "Y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "Z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


def read_bvh(path):
    """World positions (T,) dicts of joint name -> (3,) in the file's axes and units, and the frame time."""
    words = path.read_text().split()
    joints, stack = [], []
    i = 1
    while words[i] != "MOTION":
        word = words[i]
        if word in ("ROOT", "JOINT"):
            joints.append({"name": words[i + 1], "parent": stack[-1] if stack else None, "channels": []})
            i += 2
        elif word == "End":
            joints.append({"name": f"{joints[stack[-1]]['name']}_end", "parent": stack[-1], "channels": []})
            i += 2
        elif word == "{":
            stack.append(len(joints) - 1)
            i += 1
        elif word == "}":
            stack.pop()
            i += 1
        elif word == "OFFSET":
            joints[stack[-1]]["offset"] = np.array([float(w) for w in words[i + 1 : i + 4]])
            i += 4
        elif word == "CHANNELS":
            n = int(words[i + 1])
            joints[stack[-1]]["channels"] = words[i + 2 : i + 2 + n]
            i += 2 + n
        else:
            raise AssertionError(word)
    assert not stack
    assert words[i + 1] == "Frames:"
    n_frames, frame_time = int(words[i + 2]), float(words[i + 5])
    n_channels = sum(len(j["channels"]) for j in joints)
    table = np.array([float(w) for w in words[i + 6 :]]).reshape(n_frames, n_channels)
    poses = []
    for row in table:
        values = iter(row)
        pose, rotation = {}, {}
        for k, joint in enumerate(joints):
            R, position = np.eye(3), joint["offset"].copy()
            for channel in joint["channels"]:
                value = next(values)
                if channel.endswith("position"):
                    position["XYZ".index(channel[0])] += value
                else:
                    R = R @ axis_rotation(channel[0], value)
            p = joint["parent"]
            parent_R = np.eye(3) if p is None else rotation[p]
            parent_x = np.zeros(3) if p is None else pose[joints[p]["name"]]
            pose[joint["name"]] = parent_x + parent_R @ position
            rotation[k] = parent_R @ R
        poses.append(pose)
    return poses, table, frame_time


def test_bvh_rebuilds_the_joints(tmp_path):
    s = skeleton(np.random.default_rng(4))
    write_bvh(tmp_path / "a.bvh", s, FPS)
    poses, _, frame_time = read_bvh(tmp_path / "a.bvh")
    assert frame_time == pytest.approx(1 / FPS)
    expected = s.global_positions()
    assert len(poses) == T
    for t, pose in enumerate(poses):
        for j, name in enumerate(s.names):
            rebuilt = world_from_animation(pose[name.replace(" ", "_")]) / 100.0
            assert np.linalg.norm(rebuilt - expected[t, j]) < TOLERANCE_M
    # Tips move with their joint: their distance from it is that of the end offset.
    for j, tip in s.end_offsets.items():
        name = s.names[j]
        length = np.linalg.norm(poses[0][f"{name}_end"] - poses[0][name]) / 100.0
        assert length == pytest.approx(np.linalg.norm(tip), abs=TOLERANCE_M)
    assert "right_knee_end" in poses[0]


def test_bvh_at_gimbal_lock(tmp_path):
    s = skeleton(np.random.default_rng(5))
    # Body axis y is the file's x at rest, the middle axis of Z X Y; the root is turned into the file's own axes.
    lock = Rotation.from_euler("yz", [[90, 30]] * J, degrees=True).as_matrix()
    s.rotations[:] = lock
    write_bvh(tmp_path / "a.bvh", s, FPS)
    poses, _, _ = read_bvh(tmp_path / "a.bvh")
    rebuilt = np.array([world_from_animation(poses[0][n.replace(" ", "_")]) / 100.0 for n in s.names])
    np.testing.assert_allclose(rebuilt, s.global_positions()[0], atol=TOLERANCE_M)


def test_bvh_curves_do_not_jump(tmp_path):
    s = skeleton(np.random.default_rng(6), n_frames=40)
    s.rotations[:] = np.eye(3)
    turn = Rotation.from_rotvec(np.linspace(0, 12, 40)[:, None] * [0, 0, 1])
    s.rotations[:, 0] = turn.as_matrix()
    write_bvh(tmp_path / "a.bvh", s, FPS)
    _, table, _ = read_bvh(tmp_path / "a.bvh")
    assert np.abs(np.diff(table[:, 3:], axis=0)).max() < 20
    assert np.ptp(table[:, 5]) == pytest.approx(np.degrees(12), abs=1e-3)


def test_unknown_frames_hold_the_last_pose(tmp_path):
    s = skeleton(np.random.default_rng(7))
    write_bvh(tmp_path / "a.bvh", with_nan(s, 0, 3, 4), FPS)
    write_bvh(tmp_path / "b.bvh", s, FPS)
    _, held, _ = read_bvh(tmp_path / "a.bvh")
    _, whole, _ = read_bvh(tmp_path / "b.bvh")
    # Compare positions: angles may differ by full turns after unwrapping.
    np.testing.assert_array_equal(held[:, :3], whole[[1, 1, 2, 2, 2, 5, 6, 7, 8], :3])
    nothing = with_nan(s, *range(T))
    write_bvh(tmp_path / "c.bvh", nothing, FPS)
    at_rest = read_bvh(tmp_path / "c.bvh")[1]
    assert (at_rest[:, 5] == 90).all()  # from facing file z to facing scene x
    assert np.count_nonzero(at_rest) == T
    write_glb(tmp_path / "c.glb", nothing, FPS)


# --------------------------------------------------------------------------------------------------- glTF


def read_glb(path):
    data = path.read_bytes()
    magic, version, total = struct.unpack_from("<4sII", data)
    assert (magic, version, total) == (b"glTF", 2, len(data))
    n, kind = struct.unpack_from("<I4s", data, 12)
    assert (kind, n % 4) == (b"JSON", 0)
    document = json.loads(data[20 : 20 + n])
    m, kind = struct.unpack_from("<I4s", data, 20 + n)
    assert (kind, m % 4) == (b"BIN\0", 0)
    binary = data[28 + n : 28 + n + m]

    def accessor(i):
        a = document["accessors"][i]
        view = document["bufferViews"][a["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[a["type"]]
        kind = {5126: "<f4", 5123: "<u2", 5125: "<u4"}[a["componentType"]]
        values = np.frombuffer(binary, kind, a["count"] * width, view["byteOffset"]).reshape(-1, width)
        if "min" in a:
            np.testing.assert_array_equal(values.min(axis=0), np.array(a["min"], np.float32))
            np.testing.assert_array_equal(values.max(axis=0), np.array(a["max"], np.float32))
        return values.astype(float)

    return document, accessor


def gltf_positions(document, accessor, n_joints):
    """World positions of the joint nodes over time from the animation alone, file axes."""
    nodes, animation = document["nodes"], document["animations"][0]
    local = {}
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        local[channel["target"]["node"], channel["target"]["path"]] = accessor(sampler["output"])
    parent = {c: i for i, node in enumerate(nodes) for c in node.get("children", [])}
    n_frames = len(accessor(animation["samplers"][0]["input"]))
    out = np.zeros((n_frames, n_joints, 3))
    for t in range(n_frames):
        for j in range(n_joints):
            x, node = np.zeros(3), j
            while node is not None and node < n_joints:
                q = local[node, "rotation"][t]
                shift = (
                    local[node, "translation"][t]
                    if (node, "translation") in local
                    else nodes[node]["translation"]
                )
                # The joint's own rotation does not move it.
                x = (Rotation.from_quat(q).apply(x) if node != j else x) + shift
                node = parent.get(node)
            out[t, j] = x
    return out


def test_glb_animation_rebuilds_the_joints(tmp_path):
    s = skeleton(np.random.default_rng(8))
    write_glb(tmp_path / "a.glb", s, FPS)
    document, accessor = read_glb(tmp_path / "a.glb")
    assert [n["name"] for n in document["nodes"][:J]] == list(s.names)
    positions = world_from_animation(gltf_positions(document, accessor, J))
    assert np.abs(positions - s.global_positions()).max() < TOLERANCE_M
    time = accessor(document["animations"][0]["samplers"][0]["input"])[:, 0]
    np.testing.assert_allclose(time, np.arange(T) / FPS, atol=1e-6)
    assert document["asset"]["extras"]["units"] == "m"


def skinned(document, accessor, joints_at):
    """Vertices moved by the joints' world transforms (J, 4, 4), file axes."""
    skin, primitive = document["skins"][0], document["meshes"][0]["primitives"][0]["attributes"]
    inverse = accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    vertices = np.column_stack(
        [accessor(primitive["POSITION"]), np.ones(len(accessor(primitive["POSITION"])))]
    )
    joints, weights = accessor(primitive["JOINTS_0"]).astype(int), accessor(primitive["WEIGHTS_0"])
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-5)
    by_joint = joints_at[joints] @ inverse[joints]
    return np.einsum("vk,vkij,vj->vi", weights, by_joint, vertices)[:, :3]


def transforms(document, accessor, frame, n_joints):
    """World transforms (J, 4, 4) of the joints in a frame, file axes, out of the animation."""
    nodes, animation = document["nodes"], document["animations"][0]
    at = {j: np.eye(4) for j in range(n_joints)}
    for j in at:
        at[j][:3, 3] = nodes[j]["translation"]
    for channel in animation["channels"]:
        value = accessor(animation["samplers"][channel["sampler"]]["output"])[frame]
        node = channel["target"]["node"]
        if channel["target"]["path"] == "rotation":
            at[node][:3, :3] = Rotation.from_quat(value).as_matrix()
        else:
            at[node][:3, 3] = value
    parent = {c: i for i, node in enumerate(nodes) for c in node.get("children", [])}

    def world(j):
        above = parent[j]
        return (world(above) if above in at else np.eye(4)) @ at[j]

    return np.array([world(j) for j in range(n_joints)])


def test_glb_stick_figure_moves_with_the_joints(tmp_path):
    s = skeleton(np.random.default_rng(9))
    write_glb(tmp_path / "a.glb", s, FPS)
    document, accessor = read_glb(tmp_path / "a.glb")
    for frame in (0, T - 1):
        moved = skinned(document, accessor, transforms(document, accessor, frame, J))
        vertices = world_from_animation(moved)
        for place in s.global_positions()[frame]:
            assert np.linalg.norm(vertices - place, axis=1).min() < TOLERANCE_M
    # Eight faces a bone, normals outwards.
    assert len(vertices) == 24 * (J - 1 + 2)


def test_glb_with_a_person_s_skin(tmp_path):
    """The skin's flesh lies about the bones in every frame, in the scene's own place, and is closed."""
    trimesh = pytest.importorskip("trimesh")
    body = scale_body(load_body_model("girdle"), 1.75)
    skin = body_skin(body)
    solid = trimesh.Trimesh(skin.vertices, skin.faces, process=False)
    assert solid.is_watertight
    assert solid.body_count == 1
    assert 0.06 < solid.volume < 0.1  # m^3 of a person of 1.75 m
    assert ((solid.vertex_normals * skin.normals).sum(axis=1) > 0.7).all()
    states = np.tile(neutral_state(body), (3, 1))
    states[:, :2] = [[1.0, 2.0], [1.5, 2.0], [2.0, 2.5]]
    states[:, body.layout.names.index("root_yaw")] = [0.0, 1.0, 2.0]
    states[2, body.layout.names.index("left_shoulder_x")] = 0.3
    write_glb(tmp_path / "a.glb", skeleton_of(body, states, 1), FPS, skin)
    document, accessor = read_glb(tmp_path / "a.glb")
    for frame, state in enumerate(states):
        moved = skinned(document, accessor, transforms(document, accessor, frame, len(body.joints)))
        vertices = world_from_animation(moved)
        ends = cones_of(body, state)
        distance = cone_distances(vertices, ends[0], ends[1], body.cones.radii, True).min(axis=1)
        assert np.quantile(np.abs(distance), 0.9) < 0.02
        assert abs(distance).max() < 0.12  # at bends


def test_bones_are_called_as_in_other_rigs(tmp_path):
    body = scale_body(load_body_model("girdle"), 1.75)
    s = skeleton_of(body, neutral_state(body)[None], 1)
    assert renamed(s, "mocap") is s
    for bones, left_arm in (
        ("mixamo", "mixamorig:LeftArm"),
        ("vrm", "leftUpperArm"),
        ("unreal", "upperarm_l"),
    ):
        names = renamed(s, bones).names
        assert names[s.names.index("left_shoulder")] == left_arm
        assert len(set(names)) == len(names)
        write_bvh(tmp_path / "a.bvh", renamed(s, bones), FPS)
        assert f"JOINT {left_arm}" in (tmp_path / "a.bvh").read_text()


def test_hands_turn_as_they_did_in_a_rig_whose_forearms_do_not_pronate():
    body = scale_body(load_body_model("whole"), 1.75)
    state = neutral_state(body)
    for name, angle in (("left_elbow_z", -0.7), ("left_forearm_y", 0.6), ("left_wrist_x", -0.5)):
        state[body.layout.names.index(name)] = angle
    own = skeleton_of(body, state[None], 1)
    other = renamed(own, "mixamo")
    forearm, wrist = own.names.index("left_forearm"), own.names.index("left_wrist")
    assert other.rotations[:, forearm] == pytest.approx(np.eye(3)[None], abs=1e-12)
    assert other.global_positions() == pytest.approx(own.global_positions(), abs=1e-9)
    turn = own.rotations[0, forearm] @ own.rotations[0, wrist]
    assert other.rotations[0, wrist] == pytest.approx(turn, abs=1e-12)
    assert not np.allclose(own.rotations[0, wrist], turn, atol=0.1)


BLENDER = """
import bpy, json, sys
path, kind = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 25
if kind == "bvh":
    bpy.ops.import_anim.bvh(filepath=path, global_scale=0.01, frame_start=0)
else:
    bpy.ops.import_scene.gltf(filepath=path)
armature = next(o for o in bpy.data.objects if o.type == "ARMATURE")
found = []
first = 1 if kind == "bvh" else 0  # where Blender puts the first frame
for frame in range(9):
    bpy.context.scene.frame_set(first + frame)
    found.append({b.name: list((armature.matrix_world @ b.matrix).translation) for b in armature.pose.bones})
print("FOUND" + json.dumps(found))
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["bvh", "glb"])
def test_blender_shows_the_joints_where_they_were(tmp_path, kind):
    """Blender reads our file into an armature whose bones stand in the scene's places, to 0.1 mm."""
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("bpy is not installed: the extra `blender`")
    s = skeleton(np.random.default_rng(4))
    path = tmp_path / f"a.{kind}"
    (write_bvh if kind == "bvh" else write_glb)(path, s, FPS)
    said = subprocess.run(
        [sys.executable, "-c", BLENDER, str(path), kind],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    found = json.loads(said.stdout.split("FOUND")[1].splitlines()[0])
    expected = s.global_positions()
    for t, bones in enumerate(found):
        for j, name in enumerate(s.names):
            place = bones[name.replace(" ", "_") if kind == "bvh" else name]
            assert np.linalg.norm(np.array(place) - expected[t, j]) < TOLERANCE_M


def test_glb_rotations_take_the_short_way(tmp_path):
    s = skeleton(np.random.default_rng(10), n_frames=60)
    turn = Rotation.from_rotvec(np.linspace(0, 14, 60)[:, None] * [0.6, 0, 0.8]).as_matrix()
    s.rotations[:] = turn[:, None]
    write_glb(tmp_path / "a.glb", s, FPS)
    document, accessor = read_glb(tmp_path / "a.glb")
    for sampler in document["animations"][0]["samplers"][1:]:
        q = accessor(sampler["output"])
        assert (q[1:] * q[:-1]).sum(axis=1).min() > 0.9


def test_glb_without_frames_stands_at_rest(tmp_path):
    s = skeleton(np.random.default_rng(11), n_frames=0)
    write_glb(tmp_path / "a.glb", s, FPS)
    document, _ = read_glb(tmp_path / "a.glb")
    assert "animations" not in document
    trimesh = pytest.importorskip("trimesh")
    assert len(trimesh.load(tmp_path / "a.glb", force="scene").geometry) == 1


# ------------------------------------------------------------------------------------------- all of them


def writers():
    rng = np.random.default_rng(12)
    m, s = motion(rng), skeleton(rng)
    return {".trc": (write_trc, m), ".c3d": (write_c3d, m), ".bvh": (write_bvh, s), ".glb": (write_glb, s)}


@pytest.mark.parametrize("suffix", EXPORT_CONVENTIONS)
def test_same_input_same_bytes(tmp_path, suffix):
    if suffix == ".c3d":
        pytest.importorskip("ezc3d")
    write, what = writers()[suffix]
    (tmp_path / "again").mkdir()
    first, second = tmp_path / f"a{suffix}", tmp_path / "again" / f"a{suffix}"
    write(first, what, FPS)
    write(second, what, FPS)
    assert first.read_bytes() == second.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"a{suffix}", "again"]


@pytest.mark.parametrize("suffix", EXPORT_CONVENTIONS)
def test_unwritable_place_is_named_and_leaves_nothing(tmp_path, suffix):
    if suffix == ".c3d":
        pytest.importorskip("ezc3d")
    write, what = writers()[suffix]
    path = tmp_path / "missing" / f"a{suffix}"
    with pytest.raises(MocapError, match="Remedy") as caught:
        write(path, what, FPS)
    assert caught.value.path == path
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", EXPORT_CONVENTIONS)
def test_wrong_frame_rate_is_named(tmp_path, suffix):
    write, what = writers()[suffix]
    for fps in (0.0, float("nan")):
        with pytest.raises(ValueError, match="fps"):
            write(tmp_path / f"a{suffix}", what, fps)


def test_joints_that_are_no_tree_are_refused(tmp_path):
    s = skeleton(np.random.default_rng(13))
    two_roots = Skeleton(
        1, s.names, np.array([-1, -1, 0, 1, 2, 0, 5]), s.offsets, {}, s.rotations, s.root_position
    )
    for write in (write_bvh, write_glb):
        with pytest.raises(ValueError, match="one root"):
            write(tmp_path / "a", two_roots, FPS)
