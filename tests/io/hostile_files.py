"""Damaged files in great numbers: valid samples of every format that is read, and the ways to damage them.

`python tests/io/hostile_files.py 10000` tries so many and prints the table of docs/reliability.md. A reader may give a
value or raise MocapError; everything else, and more than SLOW_S seconds, is a failure. The two parsers that run in a
process of their own are forked from one server here, so that thousands of files take minutes.
"""

from __future__ import annotations

import io
import json
import pickle
import re
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import public_sets
from foreign_rigs import colmap_model, humaneva, opencap_values, opensfm, truth
from io_samples import look_at, write_video

from mocap.body import load_body_model
from mocap.body.hierarchy import load_hierarchy, load_limbs
from mocap.body.markers import load_marker_set
from mocap.data import LANDMARKS, CameraRig, Motion, Skeleton, Tracks
from mocap.errors import MocapError
from mocap.io import _child
from mocap.io.actions import read_actions_csv
from mocap.io.calibration import read_calibration, write_calibration
from mocap.io.calibration.frame import in_our_frame
from mocap.io.calibration.public_sets import read_human36m, read_skeletool
from mocap.io.formats import read_poses, write_bvh, write_c3d, write_trc
from mocap.io.poses import read_map, read_motions
from mocap.io.session import read_session_settings
from mocap.io.sets.humaneva import clock_of
from mocap.io.sets.mpi_inf_3dhp import read_annotations
from mocap.io.sets.totalcapture import read_positions
from mocap.io.tables import (
    read_detections_csv,
    read_landmarks_csv,
    read_marker_labels_csv,
    read_tracks_csv,
    write_detections_csv,
    write_landmarks_csv,
    write_tracks_csv,
)
from mocap.io.truth import read_true_voxels
from mocap.io.video import MaskReader, clip_info, iter_clip
from mocap.pipeline.cluster.spec import read_sweep_spec
from mocap.pipeline.config import load_config
from mocap.synth.capture import read_amc, read_bvh
from mocap.synth.capture import read_map as read_joint_map
from mocap.synth.scene import load_scene

SLOW_S = 10.0
SERVER = """
import os, resource, signal, sys
sys.path.insert(0, sys.argv[1])
import cv2, ezc3d, scipy.io
from mocap.io import _child
for line in sys.stdin:
    kind, memory, seconds, path, out = line.rstrip("\\n").split("\\t")
    pid = os.fork()
    if pid == 0:
        signal.alarm(int(seconds))
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
        try:
            data = _child.packed(kind, path)
        except BaseException:
            os._exit(1)
        with open(out, "wb") as file:
            file.write(data)
        os._exit(0)
    status = os.waitpid(pid, 0)[1]
    print(os.waitstatus_to_exitcode(status), flush=True)
"""


@dataclass(frozen=True)
class Sample:
    """A valid file.  read : reader of its path.  beside : other files that it needs, by name."""

    kind: str
    name: str
    content: bytes
    read: Callable[[Path], object]
    beside: dict[str, bytes] = field(default_factory=dict)
    is_text: bool = True


@dataclass
class Count:
    tried: int = 0
    values: int = 0
    refused: int = 0
    crashed_in_child: int = 0
    slowest_s: float = 0.0
    failures: list[str] = field(default_factory=list)


# --- samples ------------------------------------------------------------------------------------------------


def samples(folder: Path) -> list[Sample]:
    """One valid file, or more, of every format; `folder` holds what the writers leave."""
    makers = (_calibrations, _motions, _tables, _public_sets, _pictures)
    return [*_settings(), *(sample for make in makers for sample in make(folder))]


def _rig() -> CameraRig:
    return CameraRig(
        (
            look_at("back", np.array([-3.0, 0.5, 1.5]), (64, 48)),
            look_at("cam_10", np.array([2.0, 2.5, 2.0]), (48, 40)),
        )
    )


