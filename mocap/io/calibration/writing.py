"""Rigs written for other tools, each in its own units, axes and files."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from mocap.arrays import Array
from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.geometry.rigid import rotation_vector_from_matrix
from mocap.io._files import atomic_text
from mocap.io.calibration.anipose import toml_value, write_calibration

_CM = 100.0
# CMU Panoptic's y points down: rows are its axes in ours.
_PANOPTIC_FROM_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def write_rig(path: Path, rig: CameraRig, form: str) -> tuple[Path, ...]:
    """Write a rig in one of FORMATS; gives the files that were written.

    path : a file; of easymocap the folder, or the path of its intri.yml.
    Raises MocapError for a lens that the format has no words for.
    """
    n_distortions, has_fisheye, write = _WRITERS[form]
    for camera in rig:
        if camera.is_fisheye and not has_fisheye:
            raise _no_words(path, camera, form, "a fisheye lens")
        if not camera.is_fisheye and np.any(camera.dist[n_distortions:]):
            raise _no_words(path, camera, form, f"more than {n_distortions} distortion numbers")
    return write(path, rig)


def _no_words(path: Path, camera: Camera, form: str, what: str) -> MocapError:
    return MocapError(
        f"{form} has no words for {what}",
        path=path,
        camera=camera.name,
        remedy="calibrate with a simpler lens (`mocap calibrate --lens radial`), or choose another format",
    )


def _dist(camera: Camera, n: int) -> Array:
    """The first n distortion numbers, zeros where there are fewer."""
    return np.concatenate([camera.dist, np.zeros(n)])[:n]


def _toml_tables(tables: Sequence[tuple[str, dict[str, object]]]) -> str:
    lines = []
    for title, values in tables:
        lines += [f"[{title}]", *(f"{key} = {toml_value(value)}" for key, value in values.items()), ""]
    return "\n".join(lines)


def _anipose_table(camera: Camera, n: int) -> dict[str, object]:
    return {
        "name": camera.name,
        "size": list(camera.size),
        "matrix": camera.K,
        "distortions": _dist(camera, 4 if camera.is_fisheye else n),
        "rotation": rotation_vector_from_matrix(camera.R),
        "translation": camera.t,
        "fisheye": camera.is_fisheye,
    }


def _write_anipose(path: Path, rig: CameraRig) -> tuple[Path, ...]:
    tables = [(f"cam_{i}", _anipose_table(camera, max(5, len(camera.dist)))) for i, camera in enumerate(rig)]
    # aniposelib reads these two, and skips what it does not know.
    tables.append(("metadata", {"adjusted": False, "error": 0.0, "units": "m"}))
    atomic_text(path, _toml_tables(tables))
    return (path,)


def _write_pose2sim(path: Path, rig: CameraRig) -> tuple[Path, ...]:
    tables = [(f"cam_{i}", _anipose_table(camera, 4)) for i, camera in enumerate(rig)]
    tables.append(("metadata", {"adjusted": False, "error": 0.0}))
    atomic_text(path, _toml_tables(tables))
    return (path,)


def _write_caliscope(path: Path, rig: CameraRig) -> tuple[Path, ...]:
    tables = []
    for i, camera in enumerate(rig):
        values: dict[str, object] = {
            "cam_id": i,
            "name": camera.name,
            "size": list(camera.size),
            "rotation_count": 0,
            "error": 0.0,
            "matrix": camera.K,
            "distortions": _dist(camera, 4 if camera.is_fisheye else 5),
            "translation": camera.t,
            "rotation": rotation_vector_from_matrix(camera.R),
            "fisheye": camera.is_fisheye,
        }
        tables.append((f"cameras.{i}", values))
    atomic_text(path, _toml_tables(tables))
    return (path,)


def _matrix(name: str, values: Array, indent: str = "") -> str:
    """A matrix of OpenCV's YAML."""
    table = np.atleast_2d(values)
    data = ", ".join(repr(float(v)) for v in table.ravel())
    return (
        f"{indent}{name}: !!opencv-matrix\n{indent}   rows: {table.shape[0]}\n{indent}   cols: {table.shape[1]}\n"
        f"{indent}   dt: d\n{indent}   data: [ {data} ]\n"
    )


