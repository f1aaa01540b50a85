"""Pose from markers: from detections to the poses and the track of the person who wears them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, load_body_model
from mocap.body.markers import load_marker_set, place_markers
from mocap.data import Tracks
from mocap.likelihood.markers import MarkerObservation, marker_views, observe
from mocap.pipeline.edits.followed import solve_persons
from mocap.pipeline.pose_settings import make_marker_tools, marker_tools, stated_height_m
from mocap.pipeline.stage import ClipWork, Job, Stage, StageReport
from mocap.pipeline.stages.pose import poses_report, tracks_of_flesh
from mocap.pose.edits import EvidenceOf
from mocap.pose.marker import MarkerClipObservation, MarkerEvidence, MarkerTools, ObservationOf
from mocap.pose.marker_person import PERSON, finish_markers, follow_markers
from mocap.pose.result import FollowedPerson, PersonPoses
from mocap.products import detections as detections_product
from mocap.products import followed as followed_product
from mocap.products import poses as poses_product
from mocap.products import tracks as tracks_product
from mocap.products.detections import detections_from_arrays
from mocap.products.tracks import stored_tracks, track_row
from mocap.tracking.renaming import Renaming

Array = NDArray[np.float64]


def marker_pose_stage(job: Job) -> None:
    """Poses of the person who wears the markers, and its track, into the store.

    One person per session: a second one is not followed, and a warning says so. Edits by hand can tell that it is
    another one from some frame on.
    Source: CF 6.4.
    """
    session = job.session
    found = wearer_tracks(session.frames, session.fps)
    results = solve_persons(job, found, "markers", partial(MarkerWork, job))
    tracks = tracks_of_flesh(results, session.fps)
    with job.writer(tracks_product.PRODUCT) as out:
        for frame in session.frames:
            out.append(frame, **track_row(tracks, frame))


def wearer_tracks(frames: range, fps: float) -> Tracks:
    """The track of the person who wears the markers before it has poses: there in all frames, nobody knows where."""
    frame = np.array(frames, dtype=np.int64)
    return Tracks(frame, np.full(len(frame), PERSON), frame / fps, np.full((len(frame), 3), np.nan))


@dataclass(frozen=True, eq=False)
class MarkerWork:
    """What persons are followed in: the detections in the store. Implements `PersonsWork`.

    All detections of a frame are those of whoever is there: edits of tracks change nothing in them.
    """

    job: Job
    renamings: Sequence[Renaming] = ()

    @cached_property
    def observation_of(self) -> ObservationOf:
        """frame -> its detections."""
        rig = self.job.session.rig
        reader, views = self.job.store.reader(detections_product.PRODUCT), marker_views(rig)

        @lru_cache(maxsize=128)
        def observation_of(frame: int) -> MarkerObservation:
            return observe(views, detections_from_arrays(reader.read(frame), len(rig)))

        return observation_of

    def tools_of(self, body: Body, marker_offsets: Array | None) -> MarkerTools:
        """What a person is followed with whose body and markers are known already."""
        config = self.job.config
        markers = place_markers(load_marker_set(config.body.marker_set), body)
        if marker_offsets is not None:
            markers = replace(markers, offset=marker_offsets)
        return marker_tools(body, markers, self.job.session.fps, config)

    def evidence_of(self, one: FollowedPerson) -> EvidenceOf:
        """Row of a person -> its detections, with the body of that person."""
        assert isinstance(one.tools, MarkerTools)
        observation = MarkerClipObservation(one.tools, self.observation_of)

        def evidence_of(row: int) -> MarkerEvidence | None:
            seen = observation.prepare(int(one.frames[row]))
            return None if seen is None else observation.evidence(seen)

        return evidence_of

    def follow(self, tracks: Tracks) -> list[FollowedPerson]:
        """Every person whose detections a pose explains."""
        found = [self._followed(person, tracks.of(person).frame) for person in tracks.persons]
        return [one for one in found if one is not None]

    def _followed(self, person: int, frames: NDArray[np.int64]) -> FollowedPerson | None:
        """One person in its frames (T,); in frames between them that are not its own nothing is seen of it."""
        session, config, job = self.job.session, self.job.config, self.job
        is_own = set(frames.tolist())
        nothing = observe(marker_views(session.rig), [np.zeros((0, 2))] * len(session.rig))
        one = follow_markers(
            range(int(frames[0]), int(frames[-1]) + 1),
            lambda frame: self.observation_of(frame) if frame in is_own else nothing,
            lambda height_m: make_marker_tools(config, session.fps, height_m),
            height_m=stated_height_m(config, load_body_model(config.body_model("markers")), session),
            seed=job.seed,
            is_fitted=config.body.marker_offsets == "fit",
            progress=lambda done, total: job.progress("pose", done, total),
            person=person,
        )
        return None if one is None else one.rows(np.isin(one.frames, frames))

    def finished(self, one: FollowedPerson) -> PersonPoses:
        """The smoothed poses of a followed person."""
        return finish_markers(one)


def marker_pose_report(job: Job) -> StageReport:
    """What the poses say of themselves, and advice where nobody was found."""
    report = poses_report(job)
    n = len(stored_tracks(job.store, job.session.fps).persons)
    return StageReport((*(() if n else (_NOBODY,)), *report.warnings), {"n_persons": n, **report.numbers})


_NOBODY = (
    "no person was found in the detections. Remedy: look at the detections in the report; the cameras "
    "must agree on some markers, and the calibration must be that of the detections"
)
MARKER_POSE = Stage(
    name="pose",
    until="pose",
    products=(tracks_product.PRODUCT, followed_product.PRODUCT, poses_product.PRODUCT),
    work=ClipWork(marker_pose_stage),
    report=marker_pose_report,
    needs=("detect",),
    sections=("body", "pose", "method", "markers", "edits"),
    facts=("fps", "person_height_m"),
    is_random=lambda config: True,
)
