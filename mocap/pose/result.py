"""Poses of one person over a clip, and what the user has to know of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import frames_in_words
from mocap.body import Body
from mocap.body.initial import HeightEstimate
from mocap.data import LANDMARKS, Motion, landmark_names
from mocap.metrics.smoothness import smoothness_scores
from mocap.pose.deviation import FrameSeries
from mocap.pose.evidence import PersonTools

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PersonPoses:
    """The result for one person.

    frames : (T,).  states : (T, D).  landmarks : (T, M, 3) m, in the order of the body's.  landmark_covariance :
    (T, M, 3, 3) m^2.  observed : (T, M) bool.
    log_likelihood, ess_share : (T,), of the poses before they were smoothed.  start_frame : where the first pose was
    found.  first_pose : its name.  series : what the frames gave one by one, before smoothing; None = not kept.
    """

    person: int
    body: Body
    height: HeightEstimate
    frames: NDArray[np.int64]
    states: Array
    landmarks: Array
    landmark_covariance: Array
    observed: NDArray[np.bool_]
    log_likelihood: Array
    ess_share: Array
    start_frame: int
    first_pose: str
    warnings: tuple[str, ...] = field(default=())
    series: FrameSeries | None = None


@dataclass(frozen=True, eq=False)
class FollowedPerson:
    """What the filter has given of one person, frame by frame: nothing is smoothed yet.

    tools : the person's body, and the settings with which it was followed.  frames : (T,).  is_facing_open : two first
    poses explained the volumes almost equally well.  n_usable : frames in which enough was seen to judge a pose.
    start_frame and first_pose as in `PersonPoses`.  information : (T, D, D), inverse covariance of every frame's state,
    0 where nothing was seen; None where smoothing does not ask for it.  warnings : what following has found out.
    thing : what is said of it where it was tracked as a person and is none; empty for persons.
    """

    person: int
    tools: PersonTools
    height: HeightEstimate
    frames: NDArray[np.int64]
    series: FrameSeries
    is_facing_open: bool
    n_usable: int
    start_frame: int
    first_pose: str
    information: Array | None = None
    warnings: tuple[str, ...] = ()
    thing: str = ""

    @property
    def body(self) -> Body:
        return self.tools.body

    def rows(self, rows: NDArray[np.bool_]) -> FollowedPerson:
        """Some of the frames, (T,) bool; all of them where something was seen."""
        information = None if self.information is None else self.information[rows]
        return replace(self, frames=self.frames[rows], series=self.series.rows(rows), information=information)


def motion_of(poses: PersonPoses, fps: float) -> Motion:
    """The landmarks of one person with their standard deviations."""
    return Motion(
        person=poses.person,
        frames=poses.frames,
        time_s=poses.frames / fps,
        landmarks=poses.landmarks,
        std=np.sqrt(np.diagonal(poses.landmark_covariance, axis1=2, axis2=3)),
        observed=poses.observed,
    )


def motion_numbers(poses: PersonPoses, fps: float) -> dict[str, float | None]:
    """How much the landmarks tremble (m/s^3, None for a clip of fewer than four frames) and how much was observed."""
    fifteen = poses.landmarks[:, : len(LANDMARKS)]
    jitter = smoothness_scores(fifteen, fifteen, poses.frames, fps).jitter_estimate_m_s3
    return {
        "jitter_m_s3": None if jitter is None else round(jitter, 1),
        "observed_percent": round(100.0 * float(poses.observed.mean()), 1),
    }


def warnings_of_volumes(
    person: int,
    *,
    n_blind: int,
    series: FrameSeries,
    frames: NDArray[np.int64],
    height: HeightEstimate,
    is_facing_open: bool,
    crowded_share: float,
) -> list[str]:
    """What the user has to know of poses found in volumes.

    n_blind : frames without a usable hull.  is_facing_open : two first poses explained the volumes almost equally well.
    crowded_share : share of the hull's surface that nothing explains, from which poses are uncertain.
    """
    n_total, doubtful = len(series), series.doubtful
    warnings: list[str] = []
    if n_blind:
        warnings.append(
            f"person {person}: no usable volume in {n_blind} of {n_total} frames; the last pose was carried on and "
            "its landmarks are marked as not observed"
        )
    n_crowded = int((series.unexplained > crowded_share).sum())
    if n_crowded:
        warnings.append(
            f"person {person}: in {n_crowded} of {n_total} frames the body explains less than "
            f"{100 - 100 * crowded_share:.0f} % of the volume, as when others or things are in it or few cameras see "
            "the person; poses are uncertain there"
        )
    if doubtful.any():
        names = [
            name for name, own in zip(landmark_names(doubtful.shape[1]), doubtful.T, strict=True) if own.any()
        ]
        when = frames_in_words(frames[doubtful.any(axis=1)])
        warnings.append(
            f"person {person}: {', '.join(names)} may be elsewhere in frames {when}: another pose explains the volume "
            "about as well there, as when legs cross behind furniture or hands lie along what they hold. They are "
            "marked as not observed"
        )
    hidden = (series.hidden_std > 0) & ~doubtful
    if hidden.any():
        names = [
            name for name, own in zip(landmark_names(hidden.shape[1]), hidden.T, strict=True) if own.any()
        ]
        warnings.append(
            f"person {person}: {', '.join(names)} are hidden from all cameras or all but one, outside their pictures "
            "or the room, or lost from masks so that the volume hangs in the air, in frames "
            f"{frames_in_words(frames[hidden.any(axis=1)])}: they are marked as not observed, and deviations grow with "
            "the time"
        )
    seldom = _seldom_observed(series.observed, series.log_likelihood)
    if seldom:
        warnings.append(
            f"person {person}: in less than half of the frames the volume holds {', '.join(seldom)}: it has holes "
            "there, or the pose is wrong. Remedy: look at the masks in the report; clothes or skin of the colour of "
            "the background leave holes"
        )
    if not height.is_measured:
        warnings.append(
            f"person {person}: the standing height could not be read from the volume; "
            f"{height.height_m:.2f} m was taken. Remedy: set person_height_m in session.toml"
        )
    if is_facing_open:
        warnings.append(
            f"person {person}: it is not clear which way the person faces (two poses explain the volumes "
            "almost equally well); left and right may be exchanged"
        )
    return warnings


def _seldom_observed(observed: NDArray[np.bool_], log_likelihood: Array) -> list[str]:
    """Landmarks that were observed (T, M) in less than half of the frames that had a usable volume."""
    usable = np.isfinite(log_likelihood)
    if not usable.any():
        return []
    names = landmark_names(observed.shape[1])
    return [name for name, share in zip(names, observed[usable].mean(axis=0), strict=True) if share < 0.5]