def _calibrations(folder: Path) -> Iterator[Sample]:
    rig = _rig()
    write_calibration(folder / "calibration.toml", rig)
    yield Sample("calibration TOML", "c.toml", (folder / "calibration.toml").read_bytes(), _calibration)
    lines = ["[cameras]"]
    for i, c in enumerate(rig):
        lines += [f"[cameras.{i}]", f"cam_id = {i}", "rotation_count = 0", "error = 0.4"]
        lines += [f"size = {list(c.size)}", f"matrix = {c.K.tolist()}", f"distortions = {c.dist.tolist()}"]
        lines += [f"rotation = {cv2.Rodrigues(c.R)[0].ravel().tolist()}", f"translation = {c.t.tolist()}"]
    yield Sample("calibration TOML (Caliscope)", "c.toml", "\n".join(lines).encode(), _calibration)
    panoptic = [
        {
            "name": c.name,
            "type": "hd",
            "resolution": list(c.size),
            "K": c.K.tolist(),
            "distCoef": c.dist.tolist(),
            "R": c.R.tolist(),
            "t": (100 * c.t).reshape(3, 1).tolist(),
        }
        for c in rig
    ]
    yield Sample("calibration JSON", "c.json", json.dumps({"cameras": panoptic}).encode(), _calibration)
    for suffix in (".yml", ".xml", ".json"):
        yield Sample(
            f"calibration FileStorage {suffix}", f"c{suffix}", _storage(folder, suffix, rig), _calibration
        )
    inner, outer = ["%YAML:1.0", "---", "names:"], ["%YAML:1.0", "---"]
    inner += [f'  - "{c.name}"' for c in rig]
    for c in rig:
        inner.append(f"K_{c.name}: {_matrix(c.K)}")
        inner += [
            f"dist_{c.name}: {_matrix(c.dist.reshape(1, -1))}",
            f"H_{c.name}: {c.size[1]}",
            f"W_{c.name}: {c.size[0]}",
        ]
        outer += [f"Rot_{c.name}: {_matrix(c.R)}", f"T_{c.name}: {_matrix(c.t.reshape(3, 1))}"]
    intri, extri = "\n".join([*inner, ""]).encode(), "\n".join([*outer, ""]).encode()
    yield Sample("calibration EasyMocap", "intri.yml", intri, _calibration, {"extri.yml": extri})
    yield Sample("calibration EasyMocap", "extri.yml", extri, _calibration, {"intri.yml": intri})
    yield from _foreign_calibrations(folder)


