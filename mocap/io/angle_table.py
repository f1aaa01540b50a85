"""angles.csv: anatomical angles of a run in degrees, written, and read line by line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mocap.data import AngleSeries
from mocap.errors import MocapError
from mocap.io._files import atomic_text
from mocap.io.tables import rows_of, whole_of

ANGLE_COLUMNS = ("frame", "time_s", "person", "angle", "value_deg", "std_deg", "observed")


def write_angles_csv(path: Path | str, series: Sequence[AngleSeries]) -> None:
    """Write the angles of all persons, rows by frame, person and order of the angles; NaN is written as `nan`."""
    order = sorted((int(f), s.person, k, i) for k, s in enumerate(series) for i, f in enumerate(s.frames))
    texts = [_frame_texts(own) for own in series]
    atomic_text(Path(path), ",".join(ANGLE_COLUMNS) + "\n" + "".join(texts[k][i] for _, _, k, i in order))


def _frame_texts(series: AngleSeries) -> list[str]:
    """The rows of one person, as one text per frame."""
    values = np.rad2deg(series.values)
    std = np.full(values.shape, np.nan) if series.std is None else np.rad2deg(series.std)
    seen = np.full(values.shape, "") if series.observed is None else np.where(series.observed, "1", "0")
    columns = series.frames, series.time_s, values, std, seen
    texts = []
    for frame, time_s, *of_angles in zip(*(c.tolist() for c in columns), strict=True):
        begin = f"{frame},{time_s:.6f},{series.person}"
        rows = zip(series.names, *of_angles, strict=True)
        texts.append("".join(f"{begin},{name},{v:.3f},{s:.3f},{o}\n" for name, v, s, o in rows))
    return texts


def read_angles_csv(path: Path | str) -> list[AngleSeries]:
    """Read the angles of all persons, ordered by person; what a frame does not list is NaN.

    Raises MocapError with the line for a missing column, a number that is none, or a doubled row.
    """
    path = Path(path)
    found: dict[int, dict[tuple[int, str], tuple[float, float, float, bool]]] = {}
    for line, row in rows_of(path, ANGLE_COLUMNS):
        person, frame = whole_of(path, line, row, "person"), whole_of(path, line, row, "frame")
        own = found.setdefault(person, {})
        key = (frame, row["angle"].strip())
        if key in own:
            raise _bad(path, line, f"{key[1]} of person {person} in frame {frame} is there twice")
        numbers = (_number(path, line, row, column) for column in ("time_s", "value_deg", "std_deg"))
        own[key] = (*numbers, row["observed"].strip() == "1")  # type: ignore[assignment]
    return [_series(person, found[person]) for person in sorted(found)]


def _series(person: int, rows: dict[tuple[int, str], tuple[float, float, float, bool]]) -> AngleSeries:
    names = tuple(dict.fromkeys(name for _, name in rows))
    frames = sorted({frame for frame, _ in rows})
    at = {frame: i for i, frame in enumerate(frames)}
    values = np.full((3, len(frames), len(names)), np.nan)
    observed = np.zeros((len(frames), len(names)), dtype=np.bool_)
    for (frame, name), (time_s, value, std, seen) in rows.items():
        i, a = at[frame], names.index(name)
        values[:, i, a] = time_s, value, std
        observed[i, a] = seen
    times = np.nanmax(values[0], axis=1) if len(frames) else np.zeros(0)
    angles, std_rad = np.deg2rad(values[1]), np.deg2rad(values[2])
    return AngleSeries(person, names, np.array(frames, dtype=np.int64), times, angles, std_rad, observed)


def _number(path: Path, line: int, row: dict[str, str], column: str) -> float:
    try:
        value = float(row[column])
    except ValueError as error:
        raise _bad(path, line, f"{column} is {row[column]!r}, not a number") from error
    if math.isinf(value):
        raise _bad(path, line, f"{column} is infinite")
    return value


def _bad(path: Path, line: int, message: str) -> MocapError:
    return MocapError(f"line {line}: {message}", path=path, remedy="correct the table or write it again")
