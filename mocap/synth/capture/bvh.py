"""Reading BVH files (Biovision hierarchy)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mocap.errors import MocapError
from mocap.synth.capture.recording import Recording, euler_matrix

_AXES = {"Xrotation": "x", "Yrotation": "y", "Zrotation": "z"}
_PLACES = {"Xposition": 0, "Yposition": 1, "Zposition": 2}


def read_bvh(path: Path | str) -> Recording:
    """The joints and frames of a BVH file, in its own units and axes. End sites are left out.

    Raises MocapError with the line for a file that cannot be read or understood.
    """
    path = Path(path)
    lines = _Lines(path)
    lines.expect("HIERARCHY")
    names: list[str] = []
    parents: list[int] = []
    offsets: list[list[float]] = []
    channels: list[list[str]] = []
    stack: list[int] = []
    pending: int | None = None  # the joint whose brace comes next; -1 = an end site
    for words in lines:
        match words:
            case ["ROOT" | "JOINT", *name] if name:
                if (words[0] == "ROOT") != (not names):
                    raise lines.error("one ROOT and then JOINTs are expected")
                names.append(" ".join(name))
                parents.append(stack[-1] if stack else -1)
                offsets.append([0.0, 0.0, 0.0])
                channels.append([])
                pending = len(names) - 1
            case ["End", "Site"]:
                pending = -1
            case ["{"] if pending is not None:
                stack.append(pending)
                pending = None
            case ["}"] if stack:
                stack.pop()
            case ["OFFSET", *values] if stack:
                numbers = lines.numbers(values, 3)
                if stack[-1] >= 0:
                    offsets[stack[-1]] = numbers
            case ["CHANNELS", count, *kinds] if stack and stack[-1] >= 0:
                if count != str(len(kinds)) or not set(kinds) <= {*_AXES, *_PLACES}:
                    raise lines.error(f"CHANNELS {' '.join(words[1:])} is not understood")
                channels[stack[-1]] = kinds
            case ["MOTION"] if not stack and names:
                break
            case _:
                raise lines.error(f"{' '.join(words)!r} is not expected here")
    else:
        raise lines.error("the file ends before MOTION")
    n_frames = int(lines.value("Frames:"))
    frame_s = lines.value("Frame Time:")
    if n_frames < 1 or not frame_s > 0:
        raise lines.error(f"{n_frames} frames of {frame_s} s are no motion")
    n_columns = sum(len(c) for c in channels)
    rows = []
    for words in lines:
        rows.append(lines.numbers(words, n_columns))
    if len(rows) != n_frames:
        raise lines.error(f"{n_frames} frames are announced, {len(rows)} are there")
    table = np.array(rows)
    if not np.isfinite(table).all():
        raise MocapError("the motion holds a number that is not finite", path=path, remedy="export it again")
    rotations = np.tile(np.eye(3), (n_frames, len(names), 1, 1))
    root = np.zeros((n_frames, 3))
    column = 0
    for j, kinds in enumerate(channels):
        mine = table[:, column : column + len(kinds)]
        column += len(kinds)
        turns = [i for i, k in enumerate(kinds) if k in _AXES]
        rotations[:, j] = euler_matrix("".join(_AXES[kinds[i]] for i in turns), mine[:, turns])
        for i, kind in enumerate(kinds):
            if kind in _PLACES and j == 0:
                root[:, _PLACES[kind]] = mine[:, i]
    if any(k in _PLACES for k in channels[0]):
        offsets[0] = [0.0, 0.0, 0.0]  # the channels hold the place itself
    return Recording(
        tuple(names), np.array(parents, dtype=np.int64), np.array(offsets), rotations, root, 1.0 / frame_s
    )


class _Lines:
    """The lines of a file as words, with the number of the current one for messages."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._lines = path.read_text(encoding="utf-8", errors="strict").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise MocapError(
                f"the capture cannot be read: {error}", path=path, remedy="give a BVH file"
            ) from error
        self._next = 0

    def __iter__(self) -> Iterator[list[str]]:
        while self._next < len(self._lines):
            self._next += 1
            if words := self._lines[self._next - 1].split():
                yield words

    def error(self, what: str) -> MocapError:
        return MocapError(
            f"line {self._next}: {what}", path=self._path, remedy="export the motion as BVH again"
        )

    def expect(self, word: str) -> None:
        if next(iter(self), None) != [word]:
            raise self.error(f"a BVH file begins with {word}")

    def value(self, name: str) -> float:
        words = next(iter(self), [])
        if " ".join(words[:-1]) != name:
            raise self.error(f"{name!r} is expected here")
        return self.numbers(words[-1:], 1)[0]

    def numbers(self, words: list[str], n: int) -> list[float]:
        try:
            values = [float(w) for w in words]
        except ValueError as error:
            raise self.error(f"{' '.join(words)[:60]!r} are no numbers") from error
        if len(values) != n:
            raise self.error(f"{n} numbers are expected, {len(values)} are there")
        return values