def _foreign_calibrations(folder: Path) -> Iterator[Sample]:
    """Of laboratories and of structure from motion."""
    lenses = truth("k1 k2 p1 p2 k3")
    values = opencap_values(lenses[0], np.eye(3))
    for protocol in (2, 4):
        data = pickle.dumps(values, protocol=protocol)
        yield Sample("calibration OpenCap", "cam.pickle", data, _calibration, is_text=False)
    yield Sample("calibration HumanEva", "c.cal", humaneva(lenses[0]).encode(), _calibration)
    pose = np.column_stack([lenses[0].R, 1000 * lenses[0].t]).tolist()
    rows = [*(" ".join(map(repr, row)) for row in (*lenses[0].K.tolist(), *pose)), "0 0 0 1"]
    biocv = "\n".join(["1280", "720", *rows, "", "0.1 0.01 0 0 0", ""])
    yield Sample("calibration bioCV", "c.calib", biocv.encode(), _calibration)
    vicon = (
        '<Cameras><Camera DEVICEID="1" TYPE="VIDEO" SENSOR_SIZE="64 48"><KeyFrames><KeyFrame FOCAL_LENGTH="60" '
        'PRINCIPAL_POINT="32 24" ORIENTATION="0.5 0.5 0.5 0.5" POSITION="1 2000 3" '
        'VICON_RADIAL2="ViconRadial2 1 2 0.1 0.2 0.3"/></KeyFrames></Camera></Cameras>'
    )
    yield Sample("calibration Vicon", "c.xcp", vicon.encode(), _calibration)
    turn = " ".join(f'r{i}{j}="{int(i == j)}"' for i in (1, 2, 3) for j in (1, 2, 3))
    qualisys = (
        '<?xml version="1.0"?><calibration><cameras><camera serial="a" model="none"><fov_video left="0" top="0" '
        f'right="63" bottom="47"/><transform x="1" y="2000" z="3" {turn}/><intrinsic focalLengthU="3840" '
        'focalLengthV="3840" centerPointU="2048" centerPointV="1536" radialDistortion1="0" radialDistortion2="0" '
        'tangentalDistortion1="0" tangentalDistortion2="0"/></camera></cameras></calibration>'
    )
    yield Sample("calibration Qualisys", "c.qca.txt", qualisys.encode(), _calibration)
    yield Sample(
        "calibration OpenSfM", "c.json", json.dumps([opensfm(lenses, "brown")]).encode(), _calibration
    )
    for ending in ("txt", "bin"):
        place = folder / f"colmap_{ending}"
        place.mkdir(exist_ok=True)
        colmap_model(place, truth("k1 k2 p1 p2"), "OPENCV", is_binary=ending == "bin")
        cameras, images = ((place / f"{part}.{ending}").read_bytes() for part in ("cameras", "images"))
        for name, own, other, beside in (
            ("cameras", cameras, "images", images),
            ("images", images, "cameras", cameras),
        ):
            yield Sample(
                f"calibration COLMAP .{ending}",
                f"{name}.{ending}",
                own,
                _calibration,
                {f"{other}.{ending}": beside},
                is_text=ending == "txt",
            )


def _public_sets(folder: Path) -> Iterator[Sample]:
    """Cameras and truth of public sets; their C3D, JSON and .calib files are those of other samples."""
    root = folder / "sets"
    if not root.is_dir():
        public_sets.totalcapture(root / "tc")
        public_sets.mpi_inf_3dhp(root / "3dhp")
        public_sets.human36m(root / "h36m", lambda path, _: path.touch())
    cal, positions = (root / "tc" / name for name in ("calibration.cal", "s1/acting1/gt_skel_gbl_pos.txt"))
    yield Sample("calibration TotalCapture", "c.cal", cal.read_bytes(), _calibration)
    yield Sample("TotalCapture positions", "gt.txt", positions.read_bytes(), read_positions)
    sequence = root / "3dhp" / "S2" / "Seq1"
    skeletool, annotations = ((sequence / name).read_bytes() for name in ("camera.calibration", "annot.mat"))
    yield Sample("calibration MPI-INF-3DHP", "camera.calibration", skeletool, _calibration)
    rig = read_skeletool(sequence / "camera.calibration")
    yield Sample(
        "MPI-INF-3DHP annotations", "a.mat", annotations, lambda p: read_annotations(p, rig), is_text=False
    )
    metadata = (root / "h36m" / "metadata.xml").read_bytes()
    yield Sample("calibration Human3.6M", "metadata.xml", metadata, _human36m)
    yield Sample("HumanEva .ofs", "a.ofs", b"1\n5\n2.0\n", lambda p: clock_of(p, 120.0))


def _human36m(path: Path) -> object:
    return in_our_frame(read_human36m(path, public_sets.SUBJECT), path, None, None, False)


def _calibration(path: Path) -> object:
    return read_calibration(path, check_world=False)


def _matrix(M: np.ndarray) -> str:
    data = ", ".join(repr(float(v)) for v in M.ravel())
    return f"!!opencv-matrix {{rows: {M.shape[0]}, cols: {M.shape[1]}, dt: d, data: [{data}]}}"


