"""Calibration files of other tools and our own: read into a rig in metres with z up, and write back exactly.

Our own file is the anipose-style TOML with `[metadata] units = "m"`. Every conversion that a reader makes is
reported in `CalibrationFile.notes`, every doubt in `CalibrationFile.warnings`.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.geometry.rigid import matrix_from_rotation_vector, rotation_vector_from_matrix
from mocap.io._files import atomic_text

Array = NDArray[np.float64]

METRES_PER_UNIT: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}

# Largest distance between two cameras of a rig that films people.
PLAUSIBLE_SPAN_M = (0.3, 100.0)
# A camera standing on the floor of a roughly levelled rig may come out a little below it.
FLOOR_TOLERANCE_M = 0.3
# Six printed decimals make R wrong by 1e-6; beyond 1e-2 it is another matrix, not a rounded rotation.
# Below 1e-9 the matrix is left alone, so that our own files come back bit for bit.
_ROTATION_EXACT, _ROTATION_NOTE, _ROTATION_LIMIT = 1e-9, 1e-6, 1e-2

# Rows are our x, y, z (z up) in the axes of the file. Proper rotations: left and right stay what they are.
_AXES_TO_Z_UP: dict[str, Array] = {
    "z": np.eye(3),
    "-z": np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]]),
    "y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "-y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "x": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "-x": np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]]),
}


@dataclass(frozen=True, eq=False)
class CalibrationFile:
    """What a calibration file said, converted to metres, z up, world to camera.

    units : unit of the translations in the file.  notes : conversions that were made.  warnings : doubts.
    rms_px : reprojection error that the file itself claims, px, or None.
    guessed_sizes : cameras whose picture size the file does not give; twice the principal point was taken.
    """

    rig: CameraRig
    path: Path
    format: str
    units: str
    notes: tuple[str, ...] = ()
    rms_px: float | None = None
    warnings: tuple[str, ...] = ()
    guessed_sizes: frozenset[str] = frozenset()


@dataclass
class _RawCamera:
    """One camera as the file has it: own unit, own world axes, nothing checked but the shapes."""

    name: str
    size: tuple[int, int] | None
    K: Array
    dist: Array
    R: Array
    t: Array
    is_fisheye: bool = False


@dataclass
class _RawRig:
    cameras: list[_RawCamera]
    format: str
    units: str | None = None
    is_unit_sure: bool = True
    up: str | None = None
    rms_px: float | None = None
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def unit_from_word(word: str) -> str | None:
    """ "m", "cm" or "mm" of a word like "metres"; None when it is no length unit we know."""
    w = word.strip().lower()
    if w in METRES_PER_UNIT:
        return w
    stem = w.removesuffix("s").replace("metre", "meter")
    return {"meter": "m", "centimeter": "cm", "millimeter": "mm"}.get(stem)


def read_calibration(
    path: Path | str, *, units: str | None = None, up: str | None = None, check_world: bool = True
) -> CalibrationFile:
    """Read a calibration of any supported format into metres, z up.

    path : anipose, Pose2Sim, FreeMoCap or Caliscope TOML; EasyMocap intri.yml or extri.yml (or their folder);
    OpenCV FileStorage YAML, XML or JSON with camera_matrix, distortion and extrinsics, one camera per file (a
    folder of them makes a rig) or one map per camera; CMU Panoptic JSON.
    units : "m", "cm" or "mm" of the translations; overrides what the file says.
    up : axis of the file that points up, "z", "-y", ...; None = what the file or its format says, else z.
    check_world : False accepts a world whose floor is not at z = 0 (a file that is only to be converted).
    Raises MocapError (path, camera, remedy) for an unreadable file, zero cameras, doubled names, numbers that
    are not finite, a singular matrix, a mirrored rotation, implausible distances, cameras below the floor.
    """
    path = Path(path)
    if units is not None and units not in METRES_PER_UNIT:
        raise ValueError(f"units must be one of m, cm, mm, got {units!r}")
    if up is not None and up not in _AXES_TO_Z_UP:
        raise ValueError(f"up must be one of {', '.join(_AXES_TO_Z_UP)}, got {up!r}")
    if not path.exists():
        raise MocapError("no such calibration file", path=path, remedy="check the path")
    try:
        raw = _read_raw(path)
    except OSError as error:
        raise MocapError(
            f"calibration cannot be read: {error.strerror}", path=path, remedy="check the file's permissions"
        ) from error
    return _finish(raw, path, units, up, check_world)


def write_calibration(path: Path | str, rig: CameraRig, *, metadata: dict[str, Any] | None = None) -> None:
    """Write a rig as our anipose-style TOML in metres; reading it back gives the same numbers bit for bit.

    metadata : further keys of `[metadata]` (strings, numbers, booleans, lists of them).
    Beside anipose's Rodrigues vector the 3 x 3 matrix is kept, because the vector alone loses the last bits.
    """
    lines = []
    for i, camera in enumerate(rig):
        lines += [
            f"[cam_{i}]",
            f"name = {_toml(camera.name)}",
            f"size = [{camera.size[0]}, {camera.size[1]}]",
            f"matrix = {_toml(camera.K)}",
            f"distortions = {_toml(camera.dist)}",
            f"rotation = {_toml(rotation_vector_from_matrix(camera.R))}",
            f"rotation_matrix = {_toml(camera.R)}",
            f"translation = {_toml(camera.t)}",
            f"fisheye = {_toml(camera.is_fisheye)}",
            "",
        ]
    about = {"format": "mocap", **(metadata or {}), "units": "m", "up": "z"}
    lines.append("[metadata]")
    lines += [f"{_toml_key(key)} = {_toml(value)}" for key, value in about.items()]
    atomic_text(Path(path), "\n".join(lines) + "\n")


def find_calibration(root: Path | str) -> Path:
    """The calibration of a session folder: calibration.toml, else the only file with a name we recognise.

    Raises MocapError when there is none, or several and none is called calibration.toml.
    """
    root = Path(root)
    if (root / "calibration.toml").is_file():
        return root / "calibration.toml"
    found = calibration_candidates(root)
    if not found:
        raise MocapError(
            "the session has no calibration",
            path=root,
            remedy="put a calibration.toml there (or intri.yml and extri.yml, Calib_*.toml, "
            "calibration_*.json ...), or name the file with --calibration",
        )
    if len(found) > 1:
        raise MocapError(
            f"the session has several calibrations: {', '.join(p.name for p in found)}",
            path=root,
            remedy="call the right one calibration.toml, or name it with --calibration",
        )
    return found[0]


def calibration_candidates(root: Path) -> list[Path]:
    """All files (and the calibration/ folder) of a session with a calibration's name, sorted by name."""
    found = []
    for folder in (root, root / "calibration"):
        if not folder.is_dir():
            continue
        for path in sorted(folder.iterdir()):
            stem, suffix = path.stem.lower(), path.suffix.lower()
            if not path.is_file() or stem.startswith("."):
                continue
            is_toml = suffix == ".toml" and ("calib" in stem or stem.startswith("camera_array"))
            is_storage = suffix in {".yml", ".yaml", ".xml", ".json"} and "calib" in stem
            if is_toml or is_storage or path.name in {"extri.yml", "extri.yaml"}:
                found.append(path)
    if not found and (root / "calibration").is_dir():
        found.append(root / "calibration")
    # Caliscope writes the same rig twice; its own file has more in it.
    if (twin := root / "camera_array_aniposelib.toml") in found and (root / "camera_array.toml") in found:
        found.remove(twin)
    return found


