"""BVH, the skeleton animation that every animation tool opens: read by forward kinematics, written from a skeleton."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap.data import Skeleton
from mocap.errors import MocapError
from mocap.files import read_text
from mocap.io.formats._writing import (
    ANIMATION_FROM_WORLD,
    Y_UP_FROM_WORLD,
    animated,
    check_fps,
    root_and_order,
    write_bytes,
)
from mocap.io.formats.table import MOST, PoseFile, PoseTable, person_in_name

Array = NDArray[np.float64]
Number = TypeVar("Number", int, float)

CHANNELS = ("Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation")
# Rigs of films with faces and fingers have a few hundred; what goes beyond is no skeleton.
_MAX_JOINTS = 2000
_CM = 100.0
# From a million frames per second to one frame a day.
_SHORTEST_FRAME_S, _LONGEST_FRAME_S = 1e-6, 86_400.0
_REMEDY = "export the motion as BVH again"


@dataclass(frozen=True)
class BvhJoint:
    """One joint, or the end site of one (`PARENT_end`).

    parent : index, -1 for the root.  offset : (x, y, z) in the unit of the file.  channels : words of CHANNELS.
    first_channel : column of its first channel in the motion table.
    """

    name: str
    parent: int
    offset: tuple[float, float, float]
    channels: tuple[str, ...]
    first_channel: int
    is_end: bool


@dataclass(frozen=True, eq=False)
class BvhMotion:
    """A BVH file as it stands: joints, parents first, and the values of their channels, (T, C), degrees and lengths.

    frame_s : seconds per frame.
    """

    joints: tuple[BvhJoint, ...]
    table: Array
    frame_s: float

    def place_in_parent(self, joint: BvhJoint) -> Array:
        """Where a joint is in its parent's frame, (T, 3): its OFFSET, which positions among its channels replace."""
        place = np.tile(np.array(joint.offset), (len(self.table), 1))
        for c, name in enumerate(joint.channels, start=joint.first_channel):
            if name.endswith("position"):
                place[:, "XYZ".index(name[0])] = self.table[:, c]
        return place


def read_bvh(path: Path | str) -> PoseFile:
    """Read a BVH file: one person, the place of every joint and of every end site (`PARENT_end`).

    Channels in any order, joints with or without a position; a position replaces the OFFSET, as animation tools have
    it. BVH knows no unit and no frame numbers: frames count from 0. Up is y, and forward -z, by custom.
    Raises MocapError for a hierarchy or a motion table that is broken.
    """
    path = Path(path)
    motion = read_bvh_motion(path)
    frames = np.arange(len(motion.table), dtype=np.int64)
    return PoseFile(
        path=path,
        format="BVH",
        people=(
            PoseTable(
                person_in_name(path),
                tuple(j.name for j in motion.joints),
                frames,
                np.asarray(frames * motion.frame_s, dtype=np.float64),
                _places(motion),
            ),
        ),
        fps=1.0 / motion.frame_s,
        unit=None,
        up="y",
        world_from_file=ANIMATION_FROM_WORLD.T,
        notes=("BVH has no frame numbers: its first frame is taken as frame 0",),
    )


def read_bvh_motion(path: Path | str) -> BvhMotion:
    """Read joints and channel values of a BVH file; names may hold blanks, lines may be broken anywhere.

    Raises MocapError with the line for what is no BVH file, a broken hierarchy, and a motion table that is not as
    long as announced or holds what is no finite number.
    """
    path = Path(path)
    words = _Words(path, read_text(path))
    if words.take() != "HIERARCHY":
        raise words.error("not a BVH file: it does not begin with HIERARCHY")
    joints = _Hierarchy(words).read()
    table, frame_s = _table(words, sum(len(j.channels) for j in joints))
    return BvhMotion(joints, table, frame_s)


