"""CSV keypoints: our own table (MediaPipe's names too), DeepLabCut's and SLEAP's."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data.keypoints import KEYPOINTS
from mocap.errors import MocapError
from mocap.files import read_text
from mocap.io._files import atomic_text
from mocap.io.keypoints.clip import CameraKeypoints, bad, finite_or_none, known_rows, new_figure, placed
from mocap.io.keypoints.names import keypoint_row
from mocap.io.tables import MOST_WHOLE, rows_of, whole_of

Array = NDArray[np.float64]
COLUMNS = ("frame", "keypoint", "u_px", "v_px", "confidence")


def read_table(path: Path) -> CameraKeypoints:
    """A CSV file of one camera, of the kind that its first line says."""
    head = _first_fields(path)
    if head and head[0].strip().lower() == "scorer":
        return _read_dlc(path)
    if {"frame_idx", "track"} & {f.strip() for f in head} and any(f.strip().endswith(".x") for f in head):
        return _read_sleap(path)
    return _read_own(path)


def write_keypoints_csv(path: Path | str, figures: Iterable[tuple[int, int, Array]]) -> None:
    """Write keypoints of one camera as `frame,person,keypoint,u_px,v_px,confidence`, atomically.

    figures : frame, number of the person in this file, and (K, 3): u px, v px, confidence; NaN is left out.
    """
    lines = ["frame,person,keypoint,u_px,v_px,confidence"]
    for frame, person, points in figures:
        for name, (u, v, c) in zip(KEYPOINTS, points, strict=True):
            if math.isfinite(u):
                lines.append(f"{frame},{person},{name},{u:.2f},{v:.2f},{c:.3f}")
    atomic_text(Path(path), "\n".join(lines) + "\n")


def _first_fields(path: Path) -> list[str]:
    text = read_text(path, "the keypoints")
    return next(csv.reader([text.split("\n", 1)[0]]), [])


def _read_own(path: Path) -> CameraKeypoints:
    """One row per point; `person` tells the figures of a picture apart, without it there is one."""
    figures: dict[tuple[int, int], Array] = {}
    seen: set[tuple[int, int, str]] = set()
    named: dict[str, int | None] = {}
    for line, row in rows_of(path, COLUMNS):
        frame = whole_of(path, line, row, "frame")
        person = whole_of(path, line, row, "person") if row.get("person") else 0
        name = row["keypoint"].strip()
        if (frame, person, name) in seen:
            raise bad(path, f"line {line}: {name} is there twice", frame)
        seen.add((frame, person, name))
        if name not in named:
            named[name] = keypoint_row(name)
        at = named[name]
        figure = figures.setdefault((frame, person), new_figure())
        if at is not None:
            placed(figure, at, *(_value(path, frame, row[c]) for c in COLUMNS[2:]))
    if figures:
        known_rows(list(named), path)
    clip = CameraKeypoints(path)
    for (frame, _), figure in sorted(figures.items(), key=lambda entry: entry[0]):
        clip.add(frame, figure)
    return clip


def _read_dlc(path: Path) -> CameraKeypoints:
    """DeepLabCut: lines scorer, (individuals,) bodyparts and coords over columns x, y, likelihood."""
    heads: dict[str, list[str]] = {}
    rows: list[list[str]] = []
    for fields in _lines(path):
        word = fields[0].strip().lower()
        if word in ("scorer", "individuals", "bodyparts", "coords") and not rows:
            heads[word] = [f.strip() for f in fields]
        else:
            rows.append(fields)
    if "bodyparts" not in heads or "coords" not in heads:
        raise bad(path, "a table of DeepLabCut has lines bodyparts and coords")
    parts, coords = heads["bodyparts"], heads["coords"]
    persons = heads.get("individuals", ["", *["one"] * (len(parts) - 1)])
    columns: dict[tuple[str, str], dict[str, int]] = {}
    for k in range(1, min(len(parts), len(coords), len(persons))):
        columns.setdefault((persons[k], parts[k]), {})[coords[k].lower()] = k
    return _wide(path, columns, "likelihood", [(_frame(path, r[0]), r) for r in rows])


def _read_sleap(path: Path) -> CameraKeypoints:
    """SLEAP: a row per instance with columns track, frame_idx and NAME.x, NAME.y, NAME.score."""
    lines = _lines(path)
    head = [f.strip() for f in next(lines)]
    if "frame_idx" not in head:
        raise bad(path, "a table of SLEAP has a column frame_idx")
    at = head.index("frame_idx")
    columns: dict[tuple[str, str], dict[str, int]] = {}
    for k, name in enumerate(head):
        part, _, what = name.rpartition(".")
        if part and part != "instance":
            columns.setdefault(("one", part), {})[what] = k
    rows = []
    for fields in lines:
        if len(fields) != len(head):
            raise bad(path, f"a line has {len(fields)} fields, expected {len(head)}")
        rows.append((_frame(path, fields[at]), fields))
    return _wide(path, columns, "score", rows)


def _wide(
    path: Path,
    columns: Mapping[tuple[str, str], Mapping[str, int]],
    confidence: str,
    rows: Sequence[tuple[int, Sequence[str]]],
) -> CameraKeypoints:
    """Figures of a table with three columns per point.  columns : (person, name) -> x, y and confidence -> column."""
    names = list(dict.fromkeys(name for _, name in columns))
    at = dict(zip(names, known_rows(names, path), strict=True))
    clip = CameraKeypoints(path)
    for frame, fields in rows:
        figures: dict[str, Array] = {}
        clip.of_frame.setdefault(frame, [])
        for (person, name), where in columns.items():
            row = at[name]
            if row is None or not {"x", "y"} <= where.keys():
                continue
            if max(where.values()) >= len(fields):
                raise bad(path, f"a line has {len(fields)} fields, fewer than its heading", frame)
            c = _value(path, frame, fields[where[confidence]]) if confidence in where else 1.0
            u, v = (_value(path, frame, fields[where[k]]) for k in "xy")
            placed(figures.setdefault(person, new_figure()), row, u, v, c)
        for figure in figures.values():
            clip.add(frame, figure)
    return clip


def _lines(path: Path) -> Iterator[list[str]]:
    try:
        yield from (f for f in csv.reader(read_text(path, "the keypoints").splitlines()) if any(f))
    except csv.Error as error:
        raise MocapError(f"not a CSV file: {error}", path=path, remedy="write the table again") from error


def _frame(path: Path, text: str) -> int:
    value = _value(path, None, text)
    if not 0 <= value < MOST_WHOLE or value != int(value):
        raise bad(path, f"{text!r} is no frame")
    return int(value)


def _value(path: Path, frame: int | None, text: str) -> float:
    if not text.strip():
        return math.nan
    try:
        value = float(text)
    except ValueError as error:
        raise bad(path, f"{text!r} is no number", frame) from error
    return finite_or_none(value, path, -1 if frame is None else frame)
