"""TRC, the marker table of OpenSim, Pose2Sim and OpenCap: read and written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import Motion
from mocap.files import read_text
from mocap.io.formats._writing import Y_UP_FROM_WORLD, check_fps, gap_free, write_bytes
from mocap.io.formats.marker_names import MarkerNames, marker_names
from mocap.io.formats.table import (
    PoseFile,
    PoseTable,
    bad_line,
    number,
    person_in_name,
    time_of,
    whole,
    without_zeros,
    zero_note,
)

_UNITS = {"m": "m", "meters": "m", "metres": "m", "cm": "cm", "mm": "mm", "millimeters": "mm"}
_HEADER_LINES = 5


def read_trc(path: Path) -> PoseFile:
    """Read a TRC file: one person, frames and times as they are numbered there, empty cells = unknown.

    Up is y, the custom of OpenSim. `_P3` or `_person3` in the file's name says whose markers these are, and
    so does `person_3`; else person 0. Raises MocapError with the line for a header or a cell that is wrong.
    """
    path = Path(path)
    lines = read_text(path).splitlines()
    if len(lines) < _HEADER_LINES or "PathFileType" not in lines[0]:
        raise bad_line(
            path, 1, "not a TRC file: it does not begin with PathFileType and five lines of header"
        )
    header = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    # Cells of a table with blanks can only be told apart by tabs.
    cells = _tabs if "\t" in lines[3] else str.split
    names = _marker_names(path, cells(lines[3])[2:], header.get("NumMarkers", ""))
    table = _cells_as_numbers(path, lines, cells, 2 + 3 * len(names))
    frames = table[:, 0].astype(np.int64)
    if len(frames) > 1 and (np.diff(frames) <= 0).any():
        at = int(np.argmax(np.diff(frames) <= 0)) + 1
        raise bad_line(path, _HEADER_LINES + 1 + at, f"frame {frames[at]} does not follow {frames[at - 1]}")
    xyz, n_zero = without_zeros(table[:, 2:].reshape(len(table), len(names), 3))
    rate = number(path, 3, header.get("DataRate", ""), "DataRate")
    fps = rate if rate > 0 else None
    time_s = table[:, 1]
    if fps is not None:
        time_s = np.where(np.isfinite(time_s), time_s, frames / fps)
    return PoseFile(
        path=path,
        format="TRC",
        people=(PoseTable(person_in_name(path), names, frames, time_s, xyz),),
        fps=fps,
        unit=_UNITS.get(header.get("Units", "").lower()),
        up="y",
        notes=zero_note(n_zero),
    )


def _marker_names(path: Path, cells: list[str], declared: str) -> tuple[str, ...]:
    names = tuple(c.strip() for c in cells if c.strip())
    if not names:
        raise bad_line(path, 4, "no marker is named")
    doubled = sorted({n for n in names if names.count(n) > 1})
    if doubled:
        raise bad_line(path, 4, f"marker {doubled[0]!r} is named twice")
    if declared.isdecimal() and int(declared) != len(names):
        raise bad_line(path, 4, f"{len(names)} markers are named, the header says {declared}")
    return names


def _cells_as_numbers(
    path: Path, lines: list[str], cells: Callable[[str], list[str]], width: int
) -> NDArray[np.float64]:
    """The table below the header, (T, width): frame, time, then x, y, z of every marker."""
    rows = []
    for i, line in enumerate(lines[_HEADER_LINES:], start=_HEADER_LINES + 1):
        fields = cells(line)
        if not any(f.strip() for f in fields):
            continue
        if any(f.strip() for f in fields[width:]):
            raise bad_line(path, i, f"{len(fields)} cells, expected at most {width}")
        fields = fields[:width] + [""] * (width - len(fields))
        first = [whole(path, i, fields[0], "the frame"), time_of(path, i, fields[1], "the time")]
        rows.append([*first, *(number(path, i, f, "a cell") for f in fields[2:])])
    return np.array(rows, dtype=np.float64).reshape(-1, width)


def _tabs(line: str) -> list[str]:
    return line.split("\t")


def write_trc(
    path: Path, motion: Motion, fps: float, *, markers: MarkerNames = "mocap", is_filled: bool = False
) -> None:
    """Write the landmarks of one person as a TRC file in metres, Y up.

    The axes are those of Pose2Sim and OpenSim: file (x, y, z) = scene (y, z, x), so a reader gets the scene
    back as file (z, x, y). One row for every frame from the motion's first to its last, `Frame#` counts from
    0 as everywhere here; an unknown landmark is three blank cells. A motion without frames gives a header
    only. Raises ValueError for fps <= 0, MocapError when the file cannot be written.

    markers : what the landmarks are called; those that the set has no name for are left out.  is_filled : unknown
    places are drawn straight from the last known one to the next, which tools want that know no gaps; STEM_filled.csv
    beside the file lists them.
    """
    check_fps(fps)
    path = Path(path)
    motion = gap_free(motion, fps)
    names = marker_names(motion.names, markers)
    places = motion.landmarks[:, [motion.names.index(name) for name in names]]
    if is_filled:
        places, filled = without_gaps(places)
        _write_filled(path.with_name(f"{path.stem}_filled.csv"), motion.frames, list(names.values()), filled)
    n_markers = len(names)
    first = int(motion.frames[0]) if len(motion) else 0
    header = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units"]
    header += ["OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"]
    rate = f"{fps:g}"
    values = [rate, rate, str(len(motion)), str(n_markers), "m", rate, str(first), str(len(motion))]
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "\t".join(header),
        "\t".join(values),
        "Frame#\tTime\t" + "\t\t\t".join(names.values()) + "\t\t",
        "\t\t" + "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, n_markers + 1)),
    ]
    points = places @ Y_UP_FROM_WORLD.T
    for frame, time_s, row in zip(motion.frames, motion.time_s, points, strict=True):
        cells = [
            "\t\t" if not np.isfinite(point).all() else "\t".join(f"{value:.6f}" for value in point)
            for point in row
        ]
        lines.append(f"{int(frame)}\t{time_s:.6f}\t" + "\t".join(cells))
    write_bytes(path, ("\n".join(lines) + "\n").encode("utf-8"))


def without_gaps(places: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Places (T, K, 3) with unknown ones drawn between their neighbours in time, and which these are, (T, K).

    Before the first and after the last known place it stands; what is never known stays unknown.
    """
    known = np.asarray(np.isfinite(places).all(axis=2))
    out = places.copy()
    frames = np.arange(len(places))
    for k in np.flatnonzero(known.any(axis=0)):
        for axis in range(3):
            out[:, k, axis] = np.interp(frames, frames[known[:, k]], places[known[:, k], k, axis])
    return out, ~known & np.isfinite(out).all(axis=2)


def _write_filled(
    path: Path, frames: NDArray[np.int64], markers: list[str], filled: NDArray[np.bool_]
) -> None:
    """The places that were not measured: one line per frame and marker."""
    lines = [f"{int(frames[i])},{markers[k]}" for i, k in np.argwhere(filled)]
    write_bytes(path, ("\n".join(["frame,marker", *lines]) + "\n").encode("utf-8"))
