"""OpenCap: a pickle per camera, cameraIntrinsicsExtrinsics.pickle, in millimetres of the board."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mocap.io._files import natural_key
from mocap.io.calibration.pickled import read_pickled
from mocap.io.calibration.record import (
    RawCamera,
    RawRig,
    bad,
    camera_name,
    distortion,
    numbers,
    picture_size,
    rotation,
)

FILE = "cameraIntrinsicsExtrinsics.pickle"
_DEEPEST = "*/*/"


def opencap_files(folder: Path) -> list[Path]:
    """The pickles of a session of OpenCap (Videos/Cam0/...), or of a folder of cameras."""
    found = [path for pattern in ("*/", _DEEPEST) for path in folder.glob(pattern + FILE)]
    return sorted(found, key=lambda p: natural_key(str(p)))


def read_opencap(files: list[Path]) -> RawRig:
    """All cameras, named as their folders (a lone file as itself).

    The world is that of the board: which of its axes points up follows from the pictures, as the board may hang on a
    wall or lie on the floor; heights count from its origin.
    """
    cameras = tuple(_camera(path) for path in files)
    up = _up(cameras)
    notes = (
        f"the world is that of OpenCap's board, whose {up} points up in the pictures; heights count from the board",
    )
    return RawRig(cameras, "opencap", units="mm", up=up, notes=notes)


def _camera(path: Path) -> RawCamera:
    name = camera_name(path, path.parent.name if path.name == FILE else path.stem)
    values = read_pickled(path, "the calibration")
    if not isinstance(values, dict):
        raise bad(path, "the pickle holds no map", camera=name)
    for key in ("intrinsicMat", "distortion", "imageSize", "rotation", "translation"):
        if key not in values:
            raise bad(path, f"{key} is missing", camera=name)
    height, width = numbers(path, name, "imageSize", values["imageSize"], (2,))
    return RawCamera(
        name,
        picture_size(path, name, [width, height]),
        numbers(path, name, "intrinsicMat", values["intrinsicMat"], (3, 3)),
        distortion(path, name, _flat(values["distortion"]), False),
        rotation(path, name, values["rotation"]),
        numbers(path, name, "translation", values["translation"], (3,)),
    )


def _flat(value: Any) -> Any:
    return value.ravel() if isinstance(value, np.ndarray) else value


def _up(cameras: tuple[RawCamera, ...]) -> str:
    """The axis of the file that most pictures show as up."""
    up = -np.sum([camera.R[1] for camera in cameras], axis=0)
    axis = int(np.abs(up).argmax())
    return ("" if up[axis] > 0 else "-") + "xyz"[axis]
