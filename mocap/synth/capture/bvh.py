"""Reading BVH files (Biovision hierarchy) as recordings: the joints of a figure and how they turn."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap.errors import MocapError
from mocap.io.formats.bvh import BvhJoint, read_bvh_motion
from mocap.synth.capture.recording import Recording, euler_matrix


def read_bvh(path: Path | str) -> Recording:
    """The joints and frames of a BVH file, in its own units and axes. End sites are left out.

    Of places only the root's are kept: the offsets of the other joints are the lengths of bones.
    Raises MocapError with the line for a file that cannot be read or understood, or that has no frames.
    """
    path = Path(path)
    motion = read_bvh_motion(path)
    joints = [j for j in motion.joints if not j.is_end]
    n_frames = len(motion.table)
    if n_frames == 0:
        raise MocapError("0 frames are no motion", path=path, remedy="export the motion as BVH again")
    # Parents by their place among the joints that are kept.
    row = {id(j): i for i, j in enumerate(joints)}
    parents = np.array([-1 if j.parent < 0 else row[id(motion.joints[j.parent])] for j in joints])
    offsets = np.array([j.offset for j in joints])
    rotations = np.stack([_turns(path, j, motion.table) for j in joints], axis=1)
    root = np.zeros((n_frames, 3))
    places = [(k, c) for k, c in enumerate(joints[0].channels) if c.endswith("position")]
    for k, channel in places:
        root[:, "XYZ".index(channel[0])] = motion.table[:, joints[0].first_channel + k]
    if places:
        offsets[0] = 0.0  # the channels hold the place itself
    return Recording(
        tuple(j.name for j in joints),
        parents.astype(np.int64),
        offsets,
        rotations,
        root,
        1.0 / motion.frame_s,
    )


def _turns(path: Path, joint: BvhJoint, table: np.ndarray) -> np.ndarray:
    """Rotations (T, 3, 3) of one joint in its parent."""
    turns = [(k, c) for k, c in enumerate(joint.channels) if c.endswith("rotation")]
    if len(turns) > 3:
        raise MocapError(
            f"{joint.name} has {len(turns)} rotations, three are enough",
            path=path,
            remedy="export the motion as BVH again",
        )
    columns = [joint.first_channel + k for k, _ in turns]
    return euler_matrix("".join(c[0].lower() for _, c in turns), table[:, columns])
