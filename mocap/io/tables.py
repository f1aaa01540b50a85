"""The CSV tables of a run and of a truth: tracks and landmarks, checked line by line when read."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import ALL_LANDMARKS, FURTHER_LANDMARKS, LANDMARKS, Motion, Tracks
from mocap.errors import MocapError
from mocap.files import MB, TEXT_LIMIT_BYTES, check_regular
from mocap.io._files import atomic_text

TRACK_COLUMNS = ("frame", "time_s", "person", "x_m", "y_m", "z_m")
TRACK_STATUS_COLUMNS = ("std_x_m", "std_y_m", "std_z_m", "status")
LANDMARK_COLUMNS = ("frame", "time_s", "person", "landmark", "x_m", "y_m", "z_m")
FEET_AND_HANDS = "extra.csv"  # true landmarks of feet and hands, beside the fifteen of landmarks.csv
FURTHER_COLUMNS = ("frame", "person", "point", "x_m", "y_m", "z_m", "in_contact")
UNCERTAINTY_COLUMNS = ("std_x_m", "std_y_m", "std_z_m", "observed")
DETECTION_COLUMNS = ("frame", "u_px", "v_px")
WORLD_POINT_COLUMNS = ("camera", "u_px", "v_px", "x_m", "y_m", "z_m")
LABEL_COLUMNS = ("frame", "camera", "u_px", "v_px")
TIMESTAMP_COLUMNS = ("cam_id", "frame_time")

# Frames of a thousand years at 30 per second: what goes beyond is no count.
MOST_WHOLE = 10**12
# By the end of a column's name, its unit. No recording of people reaches a thousand kilometres, no camera has so many
# pixels, no recording lasts that long; larger values only overflow later, where nobody knows the line any more.
MOST_OF = {"_m": 1e6, "px": 1e6, "_s": 1e12}

_LANDMARK_INDEX = {name: i for i, name in enumerate(ALL_LANDMARKS)}
_STATUS = {"confirmed": True, "coasting": False}
_OBSERVED = {"1": True, "0": False, "true": True, "false": False}


def write_tracks_csv(path: Path | str, tracks: Tracks) -> None:
    """Write tracks as `frame,time_s,person,x_m,y_m,z_m`, rows as given, six decimals, atomically.

    Tracks that know their covariance and whether they were observed (not a truth) get std_x_m, std_y_m, std_z_m and
    status: `confirmed`, or `coasting` where the person was out of sight.
    """
    std, observed = tracks.std, tracks.observed
    has_more = std is not None or observed is not None
    numbers, ends = tracks.xyz, np.full(len(tracks), "")
    if has_more:
        numbers = np.hstack([numbers, np.full(numbers.shape, np.nan) if std is None else std])
        ends = (
            np.full(len(tracks), ",") if observed is None else np.where(observed, ",confirmed", ",coasting")
        )
    columns = tracks.frame, tracks.time_s, tracks.person, numbers, ends
    lines = [",".join(TRACK_COLUMNS + (TRACK_STATUS_COLUMNS if has_more else ()))]
    # Numbers of Python are written in a third of the time of numpy's.
    lines += [
        f"{frame},{_text(time_s)},{person},{_texts(own)}{end}"
        for frame, time_s, person, own, end in zip(*(c.tolist() for c in columns), strict=True)
    ]
    atomic_text(Path(path), "\n".join(lines) + "\n")


def read_tracks_csv(path: Path | str) -> Tracks:
    """Read tracks, sorted by frame, then person; a table with a header only gives empty tracks.

    Of the covariance the table holds the diagonal; it and `observed` are None where the table does not have them.
    Raises MocapError with the line for a missing column, a number that is none, an unknown status, or a doubled row.
    """
    rows, status = _track_rows(Path(path))
    keys = sorted(rows)
    values = np.array([rows[k] for k in keys], dtype=np.float64).reshape(-1, 7)
    index = np.array(keys, dtype=np.int64).reshape(-1, 2)
    has_std = bool(len(keys)) and bool(np.isfinite(values[:, 4:]).all())
    return Tracks(
        index[:, 0].copy(),
        index[:, 1].copy(),
        values[:, 0].copy(),
        values[:, 1:4].copy(),
        values[:, 4:, None] ** 2 * np.eye(3) if has_std else None,
        np.array([status[k] for k in keys], dtype=np.bool_) if keys and len(status) == len(keys) else None,
    )


def _track_rows(
    path: Path,
) -> tuple[dict[tuple[int, int], tuple[float, ...]], dict[tuple[int, int], bool]]:
    """(frame, person) -> time, place and deviation, and -> whether the person was seen, where the table says it."""
    rows: dict[tuple[int, int], tuple[float, ...]] = {}
    status: dict[tuple[int, int], bool] = {}
    for line, row in rows_of(path, TRACK_COLUMNS):
        key = (whole_of(path, line, row, "frame"), whole_of(path, line, row, "person"))
        if key in rows:
            raise _bad(path, line, f"frame {key[0]} of person {key[1]} is there twice")
        rows[key] = (
            *(_number(path, line, row, c) for c in ("time_s", "x_m", "y_m", "z_m")),
            *(_number(path, line, row, c, may_miss=True) for c in TRACK_STATUS_COLUMNS[:3]),
        )
        if word := row.get("status", "").strip().lower():
            if word not in _STATUS:
                raise _bad(path, line, f"status is {word!r}, expected {' or '.join(_STATUS)}")
            status[key] = _STATUS[word]
    return rows, status


def write_landmarks_csv(path: Path | str, motions: Sequence[Motion], *, with_unknown: bool = True) -> None:
    """Write the landmarks of all persons, rows by frame, person and order of the landmarks, atomically.

    with_unknown : False leaves out the rows of landmarks that are not known.
    The columns std_*_m and observed are left out when there are motions and none has either (a truth); NaN is
    written as `nan`, a missing `observed` as an empty field.
    """
    has_more = not motions or any(m.std is not None or m.observed is not None for m in motions)
    order = sorted((int(f), m.person, k, i) for k, m in enumerate(motions) for i, f in enumerate(m.frames))
    columns = LANDMARK_COLUMNS + (UNCERTAINTY_COLUMNS if has_more else ())
    texts = [_landmark_texts(motion, has_more, with_unknown) for motion in motions]
    atomic_text(Path(path), ",".join(columns) + "\n" + "".join(texts[k][i] for _, _, k, i in order))


def _landmark_texts(motion: Motion, has_more: bool, with_unknown: bool) -> list[str]:
    """The rows of one person, as one text per frame.  has_more : with deviations and `observed`."""
    numbers, ends = motion.landmarks, np.full(motion.landmarks.shape[:2], "")
    is_written = with_unknown | ~np.isnan(numbers).any(axis=2)
    if has_more:
        std = np.full(numbers.shape, np.nan) if motion.std is None else motion.std
        numbers = np.concatenate([numbers, std], axis=2)
        ends = np.full(ends.shape, ",") if motion.observed is None else np.where(motion.observed, ",1", ",0")
    columns = motion.frames, motion.time_s, numbers, ends, is_written
    texts = []
    for frame, time_s, *of_landmarks in zip(*(c.tolist() for c in columns), strict=True):
        begin = f"{frame},{_text(time_s)},{motion.person}"
        rows = zip(motion.names, *of_landmarks, strict=True)
        texts.append("".join(f"{begin},{name},{_texts(own)}{end}\n" for name, own, end, w in rows if w))
    return texts


def read_landmarks_csv(path: Path | str) -> list[Motion]:
    """Read the landmarks of all persons, one Motion each, ordered by person.

    Landmarks that a frame does not list are NaN; those of feet and hands are there when a row names one of them.
    `std` and `observed` are None where the file says nothing.
    Raises MocapError with the line for a missing column, an unknown landmark, a number that is none, or a
    doubled row.
    """
    path, people = Path(path), dict[int, _PersonRows]()
    for line, row in rows_of(path, LANDMARK_COLUMNS):
        person = whole_of(path, line, row, "person")
        if person not in people:
            people[person] = _PersonRows(path, person)
        people[person].add(line, row)
    return [people[person].motion() for person in sorted(people)]


class _PersonRows:
    """The rows of one person while a table of landmarks is read."""

    def __init__(self, path: Path, person: int) -> None:
        self._path, self._person = path, person
        self._times: dict[int, float] = {}
        # Frame -> landmark -> place and deviation; (frame, landmark) -> whether it was seen.
        self._values: dict[int, dict[int, tuple[float, ...]]] = {}
        self._observed: dict[tuple[int, int], bool] = {}

    def add(self, line: int, row: dict[str, str]) -> None:
        frame = whole_of(self._path, line, row, "frame")
        name = row["landmark"].strip()
        if name not in _LANDMARK_INDEX:
            raise _bad(self._path, line, f"unknown landmark {name!r}; known are {', '.join(ALL_LANDMARKS)}")
        landmark = _LANDMARK_INDEX[name]
        there = self._values.setdefault(frame, {})
        if landmark in there:
            raise _bad(self._path, line, f"{name} of person {self._person} in frame {frame} is there twice")
        self._times.setdefault(frame, _number(self._path, line, row, "time_s"))
        there[landmark] = tuple(
            _number(self._path, line, row, c, may_miss=True)
            for c in ("x_m", "y_m", "z_m", *UNCERTAINTY_COLUMNS[:3])
        )
        if word := row.get("observed", "").strip().lower():
            if word not in _OBSERVED:
                raise _bad(self._path, line, f"observed is {word!r}, expected 0 or 1")
            self._observed[frame, landmark] = _OBSERVED[word]

    def motion(self) -> Motion:
        frames = sorted(self._values)
        has_further = any(j >= len(LANDMARKS) for there in self._values.values() for j in there)
        n_landmarks = len(ALL_LANDMARKS if has_further else LANDMARKS)
        values = np.full((len(frames), n_landmarks, 6), np.nan)
        seen = np.zeros((len(frames), n_landmarks), dtype=np.bool_)
        for i, frame in enumerate(frames):
            for j, row_values in self._values[frame].items():
                values[i, j] = row_values
                seen[i, j] = self._observed.get((frame, j), False)
        return Motion(
            self._person,
            np.array(frames, dtype=np.int64),
            np.array([self._times[f] for f in frames]),
            values[..., :3].copy(),
            values[..., 3:].copy() if np.isfinite(values[..., 3:]).any() else None,
            seen if self._observed else None,
        )


@dataclass(frozen=True, eq=False)
class FeetAndHands:
    """True landmarks of feet and hands of one person.

    frames : (T,) int64, ascending.  xyz : (T, 6, 3) m, world, in the order of FURTHER_LANDMARKS, NaN = unknown.
    in_contact : (T, 6), whether it rests on the floor.
    """

    person: int
    frames: NDArray[np.int64]
    xyz: NDArray[np.float64]
    in_contact: NDArray[np.bool_]


def write_feet_and_hands_csv(path: Path | str, people: Sequence[FeetAndHands]) -> None:
    """Write `frame,person,point,x_m,y_m,z_m,in_contact`, rows by frame and person, atomically."""
    order = sorted((int(f), p.person, k, i) for k, p in enumerate(people) for i, f in enumerate(p.frames))
    lines = [",".join(FURTHER_COLUMNS)]
    for frame, person, k, i in order:
        own = people[k]
        lines += [
            f"{frame},{person},{name},{','.join(_text(x) for x in xyz)},{int(touches)}"
            for name, xyz, touches in zip(FURTHER_LANDMARKS, own.xyz[i], own.in_contact[i], strict=True)
        ]
    atomic_text(Path(path), "\n".join(lines) + "\n")


def read_feet_and_hands_csv(path: Path | str) -> list[FeetAndHands]:
    """Read true landmarks of feet and hands, ordered by person; other points of the table are left out.

    Raises MocapError with the line for a missing column, a number that is none, or a doubled row.
    """
    path = Path(path)
    found: dict[int, dict[int, dict[int, tuple[float, ...]]]] = {}
    for line, row in rows_of(path, FURTHER_COLUMNS):
        name = row["point"].strip()
        if name not in FURTHER_LANDMARKS:
            continue
        frame, person = whole_of(path, line, row, "frame"), whole_of(path, line, row, "person")
        there = found.setdefault(person, {}).setdefault(frame, {})
        point = FURTHER_LANDMARKS.index(name)
        if point in there:
            raise _bad(path, line, f"{name} of person {person} in frame {frame} is there twice")
        places = (_number(path, line, row, c, may_miss=True) for c in ("x_m", "y_m", "z_m"))
        there[point] = (*places, _number(path, line, row, "in_contact", may_miss=True))
    return [_feet_and_hands(person, found[person]) for person in sorted(found)]


def _feet_and_hands(person: int, rows: dict[int, dict[int, tuple[float, ...]]]) -> FeetAndHands:
    frames = sorted(rows)
    values = np.full((len(frames), len(FURTHER_LANDMARKS), 4), np.nan)
    for i, frame in enumerate(frames):
        for point, numbers in rows[frame].items():
            values[i, point] = numbers
    return FeetAndHands(
        person, np.array(frames, dtype=np.int64), values[..., :3].copy(), values[..., 3] == 1.0
    )


def read_detections_csv(path: Path | str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Read 2D marker detections of one camera: frame (n,) int64 ascending, uv (n, 2) px.

    A frame without detections is simply not there. Raises MocapError as the other readers do.
    """
    path = Path(path)
    frames, pixels = [], []
    for line, row in rows_of(path, DETECTION_COLUMNS):
        frames.append(whole_of(path, line, row, "frame"))
        pixels.append([_number(path, line, row, c) for c in DETECTION_COLUMNS[1:]])
    frame = np.array(frames, dtype=np.int64)
    order = np.argsort(frame, kind="stable")
    return frame[order], np.array(pixels, dtype=np.float64).reshape(-1, 2)[order]


