"""CSV of poses: ours (one row per landmark) and wide ones (one row per frame, NAME_x, NAME_y, NAME_z)."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap.errors import MocapError
from mocap.files import read_text
from mocap.io.formats.table import (
    PoseFile,
    PoseTable,
    bad_line,
    number,
    time_of,
    whole,
    without_zeros,
    zero_note,
)
from mocap.io.tables import read_landmarks_csv

_COLUMN = re.compile(r"^(?P<name>.+?)[ ._:\-]?(?P<axis>[xyzXYZ])(?:[ _(\[]+(?P<unit>mm|cm|m)[)\]]?)?$")
_FRAME = ("frame", "frame#", "frame_number", "fnum", "frameid", "frame_id")
_TIME = ("time", "time_s", "timestamp", "t", "seconds", "time(s)")
_PERSON = ("person", "person_id", "id", "track", "subject")


def read_csv(path: Path) -> PoseFile:
    """Read poses from a CSV file, ours or a wide one; the header tells which.

    Wide: columns `NAME_x, NAME_y, NAME_z` (or `NAME.x`, `NAMEX`, `NAME_x_mm`), one row per frame and person; `frame`,
    `time` and `person` where there are such columns, else rows count from 0. Up is z.
    Raises MocapError with the line for a cell that is no number or a frame that is there twice.
    """
    path = Path(path)
    text = read_text(path)
    lines = text.splitlines()
    try:
        header = [c.strip() for c in next(csv.reader(lines[:1], delimiter=_delimiter(text)), [])]
        if "landmark" in header:
            return _own(path)
        return _wide(path, header, list(csv.reader(lines[1:], delimiter=_delimiter(text))))
    except csv.Error as error:
        raise MocapError(f"not a CSV file: {error}", path=path, remedy="export the file again") from error


def _own(path: Path) -> PoseFile:
    motions = read_landmarks_csv(path)
    people = tuple(
        PoseTable(m.person, m.names, m.frames, m.time_s, m.landmarks, m.std, m.observed) for m in motions
    )
    return PoseFile(path, "landmarks.csv", people, _rate(people), "m", "z")


@dataclass(frozen=True)
class _Columns:
    """Where things stand in a wide table: place of frame, time and person (None = no such column), and point -> places
    of x, y, z. unit : the one that all titles name, else None."""

    frame_at: int | None
    time_at: int | None
    person_at: int | None
    points: dict[str, tuple[int, int, int]]
    unit: str | None


def _columns(path: Path, header: list[str]) -> _Columns:
    axes: dict[str, dict[str, int]] = {}
    units = set()
    for c, title in enumerate(header):
        match = None if title.lower() in (*_FRAME, *_TIME, *_PERSON) else _COLUMN.match(title)
        if match:
            axes.setdefault(match["name"], {})[match["axis"].lower()] = c
            units.add(match["unit"])
    units.discard(None)
    points = {name: (at["x"], at["y"], at["z"]) for name, at in axes.items() if len(at) == 3}
    if not points:
        raise MocapError(
            "no point was found: no three columns are named alike but for x, y and z",
            path=path,
            remedy="name the columns like left_knee_x, left_knee_y, left_knee_z",
        )
    lower = [title.lower() for title in header]
    unit = units.pop() if len(units) == 1 else None
    return _Columns(_place(lower, _FRAME), _place(lower, _TIME), _place(lower, _PERSON), points, unit)


def _place(titles: list[str], words: tuple[str, ...]) -> int | None:
    """Place of the first of the words that is a title; None when none is."""
    return next((titles.index(w) for w in words if w in titles), None)


def _wide(path: Path, header: list[str], rows: list[list[str]]) -> PoseFile:
    columns = _columns(path, header)
    found: dict[int, dict[int, tuple[float, list[list[float]]]]] = {}
    for k, row in enumerate(rows):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(header):
            raise bad_line(path, k + 2, f"{len(row)} fields, expected {len(header)}")
        person, frame, values = _wide_row(path, k, row, header, columns)
        there = found.setdefault(person, {})
        if frame in there:
            raise bad_line(path, k + 2, f"frame {frame} of person {person} is there twice")
        there[frame] = values
    notes = (
        [] if columns.frame_at is not None else ["the table has no column `frame`: rows are counted from 0"]
    )
    people, n_zero = [], 0
    for person in sorted(found):
        frames = np.array(sorted(found[person]), dtype=np.int64)
        xyz = np.array([found[person][f][1] for f in frames.tolist()])
        xyz, zeros = without_zeros(xyz)
        n_zero += zeros
        time_s = np.array([found[person][f][0] for f in frames.tolist()])
        people.append(PoseTable(person, tuple(columns.points), frames, time_s, xyz))
    notes += zero_note(n_zero)
    return PoseFile(path, "wide CSV", tuple(people), _rate(tuple(people)), columns.unit, "z", tuple(notes))


def _wide_row(
    path: Path, k: int, row: list[str], header: list[str], at: _Columns
) -> tuple[int, int, tuple[float, list[list[float]]]]:
    """Person, frame, and (time, places) of the k-th row below the header."""
    line = k + 2
    person = 0 if at.person_at is None else whole(path, line, row[at.person_at], "person")
    frame = k if at.frame_at is None else whole(path, line, row[at.frame_at], "frame")
    time = float("nan") if at.time_at is None else time_of(path, line, row[at.time_at], header[at.time_at])
    return (
        person,
        frame,
        (time, [[number(path, line, row[c], header[c]) for c in xyz] for xyz in at.points.values()]),
    )


def _rate(people: tuple[PoseTable, ...]) -> float | None:
    """Frames per second from frame numbers and times; None without times."""
    rates = []
    for table in people:
        known = np.isfinite(table.time_s)
        frames, time_s = table.frames[known], table.time_s[known]
        if len(frames) > 1 and time_s[-1] > time_s[0]:
            rates.append(float((frames[-1] - frames[0]) / (time_s[-1] - time_s[0])))
    return float(np.median(rates)) if rates else None


def _delimiter(text: str) -> str:
    first = text.partition("\n")[0]
    return max(",;\t", key=first.count)
