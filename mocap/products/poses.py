"""Poses, product `pose`: states and landmarks of every person, and the body that they belong to.

Per frame, of the P persons in it, `person` (P,) int64, `state` (P, D), `landmarks` (P, M, 3) m, `covariance`
(P, M, 3, 3) m^2, `observed` (P, M) bool, `log_likelihood` and `ess_share` (P,); bodies in the attributes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.body import body_toml, model_of, scale_body
from mocap.body.initial import HeightEstimate
from mocap.body.model import BodyModel, load_body_model, parse_body_model
from mocap.body.stretch import lengths_of, with_lengths
from mocap.io.store import StageReader, StageStore
from mocap.pose.result import PersonPoses

PRODUCT = "pose"
# Array of the product -> field of PersonPoses, one row per frame.
_COLUMNS = {
    "state": "states",
    "landmarks": "landmarks",
    "covariance": "landmark_covariance",
    "observed": "observed",
    "log_likelihood": "log_likelihood",
    "ess_share": "ess_share",
}


def store_poses(store: StageStore, key: str, body_model: str, results: list[PersonPoses]) -> None:
    """Poses of all persons into the store; `stored_poses` reads them back.  body_model : that of all of them."""
    attrs = {
        # The file itself: it may be moved or changed before the poses are read.
        "body_model": body_toml(load_body_model(body_model)),
        "persons": {
            str(r.person): {
                "height_m": r.height.height_m,
                "lengths": lengths_of(r.body),
                "height_is_measured": r.height.is_measured,
                "start_frame": r.start_frame,
                "first_pose": r.first_pose,
                "warnings": list(r.warnings),
            }
            for r in results
        },
    }
    row_of = {r.person: {int(frame): i for i, frame in enumerate(r.frames)} for r in results}
    with store.writer(PRODUCT, key, attrs) as out:
        for frame in sorted(set().union(*row_of.values())):
            present = [(r, row_of[r.person][frame]) for r in results if frame in row_of[r.person]]
            columns = {
                name: np.array([getattr(r, field)[i] for r, i in present]) for name, field in _COLUMNS.items()
            }
            out.append(frame, person=np.array([r.person for r, _ in present], dtype=np.int64), **columns)


def body_files(store: StageStore, poses: Sequence[PersonPoses]) -> dict[str, str]:
    """Body files of the persons, file name -> text: body.toml of one person, body_1.toml and so on of several.

    Each can be given to `body.model` in another run of the same person, who is then not measured again.
    """
    model = parse_body_model(store.reader(PRODUCT).attrs["body_model"], Path("store.zarr"))
    files = {}
    for p in poses:
        name = "body.toml" if len(poses) == 1 else f"body_{p.person}.toml"
        how = "as measured" if p.height.is_measured else "not measured: a usual height was taken"
        comment = (
            f"The body of person {p.person}, {how}. Use it again with --set body.model=PATH (docs/bodies.md)."
        )
        files[name] = body_toml(model_of(p.body, model), comment)
    return files


def stored_poses(store: StageStore) -> list[PersonPoses]:
    """Poses of all persons from the store."""
    reader = store.reader(PRODUCT)
    model = parse_body_model(reader.attrs["body_model"], Path("store.zarr"))
    places = persons_rows(reader)
    return [
        _stored_person(reader, person, own, reader.attrs["persons"][str(person)], model)
        for person, own in places.items()
    ]


def persons_rows(reader: StageReader) -> dict[int, list[tuple[int, int]]]:
    """Person of a product -> its frames, each with the person's row in it."""
    places: dict[int, list[tuple[int, int]]] = {int(name): [] for name in reader.attrs["persons"]}
    for frame in reader.frames.tolist():
        for i, person in enumerate(reader.read(frame, ["person"])["person"].tolist()):
            places[person].append((frame, i))
    return places


def columns_of(
    reader: StageReader, places: Sequence[tuple[int, int]], names: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Columns of one person, name -> (T, ...).  places : as `persons_rows` gives them."""
    columns: dict[str, NDArray[Any]] = {}
    for k, (frame, i) in enumerate(places):
        for name, array in reader.read(frame, list(names)).items():
            if k == 0:  # filled in place: an hour of them is not held twice
                columns[name] = np.empty((len(places), *array.shape[1:]), array.dtype)
            columns[name][k] = array[i]
    return columns


def _stored_person(
    reader: StageReader,
    person: int,
    places: Sequence[tuple[int, int]],
    about: dict[str, Any],
    model: BodyModel,
) -> PersonPoses:
    """One person's poses.  places : of every frame, the frame and the person's row in it.  about : as stored."""
    read = columns_of(reader, places, list(_COLUMNS))
    columns: dict[str, Any] = {_COLUMNS[name]: column for name, column in read.items()}
    columns["observed"] = columns["observed"].astype(np.bool_)
    return PersonPoses(
        person=person,
        body=with_lengths(scale_body(model, about["height_m"]), about["lengths"]),
        height=HeightEstimate(about["height_m"], about["height_is_measured"]),
        frames=np.array([frame for frame, _ in places], dtype=np.int64),
        **columns,
        start_frame=about["start_frame"],
        first_pose=about["first_pose"],
        warnings=tuple(about["warnings"]),
    )