def read_marker_labels_csv(path: Path | str) -> tuple[NDArray[np.int64], list[str], NDArray[np.float64]]:
    """Read hand-labelled markers: frame (n,) int64, camera names (n), uv (n, 2) px, rows as they stand.

    Raises MocapError as the other readers do.
    """
    path = Path(path)
    frames, cameras, pixels = [], [], []
    for line, row in rows_of(path, LABEL_COLUMNS):
        frames.append(whole_of(path, line, row, "frame"))
        cameras.append(row["camera"].strip())
        pixels.append([_number(path, line, row, c) for c in LABEL_COLUMNS[2:]])
    return np.array(frames, dtype=np.int64), cameras, np.array(pixels, dtype=np.float64).reshape(-1, 2)


def read_world_points_csv(path: Path | str) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Read points of known place in pictures: camera -> points (N, 3) m, world, and uv (N, 2) px.

    Raises MocapError as the other readers do.
    """
    path = Path(path)
    found: dict[str, list[list[float]]] = {}
    for line, row in rows_of(path, WORLD_POINT_COLUMNS):
        numbers = [_number(path, line, row, c) for c in WORLD_POINT_COLUMNS[1:]]
        found.setdefault(row["camera"].strip(), []).append(numbers)
    both = {camera: np.array(rows) for camera, rows in found.items()}
    return {camera: (rows[:, 2:].copy(), rows[:, :2].copy()) for camera, rows in both.items()}


def read_timestamps_csv(path: Path | str) -> dict[str, NDArray[np.float64]]:
    """Read when the pictures of a recording were taken: camera -> (n,) s on one clock, ascending, a row per picture.

    The table `cam_id,frame_time` of Caliscope and other recorders; rows of different cameras may stand in any order.
    Raises MocapError as the other readers do, and for times that do not ascend.
    """
    path = Path(path)
    found: dict[str, list[float]] = {}
    for line, row in rows_of(path, TIMESTAMP_COLUMNS):
        time = _number(path, line, row, "frame_time")
        times = found.setdefault(row["cam_id"].strip(), [])
        if times and time <= times[-1]:
            raise _bad(
                path, line, f"the time {time:g} does not come after {times[-1]:g} of the picture before"
            )
        times.append(time)
    if not found:
        raise MocapError(
            "there are no time stamps in the file", path=path, remedy="record it again, or take it away"
        )
    return {camera: np.array(times) for camera, times in found.items()}


def write_timestamps_csv(path: Path | str, times: Mapping[str, NDArray[np.floating]]) -> None:
    """Write when the pictures were taken, camera -> (n,) s, as `cam_id,frame_time`."""
    lines = [",".join(TIMESTAMP_COLUMNS)]
    lines += [f"{camera},{_text(t)}" for camera, of_camera in times.items() for t in of_camera]
    atomic_text(Path(path), "\n".join(lines) + "\n")


def write_detections_csv(path: Path | str, frame: NDArray[np.integer], uv: NDArray[np.floating]) -> None:
    """Write 2D marker detections as `frame,u_px,v_px`: frame (n,), uv (n, 2) px."""
    lines = [",".join(DETECTION_COLUMNS)]
    lines += [f"{int(f)},{_text(u)},{_text(v)}" for f, (u, v) in zip(frame, uv, strict=True)]
    atomic_text(Path(path), "\n".join(lines) + "\n")


def _text(value: float) -> str:
    return f"{float(value):.6f}"


def _texts(values: Sequence[float]) -> str:
    return ",".join([f"{value:.6f}" for value in values])


def rows_of(path: Path, required: Sequence[str]) -> Iterator[tuple[int, dict[str, str]]]:
    """(line number, fields by column) of a CSV file with at least the required columns.

    Raises MocapError for a file that cannot be read, a column that is missing or there twice, a line of other length.
    """
    if check_regular(path, "the table") > TEXT_LIMIT_BYTES:
        raise MocapError(
            f"the table cannot be read: it has more than {TEXT_LIMIT_BYTES / MB:.0f} MB",
            path=path,
            remedy="split the table, or write fewer decimals",
        )
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            header = _header(path, next(reader, []), required)
            for fields in reader:
                if not any(f.strip() for f in fields):
                    continue
                if len(fields) != len(header):
                    raise _bad(path, reader.line_num, f"{len(fields)} fields, expected {len(header)}")
                yield reader.line_num, dict(zip(header, fields, strict=True))
    except OSError as error:
        raise MocapError(
            f"the table cannot be read: {error.strerror}", path=path, remedy="check the path"
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise MocapError(f"not a CSV file: {error}", path=path, remedy="write the table again") from error


def _header(path: Path, fields: list[str], required: Sequence[str]) -> list[str]:
    header = [c.strip() for c in fields]
    if missing := [c for c in required if c not in header]:
        raise _bad(path, 1, f"column {', '.join(missing)} is missing; the file has {', '.join(header)}")
    if len(set(header)) < len(header):
        raise _bad(path, 1, "a column is there twice")
    return header


def _number(path: Path, line: int, row: dict[str, str], column: str, *, may_miss: bool = False) -> float:
    text = row.get(column, "").strip()
    if not text and may_miss:
        return math.nan
    try:
        value = float(text)
    except ValueError as error:
        raise _bad(path, line, f"{column} is {text!r}, not a number") from error
    if math.isinf(value) or (math.isnan(value) and not may_miss):
        raise _bad(path, line, f"{column} is {text!r}, not a finite number")
    if abs(value) > MOST_OF.get(column[-2:], math.inf):
        raise _bad(path, line, f"{column} is {text!r}; no recording reaches that far")
    return value


def whole_of(path: Path, line: int, row: dict[str, str], column: str) -> int:
    """A whole number from 0 on out of one field of a row; MocapError with the line for anything else."""
    value = _number(path, line, row, column)
    if not 0 <= value < MOST_WHOLE or value != int(value):
        raise _bad(path, line, f"{column} is {row[column]!r}, not a whole number from 0 on")
    return int(value)


def _bad(path: Path, line: int, message: str) -> MocapError:
    return MocapError(f"line {line}: {message}", path=path, remedy="correct the table or write it again")
