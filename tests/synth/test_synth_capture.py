"""Capture files: what is read, what is refused, and that our figures move as the source did."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mocap.errors import MocapError
from mocap.io.formats.bvh import write_bvh
from mocap.synth.body import build_body
from mocap.synth.capture import built_in_maps, read_amc, read_bvh, read_capture, read_map
from mocap.synth.capture.retarget import _swing
from mocap.synth.figure import JOINT, JOINTS, Figure, forward_kinematics, make_figure, skeleton_of
from mocap.synth.motions import MOTIONS, Pose, Stop
from mocap.synth.motions.kit import hinged_frames
from mocap.synth.scene import load_scene

Array = NDArray[np.float64]

MOTIONS_DIR = Path(__file__).resolve().parents[3] / "shared" / "motions"
FPS = 50.0
MAX_LEG_DEG = 8.0  # holding feet still turns the legs a little
MAX_ARM_DEG = 0.5  # arms are copied; rounding in the file
MAX_SLIDE_M = 0.010
FLOOR_M = -0.015  # toes that curl in the source, heels that strike

# Two bones of length 2 and 1 along y, the second with a frame of its own turned by 90 degrees about z.
ASF = """# comment
:version 1.10
:name tiny
:units
  mass 1.0
  length 0.45
  angle deg
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name upper
     direction 0 1 0
     length 2
     axis 0 0 0  XYZ
     dof rx ry rz
     limits (-160.0 20.0)
            (-70.0 70.0)
            (-60.0 70.0)
  end
  begin
     id 2
     name lower
     direction 0 1 0
     length 1
     axis 0 0 90  XYZ
     dof rx
  end
  begin
     id 3
     name tip
     direction 1 0 0
     length 0.5
     axis 0 0 0 XYZ
  end
:hierarchy
  begin
    root upper
    upper lower
    lower tip
  end
