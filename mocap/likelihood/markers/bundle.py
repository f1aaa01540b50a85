"""Bundle adjustment of markers: their places on the body and a person's segment lengths, from many frames at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.body.kinematics import point_jacobian
from mocap.body.markers import Markers
from mocap.body.model import Body
from mocap.body.stretch import segment_groups, stretch_body
from mocap.likelihood.markers.fit import MarkerFitProblem, MarkerFitSettings
from mocap.likelihood.markers.views import MarkerObservation

_DAMPING = 1e-3


@dataclass(frozen=True)
class BundleSettings:
    """What is known of a person and of a marker set before any frame is seen."""

    size_std: float = 0.06
    """Standard deviation of the logarithm of the person's size."""
    stretch_std: float = 0.05
    """The same for every segment and axis, beyond the size."""
    offset_std_m: float = 0.02
    """How far a marker may sit from where its set says."""
    is_body_free: bool = True
    """False: the body is as given and only the markers are looked for."""
    n_rounds: int = 4
    """Rounds of matching."""
    n_iterations: int = 5
    """Gauss-Newton steps in each."""


@dataclass(frozen=True, eq=False)
class Bundle:
    """body, markers : fitted to the person.  states : (F, D) of the frames.  cost : per frame, robust.

    Costs are with fitted offsets, on the last matches.
    """

    body: Body
    markers: Markers
    states: Array
    cost: Array


class BundleProblem(Protocol):
    """One frame of points on a body, as a bundle needs it; a dataclass with these fields among its own."""

    @property
    def body(self) -> Body: ...

    @property
    def markers(self) -> Markers: ...

    @property
    def usual_information(self) -> Array:
        """(D,) how firmly every angle is held at 0, rad^-2."""
        ...

    def matched_at(self, state: Array) -> Self:
        """The same problem with what belongs to each marker near a state (D,) fixed."""
        ...

    def pulls(self, points: Array) -> tuple[float, Array, Array]:
        """Robust cost of markers at points (M, 3) m, its matrix (M, 3, 3) and its gradient (M, 3)."""
        ...


def bundle_markers(
    body: Body,
    markers: Markers,
    observations: Sequence[MarkerObservation],
    states: Array,
    fit: MarkerFitSettings,
    settings: BundleSettings,
) -> Bundle:
    """Fit segment lengths, marker offsets and poses together to frames of detections; see `bundle`.

    observations : F frames.  states : (F, D).  Raises ValueError when there are no frames.
    """
    return bundle([MarkerFitProblem(body, markers, o, fit) for o in observations], states, settings)


def bundle(problems: Sequence[BundleProblem], states: Array, settings: BundleSettings) -> Bundle:
    """Fit segment lengths, marker offsets and poses together to frames that are roughly posed.

    problems : F frames, all of one body and its markers.  states : (F, D).  Priors hold what the markers do not show:
    where a joint lies between its markers, and how long a segment is whose markers move together.
    Gauss-Newton on the robust reprojection error; the poses are eliminated frame by frame.
    Raises ValueError when there are no frames.
    """
    if len(problems) == 0 or len(problems) != len(states):
        raise ValueError(
            f"{len(problems)} observations and {len(states)} states, expected as many, at least 1"
        )
    body, markers = problems[0].body, problems[0].markers
    layout = body.layout
    D, M, F = layout.n_columns, len(markers), len(states)
    group = segment_groups(body)
    S = 1 + 3 * (int(group.max()) + 1)
    prior = np.concatenate(
        [
            [settings.size_std**-2],
            np.full(S - 1, settings.stretch_std**-2),
            np.full(3 * M, settings.offset_std_m**-2),
        ]
    )
    is_free = np.ones(S + 3 * M, dtype=np.bool_)
    is_free[:S] = settings.is_body_free
    theta = np.zeros(S + 3 * M)
    x = np.clip(states, layout.lower, layout.upper)

    def shaped(theta: Array) -> tuple[Body, Markers]:
        s = np.exp(theta[0] + theta[1:S].reshape(-1, 3))[group]
        offset = markers.offset * s[markers.joint] + theta[S:].reshape(M, 3)
        return stretch_body(body, s), replace(markers, offset=offset)

    cost = np.zeros(F)
    for _ in range(settings.n_rounds):
        fitted, placed = shaped(theta)
        matched = [_worn(p, fitted, placed).matched_at(x[f]) for f, p in enumerate(problems)]
        for _ in range(settings.n_iterations):
            fitted, placed = shaped(theta)
            N = np.diag(prior)
            r = prior * theta
            steps = []
            for f, own in enumerate(matched):
                problem = _worn(own, fitted, placed)
                points, to_state, R = point_jacobian(fitted, x[f], placed.joint, placed.offset)
                cost[f], A, b = problem.pulls(points)
                usual = problem.usual_information
                to_shape = _shape_jacobian(fitted, placed, markers, theta, group, S, R)
                Hxx = np.einsum("mri,mrs,msj->ij", to_state, A, to_state)
                Hxs = np.einsum("mri,mrs,msj->ij", to_state, A, to_shape)
                gx = np.einsum("mri,mr->i", to_state, b) + usual * x[f]
                Hxx[np.diag_indices(D)] += usual
                free = ~(((x[f] <= layout.lower) & (gx > 0)) | ((x[f] >= layout.upper) & (gx < 0)))
                Hxx[~free] = 0.0
                Hxx[:, ~free] = 0.0
                Hxs[~free] = 0.0
                gx[~free] = 0.0
                Hxx[np.diag_indices(D)] += _DAMPING * np.diag(Hxx) + 1.0
                back = np.linalg.solve(Hxx, np.column_stack([Hxs, gx]))
                N += np.einsum("mri,mrs,msj->ij", to_shape, A, to_shape) - Hxs.T @ back[:, :-1]
                r += np.einsum("mri,mr->i", to_shape, b) - Hxs.T @ back[:, -1]
                steps.append(back)
            d = np.zeros_like(theta)
            d[is_free] = -np.linalg.solve(N[np.ix_(is_free, is_free)], r[is_free])
            theta = theta + d
            for f, back in enumerate(steps):
                x[f] = np.clip(x[f] - back[:, -1] - back[:, :-1] @ d, layout.lower, layout.upper)
    fitted, placed = shaped(theta)
    return Bundle(fitted, placed, x, cost)


def _worn(problem: BundleProblem, body: Body, markers: Markers) -> BundleProblem:
    """The problem with another body, and its markers there."""
    return replace(problem, body=body, markers=markers)  # type: ignore[type-var]


def _shape_jacobian(
    fitted: Body, placed: Markers, markers: Markers, theta: Array, group: NDArray[np.int64], S: int, R: Array
) -> Array:
    """Derivatives (M, 3, S + 3 M) of the markers by size, stretches and offsets."""
    M = len(placed)
    out = np.zeros((M, 3, S + 3 * M))
    s = np.exp(theta[0] + theta[1:S].reshape(-1, 3))[group]
    for m in range(M):
        j = int(placed.joint[m])
        out[m, :, S + 3 * m : S + 3 * m + 3] = R[j]
        columns = 1 + 3 * group[j] + np.arange(3)
        out[m][:, columns] += R[j] * (markers.offset[m] * s[j])
        while fitted.parent[j] >= 0:
            p = int(fitted.parent[j])
            columns = 1 + 3 * group[p] + np.arange(3)
            out[m][:, columns] += R[p] * fitted.offset[j]
            j = p
    out[:, :, 0] = out[:, :, 1:S].sum(axis=2)
    return out
