"""Keypoints as evidence: the named points that cameras see of one person, and what they say of a pose."""

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
from mocap.geometry.triangulation import triangulate_agreeing
from mocap.likelihood.keypoints import KeypointProblem, KeypointSettings, KeypointViews
from mocap.likelihood.residuals.total import SumProblem
from mocap.pose.evidence import FrameEvidence, FrameFit, PersonTools
from mocap.pose.method import KeypointPoseSettings

Array = NDArray[np.float64]
ViewsOf = Callable[[int], KeypointViews | None]


@dataclass(frozen=True, eq=False)
class KeypointTools(PersonTools):
    """What stays the same for one person over a clip of keypoints.  markers : where they sit on the body."""

    markers: Markers

    @property
    def marker_offsets(self) -> Array | None:
        return self.markers.offset

    @property
    def numbers(self) -> KeypointPoseSettings:
        return self.settings.method.keypoints

    @property
    def prior_std(self) -> Array:
        """(D,) how far a refinement may be expected to move, m and rad: its weak prior."""
        numbers = self.settings.method.evidence
        return np.where(self.body.is_position, numbers.refine_std_m, numbers.refine_std_rad)

    @cached_property
    def near(self) -> NDArray[np.bool_]:
        """Whether a keypoint shows a landmark, because it sits near it at rest: (M, K)."""
        rest = neutral_state(self.body)[None]
        landmarks, points = landmarks_of(self.body, rest)[0], marker_positions(self.body, self.markers, rest)
        d = np.linalg.norm(landmarks[:, None] - points, axis=2)
        return np.asarray(d <= np.maximum(self.numbers.near_landmark_m, d.min(axis=1, keepdims=True)))

    def problem(self, views: KeypointViews, scale: float | None = None) -> KeypointProblem:
        """The problem of one frame.  scale : of the robust cost, None = the usual one."""
        settings = KeypointSettings(self.numbers.scale if scale is None else scale, self.numbers.worth)
        return KeypointProblem(self.body, self.markers, views, settings)


