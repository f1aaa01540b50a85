"""Forward kinematics: joint transforms, landmarks and flesh of a state."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.body._kernels import Chain, ConeArrays, place_cones, points_and_derivatives, transforms_kernel
from mocap.body.model import Body
from mocap.data.skeleton import Skeleton
from mocap.geometry.rigid import matrix_from_twist

# Height of a unit vector at 75 degrees: who sits down or rises bends his pelvis by 60 and more (decision 124).
_LEVEL = 0.966


def joint_transforms(body: Body, states: Array) -> tuple[Array, Array]:
    """World transforms of every joint frame.

    states : (N, D). Returns R (N, J, 3, 3) and t (N, J, 3) m with x_world = R x_joint + t.
    Source: CF Eq. 6.1.
    """
    s = np.ascontiguousarray(states, dtype=np.float64)
    if s.ndim != 2 or s.shape[1] != body.layout.n_columns:
        raise ValueError(f"states has shape {s.shape}, expected (N, {body.layout.n_columns})")
    R = np.empty((len(s), len(body.joints), 3, 3))
    t = np.empty((len(s), len(body.joints), 3))
    transforms_kernel(s, body.chain, R, t)
    return R, t


def transforms_by_exponentials(body: Body, state: Array) -> tuple[Array, Array]:
    """The same for one state (D,) as products of exponentials of twists, the way CF writes it; slow.

    Every rotation is a twist about the joint's position in the rest pose; the chain's twists are multiplied
    from the root outwards (their order matters, reading guide 18).
    Source: CF Eq. A.10.
    """
    J = len(body.joints)
    rest = np.zeros((J, 3))
    for j in range(J):
        p = int(body.parent[j])
        rest[j] = body.offset[j] + (rest[p] if p >= 0 else 0.0)
    product = np.zeros((J, 4, 4))
    for j in range(J):
        p = int(body.parent[j])
        T = np.eye(4) if p < 0 else product[p].copy()
        if p < 0:
            T[:3, 3] = state[:3]
        for d in np.flatnonzero(body.dof_joint == j):
            axis = np.eye(3)[body.dof_axis[d]]
            T = T @ matrix_from_twist(axis, rest[j], float(state[body.dof_column[d]]))
        product[j] = T
    R = product[:, :3, :3]
    t = np.einsum("jrc,jc->jr", R, rest) + product[:, :3, 3]
    return R, t


def landmarks_of(body: Body, states: Array) -> Array:
    """Landmarks of states: (N, D) -> (N, M, 3) m, world, in the order of `Body.landmarks`.  Source: CF Eq. A.14."""
    R, t = joint_transforms(body, states)
    j = body.landmark_joint
    return np.einsum("nlrc,lc->nlr", R[:, j], body.landmark_offset) + t[:, j]


def facing_of(body: Body, states: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Direction over the floor in which the pelvis of states (N, D) faces, (N,) rad, and whether it faces a wall, (N,),
    rather than floor or ceiling."""
    front = joint_transforms(body, states)[0][:, 0, :, 0]
    return np.arctan2(front[:, 1], front[:, 0]), np.abs(front[:, 2]) < _LEVEL


def cones_of(body: Body, state: Array) -> tuple[Array, Array]:
    """End points of the flesh cones in one pose.  state : (D,). Returns start, end, each (K, 3) m, world."""
    R, t = joint_transforms(body, np.asarray(state, dtype=np.float64)[None])
    Rk, tk = R[0, body.cones.joint], t[0, body.cones.joint]
    start = np.einsum("krc,kc->kr", Rk, body.cones.start) + tk
    end = np.einsum("krc,kc->kr", Rk, body.cones.end) + tk
    return start, end


def distance_of_lines(body: Body, ends: tuple[Array, Array], origins: Array, directions: Array) -> Array:
    """How far lines pass outside every flesh cone, (N, K) m, negative through it.

    ends : of the cones, as `cones_of` has them.  origins : (3,) or (N, 3) m.  directions : (N, 3), unit length.
    """
    sight = directions[:, None]
    # Seen along a line it is a point, and the axes are segments in a plane.
    a, b = (one[None] - np.reshape(origins, (-1, 1, 3)) for one in ends)
    a = a - (a * sight).sum(axis=2, keepdims=True) * sight
    b = b - (b * sight).sum(axis=2, keepdims=True) * sight
    ab = b - a
    share = np.clip(-(a * ab).sum(axis=2) / np.maximum((ab * ab).sum(axis=2), 1e-12), 0.0, 1.0)
    radii = body.cones.radii
    own_radius = (1.0 - share) * radii[:, 0] + share * radii[:, 1]
    return np.asarray(np.linalg.norm(a + share[:, :, None] * ab, axis=2) - own_radius)


