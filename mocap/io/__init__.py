"""Calibrations, sessions, pictures, stage products and tables: everything that is a file.

The names are imported when they are first used, because zarr and OpenCV take their time to load.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOMES = {
    "CalibrationFile": "calibration",
    "find_calibration": "calibration",
    "read_calibration": "calibration",
    "write_calibration": "calibration",
    "Finding": "session",
    "Session": "session",
    "check_session": "session",
    "open_session": "session",
    "FrameReader": "video",
    "MaskReader": "video",
    "clip_info": "video",
    "iter_clip": "video",
    "StageReader": "store",
    "StageStore": "store",
    "StageWriter": "store",
    "pack_masks": "store",
    "unpack_masks": "store",
    "read_detections_csv": "tables",
    "read_landmarks_csv": "tables",
    "read_tracks_csv": "tables",
    "write_detections_csv": "tables",
    "write_landmarks_csv": "tables",
    "write_tracks_csv": "tables",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