def _storage(folder: Path, suffix: str, rig: CameraRig) -> bytes:
    path = folder / f"storage{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for c in rig:
        storage.startWriteStruct(c.name, cv2.FileNode_MAP)
        storage.write("camera_matrix", c.K)
        storage.write("distortion_coefficients", c.dist.reshape(-1, 1))
        storage.write("image_width", c.size[0])
        storage.write("image_height", c.size[1])
        storage.write("R", c.R)
        storage.write("T", c.t.reshape(3, 1))
        storage.endWriteStruct()
    storage.release()
    return path.read_bytes()


def _person() -> Motion:
    rng = np.random.default_rng(7)
    frames = np.array([3, 4, 5, 7])
    landmarks = rng.normal(size=(4, len(LANDMARKS), 3))
    landmarks[1, 2] = np.nan
    return Motion(1, frames, frames / 30.0, landmarks)


def _motions(folder: Path) -> Iterator[Sample]:
    person = _person()
    write_trc(folder / "a.trc", person, 30.0)
    write_c3d(folder / "a.c3d", person, 30.0)
    names = ("Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftArm", "LeftForeArm")
    turns = np.broadcast_to(np.eye(3), (3, 6, 3, 3)).copy()
    parents, offsets = np.array([-1, 0, 1, 2, 0, 4]), np.full((6, 3), 0.25)
    ends = {3: np.array([0, 0, 0.2]), 5: np.array([0.1, 0, 0])}
    skeleton = Skeleton(1, names, parents, offsets, ends, turns, np.ones((3, 3)))
    write_bvh(folder / "a.bvh", skeleton, 30.0)
    yield Sample("TRC", "a.trc", (folder / "a.trc").read_bytes(), _poses)
    yield Sample("C3D", "a.c3d", (folder / "a.c3d").read_bytes(), _poses, is_text=False)
    yield Sample("BVH", "a.bvh", (folder / "a.bvh").read_bytes(), _poses)
    yield Sample("BVH as capture", "a.bvh", (folder / "a.bvh").read_bytes(), read_bvh)
    points = ("LHip", "RHip", "LKnee", "RKnee", "Neck")
    wide = "frame,time,person," + ",".join(f"{p}_{axis}_mm" for p in points for axis in "xyz")
    wide += "".join(f"\n{k},{k / 25},1," + ",".join(str(100 * i + k) for i in range(15)) for k in range(3))
    yield Sample("wide CSV", "a.csv", wide.encode(), _poses)
    body = {"bodies": [{"id": 1, "joints15": [0.5] * 60}, {"id": 2, "joints15": [-1.0] * 60}]}
    yield Sample("Panoptic poses", "body3DScene_00000102.json", json.dumps(body).encode(), _poses)
    asf = (
        ":version 1.10\n:units\n  angle deg\n:root\n  order TX TY TZ RX RY RZ\n:bonedata\n  begin\n    id 1\n"
    )
    asf += (
        "    name upper\n    direction 0 1 0\n    length 2\n    axis 0 0 90  XYZ\n    dof rx ry rz\n  end\n"
    )
    asf += ":hierarchy\n  begin\n    root upper\n  end\n"
    amc = ":FULLY-SPECIFIED\n:DEGREES\n1\nroot 1 2 3 0 0 0\nupper 0 0 0\n2\nroot 1 2 3 0 0 9\nupper 9 0 0\n"
    yield Sample("AMC", "07_02.amc", amc.encode(), read_amc, {"07.asf": asf.encode()})
    yield Sample(
        "ASF",
        "07.asf",
        asf.encode(),
        lambda p: read_amc(p.with_name("07_02.amc")),
        {"07_02.amc": amc.encode()},
    )


def _poses(path: Path) -> object:
    reading = read_motions(read_poses(path))
    return reading.in_metres(reading.unit or "mm")