@lru_cache(maxsize=64)
def _cones_on(body: Body, parts: tuple[int, ...]) -> NDArray[np.bool_]:
    return np.isin(body.cones.part, parts)


def cones_on(body: Body, parts: Sequence[int]) -> NDArray[np.bool_]:
    """Which flesh cones are those of some parts, (K,). Kept and shared: not to be written to."""
    return _cones_on(body, tuple(parts))


def cones_of_particles(body: Body, states: Array, which: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Ends of some of the flesh cones of states (N, D): start and end (N, K', 3) m, world.  which : (K,) bool."""
    s = np.ascontiguousarray(states, dtype=np.float64)
    chain, cones = _branch(body, tuple(np.flatnonzero(which).tolist()))
    start, end = np.empty((len(s), len(cones.joint), 3)), np.empty((len(s), len(cones.joint), 3))
    place_cones(s, chain, cones, start, end)
    return start, end


@lru_cache(maxsize=64)
def _branch(body: Body, which: tuple[int, ...]) -> tuple[Chain, ConeArrays]:
    """Some cones of a body with no more joints than move them."""
    rows, cones = np.array(which, dtype=np.int64), body.cones
    needed: set[int] = set()
    for joint in cones.joint[rows].tolist():
        while joint >= 0 and joint not in needed:
            needed.add(joint)
            joint = int(body.parent[joint])
    joints = np.array(sorted(needed), dtype=np.int64)
    number = np.full(len(body.joints) + 1, -1, dtype=np.int64)  # the last one is nobody's, the root's parent
    number[joints] = np.arange(len(joints))
    dofs = np.isin(body.dof_joint, joints)
    chain = Chain(
        number[body.parent[joints]],
        body.offset[joints],
        number[body.dof_joint[dofs]],
        body.dof_axis[dofs],
        body.dof_column[dofs],
    )
    own = ConeArrays(
        cones.start[rows], cones.end[rows], cones.radii[rows], number[cones.joint[rows]], cones.part[rows]
    )
    return chain, own


def point_jacobian(
    body: Body, state: Array, joint: NDArray[np.int64], offset: Array
) -> tuple[Array, Array, Array]:
    """Points offset (K, 3) m on joints (K,) at a state (D,): their places (K, 3) m, world, the derivatives (K, 3, D) of
    these by the state, and the rotations (J, 3, 3) of all joints."""
    J, K = len(body.joints), len(joint)
    R, t, points = np.empty((J, 3, 3)), np.empty((J, 3)), np.empty((K, 3))
    derivatives = np.zeros((K, 3, body.layout.n_columns))
    points_and_derivatives(
        np.ascontiguousarray(state, dtype=np.float64),
        body.arrays,
        np.ascontiguousarray(joint, dtype=np.int64),
        np.ascontiguousarray(offset, dtype=np.float64),
        R,
        t,
        points,
        derivatives,
    )
    return points, derivatives, R


def neutral_state(body: Body) -> Array:
    """A relaxed standing pose: legs straight, arms hanging, facing +x, root at hip height.  Returns (D,)."""
    state = np.zeros(body.layout.n_columns)
    for name, value in (
        ("right_shoulder_x", 1.40),
        ("left_shoulder_x", -1.40),
        ("right_elbow_z", 0.25),
        ("left_elbow_z", -0.25),
    ):
        if name in body.layout.names:
            state[body.layout.names.index(name)] = value
    ends = cones_of(body, state)
    lowest = min(float((e[:, 2] - body.cones.radii[:, i]).min()) for i, e in enumerate(ends))
    state[2] = -lowest
    return np.clip(state, body.layout.lower, body.layout.upper)


def skeleton_of(body: Body, states: Array, person: int) -> Skeleton:
    """The states as an animated skeleton for export.  states : (T, D)."""
    R, t = joint_transforms(body, states)
    local = R.copy()
    for j in range(len(body.joints)):
        p = int(body.parent[j])
        if p >= 0:
            local[:, j] = np.einsum("trc,trk->tck", R[:, p], R[:, j])
    leaves = set(range(len(body.joints))) - {int(p) for p in body.parent}
    ends: dict[int, Array] = {}
    for leaf in leaves:
        tips = body.cones.end[body.cones.joint == leaf]
        landmark_tips = body.landmark_offset[body.landmark_joint == leaf]
        candidates = np.concatenate([tips, landmark_tips]) if len(tips) else landmark_tips
        if len(landmark_tips) and np.linalg.norm(landmark_tips, axis=1).max() > 0:
            candidates = landmark_tips  # ankles, wrists, top of the head: what people know by name
        ends[leaf] = candidates[np.argmax(np.linalg.norm(candidates, axis=1))]
    return Skeleton(
        person=person,
        names=body.joints,
        parents=body.parent.copy(),
        offsets=body.offset.copy(),
        end_offsets=ends,
        rotations=local,
        root_position=t[:, 0].copy(),
    )
