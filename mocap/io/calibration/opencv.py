"""OpenCV FileStorage calibrations: one camera per file, one map per camera, or a folder of files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.errors import MocapError
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
from mocap.io.calibration.storage import Map, first_numbers, read_storage
from mocap.io.units import unit_from_word

# What programs call these nodes, in small letters and without underscores; the first that is there counts.
_K_NODES = ("cameramatrix", "k", "m", "mtx", "intrinsicmatrix", "cameraintrinsicmatrix")
_DIST_NODES = ("distortioncoefficients", "distortioncoeffs", "distcoeffs", "dist", "d", "distortions")
_R_NODES = (
    "rotationmatrix",
    "rot",
    "r",
    "rvec",
    "rotation",
    "rotationvector",
    "rotationvalues",
    "camerarotationvecs",
)
_T_NODES = ("t", "tvec", "translation", "translationvector", "translationvalues", "cameratranslationvecs")
_SIZE_NODES = ("imagesize", "size")
_NODES_TO_NAME = 8  # in a message


def read_opencv(path: Path) -> RawRig:
    """All cameras of a file: one at the top level, or one map per camera.

    Raises MocapError with the camera for a node that is missing or makes no sense.
    """
    document = read_storage(path)
    units, is_unit_sure = _units(path, document.get("units"))
    error_px = document.get("avg_reprojection_error")
    rms_px = error_px if isinstance(error_px, float) and error_px > 0 else None
    if _numbers_of(document, _K_NODES) is not None:
        cameras = [_camera(path, document, _name(path, document, path.stem))]
    else:
        maps = {key: node for key, node in document.items() if isinstance(node, dict)}
        cameras = [
            _camera(path, node, _name(path, node, key))
            for key, node in maps.items()
            if _numbers_of(node, _K_NODES) is not None
        ]
        if not cameras:
            raise bad(
                path,
                f"the file holds no camera; its nodes are {', '.join([*document][:_NODES_TO_NAME])}",
                remedy="name them camera_matrix, dist_coeffs, rvec or R, and tvec or T, one camera per file or map",
            )
    return RawRig(tuple(cameras), "opencv", units=units, is_unit_sure=is_unit_sure, rms_px=rms_px)


def read_opencv_folder(path: Path, files: list[Path]) -> RawRig:
    """The cameras of several files as one rig; MocapError when their units differ."""
    parts = [read_opencv(file) for file in files]
    if len({part.units for part in parts}) > 1:
        raise bad(path, "the files of the folder have different units")
    cameras = tuple(c for part in parts for c in part.cameras)
    return RawRig(cameras, "opencv", units=parts[0].units, is_unit_sure=parts[0].is_unit_sure)


def _numbers_of(node: Map, names: Sequence[str]) -> NDArray[np.float64] | None:
    """Numbers of the first of the names that the node has, however it writes them."""
    return first_numbers({key.lower().replace("_", ""): value for key, value in node.items()}, names)


def _units(path: Path, word: Any) -> tuple[str, bool]:
    """The unit, and whether the file says it."""
    if not isinstance(word, str):
        return "m", False
    unit = unit_from_word(word)
    if unit is None:
        raise bad(path, f"units is {word!r}", remedy='write "m", "cm" or "mm"')
    return unit, True


def _name(path: Path, node: Map, otherwise: str) -> str:
    label = node.get("camera_name", node.get("name"))
    return camera_name(path, label if isinstance(label, str) else otherwise)


def _camera(path: Path, node: Map, name: str) -> RawCamera:
    K, R, t = (_numbers_of(node, nodes) for nodes in (_K_NODES, _R_NODES, _T_NODES))
    if R is None or t is None:
        raise MocapError(
            "the camera has no extrinsics: neither R nor rvec, or neither T nor tvec",
            path=path,
            camera=name,
            remedy="calibrate the camera poses too; store R or rvec and T or tvec, world to camera",
        )
    dist = _numbers_of(node, _DIST_NODES)
    fisheye = node.get("fisheye")
    is_fisheye = isinstance(fisheye, float) and bool(fisheye)
    return RawCamera(
        name,
        _size(path, node, name),
        numbers(path, name, "camera_matrix", K, (3, 3)),
        distortion(path, name, [0.0] * 4 if dist is None else dist, is_fisheye),
        rotation(path, name, R),
        numbers(path, name, "T", t, (3,)),
        is_fisheye,
    )


def _size(path: Path, node: Map, name: str) -> tuple[int, int] | None:
    width, height = node.get("image_width"), node.get("image_height")
    if width is not None and height is not None:
        return picture_size(path, name, [width, height])
    both = _numbers_of(node, _SIZE_NODES)
    return None if both is None else picture_size(path, name, both)
