"""Frame evidence: what a follower asks of one frame, whatever the frame shows, and the observation that gives it.

A new kind of evidence is one class that answers `FrameEvidence` and one that answers `Observation`
(docs/add-evidence.md); nothing else of the room has to know it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body
from mocap.data.problem import ArticulatedProblem
from mocap.filters import FilterSettings, filter_settings
from mocap.filters.scout import Bonus
from mocap.pose.settings import PoseSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PersonTools:
    """What stays the same for one person over a clip, whatever it is seen by."""

    body: Body
    fps: float
    settings: PoseSettings
    n_threads: int

    @property
    def marker_offsets(self) -> Array | None:
        """Where markers or keypoints sit on this person, (M, 3) m in the joints' frames; None without any."""
        return None

    @property
    def noise_std(self) -> Array:
        """(D,) standard deviation per frame: half of the largest expected movement (CF 3.2.2)."""
        return 0.5 * self.body.max_speed / self.fps * self.settings.noise_scale

    @property
    def is_searched(self) -> NDArray[np.bool_]:
        """(D,) bool, columns in which filters and searches draw poses."""
        return np.ones(self.body.layout.n_columns, dtype=np.bool_)

    def filter_settings(self) -> FilterSettings:
        """Settings of the chosen filter on this body."""
        noise = np.where(self.is_searched, self.noise_std, 0.0)
        return filter_settings(self.settings.filter, self.body.layout, noise)

    def brisk(self, n_layers: int, n_particles: int, stride: int = 1, **settings: Any) -> Self:
        """The tools for a brief look at every `stride`-th frame: fewer particles, no search for what is lost."""
        budget = replace(self.settings.filter, n_layers=n_layers, n_particles=n_particles)
        brief = replace(self.settings, filter=budget, look_again=False, search_every_frames=1, **settings)
        return replace(self, fps=self.fps / stride, settings=brief)


@dataclass(frozen=True, eq=False)
class FrameFit:
    """How one state fits its frame.

    information : (D, D) inverse covariance of a refined state, 0 where there is none.  misfit : (P,) nats >= 0, how
    badly every part fits.  unexplained : share of the data that lies far from the body.  observed, judged : (M,) bool,
    of every landmark: whether it was seen, and whether it could have been.  unseen_std : (M,) m, what landmarks may be
    off that nothing but a usual pose has placed.
    """

    information: Array
    misfit: Array
    unexplained: float
    log_likelihood: float
    observed: NDArray[np.bool_]
    judged: NDArray[np.bool_]
    unseen_std: Array | float = 0.0


class FrameEvidence(Protocol):
    """One person in one frame.

    Data may have no say: what no camera can see must leave `evidence` as it is (unknown is not empty), lowers
    `information`, and its landmarks are not `observed`.
    """

    @property
    def tools(self) -> PersonTools: ...

    @property
    def search(self) -> ArticulatedProblem:
        """The problem on which the filter proposes poses."""
        ...

    @property
    def n_cameras(self) -> int:
        """How many cameras show the person."""
        ...

    @property
    def grain_m(self) -> float:
        """Standard deviation of what the data resolve, added to the particles' spread."""
        ...

    def evidence(self, states: Sequence[Array] | Array) -> Array:
        """How well K states explain the frame, (K,) nats."""
        ...

    def all_refined(self, states: Sequence[Array], n_iterations: int | None = None) -> list[Array]:
        """Each of several states (D,) moved to a nearby minimum of the residuals."""
        ...

    def limb_terms(self, state: Array) -> list[Bonus]:
        """What speaks for other places of a limb than the likelihood: functions of (particles (N, D), parts of the
        limb) that give (N,) nats, 0 for the given state (D,)."""
        ...

    def limb_misfits(self, state: Array) -> dict[int, float]:
        """How badly each limb fits, by its first part, nats >= 0; empty for evidence that knows no parts."""
        ...

    def fit(self, state: Array, kept_parts: NDArray[np.bool_] | None = None) -> FrameFit:
        """How a settled state fits.  kept_parts : (P,) that the filter has not lost, None = it does not judge."""
        ...


class WholeBodyEvidence(FrameEvidence, Protocol):
    """Evidence in which a whole pose can be looked for, with nothing known but that the person is there."""

    @property
    def places(self) -> Array:
        """Points (N, 3) m where the person is: candidates of a first pose are put there."""
        ...

    @property
    def coarse(self) -> WholeBodyEvidence:
        """The same, cheaper: for brief attempts."""
        ...

    @property
    def on_one_thread(self) -> WholeBodyEvidence:
        """The same for a caller that is one of several threads."""
        ...

    def log_likelihood(self, states: Sequence[Array] | Array) -> Array:
        """Whether K states lie in the data, (K,) nats."""
        ...

    def misfit(self, states: Sequence[Array] | Array) -> Array:
        """What the likelihood does not ask of K states, (K,) nats: `evidence` is the one less the other."""
        ...


class Observation(Protocol):
    """What is seen of one person over a clip."""

    @property
    def tools(self) -> PersonTools: ...

    def prepare(self, frame: int) -> Any | None:
        """All that can be made of a frame before its turn, perhaps on another thread; None = too little is seen."""
        ...

    def evidence(self, prepared: Any) -> FrameEvidence:
        """What poses are judged by in a prepared frame, with all that has been learnt until now."""
        ...

    def learn(self, evidence: FrameEvidence, state: Array) -> None:
        """Take in a frame under its settled pose (D,)."""
        ...


@dataclass(frozen=True, eq=False)
class PersonClip:
    """One person over the frames of its track.

    frames : (T,) ascending.  xyz : (T, 3) m, the track; None = there is none.
    """

    person: int
    frames: NDArray[np.int64]
    xyz: Array | None
    observation: Observation

    def __len__(self) -> int:
        return len(self.frames)
