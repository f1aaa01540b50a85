"""What a pose is judged by in one frame of marker detections, and how it is refined there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body
from mocap.body.markers import Markers
from mocap.filters import FilterSettings, filter_settings
from mocap.filters.refine import RefineSettings, refine
from mocap.geometry.rigid import wrap_angle
from mocap.likelihood.markers import (
    MarkerFitProblem,
    MarkerFitSettings,
    MarkerLikelihoodSettings,
    MarkerObservation,
    MarkerProblem,
)
from mocap.pipeline.config import MarkersConfig, PoseConfig
from mocap.pipeline.pose_settings import filter_budget

Array = NDArray[np.float64]
ObservationOf = Callable[[int], MarkerObservation]

# A refinement in rounds of matching: how far markers are looked for (m), and iterations.
Rounds = Sequence[tuple[float, int]]
NARROW: Rounds = ((0.12, 4), (0.08, 6))
WIDE: Rounds = ((0.25, 5), (0.15, 5), (0.08, 6))
_PRIOR_STD_M = 0.1
_PRIOR_STD_RAD = 0.5
# Nothing but this many matched markers tells a body from clutter.
MIN_MATCHED_MARKERS = 5


@dataclass(frozen=True, eq=False)
class Fit:
    """A refined pose of one frame.  state : (D,); cost : robust, nats; problem : with its matches."""

    state: Array
    cost: float
    problem: MarkerFitProblem

    @property
    def gain(self) -> float:
        """Nats that the pose explains: what it would cost without any detection, less what it costs."""
        matches, settings = self.problem.matches, self.problem.settings
        n_possible = 0 if matches is None else int(matches.in_view.sum())
        return 0.5 * settings.scale**2 * n_possible - self.cost

    @property
    def is_seen(self) -> bool:
        """Whether enough markers were matched in two views or more."""
        matches = self.problem.matches
        return matches is not None and int((matches.n_views >= 2).sum()) >= MIN_MATCHED_MARKERS


@dataclass(frozen=True, eq=False)
class MarkerTools:
    """What stays the same for one person over a clip.  extra_slack_m : of a body that is not fitted yet."""

    body: Body
    markers: Markers
    fps: float
    pose: PoseConfig
    config: MarkersConfig
    extra_slack_m: float = 0.0

    @property
    def noise_std(self) -> Array:
        """(D,) standard deviation per frame: half of the largest expected movement (CF 3.2.2)."""
        return 0.5 * self.body.max_speed / self.fps * self.pose.noise_scale

    def filter_settings(self) -> FilterSettings:
        """Settings of the configured filter."""
        layout = self.body.layout
        return filter_settings(filter_budget(self.pose, layout), layout, self.noise_std)

    def problem(self, observation: MarkerObservation, gate_px: float | None = None) -> MarkerProblem:
        """The filter's problem of one frame."""
        config = self.config
        settings = MarkerLikelihoodSettings(
            gate_px=config.gate_px if gate_px is None else gate_px,
            reprojection_weight=config.reprojection_weight,
            sigma=config.sigma,
            factorised=config.factorised,
        )
        return MarkerProblem(self.body, self.markers, observation, settings)

    def fit(self, observation: MarkerObservation, state: Array, rounds: Rounds = NARROW) -> Fit:
        """A state (D,) refined on one frame, matched anew before each round."""
        is_position = np.arange(self.body.layout.n_columns) < 3
        prior_std = np.where(is_position, _PRIOR_STD_M, _PRIOR_STD_RAD)
        problem = self.fit_problem(observation)
        for reach_m, n_iterations in rounds:
            settings = replace(problem.settings, reach_m=reach_m)
            problem = replace(problem, settings=settings).matched_at(state)
            # One unit of a residual is one standard deviation of a detection.
            refining = RefineSettings(prior_std, residual_std_m=1.0, n_iterations=n_iterations)
            state, _ = refine(problem, state, refining)
        return Fit(state, problem.normal_equations(state)[0], problem)

    def fit_problem(self, observation: MarkerObservation) -> MarkerFitProblem:
        settings = MarkerFitSettings(noise_px=self.config.noise_px, extra_slack_m=self.extra_slack_m)
        return MarkerFitProblem(self.body, self.markers, observation, settings)

    def difference(self, a: Array, b: Array) -> Array:
        """a - b of states (..., D), angles without bounds wrapped."""
        return np.where(self.body.layout.is_circular, wrap_angle(a - b), a - b)