"""
AMC = """:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 0 0 90
upper 0 0 0
lower 0
2
root 0 0 0 0 0 0
upper 90 0 90
lower 30
"""
BVH = """HIERARCHY
ROOT hip
{
  OFFSET 5 6 7
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT left leg
  {
    OFFSET 1 0 0
    CHANNELS 3 Yrotation Zrotation Xrotation
    End Site
    {
      OFFSET 0 -1 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.025
0 0 0 0 0 0 0 0 0
1 2 3 90 0 0 0 90 90
"""


def _tiny(tmp_path: Path, asf: str = ASF, amc: str = AMC) -> Path:
    (tmp_path / "07.asf").write_text(asf, encoding="utf-8")
    path = tmp_path / "07_02.amc"
    path.write_text(amc, encoding="utf-8")
    return path


def test_bvh_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    path.write_text(BVH, encoding="utf-8")
    found = read_bvh(path)
    assert found.names == ("hip", "left leg")
    assert found.fps == pytest.approx(40.0)
    position, rotation = found.world()
    # The channels of the root hold its place; a quarter turn about z takes x to y.
    assert np.allclose(position[0], [[0, 0, 0], [1, 0, 0]])
    assert np.allclose(position[1], [[1, 2, 3], [1, 3, 3]])
    # Ry(0) Rz(90) Rx(90): y goes to z under x and stays there under z.
    assert np.allclose(rotation[1, 0].T @ rotation[1, 1] @ [0, 1, 0], [0, 0, 1])
    assert np.allclose(rotation[1, 0].T @ rotation[1, 1] @ [0, 0, 1], [1, 0, 0])


def test_amc_by_hand(tmp_path: Path) -> None:
    found = read_amc(_tiny(tmp_path))
    assert found.names == ("root", "upper", "lower", "tip")
    assert found.fps is None
    assert np.allclose(found.at_rest().world()[0][0], [[0, 0, 0], [0, 0, 0], [0, 2, 0], [0, 3, 0]])
    position, _ = found.world()
    assert np.allclose(position[0], [[1, 2, 3], [1, 2, 3], [-1, 2, 3], [-2, 2, 3]])
    # rx 90 then rz 90 about fixed axes: y -> z -> z; the bone stands along z.
    assert np.allclose(position[1, 2], [0, 0, 2])
    # The lower bone turns by 30 degrees about its own x axis, which lies along y of the skeleton; y is that
    # axis, so the bone along y keeps its direction.
    assert np.allclose(position[1, 3], [0, 0, 3])
    with_other_axis = _tiny(tmp_path, asf=ASF.replace("axis 0 0 90  XYZ", "axis 0 0 0 XYZ"))
    bent = read_amc(with_other_axis).world()[0][1, 3]
    assert np.linalg.norm(bent - [0, 0, 2]) == pytest.approx(1.0)
    assert bent[2] - 2 == pytest.approx(np.cos(np.deg2rad(30)))


def test_hips_walk_below_a_root_that_stays(tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    channels = "CHANNELS 6 Xposition Yposition Zposition Yrotation Zrotation Xrotation"
    text = BVH.replace("CHANNELS 3 Yrotation Zrotation Xrotation", channels)
    rows = "0 0 0 0 0 0 1 0 0 0 0 0\n0 0 0 90 0 0 4 0 2 0 0 0\n"
    path.write_text(text[: text.index("0 0 0 0 0 0 0 0 0")] + rows, encoding="utf-8")
    found = read_bvh(path)
    # In the frame of its parent, which turns a quarter about z: x goes to y.
    assert np.allclose(found.world()[0], [[[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [0, 4, 2]]])
    assert np.allclose(found.sampled(np.array([0.5])).places[0, 1], [2.5, 0, 1])
    assert np.allclose(found.at_rest().world()[0], [[[5, 6, 7], [6, 6, 7]]])


def test_sampling_goes_between_frames_and_stops_at_the_ends(tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    path.write_text(BVH, encoding="utf-8")
    recording = read_bvh(path)
    sampled = recording.sampled(np.array([-1.0, 0.5, 1.0, 9.0]))
    assert np.allclose(
        sampled.places[:, 0], [[0.0, 0.0, 0.0], [0.5, 1.0, 1.5], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]]
    )
    half = sampled.rotations[1, 0] @ [1, 0, 0]
    assert np.allclose(half, [np.sqrt(0.5), np.sqrt(0.5), 0])
    assert np.allclose(sampled.rotations[3], recording.rotations[1])
    assert recording.sampled(np.zeros(1)).sampled(np.array([0.0, 5.0])).n_frames == 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("HIERARCHY", "HIER"), "line 1: not a BVH file: it does not begin with HIERARCHY"),
        (("OFFSET 1 0 0", "OFFSET 1 0"), "line 9: OFFSET of left leg is not three numbers"),
        (("OFFSET 1 0 0", "OFFSET 1 0 x"), "line 8: OFFSET of left leg is not three numbers"),
        (("CHANNELS 3 Y", "CHANNELS 2 Y"), "line 9: 'Xrotation' is not expected"),
        (("End Site", "Start Site"), "line 10: 'Start' is not expected in the hierarchy"),
        (("Frames: 2", "Frames: 3"), "18 numbers, expected 3 frames of 9 channels"),
        (("Frames: 2", "Frame 2"), "line 17: 'Frames:' is expected"),
        (("Time: 0.025", "Time: 0"), "make no sense"),
        (("MOTION", ""), "line 17: 'Frames:' is not expected in the hierarchy"),
        (("1 2 3 90", "nan 2 3 90"), "not finite"),
    ],
)
def test_bad_bvh_files_are_named_with_their_line(
    tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    path = tmp_path / "bad.bvh"
    path.write_text(BVH.replace(*change), encoding="utf-8")
    with pytest.raises(MocapError) as caught:
        read_bvh(path)
    assert message in str(caught.value)
    assert caught.value.path == path


@pytest.mark.parametrize(
    ("asf", "amc", "message"),
    [
        ((":root", ":stem"), ("", ""), "no section :root"),
        (("direction 0 1 0", "direction 0 1"), ("", ""), "line 17: 3 finite numbers"),
        (("dof rx ry rz", "dof rx length"), ("", ""), "line 20: the degrees of freedom"),
        (("root upper", "root over"), ("", ""), "line 42: 'over' is not in the bone data"),
        (("upper lower\n    ", ""), ("", ""), "'lower' has no parent"),
        (("angle deg", "angle rad"), ("", ""), "radians"),
        (("", ""), ("lower 30", "lower 30 4"), "line 10: 1 finite numbers"),
        (("", ""), ("lower 30", "over 30"), "line 10: the skeleton has no bone 'over'"),
        (("", ""), ("lower 30", ""), "frame 1: lower is missing"),
        (("", ""), (":DEGREES", ":RADIANS"), "line 2: angles in radians"),
        (("", ""), ("1\nroot 1", "root 1"), "before the first frame"),
    ],
)
def test_bad_acclaim_files_are_named_with_their_line(
    tmp_path: Path, asf: tuple[str, str], amc: tuple[str, str], message: str
) -> None:
    path = _tiny(tmp_path, ASF.replace(*asf), AMC.replace(*amc))
    with pytest.raises(MocapError) as caught:
        read_amc(path)
    assert message in str(caught.value)


def test_missing_files_name_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="cannot be read"):
        read_bvh(tmp_path / "none.bvh")
    path = _tiny(tmp_path)
    (tmp_path / "07.asf").unlink()
    with pytest.raises(MocapError, match=r"07\.asf beside it"):
        read_amc(path)
    with pytest.raises(MocapError, match=r"ends in \.bvh or \.amc"):
        read_capture(tmp_path / "walk.fbx")
    with pytest.raises(MocapError, match="no built-in joint map"):
        read_capture(_write_walk(tmp_path, _figure())[0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("unit_m = 0.01", "unit_m = -1"), "unit_m"),
        (("up = ", "upwards = "), "upwards: unknown key"),
        (('"y"', '"u"'), "up: 'x', 'y' or 'z'"),
        (("left_knee =", "left_tail ="), "joints.left_tail: there is no such joint"),
        (('left_knee = "left_knee"', ""), "joints.left_knee: missing"),
        (('"rest"', '"lying"'), "reference"),
        (("[joints]", "[joints"), "cannot be read"),
    ],
)
def test_bad_joint_maps_are_named_by_their_key(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    path = _write_map(tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace(*change), encoding="utf-8")
    with pytest.raises(MocapError) as caught:
        read_map(path)
    assert message in str(caught.value)


def test_built_in_maps_name_every_joint() -> None:
    maps = built_in_maps()
    assert {m.name for m in maps} == {"cmu", "character_rig"}
    for joint_map in maps:
        assert set(joint_map.joints) == set(JOINTS)
        assert len(set(joint_map.joints.values())) == len(JOINTS)


def test_swings_are_the_smallest_turns() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(11, 3)), rng.normal(size=(11, 3))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    R = _swing(a, b)
    assert np.allclose(np.einsum("tab,tb->ta", R, a), b)
    angle = np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert np.allclose(angle, np.arccos(np.sum(a * b, axis=1)))
    opposite = _swing(np.array([[0.0, 0.0, -1.0]]), np.array([[0.0, 0.0, 1.0]]))[0]
    assert np.allclose(opposite @ [0, 0, -1], [0, 0, 1])
    assert np.isclose(np.linalg.det(opposite), 1)


def test_hinged_bones_point_as_given_and_share_their_axis() -> None:
    first = np.tile([0.1, 0.0, -0.4], (5, 1))
    angles = np.deg2rad([0.0, 3.0, 12.0, 40.0, 100.0])
    second = np.column_stack([-np.sin(angles), 0 * angles, -np.cos(angles)])
    a, b = hinged_frames(first, second, np.tile([0.2, 1.0, 0.0], (5, 1)), 1.0)
    assert np.allclose(-a[:, :, 2], first / np.linalg.norm(first, axis=1, keepdims=True))
    assert np.allclose(-b[:, :, 2], second)
    assert np.allclose(np.linalg.det(a), 1)
    # A bent limb knows its axis; a straight one takes the given one.
    assert np.allclose(a[3:, :, 1], [0, 1, 0])
    assert np.allclose(b[3:, :, 1], [0, 1, 0])
    assert abs(a[0, 0, 1]) > 0.1


def _figure(stature_m: float = 1.72) -> Figure:
    return make_figure(stature_m, "female", 1.0, rng=np.random.default_rng(8))


def _write_walk(tmp_path: Path, figure: Figure) -> tuple[Path, Pose]:
    """A route with a seat, written as BVH with the product's own writer: Y up, centimetres."""
    stops = (Stop((0.0, 0.0)), Stop((1.4, 0.6), 0.4), Stop((0.8, 1.6), 0.5, 2.0, 0.45))
    pose = MOTIONS["route"](
        figure, 400, FPS, stops=stops, speed_m_s=1.1, start_s=0.3, rng=np.random.default_rng(4)
    )
    path = tmp_path / "walk.bvh"
    write_bvh(path, skeleton_of(figure, pose.rotations, pose.root_position, 1), FPS)
    return path, pose


def _write_map(tmp_path: Path) -> Path:
    path = tmp_path / "ours.toml"
    lines = ["unit_m = 0.01", 'up = "y"', 'reference = "rest"', "[joints]", *(f'{j} = "{j}"' for j in JOINTS)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


_LIMBS = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))


def _directions(position: Array) -> dict[str, Array]:
    out = {"trunk": position[:, JOINT["neck"]] - position[:, JOINT["pelvis"]]}
    for side in ("left", "right"):
        for a, b in _LIMBS:
            out[f"{side}_{a}"] = position[:, JOINT[f"{side}_{b}"]] - position[:, JOINT[f"{side}_{a}"]]
    return {k: v / np.linalg.norm(v, axis=1, keepdims=True) for k, v in out.items()}


def test_our_own_motion_comes_back(tmp_path: Path) -> None:
    figure = _figure()
    path, pose = _write_walk(tmp_path, figure)
    back = MOTIONS["capture"](
        figure,
        len(pose.rotations),
        FPS,
        file=path,
        joint_map=_write_map(tmp_path),
        position=tuple(pose.root_position[0, :2]),
        heading_rad=float(np.arctan2(pose.rotations[0, 0, 1, 0], pose.rotations[0, 0, 0, 0])),
        rng=np.random.default_rng(0),
    )
    was, _ = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    now, _ = forward_kinematics(figure.offsets, back.rotations, back.root_position)
    off = np.linalg.norm(now - was, axis=2)
    assert np.percentile(off, 99) < 0.025  # a foot is held a moment before it lands and after it lifts
    assert np.median(off) < 0.005
    assert (back.contact == pose.contact).mean() > 0.75


def test_other_bodies_move_in_the_same_directions_with_their_own_bones(tmp_path: Path) -> None:
    source = _figure()
    path, pose = _write_walk(tmp_path, source)
    was, _ = forward_kinematics(source.offsets, pose.rotations, pose.root_position)
    start = np.arctan2(pose.rotations[0, 0, 1, 0], pose.rotations[0, 0, 0, 0])
    for stature in (1.5, 1.95):
        figure = make_figure(stature, "male", 1.1, rng=np.random.default_rng(5))
        back = MOTIONS["capture"](
            figure,
            len(pose.rotations),
            FPS,
            file=path,
            joint_map=_write_map(tmp_path),
            heading_rad=float(start),
            rng=np.random.default_rng(0),
        )
        now, _ = forward_kinematics(figure.offsets, back.rotations, back.root_position)
        _check_directions(_directions(was), _directions(now))
        path_was = np.linalg.norm(np.diff(was[:, 0, :2], axis=0), axis=1).sum()
        path_now = np.linalg.norm(np.diff(now[:, 0, :2], axis=0), axis=1).sum()
        legs = (figure.thigh_m + figure.shank_m) / (source.thigh_m + source.shank_m)
        assert path_now / path_was == pytest.approx(legs, rel=0.02)
        _check_feet(figure, back)


def _check_directions(was: dict[str, Array], now: dict[str, Array]) -> None:
    for bone, directions in was.items():
        angle = np.rad2deg(np.arccos(np.clip(np.sum(directions * now[bone], axis=1), -1, 1)))
        limit = MAX_LEG_DEG if "hip" in bone or "knee" in bone else 3.0 if bone == "trunk" else MAX_ARM_DEG
        assert np.percentile(angle, 99) < limit, bone


def _check_feet(figure: Figure, pose: Pose) -> None:
    position, rotation = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    for i, side in enumerate(("left", "right")):
        at = position[:, JOINT[f"{side}_ankle"]]
        change = np.flatnonzero(np.diff(pose.contact[:, i].astype(int)) != 0) + 1
        for run in np.split(np.arange(len(at)), change):
            if pose.contact[run[0], i]:
                assert np.linalg.norm(at[run] - at[run[0]], axis=1).max() < MAX_SLIDE_M
    body = build_body(figure, cell_m=0.03)
    lowest = [body.pose(position[f], rotation[f])[0][:, 2].min() for f in range(0, len(position), 5)]
    assert min(lowest) > FLOOR_M
    assert np.median(lowest) < 0.01


def _files() -> list[str]:
    return sorted(p.name for p in MOTIONS_DIR.glob("*") if p.suffix in (".amc", ".bvh"))


@pytest.mark.skipif(not _files(), reason="no ../shared/motions beside the project")
@pytest.mark.parametrize("name", _files() or ["-"])
def test_real_captures_drive_our_figures(name: str) -> None:
    path = MOTIONS_DIR / name
    recording, joint_map = read_capture(path)
    assert joint_map.name == ("character_rig" if name.endswith(".bvh") else "cmu")
    rate = recording.fps or joint_map.fps
    assert rate is not None
    figure = _figure(1.8)
    first = 1 if joint_map.reference == "first_frame" else 0
    n = recording.n_frames - first
    pose = MOTIONS["capture"](figure, n, rate, file=path, rng=np.random.default_rng(0))
    _check_feet(figure, pose)
    at, _ = recording.world()
    index = [recording.names.index(joint_map.joints[j]) for j in JOINTS]
    x, y, z = at[first:, index].transpose(2, 0, 1)
    source = np.stack([z, x, y], axis=-1)  # theirs: y up, z forward
    now, rotation = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    # Skeletons of captures have hips and neck by markers, where the tables have them, not where skin turns.
    ends = [now[:, JOINT[j]] + rotation[:, JOINT[j]] @ figure.surface[JOINT[j]] for j in ("pelvis", "neck")]
    was = _directions(source)
    turn = _heading(now[0]) - _heading(source[0])
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    mids = 0.5 * (source[:, JOINT["left_hip"]] + source[:, JOINT["right_hip"]])
    was["trunk"] = source[:, JOINT["neck"]] - mids
    was["trunk"] /= np.linalg.norm(was["trunk"], axis=1, keepdims=True)
    trunk = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0], axis=1, keepdims=True)
    _check_real_directions({k: v @ R.T for k, v in was.items()}, _directions(now) | {"trunk": trunk})


