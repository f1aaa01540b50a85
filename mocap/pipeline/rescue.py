"""When a whole pose counts as lost, and how a new one is found."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocap.body import candidate_states
from mocap.filters import initial_particles
from mocap.filters.apf import ApfSettings
from mocap.pipeline.first_pose import PoseSearch, yaw_column

Array = NDArray[np.float64]

_LOST_NATS = 12.0
_RESCUE_MARGIN_NATS = 4.0
_RESCUE_AFTER = 8
_RESCUE_MEMORY = 90


@dataclass
class Rescue:
    """When a pose counts as lost: its evidence has fallen far below what this person's poses usually reach.

    best_state is the latest pose that was good; a failed rescue doubles the pause before the next.
    """

    best_state: Array | None = None
    _values: list[float] = field(default_factory=list)
    _next: int | None = None
    _pause: int = 2

    @property
    def usual(self) -> float:
        return float(np.quantile(self._values, 0.6)) if len(self._values) >= _RESCUE_AFTER else -np.inf

    def is_due(self, row: int, value: float) -> bool:
        """Whether row's pose is lost and the last attempt lies far enough back."""
        waited = self._next is None or abs(row - self._next) >= self._pause
        return value < self.usual - _LOST_NATS and waited

    def settle(self, row: int, value: float, saved: float) -> bool:
        """Whether a rescued pose is taken."""
        self._next = row
        is_better = saved > value + _RESCUE_MARGIN_NATS
        self._pause = 2 if is_better else min(2 * self._pause, 32)
        return is_better

    def note(self, state: Array, value: float) -> None:
        if value >= self.usual - 0.5 * _LOST_NATS:
            self.best_state = state
        self._values.append(value)
        del self._values[:-_RESCUE_MEMORY]


def rescue_pose(search: PoseSearch, state: Array, good: Array | None, *, rng: np.random.Generator) -> Array:
    """A new pose for a lost body: from the last good pose and from usual poses, moved to where the body is now.

    Where it is and which way it faces are taken from the lost state (D,), whose trunk and head are kept longest,
    unless the person walks another way.
    """
    body = search.tools.body
    yaw = yaw_column(body)
    facing = 0.0 if yaw is None else float(state[yaw])
    if search.heading is not None and np.cos(facing - search.heading) < 0.5:
        facing = search.heading
    starts, _ = candidate_states(body, search.tools.grid.centers(search.hull.hull.voxels), np.array([facing]))
    states = [*starts, state]
    if good is not None:
        moved = good.copy()
        moved[:3] = state[:3]
        if yaw is not None:
            moved[yaw] = facing
        states.append(moved)
    problem = search.problem.search
    brief = ApfSettings(n_layers=4, n_particles=80, std=0.5 * search.std, survival_rate=0.5)
    thorough = ApfSettings(n_layers=6, n_particles=200, std=0.5 * search.std, survival_rate=0.6)
    tried = search.attempts(
        [(initial_particles(problem, s, 2), "") for s in states], brief, is_brief=True, rng=rng
    )
    tried.sort(key=lambda found: -found.log_likelihood)
    settled = search.attempts(
        [(initial_particles(problem, f.state, 2), "") for f in tried[:2]], thorough, is_brief=False, rng=rng
    )
    best = max(settled, key=lambda found: found.log_likelihood)
    return search.with_limbs_recovered(best, rng=rng).state
