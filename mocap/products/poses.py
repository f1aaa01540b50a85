"""Poses, product `pose`: states and landmarks of every person, and the body that they belong to.

Per frame, of the P persons in it, `person` (P,) int64, `state` (P, D), `landmarks` (P, M, 3) m, `covariance`
(P, M, 3, 3) m^2, `observed` (P, M) bool, `log_likelihood` and `ess_share` (P,); bodies in the attributes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.body import body_toml, model_of, scale_body
from mocap.body.initial import HeightEstimate
from mocap.body.model import load_body_model, parse_body_model
from mocap.body.stretch import lengths_of, with_lengths
from mocap.io.store import StageStore
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
    rows = sorted({int(f) for r in results for f in r.frames})
    with store.writer(PRODUCT, key, attrs) as out:
        for frame in rows:
            present = [(r, int(np.searchsorted(r.frames, frame))) for r in results if frame in r.frames]
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
    rows: dict[int, list[tuple[int, dict[str, NDArray[np.generic]], int]]] = {}
    for frame, arrays in reader:
        for i, person in enumerate(arrays["person"]):
            rows.setdefault(int(person), []).append((frame, arrays, i))
    results = []
    for name, about in reader.attrs["persons"].items():
        own = rows[int(name)]

        def column(field: str, own: list = own) -> NDArray:  # type: ignore[type-arg]
            return np.array([arrays[field][i] for _, arrays, i in own])

        results.append(
            PersonPoses(
                person=int(name),
                body=with_lengths(scale_body(model, about["height_m"]), about["lengths"]),
                height=HeightEstimate(about["height_m"], about["height_is_measured"]),
                frames=np.array([frame for frame, _, _ in own], dtype=np.int64),
                states=column("state"),
                landmarks=column("landmarks"),
                landmark_covariance=column("covariance"),
                observed=column("observed").astype(np.bool_),
                log_likelihood=column("log_likelihood"),
                ess_share=column("ess_share"),
                start_frame=about["start_frame"],
                first_pose=about["first_pose"],
                warnings=tuple(about["warnings"]),
            )
        )
    return results
