"""From the poses of single frames to a motion: point estimate, uncertainty of landmarks, smoothing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body
from mocap.body.average import mean_state
from mocap.body.kinematics import point_jacobian
from mocap.data import LANDMARKS, StateLayout
from mocap.data.problem import limbs_of
from mocap.filters import FilterInfo, ParticleState
from mocap.filters.refine import RefineSettings, refine
from mocap.filters.smoother import smooth_points

Array = NDArray[np.float64]

# Standard deviation, m, of a landmark of a pose that fits perfectly, and its growth per nat of its limb's misfit:
# fitted on development scenes by `python -m eval.pose_coverage --fit`, and printed there.
UNCERTAINTY: dict[str, tuple[float, float]] = {
    "pelvis": (0.003, 0.004),
    "neck": (0.011, 0.009),
    "head": (0.009, 0.012),
    "shoulder": (0.016, 0.007),
    "elbow": (0.006, 0.006),
    "wrist": (0.004, 0.006),
    "hip": (0.015, 0.012),
    "knee": (0.009, 0.003),
    "ankle": (0.010, 0.003),
}
# Neighbouring points of hull and outlines err alike: so many of them count as one. From the jitter of the poses of
# walking people, which is this much larger than independent residuals would make it.
_CORRELATED = 2.5
_WEAK_STD = (0.3, 0.7)  # what is known of a column without data, m and rad
_MOST_MISFIT_NATS = 15.0

# The share of a hull's surface, UNEXPLAINED_M and more from the body, that is usual: clothes, the hull's own excess, a
# limb that is off. It reached 0.23 on development scenes. A hull with two persons in it has 0.5, one of three cameras
# 0.7: somewhere in there the limbs are, and by this much they may be off per share.
UNEXPLAINED_M = 0.05
USUAL_UNEXPLAINED = 0.22
_ASTRAY_M = 0.4

# The smoother: noise of a point of the body between frames, its growth per nat of misfit, and half of the largest
# expected acceleration. Chosen on development scenes: half the acceleration blurs a jog, twice leaves jitter.
_NOISE_M = 0.006
_NOISE_PER_NAT_M = 0.007
_ACCELERATION_M_S2 = 25.0
_HANDLE_M = 0.15  # arm of the points that hold a joint's direction
_IK_STEPS = 10


def landmark_kind(name: str) -> str:
    """`left_wrist` -> `wrist`."""
    return name.removeprefix("left_").removeprefix("right_")


def point_estimate(body: Body, particles: ParticleState, info: FilterInfo, kind: str = "mean") -> Array:
    """One state (D,) for a frame's particles.

    kind : `mean` = the filter's own, weighted over angles (CF 3.19); `rotation_mean` = weighted over rotations;
    `map` = the particle of the highest likelihood, the maximum a posteriori under a flat prior.
    """
    if kind == "map":
        return info.best
    if kind == "rotation_mean":
        return mean_state(body, particles.particles, particles.weights, info.estimate)
    return info.estimate


@dataclass(frozen=True, eq=False)
class FrameSeries:
    """What the filter has found of one person in T frames, each on its own.

    states : (T, D).  information : (T, D, D) inverse covariance of the refined state, 0 where there is none.
    spread : (T, 15, 3, 3) m^2, of the particles about the estimate.  misfit : (T, P) nats >= 0, how badly every part
    fits the volume.  unexplained : (T,) share of the hull's surface that lies far from the body.  blind_std : (T,) m,
    what a pose that was carried on has gained since the last hull, 0 = seen.
    """

    states: Array
    information: Array
    spread: Array
    misfit: Array
    unexplained: Array
    blind_std: Array

    def __len__(self) -> int:
        return len(self.states)

    @cached_property
    def astray_variance(self) -> Array:
        """What any landmark may be off for other reasons than a bad fit of its limb, (T,) m^2: a hull that holds much
        else than the body, and frames without one."""
        excess = np.maximum(self.unexplained - USUAL_UNEXPLAINED, 0.0)
        return np.asarray((_ASTRAY_M * excess) ** 2 + self.blind_std**2)


def landmark_parts(body: Body) -> NDArray[np.int64]:
    """The part at every landmark's joint, (15,)."""
    return _part_of_joint(body)[body.landmark_joint]


def limb_misfit(layout: StateLayout, misfit: Array) -> Array:
    """The misfit of every part's limb, (..., P) -> (..., P): the largest of its parts', for the root part its own.

    An arm whose upper half is wrong is wrong at the hand too.
    """
    out = misfit.copy()
    for limb in limbs_of(layout):
        out[..., limb] = misfit[..., limb].max(axis=-1, keepdims=True)
    return np.asarray(np.minimum(out, _MOST_MISFIT_NATS))


def landmark_misfit(body: Body, series: FrameSeries) -> Array:
    """How badly the limb of every landmark fits, (T, 15) nats."""
    return limb_misfit(body.layout, series.misfit)[:, landmark_parts(body)]


