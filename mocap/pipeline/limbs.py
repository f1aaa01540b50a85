"""Limbs that were lost, searched for anew in one frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mocap.body import landmarks_of
from mocap.data import StateLayout
from mocap.data.problem import limbs_of
from mocap.filters.scout import Bonus, ScoutSettings, scout_limbs
from mocap.likelihood.colours import ColourProblem
from mocap.likelihood.residuals import SurfaceProblem
from mocap.pipeline.pose_problem import NATS_PER_M2, FrameProblem, PoseTools

Array = NDArray[np.float64]

_UNEXPLAINED_M = 0.05
_UNEXPLAINED_SHARE = 0.025  # of the hull's surface points; loose clothes reach 0.01, a lost forearm 0.04
_SCOUT_ZEAL = 4.0
_N_LOST_POINTS = 24
_EVERY_COLOUR = 4  # of the pixels, in the search
_N_ALTERNATIVES = 6
_N_ITERATIONS = 6  # of an alternative
_LONGEST_PAUSE = 8  # frames between searches for all limbs that find nothing
_TURN_FRAMES = 4  # frames between searches for single limbs
_LEAST_MISFIT = 0.5
_LOOK_AGAIN = 10
_FALLEN_NATS = 6.0
_FIND_NATS = 1.0  # a smaller gain is no find
_USUAL_RATE = 0.2
_FREE_SPEED_M_S = 4.0
_JUMP_M = 0.25  # a jump by this much beyond the free speed costs all that a jump can cost


@dataclass
class Lookout:
    """Which limbs are searched for though they fit: all where the evidence falls, ever more rarely while nothing is
    found; otherwise one at a time, the sooner the worse it fits.
    """

    _age: dict[int, int] = field(default_factory=dict)  # frames since a limb was looked at, by its first part
    _pause: int = 1
    _wait: int = 0
    _turn: int = 0
    _usual: float = float("nan")

    def due(self, value: float, misfit: dict[int, float]) -> tuple[int, ...]:
        """Limbs to search for in this frame, by their first part.

        value : evidence of the frame's pose, nats.  misfit : of every limb by its first part, nats >= 0.
        """
        self._wait -= 1
        self._turn -= 1
        for limb in misfit:
            self._age[limb] = self._age.get(limb, 0) + 1
        has_fallen = value < self._usual - _FALLEN_NATS
        self._usual = value if np.isnan(self._usual) else self._usual + _USUAL_RATE * (value - self._usual)
        if has_fallen and self._wait <= 0:
            chosen = tuple(misfit)
        elif self._turn <= 0 and misfit:
            chosen = (max(misfit, key=lambda limb: self._age[limb] * max(misfit[limb], _LEAST_MISFIT)),)
        else:
            chosen = ()
        if not has_fallen:
            self._pause = 1
        if chosen:
            self._turn = _TURN_FRAMES
            self._age.update(dict.fromkeys(chosen, 0))
        return chosen

    def note(self, gain: float, limbs: tuple[int, ...]) -> None:
        """By how many nats a search for some limbs has raised the evidence."""
        if gain > _FIND_NATS:
            self._turn = 1  # a limb that was found is looked at again at once: it seldom is right at first
            self._age.update(dict.fromkeys(limbs, _LOOK_AGAIN))
        if len(limbs) > 1:
            self._pause = 1 if gain > _FIND_NATS else min(2 * self._pause, _LONGEST_PAUSE)
            self._wait = self._pause


def first_parts(layout: StateLayout) -> tuple[int, ...]:
    """The limbs of a body by their first part."""
    return tuple(limb[0] for limb in limbs_of(layout))


def limb_misfits(layout: StateLayout, per_part: Array) -> dict[int, float]:
    """How badly each limb fits, by its first part: nats >= 0, of its worst part.  per_part : (P,) log-likelihoods."""
    if len(per_part) != layout.n_parts:
        return {}
    return {limb[0]: max(-float(per_part[limb].min()), 0.0) for limb in limbs_of(layout)}


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
    look_at: Sequence[int] = (),
    max_limbs: int,
    rng: np.random.Generator,
) -> Array:
    """A state (D,) with limbs searched for anew: those that fit badly, and others.

    look_at : limbs, by their first part, that are searched for though they fit: by what of the hull is unexplained,
    what the colours say and what is usual. The state comes back unchanged unless the evidence grows, less the cost of a
    jump from the pose before (`jump_nats`).
    """
    settings = ScoutSettings(max_limbs=max_limbs, n_alternatives=_N_ALTERNATIVES if len(look_at) else 0)
    terms: list[Bonus] = []
    if len(look_at):
        surface = frame.surface
        lost = surface.unexplained(state, _UNEXPLAINED_M)
        if len(lost) > _UNEXPLAINED_SHARE * surface.n_points:
            terms.append(partial(_explained_nats, surface, lost))
        if frame.colours is not None:
            terms.append(_ColourNats(frame.colours, frame.tools.pose.colour_weight, state))
        if frame.tools.pose.posture_nats > 0:
            terms.append(partial(_posture_nats, frame, float(frame.posture.departure(state[None])[0])))

    def bonus(particles: Array, limb: list[int]) -> Array:
        return np.sum([term(particles, limb) for term in terms], axis=0)

    found, scouted = scout_limbs(
        frame.search, state, settings, rng=rng, bonus=bonus if terms else None, look_at=look_at
    )
    candidates = [state, *frame.all_refined(list(scouted.alternatives), _N_ITERATIONS)]
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


@dataclass
class _ColourNats:
    """What the colours say for a limb of each particle, (N,), against the state (D,) they were made from."""

    colours: ColourProblem
    weight: float
    state: Array
    _of_limb: dict[int, Callable[[Array], Array]] = field(default_factory=dict)

    def __call__(self, particles: Array, limb: list[int]) -> Array:
        if limb[0] not in self._of_limb:
            self._of_limb[limb[0]] = self.colours.limb_log_ratio(self.state, limb, _EVERY_COLOUR)
        return self.weight * self._of_limb[limb[0]](particles)


def _posture_nats(frame: FrameProblem, departure: float, particles: Array, limb: list[int]) -> Array:
    """What the posture of each particle speaks for it, (N,), against that of the state they were made from."""
    return frame.tools.pose.posture_nats * (departure - frame.posture.departure(particles))