# --- formats ------------------------------------------------------------------------------------------------


def _read_raw(path: Path) -> _RawRig:
    if path.is_dir():
        return _read_folder(path)
    suffix = path.suffix.lower()
    if suffix == ".toml":
        return _read_toml(path)
    if suffix == ".json":
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except (json.JSONDecodeError, UnicodeDecodeError) as error:
            raise _bad(path, f"not valid JSON: {error}") from error
        if isinstance(document, dict) and isinstance(document.get("cameras"), list):
            return _read_panoptic(path, document)
        return _read_storage(path)
    if suffix in {".yml", ".yaml", ".xml"}:
        if path.stem in {"intri", "extri"}:
            return _read_easymocap(path)
        return _read_storage(path)
    raise MocapError(
        f"calibration format {suffix or 'without suffix'} is not known",
        path=path,
        remedy="give .toml (anipose, Pose2Sim, FreeMoCap, Caliscope), .yml, .yaml, .xml or .json (OpenCV, "
        "EasyMocap) or .json (CMU Panoptic)",
    )


def _read_toml(path: Path) -> _RawRig:
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise _bad(path, f"not valid TOML: {error}") from error
    metadata = document.pop("metadata", {})
    if not isinstance(metadata, dict):
        raise _bad(path, "metadata is not a table")
    is_caliscope = isinstance(document.get("cameras"), dict)
    sections: dict[str, Any] = document["cameras"] if is_caliscope else document
    raw = _RawRig([], "caliscope" if is_caliscope else "anipose")
    errors_px = []
    for key, section in sections.items():
        if not isinstance(section, dict):
            continue
        if not section.keys() & {"matrix", "rotation", "translation", "distortions"}:
            if section.keys() & {"size", "name", "cam_id", "port"}:
                raise _bad(path, "the camera has no matrix, rotation and translation", camera=str(key))
            continue
        name = _toml_camera_name(str(key), section, is_caliscope)
        if section.get("ignore") is True:
            raw.notes.append(f"camera {name} is marked as ignored and left out")
            continue
        if is_caliscope and not {"rotation", "translation"} <= section.keys():
            raw.warnings.append(f"camera {name} has no pose in the file and is left out")
            continue
        if section.get("rotation_count", 0) % 4:
            raw.warnings.append(f"camera {name}: its pictures must be turned upright as the file's tool did")
        if isinstance(error_px := section.get("error", section.get("reprojection_error_px")), (int, float)):
            errors_px.append(float(error_px))
        raw.cameras.append(_toml_camera(path, name, section))

    error_px = metadata.get("error", metadata.get("reprojection_error_px", metadata.get("rms_px")))
    if not isinstance(error_px, (int, float)):
        error_px = float(np.mean(errors_px)) if errors_px else 0.0
    # Pose2Sim always writes error = 0.0: that means "not known".
    raw.rms_px = float(error_px) if np.isfinite(error_px) and error_px > 0 else None

    tables = [s for s in sections.values() if isinstance(s, dict)]
    is_freemocap = (
        any("world_position" in s or "world_orientation" in s for s in tables)
        or any(k.startswith(("charuco_", "groundplane")) for k in metadata)
        or "path_to_recorded_videos" in metadata
        or (isinstance(metadata.get("board"), dict) and "square_length_mm" in metadata["board"])
    )
    if isinstance(word := metadata.get("units", metadata.get("unit")), str):
        raw.units = unit_from_word(word)
        raw.format = "mocap" if metadata.get("format") == "mocap" else raw.format
        if raw.units is None:
            raise _bad(path, f"metadata.units is {word!r}", remedy='write units = "m", "cm" or "mm"')
    elif is_freemocap:
        raw.format, raw.units = "freemocap", "mm"
    elif is_caliscope:
        raw.units = "m"
    else:
        is_pose2sim = {"adjusted", "error"} <= metadata.keys() and all("fisheye" in s for s in tables)
        raw.format = "pose2sim" if is_pose2sim else "anipose"
        raw.units, raw.is_unit_sure = "m", False
    if "up" in metadata:
        if metadata["up"] not in _AXES_TO_Z_UP:
            raise _bad(path, f"metadata.up is {metadata['up']!r}", remedy='write up = "z" (or "-y", ...)')
        raw.up = metadata["up"]
    return raw


