"""Deviations of landmarks: how far off each may be, from the fit of its frame, its limb's misfit and what is unseen."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body
from mocap.body.kinematics import point_jacobian
from mocap.data import StateLayout
from mocap.data.problem import limbs_of
from mocap.pose.method import DeviationSettings

Array = NDArray[np.float64]


def landmark_kind(name: str) -> str:
    """`left_wrist` -> `wrist`."""
    return name.removeprefix("left_").removeprefix("right_")


@dataclass(frozen=True, eq=False)
class FrameSeries:
    """What the filter has found of one person in T frames, each on its own.

    states : (T, D).  information : (T, D, D) inverse covariance of the refined state, 0 where there is none.
    spread : (T, M, 3, 3) m^2, of the particles about the estimate.  misfit : (T, P) nats >= 0, how badly every part
    fits the volume.  unexplained : (T,) share of the hull's surface that lies far from the body.  blind_std : (T,) m,
    what a pose that was carried on has gained since the last hull, 0 = seen.  hidden_std : (T, M) m, the same for a
    landmark that too few cameras could judge while others saw the rest.
    """

    states: Array
    information: Array
    spread: Array
    misfit: Array
    unexplained: Array
    blind_std: Array
    hidden_std: Array

    def __len__(self) -> int:
        return len(self.states)

    def rows(self, rows: slice) -> FrameSeries:
        """Some of the frames."""
        return FrameSeries(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


def astray_variance(series: FrameSeries, settings: DeviationSettings) -> Array:
    """What any landmark may be off for other reasons than a bad fit of its limb, (T,) m^2: a hull that holds much else
    than the body, and frames without one."""
    excess = np.maximum(series.unexplained - settings.usual_unexplained, 0.0)
    return np.asarray((settings.astray_m * excess) ** 2 + series.blind_std**2)


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


def landmark_covariances(
    body: Body, series: FrameSeries, settings: DeviationSettings, *, is_refined: bool
) -> Array:
    """Covariance of every landmark, (T, M, 3, 3) m^2.

    is_refined : the covariance of the fit, from its normal matrix, and what the fit does not know: the body's own
    errors, and the chance that a limb which fits badly is lost (`DeviationSettings.of_landmark`). Otherwise the spread
    of the particles takes the place of the fit's. A hull that the body does not explain, a pose that was carried on and
    a landmark that could not be seen add to both.
    """
    floor, per_nat = np.array([settings.of_landmark[landmark_kind(name)] for name in body.landmarks]).T
    misfit = landmark_misfit(body, series, settings.most_misfit_nats)
    own = (
        floor**2 + (per_nat * misfit) ** 2 + astray_variance(series, settings)[:, None] + series.hidden_std**2
    )
    out = own[:, :, None, None] * np.eye(3)
    if not is_refined:
        return np.asarray(out + series.spread)
    weak = np.where(body.is_position, settings.weak_std_m, settings.weak_std_rad) ** -2.0
    for i in range(len(series)):
        if series.information[i].any():
            _, J, _ = point_jacobian(body, series.states[i], body.landmark_joint, body.landmark_offset)
            state = np.linalg.inv(series.information[i] + np.diag(weak))
            out[i] += np.einsum("lri,ij,lcj->lrc", J, state, J)
    return np.asarray(out)


def widened(covariance: Array, rig_offset_m: float, settings: DeviationSettings) -> Array:
    """Covariances (T, M, 3, 3) m^2 where the cameras do not agree with each other: nobody knows which are right.

    rig_offset_m : by how much their lines of sight miss each other, 0 = they agree.
    """
    return np.asarray(covariance + (settings.per_rig_offset * rig_offset_m) ** 2 * np.eye(3))


def fit_information(cost: float, normal_matrix: Array, n_points: int, correlated: float) -> Array:
    """Inverse covariance (D, D) of a fitted state from its robust cost, m^2, and Gauss-Newton matrix.

    The variance of a residual is that of this fit; `correlated` neighbouring residuals count as one.
    """
    variance = correlated * 2.0 * cost / max(n_points, 1)
    return normal_matrix / variance if variance > 0 else np.zeros_like(normal_matrix)
