"""Marker likelihood: how well a pose explains the 2D marker detections of one frame (CF 6.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.body.markers import Markers, marker_positions
from mocap.body.model import Body
from mocap.data.camera import Camera, CameraRig
from mocap.data.problem import StateLayout
from mocap.data.propagation import truncated_gaussian_step
from mocap.geometry.epipolar import fundamental_matrix, symmetric_epipolar_distance
from mocap.likelihood._marker_kernels import (
    OUT_OF_REACH_PX,
    add_pulls,
    agreeing_detections,
    closest_cells,
    epipolar_table,
    marker_pulls,
    marker_scores_kernel,
    nearest_detections,
    project_markers,
)
from mocap.likelihood._pull_kernels import chain_axes
from mocap.likelihood.surface import dof_moves_joint

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_CELL_PX = 8.0
_SMALLEST_BOX_PX = 30.0
_BORDER_SAMPLES = 9  # points per side of a picture that tell how far it reaches without distortion


@dataclass(frozen=True)
class MarkerLikelihoodSettings:
    """How detections are chosen and weighed."""

    gate_px: float = 20.0
    """rho of CF 6.4.1.2: a detection further from the projected marker is none of it."""
    reprojection_weight: float = 1.0
    """Share of the reprojection term in a marker's score; 0 = the printed cost (CF Eq. 6.8)."""
    sigma: float = 1.0
    """Source: CF Eq. 6.10."""
    factorised: bool = True
    """Per-part likelihoods; False pools all markers, as printed (CF Eq. 6.9)."""

    def __post_init__(self) -> None:
        if not self.gate_px > 0 or not self.sigma > 0:
            raise ValueError(f"gate_px and sigma must be positive, got {self.gate_px} and {self.sigma}")
        if not 0 <= self.reprojection_weight <= 1:
            raise ValueError(f"reprojection_weight must lie in [0, 1], got {self.reprojection_weight}")


@dataclass(frozen=True, eq=False)
class MarkerViews:
    """What the likelihood needs of the cameras: ideal pinholes, without distortion.

    P : (C, 3, 4), world (m) to undistorted px.  lower, upper : (C, 2) px, bounds of the undistorted picture.
    F : (C, C, 3, 3), a point of view i times F[i, j] is its epipolar line in view j.  is_pair : (C, C) bool, whether
    two views have epipolar geometry (two cameras in one place have none).
    """

    rig: CameraRig
    P: Array
    lower: Array
    upper: Array
    F: Array
    is_pair: NDArray[np.bool_]

    @property
    def n_views(self) -> int:
        return len(self.P)

    @cached_property
    def focal(self) -> Array:
        """Mean focal length of each view, (C,) px."""
        return np.array([0.5 * (c.K[0, 0] + c.K[1, 1]) for c in self.rig])


def marker_views(rig: CameraRig) -> MarkerViews:
    """Projection and epipolar geometry of a rig for undistorted pixels."""
    C = len(rig)
    P, lower, upper = np.zeros((C, 3, 4)), np.zeros((C, 2)), np.zeros((C, 2))
    F, is_pair = np.zeros((C, C, 3, 3)), np.zeros((C, C), dtype=np.bool_)
    for c, camera in enumerate(rig):
        P[c] = camera.K @ np.column_stack([camera.R, camera.t])
        border = undistort(camera, _border(camera))
        lower[c], upper[c] = np.nanmin(border, axis=0), np.nanmax(border, axis=0)
    for i, a in enumerate(rig):
        for j, b in enumerate(rig):
            if i != j and np.linalg.norm(a.center - b.center) > 1e-9:
                F[i, j] = fundamental_matrix(a.K, a.R, a.t, b.K, b.R, b.t)
                is_pair[i, j] = True
    return MarkerViews(rig, P, lower, upper, F, is_pair)


def undistort(camera: Camera, uv: Array) -> Array:
    """Pixels uv (N, 2) as an ideal pinhole camera of the same K would see them, (N, 2); NaN beyond 90 degrees."""
    direction = camera.rays(uv) @ camera.R.T
    with np.errstate(divide="ignore", invalid="ignore"):
        normalised = np.where(direction[:, 2:] > 1e-6, direction[:, :2] / direction[:, 2:], np.nan)
    return normalised @ camera.K[:2, :2].T + camera.K[:2, 2]