def _tables(folder: Path) -> Iterator[Sample]:
    frame = np.array([0, 1, 2])
    write_landmarks_csv(folder / "landmarks.csv", [_person()])
    write_tracks_csv(
        folder / "tracks.csv", Tracks(frame, np.ones(3, dtype=np.int64), frame / 30.0, np.ones((3, 3)))
    )
    write_detections_csv(folder / "detections.csv", frame, np.full((3, 2), 5.25))
    readers = {"landmarks": read_landmarks_csv, "tracks": read_tracks_csv, "detections": read_detections_csv}
    for name, reader in readers.items():
        yield Sample(f"{name}.csv", f"{name}.csv", (folder / f"{name}.csv").read_bytes(), reader)
    labels = b"frame,camera,u_px,v_px\n0,back,3.5,4.5\n0,cam_10,7,8\n"
    yield Sample("marker_labels.csv", "marker_labels.csv", labels, read_marker_labels_csv)
    actions = b"first_frame,last_frame,action,person\n0,10,walk,1\n11,20,turn,\n"
    yield Sample("actions.csv", "actions.csv", actions, read_actions_csv)


def _settings() -> Iterator[Sample]:
    session = b"""fps = 25.0
frames = [0, 10]
room_bounds_m = [[-1.0, -1, 0], [1, 1, 2.5]]
person_height_m = 1.7
marker_colour = "#ff0000"
cameras = ["back", "cam_10"]
calibration_units = "mm"
calibration_up = "-y"
checkerboard = [8, 6]
checkerboard_square_m = 0.03
[camera_map]
left = "back"
[roi_px]
back = [[0, 0], [9, 0], [9, 9.5]]
"""
    yield Sample("session.toml", "session.toml", session, read_session_settings)
    side = b'[truth]\nunit = "mm"\nup = "y"\nfps = 120.0\n[truth.landmarks]\nhead = ["a", "b"]\nneck = "c"\n'
    yield Sample("map", "map.toml", side, read_map)
    body = resources.files("mocap.body")
    for kind, folder, name, reader in (
        ("body", "presets", "anthropometric", load_body_model),
        ("marker set", "marker_sets", "markers_20", load_marker_set),
        ("hierarchy", "scalable", "model1", load_hierarchy),
        ("limbs", "scalable", "limbs", load_limbs),
    ):
        yield Sample(kind, "own.toml", (body / folder / f"{name}.toml").read_bytes(), reader)
    config = b"[pose]\nn_particles = 60\n[output]\nformats = ['bvh', 'trc']\n[segmentation]\nhold_s = 1.5\n"
    yield Sample("configuration", "own.toml", config, lambda p: load_config(str(p)))
    sweep = b"sessions = ['.']\nseeds = [0, 1]\npresets = ['default']\nframes = '0:8'\n"
    sweep += b"[grid]\n'pose.n_particles' = [20, 50]\n"
    yield Sample("sweep", "sweep.toml", sweep, read_sweep_spec)
    synth = resources.files("mocap.synth")
    scene = (synth / "scenes" / "development" / "two_persons.toml").read_bytes()
    yield Sample("scene", "scene.toml", scene, load_scene)
    joints = (synth / "capture" / "maps" / "cmu.toml").read_bytes()
    yield Sample("joint map", "joints.toml", joints, read_joint_map)


def _pictures(folder: Path) -> Iterator[Sample]:
    rng = np.random.default_rng(3)
    picture = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)
    for suffix in (".png", ".jpg", ".bmp", ".tif", ".webp", ".ppm"):
        encoded = cv2.imencode(suffix, picture)[1].tobytes()
        yield Sample(f"picture {suffix}", f"a{suffix}", encoded, _all_frames, is_text=False)
    masks = rng.random((4, 24, 32)) < 0.5
    for kind, save in (("", np.savez), (" packed", np.savez_compressed)):
        buffer = io.BytesIO()
        save(buffer, masks=np.packbits(masks, axis=2) if kind else masks, size=np.array([32, 24]))
        yield Sample(f"masks .npz{kind}", "m.npz", buffer.getvalue(), _all_masks, is_text=False)
    buffer = io.BytesIO()
    np.savez(
        buffer, origin_m=np.zeros(3), shape=np.array([4, 5, 6]), voxel_size_m=np.float64(0.05),
        offsets=np.array([0, 2, 3]), voxels=np.array([1, 2, 3], dtype=np.int32),
    )  # fmt: skip
    yield Sample("voxels.npz", "voxels.npz", buffer.getvalue(), read_true_voxels, is_text=False)
    for suffix, code in ((".mp4", "mp4v"), (".avi", "MJPG")):
        path = folder / f"a{suffix}"
        if suffix == ".mp4":
            write_video(path, [picture] * 6)
        else:
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), 25.0, (32, 24))
            for _ in range(6):
                writer.write(picture)
            writer.release()
        yield Sample(f"video {suffix}", f"a{suffix}", path.read_bytes(), _all_frames, is_text=False)