def _quoted(name: str) -> str:
    return json.dumps(name, ensure_ascii=False)


def _write_easymocap(path: Path, rig: CameraRig) -> tuple[Path, ...]:
    for camera in rig:
        if not camera.name.replace("_", "").replace("-", "").isalnum():
            raise MocapError(
                "EasyMocap's files hold names of letters, digits, - and _ alone",
                path=path,
                camera=camera.name,
                remedy="rename the camera in the calibration and its clips",
            )
    folder = path.parent if path.suffix else path
    names = "names:\n" + "".join(f"   - {_quoted(camera.name)}\n" for camera in rig)
    inner, outer = ["%YAML:1.0\n---\n", names], ["%YAML:1.0\n---\n", names]
    for camera in rig:
        inner += [_matrix(f"K_{camera.name}", camera.K), _matrix(f"dist_{camera.name}", _dist(camera, 5))]
        inner += [f"W_{camera.name}: {camera.size[0]}\n", f"H_{camera.name}: {camera.size[1]}\n"]
        outer.append(_matrix(f"R_{camera.name}", rotation_vector_from_matrix(camera.R)[:, None]))
        outer.append(_matrix(f"Rot_{camera.name}", camera.R))
        outer.append(_matrix(f"T_{camera.name}", camera.t[:, None]))
    paths = folder / "intri.yml", folder / "extri.yml"
    for target, parts in zip(paths, (inner, outer), strict=True):
        atomic_text(target, "".join(parts))
    return paths


def _write_opencv(path: Path, rig: CameraRig) -> tuple[Path, ...]:
    """One map per camera: K, distortion, size, R and T as FileStorage has them."""
    parts = ["%YAML:1.0\n---\n", 'units: "m"\n']
    for i, camera in enumerate(rig):
        n = 4 if camera.is_fisheye else max(5, len(camera.dist))
        parts += [f"camera_{i}:\n", f"   name: {_quoted(camera.name)}\n"]
        parts += [f"   image_width: {camera.size[0]}\n", f"   image_height: {camera.size[1]}\n"]
        parts += [f"   fisheye: {int(camera.is_fisheye)}\n", _matrix("camera_matrix", camera.K, "   ")]
        parts += [_matrix("distortion_coefficients", _dist(camera, n), "   "), _matrix("R", camera.R, "   ")]
        parts.append(_matrix("T", camera.t[:, None], "   "))
    atomic_text(path, "".join(parts))
    return (path,)


def _write_panoptic(path: Path, rig: CameraRig) -> tuple[Path, ...]:
    """Centimetres, y down."""
    cameras = [
        {
            "name": camera.name,
            "type": "hd",
            "resolution": list(camera.size),
            "panel": 0,
            "node": i,
            "K": camera.K.tolist(),
            "distCoef": _dist(camera, 5).tolist(),
            "R": (camera.R @ _PANOPTIC_FROM_Z_UP.T).tolist(),
            "t": (_CM * camera.t)[:, None].tolist(),
        }
        for i, camera in enumerate(rig)
    ]
    atomic_text(path, json.dumps({"calibDataSource": "mocap", "cameras": cameras}, indent=1) + "\n")
    return (path,)


def _write_own(path: Path, rig: CameraRig) -> tuple[Path, ...]:
    write_calibration(path, rig)
    return (path,)


# By format: how many distortion numbers it holds, whether it knows fisheye lenses, and who writes it.
_WRITERS: dict[str, tuple[int, bool, Callable[[Path, CameraRig], tuple[Path, ...]]]] = {
    "mocap": (14, True, _write_own),
    "anipose": (14, True, _write_anipose),
    "pose2sim": (4, False, _write_pose2sim),
    "caliscope": (5, True, _write_caliscope),
    "easymocap": (5, False, _write_easymocap),
    "opencv": (14, True, _write_opencv),
    "panoptic": (5, False, _write_panoptic),
}
FORMATS = tuple(_WRITERS)