def _toml_camera_name(key: str, section: dict[str, Any], is_caliscope: bool) -> str:
    if "name" in section:
        return str(section["name"])
    if not is_caliscope:
        return key
    return f"port_{section['port']}" if "port" in section else f"cam_{section.get('cam_id', key)}"


def _toml_camera(path: Path, name: str, section: dict[str, Any]) -> _RawCamera:
    for key in ("matrix", "rotation", "translation"):
        if key not in section:
            raise _bad(path, f"the camera has no {key}", camera=name)
    is_fisheye = bool(section.get("fisheye") or False)
    size = _size(path, name, section["size"]) if "size" in section else None
    rotation = _rotation(path, name, section["rotation"])
    if "rotation_matrix" in section:
        exact = _rotation(path, name, section["rotation_matrix"])
        # Someone may have edited the vector by hand; then the vector is what they meant.
        if np.abs(exact - rotation).max() < 1e-9:
            rotation = exact
    return _RawCamera(
        name,
        size,
        _numbers(path, name, "matrix", section["matrix"], (3, 3)),
        _distortion(path, name, section.get("distortions") or [0.0] * 4, is_fisheye),
        rotation,
        _numbers(path, name, "translation", section["translation"], (3,)),
        is_fisheye,
    )


def _read_panoptic(path: Path, document: dict[str, Any]) -> _RawRig:
    raw = _RawRig([], "panoptic", units="cm", up="-y")
    for i, entry in enumerate(document["cameras"]):
        if not isinstance(entry, dict):
            raise _bad(path, f"cameras[{i}] is not an object")
        name = str(entry.get("name", i))
        for key in ("K", "R", "t"):
            if key not in entry:
                raise _bad(path, f"the camera has no {key}", camera=name)
        known = {"vga": (640, 480), "hd": (1920, 1080)}.get(str(entry.get("type")))
        raw.cameras.append(
            _RawCamera(
                name,
                _size(path, name, entry["resolution"]) if "resolution" in entry else known,
                _numbers(path, name, "K", entry["K"], (3, 3)),
                _distortion(path, name, entry.get("distCoef") or [0.0] * 5, False),
                _rotation(path, name, entry["R"]),
                _numbers(path, name, "t", entry["t"], (3,)),
            )
        )
    return raw


