"""C3D, the binary marker file of biomechanics laboratories: read and written through ezc3d, read in a child process."""

from __future__ import annotations

import errno
import os
import struct
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap.data import Motion
from mocap.errors import MissingExtra, MocapError
from mocap.files import read_head
from mocap.io._child import read_in_child
from mocap.io.formats._writing import check_fps, gap_free, replacing
from mocap.io.formats.table import (
    MOST,
    PoseFile,
    PoseTable,
    check_places,
    person_in_name,
    without_zeros,
    zero_note,
)
from mocap.io.units import AXES

Array = NDArray[np.float64]

_UNITS = {"m": "m", "cm": "cm", "mm": "mm"}
_C3D_KEY = 0x50  # second byte of every C3D file
_BLOCK_BYTES = 512  # C3D files are made of blocks


def read_c3d(path: Path) -> PoseFile:
    """Read the points of a C3D file: one person, points with a negative residual are unknown.

    Up is what POINT:Y_SCREEN says points up on a screen, else z. A prefix `Name:` of the labels is left out.
    Needs the extra `export`. Raises MocapError for what is no C3D file or holds no points.
    """
    path = Path(path)
    head = read_head(path, 2, "the C3D file")
    if len(head) < 2 or head[1] != _C3D_KEY:
        raise MocapError("not a C3D file", path=path, remedy="export the file again")
    said, arrays = read_in_child("c3d", path, "the C3D file", remedy="export the file again")
    xyz = arrays["points"][:3].transpose(2, 1, 0)
    K = min(len(said["labels"]), xyz.shape[1])
    if K == 0:
        raise MocapError("the C3D file holds no named points", path=path, remedy="export points with labels")
    names = tuple(label.rpartition(":")[2].strip() for label in said["labels"][:K])
    xyz = _where_seen(xyz[:, :K], arrays["residuals"])
    check_places(path, xyz)
    xyz, n_zero = without_zeros(xyz)
    rate = _number(said["rate"])
    fps = rate if 0 < rate < MOST else None
    screen = str(said["up"] or "+Z").strip().lower().removeprefix("+")
    frames = said["first_frame"] + np.arange(len(xyz), dtype=np.int64)
    time_s = np.asarray(frames / rate if fps is not None else frames, dtype=np.float64)
    return PoseFile(
        path=path,
        format="C3D",
        people=(PoseTable(person_in_name(path), names, frames, time_s, xyz),),
        fps=fps,
        unit=_UNITS.get(str(said["units"] or "").strip().lower()),
        up=screen if screen in AXES else "z",
        notes=zero_note(n_zero),
    )


def _where_seen(xyz: Array, residuals: Array) -> Array:
    """Points (T, K, 3) with NaN where the residual is negative, as far as there are residuals."""
    if residuals.ndim < 2 or residuals.size != residuals.shape[-1] * residuals.shape[-2]:
        return xyz
    lost = residuals.reshape(residuals.shape[-2], residuals.shape[-1]).T[:, : xyz.shape[1]] < 0
    return np.where(lost[:, :, None], np.nan, xyz) if lost.shape == xyz.shape[:2] else xyz


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else 0.0


class Event(NamedTuple):
    """A moment of the recording, such as a left `Foot Strike`.  side : `Left`, `Right` or `General`.  time_s : of the
    frame, as frame / fps."""

    label: str
    side: str
    time_s: float


def write_c3d(path: Path, motion: Motion, fps: float, events: Sequence[Event] = ()) -> None:
    """Write the landmarks of one person as a C3D file in millimetres, Z up, axes as in the scene.

    Millimetres are what readers of C3D assume; the file says so in POINT:UNITS. One frame for every frame
    from the motion's first to its last; an unknown landmark has the residual -1 (C3D's mark of an invalid
    point).  events : into the group EVENT.
    Needs the extra `export`; without it, for a motion without frames, or when the file cannot be
    written, MocapError. Raises ValueError for fps <= 0.
    """
    check_fps(fps)
    path = Path(path)
    try:
        import ezc3d
    except ImportError as error:
        raise MissingExtra(
            "writing C3D needs the package ezc3d, which is not installed", "export", path=path
        ) from error
    if len(motion) == 0:
        raise MocapError(
            f"person {motion.person} has no frames; a C3D file cannot be empty",
            remedy="export another person or a frame range in which this one is present",
            path=path,
        )
    motion = gap_free(motion, fps)
    known = np.all(np.isfinite(motion.landmarks), axis=2)
    points = np.ones((4, len(motion.names), len(motion)))
    points[:3] = np.where(known[:, :, None], 1000.0 * motion.landmarks, np.nan).transpose(2, 1, 0)

    c3d = ezc3d.c3d()
    point = c3d["parameters"]["POINT"]
    point["RATE"]["value"] = [float(fps)]
    point["LABELS"]["value"] = list(motion.names)
    point["DESCRIPTIONS"]["value"] = [name.replace("_", " ") for name in motion.names]
    point["UNITS"]["value"] = ["mm"]
    c3d.add_parameter("POINT", "X_SCREEN", ["+X"])
    c3d.add_parameter("POINT", "Y_SCREEN", ["+Z"])
    if events:
        c3d.add_parameter("EVENT", "USED", [len(events)])
        c3d.add_parameter("EVENT", "CONTEXTS", [event.side for event in events])
        c3d.add_parameter("EVENT", "LABELS", [event.label for event in events])
        c3d.add_parameter("EVENT", "TIMES", np.array([[0.0, event.time_s] for event in events]).T)
    c3d["header"]["points"]["first_frame"] = int(motion.frames[0])
    c3d["data"]["points"] = points
    c3d["data"]["meta_points"]["residuals"] = np.where(known.T, 0.0, -1.0)[None]
    with replacing(path) as temporary, _plain_place(temporary) as place:
        try:
            c3d.write(str(place))
        except (RuntimeError, ValueError) as error:
            raise MocapError(
                f"ezc3d could not write the file: {error}",
                remedy="check that the folder is writable and has space left",
                path=path,
            ) from error
        if not _is_whole(place, points.shape[1] * points.shape[2]):
            # ezc3d says nothing when the disk is full.
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@contextmanager
def _plain_place(path: Path) -> Iterator[Path]:
    """Where ezc3d writes for `path`: it knows names of ASCII letters alone, whatever the locale."""
    if str(path).isascii():
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="mocap-") as folder:
        place = Path(folder) / "motion.c3d"
        yield place
        path.write_bytes(place.read_bytes())


def _is_whole(path: Path, n_points: int) -> bool:
    """Whether a file of so many points (x, y, z, residual as float32) was written to its end.

    ezc3d puts the block where the data begin into the header at the very end; until then it says 1.
    """
    with path.open("rb") as file:
        header = file.read(_BLOCK_BYTES)
    if len(header) < _BLOCK_BYTES:
        return False
    (first_block,) = struct.unpack_from("<H", header, 16)
    return first_block > 1 and path.stat().st_size >= (first_block - 1) * _BLOCK_BYTES + 16 * n_points
