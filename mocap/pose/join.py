"""Joining: persons followed in pieces of a recording that share frames become persons of the whole recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mocap.body import Body, landmarks_of
from mocap.body.stretch import lengths_of, with_lengths
from mocap.pose.deviation import FrameSeries
from mocap.pose.evidence import PersonTools
from mocap.pose.method import Method
from mocap.pose.result import FollowedPerson
from mocap.pose.smooth import carried_over

Array = NDArray[np.float64]

# Mean distance of all landmarks, m: two people who stand back to back are farther apart.
_SAME_PERSON_M = 0.3
# Of the shared frames, at each end: a filter that has just begun, and tracks that are not confirmed yet.
_UNSETTLED_SHARE = 0.25


def same_persons(
    before: Sequence[FollowedPerson], after: Sequence[FollowedPerson], shared: range
) -> dict[int, int]:
    """Number in the later piece -> number in the earlier one, of persons whose landmarks are at the same places.

    shared : frames of both. Together the pairs are the nearest; those who are nobody's neighbour are not named.
    """
    distance = np.full((len(after), len(before)), np.inf)
    for i, late in enumerate(after):
        for j, early in enumerate(before):
            gaps = gaps_m(early, late, shared)
            if not np.isnan(gaps).all():
                distance[i, j] = float(np.nanmean(gaps))
    rows, columns = linear_sum_assignment(np.minimum(distance, 1e6))
    return {
        after[i].person: before[j].person
        for i, j in zip(rows, columns, strict=True)
        if distance[i, j] < _SAME_PERSON_M
    }


def gaps_m(early: FollowedPerson, late: FollowedPerson, frames: range) -> Array:
    """Mean distance of the landmarks of two pieces in every frame, (n,) m; NaN where one of them has none."""
    gaps = np.full(len(frames), np.nan)
    one, other = _cut(early, frames), _cut(late, frames)
    both, at, there = np.intersect1d(one.frames, other.frames, assume_unique=True, return_indices=True)
    if len(both):
        d = landmarks_of(one.body, one.series.states[at]) - landmarks_of(
            other.body, other.series.states[there]
        )
        gaps[both - frames.start] = np.linalg.norm(d, axis=2).mean(axis=1)
    return gaps


def seam_frame(
    before: Mapping[int, FollowedPerson],
    after: Mapping[int, FollowedPerson],
    same: Mapping[int, int],
    shared: range,
) -> int:
    """The first frame that is taken from the later piece: where all persons are nearest in both, away from the ends.

    before, after : persons by number.  same : as of `same_persons`.
    """
    margin = int(_UNSETTLED_SHARE * len(shared))
    frames = shared[margin : len(shared) - margin]
    worst = np.zeros(len(frames))
    for late, early in same.items():
        worst = np.fmax(worst, gaps_m(before[early], after[late], frames))
    middle = (frames.start + frames.stop - 1) / 2
    return min(frames, key=lambda frame: (worst[frame - frames.start], abs(frame - middle)))


def joined_person(
    person: int,
    parts: Sequence[tuple[FollowedPerson, range]],
    method: Method,
    tools_of: Callable[[Body], PersonTools],
) -> FollowedPerson | None:
    """One person, followed in volumes, out of the frames that each piece contributes, in order; None where they hold
    nobody.

    The body is the mean of the pieces', weighted by their frames, and the poses of each are carried over to it.
    tools_of : body -> what a person is followed with.
    """
    cut = [part for part in (_cut(one, frames) for one, frames in parts) if len(part.frames)]
    if not cut:
        return None
    body = mean_body([part.body for part in cut], [len(part.frames) for part in cut])
    own = [_of_size(part, body, method) for part in cut]
    first, series = own[0], [part.series for part in own]
    tools, settings = tools_of(body), first.tools.settings
    return replace(
        first,
        person=person,
        tools=replace(tools, settings=replace(tools.settings, outline_weight=settings.outline_weight)),
        height=replace(
            first.height,
            height_m=body.height_m,
            is_measured=any(part.height.is_measured for part in own),
        ),
        frames=np.concatenate([part.frames for part in own]),
        series=FrameSeries(
            **{f.name: np.concatenate([getattr(s, f.name) for s in series]) for f in fields(FrameSeries)}
        ),
        # Whoever is told front from back in one piece is told in those that agree with it.
        is_facing_open=all(part.is_facing_open for part in own),
        n_usable=sum(int((s.blind_std == 0).sum()) for s in series),
        warnings=tuple(dict.fromkeys(words for part in own for words in part.warnings)),
    )


def mean_body(bodies: Sequence[Body], weights: Sequence[float]) -> Body:
    """The body whose lengths are the weighted means of those of several sizes of one body."""
    first, lengths = bodies[0], [lengths_of(body) for body in bodies]
    if all(own == lengths[0] for own in lengths):
        return first
    mean = {
        name: np.average([own[name] for own in lengths], axis=0, weights=weights).tolist()
        for name in lengths[0]
    }
    height_m = float(np.average([body.height_m for body in bodies], weights=weights))
    return with_lengths(replace(first, height_m=height_m), mean)


def _of_size(part: FollowedPerson, body: Body, method: Method) -> FollowedPerson:
    if lengths_of(part.body) == lengths_of(body):
        return part
    states = carried_over(part.series.states, part.body, body, method)
    return replace(part, series=replace(part.series, states=states))


def _cut(one: FollowedPerson, frames: range) -> FollowedPerson:
    """A followed person in some frames."""
    return one.rows((one.frames >= frames.start) & (one.frames < frames.stop))
