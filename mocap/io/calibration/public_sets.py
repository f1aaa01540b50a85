"""Calibrations of public sets: MPI-INF-3DHP (Skeletool), TotalCapture (.cal) and Human3.6M (metadata.xml)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mocap.files import DOCUMENT_LIMIT_BYTES, read_text
from mocap.io.calibration.laboratory import numbers_in, xml_root
from mocap.io.calibration.record import RawCamera, RawRig, bad, camera_name, distortion, numbers, picture_size

# Serial numbers of the cameras of Human3.6M, in the order in which its metadata count them.
HUMAN36M_CAMERAS = ("54138969", "55011271", "58860488", "60457274")
HUMAN36M_SUBJECTS = 11
_N_OUTER, _N_INNER = 6, 9  # numbers of a camera of Human3.6M: per subject, and for all
_TOTALCAPTURE_LINES, _TOTALCAPTURE_NUMBERS = 7, 21  # of a camera


def read_skeletool(path: Path) -> RawRig:
    """All cameras of a Skeletool file, as MPI-INF-3DHP has it: a keyword and its numbers on a line, `name` first.

    `intrinsic` and `extrinsic` are 4 x 4 by rows, mm, world to camera; y points up. `radial`, when it is not 0, is k1.
    """
    lines = [line.split() for line in _text(path).splitlines() if line.strip()]
    if not lines or lines[0][0].lower() != "skeletool":
        raise bad(path, "the file does not begin with `Skeletool Camera Calibration File`")
    tables: list[dict[str, list[str]]] = []
    for word, *rest in lines[1:]:
        if word == "name":
            tables.append({})
        if not tables:
            raise bad(path, f"{word} stands before the first `name`")
        tables[-1][word] = rest
    return RawRig(tuple(_skeletool_camera(path, t) for t in tables), "skeletool", units="mm", up="y")


def _skeletool_camera(path: Path, table: dict[str, list[str]]) -> RawCamera:
    name = camera_name(path, " ".join(table["name"]))
    if missing := [word for word in ("size", "intrinsic", "extrinsic") if word not in table]:
        raise bad(path, f"{missing[0]} is missing", camera=name)
    found = {word: numbers_in(path, " ".join(table.get(word, [])), name) for word in table if word != "name"}
    K = numbers(path, name, "intrinsic", found["intrinsic"], (4, 4))[:3, :3]
    pose = numbers(path, name, "extrinsic", found["extrinsic"], (4, 4))
    radial = distortion(path, name, found.get("radial", [])[:1], False)
    return RawCamera(name, picture_size(path, name, found["size"]), K, radial, pose[:3, :3], pose[:3, 3])


def is_totalcapture(path: Path) -> bool:
    """Whether a .cal is TotalCapture's: the count of its cameras says how many numbers there are."""
    words = _text(path).split()
    return len(words) > 1 and words[0] == f"{(len(words) - 2) / _TOTALCAPTURE_NUMBERS:g}"


def read_totalcapture(path: Path) -> RawRig:
    """All cameras of TotalCapture, called cam1, cam2, ... as the videos: their count, then of each the first and last
    rows and columns of its picture, fx fy cx cy, k1, R by rows and t in metres; y points up."""
    lines = [line for line in _text(path).splitlines() if line.strip()]
    head = numbers_in(path, lines[0] if lines else "", None)
    n = int(head[0]) if head else 0
    if len(head) != 2 or n < 1 or len(lines) != 1 + n * _TOTALCAPTURE_LINES:
        raise bad(path, f"expected the count of cameras and {_TOTALCAPTURE_LINES} lines for each")
    blocks = [lines[1 + k * _TOTALCAPTURE_LINES :][:_TOTALCAPTURE_LINES] for k in range(n)]
    return RawRig(
        tuple(_totalcapture_camera(path, f"cam{k + 1}", block) for k, block in enumerate(blocks)),
        "totalcapture",
        units="m",
        up="y",
    )


def _totalcapture_camera(path: Path, name: str, block: list[str]) -> RawCamera:
    rows = [numbers_in(path, line, name) for line in block]
    top, bottom, left, right = numbers(path, name, "the picture", rows[0], (4,))
    fx, fy, cx, cy = numbers(path, name, "the lens", rows[1], (4,))
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    R = numbers(path, name, "R", [number for row in rows[3:6] for number in row], (3, 3))
    size = picture_size(path, name, [right - left + 1, bottom - top + 1])
    k1 = distortion(path, name, numbers(path, name, "the distortion", rows[2], (1,)), False)
    return RawCamera(name, size, K, k1, R, numbers(path, name, "t", rows[6], (3,)))


def read_human36m(path: Path, subject: int) -> RawRig:
    """The four cameras of a subject of Human3.6M, out of `w0` of its metadata.xml.

    subject : 1 to 11. For every camera and subject w0 has three angles (R = Rx Ry Rz, world to camera) and the place of
    the camera in mm; then for every camera fx fy cx cy k1 k2 k3 p1 p2. z points up; picture sizes are not in it.
    """
    node = xml_root(path).find(".//w0")
    text = "" if node is None or node.text is None else node.text.strip().strip("[]")
    n_cameras = len(HUMAN36M_CAMERAS)
    n_outer = n_cameras * HUMAN36M_SUBJECTS * _N_OUTER
    w0 = np.array(numbers_in(path, text, None))
    if len(w0) != n_outer + n_cameras * _N_INNER:
        raise bad(path, f"w0 has {len(w0)} numbers, expected {n_outer + n_cameras * _N_INNER}")
    outer = w0[:n_outer].reshape(n_cameras, HUMAN36M_SUBJECTS, _N_OUTER)[:, subject - 1]
    inner = w0[n_outer:].reshape(n_cameras, _N_INNER)
    cameras = []
    for name, (*angles, x, y, z), (fx, fy, cx, cy, k1, k2, k3, p1, p2) in zip(
        HUMAN36M_CAMERAS, outer.tolist(), inner.tolist(), strict=True
    ):
        R = Rotation.from_euler("XYZ", angles).as_matrix()
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        dist = distortion(path, name, [k1, k2, p1, p2, k3], False)
        cameras.append(RawCamera(name, None, K, dist, R, -R @ np.array([x, y, z])))
    return RawRig(tuple(cameras), "human36m", units="mm", up="z")


def _text(path: Path) -> str:
    return read_text(path, "the calibration", limit=DOCUMENT_LIMIT_BYTES)
