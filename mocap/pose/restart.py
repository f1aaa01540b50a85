"""Restart: when a whole pose counts as lost, and the search for a new one.

Two rules of loss stand side by side until a measurement decides: volumes ask whether the evidence has fallen below the
usual, detections whether too few of them are explained for some frames.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocap.body import candidate_states
from mocap.body.kinematics import facing_of
from mocap.filters import initial_particles
from mocap.filters.apf import ApfSettings
from mocap.pose.method import BeamSettings, RestartSettings
from mocap.pose.start import PoseSearch

Array = NDArray[np.float64]


@dataclass
class FallenEvidence:
    """A pose is lost when its evidence has fallen far below what this person's poses usually reach, or when it faces
    against the way that the person goes.

    best_state is the latest pose that was good; a failed restart doubles the pause before the next. `_lead` is what
    the pose has gained, nats, wherever one that faces the other way was tried.
    """

    settings: RestartSettings = field(default_factory=RestartSettings)
    best_state: Array | None = None
    _values: list[float] = field(default_factory=list)
    _next: int | None = None
    _pause: int = -1
    _lead: float = 0.0

    def __post_init__(self) -> None:
        self._pause = self.settings.shortest_pause_frames

    @property
    def usual(self) -> float:
        """The evidence that poses usually reach, nats; -inf while nothing is usual."""
        if len(self._values) < self.settings.after_frames:
            return -np.inf
        return float(np.quantile(self._values, self.settings.usual_quantile))

    def is_due(self, row: int, value: float, *, is_backwards: bool) -> bool:
        """Whether row's pose is lost and the last attempt lies far enough back.  is_backwards : against the walk."""
        waited = self._next is None or abs(row - self._next) >= self._pause
        return waited and (is_backwards or value < self.usual - self.settings.lost_nats)

    def settle(
        self, row: int, value: float, restarted: float, *, likelier: float = 0.0, is_turned: bool = False
    ) -> bool:
        """Whether a new pose is taken.

        value, restarted : evidence of the pose and of the new one.  likelier : nats that the new one is worth more
        beforehand.  is_turned : it faces the other way. Nobody turns about in a frame: what earlier frames said of the
        two ways counts as well, and what is likely beforehand counts once.
        """
        self._next = row
        gain = restarted - value
        is_better = gain + likelier - (self._lead if is_turned else 0.0) > self.settings.margin_nats
        if is_turned:
            lead = min(max(self._lead - gain, 0.0), self.settings.most_lead_nats)
            self._lead = 0.0 if is_better else lead
        longer = min(2 * self._pause, self.settings.longest_pause_frames)
        self._pause = self.settings.shortest_pause_frames if is_better else longer
        return is_better

    def note(self, state: Array, value: float) -> None:
        """Remember the evidence of a frame's pose (D,)."""
        if value >= self.usual - 0.5 * self.settings.lost_nats:
            self.best_state = state
        self._values.append(value)
        del self._values[: -self.settings.memory_frames]


@dataclass
class FallenGain:
    """A pose is lost when what it explains of the detections falls far below the usual for some frames, or when
    detections come back after a pause."""

    settings: BeamSettings = field(default_factory=BeamSettings)
    n_bad: int = 0
    n_after_pause: int = -1
    gains: list[float] = field(default_factory=list)

    def lose_sight(self) -> None:
        """Nothing was seen in a frame."""
        self.n_after_pause = 0

    def is_due(self, gain: float) -> bool:
        """Whether a new start should be looked for in this frame."""
        numbers = self.settings
        if self.n_after_pause >= 0:
            # The first frames after a pause: a new start needs neighbours to tell true points from false ones.
            self.n_after_pause += 1
            if self.n_after_pause == numbers.after_pause_frames:
                self.n_after_pause = -1
                return True
        usual = float(np.median(self.gains)) if len(self.gains) >= numbers.lost_frames else 0.0
        self.n_bad = self.n_bad + 1 if gain < numbers.lost_share * usual else 0
        return self.n_bad > 0 and self.n_bad % numbers.lost_frames == 0

    def note(self, gain: float) -> None:
        """Remember what a frame's pose explains."""
        if self.n_bad == 0:
            self.gains.append(gain)
            del self.gains[: -self.settings.memory_frames]


def restarted_pose(
    search: PoseSearch, state: Array, good: Array | None, *, rng: np.random.Generator
) -> Array:
    """A new pose for a lost body: from the last good pose and from usual poses, moved to where the body is now.

    Where it is and which way it faces are taken from the lost state (D,), whose trunk and head are kept longest,
    unless the person walks another way.
    """
    numbers = search.settings.method.restart
    body = search.body
    yaw = body.yaw_column
    facing = 0.0 if yaw is None else float(facing_of(body, state[None])[0][0])
    if search.heading is not None and np.cos(facing - search.heading) < numbers.facing_cosine:
        facing = search.heading
    starts, _ = candidate_states(body, search.evidence.places, np.array([facing]))
    states = [*starts, state]
    if good is not None:
        moved = good.copy()
        moved[:3] = state[:3]
        if yaw is not None:
            moved[yaw] += facing - float(facing_of(body, good[None])[0][0])
        states.append(moved)
    problem = search.evidence.search
    std = numbers.std_factor * search.std
    brief = ApfSettings(
        n_layers=numbers.brief_layers,
        n_particles=numbers.brief_particles,
        std=std,
        survival_rate=numbers.brief_survival_rate,
    )
    thorough = ApfSettings(
        n_layers=numbers.thorough_layers,
        n_particles=numbers.thorough_particles,
        std=std,
        survival_rate=numbers.thorough_survival_rate,
    )
    tried = search.attempts(
        [(initial_particles(problem, s, 2), "") for s in states], brief, is_brief=True, rng=rng
    )
    tried.sort(key=lambda found: -found.log_likelihood)
    settled = search.attempts(
        [(initial_particles(problem, f.state, 2), "") for f in tried[: numbers.n_settled]],
        thorough,
        is_brief=False,
        rng=rng,
    )
    best = max(settled, key=lambda found: found.log_likelihood)
    return search.with_limbs_searched(best, rng=rng).state
