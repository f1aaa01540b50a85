"""Several hypotheses of one person's pose followed through the frames; the best path is traced back at the end.

One frame of detections is often ambiguous: false ones lie closer to a marker than the true one, and left and right
change places where limbs cross. Over a few frames the wrong pose costs more, so that a handful of alternatives is
kept until then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mocap.body import landmarks_of
from mocap.data.problem import limbs_of
from mocap.filters import FILTERS, ParticleState, initial_particles
from mocap.filters.annealing import annealed, layer_scales, next_beta
from mocap.filters.resampling import systematic
from mocap.filters.weights import normalise_log_weights
from mocap.likelihood.markers import MarkerProblem
from mocap.pipeline.marker_problem import WIDE, Fit, MarkerTools, ObservationOf

Array = NDArray[np.float64]

_JUMP_STD = 2.0  # of the filter's noise: what a pose may move between frames without much cost
_JUMP_NATS = 30.0  # what any jump costs at most; a lost limb costs as much in two or three frames
_WORTHLESS_NATS = 60.0  # hypotheses that are so much worse than the best are dropped
_APART_M = 0.06  # hypotheses are different when a landmark is this far off
_MAX_STEP = 0.25  # rad and m per frame that a pose may go on by itself
_SCOUT_GATE_PX = 20.0
_SCOUT_SAMPLES = 300
_SCOUT_PARTICLES = 100
_SCOUT_LAYERS = 3
_SCOUT_STD_RAD = 0.5
_FEEDBACK_SHARE = 0.5
_LOST_SHARE = 0.6
_LOST_FRAMES = 8
_LOST_MEMORY = 60
_AFTER_PAUSE_FRAMES = 3


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
    tools: MarkerTools,
    observation_of: ObservationOf,
    frames: Sequence[int],
    first: Sequence[Array],
    *,
    rng_of: Callable[[int], np.random.Generator],
    n_hypotheses: int,
    restart: Callable[[int], Sequence[Fit]] | None = None,
    tick: Callable[[], None] = lambda: None,
) -> BeamPath:
    """Follow the pose through frames, in the order given, from the candidates `first` (D,) in the first of them.

    Each hypothesis goes on from where it is and from where its velocity leads; the particle filter and a search for
    one limb, another one in every frame, add candidates to the best. All are refined; those that cost least in total
    are kept. Where the detections explained fall far below the usual for some frames, or come back after a pause,
    `restart` is asked for poses found anew in that frame.
    rng_of : frame -> generator.
    Raises ValueError when there is no frame or no candidate.
    """
    if len(frames) == 0 or len(first) == 0:
        raise ValueError(f"{len(frames)} frames and {len(first)} candidates, expected at least one of each")
    limbs = limbs_of(tools.body.layout)
    alive = [Hypothesis(0.0, state, None, -1, None) for state in first]
    history: list[list[Hypothesis]] = []
    ess_share = np.full(len(frames), np.nan)
    settings = tools.filter_settings()
    particles: ParticleState | None = None
    watch = _Watch()
    for i, frame in enumerate(frames):
        observation, rng = observation_of(frame), rng_of(frame)
        starts = [(k, state) for k, h in enumerate(alive) for state in _next_states(tools, h)]
        tried = [(k, tools.fit(observation, state)) for k, state in starts]
        if not any(fit.is_seen for _, fit in tried):
            # Too little to see: everything stays as it is.
            alive = [Hypothesis(h.score, h.state, None, k, None) for k, h in enumerate(alive)]
            history.append(alive)
            particles = None
            watch.lose_sight()
            tick()
            continue
        problem = tools.problem(observation)
        if particles is None:
            particles = initial_particles(problem, alive[0].state, settings.n_particles)
        particles, info = FILTERS[tools.pose.filter].step(problem, particles, settings, rng=rng)
        ess_share[i] = float(info.ess[-1]) / len(particles.weights)
        tried.append((0, tools.fit(observation, info.estimate)))
        if tools.pose.scouts:
            base = min(tried, key=lambda entry: alive[entry[0]].score + entry[1].cost)[1].state
            wide = tools.problem(observation, gate_px=_SCOUT_GATE_PX)
            found = _search_limb(wide, base, limbs[i % len(limbs)], rng=rng)
            tried.append((0, tools.fit(observation, found, WIDE)))
        if restart is not None and watch.is_due(max(fit.gain for _, fit in tried)):
            tried += [(0, fit) for fit in restart(frame)]
        alive = _best(tools, alive, tried, n_hypotheses)
        watch.note(max(fit.gain for _, fit in tried))
        history.append(alive)
        particles = _fed_back(particles, alive[0].state)
        tick()
    return _trace_back(history, ess_share)


@dataclass
class _Watch:
    """Notices that the body is lost: what the pose explains of the detections falls far below the usual."""

    n_bad: int = 0
    n_after_pause: int = -1
    gains: list[float] = field(default_factory=list)

    def lose_sight(self) -> None:
        self.n_after_pause = 0

    def is_due(self, gain: float) -> bool:
        """Whether a new start should be looked for in this frame."""
        if self.n_after_pause >= 0:
            # The first frames after a pause: a new start needs neighbours to tell true points from false ones.
            self.n_after_pause += 1
            if self.n_after_pause == _AFTER_PAUSE_FRAMES:
                self.n_after_pause = -1
                return True
        usual = float(np.median(self.gains)) if len(self.gains) >= _LOST_FRAMES else 0.0
        self.n_bad = self.n_bad + 1 if gain < _LOST_SHARE * usual else 0
        return self.n_bad > 0 and self.n_bad % _LOST_FRAMES == 0

    def note(self, gain: float) -> None:
        if self.n_bad == 0:
            self.gains.append(gain)
            del self.gains[:-_LOST_MEMORY]


def _next_states(tools: MarkerTools, hypothesis: Hypothesis) -> list[Array]:
    """Where a pose may be in the next frame: where it is, and where its velocity leads."""
    if hypothesis.before is None:
        return [hypothesis.state]
    layout = tools.body.layout
    step = np.clip(tools.difference(hypothesis.state, hypothesis.before), -_MAX_STEP, _MAX_STEP)
    return [hypothesis.state, np.clip(hypothesis.state + step, layout.lower, layout.upper)]


def _jump_nats(tools: MarkerTools, parent: Hypothesis, state: Array) -> float:
    """What it costs to come from a parent to a state (D,): half the squared step or change of step, bounded."""
    step = tools.difference(state, parent.state)
    costs = [step]
    if parent.before is not None:
        costs.append(step - tools.difference(parent.state, parent.before))
    half = [0.5 * float(np.sum((c / (_JUMP_STD * tools.noise_std)) ** 2)) for c in costs]
    return min(*half, _JUMP_NATS) if len(half) > 1 else min(half[0], _JUMP_NATS)


def _best(
    tools: MarkerTools, alive: Sequence[Hypothesis], tried: Sequence[tuple[int, Fit]], n: int
) -> list[Hypothesis]:
    """The n best continuations that differ from each other."""
    found = []
    for k, fit in tried:
        parent = alive[k]
        # The candidates of the first frame are no movement.
        jump = 0.0 if parent.fit is None and parent.before is None else _jump_nats(tools, parent, fit.state)
        found.append(Hypothesis(parent.score + fit.cost + jump, fit.state, parent.state, k, fit))
    found.sort(key=lambda h: h.score)
    kept: list[Hypothesis] = []
    places: list[Array] = []
    for h in found:
        if len(kept) == n or h.score > found[0].score + _WORTHLESS_NATS:
            break
        place = landmarks_of(tools.body, h.state[None])[0]
        if all(np.linalg.norm(place - other, axis=1).max() > _APART_M for other in places):
            kept.append(h)
            places.append(place)
    return kept


def _search_limb(
    problem: MarkerProblem, state: Array, limb: Sequence[int], *, rng: np.random.Generator
) -> Array:
    """The state (D,) with one limb where its own markers fit best, searched over its whole range.

    Source: the scout filters of CF 7.4 (DDMA-PF), here as one more candidate in every frame.
    """
    layout = problem.layout
    columns = np.flatnonzero(np.isin(layout.part_of_column, limb) & np.isfinite(layout.upper - layout.lower))
    if not len(columns):
        return state
    low, high = layout.lower[columns], layout.upper[columns]
    particles = np.tile(state, (_SCOUT_SAMPLES, 1))
    particles[:, columns] = low + rng.random((_SCOUT_SAMPLES, len(columns))) * (high - low)
    value = problem.log_likelihood(particles, parts=limb).sum(axis=1)
    best, reached = particles[value.argmax()], float(value.max())
    std = np.zeros(layout.n_columns)
    for scale in layer_scales(_SCOUT_LAYERS, 0.4):
        weights, _ = normalise_log_weights(annealed(value, next_beta(value, 0.2)))
        std[columns] = _SCOUT_STD_RAD * scale
        particles = particles[systematic(weights, _SCOUT_PARTICLES, rng=rng)]
        particles = problem.propagate(particles, std, rng=rng)
        value = problem.log_likelihood(particles, parts=limb).sum(axis=1)
        if value.max() > reached:
            best, reached = particles[value.argmax()], float(value.max())
    return best


def _fed_back(particles: ParticleState, state: Array) -> ParticleState:
    """Half of the particles at the best pose, all with the same weight."""
    n = len(particles.weights)
    heaviest = np.argsort(-particles.weights, kind="stable")
    moved = particles.particles[heaviest].copy()
    moved[n - round(_FEEDBACK_SHARE * n) :] = state
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
