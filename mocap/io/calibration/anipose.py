"""Anipose-style TOML, ours among it: read in all its dialects (Pose2Sim, FreeMoCap, Caliscope), and written exactly."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap.data import CameraRig
from mocap.files import load_toml
from mocap.geometry.rigid import rotation_vector_from_matrix
from mocap.io._files import atomic_text
from mocap.io.calibration.record import (
    MOST_PX,
    RawCamera,
    RawRig,
    bad,
    camera_name,
    distortion,
    numbers,
    picture_size,
    rotation,
)
from mocap.io.units import AXES, unit_from_word

_CAMERA_KEYS = {"matrix", "rotation", "translation", "distortions"}


def read_toml(path: Path) -> RawRig:
    """All cameras of an anipose, Pose2Sim, FreeMoCap or Caliscope TOML, or of our own.

    Raises MocapError with the camera for what is no TOML or lacks a part.
    """
    document = load_toml(path, "the calibration", remedy="correct the file or calibrate again")
    metadata = document.pop("metadata", {})
    if not isinstance(metadata, dict):
        raise bad(path, "metadata is not a table")
    is_caliscope = isinstance(document.get("cameras"), dict)
    sections = document["cameras"] if is_caliscope else document
    tables = {str(key): section for key, section in sections.items() if isinstance(section, dict)}
    found = _Cameras(path, is_caliscope)
    for key, section in tables.items():
        found.add(key, section)
    raw = RawRig(
        tuple(found.cameras),
        "caliscope" if is_caliscope else "anipose",
        rms_px=_rms_px(metadata, found.errors_px),
        notes=(*found.notes, *([note] if isinstance(note := metadata.get("note"), str) else ())),
        warnings=tuple(found.warnings),
    )
    return _with_up(path, _with_units(path, raw, metadata, list(tables.values())), metadata)


class _Cameras:
    """The cameras of a file while its sections are read."""

    def __init__(self, path: Path, is_caliscope: bool) -> None:
        self._path, self._is_caliscope = path, is_caliscope
        self.cameras: list[RawCamera] = []
        self.errors_px: list[float] = []
        self.notes: list[str] = []
        self.warnings: list[str] = []

    def add(self, key: str, section: dict[str, Any]) -> None:
        if not section.keys() & _CAMERA_KEYS:
            if section.keys() & {"size", "name", "cam_id", "port"}:
                raise bad(self._path, "the camera has no matrix, rotation and translation", camera=key)
            return
        name = self._name(key, section)
        if section.get("ignore") is True:
            self.notes.append(f"camera {name} is marked as ignored and left out")
            return
        if self._is_caliscope and not {"rotation", "translation"} <= section.keys():
            self.warnings.append(f"camera {name} has no pose in the file and is left out")
            return
        if section.get("rotation_count", 0) not in (0, 4, -4):
            self.warnings.append(f"camera {name}: its pictures must be turned upright as the file's tool did")
        error_px = section.get("error", section.get("reprojection_error_px"))
        if isinstance(error_px, (int, float)) and 0 <= error_px < MOST_PX:
            self.errors_px.append(float(error_px))
        self.cameras.append(_camera(self._path, name, section))

    def _name(self, key: str, section: dict[str, Any]) -> str:
        if "name" in section or not self._is_caliscope:
            return camera_name(self._path, section.get("name", key))
        word = f"port_{section['port']}" if "port" in section else f"cam_{section.get('cam_id', key)}"
        return camera_name(self._path, word)


def _camera(path: Path, name: str, section: dict[str, Any]) -> RawCamera:
    for key in ("matrix", "rotation", "translation"):
        if key not in section:
            raise bad(path, f"the camera has no {key}", camera=name)
    is_fisheye = bool(section.get("fisheye") or False)
    size = picture_size(path, name, section["size"]) if "size" in section else None
    R = rotation(path, name, section["rotation"])
    if "rotation_matrix" in section:
        exact = rotation(path, name, section["rotation_matrix"])
        # Someone may have edited the vector by hand; then the vector is what they meant.
        if np.abs(exact - R).max() < 1e-9:
            R = exact
    return RawCamera(
        name,
        size,
        numbers(path, name, "matrix", section["matrix"], (3, 3)),
        distortion(path, name, section.get("distortions") or [0.0] * 4, is_fisheye),
        R,
        numbers(path, name, "translation", section["translation"], (3,)),
        is_fisheye,
    )


def _rms_px(metadata: dict[str, Any], errors_px: list[float]) -> float | None:
    error_px = metadata.get("error", metadata.get("reprojection_error_px", metadata.get("rms_px")))
    if not isinstance(error_px, (int, float)):
        error_px = float(np.mean(errors_px)) if errors_px else 0.0
    # Pose2Sim always writes error = 0.0: that means "not known".
    return float(error_px) if 0 < error_px < MOST_PX else None


def _with_units(path: Path, raw: RawRig, metadata: dict[str, Any], tables: list[dict[str, Any]]) -> RawRig:
    """The rig with its unit and dialect: what `[metadata]` says, else the custom of the tool that wrote it."""
    word = metadata.get("units", metadata.get("unit"))
    if isinstance(word, str):
        unit = unit_from_word(word)
        if unit is None:
            raise bad(path, f"metadata.units is {word!r}", remedy='write units = "m", "cm" or "mm"')
        return replace(raw, units=unit, format="mocap" if metadata.get("format") == "mocap" else raw.format)
    if _is_freemocap(metadata, tables):
        return replace(raw, units="mm", format="freemocap")
    if raw.format == "caliscope":
        return replace(raw, units="m")
    is_pose2sim = {"adjusted", "error"} <= metadata.keys() and all("fisheye" in s for s in tables)
    return replace(raw, units="m", is_unit_sure=False, format="pose2sim" if is_pose2sim else "anipose")


def _is_freemocap(metadata: dict[str, Any], tables: list[dict[str, Any]]) -> bool:
    board = metadata.get("board")
    return (
        any("world_position" in s or "world_orientation" in s for s in tables)
        or any(k.startswith(("charuco_", "groundplane")) for k in metadata)
        or "path_to_recorded_videos" in metadata
        or (isinstance(board, dict) and "square_length_mm" in board)
    )


def _with_up(path: Path, raw: RawRig, metadata: dict[str, Any]) -> RawRig:
    if "up" not in metadata:
        return raw
    if metadata["up"] not in AXES:
        raise bad(path, f"metadata.up is {metadata['up']!r}", remedy='write up = "z" (or "-y", ...)')
    return replace(raw, up=metadata["up"])


def write_calibration(path: Path | str, rig: CameraRig, *, metadata: dict[str, Any] | None = None) -> None:
    """Write a rig as our anipose-style TOML in metres; reading it back gives the same numbers bit for bit.

    metadata : further keys of `[metadata]` (strings, numbers, booleans, lists of them).
    Beside anipose's Rodrigues vector the 3 x 3 matrix is kept, because the vector alone loses the last bits.
    """
    lines = []
    for i, camera in enumerate(rig):
        lines += [
            f"[cam_{i}]",
            f"name = {toml_value(camera.name)}",
            f"size = [{camera.size[0]}, {camera.size[1]}]",
            f"matrix = {toml_value(camera.K)}",
            f"distortions = {toml_value(camera.dist)}",
            f"rotation = {toml_value(rotation_vector_from_matrix(camera.R))}",
            f"rotation_matrix = {toml_value(camera.R)}",
            f"translation = {toml_value(camera.t)}",
            f"fisheye = {toml_value(camera.is_fisheye)}",
            "",
        ]
    about = {"format": "mocap", **(metadata or {}), "units": "m", "up": "z"}
    lines.append("[metadata]")
    lines += [f"{_toml_key(key)} = {toml_value(value)}" for key, value in about.items()]
    atomic_text(Path(path), "\n".join(lines) + "\n")


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else toml_value(key)


def toml_value(value: Any) -> str:
    """A TOML value; floats by repr, which is exact."""
    if isinstance(value, np.ndarray):
        return toml_value(value.tolist())
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (float, np.floating)):
        return repr(float(value))
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    if isinstance(value, (str, Path)):
        return json.dumps(str(value), ensure_ascii=False)
    raise TypeError(f"metadata holds a {type(value).__name__}, expected text, numbers, booleans or lists")
