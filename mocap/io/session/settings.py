"""session.toml: what a user says about a session, checked key by key."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mocap.data.depth import DepthUnits
from mocap.errors import MocapError, did_you_mean
from mocap.files import load_toml
from mocap.io.units import AXES, UNITS, unit_from_word

Bounds = tuple[tuple[float, float, float], tuple[float, float, float]]
Polygon = tuple[tuple[float, float], ...]

# Clips that begin further apart are not of one recording.
MOST_OFFSET_S = 3600.0

_HEADER = re.compile(r"^\s*\[")  # of a table

_COLOURS = {
    "white": (255, 255, 255),
    "red": (255, 0, 0),
    "green": (0, 255, 0),
    "blue": (0, 0, 255),
    "yellow": (255, 255, 0),
    "orange": (255, 128, 0),
    "cyan": (0, 255, 255),
    "magenta": (255, 0, 255),
}


@dataclass(frozen=True)
class SessionSettings:
    """session.toml, checked; every key may be missing."""

    fps: float | None = None
    frames: tuple[int | None, int | None] | None = None
    room_bounds_m: Bounds | None = None
    person_height_m: float | None = None
    marker_colour: tuple[int, int, int] | None = None
    cameras: tuple[str, ...] | None = None
    camera_map: Mapping[str, str] | None = None
    calibration_units: str | None = None
    calibration_up: str | None = None
    checkerboard: tuple[int, int] | None = None
    checkerboard_square_m: float | None = None
    roi_px: Mapping[str, Polygon] | None = None
    offset_s: Mapping[str, float] | None = None
    clip_fps: Mapping[str, float] | None = None
    calibration_from: Mapping[int, str] | None = None
    depth: DepthUnits = field(default_factory=DepthUnits)


def read_session_settings(path: Path | str) -> SessionSettings:
    """Read and check session.toml; a file that is not there gives the defaults.

    Keys: fps, frames = [start, stop], room_bounds_m = [[x, y, z], [x, y, z]], person_height_m, marker_colour =
    "red" | "#rrggbb" | [r, g, b], cameras = ["camera name", ...] (the others are left out), calibration_units,
    calibration_up, checkerboard = [columns, rows] (inner corners), checkerboard_square_m, and the tables
    [camera_map] file name = "camera name", [roi_px] camera name = [[u, v], ...] (corners of a polygon), [offset_s]
    camera name = seconds after the start of the session at which its clip begins, [clip_fps] camera name = rate,
    [calibration_from] frame = "file" that holds from that frame on, and [depth] unit_mm = millimetres that a number of
    a depth map stands for, scale = its pixels per pixel of the camera.
    Raises MocapError naming the key for anything else.
    """
    path = Path(path)
    if not path.exists():
        return SessionSettings()
    document = load_toml(path, "session.toml")
    known = list(SessionSettings.__dataclass_fields__)
    for key in document:
        if key not in known:
            raise bad_key(
                path, key, f"is not known{did_you_mean(key, known)} Known keys are {', '.join(known)}"
            )
    return SessionSettings(
        fps=_positive(path, document, "fps"),
        frames=_frame_pair(path, document),
        room_bounds_m=_bounds(path, document),
        person_height_m=_positive(path, document, "person_height_m", 0.3, 3.0),
        marker_colour=_colour(path, document),
        cameras=_cameras(path, document),
        camera_map=_camera_map(path, document),
        calibration_units=_units(path, document),
        calibration_up=_up(path, document),
        checkerboard=_board(path, document),
        checkerboard_square_m=_positive(path, document, "checkerboard_square_m"),
        roi_px=_polygons(path, document),
        offset_s=_by_camera(path, document, "offset_s", -MOST_OFFSET_S, MOST_OFFSET_S),
        clip_fps=_by_camera(path, document, "clip_fps", 0.1, 10_000),
        calibration_from=_by_frame(path, document),
        depth=_depth(path, document),
    )


def bad_key(path: Path, key: str, what: str) -> MocapError:
    """The error of a key of session.toml that makes no sense."""
    return MocapError(f"session.toml: {key} {what}", path=path, remedy="correct session.toml")


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e12


def _are_numbers(value: Any, n: int) -> bool:
    return isinstance(value, list) and len(value) == n and all(map(_is_number, value))


def _positive(
    path: Path, document: dict[str, Any], key: str, low: float = 0.0, high: float = 1e9
) -> float | None:
    value = document.get(key)
    if value is None:
        return None
    if not _is_number(value) or not low < value < high:
        limits = f" between {low:g} and {high:g}" if low > 0 else " above 0"
        raise bad_key(path, key, f"is {value!r}, expected a number{limits}")
    return float(value)


def _by_camera(
    path: Path, document: dict[str, Any], key: str, low: float, high: float
) -> dict[str, float] | None:
    """A number for each of some cameras."""
    value = document.get(key)
    if value is None:
        return None
    if not isinstance(value, dict):
        raise bad_key(path, key, f"is no table, expected [{key}] camera = number")
    for name, number in value.items():
        if not _is_number(number) or not low <= number <= high:
            raise bad_key(path, f"{key}.{name}", f"is {number!r}, expected a number from {low:g} to {high:g}")
    return {name: float(number) for name, number in value.items()}


def _by_frame(path: Path, document: dict[str, Any]) -> dict[int, str] | None:
    """A calibration for each of some frames, in their order."""
    value = document.get("calibration_from")
    if value is None:
        return None
    if not isinstance(value, dict):
        raise bad_key(path, "calibration_from", 'is no table, expected [calibration_from] frame = "file"')
    for frame, name in value.items():
        if (
            not (frame.isascii() and frame.isdecimal() and int(frame) > 0)
            or not isinstance(name, str)
            or not name
        ):
            what = f'is {name!r}, expected a frame after the first = "calibration file"'
            raise bad_key(path, f"calibration_from.{frame}", what)
    return {int(frame): value[frame] for frame in sorted(value, key=int)}


def with_tables(text: str, tables: Mapping[str, str]) -> str:
    """The text of a session.toml with some of its tables in place of those it had; an empty one goes.

    tables : name -> text, header and all. Comments elsewhere stay.
    """
    kept, is_kept = [], True
    for line in text.splitlines(keepends=True):
        if _HEADER.match(line):
            is_kept = line.split("]")[0].strip(" \t[") not in tables
        if is_kept:
            kept.append(line)
    for table in filter(None, tables.values()):
        before = "".join(kept).rstrip()
        kept = [before + "\n\n" if before else "", table.rstrip() + "\n"]
    return "".join(kept)


def _depth(path: Path, document: dict[str, Any]) -> DepthUnits:
    value = document.get("depth", {})
    limits = {"unit_mm": (0.001, 10_000.0), "scale": (0.05, 20.0)}
    if not isinstance(value, dict) or (strangers := [key for key in value if key not in limits]):
        what = f"has {strangers[0]!r}" if isinstance(value, dict) else "is no table"
        raise bad_key(path, "depth", f"{what}, expected [depth] unit_mm = millimetres, scale = number")
    for key, (low, high) in limits.items():
        if key in value and not (_is_number(value[key]) and low <= value[key] <= high):
            raise bad_key(
                path, f"depth.{key}", f"is {value[key]!r}, expected a number from {low:g} to {high:g}"
            )
    return DepthUnits(**{key: float(number) for key, number in value.items()})


def _frame_pair(path: Path, document: dict[str, Any]) -> tuple[int | None, int | None] | None:
    value = document.get("frames")
    if value is None:
        return None
    is_pair = isinstance(value, list) and len(value) == 2 and all(type(v) is int for v in value)
    if not is_pair or not 0 <= value[0] < value[1]:
        raise bad_key(path, "frames", f"is {value!r}, expected [start, stop] with 0 <= start < stop")
    return value[0], value[1]


def _bounds(path: Path, document: dict[str, Any]) -> Bounds | None:
    value = document.get("room_bounds_m")
    if value is None:
        return None
    is_table = isinstance(value, list) and len(value) == 2 and all(_are_numbers(row, 3) for row in value)
    if not is_table or not all(a < b for a, b in zip(*value, strict=True)):
        raise bad_key(
            path,
            "room_bounds_m",
            f"is {value!r}, expected [[x0, y0, z0], [x1, y1, z1]] in metres, lower first",
        )
    lower, upper = ((float(x), float(y), float(z)) for x, y, z in value)
    return lower, upper


def _colour(path: Path, document: dict[str, Any]) -> tuple[int, int, int] | None:
    value = document.get("marker_colour")
    if value is None:
        return None
    if isinstance(value, str):
        if value.lower() in _COLOURS:
            return _COLOURS[value.lower()]
        if re.fullmatch(r"#[0-9a-fA-F]{6}", value):
            return int(value[1:3], 16), int(value[3:5], 16), int(value[5:7], 16)
    if isinstance(value, list) and len(value) == 3 and all(type(v) is int and 0 <= v <= 255 for v in value):
        return value[0], value[1], value[2]
    raise bad_key(
        path,
        "marker_colour",
        f'is {value!r}, expected [r, g, b] in 0..255, "#rrggbb" or {", ".join(_COLOURS)}',
    )


def _cameras(path: Path, document: dict[str, Any]) -> tuple[str, ...] | None:
    value = document.get("cameras")
    if value is None:
        return None
    if not isinstance(value, list) or not value or not all(isinstance(v, str) for v in value):
        raise bad_key(path, "cameras", f"is {value!r}, expected a list of names of calibrated cameras")
    return tuple(value)


def _camera_map(path: Path, document: dict[str, Any]) -> dict[str, str] | None:
    value = document.get("camera_map")
    if value is None:
        return None
    if not isinstance(value, dict):
        raise bad_key(path, "camera_map", 'is no table, expected [camera_map] "file name" = "camera name"')
    for key, name in value.items():
        if not isinstance(name, str):
            raise bad_key(path, f"camera_map.{key}", f"is {name!r}, expected the name of a calibrated camera")
    if doubled := sorted({n for n in value.values() if list(value.values()).count(n) > 1}):
        raise bad_key(path, "camera_map", f"gives camera {', '.join(doubled)} to more than one file")
    return dict(value)


def _polygons(path: Path, document: dict[str, Any]) -> dict[str, Polygon] | None:
    value = document.get("roi_px")
    if value is None:
        return None
    if not isinstance(value, dict):
        raise bad_key(path, "roi_px", "is no table, expected [roi_px] camera = [[u, v], [u, v], [u, v], ...]")
    polygons = {}
    for name, corners in value.items():
        is_polygon = isinstance(corners, list) and len(corners) >= 3
        if not is_polygon or not all(_are_numbers(corner, 2) for corner in corners):
            raise bad_key(path, f"roi_px.{name}", f"is {corners!r}, expected at least three corners [u, v]")
        polygons[name] = tuple((float(u), float(v)) for u, v in corners)
    return polygons


def _units(path: Path, document: dict[str, Any]) -> str | None:
    value = document.get("calibration_units")
    if value is None:
        return None
    unit = unit_from_word(value) if isinstance(value, str) else None
    if unit is None:
        raise bad_key(path, "calibration_units", f"is {value!r}, expected one of {', '.join(UNITS)}")
    return unit


def _up(path: Path, document: dict[str, Any]) -> str | None:
    value = document.get("calibration_up")
    if value is not None and value not in AXES:
        raise bad_key(path, "calibration_up", f'is {value!r}, expected "z", "-y", ...')
    return value


def _board(path: Path, document: dict[str, Any]) -> tuple[int, int] | None:
    value = document.get("checkerboard")
    if value is None:
        return None
    if not (isinstance(value, list) and len(value) == 2 and all(type(v) is int and v >= 3 for v in value)):
        raise bad_key(
            path, "checkerboard", f"is {value!r}, expected [columns, rows] of inner corners, each at least 3"
        )
    return value[0], value[1]
