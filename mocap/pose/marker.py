"""Marker detections as evidence: what a pose is judged by in one frame of them, and how it is refined there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap.body import landmarks_of, neutral_state
from mocap.body.markers import Markers, marker_positions
from mocap.data.problem import ResidualProblem
from mocap.filters.refine import RefineSettings, refine
from mocap.filters.scout import Bonus
from mocap.geometry.rigid import wrap_angle
from mocap.likelihood.markers import (
    MarkerFitProblem,
    MarkerFitSettings,
    MarkerLikelihoodSettings,
    MarkerObservation,
    MarkerProblem,
)
from mocap.likelihood.residuals.total import SumProblem
from mocap.pose.evidence import FrameEvidence, FrameFit, PersonTools
from mocap.pose.settings import MarkerSettings

Array = NDArray[np.float64]
ObservationOf = Callable[[int], MarkerObservation]

# A refinement in rounds of matching: how far markers are looked for (m), and iterations.
Rounds = Sequence[tuple[float, int]]


@dataclass(frozen=True, eq=False)
class Fit:
    """A refined pose of one frame.  state : (D,); cost : robust, nats; problem : with its matches."""

    state: Array
    cost: float
    problem: MarkerFitProblem
    min_matched: int

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
        return matches is not None and int((matches.n_views >= 2).sum()) >= self.min_matched


@dataclass(frozen=True, eq=False)
class MarkerTools(PersonTools):
    """What stays the same for one person over a clip of detections.  extra_slack_m : of a body that is not fitted
    yet."""

    markers: Markers
    judged_by: MarkerSettings
    extra_slack_m: float = 0.0

    @property
    def marker_offsets(self) -> Array | None:
        return self.markers.offset

    @property
    def narrow(self) -> Rounds:
        """Rounds of matching near a pose."""
        return self.settings.method.marker_fit.narrow_rounds

    @property
    def wide(self) -> Rounds:
        """Rounds of matching for a pose that may be far off."""
        return self.settings.method.marker_fit.wide_rounds

    @cached_property
    def is_near_landmark(self) -> NDArray[np.bool_]:
        """Whether a marker shows a landmark, because it sits near it at rest: (M, K)."""
        rest = neutral_state(self.body)[None]
        landmarks, markers = landmarks_of(self.body, rest)[0], marker_positions(self.body, self.markers, rest)
        d = np.linalg.norm(landmarks[:, None] - markers, axis=2)
        near_m = self.settings.method.marker_fit.near_landmark_m
        return np.asarray(d <= np.maximum(near_m, d.min(axis=1, keepdims=True)))

    def problem(self, observation: MarkerObservation, gate_px: float | None = None) -> MarkerProblem:
        """The filter's problem of one frame."""
        judged_by = self.judged_by
        settings = MarkerLikelihoodSettings(
            gate_px=judged_by.gate_px if gate_px is None else gate_px,
            reprojection_weight=judged_by.reprojection_weight,
            sigma=judged_by.sigma,
            factorised=judged_by.factorised,
        )
        return MarkerProblem(self.body, self.markers, observation, settings)

    def fit(
        self,
        observation: MarkerObservation,
        state: Array,
        rounds: Rounds | None = None,
        others: Sequence[ResidualProblem] = (),
    ) -> Fit:
        """A state (D,) refined on one frame, matched anew before each round.  others : further costs, nats."""
        numbers = self.settings.method.marker_fit
        is_position = self.body.is_position
        prior_std = np.where(is_position, numbers.prior_std_m, numbers.prior_std_rad)
        problem = self.fit_problem(observation)
        for reach_m, n_iterations in self.narrow if rounds is None else rounds:
            settings = replace(problem.settings, reach_m=reach_m)
            problem = replace(problem, settings=settings).matched_at(state)
            # One unit of a residual is one standard deviation of a detection.
            refining = RefineSettings(prior_std, residual_std_m=1.0, n_iterations=n_iterations)
            every = SumProblem(((1.0, problem), *((1.0, other) for other in others))) if others else problem
            state, _ = refine(every, state, refining)
        return Fit(state, problem.normal_equations(state)[0], problem, numbers.min_matched_markers)

    def fit_problem(self, observation: MarkerObservation) -> MarkerFitProblem:
        """The residuals of one frame, not matched yet."""
        settings = MarkerFitSettings(noise_px=self.judged_by.noise_px, extra_slack_m=self.extra_slack_m)
        return MarkerFitProblem(self.body, self.markers, observation, settings)

    def difference(self, a: Array, b: Array) -> Array:
        """a - b of states (..., D), angles without bounds wrapped."""
        return np.where(self.body.layout.is_circular, wrap_angle(a - b), a - b)