def _border(camera: Camera) -> Array:
    """Points along the border of a picture, (N, 2) px."""
    w, h = camera.size
    u, v = np.linspace(-0.5, w - 0.5, _BORDER_SAMPLES), np.linspace(-0.5, h - 0.5, _BORDER_SAMPLES)
    sides = [(u, np.full_like(u, y)) for y in (-0.5, h - 0.5)] + [
        (np.full_like(v, x), v) for x in (-0.5, w - 0.5)
    ]
    return np.concatenate([np.column_stack(side) for side in sides])


@dataclass(frozen=True, eq=False)
class MarkerObservation:
    """The detections of one frame.  uv : (Q, 2) undistorted px, view by view.  first : (C + 1,) where a view starts."""

    views: MarkerViews
    uv: Array
    first: Indices

    def of_view(self, c: int) -> Array:
        """Detections of one view, (n, 2) undistorted px."""
        return self.uv[self.first[c] : self.first[c + 1]]

    @cached_property
    def density(self) -> Array:
        """Detections per square pixel of the box that holds them, in each view, (C,)."""
        out = np.empty(self.views.n_views)
        for c in range(len(out)):
            uv = self.of_view(c)
            extent = np.maximum(np.ptp(uv, axis=0), _SMALLEST_BOX_PX) if len(uv) else np.ones(2)
            out[c] = max(len(uv), 1) / float(extent.prod())
        return out

    def worth(self, noise_px: float) -> Array:
        """Nats that a detection right at a marker is worth in each view, (C,): its density there over that of all
        detections, which may all be false. Between 0.5 and 6."""
        return np.clip(-np.log(2 * np.pi * noise_px**2 * self.density), 0.5, 6.0)


def observe(views: MarkerViews, detections: Sequence[Array]) -> MarkerObservation:
    """Detections of one frame, one (n, 2) array of raw pixels per camera, made ready for the likelihood.

    Detections that are NaN or that no pinhole sees are left out.
    Raises ValueError for a wrong number of cameras or shape.
    """
    if len(detections) != views.n_views:
        raise ValueError(f"detections of {len(detections)} cameras, the rig has {views.n_views}")
    kept = []
    for camera, uv in zip(views.rig, detections, strict=True):
        if np.ndim(uv) != 2 or np.shape(uv)[1] != 2:
            raise ValueError(f"camera {camera.name}: detections have shape {np.shape(uv)}, expected (n, 2)")
        ideal = undistort(camera, np.asarray(uv, dtype=np.float64))
        kept.append(ideal[np.isfinite(ideal).all(axis=1)])
    first = np.concatenate([[0], np.cumsum([len(k) for k in kept])]).astype(np.int64)
    return MarkerObservation(views, np.ascontiguousarray(np.concatenate(kept)), first)


@dataclass(frozen=True, eq=False)
class _Search:
    """Per frame, what the kernel looks up: distances of pairs, and who can be the closest detection in a cell."""

    uv: Array
    table: NDArray[np.float32]
    n_cells: Indices
    cell_first: Indices
    start: NDArray[np.uint32]
    stop: NDArray[np.uint32]
    member: NDArray[np.uint32]


def _prepare(observation: MarkerObservation, settings: MarkerLikelihoodSettings) -> _Search:
    views, first = observation.views, observation.first
    uv = np.vstack([observation.uv, np.full((1, 2), OUT_OF_REACH_PX)])
    Q = len(observation.uv)
    table = np.empty((Q, Q) if settings.reprojection_weight < 1 else (0, 0), dtype=np.float32)
    if table.size:
        epipolar_table(views.F, views.is_pair, uv, first, table)
    n_cells = np.floor((views.upper - views.lower) / _CELL_PX).astype(np.int64) + 1
    cell_first = np.concatenate([[0], np.cumsum(n_cells.prod(axis=1))]).astype(np.int64)
    start, stop = (np.empty(cell_first[-1] + 1, dtype=np.uint32) for _ in range(2))
    member = closest_cells(
        uv, first, views.lower, n_cells, cell_first, _CELL_PX, settings.gate_px, start, stop
    )
    return _Search(uv, table, n_cells, cell_first, start, stop, member)


