"""Limb search: when a limb counts as lost or doubtful, and the search for it over its whole range in one frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocap.body import landmarks_of
from mocap.data import StateLayout
from mocap.data.problem import ArticulatedProblem, limbs_of
from mocap.filters.annealing import annealed, layer_scales, next_beta
from mocap.filters.resampling import systematic
from mocap.filters.scout import ScoutSettings, scout_limbs
from mocap.filters.weights import normalise_log_weights
from mocap.pose.evidence import FrameEvidence, PersonTools
from mocap.pose.method import BeamSettings, LimbSearchSettings

Array = NDArray[np.float64]


@dataclass
class LimbSchedule:
    """Which limbs are searched for though they fit: all where the evidence falls, ever more rarely while nothing is
    found; otherwise one at a time, the sooner the worse it fits.
    """

    settings: LimbSearchSettings = field(default_factory=LimbSearchSettings)
    _age: dict[int, int] = field(default_factory=dict)  # frames since a limb was looked at, by its first part
    _pause: int = 1
    _wait: int = 0
    _turn: int = 0
    _usual: float = float("nan")

    def has_fallen(self, value: float) -> bool:
        """Whether the evidence of a frame's pose lies far below the usual, nats."""
        return value < self._usual - self.settings.fallen_nats

    def due(self, value: float, misfit: dict[int, float]) -> tuple[int, ...]:
        """Limbs to search for in this frame, by their first part.

        value : evidence of the frame's pose, nats.  misfit : of every limb by its first part, nats >= 0.
        """
        numbers = self.settings
        self._wait -= 1
        self._turn -= 1
        for limb in misfit:
            self._age[limb] = self._age.get(limb, 0) + 1
        has_fallen = self.has_fallen(value)
        change = numbers.usual_rate * (value - self._usual)
        self._usual = value if np.isnan(self._usual) else self._usual + change
        if has_fallen and self._wait <= 0:
            chosen = tuple(misfit)
        elif self._turn <= 0 and misfit:
            least = numbers.least_misfit_nats
            chosen = (max(misfit, key=lambda limb: self._age[limb] * max(misfit[limb], least)),)
        else:
            chosen = ()
        if not has_fallen:
            self._pause = 1
        if chosen:
            self._turn = numbers.turn_frames
            self._age.update(dict.fromkeys(chosen, 0))
        return chosen

    def note(self, gain: float, limbs: tuple[int, ...]) -> None:
        """By how many nats a search for some limbs has raised the evidence."""
        numbers = self.settings
        if gain > numbers.find_nats:
            self._turn = 1  # a limb that was found is looked at again at once: it seldom is right at first
            self._age.update(dict.fromkeys(limbs, numbers.look_again_frames))
        if len(limbs) > 1:
            longer = min(2 * self._pause, numbers.longest_pause_frames)
            self._pause = 1 if gain > numbers.find_nats else longer
            self._wait = self._pause


def first_parts(layout: StateLayout) -> tuple[int, ...]:
    """The limbs of a body by their first part."""
    return tuple(limb[0] for limb in limbs_of(layout))


def jump_nats(tools: PersonTools, states: Sequence[Array], previous: Array | None) -> Array:
    """What it costs K states (D,) to have moved further since the pose before, `previous`, than people do, (K,) nats.

    No landmark may cost more than `pose.jump_nats`, so that a limb which was lost can come back.
    """
    if previous is None or tools.settings.jump_nats == 0:
        return np.zeros(len(states))
    numbers = tools.settings.method.limb_search
    moved = landmarks_of(tools.body, np.stack(list(states))) - landmarks_of(tools.body, previous[None])
    excess = np.linalg.norm(moved, axis=2) - numbers.free_speed_m_s / tools.fps
    return tools.settings.jump_nats * np.clip(excess / numbers.jump_m, 0.0, 1.0).sum(axis=1)


def search_limbs(
    evidence: FrameEvidence,
    state: Array,
    previous: Array | None = None,
    *,
    look_at: Sequence[int] = (),
    max_limbs: int,
    rng: np.random.Generator,
) -> Array:
    """A state (D,) with limbs searched for anew: those that fit badly, and others.

    look_at : limbs, by their first part, that are searched for though they fit: by what else speaks for another place
    (`FrameEvidence.limb_terms`). The state comes back unchanged unless the evidence grows, less the cost of a jump from
    the pose before (`jump_nats`).
    """
    numbers = evidence.tools.settings.method.limb_search
    n_alternatives = numbers.n_alternatives if len(look_at) else 0
    settings = ScoutSettings(max_limbs=max_limbs, n_alternatives=n_alternatives)
    terms = evidence.limb_terms(state) if len(look_at) else []

    def bonus(particles: Array, limb: list[int]) -> Array:
        return np.sum([term(particles, limb) for term in terms], axis=0)

    found, scouted = scout_limbs(
        evidence.search,
        state,
        settings,
        rng=rng,
        bonus=bonus if terms else None,
        look_at=look_at,
        is_drawn=evidence.tools.is_searched,
    )
    alternatives = evidence.all_refined(list(scouted.alternatives), numbers.alternative_iterations)
    candidates = [state, *alternatives]
    if scouted.accepted:
        candidates += [found, *evidence.all_refined([found])]
    if len(candidates) == 1:
        return state
    worth = evidence.evidence(candidates) - jump_nats(evidence.tools, candidates, previous)
    return candidates[int(worth.argmax())]


def best_of_limb(
    problem: ArticulatedProblem,
    state: Array,
    limb: Sequence[int],
    settings: BeamSettings,
    *,
    rng: np.random.Generator,
) -> Array:
    """The state (D,) with one limb where its own data fit best, searched over its whole range.

    Source: the scout filters of CF 7.4 (DDMA-PF), here as one more candidate in every frame.
    """
    layout = problem.layout
    columns = np.flatnonzero(np.isin(layout.part_of_column, limb) & np.isfinite(layout.upper - layout.lower))
    if not len(columns):
        return state
    low, high = layout.lower[columns], layout.upper[columns]
    particles = np.tile(state, (settings.limb_samples, 1))
    particles[:, columns] = low + rng.random((settings.limb_samples, len(columns))) * (high - low)
    value = problem.log_likelihood(particles, parts=limb).sum(axis=1)
    best, reached = particles[value.argmax()], float(value.max())
    std = np.zeros(layout.n_columns)
    for scale in layer_scales(settings.limb_layers, 0.4):
        weights, _ = normalise_log_weights(annealed(value, next_beta(value, 0.2)))
        std[columns] = settings.limb_std_rad * scale
        particles = particles[systematic(weights, settings.limb_particles, rng=rng)]
        particles = problem.propagate(particles, std, rng=rng)
        value = problem.log_likelihood(particles, parts=limb).sum(axis=1)
        if value.max() > reached:
            best, reached = particles[value.argmax()], float(value.max())
    return best