def _heading(joints: Array) -> float:
    across = joints[JOINT["left_hip"]] - joints[JOINT["right_hip"]]
    return float(np.arctan2(-across[0], across[1]))


def _check_real_directions(was: dict[str, Array], now: dict[str, Array]) -> None:
    for bone, directions in was.items():
        angle = np.rad2deg(np.arccos(np.clip(np.sum(directions * now[bone], axis=1), -1, 1)))
        if "hip" in bone or "knee" in bone:
            # Other proportions of thigh and shank, and feet held still: a nearly straight leg turns by most.
            assert np.median(angle) < 4.0, bone
            assert np.percentile(angle, 98) < 13.0, bone
        else:
            # The trunk of the source begins and ends at other points of the body.
            assert angle.max() < (8.0 if bone == "trunk" else MAX_ARM_DEG), bone


def test_captures_in_scene_files(tmp_path: Path) -> None:
    from mocap.synth.world import build_world

    _write_walk(tmp_path, _figure())
    _write_map(tmp_path)
    scene = tmp_path / "replayed.toml"
    text = """
seed = 3
n_frames = 4
[[persons]]
seed = 4
motion = { kind = "capture", file = "walk.bvh", map = "ours.toml", start_s = 1.0, position_m = [0.2, 0.1] }
"""
    scene.write_text(text, encoding="utf-8")
    world = build_world(load_scene(scene))
    assert np.allclose(world.actors[0].pose.root_position[0, :2], [0.2, 0.1], atol=1e-9)
    scene.write_text(text.replace("start_s = 1.0", "start_s = 99.0"), encoding="utf-8")
    with pytest.raises(MocapError, match=r"persons\.0\.motion: start_s"):
        build_world(load_scene(scene))
    scene.write_text(text.replace("walk.bvh", "away.bvh"), encoding="utf-8")
    with pytest.raises(MocapError, match="cannot be read"):
        build_world(load_scene(scene))
