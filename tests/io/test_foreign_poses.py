"""Poses of other tools: every format against what wrote it or by hand, and what is said of broken files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap.compare.units import length_unit
from mocap.data import LANDMARKS, Motion, Skeleton
from mocap.errors import MocapError
from mocap.io.actions import read_actions_csv
from mocap.io.formats import read_poses, write_bvh, write_c3d, write_trc
from mocap.io.poses import SideMap, read_map, read_motions, skeletons_known
from mocap.io.poses.maps import SKELETONS, automatic
from mocap.io.poses.motions import _WORLD_FROM
from mocap.io.tables import write_landmarks_csv
from mocap.io.units import AXES

AT = LANDMARKS.index
FPS = 25.0


def motion(T: int = 7, first: int = 3, seed: int = 0) -> Motion:
    rng = np.random.default_rng(seed)
    frames = np.arange(first, first + T)
    landmarks = rng.normal([1.0, 2.0, 1.0], 0.4, (T, 15, 3))
    landmarks[1, 4] = np.nan
    return Motion(2, frames, frames / FPS, landmarks)


def only(path: Path, side: SideMap | None = None) -> Motion:
    (found,) = read_motions(read_poses(path), side).motions
    return found


# ------------------------------------------------------------------------------------------- what we write ourselves


def test_our_own_exports_come_back(tmp_path: Path) -> None:
    pytest.importorskip("ezc3d")
    m = motion()
    write_trc(tmp_path / "person_2.trc", m, FPS)
    write_c3d(tmp_path / "person_2.c3d", m, FPS)
    write_landmarks_csv(tmp_path / "landmarks.csv", [m])
    for name, unit in (("person_2.trc", "m"), ("person_2.c3d", "mm"), ("landmarks.csv", "m")):
        reading = read_motions(read_poses(tmp_path / name))
        assert reading.unit == unit
        assert reading.fps == pytest.approx(FPS)
        assert reading.skeleton == "mocap"
        (found,) = reading.in_metres(unit).motions
        assert found.person == 2
        np.testing.assert_array_equal(found.frames, m.frames)
        np.testing.assert_allclose(found.time_s, m.time_s, atol=1e-6)
        np.testing.assert_allclose(found.landmarks, m.landmarks, atol=2e-6)


def test_deviations_of_our_table_come_along_and_turn_with_the_axes(tmp_path: Path) -> None:
    m = motion()
    std = np.random.default_rng(1).uniform(0.01, 0.05, m.landmarks.shape)
    write_landmarks_csv(tmp_path / "a.csv", [Motion(1, m.frames, m.time_s, m.landmarks, std)])
    found = only(tmp_path / "a.csv")
    assert found.std is not None
    np.testing.assert_allclose(found.std, std, atol=1e-6)
    turned = only(tmp_path / "a.csv", SideMap(up="-y"))
    assert turned.std is not None
    np.testing.assert_allclose(turned.std, std[..., [2, 0, 1]], atol=1e-6)
    in_cm = read_motions(read_poses(tmp_path / "a.csv"), SideMap(unit="cm")).in_metres("cm").motions[0]
    assert in_cm.std is not None
    np.testing.assert_allclose(in_cm.std, 0.01 * std, atol=1e-8)


def test_bvh_agrees_with_the_skeleton_that_was_written(tmp_path: Path) -> None:
    """Two ways to the places of the joints: ours from matrices, the reader's from Euler angles in a text."""
    rng = np.random.default_rng(3)
    names = ("root", "spine", "left hip", "head", "left_knee")
    skeleton = Skeleton(
        person=4,
        names=names,
        parents=np.array([-1, 0, 0, 1, 2]),
        offsets=rng.normal(0, 0.3, (5, 3)),
        end_offsets={3: np.array([0.0, 0.0, 0.2]), 4: np.array([0.1, 0.0, -0.3])},
        rotations=Rotation.random(6 * 5, rng=rng).as_matrix().reshape(6, 5, 3, 3),
        root_position=rng.normal(0, 1, (6, 3)),
    )
    write_bvh(tmp_path / "person_4.bvh", skeleton, FPS)
    poses = read_poses(tmp_path / "person_4.bvh")
    (table,) = poses.people
    assert poses.world_from_file is not None
    expected = skeleton.global_positions()
    found = table.xyz @ poses.world_from_file.T / 100.0
    for j, name in enumerate(names):
        at = table.names.index(name.replace(" ", "_"))
        np.testing.assert_allclose(found[:, at], expected[:, j], atol=2e-7, err_msg=name)
    assert "head_end" in table.names
    tip = np.linalg.norm(
        found[:, table.names.index("head_end")] - found[:, table.names.index("head")], axis=1
    )
    np.testing.assert_allclose(tip, 0.2, atol=1e-6)


