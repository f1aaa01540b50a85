"""TRC, the marker table of OpenSim, Pose2Sim and OpenCap."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from mocap.io.poses.table import (
    PoseFile,
    PoseTable,
    bad_line,
    number,
    text_of,
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
    lines = text_of(path).splitlines()
    if len(lines) < _HEADER_LINES or "PathFileType" not in lines[0]:
        raise bad_line(
            path, 1, "not a TRC file: it does not begin with PathFileType and five lines of header"
        )
    header = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    # Cells of a table with blanks can only be told apart by tabs.
    cells = _tabs if "\t" in lines[3] else str.split
    names = tuple(c.strip() for c in cells(lines[3])[2:] if c.strip())
    if not names:
        raise bad_line(path, 4, "no marker is named")
    doubled = sorted({n for n in names if names.count(n) > 1})
    if doubled:
        raise bad_line(path, 4, f"marker {doubled[0]!r} is named twice")
    declared = header.get("NumMarkers", "")
    if declared.isdecimal() and int(declared) != len(names):
        raise bad_line(path, 4, f"{len(names)} markers are named, the header says {declared}")
    width = 2 + 3 * len(names)
    rows = []
    for i, line in enumerate(lines[_HEADER_LINES:], start=_HEADER_LINES + 1):
        fields = cells(line)
        if not any(f.strip() for f in fields):
            continue
        if any(f.strip() for f in fields[width:]):
            raise bad_line(path, i, f"{len(fields)} cells, expected at most {width}")
        fields = fields[:width] + [""] * (width - len(fields))
        rows.append([number(path, i, f, "a cell") for f in fields])
        whole(path, i, fields[0], "the frame")
    table = np.array(rows, dtype=np.float64).reshape(-1, width)
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


def person_in_name(path: Path) -> int:
    """Number of the person in a file name like person_2.trc or walk_P2_0-90.trc, else 0."""
    match = re.search(r"(?:^|_)(?:person_?|P)(\d+)(?=_|$)", path.stem)
    return int(match.group(1)) if match else 0


def _tabs(line: str) -> list[str]:
    return line.split("\t")
