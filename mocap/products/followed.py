"""Followed persons, product `pose-frames`: what the filter has given of every person, before edits and smoothing.

Per frame, of the P persons in it, `person` (P,) int64, the arrays of `FrameSeries` and, where smoothing asks for it,
`information` (P, D, D); bodies and what is said of whole persons in the attributes. A person is known by a key of its
own: an edit of one leaves the others as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, scale_body
from mocap.body.initial import HeightEstimate
from mocap.body.model import BodyModel
from mocap.body.stretch import lengths_of, with_lengths
from mocap.errors import MocapError
from mocap.io.store import StageReader, StageStore
from mocap.pose.deviation import FrameSeries
from mocap.pose.evidence import PersonTools
from mocap.pose.result import FollowedPerson
from mocap.products import poses as poses_product
from mocap.products.poses import columns_of, persons_rows

PRODUCT = "pose-frames"
_SERIES = tuple(f.name for f in fields(FrameSeries))


def store_followed(
    store: StageStore, key: str, results: Sequence[FollowedPerson], keys: Mapping[int, str]
) -> None:
    """All persons into the store.  keys : person -> its own key."""
    attrs = {"persons": {str(r.person): _about(r, keys[r.person]) for r in results}}
    row_of = {r.person: {int(frame): i for i, frame in enumerate(r.frames)} for r in results}
    with store.writer(PRODUCT, key, attrs) as out:
        for frame in sorted(set().union(*row_of.values())):
            present = [(r, row_of[r.person][frame]) for r in results if frame in row_of[r.person]]
            columns = {name: np.array([getattr(r.series, name)[i] for r, i in present]) for name in _SERIES}
            known = [r.information[i] for r, i in present if r.information is not None]
            if known:
                columns["information"] = np.array(known)
            out.append(frame, person=np.array([r.person for r, _ in present], dtype=np.int64), **columns)


def things_in(store: StageStore) -> dict[int, str]:
    """Whom the stored poses leave out, as they are things: number -> what is said of each."""
    about = store.reader(PRODUCT).attrs["persons"]
    shown = store.reader(poses_product.PRODUCT).attrs["persons"]
    return {int(p): own["thing"] for p, own in about.items() if own["thing"] and p not in shown}


def _about(followed: FollowedPerson, key: str) -> dict[str, Any]:
    offsets = followed.tools.marker_offsets
    return {
        "key": key,
        "height_m": followed.height.height_m,
        "height_is_measured": followed.height.is_measured,
        "lengths": lengths_of(followed.body),
        "outline_weight": followed.tools.settings.outline_weight,
        "is_facing_open": followed.is_facing_open,
        "n_usable": followed.n_usable,
        "start_frame": followed.start_frame,
        "first_pose": followed.first_pose,
        "warnings": list(followed.warnings),
        "thing": followed.thing,
        "has_information": followed.information is not None,
        "marker_offset_m": None if offsets is None else offsets.tolist(),
    }


def stored_followed(
    store: StageStore,
    keys: Mapping[int, str],
    model: BodyModel,
    tools_of: Callable[[Body, NDArray[np.float64] | None], PersonTools],
) -> dict[int, FollowedPerson]:
    """The persons that an earlier run has left in the store under their own keys, by number; none where it is damaged.

    model : the body file of all of them.  tools_of : body of a person, and where its markers sit -> what it is followed
    with.
    """
    try:
        reader = store.reader(PRODUCT)
        about = reader.attrs["persons"]
        persons = [int(name) for name, value in about.items() if keys.get(int(name)) == value["key"]]
        return read_followed(reader, persons, model, tools_of)
    except MocapError:
        return {}


def read_followed(
    reader: StageReader,
    persons: Sequence[int],
    model: BodyModel,
    tools_of: Callable[[Body, NDArray[np.float64] | None], PersonTools],
) -> dict[int, FollowedPerson]:
    """Some persons of the product, by number; arguments as of `stored_followed`. Raises MocapError for damage."""
    places = persons_rows(reader) if persons else {}
    about = reader.attrs["persons"]
    return {
        person: _person(reader, person, about[str(person)], places[person], model, tools_of)
        for person in persons
    }


def _person(
    reader: StageReader,
    person: int,
    about: Mapping[str, Any],
    places: Sequence[tuple[int, int]],
    model: BodyModel,
    tools_of: Callable[[Body, NDArray[np.float64] | None], PersonTools],
) -> FollowedPerson:
    """One person of the product.  places : as `persons_rows` gives them."""
    offsets = about["marker_offset_m"]
    body = with_lengths(scale_body(model, about["height_m"]), about["lengths"])
    tools = tools_of(body, None if offsets is None else np.array(offsets))
    settings = replace(tools.settings, outline_weight=about["outline_weight"])
    columns = columns_of(reader, places, (*_SERIES, *(("information",) if about["has_information"] else ())))
    information = columns.pop("information", None)
    return FollowedPerson(
        person=person,
        tools=replace(tools, settings=settings),
        height=HeightEstimate(about["height_m"], about["height_is_measured"]),
        frames=np.array([frame for frame, _ in places], dtype=np.int64),
        series=FrameSeries(**columns),
        is_facing_open=about["is_facing_open"],
        n_usable=about["n_usable"],
        start_frame=about["start_frame"],
        first_pose=about["first_pose"],
        information=information,
        warnings=tuple(about["warnings"]),
        thing=about["thing"],
    )
