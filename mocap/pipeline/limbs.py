"""Limbs that were lost, searched for anew in one frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mocap.body import landmarks_of
from mocap.filters import ScoutSettings, scout_limbs
from mocap.filters.scout import Bonus
from mocap.likelihood import ColourProblem, SurfaceProblem
from mocap.pipeline.pose_problem import NATS_PER_M2, FrameProblem, PoseTools

Array = NDArray[np.float64]

_UNEXPLAINED_M = 0.05
_UNEXPLAINED_SHARE = 0.025  # of the hull's surface points; loose clothes reach 0.01, a lost forearm 0.04
_SCOUT_ZEAL = 4.0
_N_LOST_POINTS = 24
_EVERY_COLOUR = 2  # of the surface points with a colour, in the search
_N_ALTERNATIVES = 4
_LONGEST_PAUSE = 8  # frames between searches that find nothing
_FALLEN_NATS = 4.0
_FIND_NATS = 1.0  # a smaller gain is no find
_USUAL_RATE = 0.2
_FREE_SPEED_M_S = 4.0
_JUMP_M = 0.25  # a jump by this much beyond the free speed costs all that a jump can cost


@dataclass
class Lookout:
    """When limbs are searched for though each of them fits: where the evidence falls, but ever more rarely while nothing
    is found.
    """

    _pause: int = 1
    _wait: int = 0
    _usual: float = float("nan")

    def is_due(self, value: float) -> bool:
        """Whether to search in this frame, whose pose has evidence value."""
        self._wait -= 1
        has_fallen = value < self._usual - _FALLEN_NATS
        self._usual = value if np.isnan(self._usual) else self._usual + _USUAL_RATE * (value - self._usual)
        if not has_fallen:
            self._pause = 1
        return has_fallen and self._wait <= 0

    def note(self, gain: float) -> None:
        """By how many nats a search has raised the evidence."""
        self._pause = 1 if gain > _FIND_NATS else min(2 * self._pause, _LONGEST_PAUSE)
        self._wait = self._pause


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

    look_at_hull : also search though every limb fits, for what of the hull is unexplained, what the colours say and
    what is usual. The state comes back unchanged unless the evidence grows, less the cost of a jump from the pose
    before (`jump_nats`).
    """
    settings = ScoutSettings(max_limbs=max_limbs, n_alternatives=_N_ALTERNATIVES if look_at_hull else 0)
    surface = frame.surface
    lost = surface.unexplained(state, _UNEXPLAINED_M)
    terms: list[Bonus] = []
    if look_at_hull and len(lost) > _UNEXPLAINED_SHARE * surface.n_points:
        terms.append(partial(_explained_nats, surface, lost))
    if look_at_hull and frame.colours is not None:
        terms.append(partial(_colour_nats, frame.colours, frame.tools.pose.colour_weight, state))
    if look_at_hull and frame.tools.pose.posture_nats > 0:
        terms.append(partial(_posture_nats, frame, float(frame.posture.departure(state[None])[0])))

    def bonus(particles: Array, limb: list[int]) -> Array:
        return np.sum([term(particles, limb) for term in terms], axis=0)

    found, scouted = scout_limbs(frame.search, state, settings, rng=rng, bonus=bonus if terms else None)
    candidates = [state, *frame.all_refined(list(scouted.alternatives), 6)]
    if scouted.accepted:
        candidates += [found, frame.refined(found)]
    if len(candidates) == 1:
        return state
    worth = frame.evidence(candidates) - jump_nats(frame.tools, candidates, previous)
    return candidates[int(worth.argmax())]


def _explained_nats(surface: SurfaceProblem, lost: Array, particles: Array, limb: list[int]) -> Array:
    """Evidence of the lost hull points (U, 3) that a limb of each particle would explain, (N,)."""
    some = lost[:: max(1, len(lost) // _N_LOST_POINTS)]
    # A lost point costs the surface term its robust limit, scale^2 / 2. The search overstates it: what it finds is
    # judged by the evidence itself.
    per_share = _SCOUT_ZEAL * NATS_PER_M2 * 0.5 * surface.settings.scale_m**2
    lost_share = len(lost) / surface.n_points
    return per_share * lost_share * surface.explained_share(some, particles, limb, _UNEXPLAINED_M)


def _colour_nats(
    colours: ColourProblem, weight: float, state: Array, particles: Array, limb: list[int]
) -> Array:
    """What the colours say for a limb of each particle, (N,), against the state (D,) they were made from."""
    return weight * colours.limb_log_ratio(state, particles, limb, every=_EVERY_COLOUR)


def _posture_nats(frame: FrameProblem, departure: float, particles: Array, limb: list[int]) -> Array:
    """What the posture of each particle speaks for it, (N,), against that of the state they were made from."""
    return frame.tools.pose.posture_nats * (departure - frame.posture.departure(particles))