def _open_storage(path: Path) -> cv2.FileStorage:
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    except (cv2.error, SystemError) as error:
        raise _bad(path, "not an OpenCV FileStorage file (a YAML one starts with %YAML:1.0)") from error
    if not storage.isOpened():
        raise _bad(path, "not an OpenCV FileStorage file (a YAML one starts with %YAML:1.0)")
    return storage


def _read_easymocap(path: Path) -> _RawRig:
    intri, extri = (path.with_name(stem + path.suffix) for stem in ("intri", "extri"))
    for part in (intri, extri):
        if not part.is_file():
            raise MocapError(
                "EasyMocap keeps a calibration in two files and one is missing",
                path=part,
                remedy="put intri.yml and extri.yml into one folder",
            )
    inner, outer = _open_storage(intri), _open_storage(extri)
    names = _names_node(inner) or _names_node(outer)
    if not names:
        raise _bad(intri, "the list `names` is missing or empty")
    raw = _RawRig([], "easymocap", units="m", is_unit_sure=False)
    for name in names:
        K = _first_matrix(inner, (f"K_{name}",))
        if K is None:
            raise _bad(intri, f"node K_{name} is missing", camera=name)
        dist = _first_matrix(inner, (f"dist_{name}", f"D_{name}"))
        R = _first_matrix(outer, (f"Rot_{name}", f"R_{name}"))
        t = _first_matrix(outer, (f"T_{name}",))
        if R is None or t is None:
            missing = f"T_{name}" if t is None else f"R_{name}"
            raise _bad(extri, f"node {missing} is missing", camera=name)
        width, height = inner.getNode(f"W_{name}"), inner.getNode(f"H_{name}")
        has_size = not width.empty() and not height.empty()
        raw.cameras.append(
            _RawCamera(
                name,
                (int(width.real()), int(height.real())) if has_size else None,
                _numbers(intri, name, f"K_{name}", K, (3, 3)),
                _distortion(intri, name, [0.0] * 5 if dist is None else dist, False),
                _rotation(extri, name, R),
                _numbers(extri, name, f"T_{name}", t, (3,)),
            )
        )
    inner.release()
    outer.release()
    return raw


