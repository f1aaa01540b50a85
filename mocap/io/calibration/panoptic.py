"""CMU Panoptic calibration JSON: centimetres, y down."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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

# Picture sizes of the two kinds of cameras, for files that leave `resolution` out.
_SIZES = {"vga": (640, 480), "hd": (1920, 1080)}


def read_panoptic(path: Path, document: dict[str, Any]) -> RawRig:
    """All cameras of the parsed file; MocapError with the camera for what is missing or makes no sense."""
    cameras = tuple(_camera(path, i, entry) for i, entry in enumerate(document["cameras"]))
    return RawRig(cameras, "panoptic", units="cm", up="-y")


def _camera(path: Path, i: int, entry: Any) -> RawCamera:
    if not isinstance(entry, dict):
        raise bad(path, f"cameras[{i}] is not an object")
    name = camera_name(path, entry.get("name", i))
    for key in ("K", "R", "t"):
        if key not in entry:
            raise bad(path, f"the camera has no {key}", camera=name)
    has_size = "resolution" in entry
    return RawCamera(
        name,
        picture_size(path, name, entry["resolution"]) if has_size else _SIZES.get(str(entry.get("type"))),
        numbers(path, name, "K", entry["K"], (3, 3)),
        distortion(path, name, entry.get("distCoef") or [0.0] * 5, False),
        rotation(path, name, entry["R"]),
        numbers(path, name, "t", entry["t"], (3,)),
    )
