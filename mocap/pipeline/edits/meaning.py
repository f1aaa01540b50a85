"""What edits mean on the tracks and poses of a run, and what speaks against them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body
from mocap.data import CameraRig, Tracks
from mocap.errors import did_you_mean
from mocap.geometry.triangulation import triangulate
from mocap.io.session import Session
from mocap.io.store import StageStore
from mocap.likelihood.markers import marker_views, undistort
from mocap.pipeline.edits.model import (
    Bad,
    Delete,
    Edit,
    Edits,
    ExchangeSides,
    Merge,
    PinLandmark,
    Split,
    Swap,
    frames_of,
)
from mocap.pose.edits import Exchange, Pin, PoseEdits, reach_gap_m
from mocap.pose.method import EditSettings
from mocap.products.tracks import stored_tracks
from mocap.tracking.renaming import DELETED, Renaming, renamed_tracks


def renamings_of(edits: Edits, tracks: Tracks, clip: range) -> list[Renaming]:
    """What the edits do to the numbers of persons, in order.

    tracks : as they were found.  clip : frames of the run. Raises MocapError for a person who is not there, and for
    edits that cannot be.
    """
    found: list[Renaming] = []
    for edit in edits.edit:
        if isinstance(edit, Merge | Split | Swap | Delete):
            now = renamed_tracks(tracks, found)
            frames = frames_of(edit, clip, edits)
            found.append(Renaming(frames, _names(edit, now, frames, edits, _highest(tracks, found))))
    return found


def edited_tracks(store: StageStore, session: Session, edits: Edits) -> Tracks:
    """The tracks in the store, called as the edits say. Raises MocapError for edits that cannot be."""
    tracks = stored_tracks(store, session.fps)
    return renamed_tracks(tracks, renamings_of(edits, tracks, session.frames)) if edits else tracks


def _highest(tracks: Tracks, renamings: Sequence[Renaming]) -> int:
    """The largest number that anybody has or had."""
    given = [new for renaming in renamings for new in renaming.names.values() if new != DELETED]
    return max([*tracks.persons, *given], default=0)


def _names(
    edit: Merge | Split | Swap | Delete, tracks: Tracks, frames: range, edits: Edits, highest: int
) -> dict[int, int]:
    """Old number -> new one of one edit, on the tracks as they are called before it."""
    if isinstance(edit, Merge | Swap):
        a, b = edit.persons
        if a == b:
            raise edits.wrong(edit, f"both persons are {a}", "name two persons")
        for person in edit.persons:
            _check_known(edit, person, tracks, edits)
        _check_there(edit, (b,) if isinstance(edit, Merge) else (a, b), tracks, frames, edits)
        if isinstance(edit, Swap):
            return {a: b, b: a}
        _check_apart(edit, b, a, tracks, frames, edits)
        return {b: a}
    _check_known(edit, edit.person, tracks, edits)
    _check_there(edit, (edit.person,), tracks, frames, edits)
    if isinstance(edit, Delete):
        return {edit.person: DELETED}
    new = edit.new or highest + 1
    _check_apart(edit, edit.person, new, tracks, frames, edits)
    return {edit.person: new}


def _check_known(edit: Edit, person: int, tracks: Tracks, edits: Edits) -> None:
    if person not in tracks.persons:
        there = ", ".join(map(str, tracks.persons)) or "nobody"
        raise edits.wrong(
            edit, f"there is no person {person}", f"there are {there}; see tracks.csv, and the edits above it"
        )


def _check_there(edit: Edit, persons: Sequence[int], tracks: Tracks, frames: range, edits: Edits) -> None:
    """Somebody of them is there in the frames."""
    if not any(len(_shared([person], tracks, frames)) for person in persons):
        who = " and ".join(map(str, persons))
        own = tracks.frame[np.isin(tracks.person, persons)]
        raise edits.wrong(
            edit,
            f"person {who} is not there in frames {frames.start}:{frames.stop}",
            f"he is there in frames {own.min()} to {own.max()}" if len(own) else "name somebody else",
        )


def _check_apart(edit: Edit, moving: int, taken: int, tracks: Tracks, frames: range, edits: Edits) -> None:
    """Nobody has two places."""
    both = _shared([moving, taken], tracks, frames)
    if len(both):
        raise edits.wrong(
            edit,
            f"persons {taken} and {moving} are both there in {len(both)} frames from {both[0]} on: they cannot be one",
            "delete one of them there, or give other frames",
        )


def _shared(persons: Sequence[int], tracks: Tracks, frames: range) -> np.ndarray[Any, Any]:
    """Frames in which all of them are there."""
    found = np.arange(frames.start, frames.stop)
    for person in persons:
        found = np.intersect1d(found, tracks.frame[tracks.person == person])
    return found


def pose_edits_of(edits: Edits, tracks: Tracks, clip: range) -> dict[int, PoseEdits]:
    """What the edits do to the poses, by person.  tracks : as they are called after the edits of tracks.

    Pins have their places in the world. Raises MocapError for a person who is not there, and for edits that contradict
    each other.
    """
    for edit in edits.edit:
        if isinstance(edit, ExchangeSides | Bad | PinLandmark):
            _check_pose_edit(edit, tracks, clip, edits)
    _check_contradictions(edits, clip)
    found = {}
    for person in tracks.persons:
        own = PoseEdits(
            exchanges=tuple(
                Exchange(frames_of(e, clip, edits), e.sides)
                for e in edits.of(ExchangeSides)
                if e.person == person
            ),
            pins=tuple(
                Pin(e.frame, e.landmark, e.place_m)
                for e in edits.of(PinLandmark)
                if e.person == person and e.place_m is not None
            ),
            bad=tuple(frames_of(e, clip, edits) for e in edits.of(Bad) if e.person in (None, person)),
        )
        if own:
            found[person] = own
    return found


def _check_pose_edit(
    edit: ExchangeSides | Bad | PinLandmark, tracks: Tracks, clip: range, edits: Edits
) -> None:
    """Its frames are in the clip, its person is there, and is not taken away altogether."""
    if isinstance(edit, PinLandmark):
        if edit.frame not in clip:
            last = clip.stop - 1
            raise edits.wrong(
                edit, f"frame {edit.frame} is not in the clip", f"it has frames {clip.start} to {last}"
            )
        frames = range(edit.frame, edit.frame + 1)
    else:
        frames = frames_of(edit, clip, edits)
    if edit.person is None:
        return
    _check_known(edit, edit.person, tracks, edits)
    _check_there(edit, (edit.person,), tracks, frames, edits)
    if isinstance(edit, Bad):
        own = tracks.frame[tracks.person == edit.person]
        if np.isin(own, np.arange(frames.start, frames.stop)).all():
            raise edits.wrong(
                edit,
                f"all frames of person {edit.person} are bad: nothing is left of him",
                "delete the person",
            )


def _check_contradictions(edits: Edits, clip: range) -> None:
    """No landmark is pinned to two places, no pin is in a bad frame, nothing is exchanged twice."""
    for a, b in combinations(edits.of(PinLandmark), 2):
        if (a.person, a.landmark, a.frame) == (b.person, b.landmark, b.frame):
            raise edits.wrong(
                b,
                f"{b.landmark} of person {b.person} is pinned in frame {b.frame} by line {a.line} already",
                "take one of the two away",
            )
    for pin in edits.of(PinLandmark):
        for bad in edits.of(Bad):
            if bad.person in (None, pin.person) and pin.frame in frames_of(bad, clip, edits):
                raise edits.wrong(
                    pin,
                    f"frame {pin.frame} is marked as bad by line {bad.line}: a pin needs its evidence",
                    "take one of the two away, or pin another frame",
                )
    for x, y in combinations(edits.of(ExchangeSides), 2):
        same = x.person == y.person and (x.sides == y.sides or "body" in (x.sides, y.sides))
        fx, fy = frames_of(x, clip, edits), frames_of(y, clip, edits)
        if same and max(fx.start, fy.start) < min(fx.stop, fy.stop):
            raise edits.wrong(
                y,
                f"line {x.line} exchanges the same sides in some of these frames",
                "take one of the two away",
            )


def check_reach(
    edits: Edits,
    person: int,
    body: Body,
    frames: NDArray[np.int64],
    states: NDArray[np.float64],
    limit_m: float,
) -> None:
    """Raises MocapError for a pin that the stretched limb of a person misses by more than a limit.

    frames, states : (T,) and (T, D), the poses before the edits.
    """
    for pin in edits.of(PinLandmark):
        rows = np.flatnonzero(frames == pin.frame)
        if pin.person != person or pin.place_m is None or not len(rows):
            continue
        if pin.landmark not in body.landmarks:
            raise edits.wrong(
                pin, f"the body has no {pin.landmark}", "set body.model to one that has it, such as whole"
            )
        gap = reach_gap_m(body, states[rows[0]], pin.landmark, pin.place_m)
        if gap > limit_m:
            raise edits.wrong(
                pin,
                f"person {person} cannot reach the place of {pin.landmark} in frame {pin.frame}: {gap:.2f} m are "
                "missing",
                "look at the frame and at the numbers again (metres, world; or pixels of the right cameras)",
            )


def placed(edits: Edits, rig: CameraRig, settings: EditSettings) -> Edits:
    """The edits with the places of pins that were given in pictures.  rig : of the pictures as they were filmed.

    Raises MocapError for an unknown camera, and for pictures that show different places.
    """
    found = [
        edit.model_copy(update={"place_m": _place(edit, rig, edits, settings)})
        if isinstance(edit, PinLandmark) and edit.place_m is None
        else edit
        for edit in edits.edit
    ]
    return edits.model_copy(update={"edit": tuple(found)})


def _place(pin: PinLandmark, rig: CameraRig, edits: Edits, settings: EditSettings) -> tuple[float, ...]:
    """Where the rays through the given pixels meet, m."""
    seen = pin.seen_px or {}
    for name in seen:
        if name not in rig.names:
            known = ", ".join(rig.names)
            raise edits.wrong(
                pin, f"there is no camera {name!r}{did_you_mean(name, rig.names)}", f"cameras are {known}"
            )
    names = list(seen)
    views = marker_views(rig.subset(names))
    uv = np.concatenate([undistort(rig[name], np.array([seen[name]])) for name in names])
    place = triangulate(views.P[None], uv[None])[0]
    x = views.P[:, :, :3] @ place + views.P[:, :, 3]
    miss_px = np.linalg.norm(x[:, :2] / x[:, 2:] - uv, axis=1)
    limit_px = settings.view_share * np.array([rig[name].size[0] for name in names])
    if not np.isfinite(place).all() or (x[:, 2] <= 0).any() or (miss_px > limit_px).any():
        worst = names[int(np.argmax(np.nan_to_num(miss_px / limit_px, nan=np.inf)))]
        raise edits.wrong(
            pin,
            f"the cameras show different places: in {worst} the place of all lies {np.max(miss_px):.0f} px off",
            "look for the landmark in the same frame of every camera again",
        )
    return tuple(float(v) for v in place)
