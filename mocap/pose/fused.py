"""Volumes and keypoints together: evidence is the sum of what both say of a pose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.body import landmarks_of
from mocap.body.keypoints import place_keypoints
from mocap.data.problem import ResidualProblem
from mocap.filters.refine import RefineSettings, refine
from mocap.filters.scout import Bonus
from mocap.likelihood.keypoints import KeypointProblem, KeypointSettings, KeypointViews
from mocap.likelihood.residuals.total import SumProblem
from mocap.likelihood.voxels import VoxelProblem
from mocap.pose.evidence import FrameFit
from mocap.pose.keypoint import agreeing
from mocap.pose.volume import PreparedHull, VolumeEvidence, VolumeObservation, VolumeTools

Array = NDArray[np.float64]
ViewsOf = Callable[[int], KeypointViews | None]


@dataclass(frozen=True, eq=False)
class FusedSearch(VoxelProblem):
    """The filter's problem: the likelihood of the volume times that of the keypoints."""

    keypoints: KeypointProblem | None = None

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        """As of the volume; what keypoints say is added to the parts that they sit on."""
        own = super().log_likelihood(particles, parts, given)
        if self.keypoints is None:
            return own
        nats = self.keypoints.log_likelihood(particles, parts)
        return own + (nats if own.shape[1] == nats.shape[1] else nats.sum(axis=1, keepdims=True))


@dataclass(frozen=True, eq=False)
class FusedEvidence(VolumeEvidence):
    """One person in one frame of volumes and keypoints. Implements `WholeBodyEvidence`."""

    views: KeypointViews | None = None

    @cached_property
    def keypoints(self) -> KeypointProblem | None:
        """The problem of the keypoints alone; None in a frame without."""
        if self.views is None:
            return None
        numbers = self.tools.settings.method.keypoints
        # What angles are usual is part of the volume's residuals already.
        settings = KeypointSettings(numbers.fused_scale, numbers.fused_worth, usual_weight=0.0)
        views = agreeing(self.views, numbers)
        tightness = min(1.0, len(views.P) / numbers.tight_cameras)
        views = replace(views, noise_px=numbers.fused_noise * tightness * views.noise_px)
        return KeypointProblem(self.tools.body, place_keypoints(self.tools.body), views, settings)

    @cached_property
    def search(self) -> VoxelProblem:
        own = self.voxels
        return FusedSearch(
            own.body, own.table, own.volume, self.tools.likelihood, own.n_threads, self.keypoints
        )

    @cached_property
    def coarse(self) -> VolumeEvidence:
        """The same for brief attempts: the keypoints tell left from right."""
        return _fused(super().coarse, self.views)

    def with_tools(self, tools: VolumeTools) -> VolumeEvidence:
        return _fused(super().with_tools(tools), self.views)

    def misfit(self, states: Sequence[Array] | Array) -> Array:
        """What the volume's likelihood does not ask, and what the keypoints cost, (K,) nats."""
        nats = super().misfit(states)
        if self.keypoints is None:
            return nats
        return np.asarray(nats - self.keypoints.evidence(np.stack(list(states))))

    def all_refined(self, states: Sequence[Array], n_iterations: int | None = None) -> list[Array]:
        """Each of several states (D,) moved to a nearby minimum of both kinds of residuals.

        Keypoints far from a limb have lost their pull: where they alone, pulling from afar, move a landmark elsewhere,
        the descent is tried from there as well.
        """
        if self.keypoints is None or not len(states):
            return super().all_refined(states, n_iterations)
        settings = self.tools.refining(n_iterations)
        return [self._refined(state, settings) for state in states]

    def _refined(self, state: Array, settings: RefineSettings) -> Array:
        assert self.keypoints is not None
        numbers = self.tools.settings.method.keypoints
        near, _ = refine(self._both, state, settings)
        wide = replace(self.keypoints, settings=replace(self.keypoints.settings, scale=numbers.wide_scale))
        pulled, _ = refine(wide, near, replace(settings, residual_std_m=1.0))
        landmarks = landmarks_of(self.tools.body, np.stack([near, pulled]))
        if np.linalg.norm(landmarks[0] - landmarks[1], axis=1).max() < numbers.elsewhere_m:
            return near
        far, _ = refine(self._both, pulled, settings)
        both = self.evidence([near, far])
        return far if both[1] > both[0] else near

    @cached_property
    def _both(self) -> SumProblem:
        return SumProblem(self.weighted_residuals)

    @property
    def weighted_residuals(self) -> tuple[tuple[float, ResidualProblem], ...]:
        """Residuals of the volume and of independent keypoints."""
        own = super().weighted_residuals
        if self.keypoints is None:
            return own
        worth = self.tools.settings.method.keypoints.fused_worth
        return (*own, (worth * self.m2_per_nat, self.keypoints))

    def limb_terms(self, state: Array) -> list[Bonus]:
        """What the volume and the keypoints say for other places of a limb."""
        terms = super().limb_terms(state)
        if self.keypoints is not None:
            terms.append(partial(self._keypoint_nats, self.keypoints.log_likelihood(state[None])[0]))
        return terms

    def _keypoint_nats(self, now: Array, particles: Array, limb: list[int]) -> Array:
        assert self.keypoints is not None
        return np.asarray(self.keypoints.log_likelihood(particles, limb).sum(axis=1) - now[limb].sum())

    def fit(self, state: Array, kept_parts: NDArray[np.bool_] | None = None) -> FrameFit:
        """As of the volume, with the information of both."""
        found = super().fit(state, kept_parts)
        if self.keypoints is None or not self.tools.settings.refine:
            return found
        worth = self.keypoints.settings.worth
        return replace(
            found, information=found.information + worth * self.keypoints.normal_equations(state)[1]
        )


def _fused(evidence: VolumeEvidence, views: KeypointViews | None) -> FusedEvidence:
    """The evidence of a volume with that of keypoints beside it."""
    own: dict[str, Any] = {f.name: getattr(evidence, f.name) for f in fields(VolumeEvidence)}
    return FusedEvidence(**own, views=views)


@dataclass(eq=False)
class FusedObservation(VolumeObservation):
    """The hulls and keypoints of one person over a clip. Implements `Observation`.

    views_of : frame -> what the cameras' keypoints say of the person, None = nothing.
    """

    views_of: ViewsOf = lambda frame: None

    def prepare(self, frame: int) -> tuple[PreparedHull, KeypointViews | None] | None:  # type: ignore[override]
        """Hull and keypoints of a frame, None where there is too little of a hull."""
        hull = super().prepare(frame)
        return None if hull is None else (hull, self.views_of(frame))

    def evidence(self, prepared: tuple[PreparedHull, KeypointViews | None]) -> VolumeEvidence:  # type: ignore[override]
        hull, views = prepared
        return _fused(super().evidence(hull), views)