_K_NODES = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "M", "intrinsic_matrix")
_DIST_NODES = (
    "distortion_coefficients",
    "Distortion_Coefficients",
    "dist_coeffs",
    "distCoeffs",
    "dist",
    "D",
    "distortions",
)
_R_NODES = ("rotation_matrix", "Rot", "R", "rvec", "rotation", "rotation_vector")
_T_NODES = ("T", "t", "tvec", "translation", "translation_vector")


def _read_storage(path: Path) -> _RawRig:
    """OpenCV FileStorage: one camera at the top level, or one map per camera."""
    storage = _open_storage(path)
    raw = _RawRig([], "opencv", units="m", is_unit_sure=False)
    root = storage.root()
    if root.empty() or not root.isMap():
        raise _bad(path, "the file holds no camera")
    word = storage.getNode("units")
    if word.isString():
        raw.units, raw.is_unit_sure = unit_from_word(word.string()), True
        if raw.units is None:
            raise _bad(path, f"units is {word.string()!r}", remedy='write "m", "cm" or "mm"')
    error = storage.getNode("avg_reprojection_error")
    raw.rms_px = float(error.real()) if error.isReal() and error.real() > 0 else None
    if _first_matrix(storage, _K_NODES) is not None:
        label = storage.getNode("camera_name")
        raw.cameras.append(_storage_camera(path, storage, label.string() if label.isString() else path.stem))
    else:
        for key in root.keys():  # noqa: SIM118  a FileNode is no dict
            node = root.getNode(key)
            if node.isMap() and _first_matrix(node, _K_NODES) is not None:
                label = node.getNode("camera_name")
                label = node.getNode("name") if label.empty() else label
                raw.cameras.append(_storage_camera(path, node, label.string() if label.isString() else key))
    storage.release()
    return raw


def _storage_camera(path: Path, node: Any, name: str) -> _RawCamera:
    K, R, t = (_first_matrix(node, nodes) for nodes in (_K_NODES, _R_NODES, _T_NODES))
    if R is None or t is None:
        raise MocapError(
            "the camera has no extrinsics: neither R nor rvec, or neither T nor tvec",
            path=path,
            camera=name,
            remedy="calibrate the camera poses too; store R or rvec and T or tvec, world to camera",
        )
    dist = _first_matrix(node, _DIST_NODES)
    fisheye = node.getNode("fisheye")
    is_fisheye = not fisheye.empty() and bool(fisheye.real())
    size = None
    width, height = node.getNode("image_width"), node.getNode("image_height")
    if not width.empty() and not height.empty():
        size = _size(path, name, [width.real(), height.real()])
    elif (both := _first_matrix(node, ("image_size", "size", "imageSize"))) is not None:
        size = _size(path, name, both)
    return _RawCamera(
        name,
        size,
        _numbers(path, name, "camera_matrix", K, (3, 3)),
        _distortion(path, name, [0.0] * 4 if dist is None else dist, is_fisheye),
        _rotation(path, name, R),
        _numbers(path, name, "T", t, (3,)),
        is_fisheye,
    )


def _read_folder(path: Path) -> _RawRig:
    for suffix in (".yml", ".yaml"):
        if (path / f"intri{suffix}").is_file() or (path / f"extri{suffix}").is_file():
            return _read_easymocap(path / f"intri{suffix}")
    files = sorted(p for p in path.iterdir() if p.suffix.lower() in {".yml", ".yaml", ".xml", ".json"})
    if not files:
        raise MocapError(
            "the folder holds no calibration",
            path=path,
            remedy="give the calibration file itself, or a folder with one OpenCV .yml per camera",
        )
    parts = [_read_storage(file) for file in files]
    raw = _RawRig([c for part in parts for c in part.cameras], "opencv", units=parts[0].units)
    raw.is_unit_sure = parts[0].is_unit_sure
    if len({part.units for part in parts}) > 1:
        raise _bad(path, "the files of the folder have different units")
    return raw


