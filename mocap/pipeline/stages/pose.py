"""Pose: from hulls and tracks to poses in the store."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.body import body_toml, model_of, scale_body
from mocap.body.initial import HeightEstimate
from mocap.body.model import load_body_model, parse_body_model
from mocap.body.stretch import lengths_of, with_lengths
from mocap.data import Tracks
from mocap.data.pixels import SilhouettePixels
from mocap.io.session import Session
from mocap.io.store import StageStore
from mocap.likelihood.colours import PixelRays, person_rays
from mocap.likelihood.residuals import OutlineFitSettings, Outlines, person_outlines, pinhole_view
from mocap.pipeline.config import Config
from mocap.pipeline.pose import PersonPoses, estimate_height, follow_person
from mocap.pipeline.pose_problem import HullOf, PersonHull, make_tools
from mocap.pipeline.stages.carve import stored_grid
from mocap.pipeline.stages.report import Progress
from mocap.pipeline.stages.segment import masks_from_arrays
from mocap.volume import surface_voxels

Array = NDArray[np.float64]


def pose_stage(
    session: Session,
    config: Config,
    store: StageStore,
    key: str,
    tracks: Tracks,
    *,
    seed: int,
    n_threads: int,
    progress: Progress,
) -> list[PersonPoses]:
    """Poses of every tracked person into the store.  Source: CF 6.3.3, 6.5."""
    results = estimate_poses(
        session, config, store, tracks, seed=seed, n_threads=n_threads, progress=progress
    )
    store_poses(store, key, config.body_model("voxels"), results)
    return results


def estimate_poses(
    session: Session,
    config: Config,
    store: StageStore,
    tracks: Tracks,
    *,
    seed: int,
    n_threads: int,
    progress: Progress,
) -> list[PersonPoses]:
    """Poses of every tracked person, one filter each, from the products of the earlier stages in the store."""
    grid = stored_grid(store)
    sized = load_body_model(config.body_model("voxels")).height_m
    n_total = len(tracks)
    done = 0
    results = []

    def tick(n: int) -> None:
        nonlocal done
        done += n
        progress("pose", done, n_total)

    for person in tracks.persons:
        own = tracks.of(person)
        hull_of = hulls_of_person(session, store, person)
        given = config.body.height_m or sized or session.person_height_m
        height = (
            HeightEstimate(given, True)
            if given is not None
            else estimate_height(grid, hull_of, own.frame.tolist())
        )
        tools = make_tools(
            grid,
            session.fps,
            height.height_m,
            config.body_model("voxels"),
            config.pose,
            config.likelihood,
            n_threads,
        )
        results.append(
            follow_person(
                person,
                own.frame,
                own.xyz,
                hull_of,
                tools,
                height,
                seed=seed,
                is_size_fitted=given is None and config.body.sizing == "poses" and config.pose.refine,
                progress=tick,
            )
        )
    return results


def hulls_of_person(session: Session, store: StageStore, person: int) -> HullOf:
    """frame -> the voxels of one person, with its outlines, from the products of the earlier stages."""
    grid = stored_grid(store)
    hulls, owners, segments = store.reader("carve"), store.reader("track-owners"), store.reader("segment")
    views = [pinhole_view(camera) for camera in session.rig]

    @lru_cache(maxsize=8)
    def hull_of(frame: int) -> PersonHull | None:
        arrays = hulls.read(frame)
        owner = owners.read(frame)["owner"]
        keep = owner == person
        if not keep.any():
            return None
        # Surface of the person alone, so that a neighbour does not hide a side of him.
        voxels = arrays["voxels"][keep].astype(np.int32, copy=False)
        is_surface = surface_voxels(voxels, grid)
        others = arrays["voxels"][(owner > 0) & ~keep & arrays["is_surface"].astype(np.bool_)]

        @lru_cache(maxsize=1)
        def outlines() -> Outlines:
            found = segments.read(frame)
            return person_outlines(
                views,
                session.rig,
                masks_from_arrays(found, session),
                grid.centers(voxels[is_surface]),
                grid.centers(others.astype(np.int32)),
                n_points=OutlineFitSettings().n_outline_points,
                is_whole=found["usable"] & arrays["used"].astype(np.bool_),
            )

        @lru_cache(maxsize=1)
        def rays() -> PixelRays:
            pixels = SilhouettePixels(
                arrays["pixel_camera"].astype(np.uint8, copy=False),
                arrays["pixel_uv"].astype(np.int16, copy=False),
                arrays["pixel_rgb"].astype(np.uint8, copy=False),
            )
            surface = grid.centers(voxels[is_surface])
            return person_rays(session.rig, pixels, surface, grid.centers(others.astype(np.int32)))

        return PersonHull(voxels, is_surface, outlines, rays)

    return hull_of


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
    with store.writer("pose", key, attrs) as out:
        for frame in rows:
            present = [(r, int(np.searchsorted(r.frames, frame))) for r in results if frame in r.frames]
            out.append(
                frame,
                person=np.array([r.person for r, _ in present], dtype=np.int64),
                state=np.array([r.states[i] for r, i in present]),
                landmarks=np.array([r.landmarks[i] for r, i in present]),
                covariance=np.array([r.landmark_covariance[i] for r, i in present]),
                observed=np.array([r.observed[i] for r, i in present]),
                log_likelihood=np.array([r.log_likelihood[i] for r, i in present]),
                ess_share=np.array([r.ess_share[i] for r, i in present]),
            )


def body_files(store: StageStore, poses: Sequence[PersonPoses]) -> dict[str, str]:
    """Body files of the persons, file name -> text: body.toml of one person, body_1.toml and so on of several.

    Each can be given to `body.model` in another run of the same person, who is then not measured again.
    """
    model = parse_body_model(store.reader("pose").attrs["body_model"], Path("store.zarr"))
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
    reader = store.reader("pose")
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