@dataclass(frozen=True, eq=False)
class KeypointEvidence:
    """One person in one frame of keypoints. Implements `WholeBodyEvidence`.

    is_coarse : for brief attempts, with a wide robust cost that pulls from afar.
    """

    tools: KeypointTools
    views: KeypointViews
    is_coarse: bool = False

    @cached_property
    def search(self) -> KeypointProblem:
        """The filter's problem."""
        return self.tools.problem(self.views, self.tools.numbers.wide_scale if self.is_coarse else None)

    @property
    def n_cameras(self) -> int:
        """Views that have a say on the person."""
        return int(self.views.has_say.any(axis=1).sum())

    @property
    def grain_m(self) -> float:
        """Keypoints resolve more than the filter's particles do."""
        return 0.0

    @cached_property
    def places(self) -> Array:
        """The person's points (N, 3) m on which views agree; where no two do, the world's origin, where no candidate
        can win."""
        found = points_of(self.views, self.tools.numbers)
        known = np.isfinite(found).all(axis=1)
        return found[known] if known.any() else np.zeros((1, 3))

    @cached_property
    def coarse(self) -> KeypointEvidence:
        """The same, pulling from afar."""
        return replace(self, is_coarse=True)

    @property
    def on_one_thread(self) -> KeypointEvidence:
        """Itself: it uses one."""
        return self

    def log_likelihood(self, states: Sequence[Array] | Array) -> Array:
        """How well K states explain the keypoints, (K,) nats."""
        return np.asarray(self.search.log_likelihood(np.stack(list(states))).sum(axis=1))

    def misfit(self, states: Sequence[Array] | Array) -> Array:
        """What unusual angles cost K states, (K,) nats."""
        return self.log_likelihood(states) - self.evidence(states)

    def evidence(self, states: Sequence[Array] | Array) -> Array:
        """What K states cost, less than nothing: (K,) nats."""
        return self.search.evidence(np.stack(list(states)))

    def all_refined(self, states: Sequence[Array], n_iterations: int | None = None) -> list[Array]:
        """Each of several states (D,) refined: with a wide robust cost, then with the usual one."""
        n = self.tools.numbers.n_iterations if n_iterations is None else n_iterations
        settings = RefineSettings(self.tools.prior_std, residual_std_m=1.0, n_iterations=n)
        wide = self.tools.problem(self.views, self.tools.numbers.wide_scale)
        out = []
        for state in states:
            found, _ = refine(wide, state, settings)
            out.append(found if self.is_coarse else refine(self.search, found, settings)[0])
        return out

    def refined_with(self, state: Array, other: ResidualProblem) -> Array:
        """A state (D,) moved to a nearby minimum of the keypoints' cost and of another one, nats."""
        n = self.tools.numbers.n_iterations
        both = SumProblem(((self.search.settings.worth, self.search), (1.0, other)))
        return refine(both, state, RefineSettings(self.tools.prior_std, residual_std_m=1.0, n_iterations=n))[
            0
        ]

    def limb_terms(self, state: Array) -> list[Bonus]:
        """Keypoints have no other word for a limb than their likelihood."""
        return []

    def limb_misfits(self, state: Array) -> dict[int, float]:
        """Limbs are not searched for: their keypoints have names."""
        return {}

    def _misfit(self, state: Array) -> Array:
        """Cost of every part beyond what noise costs, a nat for each view of a keypoint, (P,) nats."""
        part = self.tools.markers.part
        cost = self.search.costs(state[None])[0] - self.views.n_views
        out = np.zeros(self.tools.body.layout.n_parts)
        np.add.at(out, part, cost)
        return self.search.settings.worth * np.maximum(out, 0.0)

    def fit(self, state: Array, kept_parts: NDArray[np.bool_] | None = None) -> FrameFit:
        """How a state (D,) fits; a landmark is observed when two views or more see a keypoint near it where it is."""
        _, information, _ = self.search.normal_equations(state)
        usual = self.search.usual_information
        # How a neck usually is tells of a second, not of every frame anew: heads stay as they are.
        each = np.where(np.isinf(self.tools.body.usual_std), usual / self.tools.fps, usual)
        n_near = self._views_near(state)
        observed = np.asarray((self.tools.near & (n_near >= 2)).any(axis=1))
        judged = np.asarray((self.tools.near & (self.views.n_views >= 2)).any(axis=1))
        return FrameFit(
            information=self.search.settings.worth * (information - np.diag(usual)) + np.diag(each),
            misfit=self._misfit(state),
            unexplained=0.0,
            log_likelihood=float(self.log_likelihood([state])[0]),
            observed=observed,
            judged=judged,
        )

    def _views_near(self, state: Array) -> NDArray[np.int64]:
        """Views whose keypoint lies within the robust scale of the body's, (K,)."""
        points = marker_positions(self.tools.body, self.tools.markers, state[None])[0]
        return np.asarray((self._errors(points) <= self.search.settings.scale).sum(axis=0))

    def _errors(self, points: Array) -> Array:
        """Distance (C, K) of the keypoints from the images of points (K, 3), in deviations; inf where there is none."""
        P, uv = self.views.P, self.views.uv
        x = np.einsum("crk,nk->cnr", P[:, :, :3], points) + P[:, None, :, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.linalg.norm(x[..., :2] / x[..., 2:] - uv, axis=2) / self.views.noise_px
        return np.where(np.isfinite(error), error, np.inf)


def points_of(views: KeypointViews, numbers: KeypointPoseSettings) -> Array:
    """The points (K, 3) m on which the views agree, NaN where fewer than two do."""
    return triangulate_agreeing(views.P, views.uv, numbers.scale * views.noise_px).points


def agreeing(views: KeypointViews, numbers: KeypointPoseSettings) -> KeypointViews:
    """The views of every keypoint that agree on a point, without those that do not; of a keypoint on which no two views
    agree all of them."""
    agrees = triangulate_agreeing(views.P, views.uv, numbers.scale * views.noise_px).agrees
    kept = agrees | ~agrees.any(axis=0)
    return replace(views, uv=np.where(kept[..., None], views.uv, np.nan))


@dataclass(frozen=True, eq=False)
class KeypointObservation:
    """The keypoints of one person over a clip. Implements `Observation`."""

    tools: KeypointTools
    views_of: ViewsOf

    def prepare(self, frame: int) -> KeypointViews | None:
        """The keypoints of a frame, None where they are too few for a body."""
        views = self.views_of(frame)
        if views is None or int((views.n_views >= 2).sum()) < self.tools.numbers.min_points:
            return None
        return views

    def evidence(self, prepared: KeypointViews) -> KeypointEvidence:
        """What poses are judged by in a prepared frame."""
        return KeypointEvidence(self.tools, prepared)

    def learn(self, evidence: FrameEvidence, state: Array) -> None:
        """A frame of keypoints teaches nothing: body and offsets are fitted beforehand."""
