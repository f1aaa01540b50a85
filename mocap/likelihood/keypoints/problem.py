"""Keypoint likelihood: the robust reprojection error of a person's named points, for filter and refinement alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap.arrays import Array, Mask
from mocap.body._kernels import chain_axes
from mocap.body.markers import Markers, marker_positions
from mocap.body.model import Body
from mocap.data.problem import StateLayout
from mocap.data.propagation import truncated_gaussian_step
from mocap.likelihood.keypoints._kernels import keypoint_costs, keypoint_pulls
from mocap.likelihood.markers._fit_kernels import Movement, add_pulls


@dataclass(frozen=True)
class KeypointSettings:
    """How keypoints pull a body."""

    scale: float = 3.0
    """Error, in standard deviations, at which a view's keypoint loses three quarters of its pull (Geman-McClure)."""
    worth: float = 0.1
    """What a residual is worth as evidence: views of one keypoint err alike, and for many frames."""
    usual_weight: float = 1.0
    """Weight of what angles are usual: it holds joints on which no keypoint sits, as collar bones."""
    neck_std: float = 0.5
    """How far a neck usually is from straight, rad: many tools name no point of a head, which then hangs anywhere."""


@dataclass(frozen=True, eq=False)
class KeypointViews:
    """What the cameras say of one person in one frame.

    P : (C, 3, 4), world (m) to undistorted px.  uv : (C, K, 2) undistorted px, NaN = the view has no say.
    noise_px : (C, K) standard deviation along u and v.
    """

    P: Array
    uv: Array
    noise_px: Array

    @cached_property
    def has_say(self) -> Mask:
        """(C, K), which keypoints are seen by which views."""
        return np.asarray(np.isfinite(self.uv).all(axis=-1))

    @property
    def n_views(self) -> Array:
        """Views of every keypoint, (K,)."""
        return np.asarray(self.has_say.sum(axis=0))


@dataclass(frozen=True, eq=False)
class KeypointProblem:
    """A body against the keypoints of one frame: implements `ArticulatedProblem` and `ResidualProblem`.

    markers : where the K keypoints sit on the body. One unit of a residual is one standard deviation of a keypoint. A
    view without a keypoint has no say.
    """

    body: Body
    markers: Markers
    views: KeypointViews
    settings: KeypointSettings = KeypointSettings()

    @property
    def layout(self) -> StateLayout:
        return self.body.layout

    @cached_property
    def usual_information(self) -> Array:
        """(D,) weight of every angle's departure from what is usual, rad^-2."""
        std = self.body.usual_std.copy()
        std[[name.startswith("neck_") for name in self.layout.names]] = self.settings.neck_std
        return np.asarray(self.settings.usual_weight * std**-2.0)

    def propagate(self, particles: Array, std: Array, *, rng: np.random.Generator) -> Array:
        return truncated_gaussian_step(particles, std, self.layout.lower, self.layout.upper, rng=rng)

    def costs(self, states: Array) -> Array:
        """Robust cost of every keypoint in states (N, D), (N, K) nats."""
        points = marker_positions(self.body, self.markers, np.asarray(states, dtype=np.float64))
        out = np.empty(points.shape[:2])
        views = self.views
        keypoint_costs(points, views.P, views.uv, views.noise_px, self.settings.scale, out)
        return out

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        """(N, P) nats: every keypoint speaks for the part that it sits on."""
        per_part = np.zeros((len(particles), self.layout.n_parts))
        for k, cost in enumerate(self.costs(particles).T):
            per_part[:, self.markers.part[k]] -= self.settings.worth * cost
        return per_part if parts is None else per_part[:, list(parts)]

    def evidence(self, states: Array) -> Array:
        """What states (N, D) cost, less than nothing: keypoints and unusual angles, (N,) nats."""
        unusual = 0.5 * (self.usual_information * np.asarray(states) ** 2).sum(axis=1)
        return np.asarray(-self.settings.worth * (self.costs(states).sum(axis=1) + unusual))

    def matched_at(self, state: Array) -> KeypointProblem:
        """Itself: keypoints have names."""
        return self

    def pulls(self, points: Array) -> tuple[float, Array, Array]:
        """Robust cost of keypoints at points (K, 3) m, world, its matrix (K, 3, 3) and its gradient (K, 3) there."""
        n = len(points)
        information, gradient, cost = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty(n)
        views = self.views
        keypoint_pulls(
            points, views.P, views.uv, views.noise_px, self.settings.scale, information, gradient, cost
        )
        return float(cost.sum()), information, gradient

    def normal_equations(self, state: Array) -> tuple[float, Array, Array]:
        """Robust cost, its Gauss-Newton matrix (D, D) and gradient (D,) at a state (D,)."""
        body, joint = self.body, self.markers.joint
        D, J = body.layout.n_columns, len(body.joints)
        H, g = np.zeros((D, D)), np.zeros(D)
        R, t, axes = np.empty((J, 3, 3)), np.empty((J, 3)), np.empty((len(body.dof_joint), 3))
        chain_axes(np.ascontiguousarray(state, dtype=np.float64), body.chain, R, t, axes)
        points = np.einsum("mrc,mc->mr", R[joint], self.markers.offset) + t[joint]
        cost, information, gradient = self.pulls(points)
        movement = Movement(t, axes, body.dof_joint, body.dof_column, body.moves)
        add_pulls(points, joint, information, gradient, movement, H, g)
        usual = self.usual_information
        H[np.diag_indices(len(H))] += usual
        return cost + 0.5 * float((usual * state**2).sum()), H, g + usual * state
