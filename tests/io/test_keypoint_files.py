"""Keypoints of other tools: every format gives the same figures, and what cannot be read is one message."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from keypoint_world import keypoint_world, write_keypoint_session

from mocap.data import CameraRig
from mocap.data.keypoints import KEYPOINTS, MIRRORED
from mocap.errors import MocapError
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


def test_folders_of_pose2sim_are_found(tmp_path: Path) -> None:
    root = write_keypoint_session(keypoint_world(12), tmp_path / "session")
    pose = root / "pose"
    for i, path in enumerate(sorted((root / "keypoints").iterdir())):
        folder = pose / f"{path.stem}_json"
        folder.mkdir(parents=True)
        (folder / f"{path.stem}_000000.json").write_text(
            json.dumps({"people": [{"pose_keypoints_2d": _triples(26, i)}]})
        )
        path.unlink()
    (root / "keypoints").rmdir()
    session = open_session(root)
    assert [p.name for p in session.keypoint_sources.values()] == [f"{n}_json" for n in session.rig.names]


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
