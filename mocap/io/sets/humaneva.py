"""HumanEva: videos at 60 frames/s that begin apart, .cal and .ofs of each camera, and markers in C3D at 120 Hz."""

from __future__ import annotations

import re
from pathlib import Path

from mocap.errors import MocapError
from mocap.files import read_text
from mocap.io.calibration.laboratory import joined, read_humaneva
from mocap.io.formats.c3d import read_c3d
from mocap.io.sets.recording import Clock, Recording, clips_named, files_below, from_zero

_CAMERA = re.compile(r"_\((\w+)\)\.\w+$")
_EMPTY = re.compile(r"^background.*_\((\w+)\)\.\w+$", re.I)


def takes(root: Path) -> dict[str, Path]:
    """SUBJECT/ACTION_TRIAL -> its markers."""
    return {f"{p.parents[1].name}/{p.stem}": p for p in files_below(root, "mocap_data/*.c3d")}


def read(root: Path, markers: Path) -> Recording:
    """Image_Data, Calibration_Data and Sync_Data beside Mocap_Data; clips of the empty scene anywhere below the folder.

    Cameras without any of the three are left out.
    """
    subject = markers.parents[1]
    calibrations = {p.stem: p for p in files_below(subject, "calibration_data/*.cal")}
    videos = [p for p in files_below(subject, "image_data/*") if p.name.startswith(f"{markers.stem}_(")]
    starts = [p for p in files_below(subject, "sync_data/*.ofs") if p.name.startswith(f"{markers.stem}_(")]
    clips = clips_named(videos, _CAMERA)
    sync = {match.group(1): p for p in starts if (match := _CAMERA.search(p.name))}
    names = [name for name in clips if name in calibrations and name in sync]
    if not names:
        raise MocapError(
            f"no camera has a video of {markers.stem}, a calibration and an .ofs file",
            path=subject,
            remedy="unpack Image_Data, Calibration_Data and Sync_Data beside Mocap_Data",
        )
    truth = read_c3d(markers)
    if not truth.fps:
        raise MocapError("the markers have no frame rate", path=markers, remedy="unpack the archive again")
    begins, fps = {}, {}
    for name in names:
        begins[name], fps[name] = clock_of(sync[name], truth.fps)
    return Recording(
        rig=joined([read_humaneva(calibrations[name]) for name in names]),
        rig_path=calibrations[names[0]].parent,
        clips={name: clips[name] for name in names},
        truth=from_zero(truth),
        clock=Clock(begins, fps),
        empty=clips_named(files_below(root, "background*"), _EMPTY),
    )


def clock_of(path: Path, rate: float) -> tuple[float, float]:
    """When the first picture of a clip was taken, s after the first row of the markers, and its pictures per second.

    An .ofs file has three numbers: a picture, the row of the markers at the same moment (both count from 1), and rows
    per picture.  rate : rows per second.
    """
    words = read_text(path).split()
    try:
        picture, row, step = (float(word) for word in words)
        is_good = 0.01 < step < 1e3 and abs(picture) < 1e6 and abs(row) < 1e6
    except ValueError:
        is_good = False
    if not is_good:
        raise MocapError(
            "an .ofs file has three numbers: a picture, a row of the markers, and rows per picture",
            path=path,
            remedy="unpack Sync_Data again",
        )
    return ((row - 1.0) - (picture - 1.0) * step) / rate, rate / step
