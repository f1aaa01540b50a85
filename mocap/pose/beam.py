"""Beam: several hypotheses of one person's pose followed through the frames; the best path is traced back at the end.

One frame of detections is often ambiguous: false ones lie closer to a marker than the true one, and left and right
change places where limbs cross. Over a few frames the wrong pose costs more, so that a handful of alternatives is
kept until then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap.body import landmarks_of
from mocap.data.problem import limbs_of
from mocap.filters import FILTERS, ParticleState, initial_particles
from mocap.pose.evidence import FrameEvidence, PersonClip
from mocap.pose.follow import Candidate, Candidates, follow
from mocap.pose.limb_search import best_of_limb
from mocap.pose.marker import Fit, MarkerClipObservation, MarkerEvidence, MarkerTools
from mocap.pose.method import BeamSettings
from mocap.pose.restart import FallenGain

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """score : nats since the start.  state, before : (D,) now and one frame ago.  parent : row in the last frame."""

    score: float
    state: Array
    before: Array | None
    parent: int
    fit: Fit | None


@dataclass(frozen=True, eq=False)
class BeamPath:
    """The best path, in the order walked.

    states : (T, D).  fits : T, None where too little was seen.  ess_share : (T,).
    ends : the hypotheses that were left after the last frame, the best first.
    """

    states: Array
    fits: tuple[Fit | None, ...]
    ess_share: Array
    ends: tuple[Hypothesis, ...]

    @property
    def is_seen(self) -> NDArray[np.bool_]:
        return np.array([fit is not None and fit.is_seen for fit in self.fits], dtype=np.bool_)

    @property
    def gain(self) -> Array:
        """Nats that each frame's pose explains, (T,); 0 where too little was seen."""
        return np.array([0.0 if fit is None else fit.gain for fit in self.fits])


def follow_beam(
    clip: PersonClip,
    order: Sequence[int],
    first: Sequence[Array],
    *,
    rng_of: Callable[[int], np.random.Generator],
    n_hypotheses: int,
    restart: Callable[[int], Sequence[Fit]] | None = None,
    tick: Callable[[], None] = lambda: None,
) -> BeamPath:
    """Follow the pose through rows `order` of a clip of detections, from the candidates `first` (D,) in the first of
    them.

    Each hypothesis goes on from where it is and from where its velocity leads; the particle filter and a search for
    one limb, another one in every frame, add candidates to the best. All are refined; those that cost least in total
    are kept. Where the detections explained fall far below the usual for some frames, or come back after a pause,
    `restart` is asked for poses found anew in that frame.
    rng_of : frame -> generator.
    Raises ValueError when there is no frame or no candidate.
    """
    if len(order) == 0 or len(first) == 0:
        raise ValueError(f"{len(order)} frames and {len(first)} candidates, expected at least one of each")
    policy = Beam(clip, first, n_hypotheses, restart)
    steps = []
    for step in follow(clip, order, policy, rng_of):
        steps.append(step)
        tick()
    return _trace_back([s.alive for s in steps], np.array([s.ess_share for s in steps]))


@dataclass(frozen=True, eq=False)
class BeamStep:
    """alive : the hypotheses after a frame, the best first.  ess_share : of the filter, nan where nothing was seen."""

    alive: list[Hypothesis]
    ess_share: float