@dataclass(frozen=True, eq=False)
class MarkerEvidence:
    """One person in one frame of detections. Implements `FrameEvidence`."""

    tools: MarkerTools
    observation: MarkerObservation

    @cached_property
    def search(self) -> MarkerProblem:
        """The filter's problem."""
        return self.tools.problem(self.observation)

    @property
    def n_cameras(self) -> int:
        """Views with detections."""
        return int(np.count_nonzero(np.diff(self.observation.first)))

    @property
    def grain_m(self) -> float:
        """Detections resolve more than the filter's particles do."""
        return 0.0

    def evidence(self, states: Sequence[Array] | Array) -> Array:
        """What K states cost, less than nothing: (K,) nats."""
        fit_problem = self.tools.fit_problem(self.observation)
        return np.array([-fit_problem.matched_at(s).normal_equations(s)[0] for s in states])

    def all_refined(self, states: Sequence[Array], n_iterations: int | None = None) -> list[Array]:
        """Each of several states (D,) refined; n_iterations is that of the tools' rounds."""
        return [self.tools.fit(self.observation, state).state for state in states]

    def refined_with(self, state: Array, other: ResidualProblem) -> Array:
        """A state (D,) moved to a nearby minimum of the detections' cost and of another one, nats."""
        return self.tools.fit(self.observation, state, others=(other,)).state

    def limb_terms(self, state: Array) -> list[Bonus]:
        """Detections have no other word for a limb than their likelihood."""
        return []

    def limb_misfits(self, state: Array) -> dict[int, float]:
        """Limbs are searched for in turn, whatever their misfit (`beam.Beam`)."""
        return {}

    def fit(self, state: Array, kept_parts: NDArray[np.bool_] | None = None) -> FrameFit:
        """How a state (D,) fits; a landmark is observed when a marker near it is matched in two views or more."""
        matched = self.tools.fit_problem(self.observation).matched_at(state)
        observed = observed_landmarks(self.tools, matched)
        return FrameFit(
            information=matched.normal_equations(state)[1],
            misfit=np.zeros(self.tools.body.layout.n_parts),
            unexplained=0.0,
            log_likelihood=float(self.search.log_likelihood(state[None]).sum()),
            observed=observed,
            judged=np.ones(len(observed), dtype=np.bool_),
        )


@dataclass(frozen=True, eq=False)
class MarkerClipObservation:
    """The detections of one person over a clip. Implements `Observation`."""

    tools: MarkerTools
    observation_of: ObservationOf

    def prepare(self, frame: int) -> MarkerObservation | None:
        """The detections of a frame, None where they are too few for a body."""
        observation = self.observation_of(frame)
        few = self.tools.settings.method.marker_fit.min_matched_markers
        return None if len(observation.uv) < few else observation

    def evidence(self, prepared: MarkerObservation) -> MarkerEvidence:
        """What poses are judged by in a prepared frame."""
        return MarkerEvidence(self.tools, prepared)

    def learn(self, evidence: FrameEvidence, state: Array) -> None:
        """A frame of detections teaches nothing."""


def observed_landmarks(tools: MarkerTools, matched: MarkerFitProblem | None) -> NDArray[np.bool_]:
    """Landmarks that a marker near them, matched in two views or more, shows: (M,)."""
    if matched is None or matched.matches is None:
        return np.zeros(len(tools.is_near_landmark), dtype=np.bool_)
    return np.asarray((tools.is_near_landmark & (matched.matches.n_views >= 2)).any(axis=1))