def landmark_covariances(body: Body, series: FrameSeries, *, is_refined: bool) -> Array:
    """Covariance of every landmark, (T, 15, 3, 3) m^2.

    is_refined : the covariance of the fit, from its normal matrix, and what the fit does not know: the body's own
    errors, and the chance that a limb which fits badly is lost (`UNCERTAINTY`). Otherwise the spread of the particles
    takes the place of the fit's. A hull that the body does not explain, and a pose that was carried on, add to both.
    """
    floor, per_nat = np.array([UNCERTAINTY[landmark_kind(name)] for name in LANDMARKS]).T
    misfit = landmark_misfit(body, series)
    own = floor**2 + (per_nat * misfit) ** 2 + series.astray_variance[:, None]
    out = own[:, :, None, None] * np.eye(3)
    if not is_refined:
        return np.asarray(out + series.spread)
    weak = np.where(np.arange(body.layout.n_columns) < 3, *_WEAK_STD) ** -2.0
    for i in range(len(series)):
        if series.information[i].any():
            _, J, _ = point_jacobian(body, series.states[i], body.landmark_joint, body.landmark_offset)
            state = np.linalg.inv(series.information[i] + np.diag(weak))
            out[i] += np.einsum("lri,ij,lcj->lrc", J, state, J)
    return np.asarray(out)


def fit_information(cost: float, normal_matrix: Array, n_points: int) -> Array:
    """Inverse covariance (D, D) of a fitted state from its robust cost, m^2, and Gauss-Newton matrix.

    The variance of a residual is that of this fit, and neighbouring residuals are not independent.
    """
    variance = _CORRELATED * 2.0 * cost / max(n_points, 1)
    return normal_matrix / variance if variance > 0 else np.zeros_like(normal_matrix)


def smooth_motion(body: Body, series: FrameSeries, fps: float, lag: int) -> Array:
    """States (T, D) smoothed over time, inside the limits; every frame looks at `lag` later ones.

    Points of the body are smoothed in space, not angles: near a shoulder's singularity equal poses have angles far
    apart. A point of a limb that fits badly counts less, one that jumps and comes back counts little. Then the body is
    fitted to the smoothed points.
    """
    joint, offset = _handles(body)
    part = _part_of_joint(body)[joint]
    misfit = limb_misfit(body.layout, series.misfit)[:, part]
    variance = _NOISE_M**2 + (_NOISE_PER_NAT_M * misfit) ** 2 + series.astray_variance[:, None]
    points = np.stack([point_jacobian(body, s, joint, offset)[0] for s in series.states])
    push = np.full(len(joint), _ACCELERATION_M_S2 / fps**2)
    smoothed, _, _ = smooth_points(points, variance, push, lag=lag)
    states = np.empty_like(series.states)
    settings = RefineSettings(
        prior_std=np.full(body.layout.n_columns, 1e3), residual_std_m=1.0, n_iterations=_IK_STEPS
    )
    for i in range(len(series)):
        problem = _PointFit(body, joint, offset, smoothed[i])
        starts = [series.states[i], *([states[i - 1]] if i else [])]
        start = min(starts, key=problem.cost)
        states[i] = refine(problem, start, settings)[0]
    return states


@dataclass(frozen=True, eq=False)
class _PointFit:
    """A body fitted to places (K, 3) m of points on its joints: implements `ResidualProblem`."""

    body: Body
    joint: NDArray[np.int64]
    offset: Array
    places: Array

    @cached_property
    def layout(self) -> StateLayout:
        return self.body.layout

    def cost(self, state: Array) -> float:
        points, _, _ = point_jacobian(self.body, state, self.joint, self.offset)
        return 0.5 * float(((points - self.places) ** 2).sum())

    def normal_equations(self, state: Array) -> tuple[float, Array, Array]:
        points, J, _ = point_jacobian(self.body, state, self.joint, self.offset)
        r = (points - self.places).ravel()
        A = J.reshape(len(r), -1)
        return 0.5 * float(r @ r), A.T @ A, A.T @ r


def _handles(body: Body) -> tuple[NDArray[np.int64], Array]:
    """Points that say where the whole body is: the landmarks, and two for the direction of every joint that turns about
    more than one axis.  Returns joints (K,) and offsets (K, 3) m in their frames."""
    turning = [j for j in range(len(body.joints)) if (body.dof_joint == j).sum() > 1]
    handles = _HANDLE_M * np.eye(3)[[0, 1]]
    joint = np.concatenate([body.landmark_joint, np.repeat(turning, 2)]).astype(np.int64)
    return joint, np.concatenate([body.landmark_offset, *([handles] * len(turning))])


def _part_of_joint(body: Body) -> NDArray[np.int64]:
    """The last part with flesh on every joint, (J,); the root part for a joint without flesh."""
    found = dict(zip(body.cones.joint.tolist(), body.cones.part.tolist(), strict=True))
    return np.array([found.get(j, 0) for j in range(len(body.joints))], dtype=np.int64)
