"""Writing of formats: axes, atomic files, gap-free frames, held poses."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import Motion, Skeleton
from mocap.errors import MocapError

Array = NDArray[np.float64]

# Rows of the rotation from our world (x forward, y left, z up) to the Y-up world of TRC files as Pose2Sim has them:
# file x = scene y, file y = scene z, file z = scene x.  A body in these axes faces z with its left hand at positive x,
# as glTF and BVH rigs rest.
Y_UP_FROM_WORLD: Array = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
# To the Y-up world of animation tools: file x = scene x, file y = scene z, file z = -scene y.  Programs whose z points
# up, such as Blender, undo it when they read BVH or glTF, and are then in our world.
ANIMATION_FROM_WORLD: Array = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])

# Properties of vertices in PLY files.
PLY_POSITION = "property float x\nproperty float y\nproperty float z\n"
PLY_COLOUR = "property uchar red\nproperty uchar green\nproperty uchar blue\n"


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file beside `path` that takes its place on clean exit and vanishes otherwise.

    Raises MocapError when the folder is not writable or the disk is full; an earlier file then stays as it
    was.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise MocapError(
            f"cannot write the file: {error.strerror or error}",
            remedy="check that the folder exists, is writable and has space left",
            path=path,
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def check_fps(fps: float) -> None:
    if not (np.isfinite(fps) and fps > 0):
        raise ValueError(f"fps must be a positive number, got {fps}")


def gap_free(motion: Motion, fps: float) -> Motion:
    """The motion with a row for every frame from its first to its last; new rows are NaN."""
    if len(motion) == 0 or len(motion) == motion.frames[-1] - motion.frames[0] + 1:
        return motion
    frames = np.arange(motion.frames[0], motion.frames[-1] + 1)
    rows = motion.frames - motion.frames[0]
    landmarks = np.full((len(frames), *motion.landmarks.shape[1:]), np.nan)
    landmarks[rows] = motion.landmarks
    time_s = motion.time_s[0] + (frames - frames[0]) / fps
    time_s[rows] = motion.time_s
    return Motion(motion.person, frames, time_s, landmarks)


def root_and_order(skeleton: Skeleton) -> list[int]:
    """Joint indices depth first from the root; ValueError unless the joints form one tree."""
    parents = [int(p) for p in skeleton.parents]
    n_joints = len(skeleton.names)
    if n_joints == 0 or len(parents) != n_joints:
        raise ValueError(f"skeleton has {n_joints} names and {len(parents)} parents, expected equal and > 0")
    roots = [j for j, p in enumerate(parents) if p < 0]
    if len(roots) != 1 or any(p >= j for j, p in enumerate(parents)):
        raise ValueError(f"skeleton must have one root and parents before children, got parents {parents}")
    return _depth_first(roots[0], parents)


def _depth_first(root: int, parents: list[int]) -> list[int]:
    order: list[int] = []
    stack = [root]
    while stack:
        j = stack.pop()
        order.append(j)
        stack += [k for k in reversed(range(len(parents))) if parents[k] == j]
    return order


def animated(skeleton: Skeleton) -> tuple[Array, Array, Array]:
    """What BVH and glTF want: local rotations (T, J, 3, 3), root positions (T, 3) m, and offsets at rest (J, 3) m.

    At rest the body faces z with its left hand at positive x, as rigs do; the root turns it to where it faced.
    """
    rotations, root = held_poses(skeleton)
    body = Y_UP_FROM_WORLD
    turned = body @ rotations @ body.T
    (top, *_) = root_and_order(skeleton)
    turned[:, top] = ANIMATION_FROM_WORLD @ rotations[:, top] @ body.T
    return turned, root @ ANIMATION_FROM_WORLD.T, skeleton.offsets @ body.T


def held_poses(skeleton: Skeleton) -> tuple[Array, Array]:
    """Rotations (T, J, 3, 3) and root positions (T, 3) m with unknown frames filled.

    A frame with a NaN anywhere holds the last known pose, before the first known frame the first one; without
    any it is the rest pose at the origin.
    """
    T, J = skeleton.rotations.shape[:2]
    known = np.isfinite(skeleton.rotations).all(axis=(1, 2, 3))
    known = known & np.isfinite(skeleton.root_position).all(axis=1)
    if not known.any():
        return np.broadcast_to(np.eye(3), (T, J, 3, 3)).copy(), np.zeros((T, 3))
    source = np.maximum.accumulate(np.where(known, np.arange(T), -1))
    source[source < 0] = int(np.argmax(known))
    return skeleton.rotations[source], skeleton.root_position[source]
