"""Deviations of landmarks: how far off each may be, from the fit of its frame, its limb's misfit and what is unseen."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body
from mocap.body.kinematics import point_jacobian
from mocap.data import StateLayout
from mocap.data.problem import limbs_of
from mocap.forks import shared_zeros
from mocap.pose.method import DeviationSettings

Array = NDArray[np.float64]


def landmark_kind(name: str) -> str:
    """`left_wrist` -> `wrist`."""
    return name.removeprefix("left_").removeprefix("right_")


@dataclass(frozen=True, eq=False)
class FrameSeries:
    """What the filter has found of one person in T frames, each on its own; no more of a frame is kept than this.

    states : (T, D).  fit_covariance : (T, M, 3, 3) m^2, of the landmarks, as the frame's own fit has it.  misfit :
    (T, P) nats >= 0, how badly every part fits the volume.  unexplained : (T,) share of the hull's surface that lies
    far from the body.  blind_std : (T,) m, what a pose that was carried on has gained since the last hull, 0 = seen.
    hidden_std : (T, M) m, the same for a landmark that too few cameras could judge while others saw the rest.
    doubtful : (T, M) bool, landmarks that another pose, which explains the frame about as well, has elsewhere.
    settled : (T, P) bool, parts whose colours the texture of the clip has compared with the frame's.
    observed, log_likelihood, ess_share : as in `PersonPoses`.
    """

    states: Array
    fit_covariance: Array
    misfit: Array
    unexplained: Array
    blind_std: Array
    hidden_std: Array
    observed: NDArray[np.bool_]
    doubtful: NDArray[np.bool_]
    settled: NDArray[np.bool_]
    log_likelihood: Array
    ess_share: Array

    @classmethod
    def of_length(cls, n: int, body: Body) -> FrameSeries:
        """Room for n frames, in which processes that are forked write too."""
        D, P, M = body.layout.n_columns, body.layout.n_parts, len(body.landmarks)
        return cls(
            states=shared_zeros((n, D)),
            fit_covariance=shared_zeros((n, M, 3, 3)),
            misfit=shared_zeros((n, P)),
            unexplained=shared_zeros((n,)),
            blind_std=shared_zeros((n,)),
            hidden_std=shared_zeros((n, M)),
            observed=shared_zeros((n, M), np.bool_),
            doubtful=shared_zeros((n, M), np.bool_),
            settled=shared_zeros((n, P), np.bool_),
            log_likelihood=shared_zeros((n,)),
            ess_share=shared_zeros((n,)),
        )

    def __len__(self) -> int:
        return len(self.states)

    def rows(self, rows: slice | NDArray[np.bool_]) -> FrameSeries:
        """Some of the frames."""
        return FrameSeries(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


def astray_variance(series: FrameSeries, settings: DeviationSettings) -> Array:
    """What any landmark may be off for other reasons than a bad fit of its limb, (T,) m^2: a hull that holds much else
    than the body, and frames without one."""
    excess = np.maximum(series.unexplained - settings.usual_unexplained, 0.0)
    return np.asarray((settings.astray_m * excess) ** 2 + series.blind_std**2)


def fallen_nats(log_likelihood: Array, usual_nats: float) -> Array:
    """By how much the likelihood of a frame lies below the person's median, beyond what is usual, (T,) nats >= 0.

    log_likelihood : (T,), NaN = nothing was seen, which says nothing here.
    """
    known = np.isfinite(log_likelihood)
    if not known.any():
        return np.zeros(len(log_likelihood))
    usual = float(np.median(log_likelihood[known])) - usual_nats
    return np.asarray(np.maximum(usual - np.where(known, log_likelihood, usual), 0.0))


def limb_misfit(layout: StateLayout, misfit: Array, most_nats: float) -> Array:
    """The misfit of every part's limb, (..., P) -> (..., P): the largest of its parts', for the root part its own.

    most_nats : a larger misfit counts as this one. An arm whose upper half is wrong is wrong at the hand too.
    """
    out = misfit.copy()
    for limb in limbs_of(layout):
        out[..., limb] = misfit[..., limb].max(axis=-1, keepdims=True)
    return np.asarray(np.minimum(out, most_nats))


def landmark_misfit(
    body: Body, series: FrameSeries, most_nats: float = DeviationSettings.most_misfit_nats
) -> Array:
    """How badly the limb of every landmark fits, (T, M) nats."""
    return limb_misfit(body.layout, series.misfit, most_nats)[:, body.landmark_parts]


def landmark_covariances(body: Body, series: FrameSeries, settings: DeviationSettings) -> Array:
    """Covariance of every landmark, (T, M, 3, 3) m^2: that of the fit of its frame, and what the fit does not know.

    That are the body's own errors, the chance that a limb which fits badly is lost (`DeviationSettings.of_landmark`), a
    hull that the body does not explain, a frame that is explained much worse than the person's others, a pose that was
    carried on and a landmark that could not be seen; of all this a share where a texture has told where a limb lies.
    """
    floor, per_nat = np.array([settings.of_landmark[landmark_kind(name)] for name in body.landmarks]).T
    misfit = landmark_misfit(body, series, settings.most_misfit_nats)
    fallen = settings.per_fallen_nat * fallen_nats(series.log_likelihood, settings.usual_fall_nats)
    of_frame = astray_variance(series, settings) + fallen**2
    own = floor**2 + (per_nat * misfit) ** 2 + of_frame[:, None] + series.hidden_std**2
    covariance = own[:, :, None, None] * np.eye(3) + series.fit_covariance
    left = np.where(settled_landmarks(body, series, settings), settings.settled, 1.0)
    return np.asarray(left[:, :, None, None] ** 2 * covariance)


def settled_landmarks(body: Body, series: FrameSeries, settings: DeviationSettings) -> NDArray[np.bool_]:
    """Landmarks of which a texture has told where they lie, (T, M)."""
    is_told = np.isin([landmark_kind(name) for name in body.landmarks], settings.settled_kinds)
    return np.asarray(is_told & series.settled[:, body.landmark_parts])


def fit_covariance(body: Body, state: Array, information: Array, settings: DeviationSettings) -> Array:
    """Covariance of the landmarks (M, 3, 3) m^2 of a state (D,) fitted to a frame, 0 where nothing was fitted.

    information : (D, D) inverse covariance of the state, 0 where there is none; what it does not tell is as wide as
    `weak_std_m` and `weak_std_rad`.
    """
    if not information.any():
        return np.zeros((len(body.landmarks), 3, 3))
    weak = np.where(body.is_position, settings.weak_std_m, settings.weak_std_rad) ** -2.0
    _, J, _ = point_jacobian(body, state, body.landmark_joint, body.landmark_offset)
    return np.asarray(np.einsum("lri,ij,lcj->lrc", J, np.linalg.inv(information + np.diag(weak)), J))


def within_limits(layout: StateLayout, covariance: Array) -> Array:
    """Covariances of states (T, D, D) in which no angle is less sure than one that may be anywhere between its limits,
    or anywhere on the circle: what nothing shows does not drift away with the time."""
    circle = 2.0 * np.pi
    width = np.where(layout.is_circular, circle, np.minimum(layout.upper - layout.lower, circle))
    spread = width / np.sqrt(12.0)
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    share = np.minimum(1.0, spread / np.maximum(std, 1e-12))
    return np.asarray(covariance * share[:, :, None] * share[:, None, :])


def widened(covariance: Array, rig_offset_m: float | Array, settings: DeviationSettings) -> Array:
    """Covariances (T, M, 3, 3) m^2 where the cameras do not agree with each other: nobody knows which are right.

    rig_offset_m : by how much their lines of sight miss each other, 0 = they agree; of the clip or of every frame (T,).
    """
    offset = np.reshape(rig_offset_m, (-1, 1, 1, 1))
    return np.asarray(covariance + (settings.per_rig_offset * offset) ** 2 * np.eye(3))


def fit_information(cost: float, normal_matrix: Array, n_points: int, correlated: float) -> Array:
    """Inverse covariance (D, D) of a fitted state from its robust cost, m^2, and Gauss-Newton matrix.

    The variance of a residual is that of this fit; `correlated` neighbouring residuals count as one.
    """
    variance = correlated * 2.0 * cost / max(n_points, 1)
    return normal_matrix / variance if variance > 0 else np.zeros_like(normal_matrix)
