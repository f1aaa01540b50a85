"""Persons followed once and kept: what the pose stages of all chains do with edits and with what lies in the store."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body
from mocap.body.model import load_body_model
from mocap.data import Tracks
from mocap.pipeline.config import config_hash
from mocap.pipeline.edits.meaning import check_reach, pose_edits_of, renamings_of
from mocap.pipeline.stage import Job
from mocap.pose.edits import EvidenceOf, edited
from mocap.pose.evidence import PersonTools
from mocap.pose.result import FollowedPerson, PersonPoses
from mocap.products.followed import store_followed, stored_followed
from mocap.products.poses import store_poses
from mocap.tracking.renaming import Renaming, renamed_tracks, sources_of


class PersonsWork(Protocol):
    """How the persons of a chain are followed, in data that are called as edits of tracks say."""

    def tools_of(self, body: Body, marker_offsets: NDArray[np.float64] | None) -> PersonTools:
        """What a person is followed with whose body is known already."""
        ...

    def follow(self, tracks: Tracks) -> list[FollowedPerson]:
        """Everybody in the tracks."""
        ...

    def evidence_of(self, one: FollowedPerson) -> EvidenceOf:
        """Row of a person -> what poses are judged by there."""
        ...

    def finished(self, one: FollowedPerson) -> PersonPoses:
        """The poses of a followed person."""
        ...


def solve_persons(
    job: Job,
    found: Tracks,
    kind: Literal["voxels", "markers", "keypoints"],
    work_of: Callable[[Sequence[Renaming]], PersonsWork],
    others: str = "",
) -> list[PersonPoses]:
    """Follow every person, work in the edits, and put the frames and the poses into the store.

    A person whom an earlier run has left in the store, and whom no edit of tracks concerns, is not followed again.
    Things have no poses, unless somebody has put one of them right by hand.
    found : the tracks before edits.  kind : of body, as in `Config.body_model`.  work_of : what edits of tracks rename
    -> the work.  others : what of other persons decides how one is followed.
    """
    edits, frames = job.config.edits, job.session.frames
    renamings = renamings_of(edits, found, frames)
    tracks = renamed_tracks(found, renamings)
    orders = pose_edits_of(edits, tracks, frames)
    keys = {
        p: config_hash(job.unedited_key, repr(sources_of(found, renamings, p)), others)
        for p in tracks.persons
    }
    work, model = work_of(renamings), job.config.body_model(kind)
    kept = stored_followed(job.store, keys, load_body_model(model), work.tools_of) if job.is_resumed else {}
    followed = work.follow(tracks.of(*(p for p in tracks.persons if p not in kept)))
    every = sorted([*kept.values(), *followed], key=lambda one: one.person)
    results = []
    for one in every:
        own = orders.get(one.person)
        if one.thing and own is None:
            continue
        if own is not None:
            limit_m = job.config.method.edits.reach_m
            check_reach(edits, one.person, one.body, one.frames, one.series.states, limit_m)
        results.append(work.finished(one if own is None else edited(one, own, work.evidence_of(one))))
    # Both or none: an edit that cannot be leaves the store as it was.
    store_followed(job.store, job.key, every, keys)
    store_poses(job.store, job.key, model, results)
    return results
