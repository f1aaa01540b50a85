"""Table of foreign motion, which every reader gives: named points over time, in the unit and the axes of the file."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.errors import MocapError

Array = NDArray[np.float64]

# Millimetres in a thousand kilometres: beyond lies no recording, only overflow.
MOST = 1e9
# Frame numbers may be time stamps in microseconds.
_MOST_WHOLE = 1e15


@dataclass(frozen=True, eq=False)
class PoseTable:
    """Points of one person, as the file holds them.

    names : K names.  frames : (T,) int64 ascending.  time_s : (T,).  xyz : (T, K, 3), NaN = unknown.
    std : (T, K, 3) in the same unit, or None.  observed : (T, K), or None.
    """

    person: int
    names: tuple[str, ...]
    frames: NDArray[np.int64]
    time_s: Array
    xyz: Array
    std: Array | None = None
    observed: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        expected = (len(self.frames), len(self.names), 3)
        if self.xyz.shape != expected:
            raise ValueError(f"xyz has shape {self.xyz.shape}, expected {expected}")


@dataclass(frozen=True, eq=False)
class PoseFile:
    """A file or folder of poses.

    format : for people, such as "TRC".  fps, unit : as the file declares them, None = it does not say.
    up : axis that points up, "x", "-x", ... "-z", by the file or by custom of its format.
    world_from_file : (3, 3), z up, where custom fixes the other axes too; None = the next cyclic ones.
    notes : what the reader had to assume, plain sentences.
    """

    path: Path
    format: str
    people: tuple[PoseTable, ...]
    fps: float | None
    unit: str | None
    up: str
    notes: tuple[str, ...] = ()
    world_from_file: NDArray[np.float64] | None = None


def bad_line(path: Path, line: int, message: str) -> MocapError:
    return MocapError(f"line {line}: {message}", path=path, remedy="export the file again")


def number(path: Path, line: int, text: str, what: str) -> float:
    """A number that a recording can hold, or NaN for an empty cell or one that says nan."""
    value = _finite(path, line, text, what)
    if abs(value) > MOST:
        raise bad_line(path, line, f"{what} is {text.strip()!r}; no recording reaches that far")
    return value


def whole(path: Path, line: int, text: str, what: str) -> int:
    """A whole number that counts something; so large a one as no recording has is refused like a word."""
    value = _finite(path, line, text, what)
    if not abs(value) < _MOST_WHOLE or value != int(value):
        raise bad_line(path, line, f"{what} is {text.strip()!r}, not a whole number")
    return int(value)


def time_of(path: Path, line: int, text: str, what: str) -> float:
    """Seconds, or milliseconds since 1970 where a tool writes these; NaN for an empty cell."""
    value = _finite(path, line, text, what)
    if abs(value) > _MOST_WHOLE:
        raise bad_line(path, line, f"{what} is {text.strip()!r}; no recording lasts that long")
    return value


def _finite(path: Path, line: int, text: str, what: str) -> float:
    text = text.strip()
    if not text or text.lower() in ("nan", "na", "null", "none"):
        return float("nan")
    try:
        value = float(text)
    except ValueError as error:
        raise bad_line(path, line, f"{what} is {text!r}, not a number") from error
    if np.isinf(value):
        raise bad_line(path, line, f"{what} is infinite")
    return value


def check_places(path: Path, xyz: Array) -> None:
    """MocapError when a point (..., 3) lies where no recording reaches, NaN left out; in the unit of the file."""
    far = np.abs(xyz) > MOST
    if far.any():
        raise MocapError(
            f"a point lies at {xyz[far][0]:.3g}; no recording reaches that far",
            path=path,
            remedy="export the file again",
        )


def without_zeros(xyz: Array) -> tuple[Array, int]:
    """Points that are exactly (0, 0, 0) are how many tools write "not seen": NaN, and how many there were."""
    zero = (xyz == 0.0).all(axis=2)
    return np.where(zero[:, :, None], np.nan, xyz), int(zero.sum())


def zero_note(n: int) -> tuple[str, ...]:
    if n == 0:
        return ()
    return (f"{n} point{'s' * (n != 1)} at exactly (0, 0, 0) taken as not seen",)


def person_in_name(path: Path) -> int:
    """Number of the person in a file name like person_2.trc or walk_P2_0-90.trc, else 0."""
    match = re.search(r"(?:^|_)(?:person_?|P)(\d+)(?=_|$)", path.stem)
    return int(match.group(1)) if match else 0
