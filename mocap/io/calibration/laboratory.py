"""Calibrations of motion capture laboratories: HumanEva (.cal), bioCV (.calib), Qualisys (.qca.txt), Vicon (.xcp)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from mocap.errors import MocapError
from mocap.files import DOCUMENT_LIMIT_BYTES, read_text
from mocap.io.calibration.record import (
    RawCamera,
    RawRig,
    bad,
    camera_name,
    distortion,
    numbers,
    picture_size,
)

_QUALISYS_SUBPIXELS = 64.0  # of a pixel, in which Qualisys counts
_VIDEO_MODELS = ("video", "hybrid", "none")
_HUMANEVA_NUMBERS = 22


def read_humaneva(path: Path) -> RawRig:
    """One camera: fx fy cx cy skew k1 k2 p1 p2 k3, R by rows, t in mm; x_cam = R x + t.

    The skew of these files is a share of fx (Caltech's toolbox); the size of the pictures is not in them.
    """
    name = camera_name(path, path.stem)
    values = numbers_in(path, read_text(path, "the calibration", limit=DOCUMENT_LIMIT_BYTES), name)
    if len(values) != _HUMANEVA_NUMBERS:
        raise bad(path, f"{len(values)} numbers, expected {_HUMANEVA_NUMBERS}", camera=name)
    fx, fy, cx, cy, skew = values[:5]
    K = np.array([[fx, skew * fx, cx], [0, fy, cy], [0, 0, 1.0]])
    dist = distortion(path, name, values[5:10], False)
    camera = RawCamera(name, None, K, dist, np.reshape(values[10:19], (3, 3)), np.array(values[19:22]))
    return RawRig((camera,), "humaneva", units="mm")


def read_biocv(path: Path) -> RawRig:
    """One camera: width, height, K by rows, [R | t] by rows in mm, distortion on the last line."""
    name = camera_name(path, path.name.split(".")[0])
    text = read_text(path, "the calibration", limit=DOCUMENT_LIMIT_BYTES)
    lines = [numbers_in(path, line, name) for line in text.splitlines() if line.strip()]
    head = [number for line in lines[:2] for number in line]
    counts = [len(line) for line in lines[2:8]]
    if len(head) != 2 or counts != [3, 3, 3, 4, 4, 4] or len(lines) < 9:
        raise bad(
            path,
            "expected width, height, three rows of K, three rows of [R | t] and the distortion",
            camera=name,
        )
    pose = np.array(lines[5:8])
    return RawRig(
        (
            RawCamera(
                name,
                picture_size(path, name, head),
                np.array(lines[2:5]),
                distortion(path, name, lines[-1][:5], False),
                pose[:, :3],
                pose[:, 3],
            ),
        ),
        "biocv",
        units="mm",
    )


def read_qualisys(path: Path) -> RawRig:
    """The video cameras of a file of Qualisys Track Manager; cameras for markers alone are left out.

    Lengths of lenses are in 64ths of a pixel of the sensor, of which fov_video is what was filmed. The matrix turns the
    camera's axes, of which y and z are the other way round than ours, into the world.
    """
    root = xml_root(path)
    found, notes, warnings = [], [], []
    for k, entry in enumerate(root.findall("cameras/camera")):
        name = camera_name(path, entry.get("serial") or str(k))
        if not any(word in (entry.get("model") or "none").lower() for word in _VIDEO_MODELS):
            notes.append(f"camera {name} films no video and is left out")
            continue
        if (entry.get("viewrotation") or "0") != "0":
            warnings.append(
                f"camera {name}: its pictures must be as filmed, not turned as Qualisys shows them"
            )
        found.append(_qualisys_camera(path, name, entry))
    return RawRig(tuple(found), "qualisys", units="mm", notes=tuple(notes), warnings=tuple(warnings))


def _qualisys_camera(path: Path, name: str, entry: ElementTree.Element) -> RawCamera:
    view, pose, lens = (_child(path, name, entry, tag) for tag in ("fov_video", "transform", "intrinsic"))
    left, top, right, bottom = _attributes(path, name, view, ("left", "top", "right", "bottom"))
    fu, fv, cu, cv = (
        value / _QUALISYS_SUBPIXELS
        for value in _attributes(
            path, name, lens, ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
        )
    )
    k1, k2, p1, p2 = _attributes(
        path,
        name,
        lens,
        ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2"),
    )
    place = np.array(_attributes(path, name, pose, ("x", "y", "z")))
    turn = _attributes(path, name, pose, [f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)])
    R = np.diag([1.0, -1.0, -1.0]) @ np.reshape(turn, (3, 3))
    return RawCamera(
        name,
        picture_size(path, name, [right - left + 1, bottom - top + 1]),
        np.array([[fu, 0, cu - left], [0, fv, cv - top], [0, 0, 1.0]]),
        distortion(path, name, [k1, k2, p1, p2], False),
        R,
        -R @ place,
    )


def read_vicon(path: Path) -> RawRig:
    """The video cameras of a .xcp file; all, when none is called a video camera.

    ORIENTATION is the quaternion x y z w from the world to the camera, POSITION the camera's place in mm. The lens
    model of Vicon (VICON_RADIAL2: centre, then k1 k2 k3) is taken for OpenCV's.
    """
    root = xml_root(path)
    entries = root.findall("Camera")
    videos = [
        entry
        for entry in entries
        if "video" in (entry.get("TYPE") or entry.get("DISPLAY_TYPE") or "").lower()
    ]
    found, notes = [], []
    for k, entry in enumerate(videos or entries):
        name = camera_name(path, entry.get("DEVICEID") or str(k))
        key = entry.find("KeyFrames/KeyFrame")
        if key is None:
            notes.append(f"camera {name} was not calibrated and is left out")
            continue
        found.append(_vicon_camera(path, name, entry, key))
    warnings = (
        "the lens model of Vicon is taken for OpenCV's; look at the edges of the pictures in `mocap check`",
    )
    return RawRig(tuple(found), "vicon", units="mm", notes=tuple(notes), warnings=warnings if found else ())


def _vicon_camera(path: Path, name: str, entry: ElementTree.Element, key: ElementTree.Element) -> RawCamera:
    (focal,) = _listed(path, name, key, "FOCAL_LENGTH", 1)
    (aspect,) = (
        _listed(path, name, entry, "PIXEL_ASPECT_RATIO", 1) if entry.get("PIXEL_ASPECT_RATIO") else (1.0,)
    )
    if aspect <= 0:
        raise bad(path, f"PIXEL_ASPECT_RATIO is {aspect:g}", camera=name)
    cx, cy = _listed(path, name, key, "PRINCIPAL_POINT", 2)
    quaternion = np.array(_listed(path, name, key, "ORIENTATION", 4))
    if not np.linalg.norm(quaternion) > 0.5:
        raise bad(path, "ORIENTATION is no quaternion", camera=name)
    R = Rotation.from_quat(quaternion).as_matrix()
    radial = (key.get("VICON_RADIAL2") or "").split()[3:6]
    k1, k2, k3 = [*numbers_in(path, " ".join(radial), name), 0.0, 0.0, 0.0][:3]
    size = _listed(path, name, entry, "SENSOR_SIZE", 2) if entry.get("SENSOR_SIZE") else None
    return RawCamera(
        name,
        None if size is None else picture_size(path, name, size),
        np.array([[focal, 0, cx], [0, focal / aspect, cy], [0, 0, 1.0]]),
        distortion(path, name, [k1, k2, 0.0, 0.0, k3], False),
        R,
        -R @ np.array(_listed(path, name, key, "POSITION", 3)),
    )


def joined(parts: Sequence[RawRig]) -> RawRig:
    """The cameras of several files of one format as one rig."""
    return replace(
        parts[0],
        cameras=tuple(camera for part in parts for camera in part.cameras),
        notes=tuple(dict.fromkeys(note for part in parts for note in part.notes)),
        warnings=tuple(dict.fromkeys(word for part in parts for word in part.warnings)),
    )


def xml_root(path: Path) -> ElementTree.Element:
    """The root of an XML file. Definitions of entities, which can grow without end, are refused."""
    text = read_text(path, "the calibration", limit=DOCUMENT_LIMIT_BYTES)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise bad(path, "the file defines its own entities, which no calibration does")
    try:
        return ElementTree.fromstring(
            text.encode("utf-8") if not text.startswith("<?xml") else _undeclared(text)
        )
    except ElementTree.ParseError as error:
        raise MocapError(
            f"the calibration is no XML: {error}", path=path, remedy="export it again"
        ) from error


def _undeclared(text: str) -> str:
    """Without the declaration, whose encoding the text has no more."""
    return text[text.index("?>") + 2 :] if "?>" in text else text


def _child(path: Path, name: str, entry: ElementTree.Element, tag: str) -> ElementTree.Element:
    found = entry.find(tag)
    if found is None:
        raise bad(path, f"{tag} is missing", camera=name)
    return found


def _attributes(path: Path, name: str, entry: ElementTree.Element, keys: Sequence[str]) -> list[float]:
    return [_listed(path, name, entry, key, 1)[0] for key in keys]


def _listed(path: Path, name: str, entry: ElementTree.Element, key: str, n: int) -> list[float]:
    """The n numbers of an attribute."""
    text = entry.get(key)
    if text is None:
        raise bad(path, f"{key} is missing", camera=name)
    return numbers(path, name, key, numbers_in(path, text, name), (n,)).tolist()


def numbers_in(path: Path, text: str, name: str | None) -> list[float]:
    """Finite numbers of a text, apart by spaces or commas."""
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError as error:
        raise bad(path, f"holds what is no number: {str(error)[-40:]}", camera=name) from error
    return numbers(path, name, "the file", values, (len(values),)).tolist() if values else []