def _names_node(storage: cv2.FileStorage) -> list[str]:
    node = storage.getNode("names")
    return [_node_text(node.at(i)) for i in range(node.size())] if node.isSeq() else []


def _node_text(node: Any) -> str:
    # A list written without quotes holds numbers: 1, not "1".
    return node.string() if node.isString() else f"{node.real():g}"


def _first_matrix(holder: Any, names: Sequence[str]) -> Array | None:
    """Numbers of the first of the named nodes that is there (a missing one reads as 0.0: ask `.empty()`)."""
    for name in names:
        node = holder.getNode(name)
        if node.empty():
            continue
        if node.isSeq():
            return np.array(list(_sequence_numbers(node)))
        if node.isMap() and (matrix := node.mat()) is not None:
            return np.asarray(matrix)
    return None


def _sequence_numbers(node: Any) -> Iterator[float]:
    for i in range(node.size()):
        item = node.at(i)
        if item.isSeq():
            yield from _sequence_numbers(item)
        else:
            yield float(item.real())


# --- numbers ------------------------------------------------------------------------------------------------


def _bad(path: Path, message: str, *, camera: str | None = None, remedy: str = "") -> MocapError:
    return MocapError(
        f"bad calibration: {message}",
        path=path,
        camera=camera,
        remedy=remedy or "correct the file or calibrate again",
    )


def _numbers(path: Path, camera: str, key: str, value: Any, shape: tuple[int, ...]) -> Array:
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise _bad(path, f"{key} is not a table of numbers", camera=camera) from error
    # Column vectors and flat matrices are both common: only the count must be right.
    if numbers.size != int(np.prod(shape)):
        raise _bad(path, f"{key} has {numbers.size} numbers, expected {int(np.prod(shape))}", camera=camera)
    if not np.isfinite(numbers).all():
        raise _bad(path, f"{key} holds a number that is not finite", camera=camera)
    return numbers.reshape(shape)


