"""Small recordings written in the layouts of public sets, from one truth: what their readers must give back."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from foreign_rigs import Lens, truth
from io_samples import write_video
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

N_PICTURES = 13
SIZES = ((128, 72), (64, 48), (96, 160))
SUBJECT = 9
# World of a set in ours: rows are x, y, z of the file.
Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
Y_DOWN = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def lenses(words: str) -> list[Lens]:
    """Three cameras with small pictures; world to camera in metres, z up."""
    small = []
    for lens, size in zip(truth(words), SIZES, strict=True):
        factor = max(size) / max(lens.size)
        K = lens.K.copy()
        K[:2] *= factor
        K[:2, 2] = size[0] / 2 - 1.25, size[1] / 2 + 2.5
        small.append(replace(lens, size=size, K=K))
    return small


def joints(n_joints: int, n_frames: int = N_PICTURES) -> Array:
    """Places (T, J, 3) m in our world, each another, of somebody who moves."""
    rng = np.random.default_rng(n_joints)
    still = rng.uniform([-0.3, -0.3, 0.1], [0.3, 0.3, 1.7], (n_joints, 3))
    return still + 0.01 * np.arange(n_frames)[:, None, None] * [1.0, -0.5, 0.2]


def standing(names: tuple[str, ...], places: Array) -> Array:
    """The places with shoulders above ankles, whichever of the names are so."""
    out = places.copy()
    for k, name in enumerate(names):
        if any(word in name.lower() for word in ("foot", "ankle", "ank")):
            out[:, k, 2] = 0.08
        if any(word in name.lower() for word in ("arm", "shoulder", "sho")):
            out[:, k, 2] = 1.4
    return out


def in_world(lens: Lens, turn: Array) -> tuple[Array, Array]:
    """R and t of a lens whose world is turned: file = turn @ ours."""
    return lens.R @ turn.T, lens.t


def clips(folder: Path, name_of: Callable[[int], str], fps: float, n: int = N_PICTURES) -> None:
    for k, size in enumerate(SIZES):
        picture = np.full((size[1], size[0], 3), 40 + 50 * k, dtype=np.uint8)
        write_video(folder / name_of(k), [picture] * n, fps)


def numbers(values: Any) -> str:
    return " ".join(f"{value:.10g}" for value in np.ravel(values))


# --- one writer for each set: what it holds in our world -----------------------------------------------------------


def totalcapture(root: Path, words: str = "k1") -> tuple[list[Lens], Array, tuple[str, ...]]:
    names = ("Hips", "Spine", "Spine1", "Spine2", "Spine3", "Neck", "Head",
             "RightShoulder", "RightArm", "RightForeArm", "RightHand",
             "LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand",
             "RightUpLeg", "RightLeg", "RightFoot", "LeftUpLeg", "LeftLeg", "LeftFoot")  # fmt: skip
    rig, places = lenses(words), standing(names, joints(len(names)))
    lines = [f"{len(rig)} 1"]
    for lens in rig:
        R, t = in_world(lens, Y_UP)
        w, h = lens.size
        K = lens.K
        lines += [
            f"0 {h - 1} 0 {w - 1}",
            numbers([K[0, 0], K[1, 1], K[0, 2], K[1, 2]]),
            numbers(lens.dist[:1]),
        ]
        lines += [numbers(row) for row in R] + [numbers(t)]
    root.mkdir(parents=True)
    (root / "calibration.cal").write_text("\n".join(lines) + "\n")
    take = root / "s1" / "acting1"
    clips(take, lambda k: f"TC_S1_acting1_cam{k + 1}.mp4", 60.0)
    inches = places @ Y_UP.T / 0.0254
    rows = ["\t".join(names) + "\t"]
    rows += ["\t".join(numbers(joint) for joint in frame) + "\t" for frame in inches]
    (take / "gt_skel_gbl_pos.txt").write_text("\n".join(rows) + "\n")
    return rig, places, names


def mpi_inf_3dhp(root: Path) -> tuple[list[Lens], Array, tuple[str, ...]]:
    from scipy.io import savemat

    names = ("spine3", "spine4", "spine2", "spine", "pelvis", "neck", "head", "head_top",
             "left_clavicle", "left_shoulder", "left_elbow", "left_wrist", "left_hand",
             "right_clavicle", "right_shoulder", "right_elbow", "right_wrist", "right_hand",
             "left_hip", "left_knee", "left_ankle", "left_foot", "left_toe",
             "right_hip", "right_knee", "right_ankle", "right_foot", "right_toe")  # fmt: skip
    rig, places = lenses("0"), standing(names, joints(len(names)))
    lines, seen = ["Skeletool Camera Calibration File V1.0"], np.empty((len(rig), 1), dtype=object)
    for k, lens in enumerate(rig):
        R, t = in_world(lens, Y_UP)
        inner, outer = np.eye(4), np.eye(4)
        inner[:3, :3], outer[:3, :3], outer[:3, 3] = lens.K, R, 1000.0 * t
        lines += [f"name          {k}", "  sensor      10 10", f"  size        {lens.size[0]} {lens.size[1]}"]
        lines += ["  animated    0", f"  intrinsic   {numbers(inner)} ", f"  extrinsic   {numbers(outer)} "]
        lines += ["  radial      0"]
        seen[k, 0] = (1000.0 * (places @ lens.R.T + lens.t)).reshape(len(places), -1)
    take = root / "S2" / "Seq1"
    clips(take / "imageSequence", lambda k: f"video_{k}.avi", 25.0)
    (take / "camera.calibration").write_text("\n".join(lines) + "\n")
    savemat(take / "annot.mat", {"annot3": seen, "frames": np.arange(len(places))[:, None]})
    return rig, places, names


def human36m(root: Path, write_cdf: Callable[[Path, Array], None]) -> tuple[list[Lens], Array]:
    """Its fourth camera has no video. write_cdf : writes the variable Pose (1, T, 96)."""
    rig, places = lenses("k1 k2 p1 p2 k3"), joints(32)
    places[:, [3, 8], 2], places[:, [17, 25], 2] = 0.08, 1.4
    outer, inner = np.zeros((4, 11, 6)), np.ones((4, 9))
    for k, lens in enumerate([*rig, rig[0]]):
        angles = Rotation.from_matrix(lens.R).as_euler("XYZ")
        outer[k, SUBJECT - 1] = *angles, *(-1000.0 * lens.R.T @ lens.t)
        k1, k2, p1, p2, k3 = lens.dist
        inner[k] = lens.K[0, 0], lens.K[1, 1], lens.K[0, 2], lens.K[1, 2], k1, k2, k3, p1, p2
    root.mkdir(parents=True)
    w0 = " ".join(f"{value:.12g}" for value in [*outer.ravel(), *inner.ravel()])
    (root / "metadata.xml").write_text(f"<metadata><frequency>50</frequency><w0>[{w0}]</w0></metadata>")
    serials = ("54138969", "55011271", "58860488")
    folder = root / f"S{SUBJECT}"
    clips(folder / "Videos", lambda k: f"Walking 1.{serials[k]}.mp4", 50.0)
    path = folder / "MyPoseFeatures" / "D3_Positions" / "Walking 1.cdf"
    path.parent.mkdir(parents=True)
    write_cdf(path, (1000.0 * places).reshape(1, len(places), -1))
    return rig, places


def panoptic(root: Path) -> tuple[list[Lens], Array]:
    """Two persons; the second comes later. Cameras of VGA and their clips lie beside."""
    rig, places = lenses("k1 k2 p1 p2 k3"), np.stack([joints(19), joints(19) + 0.2])
    places[:, :, [8, 14], 2], places[:, :, [3, 9], 2] = 0.08, 1.4
    cameras: list[dict[str, Any]] = [{"name": "01_01", "type": "vga", "resolution": [640, 480]}]
    for k, lens in enumerate(rig):
        R, t = in_world(lens, Y_DOWN)
        cameras.append({"name": f"00_{k:02d}", "type": "hd", "resolution": list(lens.size)})
        own = {"K": lens.K, "distCoef": lens.dist, "R": R, "t": 100.0 * t[:, None]}
        cameras[-1] |= {key: value.tolist() for key, value in own.items()}
    cameras[0] |= {key: cameras[1][key] for key in ("K", "distCoef", "R", "t")}
    sequence = root / "171204_pose1"
    clips(sequence / "hdVideos", lambda k: f"hd_00_{k:02d}.mp4", 29.97)
    (sequence / "calibration_171204_pose1.json").write_text(json.dumps({"cameras": cameras}))
    folder = sequence / "hdPose3d_stage1_coco19"
    folder.mkdir()
    for frame in range(N_PICTURES):
        bodies = []
        for person in (0, 1)[: 1 + (frame > 4)]:
            with_sure = np.concatenate([100.0 * places[person, frame] @ Y_DOWN.T, np.ones((19, 1))], axis=1)
            bodies.append({"id": person, "joints19": with_sure.ravel().tolist()})
        (folder / f"body3DScene_{frame:08d}.json").write_text(json.dumps({"version": 0.7, "bodies": bodies}))
    return rig, places


def write_markers(path: Path, names: tuple[str, ...], places: Array, rate: float, first: int = 0) -> None:
    """A C3D file in mm, z up, as laboratories write it."""
    import ezc3d

    c3d = ezc3d.c3d()
    c3d["parameters"]["POINT"]["RATE"]["value"] = [rate]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = list(names)
    c3d["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    c3d["header"]["points"]["first_frame"] = first
    points = np.ones((4, len(names), len(places)))
    points[:3] = 1000.0 * places.transpose(2, 1, 0)
    c3d["data"]["points"] = points
    path.parent.mkdir(parents=True, exist_ok=True)
    c3d.write(str(path))


PLUG_IN_GAIT = (
    "LFHD", "RFHD", "LBHD", "RBHD", "C7", "CLAV", "LSHO", "LELB", "LWRA", "LWRB", "RSHO", "RELB", "RWRA", "RWRB",
    "LASI", "RASI", "LPSI", "RPSI", "LKNE", "LANK", "RKNE", "RANK",
)  # fmt: skip


def humaneva(root: Path) -> tuple[list[Lens], Array]:
    """C1, C2 and BW1 begin apart: C2 two pictures before the markers, BW1 two after their first row. Rows at 120 Hz."""
    rig, places = lenses("k1 k2 p1 p2 k3"), standing(PLUG_IN_GAIT, joints(len(PLUG_IN_GAIT), 2 * N_PICTURES))
    names = ("C1", "C2", "BW1")
    subject = root / "HumanEva_I" / "S1"
    for folder in ("Calibration_Data", "Sync_Data"):
        (subject / folder).mkdir(parents=True)
    for name, lens, (picture, row) in zip(names, rig, ((1, 1), (3, 1), (1, 5)), strict=True):
        K = lens.K
        values = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], 0.0, *lens.dist, *lens.R.ravel(), *(1000.0 * lens.t)]
        (subject / "Calibration_Data" / f"{name}.cal").write_text("\n".join(map(repr, map(float, values))))
        (subject / "Sync_Data" / f"Walking_1_({name}).ofs").write_text(f"{picture}\n{row}\n2.0\n")
    clips(subject / "Image_Data", lambda k: f"Walking_1_({names[k]}).avi", 60.0)
    clips(root / "HumanEva_I" / "Background", lambda k: f"Background_1_({names[k]}).avi", 60.0, 5)
    labels = tuple(f"Subject:{name}" for name in PLUG_IN_GAIT)
    write_markers(subject / "Mocap_Data" / "Walking_1.c3d", labels, places, 120.0, first=7)
    return rig, places


def biocv(root: Path) -> tuple[list[Lens], Array]:
    rig, places = lenses("k1 k2 p1 p2 k3"), standing(PLUG_IN_GAIT, joints(len(PLUG_IN_GAIT)))
    participant = root / "P03"
    clips(participant / "P03_WALK_01", lambda k: f"{k:02d}.mp4", 200.0)
    for k, lens in enumerate(rig):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = lens.R, 1000.0 * lens.t
        rows = [
            *(str(n) for n in lens.size),
            *map(numbers, lens.K),
            "",
            *map(numbers, pose),
            "",
            numbers(lens.dist),
        ]
        (participant / f"{k:02d}.mp4.calib").write_text("\n".join(rows) + "\n")
    write_markers(participant / "P03_WALK_01" / "markers.c3d", PLUG_IN_GAIT, places, 200.0)
    return rig, places