def _all_frames(path: Path) -> object:
    clip_info(path)
    return sum(1 for _ in iter_clip(path, size=(32, 24)))


def _all_masks(path: Path) -> object:
    info = clip_info(path, camera="back")
    rig = CameraRig((look_at("back", np.array([-3.0, 0.5, 1.5]), (32, 24)),))
    with MaskReader({"back": path}, rig, range(min(info.n_frames, 8))) as reader:
        return sum(1 for _ in reader)


# --- damage -------------------------------------------------------------------------------------------------

_WORDS = (
    b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e400", b"1e-320", b"-1", b"0", b"", b"99999999999999999999",
    b"9" * 5000, b"0.5", b"abc", b'"abc"', b"[]", b"{}", b"[[1, 2], [3]]", b"true", b"null", b"1e5", b"2147483648",
    b"\x00", b"\xff\xfe", b"\xed\xa0\x80", b'"\\ud800"', b"../../x", b"[" * 600, b"{" * 3000, b"-", b"%YAML:1.0",
    b"!!opencv-matrix", b"&a", b"*a", b"1970-01-01", b"0x10", b"\xef\xbb\xbf", b"\r", b"\t", b" " * 300,
)  # fmt: skip
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:e-?\d+)?")
_TOKEN = re.compile(rb"[A-Za-z_]+|-?\d+(?:\.\d+)?|[^\w\s]")


def damaged(sample: Sample, rng: np.random.Generator) -> bytes:
    """The content of a sample with one to three things wrong."""
    data = sample.content
    for _ in range(int(rng.integers(1, 4))):
        data = (_hurt_text if sample.is_text and rng.random() < 0.75 else _hurt_bytes)(data, rng)
    return data


def _hurt_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    kind = int(rng.integers(6))
    # Headers come first and decide most.
    near = len(data) if rng.random() < 0.5 else min(len(data), 600)
    i = int(rng.integers(near + 1)) if near else 0
    n = int(rng.integers(1, 40))
    if kind == 0:
        hurt = bytearray(data)
        for _ in range(int(rng.integers(1, 6))):
            if hurt:
                hurt[int(rng.integers(max(min(near, len(hurt)), 1)))] ^= 1 << int(rng.integers(8))
        return bytes(hurt)
    if kind == 1:
        return data[:i]
    if kind == 2:
        return data[:i] + data[i + n :]
    if kind == 3:
        return data[:i] + rng.bytes(n) + data[i:]
    if kind == 4:
        return data[:i] + bytes([int(rng.choice([0, 1, 127, 128, 255]))]) * n + data[i + n :]
    return data[: i + n] + data[i:]


def _hurt_text(data: bytes, rng: np.random.Generator) -> bytes:
    kind = int(rng.integers(4))
    if kind == 3:
        lines = data.split(b"\n")
        i, j = (int(rng.integers(len(lines))) for _ in range(2))
        if rng.random() < 0.5:
            return b"\n".join(lines[:i] + lines[i + 1 :])
        return b"\n".join([*lines[:i], lines[j], *lines[i:]])
    found = list((_NUMBER if kind < 2 else _TOKEN).finditer(data))
    if not found:
        return data
    match = found[int(rng.integers(len(found)))]
    word = _WORDS[int(rng.integers(len(_WORDS)))]
    return data[: match.start()] + word + data[match.end() :]


