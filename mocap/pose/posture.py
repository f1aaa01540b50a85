"""A weak preference for usual postures, for limbs that the data hardly show."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, joint_transforms, neutral_state

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Posture:
    """How far limbs point away from where they point in the neutral pose.

    joint, parent : (L,) joints of the limbs' first parts and their parents.  axis : (L, 3) unit, along the limb in its
    joint's frame.  usual : (L, 3) unit, the same in the parent's frame in the neutral pose.
    """

    body: Body
    joint: NDArray[np.int64]
    parent: NDArray[np.int64]
    axis: Array
    usual: Array

    def departure(self, states: Array) -> Array:
        """Sum over the limbs of 1 - cos of the angle to the usual direction, for states (N, D): (N,)."""
        if len(self.joint) == 0:
            return np.zeros(len(states))
        return (1.0 - np.einsum("nlc,lc->nl", self._directions(states), self.usual)).sum(axis=1)

    def _directions(self, states: Array) -> Array:
        R, _ = joint_transforms(self.body, states)
        along = np.einsum("nlrc,lc->nlr", R[:, self.joint], self.axis)
        return np.einsum("nlrc,nlr->nlc", R[:, self.parent], along)


@lru_cache(maxsize=16)
def usual_posture(body: Body) -> Posture:
    """The neutral pose's arms and head: the first part of all that hangs on the trunk above the root.

    Legs carry the body and bend in every chair: what is usual for them depends on where the person is.
    """
    layout, cones = body.layout, body.cones
    joint, axis = [], []
    for part in range(1, layout.n_parts):
        own = np.flatnonzero(cones.part == part)
        if layout.parent_of_part[part] != 0 or not len(own):
            continue
        parent = int(body.parent[cones.joint[own[0]]])
        if parent < 0 or body.parent[parent] < 0:
            continue
        along = cones.end[own[0]] - cones.start[own[0]]
        length = float(np.linalg.norm(along))
        if length > 0:
            joint.append(int(cones.joint[own[0]]))
            axis.append(along / length)
    joints = np.array(joint, dtype=np.int64)
    parents = np.asarray(body.parent)[joints].astype(np.int64)
    axes = np.array(axis).reshape(-1, 3)
    found = Posture(body, joints, parents, axes, np.zeros_like(axes))
    if not len(joints):
        return found
    return Posture(body, joints, parents, axes, found._directions(neutral_state(body)[None])[0])