# --------------------------------------------------------------------------------------------------- other dialects

BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 5 6 7
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT LeftArm
  {
    OFFSET 0 10 0
    CHANNELS 6 Xposition Yposition Zposition Xrotation Yrotation Zrotation
    JOINT Left Hand
    {
      OFFSET 20 0 0
      CHANNELS 1 Yrotation
      End Site
      {
        OFFSET 0 0 5
      }
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
1 2 3 0 0 0   0 10 0 0 0 0   0
1 2 3 90 0 0   0 12 0 0 0 0   90
"""


def test_bvh_by_hand(tmp_path: Path) -> None:
    """Positions replace offsets, channels come in any order and number, names may hold blanks."""
    path = tmp_path / "walk_P3.bvh"
    path.write_text(BVH)
    poses = read_poses(path)
    (table,) = poses.people
    assert table.names == ("Hips", "LeftArm", "Left Hand", "Left Hand_end")
    assert (poses.fps, poses.unit, poses.up, table.person) == (pytest.approx(25.0), None, "y", 3)
    # Second frame: z by 90 degrees sends the file's y to -x and x to y; the hand's own y by 90 sends z to x.
    np.testing.assert_allclose(table.xyz[0], [[1, 2, 3], [1, 12, 3], [21, 12, 3], [21, 12, 8]], atol=1e-12)
    np.testing.assert_allclose(table.xyz[1], [[1, 2, 3], [-11, 2, 3], [-11, 22, 3], [-11, 27, 3]], atol=1e-12)


def test_trc_with_millimetres_blanks_zeros_and_short_rows(tmp_path: Path) -> None:
    path = tmp_path / "take_P1_0-90.trc"
    path.write_text(
        "PathFileType\t4\t(X/Y/Z)\ttake.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n"
        "60\t60\t3\t2\tmm\nFrame#\tTime\tLHip\t\t\tRHip\t\t\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n"
        "1\t0.0\t1\t2\t3\t4\t5\t6\n2\t0.0167\t\t\t\t0\t0\t0\n3\t\t7\t8\t9\n"
    )
    poses = read_poses(path)
    (table,) = poses.people
    assert (poses.unit, poses.fps, poses.up, table.person) == ("mm", 60.0, "y", 1)
    assert poses.notes == ("1 point at exactly (0, 0, 0) taken as not seen",)
    np.testing.assert_array_equal(table.frames, [1, 2, 3])
    assert table.time_s[2] == pytest.approx(0.05)
    np.testing.assert_array_equal(table.xyz[0], [[1, 2, 3], [4, 5, 6]])
    assert np.isnan(table.xyz[1]).all()
    np.testing.assert_array_equal(table.xyz[2, 0], [7, 8, 9])


def test_c3d_of_a_laboratory(tmp_path: Path) -> None:
    """Labels with a subject's prefix, y up by Y_SCREEN, lost points, frames from 12."""
    ezc3d = pytest.importorskip("ezc3d")
    c3d = ezc3d.c3d()
    c3d["parameters"]["POINT"]["RATE"]["value"] = [120.0]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = ["Bob:LKNE", "Bob:RKNE"]
    c3d["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    c3d.add_parameter("POINT", "Y_SCREEN", ["+Y"])
    c3d["header"]["points"]["first_frame"] = 12
    points = np.ones((4, 2, 5))
    points[:3] = np.arange(30).reshape(3, 2, 5) + 1
    c3d["data"]["points"] = points
    residuals = np.zeros((1, 2, 5))
    residuals[0, 1, 3] = -1
    c3d["data"]["meta_points"]["residuals"] = residuals
    c3d.write(str(tmp_path / "a.c3d"))
    poses = read_poses(tmp_path / "a.c3d")
    (table,) = poses.people
    assert table.names == ("LKNE", "RKNE")
    assert (poses.fps, poses.unit, poses.up) == (120.0, "mm", "y")
    np.testing.assert_array_equal(table.frames, np.arange(12, 17))
    np.testing.assert_allclose(table.xyz[2, 0], points[:3, 0, 2])
    assert np.isnan(table.xyz[3, 1]).all()
    assert np.isfinite(table.xyz[3, 0]).all()


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("frame,time,LHip_x,LHip_y,LHip_z,RHip_x,RHip_y,RHip_z,index", None),
        ("frame;time;LHip.X;LHip.Y;LHip.Z;RHip.X;RHip.Y;RHip.Z;x", None),
        ("frame,time,LHip_x_mm,LHip_y_mm,LHip_z_mm,RHip_x_mm,RHip_y_mm,RHip_z_mm,score", "mm"),
        ("fnum,t,LHipX,LHipY,LHipZ,RHipX,RHipY,RHipZ,fox", None),
    ],
)
def test_wide_tables(tmp_path: Path, header: str, unit: str | None) -> None:
    between = ";" if ";" in header else ","
    rows = ["4,0.2,1,2,3,4,5,6,9", "5,0.25,1,2,,4,5,nan,9"]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([header, *(r.replace(",", between) for r in rows)]) + "\n")
    poses = read_poses(path)
    (table,) = poses.people
    assert (table.names, poses.unit, poses.up) == (("LHip", "RHip"), unit, "z")
    assert poses.fps == pytest.approx(20.0)
    np.testing.assert_array_equal(table.frames, [4, 5])
    np.testing.assert_array_equal(table.xyz[0], [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(np.isnan(table.xyz[1]), [[False, False, True]] * 2)


def test_wide_table_of_two_persons_without_frames_is_counted_and_said(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("person,a_x,a_y,a_z\n1,1,2,3\n7,4,5,6\n1,7,8,9\n")
    poses = read_poses(path)
    assert [t.person for t in poses.people] == [1, 7]
    assert "no column `frame`" in poses.notes[0]
    np.testing.assert_array_equal(poses.people[0].frames, [0, 2])
    assert poses.fps is None


def panoptic(folder: Path, frames: dict[int, dict[int, np.ndarray]]) -> None:
    folder.mkdir(parents=True)
    for frame, bodies in frames.items():
        said = [{"id": p, "joints19": np.ravel(joints).tolist()} for p, joints in bodies.items()]
        text = json.dumps({"version": 0.7, "univTime": 53.5, "bodies": said})
        (folder / f"body3DScene_{frame:08d}.json").write_text(text)


def test_panoptic_folder(tmp_path: Path) -> None:
    """y points down, in centimetres; a joint without confidence is unknown."""
    joints = np.zeros((19, 4))
    joints[:, 3] = 0.5
    joints[0, :3] = [10, -140, 20]  # neck, 1.4 m above the floor
    joints[6, :3], joints[12, :3] = [10, -90, 30], [10, -90, 10]  # hips
    joints[5, 3] = -1.0  # left wrist
    panoptic(tmp_path / "seq" / "hdPose3d_stage1_coco19", {100: {0: joints, 3: joints}, 102: {3: joints}})
    poses = read_poses(tmp_path / "seq")
    reading = read_motions(poses).in_metres("cm")
    assert [m.person for m in reading.motions] == [0, 3]
    assert (reading.fps, poses.unit, reading.skeleton) == (29.97, "cm", "OpenPose, Pose2Sim, Panoptic")
    m = reading.motions[1]
    np.testing.assert_array_equal(m.frames, [100, 102])
    np.testing.assert_allclose(m.landmarks[0, AT("neck")], [0.1, 0.2, 1.4])
    np.testing.assert_allclose(m.landmarks[0, AT("pelvis")], [0.1, 0.2, 0.9])
    assert np.isnan(m.landmarks[0, AT("left_wrist")]).all()
    assert "head" not in reading.landmarks  # a nose is no top of the head
    single = read_poses(tmp_path / "seq" / "hdPose3d_stage1_coco19" / "body3DScene_00000102.json")
    np.testing.assert_array_equal(single.people[0].frames, [102])


# ------------------------------------------------------------------------------------------------------- skeletons

NAMES = {
    "CMU BVH, Mixamo": "Hips LHipJoint LeftUpLeg LeftLeg LeftFoot RightUpLeg RightLeg RightFoot Spine Neck Head "
    "Head_end LeftShoulder LeftArm LeftForeArm LeftHand RightShoulder RightArm RightForeArm RightHand",
    "SMPL": "Pelvis L_Hip R_Hip L_Knee R_Knee L_Ankle R_Ankle Neck L_Collar R_Collar Head L_Shoulder R_Shoulder "
    "L_Elbow R_Elbow L_Wrist R_Wrist",
    "COCO, MediaPipe": "nose left_eye left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist "
    "left_hip right_hip left_knee right_knee left_ankle right_ankle",
    "OpenPose, Pose2Sim, Panoptic": "Hip RHip RKnee RAnkle LHip LKnee LAnkle Neck Head Nose RShoulder RElbow RWrist "
    "LShoulder LElbow LWrist",
    "Plug-in Gait markers": "LFHD RFHD LBHD RBHD C7 CLAV LSHO LELB LWRA LWRB RSHO RELB RWRA RWRB LASI RASI LPSI RPSI "
    "LKNE RKNE LANK RANK",
    "mocap": " ".join(LANDMARKS),
    "mocap BVH": "root waist neck neck_end right_shoulder right_elbow right_elbow_end left_shoulder left_elbow "
    "left_elbow_end right_hip right_knee right_knee_end left_hip left_knee left_knee_end",
}
LEFT_OUT = {
    "SMPL": {"head"},
    "COCO, MediaPipe": {"head"},
    "Plug-in Gait markers": {"left_hip", "right_hip"},
}


@pytest.mark.parametrize("name", NAMES)
def test_skeletons_are_known_by_their_names(name: str) -> None:
    found = automatic(NAMES[name].split())
    assert found is not None
    assert found[0].name == name
    assert set(LANDMARKS) - set(found[1]) == LEFT_OUT.get(name, set())
    for landmark, sources in found[1].items():
        side = landmark.partition("_")[0]
        if side in ("left", "right"):
            assert all(s.lower()[0] == side[0] for s in sources), (landmark, sources)


def test_every_known_skeleton_is_found_by_what_it_asks_for() -> None:
    for skeleton in SKELETONS:
        names = [n for text in skeleton.sources().values() for n in text.split("|")[0].split("+")]
        found = automatic([*names, *skeleton.needs])
        assert found is not None
        assert found[0].name == skeleton.name
        assert set(found[1]) == set(skeleton.sources())
    assert len(skeletons_known()) == len(set(skeletons_known()))
    assert automatic(["a", "b", "left_knee"]) is None


@pytest.mark.shared
def test_a_recorded_walk_on_a_character_rig() -> None:
    """A body whose thighs keep their length, upright, with its left side on its left as it walks."""
    path = Path(__file__).resolve().parents[3] / "shared" / "motions" / "07_12_characterrig.bvh"
    if not path.exists():
        pytest.skip("the recorded motions are not beside the checkout")
    reading = read_motions(read_poses(path))
    assert (reading.skeleton, reading.fps) == ("Character Creator", pytest.approx(60.0, abs=0.1))
    assert length_unit(reading.motions[0].landmarks) == "cm"
    x = reading.in_metres("cm").motions[0].landmarks
    thigh = np.linalg.norm(x[:, AT("left_knee")] - x[:, AT("left_hip")], axis=1)
    assert np.ptp(thigh) < 1e-3
    assert 0.3 < thigh[0] < 0.6
    assert (x[:, AT("neck"), 2] - x[:, AT("left_ankle"), 2]).min() > 0.9
    walked = x[-1, AT("pelvis")] - x[0, AT("pelvis")]
    left = (x[:, AT("left_hip")] - x[:, AT("right_hip")]).mean(axis=0)
    assert np.cross(walked, left)[2] > 0


def test_the_clavicle_of_a_bvh_is_not_its_shoulder() -> None:
    found = automatic(["mixamorig:" + n for n in NAMES["CMU BVH, Mixamo"].split()])
    assert found is not None
    assert found[1]["left_shoulder"] == ("mixamorig:LeftArm",)


@pytest.mark.parametrize("up", AXES)
def test_every_up_axis_is_a_rotation_that_sends_it_up(up: str) -> None:
    R = np.array(_WORLD_FROM[up], dtype=np.float64)
    np.testing.assert_allclose(R @ R.T, np.eye(3))
    assert np.linalg.det(R) == pytest.approx(1.0)
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1.0 if up.startswith("-") else 1.0
    np.testing.assert_array_equal(R @ axis, [0, 0, 1])


def test_a_map_takes_means_and_leaves_the_rest_out(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("frame,A_x,A_y,A_z,b c_x,b c_y,b c_z\n0,0,0,1,2,4,6\n1,5,5,5,,,\n")
    (tmp_path / "m.toml").write_text(
        '[estimate]\nunit = "mm"\nup = "y"\nfps = 50\n[estimate.landmarks]\npelvis = ["a", "b_c"]\nhead = "A"\n'
    )
    sides = read_map(tmp_path / "m.toml")
    assert sides["truth"] == SideMap()
    reading = read_motions(read_poses(path), sides["estimate"])
    assert (reading.unit, reading.unit_from, reading.fps, reading.landmarks) == (
        "mm",
        "user",
        50.0,
        ("pelvis", "head"),
    )
    (m,) = reading.in_metres("mm").motions
    np.testing.assert_allclose(m.landmarks[0, AT("pelvis")], [0.0035, 0.001, 0.002])
    assert np.isnan(m.landmarks[1, AT("pelvis")]).all()
    np.testing.assert_allclose(m.landmarks[1, AT("head")], 0.005)
    np.testing.assert_allclose(m.time_s, [0.0, 0.02])


# -------------------------------------------------------------------------------------------------------- bad files


def broken_bvh(old: str, new: str) -> str:
    assert old in BVH
    return BVH.replace(old, new, 1)


TRC = "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tUnits\tNumMarkers\n30\tm\t1\nFrame#\tTime\tLHip\t\t\n\t\tX1\tY1\tZ1\n"
BAD = [
    ("a.trc", "x\ty\n", "line 1: not a TRC file"),
    ("a.trc", TRC + "0\t0\t1\tred\t3\n", "line 6: a cell is 'red', not a number"),
    ("a.trc", TRC + "0.5\t0\t1\t2\t3\n", "line 6: the frame is '0.5', not a whole number"),
    ("a.trc", TRC + "1e300\t0\t1\t2\t3\n", "line 6: the frame is '1e300', not a whole number"),
    ("a.bvh", broken_bvh("1 2 3 0", "1 2 1e999 0"), "a number that is not finite"),
    ("a.bvh", broken_bvh("OFFSET 20 0 0", "OFFSET 20 inf 0"), "OFFSET of Left Hand is not three numbers"),
    ("a.csv", "frame,a_x,a_y,a_z\n1e40,1,2,3\n", "line 2: frame is '1e40', not a whole number"),
    ("a.trc", TRC + "0\t0\t1\t2\t3\t4\n", "line 6: 6 cells, expected at most 5"),
    ("a.trc", TRC + "3\t0\t1\t2\t3\n3\t0\t1\t2\t3\n", "line 7: frame 3 does not follow 3"),
    ("a.trc", TRC.replace("\t1\n", "\t2\n", 1), "line 4: 1 markers are named, the header says 2"),
    ("a.trc", TRC, "the file holds no frames"),
    ("a.trc", TRC.replace("LHip\t\t", "LHip\t\t\tLHip\t\t").replace("\t1\n", "\t2\n", 1), "named twice"),
    ("a.bvh", "hello", "not a BVH file"),
    ("a.bvh", broken_bvh("Frames: 2", "Frames: 3"), "26 numbers, expected 3 frames of 13 channels"),
    ("a.bvh", broken_bvh("Frame Time: 0.04", "Frame Time: 0"), "make no sense"),
    ("a.bvh", broken_bvh("Frames: 2\n", ""), "Frames or Frame Time is missing"),
    ("a.bvh", broken_bvh("1 2 3 0", "1 2 x 0"), "what is not a number"),
    ("a.bvh", broken_bvh("1 Yrotation", "1 Wrotation"), "CHANNELS of Left Hand are not understood"),
    ("a.bvh", broken_bvh("OFFSET 20 0 0", "OFFSET 20 zero 0"), "OFFSET of Left Hand is not three numbers"),
    ("a.bvh", broken_bvh("}\n}\nMOTION", "}\nMOTION"), "the hierarchy ends too early"),
    ("a.bvh", broken_bvh("HIERARCHY", "HIERARCHY {"), "not expected in the hierarchy"),
    ("a.csv", "frame,alpha\n0,1\n", "no point was found"),
    ("a.csv", "", "no point was found"),
    ("a.csv", "frame,a_x,a_y,a_z\n0,1,2\n", "line 2: 3 fields, expected 4"),
    ("a.csv", "frame,a_x,a_y,a_z\n0,1,2,red\n", "line 2: a_z is 'red', not a number"),
    ("a.csv", "frame,a_x,a_y,a_z\n0,1,2,inf\n", "line 2: a_z is infinite"),
    ("a.csv", "frame,a_x,a_y,a_z\n0,1,2,3\n0,1,2,3\n", "line 3: frame 0 of person 0 is there twice"),
    ("a.csv", "frame,a_x,a_y,a_z\n", "the file holds no frames"),
    ("a.c3d", "no C3D at all", "not a C3D file"),
    ("a.c3d", "\x02\x50" + "x" * 2000, "cannot be read"),
    ("a.json", "{", "not valid JSON"),
    ("a.json", "[]", "no list `bodies`"),
    ("a.json", '{"bodies": [{"id": 0}]}', "lacks `id`, or `joints19`"),
    ("a.json", '{"bodies": [{"id": 0, "joints19": [1, 2]}]}', "2 numbers, expected 4 per joint"),
    ("a.json", '{"bodies": []}', "the file holds no frames"),
    ("a.mat", "x", "MAT files of HumanEva"),
    ("a.fbx", "x", "the format .fbx is not read"),
]


@pytest.mark.parametrize(("name", "text", "message"), BAD, ids=lambda v: str(v)[:24])
def test_a_broken_file_is_named_with_what_is_wrong(
    tmp_path: Path, name: str, text: str, message: str
) -> None:
    if name == "a.c3d":
        pytest.importorskip("ezc3d")
    (tmp_path / name).write_text(text)
    with pytest.raises(MocapError) as caught:
        read_poses(tmp_path / name)
    assert message in str(caught.value)
    assert name in str(caught.value)
    assert caught.value.remedy


SAMPLES = {
    "a.trc": TRC + "0\t0.0\t1\t2\t3\n1\t0.1\t\t\t\n",
    "a.bvh": BVH,
    "a.csv": "frame,time,person,LHip_x,LHip_y,LHip_z\n0,0.0,1,1,2,3\n1,0.1,1,,,\n",
    "a.json": json.dumps({"bodies": [{"id": 1, "joints15": [0.5] * 60}]}),
}


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(sorted(SAMPLES)), st.data())
def test_damaged_files_are_read_or_refused_and_nothing_else(
    tmp_path: Path, name: str, data: st.DataObject
) -> None:
    """Some bytes cut out, some put in: a reading or one clear error, never another exception or a warning."""
    text = SAMPLES[name]
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text)))
        cut = data.draw(st.integers(0, 6))
        new = data.draw(st.text(st.sampled_from('0123456789.-+eE,;\t\n {}[]"naifINF²٣xyzR\x00'), max_size=6))
        text = text[:at] + new + text[at + cut :]
    (tmp_path / name).write_text(text, encoding="utf-8")
    refused = None
    motions: tuple[Motion, ...] = ()
    try:
        poses = read_poses(tmp_path / name)
        motions = read_motions(poses, SideMap({"pelvis": poses.people[0].names[:1]})).motions
    except MocapError as error:
        refused = error
    assert (refused is None) == bool(motions)
    assert refused is None or (refused.remedy and name in str(refused))
    assert not any(np.isinf(m.landmarks).any() for m in motions)