class Beam:
    """The policy of several hypotheses, for evidence of detections. Implements `follow.Policy`."""

    def __init__(
        self,
        clip: PersonClip,
        first: Sequence[Array],
        n_hypotheses: int,
        restart: Callable[[int], Sequence[Fit]] | None,
    ) -> None:
        assert isinstance(clip.observation, MarkerClipObservation)
        self.clip, self.tools = clip, clip.observation.tools
        self.numbers = self.tools.settings.method.beam
        self._n_hypotheses, self._new_starts = n_hypotheses, restart
        self._limbs = limbs_of(self.tools.body.layout)
        self._step = FILTERS[self.tools.settings.filter.name].step
        self._filter = self.tools.filter_settings()
        # What the next frame needs.
        self._n_steps = 0
        self._alive = [Hypothesis(0.0, state, None, -1, None) for state in first]
        self._particles: ParticleState | None = None
        self._loss = FallenGain(self.numbers)

    def carry(self, row: int, evidence: FrameEvidence) -> Candidates | None:
        """Every hypothesis where it is and where its velocity leads, refined; None when none of them is seen."""
        assert isinstance(evidence, MarkerEvidence)
        self._row, self._evidence = row, evidence
        carried = [
            self._refined(Candidate(state, k))
            for k, h in enumerate(self._alive)
            for state in _next_states(self.tools, h)
        ]
        return carried if any(c.fit.is_seen for c in carried) else None

    def _refined(self, candidate: Candidate, *, wide: bool = False) -> Candidate:
        rounds = self.tools.wide if wide else self.tools.narrow
        fit = self.tools.fit(self._evidence.observation, candidate.state, rounds)
        return Candidate(fit.state, candidate.parent, -fit.cost, fit)

    def lose_sight(self, row: int) -> BeamStep:
        """Everything stays as it is."""
        self._n_steps += 1
        self._alive = [Hypothesis(h.score, h.state, None, k, None) for k, h in enumerate(self._alive)]
        self._particles = None
        self._loss.lose_sight()
        return BeamStep(self._alive, float("nan"))

    def propose(self, carried: Candidates, rng: np.random.Generator) -> Candidates:
        """The filter adds its estimate, as a continuation of the best hypothesis."""
        problem = self._evidence.search
        if self._particles is None:
            n = self._filter.n_particles
            self._particles = initial_particles(problem, self._alive[0].state, n)
        self._particles, info = self._step(problem, self._particles, self._filter, rng=rng)
        self._ess_share = float(info.ess[-1]) / len(self._particles.weights)
        return [*carried, Candidate(info.estimate)]

    def refine(self, proposed: Candidates) -> Candidates:
        """The filter's estimate refined; the carried poses are already."""
        return [c if c.fit is not None else self._refined(c) for c in proposed]

    def judge(self, refined: Candidates) -> Candidates:
        """All stay in the race until the frame is remembered."""
        return refined

    def search_limbs(self, judged: Candidates, rng: np.random.Generator) -> Candidates:
        """The best candidate with one limb searched for, another one in every frame."""
        if not self.tools.settings.look_again:
            return judged
        best = min(judged, key=lambda c: self._alive[c.parent].score + c.fit.cost)
        wide = self.tools.problem(self._evidence.observation, gate_px=self.numbers.limb_gate_px)
        limb = self._limbs[self._n_steps % len(self._limbs)]
        found = best_of_limb(wide, best.state, limb, self.numbers, rng=rng)
        return [*judged, self._refined(Candidate(found), wide=True)]

    def restart(self, searched: Candidates, rng: np.random.Generator) -> Candidates:
        """Poses found anew where too little of the detections is explained."""
        if self._new_starts is None or not self._loss.is_due(max(c.fit.gain for c in searched)):
            return searched
        new = self._new_starts(int(self.clip.frames[self._row]))
        return [*searched, *(Candidate(fit.state, 0, -fit.cost, fit) for fit in new)]

    def remember(self, settled: Candidates) -> BeamStep:
        """Keep the hypotheses that cost least and differ; feed the best one back."""
        assert self._particles is not None
        self._n_steps += 1
        self._alive = _best(self.tools, self._alive, settled, self._n_hypotheses)
        self._loss.note(max(c.fit.gain for c in settled))
        self._particles = _fed_back(self._particles, self._alive[0].state, self.numbers)
        return BeamStep(self._alive, self._ess_share)


def _next_states(tools: MarkerTools, hypothesis: Hypothesis) -> list[Array]:
    """Where a pose may be in the next frame: where it is, and where its velocity leads."""
    if hypothesis.before is None:
        return [hypothesis.state]
    layout = tools.body.layout
    furthest = tools.settings.method.beam.max_step
    step = np.clip(tools.difference(hypothesis.state, hypothesis.before), -furthest, furthest)
    return [hypothesis.state, np.clip(hypothesis.state + step, layout.lower, layout.upper)]


def _jump_nats(tools: MarkerTools, parent: Hypothesis, state: Array) -> float:
    """What it costs to come from a parent to a state (D,): half the squared step or change of step, bounded."""
    numbers = tools.settings.method.beam
    step = tools.difference(state, parent.state)
    costs = [step]
    if parent.before is not None:
        costs.append(step - tools.difference(parent.state, parent.before))
    half = [0.5 * float(np.sum((c / (numbers.jump_std * tools.noise_std)) ** 2)) for c in costs]
    return min(*half, numbers.jump_nats)


def _best(
    tools: MarkerTools, alive: Sequence[Hypothesis], tried: Sequence[Candidate], n: int
) -> list[Hypothesis]:
    """The n best continuations that differ from each other."""
    numbers = tools.settings.method.beam
    found = []
    for candidate in tried:
        k, fit = candidate.parent, candidate.fit
        parent = alive[k]
        # The candidates of the first frame are no movement.
        jump = 0.0 if parent.fit is None and parent.before is None else _jump_nats(tools, parent, fit.state)
        found.append(Hypothesis(parent.score + fit.cost + jump, fit.state, parent.state, k, fit))
    found.sort(key=lambda h: h.score)
    kept: list[Hypothesis] = []
    places: list[Array] = []
    for h in found:
        if len(kept) == n or h.score > found[0].score + numbers.worthless_nats:
            break
        place = landmarks_of(tools.body, h.state[None])[0]
        if all(np.linalg.norm(place - other, axis=1).max() > numbers.apart_m for other in places):
            kept.append(h)
            places.append(place)
    return kept


def _fed_back(particles: ParticleState, state: Array, settings: BeamSettings) -> ParticleState:
    """A share of the particles at the best pose, all with the same weight."""
    n = len(particles.weights)
    heaviest = np.argsort(-particles.weights, kind="stable")
    moved = particles.particles[heaviest].copy()
    moved[n - round(settings.feedback_share * n) :] = state
    return replace(particles, particles=moved, weights=np.full(n, 1.0 / n))


def _trace_back(history: Sequence[Sequence[Hypothesis]], ess_share: Array) -> BeamPath:
    """The path that ends in the best hypothesis."""
    path: list[Hypothesis] = []
    k = 0
    for alive in reversed(history):
        path.append(alive[k])
        k = alive[k].parent
    path.reverse()
    return BeamPath(
        states=np.array([h.state for h in path]),
        fits=tuple(h.fit for h in path),
        ess_share=ess_share,
        ends=tuple(history[-1]),
    )
