"""Keypoints of other tools: every format gives the same figures, and what cannot be read is one message."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import cv2
import numpy as np
import pytest
from keypoint_world import keypoint_world, write_keypoint_session

from mocap.data import CameraRig
from mocap.data.keypoints import KEYPOINTS, MIRRORED
from mocap.errors import MocapError
from mocap.io.calibration import write_calibration
from mocap.io.keypoints import count_frames, read_keypoints, write_keypoints_csv
from mocap.io.keypoints.names import ORDERS, keypoint_row, rows_of_order
from mocap.io.session import check_session, open_session

NOSE, KNEE = KEYPOINTS.index("nose"), KEYPOINTS.index("left_knee")
AT = {"nose": (10.5, 7.25, 0.9), "left_knee": (12.0, 18.0, 0.5), "left_hip": (13.0, 12.0, 0.75)}
AT |= {"right_hip": (9.0, 12.0, 0.625)}


def _triples(n_points: int, frame: int) -> list[float]:
    names = [KEYPOINTS[r] if r is not None else "" for r in rows_of_order(n_points) or []]
    out: list[float] = []
    for name in names:
        u, v, c = AT.get(name, (0.0, 0.0, 0.0))
        out += [u + frame if c else 0.0, v, c]
    return out + [0.0] * (3 * n_points - len(out))


def _openpose(n_points: int, suffix: str = "_keypoints") -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        place = folder / "cam"
        place.mkdir()
        for frame in (0, 2):
            person = {
                "person_id": [-1],
                "pose_keypoints_2d": _triples(n_points, frame),
                "face_keypoints_2d": [],
            }
            document = {"version": 1.3, "people": [person]}
            (place / f"cam_{frame:012d}{suffix}.json").write_text(json.dumps(document))
        return place

    return write


def _coco(folder: Path) -> Path:
    rows = [
        {"image_id": f"{f:06d}.jpg", "category_id": 1, "keypoints": _triples(17, f), "score": 1.2}
        for f in (0, 2)
    ]
    (folder / "cam.json").write_text(json.dumps(rows))
    return folder / "cam.json"


def _own(folder: Path) -> Path:
    lines = ["frame,keypoint,u_px,v_px,confidence"]
    for f in (0, 2):
        lines += [f"{f},{name},{u + f},{v},{c}" for name, (u, v, c) in AT.items()]
        lines.append(f"{f},mouth_left,3.0,3.0,0.9")
    (folder / "cam.csv").write_text("\n".join(lines) + "\n")
    return folder / "cam.csv"


def _dlc(folder: Path) -> Path:
    heads = [["scorer"], ["bodyparts"], ["coords"]]
    for name in AT:
        for k, word in enumerate(("net", name, None)):
            heads[k] += [word] * 3 if word else ["x", "y", "likelihood"]
    lines = [",".join(h) for h in heads]
    for f in (0, 2):
        lines.append(",".join([str(f), *(f"{u + f},{v},{c}" for u, v, c in AT.values())]))
    (folder / "cam.csv").write_text("\n".join(lines) + "\n")
    return folder / "cam.csv"


def _sleap(folder: Path) -> Path:
    head = ["track", "frame_idx", "instance.score", *(f"{n}.{w}" for n in AT for w in ("x", "y", "score"))]
    lines = [",".join(head)]
    for f in (0, 2):
        lines.append(",".join(["", str(f), "0.8", *(f"{u + f},{v},{c}" for u, v, c in AT.values())]))
    (folder / "cam.csv").write_text("\n".join(lines) + "\n")
    return folder / "cam.csv"


FORMATS: dict[str, Callable[[Path], Path]] = {
    **{name: _openpose(n) for n, (name, _) in ORDERS.items()},
    "Pose2Sim": _openpose(26, ""),
    "COCO results": _coco,
    "own": _own,
    "DeepLabCut": _dlc,
    "SLEAP": _sleap,
}


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_figures(name: str, tmp_path: Path, rig: CameraRig) -> None:
    path = FORMATS[name](tmp_path)
    camera = rig.names[1]
    found = read_keypoints({camera: path}, rig, range(4))
    assert [len(found[f]) for f in range(4)] == [1, 0, 1, 0]
    for frame in (0, 2):
        figure = found[frame]
        assert figure.camera.tolist() == [1]
        for keypoint, (u, v, c) in AT.items():
            row = KEYPOINTS.index(keypoint)
            np.testing.assert_allclose(figure.uv[0, row], [u + frame, v])
            assert figure.confidence[0, row] == c
        assert np.isnan(figure.uv[0, KEYPOINTS.index("left_wrist")]).all()
    assert count_frames(path) == 3


# Where some points stand, as the tools' own lists have them.
PLACES: dict[int, dict[str, int]] = {
    17: {"nose": 0, "left_eye": 1, "right_ear": 4, "left_shoulder": 5, "left_wrist": 9, "right_hip": 12},
    18: {"nose": 0, "neck": 1, "right_shoulder": 2, "left_wrist": 7, "right_hip": 8, "left_ankle": 13, "left_eye": 15},
    25: {"neck": 1, "right_wrist": 4, "pelvis": 8, "right_hip": 9, "left_knee": 13, "left_toe": 19, "right_heel": 24},
    26: {"right_ankle": 16, "head": 17, "neck": 18, "pelvis": 19, "left_toe": 20, "right_toe": 21, "left_heel": 24},
    33: {"left_eye": 2, "right_ear": 8, "left_shoulder": 11, "right_wrist": 16, "left_hand": 19, "left_hip": 23,
         "right_ankle": 28, "left_heel": 29, "right_toe": 32},
    133: {"right_ankle": 16, "left_toe": 17, "left_heel": 19, "right_toe": 20, "right_heel": 22},
    136: {"right_ankle": 16, "head": 17, "left_toe": 20, "right_toe": 21, "right_heel": 25},
}  # fmt: skip


@pytest.mark.parametrize("n_points", PLACES)
def test_points_stand_where_the_tools_list_them(n_points: int) -> None:
    assert set(PLACES) == set(ORDERS)
    rows = rows_of_order(n_points)
    assert rows is not None
    for name, place in PLACES[n_points].items():
        assert rows[place] == KEYPOINTS.index(name)
    known = [row for row in rows if row is not None]
    assert len(set(known)) == len(known)


def test_rows_of_one_frame_are_several_persons_of_sleap(tmp_path: Path, rig: CameraRig) -> None:
    path = _sleap(tmp_path)
    second = path.read_text().splitlines()[1].replace("10.5", "50.5")
    path.write_text(path.read_text() + second + "\n")
    found = read_keypoints({rig.names[0]: path}, rig, range(1))
    assert sorted(found[0].uv[:, NOSE, 0]) == [10.5, 50.5]


def test_nobody_of_pose2sim_is_nobody(tmp_path: Path, rig: CameraRig) -> None:
    """Its associated files keep the place of a person whom a camera does not show."""
    folder = FORMATS["Pose2Sim"](tmp_path)
    for path in folder.iterdir():
        document = json.loads(path.read_text())
        document["people"].insert(0, {})
        path.write_text(json.dumps(document))
    found = read_keypoints({rig.names[0]: folder}, rig, range(3))
    assert [len(found[f]) for f in range(3)] == [1, 0, 1]


@pytest.mark.parametrize(
    ("called", "keypoint"),
    [
        ("LBigToe", "left_toe"), ("RShoulder", "right_shoulder"), ("left_foot_index", "left_toe"), ("MidHip", "pelvis"),
        ("Hip", "pelvis"), ("shoulder_left", "left_shoulder"),
        ("right ankle", "right_ankle"), ("left_index", "left_hand"),
    ],
)  # fmt: skip
def test_names_of_other_tools_are_known(called: str, keypoint: str) -> None:
    assert keypoint_row(called) == KEYPOINTS.index(keypoint)
    assert keypoint_row("left_eye_inner") is None


def test_the_mirror_of_the_mirror_is_the_point_itself() -> None:
    assert (MIRRORED[MIRRORED] == np.arange(len(KEYPOINTS))).all()
    assert KEYPOINTS[MIRRORED[KNEE]] == "right_knee"
    assert MIRRORED[NOSE] == NOSE


def test_written_keypoints_are_read_back(tmp_path: Path, rig: CameraRig) -> None:
    figure = np.full((len(KEYPOINTS), 3), np.nan)
    figure[5:12] = [[5.25, 6.5, 0.5]] * 7
    other = figure + np.array([1.0, 2.0, 0.25])
    write_keypoints_csv(tmp_path / "cam.csv", [(3, 0, figure), (3, 1, other), (4, 0, other)])
    found = read_keypoints({rig.names[0]: tmp_path / "cam.csv"}, rig, range(3, 5))
    np.testing.assert_array_equal(found[3].uv, np.stack([figure, other])[..., :2])
    assert len(found[4]) == 1


BAD = {
    "no list people": ('{"persons": []}', "people"),
    "another number of points": ('{"people": [{"pose_keypoints_2d": [1, 2, 0.5, 3]}]}', "4 numbers"),
    "a text": ('{"people": [{"pose_keypoints_2d": ["a"]}]}', "numbers of a person"),
    "no JSON": ("{", "not valid JSON"),
    "too deep": ("[" * 100 + "]" * 100, "32 deep"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_of_a_picture_is_one_message(name: str, tmp_path: Path, rig: CameraRig) -> None:
    text, word = BAD[name]
    (tmp_path / "cam").mkdir()
    (tmp_path / "cam" / "p_000.json").write_text(text)
    with pytest.raises(MocapError, match=word):
        read_keypoints({rig.names[0]: tmp_path / "cam"}, rig, range(1))


def test_points_named_in_no_known_way_are_refused(tmp_path: Path, rig: CameraRig) -> None:
    rows = [f"0,{n},3,3,1" for n in ("snout", "tail", "paw", "ear_tip", "nose")]
    (tmp_path / "cam.csv").write_text("frame,keypoint,u_px,v_px,confidence\n" + "\n".join(rows) + "\n")
    with pytest.raises(MocapError, match="snout"):
        read_keypoints({rig.names[0]: tmp_path / "cam.csv"}, rig, range(1))


def test_keypoints_of_another_resolution_are_refused(tmp_path: Path, rig: CameraRig) -> None:
    figure = np.tile([900.0, 700.0, 1.0], (len(KEYPOINTS), 1))
    write_keypoints_csv(tmp_path / "cam.csv", [(0, 0, figure)])
    with pytest.raises(MocapError, match="outside the picture"):
        read_keypoints({rig.names[0]: tmp_path / "cam.csv"}, rig, range(1))


def test_fractions_of_the_picture_are_refused(tmp_path: Path, rig: CameraRig) -> None:
    figure = np.column_stack([np.linspace([0.1, 0.9], [0.7, 0.2], len(KEYPOINTS)), np.ones(len(KEYPOINTS))])
    write_keypoints_csv(tmp_path / "cam.csv", [(0, 0, figure)])
    with pytest.raises(MocapError, match="fractions of the picture"):
        read_keypoints({rig.names[0]: tmp_path / "cam.csv"}, rig, range(1))


@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files_give_a_value_or_a_message(name: str, tmp_path: Path, rig: CameraRig) -> None:
    path = FORMATS[name](tmp_path)
    rng = np.random.default_rng(len(name))
    file = sorted(path.iterdir())[0] if path.is_dir() else path
    whole = file.read_bytes()
    n_refused = 0
    for _ in range(60):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), 3):
            data[at] = rng.integers(0, 256)
        if rng.random() < 0.3:
            data = data[: rng.integers(0, len(data))]
        file.write_bytes(bytes(data))
        with suppress(MocapError):
            read_keypoints({rig.names[0]: path}, rig, range(4))
            n_refused -= 1
        n_refused += 1
    assert n_refused > 0


# --- sessions -----------------------------------------------------------------------------------------------


def test_a_session_of_keypoints_alone_is_opened_and_checked(tmp_path: Path) -> None:
    session = open_session(write_keypoint_session(keypoint_world(12), tmp_path / "session"))
    assert list(session.keypoint_sources) == list(session.rig.names)
    assert session.frames == range(12)
    (found,) = [f for f in check_session(session) if "persons per picture" in f.message]
    assert "1.0 persons per picture, at most 1" in found.message


def pose2sim_project(folder: Path, *, call: str = "{}") -> Path:
    """A session of keypoints as Pose2Sim keeps them.  call : what folders call a camera."""
    root = write_keypoint_session(keypoint_world(12), folder / "session")
    for i, path in enumerate(sorted((root / "keypoints").iterdir())):
        own = root / "pose" / f"{call.format(path.stem)}_json"
        own.mkdir(parents=True)
        (own / f"{path.stem}_000000.json").write_text(
            json.dumps({"people": [{"pose_keypoints_2d": _triples(26, i)}]})
        )
        path.unlink()
    (root / "keypoints").rmdir()
    return root


def test_folders_of_pose2sim_are_found(tmp_path: Path) -> None:
    session = open_session(pose2sim_project(tmp_path))
    assert [p.name for p in session.keypoint_sources.values()] == [f"{n}_json" for n in session.rig.names]


def test_cameras_called_as_pose2sims_pictures_of_a_board_are_known(tmp_path: Path) -> None:
    """Its calibration has int_cam01_img for what its other folders call cam01."""
    root = pose2sim_project(tmp_path)
    rig = keypoint_world(12).rig
    called = CameraRig(tuple(replace(c, name=f"int_{c.name}_img") for c in rig))
    write_calibration(root / "calibration.toml", called)
    session = open_session(root)
    assert {n: p.name for n, p in session.keypoint_sources.items()} == {
        f"int_{n}_img": f"{n}_json" for n in rig.names
    }


def test_what_pose2sim_has_synchronised_is_read_where_there_are_no_pictures(tmp_path: Path) -> None:
    root = pose2sim_project(tmp_path)
    copytree(root / "pose", root / "pose-sync")
    session = open_session(root)
    assert {p.parent.name for p in session.keypoint_sources.values()} == {"pose-sync"}
    assert session.warnings == ()
    for camera in keypoint_world(12).rig:
        (root / "masks" / camera.name).mkdir(parents=True)
        picture = np.zeros((camera.size[1], camera.size[0]), dtype=np.uint8)
        cv2.imwrite(str(root / "masks" / camera.name / "0.png"), picture)
    session = open_session(root)
    assert {p.parent.name for p in session.keypoint_sources.values()} == {"pose"}
    assert any("pose-sync/ is not read" in warning for warning in session.warnings)


def test_what_the_remedy_says_of_names_opens_the_session(tmp_path: Path) -> None:
    root = pose2sim_project(tmp_path, call="view of {}")
    with pytest.raises(MocapError, match="does not know") as caught:
        open_session(root)
    assert '[camera_map] "view of cam_0" = "CAMERA NAME"' in (caught.value.remedy or "")
    names = keypoint_world(12).rig.names
    lines = [f'"view of {n}" = "{n}"' for n in names]
    with (root / "session.toml").open("a") as file:
        file.write("\n".join(["[camera_map]", *lines]) + "\n")
    assert list(open_session(root).keypoint_sources) == list(names)


def test_tables_called_as_deeplabcut_calls_them_are_known(tmp_path: Path) -> None:
    root = write_keypoint_session(keypoint_world(12), tmp_path / "session")
    for path in sorted((root / "keypoints").iterdir()):
        path.rename(path.with_stem(f"{path.stem}DLC_resnet50_gaitMay1shuffle1_50000"))
    session = open_session(root)
    assert list(session.keypoint_sources) == list(session.rig.names)


@pytest.mark.parametrize("name", ["cam_0DLC_resnet50_gaitMay1shuffle1_50000.h5", "cam_0.slp"])
def test_files_that_tools_keep_for_themselves_are_named(name: str, tmp_path: Path) -> None:
    root = write_keypoint_session(keypoint_world(12), tmp_path / "session")
    for path in (root / "keypoints").iterdir():
        path.unlink()
    (root / "keypoints" / name).write_bytes(b"\x89HDF")
    with pytest.raises(MocapError, match="of which none is read") as caught:
        open_session(root)
    assert name in caught.value.message
    assert "export CSV" in (caught.value.remedy or "")


def test_a_camera_that_is_not_calibrated_is_named(tmp_path: Path) -> None:
    root = write_keypoint_session(keypoint_world(12), tmp_path / "session")
    (root / "keypoints" / "cam_0.csv").rename(root / "keypoints" / "kamera_0.csv")
    with pytest.raises(MocapError, match="kamera_0"):
        open_session(root)


def halved(path: Path) -> None:
    """Every other frame of a file is taken out."""
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], *(s for s in lines[1:] if int(s.split(",")[0]) % 2 == 0)]) + "\n")


def test_check_names_a_camera_with_half_of_its_frames(tmp_path: Path) -> None:
    root = write_keypoint_session(keypoint_world(12), tmp_path / "session")
    halved(root / "keypoints" / "cam_2.csv")
    (finding,) = [f for f in check_session(open_session(root)) if "few of the frames" in f.message]
    assert (finding.camera, finding.message.rpartition(": ")[2]) == ("cam_2", "cam_2 50 %")


def test_check_says_once_that_cameras_have_half_of_their_frames(tmp_path: Path) -> None:
    root = write_keypoint_session(keypoint_world(12), tmp_path / "session")
    for name in ("cam_0", "cam_2"):
        halved(root / "keypoints" / f"{name}.csv")
    (finding,) = [f for f in check_session(open_session(root)) if "few of the frames" in f.message]
    assert (finding.camera, finding.message.rpartition(": ")[2]) == (None, "cam_0 50 %, cam_2 50 %")


def test_check_says_which_file_cannot_be_read(tmp_path: Path) -> None:
    root = write_keypoint_session(keypoint_world(12), tmp_path / "session")
    path = root / "keypoints" / "cam_1.csv"
    path.write_text(path.read_text().replace("left_knee,", "left_knee,x", 1))
    with pytest.raises(MocapError, match="is no number"):
        check_session(open_session(root))


def test_check_says_which_of_many_pictures_cannot_be_read(tmp_path: Path) -> None:
    root = pose2sim_project(tmp_path)
    broken = root / "pose" / "cam_2_json" / "cam_2_000000.json"
    broken.write_text("[")
    (finding,) = [f for f in check_session(open_session(root)) if f.severity == "error"]
    assert str(broken) in finding.message