def _distortion(path: Path, camera: str, value: Any, is_fisheye: bool) -> Array:
    try:
        flat = np.array(value, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise _bad(path, "the distortion is not a list of numbers", camera=camera) from error
    if not np.isfinite(flat).all():
        raise _bad(path, "the distortion holds a number that is not finite", camera=camera)
    if is_fisheye:
        if len(flat) < 4 or np.any(flat[4:]):
            raise _bad(path, f"a fisheye camera has 4 distortion numbers, not {len(flat)}", camera=camera)
        return flat[:4]
    if len(flat) in {1, 2, 3}:
        return np.concatenate([flat, np.zeros(4 - len(flat))])
    if len(flat) not in {4, 5, 8, 12, 14}:
        raise _bad(path, f"{len(flat)} distortion numbers; OpenCV knows 4, 5, 8, 12 or 14", camera=camera)
    return flat


def _size(path: Path, camera: str, value: Any) -> tuple[int, int]:
    w, h = _numbers(path, camera, "size", value, (2,))
    if w < 1 or h < 1:
        raise _bad(path, f"picture size {w:g} x {h:g} is not positive", camera=camera)
    return int(w), int(h)


def _rotation(path: Path, camera: str, value: Any) -> Array:
    """A 3 x 3 matrix from a matrix or a Rodrigues vector, as given (not yet made orthonormal)."""
    if np.size(value) == 3:
        return matrix_from_rotation_vector(_numbers(path, camera, "rotation", value, (3,)))
    return _numbers(path, camera, "rotation", value, (3, 3))


# --- checks and conversion ----------------------------------------------------------------------------------


def _finish(
    raw: _RawRig, path: Path, units: str | None, up: str | None, check_world: bool
) -> CalibrationFile:
    if not raw.cameras:
        raise MocapError(
            "the calibration holds no camera",
            path=path,
            remedy="calibrate at least two cameras, or name the right file with --calibration",
        )
    names = [c.name for c in raw.cameras]
    if doubled := sorted({n for n in names if names.count(n) > 1}):
        raise _bad(
            path,
            f"camera name {', '.join(doubled)} is used more than once",
            camera=doubled[0],
            remedy="give every camera its own `name`",
        )
    notes, warnings = list(raw.notes), list(raw.warnings)
    file_units = raw.units or "m"
    chosen = units or file_units
    if units is not None and raw.is_unit_sure and units != file_units:
        warnings.append(f"units {units} were asked for although the file says {file_units}")
    if chosen != "m":
        notes.append(f"translations converted from {chosen} to m")
    elif units is None and not raw.is_unit_sure:
        notes.append("the file names no unit; metres assumed because the camera distances are plausible")

    guessed = frozenset(c.name for c in raw.cameras if c.size is None)
    if guessed:
        warnings.append(
            f"no picture size in the file for {_some(sorted(guessed))}; twice the principal point assumed"
        )
    cameras = [_checked_camera(c, path, METRES_PER_UNIT[chosen], notes, warnings) for c in raw.cameras]
    _check_distances(cameras, path, chosen, units is None and not raw.is_unit_sure)

    axis = up or raw.up or "z"
    if axis == "z" and up is None and raw.up is None and _is_upside_down(cameras):
        axis = "-z"
        warnings.append("the z axis of the file points down; the world was turned by 180 degrees about x")
    elif axis != "z":
        notes.append(f"world turned so that {axis} of the file points up (our z)")
    if axis != "z":
        A = _AXES_TO_Z_UP[axis]
        cameras = [Camera(c.name, c.size, c.K, c.dist, c.R @ A.T, c.t, c.is_fisheye) for c in cameras]
    if check_world:
        _check_floor(cameras, path, warnings)
    return CalibrationFile(
        CameraRig(tuple(cameras)),
        path,
        raw.format,
        chosen,
        tuple(notes),
        raw.rms_px,
        tuple(warnings),
        guessed,
    )


def _checked_camera(raw: _RawCamera, path: Path, scale: float, notes: list[str], doubts: list[str]) -> Camera:
    K = raw.K.copy()
    if abs(np.linalg.det(K)) < 1e-9 or min(K[0, 0], K[1, 1]) <= 0:
        raise _bad(path, "the camera matrix is singular or has a focal length <= 0", camera=raw.name)
    if np.abs(K[2] - [0, 0, 1]).max() > 1e-9 or K[1, 0] != 0:
        raise _bad(
            path,
            "the camera matrix is not of the form [[fx, s, cx], [0, fy, cy], [0, 0, 1]]",
            camera=raw.name,
        )
    if K[0, 1] != 0:
        # OpenCV projects without skew; keeping it in K would make two modules disagree.
        (doubts if abs(K[0, 1]) > 0.5 else notes).append(f"camera {raw.name}: skew {K[0, 1]:.3g} px dropped")
        K[0, 1] = 0.0

    U, singular, Vt = np.linalg.svd(raw.R)
    deviation = float(np.abs(raw.R @ raw.R.T - np.eye(3)).max())
    if np.linalg.det(raw.R) <= 0:
        raise _bad(
            path,
            f"R is not a rotation but mirrored (det {np.linalg.det(raw.R):.3f})",
            camera=raw.name,
            remedy="use a right-handed world (swapping two axes mirrors it) and world-to-camera rotations",
        )
    if deviation > _ROTATION_LIMIT:
        raise _bad(
            path,
            f"R is not a rotation (R R^T is off by {deviation:.3g}, singular values {np.round(singular, 4)})",
            camera=raw.name,
        )
    R = raw.R
    if deviation > _ROTATION_EXACT:
        R = U @ Vt
        if deviation > _ROTATION_NOTE:
            notes.append(f"camera {raw.name}: rotation was off by {deviation:.1e} and made orthonormal")

    size = raw.size or (round(2 * float(K[0, 2])), round(2 * float(K[1, 2])))
    if min(size) < 1:
        raise _bad(path, "no picture size and none can be guessed", camera=raw.name)
    if not (0 <= K[0, 2] <= size[0] and 0 <= K[1, 2] <= size[1]):
        doubts.append(
            f"camera {raw.name}: principal point ({K[0, 2]:.0f}, {K[1, 2]:.0f}) lies outside the picture of "
            f"{size[0]} x {size[1]}; are width and height swapped?"
        )
    try:
        return Camera(raw.name, size, K, raw.dist, R, raw.t * scale, raw.is_fisheye)
    except ValueError as error:
        raise _bad(path, str(error), camera=raw.name) from error


def _check_distances(cameras: list[Camera], path: Path, unit: str, is_assumed: bool) -> None:
    centers = np.array([c.center for c in cameras])
    low, high = PLAUSIBLE_SPAN_M
    if len(cameras) == 1:
        span, what = float(np.linalg.norm(centers[0])), "its distance from the origin"
        low = 0.0
    else:
        span = float(np.linalg.norm(centers[:, None] - centers[None], axis=-1).max())
        what = "the largest distance between two cameras"
    if low <= span <= high:
        return
    in_file = span / METRES_PER_UNIT[unit]
    fitting = [u for u, scale in METRES_PER_UNIT.items() if u != unit and low <= in_file * scale <= high]
    hint = " or ".join(f"{u} ({in_file * METRES_PER_UNIT[u]:.3g} m)" for u in fitting)
    raise _bad(
        path,
        f"{what} is {in_file:.4g} in the file, which {'taken as' if is_assumed else 'in'} {unit} "
        f"is {span:.4g} m; people are filmed with {PLAUSIBLE_SPAN_M[0]:g} to {high:g} m",
        remedy="say the unit of the file: calibration_units in session.toml, or the argument units"
        + (f"; {hint} would fit" if hint else ", or calibrate again"),
    )


def _is_upside_down(cameras: list[Camera]) -> bool:
    """All cameras under the floor and all pictures showing +z downwards: the file's z points down."""
    return all(c.center[2] < 0 for c in cameras) and float(np.mean([-c.R[1, 2] for c in cameras])) < -0.1


def _check_floor(cameras: list[Camera], path: Path, warnings: list[str]) -> None:
    lowest = min(cameras, key=lambda c: c.center[2])
    if lowest.center[2] < -FLOOR_TOLERANCE_M:
        below = [c.name for c in cameras if c.center[2] < -FLOOR_TOLERANCE_M]
        # The direction that pictures show as "up", averaged; it tells which axis the author meant.
        up = -np.sum([c.R[1] for c in cameras], axis=0)
        i = int(np.argmax(np.abs(up)))
        axis = ("" if up[i] > 0 else "-") + "xyz"[i]
        remedy = "put the origin of the calibration on the floor with z up"
        if axis != "z":
            remedy += (
                f'; or, as the pictures show {axis} as up, say calibration_up = "{axis}" in session.toml'
            )
        raise _bad(
            path,
            f"{_some(below)} {'lie' if len(below) > 1 else 'lies'} below the floor z = 0 "
            f"(camera {lowest.name} at z = {lowest.center[2]:.2f} m)",
            camera=lowest.name,
            remedy=remedy,
        )
    if lowest.center[2] < 0:
        warnings.append(f"camera {lowest.name} lies {-lowest.center[2]:.2f} m below the floor z = 0")
    if len(cameras) > 1 and all(-c.R[1, 2] < -0.3 for c in cameras):
        warnings.append("all pictures show the world upside down: is the z axis of the calibration right?")


def _some(names: Sequence[str], limit: int = 8) -> str:
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml(key)


def _toml(value: Any) -> str:
    """A TOML value; floats by repr, which is exact."""
    if isinstance(value, np.ndarray):
        return _toml(value.tolist())
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (float, np.floating)):
        return repr(float(value))
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    if isinstance(value, (str, Path)):
        return json.dumps(str(value), ensure_ascii=False)
    raise TypeError(f"metadata holds a {type(value).__name__}, expected text, numbers, booleans or lists")