# --- the trial ----------------------------------------------------------------------------------------------


@contextmanager
def parser_server() -> Iterator[Callable[[], int]]:
    """Answers the two parsers of `mocap.io._child` by forks of one process; gives the number of crashes so far."""
    root = Path(__file__).resolve().parents[2]
    crashes = 0
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        server = stack.enter_context(
            subprocess.Popen(
                [sys.executable, "-c", SERVER, str(root)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        )
        assert server.stdin is not None
        assert server.stdout is not None

        def answer(kind: str, path: Path, memory: int, seconds: float) -> tuple[int, bytes]:
            nonlocal crashes
            out = Path(folder) / "out.npz"
            server.stdin.write(f"{kind}\t{memory}\t{seconds:.0f}\t{path}\t{out}\n")
            server.stdin.flush()
            code = int(server.stdout.readline())
            crashes += code != 0
            return code, out.read_bytes() if code == 0 else b""

        own, _child._output_of_child = _child._output_of_child, answer
        try:
            yield lambda: crashes
        finally:
            _child._output_of_child = own
            server.stdin.close()


def try_many(n: int, seed: int, folder: Path) -> dict[str, Count]:
    """Read n damaged files, spread evenly over all samples; counts by kind."""
    everything = samples(folder)
    counts = {sample.kind: Count() for sample in everything}
    place = folder / "case"
    with parser_server() as crashes:
        for k in range(n):
            sample = everything[k % len(everything)]
            rng = np.random.default_rng([seed, k])
            _one(
                sample, damaged(sample, rng), place, counts[sample.kind], f"{sample.kind} {seed} {k}", crashes
            )
    return counts


def _one(
    sample: Sample, content: bytes, place: Path, count: Count, label: str, crashes: Callable[[], int]
) -> None:
    place.mkdir(exist_ok=True)
    for name, data in {**sample.beside, sample.name: content}.items():
        (place / name).write_bytes(data)
    before, begin = crashes(), time.perf_counter()
    count.tried += 1
    try:
        # A warning of numpy is as good as an error here: somebody went on with what is no number.
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            sample.read(place / sample.name)
        count.values += 1
    except MocapError:
        count.refused += 1
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        count.failures.append(f"{label}: {type(error).__name__}: {str(error)[:200]}")
    count.crashed_in_child += crashes() - before
    took = time.perf_counter() - begin
    count.slowest_s = max(count.slowest_s, took)
    if took > SLOW_S:
        count.failures.append(f"{label}: {took:.1f} s")
    for path in place.iterdir():
        path.unlink()


def table(counts: dict[str, Count]) -> str:
    """The counts as a Markdown table."""
    lines = [
        "| file | tried | read | refused with a message | parser died in its own process | slowest, s | failed |",
        "|---|---|---|---|---|---|---|",
    ]
    total = Count()
    for kind, c in counts.items():
        lines.append(_row(kind, c))
        total.tried += c.tried
        total.values += c.values
        total.refused += c.refused
        total.crashed_in_child += c.crashed_in_child
        total.slowest_s = max(total.slowest_s, c.slowest_s)
        total.failures += c.failures
    return "\n".join([*lines, _row("**all**", total)])


def _row(kind: str, c: Count) -> str:
    return (
        f"| {kind} | {c.tried} | {c.values} | {c.refused} | {c.crashed_in_child} | {c.slowest_s:.2f} | "
        f"{len(c.failures)} |"
    )


def main() -> int:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    with tempfile.TemporaryDirectory() as folder:
        counts = try_many(n, seed, Path(folder))
    print(table(counts))
    failures = [f for c in counts.values() for f in c.failures]
    print("\n".join(failures[:60]), file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
