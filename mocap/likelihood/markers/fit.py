"""Fit of markers: robust reprojection error of the detections that belong to them, for a refinement."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Indices
from mocap.body._kernels import chain_axes
from mocap.body.markers import Markers, marker_positions
from mocap.body.model import Body
from mocap.data.problem import StateLayout
from mocap.likelihood.markers._fit_kernels import (
    Belief,
    MarkedBody,
    MatchedViews,
    Movement,
    Projected,
    RobustNoise,
    add_pulls,
    agreeing_detections,
    marker_pulls,
    matched_equations,
    nearest_detections,
    project_markers,
)
from mocap.likelihood.markers.views import MarkerObservation


@dataclass(frozen=True)
class MarkerFitSettings:
    """How detections are matched with markers, and how they pull a body in the refinement."""

    reach_m: float = 0.10
    """How far off a predicted marker may be (three standard deviations): detections beyond are not looked at."""
    noise_px: float = 2.0
    """Standard deviation of a detection along u and v."""
    scale: float = 3.0
    """Error, in standard deviations, at which a detection loses three quarters of its pull (Geman-McClure)."""
    extra_slack_m: float = 0.0
    """Slack of every marker beyond its own, for bodies that are not fitted yet."""


@dataclass(frozen=True, eq=False)
class Matches:
    """Which detection each marker takes in each view.

    chosen : (M, C) index into the observation's uv, -1 = none.  in_view : (M, C) bool, whether the picture holds it.
    """

    chosen: Indices
    in_view: NDArray[np.bool_]

    @property
    def n_views(self) -> Indices:
        """Views that hold a detection of each marker, (M,)."""
        return (self.chosen >= 0).sum(axis=1)


@dataclass(frozen=True, eq=False)
class MarkerFitProblem:
    """Robust reprojection error of a body's markers: `normal_equations(state)` for the refinement.

    matches : fixed ones; None = the closest detections, chosen anew at every state. Residuals are whitened: one unit
    is one standard deviation of a detection.
    """

    body: Body
    markers: Markers
    observation: MarkerObservation
    settings: MarkerFitSettings
    matches: Matches | None = None

    @property
    def layout(self) -> StateLayout:
        return self.body.layout

    @property
    def usual_information(self) -> Array:
        """(D,) how firmly every angle is held at 0, rad^-2: not at all."""
        return np.zeros(self.layout.n_columns)

    @property
    def slack_m(self) -> Array:
        return np.hypot(self.markers.slack_m, self.settings.extra_slack_m)

    def matched_at(self, state: Array) -> MarkerFitProblem:
        """The same problem with the detections fixed that agree across views near the markers of a state (D,).

        False detections rarely agree in three dimensions; the closest one in each view alone is often false. Markers
        on which no two views agree take the closest detections.
        Source: CF 6.6.1 (what makes false detections harmless); departs from CF Eq. 6.5: closeness to a common point
        decides, not to each projection.
        """
        points = marker_positions(self.body, self.markers, state[None])[0]
        views, observation, settings = self.observation.views, self.observation, self.settings
        seen = self._project(points)
        gate = self._gate(seen)
        nearest, agreeing = np.empty(gate.shape, dtype=np.int64), np.empty(gate.shape, dtype=np.int64)
        nearest_detections(seen.uv, seen.in_view, *observation.detections, gate, nearest)
        noise = settings.noise_px
        belief = Belief(settings.reach_m / 3.0, noise, observation.worth(noise))
        agreeing_detections(
            points, seen, gate, views.P, views.is_pair, observation.detections, belief, agreeing
        )
        # The last entry stands for "no detection".
        is_taken = np.zeros(len(observation.uv) + 1, dtype=np.bool_)
        is_taken[agreeing] = True
        is_taken[-1] = True
        alone = np.asarray((agreeing < 0).all(axis=1))
        nearest[is_taken[nearest]] = -1
        chosen = np.where(alone[:, None], nearest, agreeing)
        return replace(self, matches=Matches(chosen, seen.in_view))

    def _project(self, points: Array) -> Projected:
        shape = (len(points), self.observation.views.n_views)
        seen = Projected(np.full((*shape, 2), np.nan), np.empty(shape), np.empty(shape, dtype=np.bool_))
        views = self.observation.views
        project_markers(points, views.P, views.lower, views.upper, *seen)
        return seen

    def _gate(self, seen: Projected) -> Array:
        """How far from its projection a marker's detection may be, (M, C) px."""
        return self.settings.reach_m * self.observation.views.focal / np.maximum(seen.depth, 1e-3)

    @property
    def _noise(self) -> RobustNoise:
        return RobustNoise(self.settings.noise_px, self.settings.scale)

    @cached_property
    def _matched(self) -> tuple[MarkedBody, MatchedViews] | None:
        """Body and pictures as kernels take them, where the detections are given to markers."""
        if self.matches is None:
            return None
        body, markers, views = self.body, self.markers, self.observation.views
        marked = MarkedBody(body.chain, body.moves, markers.joint, markers.offset, self.slack_m)
        matches = self.matches
        seen = MatchedViews(
            views.P, views.lower, views.upper, self.observation.uv, matches.chosen, matches.in_view
        )
        return marked, seen

    def pulls(self, points: Array) -> tuple[float, Array, Array]:
        """Robust cost of markers at points (M, 3) m, world, its matrix (M, 3, 3) and its gradient (M, 3) there."""
        observation = self.observation
        seen = self._project(points)
        if self.matches is not None:
            # A fixed set of views: a marker must not gain by leaving the picture.
            chosen = self.matches.chosen
            seen = seen._replace(in_view=self.matches.in_view & (seen.depth > 1e-6))
        else:
            chosen = np.empty(seen.depth.shape, dtype=np.int64)
            nearest_detections(seen.uv, seen.in_view, *observation.detections, self._gate(seen), chosen)
        information, gradient = np.empty((len(points), 3, 3)), np.empty((len(points), 3))
        P, uv, slack = observation.views.P, observation.uv, self.slack_m
        cost = marker_pulls(P, seen, uv, chosen, slack, self._noise, information, gradient)
        return float(cost), information, gradient

    def normal_equations(self, state: Array) -> tuple[float, Array, Array]:
        """Robust cost, its Gauss-Newton matrix (D, D) and gradient (D,) at a state (D,).

        A marker in view of a camera that has no detection there costs as much as one infinitely far from its own.
        """
        body = self.body
        D, J = body.layout.n_columns, len(body.joints)
        H, g = np.zeros((D, D)), np.zeros(D)
        if self._matched is not None:
            # One call of compiled code: a refinement comes here a dozen times.
            x = np.ascontiguousarray(state, dtype=np.float64)
            return float(matched_equations(x, *self._matched, self._noise, H, g)), H, g
        R, t, axes = np.empty((J, 3, 3)), np.empty((J, 3)), np.empty((len(body.dof_joint), 3))
        chain_axes(np.ascontiguousarray(state, dtype=np.float64), body.chain, R, t, axes)
        joint = self.markers.joint
        points = np.einsum("mrc,mc->mr", R[joint], self.markers.offset) + t[joint]
        cost, information, gradient = self.pulls(points)
        movement = Movement(t, axes, body.dof_joint, body.dof_column, body.moves)
        add_pulls(points, joint, information, gradient, movement, H, g)
        return cost, H, g