@dataclass(frozen=True, eq=False)
class MarkerProblem:
    """A body with markers against the detections of one frame: implements `ArticulatedProblem`.

    A marker's score lies in [0, 1]: 0 = perfect, 1 = no evidence for it at all, which is also what a marker costs
    that is seen in fewer than two views (printed cost) or in none (reprojection term). A view without a detection
    inside the gate adds nothing to the printed cost and the gate's full width to the reprojection term. Nothing a
    detector may do costs a marker more than 1.
    """

    body: Body
    markers: Markers
    observation: MarkerObservation
    settings: MarkerLikelihoodSettings
    _search: _Search = field(init=False, repr=False)
    _share: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # Markers to parts: the mean over a part's markers.
        share = np.zeros((len(self.markers), self.body.layout.n_parts))
        share[np.arange(len(self.markers)), self.markers.part] = 1.0
        share /= np.maximum(share.sum(axis=0), 1.0)
        object.__setattr__(self, "_share", share)
        object.__setattr__(self, "_search", _prepare(self.observation, self.settings))

    @property
    def layout(self) -> StateLayout:
        return self.body.layout

    def propagate(self, particles: Array, std: Array, *, rng: np.random.Generator) -> Array:
        return truncated_gaussian_step(particles, std, self.layout.lower, self.layout.upper, rng=rng)

    def scores(self, states: Array, rows: NDArray[np.integer] | None = None) -> Array:
        """Scores of markers, all or those of index `rows`: (N, D) -> (N, M), in [0, 1]; NaN states give 1.

        Source: CF Eq. 6.4, 6.5, 6.7, 6.8.
        """
        s = np.ascontiguousarray(states, dtype=np.float64)
        if s.ndim != 2 or s.shape[1] != self.layout.n_columns:
            raise ValueError(f"states has shape {s.shape}, expected (N, {self.layout.n_columns})")
        joint, offset = self.markers.joint, self.markers.offset
        if rows is not None:
            joint, offset = joint[rows], offset[rows]
        views, search, settings = self.observation.views, self._search, self.settings
        out = np.empty((len(s), len(joint)))
        arguments: tuple[Any, ...] = (
            *self.body.chain,
            joint,
            offset,
            views.P,
            views.lower,
            views.upper,
            search.uv,
            self.observation.first,
            search.table,
            search.n_cells,
            search.cell_first,
            _CELL_PX,
            search.start,
            search.stop,
            search.member,
            settings.gate_px,
            settings.reprojection_weight,
        )
        marker_scores_kernel(s, *arguments, out)
        return out

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        """Log-likelihoods of particles (N, D): one column per part asked for (all for None), or one for a pooled
        likelihood of these parts' markers. A part without markers says nothing: 0.  given : of no effect, markers
        take up no room.

        Source: CF Eq. 6.9, 6.10; departs from them, unless `factorised` is off, in a mean and a likelihood per part.
        """
        chosen = np.arange(self.layout.n_parts) if parts is None else np.asarray(parts, dtype=np.int64)
        rows = np.flatnonzero(np.isin(self.markers.part, chosen))
        score = self.scores(particles, rows)
        if self.settings.factorised:
            cost = score @ self._share[np.ix_(rows, chosen)]
        else:
            cost = score.mean(axis=1, keepdims=True) if len(rows) else np.zeros((len(score), 1))
        return -0.5 * (cost / self.settings.sigma) ** 2


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
    _moves: NDArray[np.bool_] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_moves", dof_moves_joint(self.body))

    @property
    def layout(self) -> StateLayout:
        return self.body.layout

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
        projected, depth, in_view = self._project(points)
        gate = settings.reach_m * views.focal / np.maximum(depth, 1e-3)
        nearest, agreeing = np.empty(depth.shape, dtype=np.int64), np.empty(depth.shape, dtype=np.int64)
        nearest_detections(projected, in_view, observation.uv, observation.first, gate, nearest)
        agreeing_detections(
            points,
            np.full(len(points), settings.reach_m / 3.0),
            in_view,
            projected,
            gate,
            views.P,
            views.is_pair,
            observation.uv,
            observation.first,
            settings.noise_px,
            observation.worth(settings.noise_px),
            agreeing,
        )
        # The last entry stands for "no detection".
        is_taken = np.zeros(len(observation.uv) + 1, dtype=np.bool_)
        is_taken[agreeing] = True
        is_taken[-1] = True
        alone = np.asarray((agreeing < 0).all(axis=1))
        nearest[is_taken[nearest]] = -1
        chosen = np.where(alone[:, None], nearest, agreeing)
        return replace(self, matches=Matches(chosen, in_view))

    def _project(self, points: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        views = self.observation.views
        shape = (len(points), views.n_views)
        projected, depth = np.full((*shape, 2), np.nan), np.empty(shape)
        in_view = np.empty(shape, dtype=np.bool_)
        project_markers(points, views.P, views.lower, views.upper, projected, depth, in_view)
        return projected, depth, in_view

    def pulls(self, points: Array) -> tuple[float, Array, Array]:
        """Robust cost of markers at points (M, 3) m, world, its matrix (M, 3, 3) and its gradient (M, 3) there."""
        views, observation, settings = self.observation.views, self.observation, self.settings
        projected, depth, in_view = self._project(points)
        if self.matches is not None:
            # A fixed set of views: a marker must not gain by leaving the picture.
            chosen, in_view = self.matches.chosen, self.matches.in_view & (depth > 1e-6)
        else:
            chosen = np.empty(depth.shape, dtype=np.int64)
            gate = settings.reach_m * views.focal / np.maximum(depth, 1e-3)
            nearest_detections(projected, in_view, observation.uv, observation.first, gate, chosen)
        information, gradient = np.empty((len(points), 3, 3)), np.empty((len(points), 3))
        cost = marker_pulls(
            self.slack_m,
            settings.noise_px,
            views.P,
            observation.uv,
            in_view,
            chosen,
            projected,
            depth,
            settings.scale,
            information,
            gradient,
        )
        return float(cost), information, gradient

    def normal_equations(self, state: Array) -> tuple[float, Array, Array]:
        """Robust cost, its Gauss-Newton matrix (D, D) and gradient (D,) at a state (D,).

        A marker in view of a camera that has no detection there costs as much as one infinitely far from its own.
        """
        body = self.body
        D, J = body.layout.n_columns, len(body.joints)
        H, g = np.zeros((D, D)), np.zeros(D)
        R, t, axes = np.empty((J, 3, 3)), np.empty((J, 3)), np.empty((len(body.dof_joint), 3))
        chain_axes(np.ascontiguousarray(state, dtype=np.float64), *body.chain, R, t, axes)
        joint = self.markers.joint
        points = np.einsum("mrc,mc->mr", R[joint], self.markers.offset) + t[joint]
        cost, information, gradient = self.pulls(points)
        add_pulls(
            points, joint, information, gradient, t, axes, body.dof_joint, body.dof_column, self._moves, H, g
        )
        return cost, H, g


def marker_scores_numpy(
    body: Body,
    markers: Markers,
    observation: MarkerObservation,
    settings: MarkerLikelihoodSettings,
    states: Array,
) -> Array:
    """The same scores written plainly: the kernel's twin and the benchmark's competitor.

    Source: CF Eq. 6.4-6.8; departs from 6.5 (argmin) and 6.7 (all pairs of views) as printed: reading guide 9.
    """
    views, gate, weight = observation.views, settings.gate_px, settings.reprojection_weight
    points = marker_positions(body, markers, states)
    out = np.empty(points.shape[:2])
    for n, m in np.ndindex(*out.shape):
        chosen: dict[int, Array] = {}
        distance = []
        for c in range(views.n_views):
            x = views.P[c] @ np.append(points[n, m], 1.0)
            if not x[2] > 1e-6:
                continue
            p = x[:2] / x[2]
            if not (np.all(p >= views.lower[c]) and np.all(p <= views.upper[c])):
                continue
            d = np.linalg.norm(observation.of_view(c) - p, axis=1)
            distance.append(min(gate, d.min()) if len(d) else gate)
            if len(d) and d.min() < gate:
                chosen[c] = observation.of_view(c)[d.argmin()]
        squared = [
            float(symmetric_epipolar_distance(views.F[i, j], p[None], q[None])[0]) ** 2
            for i, p in chosen.items()
            for j, q in chosen.items()
            if i < j and views.is_pair[i, j]
        ]
        epipolar = min(1.0, np.sqrt(np.mean(squared) / 8.0) / gate) if squared else 1.0
        reprojection = np.sqrt(np.mean(np.square(distance))) / gate if distance else 1.0
        out[n, m] = (1.0 - weight) * epipolar + weight * reprojection
    return out