def test_files_that_are_not_there_and_folders_without_poses(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="no such file"):
        read_poses(tmp_path / "a.trc")
    with pytest.raises(MocapError, match="the folder holds no poses"):
        read_poses(tmp_path)
    (tmp_path / "b.trc").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MocapError, match="not text"):
        read_poses(tmp_path / "b.trc")
    (tmp_path / "c.csv").write_text("frame,a_x,a_y,a_z\n0,1,2,3\n")
    with pytest.raises(MocapError, match=r"no known skeleton: a.*--map"):
        read_motions(read_poses(tmp_path / "c.csv"))
    with pytest.raises(MocapError, match="takes head from 'Kopf', which the file does not have; it has a"):
        read_motions(read_poses(tmp_path / "c.csv"), SideMap({"head": ("Kopf",)}))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[estimat]\n", "estimat is not known"),
        ("estimate = 3\n", "estimate must be a table"),
        ("[truth]\nunits = 'mm'\n", "truth.units is not known"),
        ("[truth]\nunit = 'inch'\n", "truth.unit is 'inch'"),
        ("[truth]\nup = 'w'\n", "truth.up is 'w'"),
        ("[truth]\nfps = -3\n", "truth.fps is -3"),
        ("[truth]\nfps = true\n", "truth.fps is True"),
        ("[truth.landmarks]\nnose = 'a'\n", "truth.landmarks.nose is not a landmark"),
        ("[truth.landmarks]\nhead = []\n", "truth.landmarks.head must be a name or a list"),
        ("[truth]\nlandmarks = 'a'\n", "truth.landmarks must be a table"),
        ("[truth\n", "not valid TOML"),
    ],
)
def test_a_wrong_map_is_named_by_its_key(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "m.toml").write_text(text)
    with pytest.raises(MocapError) as caught:
        read_map(tmp_path / "m.toml")
    assert message in str(caught.value)
    with pytest.raises(MocapError, match="cannot be read"):
        read_map(tmp_path / "nowhere.toml")


def test_actions(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("first_frame,last_frame,action,person\n0,9,walk,\n5,20,jump,2\n")
    assert read_actions_csv(path) == [("walk", 0, 9, None), ("jump", 5, 20, 2)]
    for text, message in (
        ("first_frame,last_frame,action\n9,3,walk\n", "line 2: the last frame 3 is before the first 9"),
        ("first_frame,last_frame,action\n1,3, \n", "line 2: action is empty"),
        ("first_frame,last_frame,action\n", "lists no action"),
        ("first_frame,action\n1,a\n", "column last_frame is missing"),
        ("first_frame,last_frame,action\n1,x,a\n", "last_frame is 'x'"),
    ):
        path.write_text(text)
        with pytest.raises(MocapError, match=message):
            read_actions_csv(path)
