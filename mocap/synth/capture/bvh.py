"""Reading BVH files (Biovision hierarchy) as recordings: the joints of a figure and how they turn."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from mocap.errors import MocapError
from mocap.io.formats.bvh import BvhJoint, read_bvh_motion
from mocap.synth.capture.recording import Recording, euler_matrix


def read_bvh(path: Path | str) -> Recording:
    """The joints and frames of a BVH file, in its own units and axes. End sites are left out.

    A joint other than the root may have places of its own, as where the root stays and the hips walk.
    Raises MocapError with the line for a file that cannot be read or understood, or that has no frames.
    """
    path = Path(path)
    motion = read_bvh_motion(path)
    joints = [j for j in motion.joints if not j.is_end]
    if len(motion.table) == 0:
        raise MocapError("0 frames are no motion", path=path, remedy="export the motion as BVH again")
    return Recording(
        tuple(j.name for j in joints),
        _parents(motion.joints),
        np.array([j.offset for j in joints]),
        np.stack([motion.place_in_parent(j) for j in joints], axis=1),
        np.stack([_turns(path, j, motion.table) for j in joints], axis=1),
        1.0 / motion.frame_s,
    )


def _parents(joints: tuple[BvhJoint, ...]) -> np.ndarray:
    """Parents of the joints that are no end sites, -1 for the root."""
    # Places among the joints that are kept; the parent of the root stays -1.
    place = np.cumsum([not j.is_end for j in joints]) - 1
    kept = [j for j in joints if not j.is_end]
    return np.array([place[j.parent] if j.parent >= 0 else -1 for j in kept], dtype=np.int64)


def _turns(path: Path, joint: BvhJoint, table: np.ndarray) -> np.ndarray:
    """Rotations (T, 3, 3) of one joint in its parent."""
    turns = [(k, c) for k, c in enumerate(joint.channels) if c.endswith("rotation")]
    if len(turns) > 3 or any(a[1] == b[1] for a, b in pairwise(turns)):
        raise MocapError(
            f"{joint.name} turns by {', '.join(c for _, c in turns)}; three turns about changing axes are enough",
            path=path,
            remedy="export the motion as BVH again",
        )
    columns = [joint.first_channel + k for k, _ in turns]
    return euler_matrix("".join(c[0].lower() for _, c in turns), table[:, columns])
