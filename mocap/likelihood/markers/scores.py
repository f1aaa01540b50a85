"""Marker likelihood: how well a pose explains the 2D marker detections of one frame (CF 6.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.body.markers import Markers, marker_positions
from mocap.body.model import Body
from mocap.data.problem import StateLayout
from mocap.data.propagation import truncated_gaussian_step
from mocap.geometry.epipolar import symmetric_epipolar_distance
from mocap.likelihood.markers._score_kernels import (
    OUT_OF_REACH_PX,
    Candidates,
    Cells,
    MarkerPoints,
    Search,
    closest_cells,
    epipolar_table,
    marker_scores_kernel,
)
from mocap.likelihood.markers.views import MarkerObservation

_CELL_PX = 8.0


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


def _prepare(observation: MarkerObservation, settings: MarkerLikelihoodSettings) -> Search:
    views, detections = observation.views, observation.detections
    Q = len(observation.uv)
    table = np.empty((Q, Q) if settings.reprojection_weight < 1 else (0, 0), dtype=np.float32)
    if table.size:
        epipolar_table(views.F, views.is_pair, detections, table)
    n_cells = np.floor((views.upper - views.lower) / _CELL_PX).astype(np.int64) + 1
    cell_first = np.concatenate([[0], np.cumsum(n_cells.prod(axis=1))]).astype(np.int64)
    cells = Cells(views.lower, n_cells, cell_first, _CELL_PX)
    start, stop = (np.empty(cell_first[-1] + 1, dtype=np.uint32) for _ in range(2))
    member = closest_cells(detections, cells, settings.gate_px, start, stop)
    uv = np.vstack([observation.uv, np.full((1, 2), OUT_OF_REACH_PX)])
    return Search(uv, table, cells, Candidates(start, stop, member))


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
    _search: Search = field(init=False, repr=False)
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

        Source: CF Eq. 6.4, 6.5, 6.7, 6.8. Departs from CF Eq. 6.4: markers sit on the skin, not in the joints.
        """
        s = np.ascontiguousarray(states, dtype=np.float64)
        if s.ndim != 2 or s.shape[1] != self.layout.n_columns:
            raise ValueError(f"states has shape {s.shape}, expected (N, {self.layout.n_columns})")
        joint, offset = self.markers.joint, self.markers.offset
        if rows is not None:
            joint, offset = joint[rows], offset[rows]
        out = np.empty((len(s), len(joint)))
        marker_scores_kernel(
            s,
            self.body.chain,
            MarkerPoints(joint, offset),
            self.observation.views.projections,
            self._search,
            self.settings.gate_px,
            self.settings.reprojection_weight,
            out,
        )
        return out

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        """Log-likelihoods of particles (N, D): one column per part asked for (all for None), or one for a pooled
        likelihood of these parts' markers. A part without markers says nothing: 0.  given : of no effect, markers
        take up no room.

        Source: CF Eq. 6.9, 6.10. Departs from CF Eq. 6.9, unless `factorised` is off: a mean and a likelihood per part.
        """
        chosen = np.arange(self.layout.n_parts) if parts is None else np.asarray(parts, dtype=np.int64)
        rows = np.flatnonzero(np.isin(self.markers.part, chosen))
        score = self.scores(particles, rows)
        if self.settings.factorised:
            cost = score @ self._share[np.ix_(rows, chosen)]
        else:
            cost = score.mean(axis=1, keepdims=True) if len(rows) else np.zeros((len(score), 1))
        return -0.5 * (cost / self.settings.sigma) ** 2


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
