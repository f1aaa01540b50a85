"""BVH, the skeleton animation of the animation tools: joint places by forward kinematics."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.errors import MocapError
from mocap.io.poses.table import PoseFile, PoseTable, text_of
from mocap.io.poses.trc import person_in_name

Array = NDArray[np.float64]

_CHANNELS = ("Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation")
_MAX_JOINTS = 2000


@dataclass
class _Joint:
    name: str
    parent: int
    offset: list[float]
    channels: list[str] = field(default_factory=list)
    first_channel: int = 0


def read_bvh(path: Path) -> PoseFile:
    """Read a BVH file: one person, the place of every joint and of every end site (`PARENT_end`).

    Channels in any order, joints with or without a position; a position replaces the OFFSET, as animation tools have
    it. BVH knows no unit and no frame numbers: frames count from 0. Up is y by custom.
    Raises MocapError for a hierarchy or a motion table that is broken.
    """
    path = Path(path)
    head, separator, motion = text_of(path).partition("MOTION")
    tokens = head.split()
    if not separator or tokens[:1] != ["HIERARCHY"]:
        raise _bad(path, "not a BVH file: HIERARCHY or MOTION is missing")
    joints = _hierarchy(path, tokens[1:])
    table, frame_time = _table(path, motion, sum(len(j.channels) for j in joints))
    frames = np.arange(len(table), dtype=np.int64)
    return PoseFile(
        path=path,
        format="BVH",
        people=(
            PoseTable(
                person_in_name(path),
                tuple(j.name for j in joints),
                frames,
                np.asarray(frames * frame_time, dtype=np.float64),
                _places(joints, table),
            ),
        ),
        fps=1.0 / frame_time,
        unit=None,
        up="y",
        notes=("BVH has no frame numbers: its first frame is taken as frame 0",),
    )


def _hierarchy(path: Path, tokens: list[str]) -> list[_Joint]:
    joints: list[_Joint] = []
    stack: list[int] = []
    i, n_channels, opened = 0, 0, -1

    def take(n: int) -> list[str]:
        nonlocal i
        if i + n > len(tokens):
            raise _bad(path, "the hierarchy ends too early")
        i += n
        return tokens[i - n : i]

    while i < len(tokens):
        (word,) = take(1)
        if word in ("ROOT", "JOINT") or (word == "End" and tokens[i : i + 1] == ["Site"]):
            # Names may hold blanks: everything up to the brace belongs to them.
            begin = i
            while i < len(tokens) and tokens[i] != "{":
                i += 1
            name = " ".join(tokens[begin:i])
            take(1)
            if word == "End":
                if not stack:
                    raise _bad(path, "an end site has no joint")
                name = f"{joints[stack[-1]].name}_end"
            if word == "ROOT" and joints:
                raise _bad(path, "the file holds two skeletons")
            if len(joints) >= _MAX_JOINTS:
                raise _bad(path, f"more than {_MAX_JOINTS} joints")
            joints.append(_Joint(name, stack[-1] if stack else -1, [0.0, 0.0, 0.0]))
            opened = len(joints) - 1
            stack.append(opened)
        elif word == "OFFSET" and stack:
            try:
                joints[stack[-1]].offset = [float(v) for v in take(3)]
                if not np.isfinite(joints[stack[-1]].offset).all():
                    raise ValueError("not finite")
            except ValueError as error:
                raise _bad(path, f"OFFSET of {joints[stack[-1]].name} is not three numbers") from error
        elif word == "CHANNELS" and stack:
            (count,) = take(1)
            names = take(int(count)) if count.isdecimal() else []
            unknown = [c for c in names if c not in _CHANNELS]
            if not count.isdecimal() or unknown:
                raise _bad(
                    path, f"CHANNELS of {joints[stack[-1]].name} are not understood: {count} {unknown}"
                )
            joints[stack[-1]].channels = names
            joints[stack[-1]].first_channel = n_channels
            n_channels += len(names)
        elif word == "}" and stack:
            stack.pop()
        else:
            raise _bad(path, f"{word!r} is not expected in the hierarchy")
    if stack or not joints:
        raise _bad(path, "the hierarchy ends too early")
    return joints


def _table(path: Path, motion: str, n_channels: int) -> tuple[Array, float]:
    lines = [line for line in motion.splitlines() if line.strip()]
    try:
        n_frames = int(lines[0].partition(":")[2])
        frame_time = float(lines[1].partition(":")[2])
    except (IndexError, ValueError) as error:
        raise _bad(path, "Frames or Frame Time is missing") from error
    if n_frames < 0 or not 0 < frame_time < np.inf:
        raise _bad(path, f"{n_frames} frames of {frame_time} s make no sense")
    try:
        values = np.array(" ".join(lines[2:]).split(), dtype=np.float64)
    except ValueError as error:
        raise _bad(path, f"the motion holds what is not a number: {error}") from error
    if not np.isfinite(values).all():
        raise _bad(path, "the motion holds a number that is not finite")
    if len(values) != n_frames * n_channels:
        raise _bad(
            path,
            f"the motion has {len(values)} numbers, expected {n_frames} frames of {n_channels} channels",
        )
    return values.reshape(n_frames, n_channels), frame_time


def _places(joints: list[_Joint], table: Array) -> Array:
    """Places of the joints by forward kinematics, (T, J, 3), in the unit and axes of the file."""
    from scipy.spatial.transform import Rotation

    T = len(table)
    place = np.zeros((T, len(joints), 3))
    turn = np.zeros((T, len(joints), 3, 3))
    for j, joint in enumerate(joints):
        local = np.broadcast_to(np.array(joint.offset), (T, 3)).copy()
        angles, axes = [], ""
        for c, name in enumerate(joint.channels, start=joint.first_channel):
            if name.endswith("position"):
                local[:, "XYZ".index(name[0])] = table[:, c]
            else:
                axes += name[0]
                angles.append(table[:, c])
        R = np.broadcast_to(np.eye(3), (T, 3, 3))
        # One axis at a time: a joint may have any number of rotations in any order.
        for axis, angle in zip(axes, angles, strict=True):
            R = R @ Rotation.from_euler(axis, angle[:, None], degrees=True).as_matrix()
        if joint.parent < 0:
            place[:, j], turn[:, j] = local, R
        else:
            p = joint.parent
            place[:, j] = place[:, p] + np.einsum("tij,tj->ti", turn[:, p], local)
            turn[:, j] = turn[:, p] @ R
    return place


def _bad(path: Path, message: str) -> MocapError:
    return MocapError(message, path=path, remedy="export the file again")
