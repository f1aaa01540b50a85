"""CMU Panoptic JSON: one file per frame with the bodies in it (hdPose3d)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from mocap.errors import MocapError
from mocap.files import load_json
from mocap.io.formats.table import PoseFile, PoseTable, check_places
from mocap.io.units import Z_UP_FROM

HD_FPS = 29.97
_MOST = 10**15
_FOLDERS = ("hdPose3d_stage1_coco19", "hdPose3d_stage1")
_MPI15 = (
    "Neck", "HeadTop", "BodyCenter", "lShoulder", "lElbow", "lWrist", "lHip", "lKnee", "lAnkle",
    "rShoulder", "rElbow", "rWrist", "rHip", "rKnee", "rAnkle",
)  # fmt: skip
_COCO19 = (_MPI15[0], "Nose", *_MPI15[2:], "lEye", "lEar", "rEye", "rEar")
_SKELETONS = {"joints19": _COCO19, "joints15": _MPI15}


def panoptic_folder(path: Path) -> Path | None:
    """The folder of the JSON files when `path` is one, or a Panoptic sequence; else None."""
    for folder in (path, *(path / name for name in _FOLDERS)):
        if folder.is_dir() and any(folder.glob("body3DScene_*.json")):
            return folder
    return None


def read_panoptic(path: Path) -> PoseFile:
    """Read a folder of `body3DScene_FRAME.json` files, or a single one: persons by their id.

    Centimetres, y down (up is -y), turned as the calibration of a sequence is; 29.97 frames per second; a joint of
    confidence 0 or less (-1) is unknown.
    Raises MocapError for a file that is no such JSON.
    """
    path = Path(path)
    folder = panoptic_folder(path) if path.is_dir() else None
    files = sorted(folder.glob("body3DScene_*.json")) if folder else [path]
    kinds, found = _bodies_of(files)
    if len(kinds) > 1:
        raise _bad(path, f"files mix {' and '.join(sorted(kinds))}")
    names = _SKELETONS[kinds.pop()] if kinds else _COCO19
    people = []
    for person in sorted(found):
        frames = np.array(sorted(found[person]), dtype=np.int64)
        xyz = np.stack([found[person][f] for f in frames.tolist()])
        people.append(PoseTable(person, names, frames, frames / HD_FPS, xyz))
    return PoseFile(path, "Panoptic JSON", tuple(people), HD_FPS, "cm", "-y", world_from_file=Z_UP_FROM["-y"])


def _bodies_of(files: list[Path]) -> tuple[set[str], dict[int, dict[int, np.ndarray]]]:
    """Kinds of skeletons that the files hold, and person -> frame -> joints (K, 3)."""
    found: dict[int, dict[int, np.ndarray]] = {}
    kinds = set()
    for file in files:
        match = re.search(r"(\d+)$", file.stem)
        frame = int(match.group(1)[-15:]) if match else 0
        for body in _bodies(file):
            person, kind, joints = _body(file, body)
            kinds.add(kind)
            if frame in found.setdefault(person, {}):
                raise _bad(file, f"body {person} is there twice")
            found[person][frame] = joints
    return kinds, found


def _bodies(file: Path) -> list[Any]:
    content = load_json(file, remedy="unpack the sequence again")
    bodies = content.get("bodies") if isinstance(content, dict) else None
    if not isinstance(bodies, list):
        raise _bad(file, "not a Panoptic pose file: it has no list `bodies`")
    return bodies


def _body(file: Path, body: Any) -> tuple[int, str, np.ndarray]:
    """Number, kind of skeleton and joints (K, 3) of one body; NaN = unknown."""
    kind = next((k for k in _SKELETONS if isinstance(body, dict) and k in body), None)
    person = body.get("id") if isinstance(body, dict) else None
    if kind is None or not isinstance(person, int) or abs(person) > _MOST:
        raise _bad(file, "a body lacks `id`, or `joints19` and `joints15`")
    try:
        values = np.array(body[kind], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise _bad(file, f"{kind} of body {person} are not numbers") from error
    if values.shape != (4 * len(_SKELETONS[kind]),):
        raise _bad(file, f"{kind} of body {person} has {values.size} numbers, expected 4 per joint")
    joints = values.reshape(-1, 4)
    check_places(file, joints[:, :3])
    return person, kind, np.where(joints[:, 3:] > 0, joints[:, :3], np.nan)


def _bad(path: Path, message: str) -> MocapError:
    return MocapError(message, path=path, remedy="unpack the sequence again")
