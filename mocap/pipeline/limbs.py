"""Limbs that were lost, searched for anew in one frame."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, joint_transforms, landmarks_of
from mocap.filters import ScoutSettings, scout_limbs
from mocap.likelihood import SurfaceFitSettings
from mocap.pipeline.pose_problem import NATS_PER_M2, FrameProblem, PoseTools

Array = NDArray[np.float64]

_UNEXPLAINED_M = 0.05
_UNEXPLAINED_SHARE = 0.025  # of the hull's surface points; loose clothes reach 0.01, a lost forearm 0.04
_SCOUT_ZEAL = 4.0
_FREE_SPEED_M_S = 4.0
_JUMP_M = 0.25  # a jump by this much beyond the free speed costs all that a jump can cost


def jump_nats(tools: PoseTools, states: Sequence[Array], previous: Array | None) -> Array:
    """What it costs K states (D,) to have moved further since the pose before, `previous`, than people do, (K,) nats.

    No landmark may cost more than `pose.jump_nats`, so that a limb which was lost can come back.
    """
    if previous is None or tools.pose.jump_nats == 0:
        return np.zeros(len(states))
    moved = landmarks_of(tools.body, np.stack(list(states))) - landmarks_of(tools.body, previous[None])
    excess = np.linalg.norm(moved, axis=2) - _FREE_SPEED_M_S / tools.fps
    return tools.pose.jump_nats * np.clip(excess / _JUMP_M, 0.0, 1.0).sum(axis=1)


def recover_limbs(
    frame: FrameProblem,
    state: Array,
    previous: Array | None = None,
    *,
    look_at_hull: bool,
    max_limbs: int,
    rng: np.random.Generator,
) -> Array:
    """A state (D,) with limbs searched for anew that fit badly or leave a piece of the hull unexplained.

    look_at_hull : also search when much of the hull's surface is unexplained though every limb fits. The state comes
    back unchanged unless the evidence grows, less the cost of a jump from the pose before (`jump_nats`).
    """
    settings = ScoutSettings(max_limbs=max_limbs)
    surface = frame.surface
    lost = surface.unexplained(state, _UNEXPLAINED_M)
    bonus = None
    if look_at_hull and len(lost) > _UNEXPLAINED_SHARE * surface.n_points:
        bonus = partial(_explained_nats, frame.tools.body, lost, len(lost) / surface.n_points)
    found, scouted = scout_limbs(frame.voxels, state, settings, rng=rng, bonus=bonus)
    if not scouted.accepted:
        return state
    candidates = [state, found, frame.refined(found)]
    worth = frame.evidence(candidates) - jump_nats(frame.tools, candidates, previous)
    return candidates[int(worth.argmax())]


def _explained_nats(body: Body, lost: Array, lost_share: float, particles: Array, limb: list[int]) -> Array:
    """Evidence of the lost hull points (U, 3) that a limb of each particle would explain, (N,)."""
    some = lost[:: max(1, len(lost) // 24)]
    rows = np.flatnonzero(np.isin(body.cones.part, limb))
    R, t = joint_transforms(body, particles)
    joint = body.cones.joint[rows]
    start = np.einsum("nkrc,kc->nkr", R[:, joint], body.cones.start[rows]) + t[:, joint]
    axis = np.einsum("nkrc,kc->nkr", R[:, joint], body.cones.end[rows] - body.cones.start[rows])
    offset = some[None, None] - start[:, :, None]
    along = np.einsum("nkuc,nkc->nku", offset, axis) / np.maximum((axis**2).sum(axis=2), 1e-12)[:, :, None]
    foot = np.clip(along, 0.0, 1.0)[..., None] * axis[:, :, None]
    reach = body.cones.radii[rows].mean(axis=1) + _UNEXPLAINED_M
    near = (((offset - foot) ** 2).sum(axis=3) < (reach**2)[None, :, None]).any(axis=1)
    # A lost point costs the surface term its robust limit, scale^2 / 2. The search overstates it: what it finds is
    # judged by the evidence itself.
    per_share = _SCOUT_ZEAL * NATS_PER_M2 * 0.5 * SurfaceFitSettings().scale_m ** 2
    return per_share * lost_share * near.mean(axis=1)