class _Words:
    """The words of a text one after the other, with the number of their line for messages."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self.lines = text.splitlines()
        self.line = 0
        self._words: list[str] = []

    def peek(self) -> str | None:
        """The next word; None at the end."""
        while not self._words and self.line < len(self.lines):
            self._words = self.lines[self.line].split()[::-1]
            self.line += 1
        return self._words[-1] if self._words else None

    def take(self) -> str | None:
        word = self.peek()
        if word is not None:
            self._words.pop()
        return word

    def needed(self, n: int) -> list[str]:
        """The next n words; MocapError when the text ends before."""
        found = []
        for _ in range(n):
            if (word := self.take()) is None:
                raise self.error("the hierarchy ends too early")
            found.append(word)
        return found

    def rest(self) -> list[tuple[int, str]]:
        """(number, text) of the lines that are not empty, from the next word on."""
        first = [(self.line, " ".join(self._words[::-1]))] if self._words else []
        later = [(i + 1, t) for i, t in enumerate(self.lines[self.line :], start=self.line) if t.strip()]
        return first + later

    def error(self, what: str, line: int | None = None) -> MocapError:
        number = max(self.line, 1) if line is None else line
        return MocapError(f"line {number}: {what}", path=self.path, remedy=_REMEDY)


class _Hierarchy:
    """The joints of a file while they are read, up to the word MOTION."""

    def __init__(self, words: _Words) -> None:
        self._words = words
        self._joints: list[BvhJoint] = []
        self._stack: list[int] = []
        self._n_channels = 0

    def read(self) -> tuple[BvhJoint, ...]:
        inside: dict[str, Callable[[], Any]] = {
            "OFFSET": self._offset,
            "CHANNELS": self._channels,
            "}": self._stack.pop,
        }
        while (word := self._words.take() or "") not in ("", "MOTION"):
            if word in ("ROOT", "JOINT", "End"):
                self._open(word)
            elif word in inside and self._stack:
                inside[word]()
            else:
                raise self._words.error(f"{word!r} is not expected in the hierarchy")
        if not word or self._stack or not self._joints:
            raise self._words.error("the hierarchy ends too early, or MOTION is missing")
        return tuple(self._joints)

    def _open(self, word: str) -> None:
        name_words = []
        # Names may hold blanks: everything up to the brace belongs to them.
        while self._words.peek() not in ("{", None):
            name_words += self._words.needed(1)
        self._words.needed(1)
        name = " ".join(name_words)
        parent = self._stack[-1] if self._stack else -1
        if word == "End":
            if parent < 0 or name != "Site":
                raise self._words.error("an end site has no joint")
            name = f"{self._joints[parent].name}_end"
        if (word == "ROOT") != (not self._joints):
            raise self._words.error("one ROOT and then JOINTs are expected: a file holds one skeleton")
        if len(self._joints) >= _MAX_JOINTS:
            raise self._words.error(f"more than {_MAX_JOINTS} joints")
        self._joints.append(BvhJoint(name, parent, (0.0, 0.0, 0.0), (), self._n_channels, word == "End"))
        self._stack.append(len(self._joints) - 1)

    def _offset(self) -> None:
        joint = self._joints[self._stack[-1]]
        try:
            x, y, z = (float(v) for v in self._words.needed(3))
        except ValueError as error:
            raise self._words.error(f"OFFSET of {joint.name} is not three numbers") from error
        if not max(abs(x), abs(y), abs(z)) <= MOST or not np.isfinite((x, y, z)).all():
            raise self._words.error(f"OFFSET of {joint.name} is not three numbers of a body")
        self._replace(joint, offset=(x, y, z))

    def _channels(self) -> None:
        joint = self._joints[self._stack[-1]]
        if joint.channels:
            raise self._words.error(f"CHANNELS of {joint.name} are given twice")
        (count,) = self._words.needed(1)
        # Nine digits are more than any file has words.
        is_count = count.isdecimal() and len(count) < 10
        names = self._words.needed(int(count)) if is_count else []
        unknown = [c for c in names if c not in CHANNELS]
        if not is_count or unknown:
            raise self._words.error(f"CHANNELS of {joint.name} are not understood: {count} {unknown}")
        self._replace(joint, channels=tuple(names), first_channel=self._n_channels)
        self._n_channels += len(names)

    def _replace(self, joint: BvhJoint, **changes: Any) -> None:
        self._joints[self._stack[-1]] = replace(joint, **changes)


def _table(words: _Words, n_channels: int) -> tuple[Array, float]:
    lines = words.rest()
    n_frames = _announced(words, lines[:1], "Frames:", int)
    frame_s = _announced(words, lines[1:2], "Frame Time:", float)
    if n_frames < 0 or not _SHORTEST_FRAME_S <= frame_s <= _LONGEST_FRAME_S:
        raise words.error(f"{n_frames} frames of {frame_s} s make no sense", lines[0][0])
    rows = lines[2:]
    try:
        values = np.array(" ".join(text for _, text in rows).split(), dtype=np.float64)
    except ValueError as error:
        raise words.error(f"the motion holds what is not a number: {error}", rows[0][0]) from error
    if not np.isfinite(values).all():
        raise words.error("the motion holds a number that is not finite", rows[0][0])
    if np.abs(values).max(initial=0.0) > MOST:
        raise words.error(f"the motion holds {np.abs(values).max():.3g}, which no motion reaches", rows[0][0])
    if len(values) != n_frames * n_channels:
        odd = next((i for i, text in rows if len(text.split()) != n_channels), lines[0][0])
        raise words.error(
            f"the motion has {len(values)} numbers, expected {n_frames} frames of {n_channels} channels", odd
        )
    return values.reshape(n_frames, n_channels), frame_s


def _announced(words: _Words, line: list[tuple[int, str]], key: str, kind: Callable[[str], Number]) -> Number:
    """The number behind `key` in a line; MocapError when the line says something else."""
    number, text = line[0] if line else (len(words.lines), "")
    name, _, value = text.partition(":")
    if f"{' '.join(name.split())}:".lower() != key.lower():
        raise words.error(f"{key!r} is expected: Frames or Frame Time is missing", number)
    try:
        return kind(value)
    except ValueError as error:
        raise words.error(f"{key!r} is followed by {value.strip()[:40]!r}, not a number", number) from error


def _places(motion: BvhMotion) -> Array:
    """Places of the joints by forward kinematics, (T, J, 3), in the unit and axes of the file."""
    from scipy.spatial.transform import Rotation

    T, J = len(motion.table), len(motion.joints)
    place = np.zeros((T, J, 3))
    turn = np.zeros((T, J, 3, 3))
    for j, joint in enumerate(motion.joints):
        local = motion.place_in_parent(joint)
        R = np.broadcast_to(np.eye(3), (T, 3, 3))
        for c, name in enumerate(joint.channels, start=joint.first_channel):
            if name.endswith("rotation"):
                # One axis at a time: a joint may have any number of rotations in any order.
                R = R @ Rotation.from_euler(name[0], motion.table[:, c, None], degrees=True).as_matrix()
        if joint.parent < 0:
            place[:, j], turn[:, j] = local, R
        else:
            p = joint.parent
            place[:, j] = place[:, p] + np.einsum("tij,tj->ti", turn[:, p], local)
            turn[:, j] = turn[:, p] @ R
    return place


def write_bvh(path: Path, skeleton: Skeleton, fps: float) -> None:
    """Write an animated skeleton as BVH in centimetres, Y up, Euler order Z X Y.

    The rest pose is the skeleton's own, facing +Z with the left side at +X; places are those of our world with Y up,
    so that Blender shows them where they were (file x, -z, y are scene x, y, z). A joint's rotation is
    Rz(z) Rx(x) Ry(y) with the channels in that order; the root also has its absolute position. Angles run on
    over 180 degrees so that curves have no jumps. A frame with a NaN holds the last known pose.
    Raises ValueError for fps <= 0 or joints that are not one tree, MocapError when the file cannot be
    written.
    """
    check_fps(fps)
    order = root_and_order(skeleton)
    rotations, root, _ = animated(skeleton)
    angles = _zxy_degrees(rotations)
    columns = [_CM * root, *(angles[:, j] for j in order)]
    table = np.concatenate(columns, axis=1)

    lines = ["HIERARCHY", *_hierarchy(skeleton, order[0], 0)]
    lines += ["MOTION", f"Frames: {len(table)}", f"Frame Time: {1.0 / fps:.8f}"]
    # Adding zero turns -0.0 into 0.0: equal poses must give equal bytes.
    lines += [" ".join(f"{value:.6f}" for value in row) for row in np.round(table, 6) + 0.0]
    write_bytes(path, ("\n".join(lines) + "\n").encode("utf-8"))


def _hierarchy(skeleton: Skeleton, joint: int, depth: int) -> list[str]:
    """Text of one joint and everything below it."""
    pad, inner = "\t" * depth, "\t" * (depth + 1)
    is_root = depth == 0
    # The root's channels hold its absolute position, to which some readers add the OFFSET: it must be zero.
    offset = np.zeros(3) if is_root else skeleton.offsets[joint]
    channels = "6 Xposition Yposition Zposition" if is_root else "3"
    lines = [
        f"{pad}{'ROOT' if is_root else 'JOINT'} {skeleton.names[joint].replace(' ', '_')}",
        f"{pad}{{",
        f"{inner}{_offset(offset)}",
        f"{inner}CHANNELS {channels} Zrotation Xrotation Yrotation",
    ]
    children = [k for k, p in enumerate(skeleton.parents) if int(p) == joint]
    for child in children:
        lines += _hierarchy(skeleton, child, depth + 1)
    if not children:
        end = skeleton.end_offsets.get(joint, np.zeros(3))
        lines += [f"{inner}End Site", f"{inner}{{", f"{inner}\t{_offset(end)}", f"{inner}}}"]
    return [*lines, f"{pad}}}"]


def _offset(offset_m: Array) -> str:
    x, y, z = np.round(_CM * Y_UP_FROM_WORLD @ np.asarray(offset_m, dtype=np.float64), 6) + 0.0
    return f"OFFSET {x:.6f} {y:.6f} {z:.6f}"


def _zxy_degrees(rotations: Array) -> Array:
    """Euler angles (T, J, 3) in degrees, order z, x, y, of R = Rz Rx Ry; (T, J, 3, 3) in."""
    from scipy.spatial.transform import Rotation

    T, J = rotations.shape[:2]
    if T == 0:
        return np.zeros((0, J, 3))
    with warnings.catch_warnings():
        # At x = +-90 degrees z and y are one; SciPy then sets one of them to zero, which is a right answer.
        warnings.filterwarnings("ignore", message="Gimbal lock")
        angles = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_euler("ZXY")
    return np.degrees(np.unwrap(angles.reshape(T, J, 3), axis=0))
