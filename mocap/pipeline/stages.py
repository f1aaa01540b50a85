"""The four stages on files: each reads the products of the one before from the store and writes its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from mocap.body import scale_body
from mocap.body.initial import HeightEstimate
from mocap.body.model import load_body_model
from mocap.data import Hull, Tracks, VoxelGrid
from mocap.errors import MocapError
from mocap.foreground import (
    Background,
    ForegroundSettings,
    Segmenter,
    learn_background,
    median_background,
)
from mocap.io.session import Session
from mocap.io.store import StageStore, StageWriter
from mocap.io.video import FrameReader, MaskReader, iter_clip
from mocap.pipeline.config import Config, SegmentationConfig
from mocap.pipeline.pose import PersonHull, PersonPoses, estimate_height, follow_person, make_tools
from mocap.tracking import TrackerSettings, TrackerState, track_step, tracks_from_history
from mocap.volume import Carver, choose_grid, colour_hull, connected_components, surface_voxels

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

_UNUSABLE_SHARE = 0.1  # share of frames with unusable masks that earns a warning
_EMPTY_SHARE = 0.1


@dataclass(frozen=True)
class StageReport:
    """What a stage has to say: warnings for the user and numbers for run.json."""

    warnings: tuple[str, ...] = ()
    numbers: dict[str, float | int | str] | None = None


def learn_backgrounds(session: Session, config: SegmentationConfig, warnings: list[str]) -> list[Background]:
    """One background per camera, from background/, the first frames, or the temporal median.

    Raises MocapError when there is nothing to learn from, saying how to help.
    """
    backgrounds = []
    n_frames = len(session.frames)
    for camera in session.rig:
        source = config.background
        if source == "auto":
            source = "clip" if camera.name in session.background_sources else "median"
        if source == "clip":
            if camera.name not in session.background_sources:
                raise MocapError(
                    "there is no clip of the empty scene",
                    camera=camera.name,
                    path=session.root / "background",
                    remedy="record one, or set segmentation.background to median or first",
                )
            clip = iter_clip(session.background_sources[camera.name], size=camera.size, camera=camera.name)
            background = learn_background(clip)
        else:
            if n_frames < 3:
                raise MocapError(
                    f"no background to learn from: {n_frames} frame(s) and no background/ folder",
                    camera=camera.name,
                    path=session.root,
                    remedy="add pictures of the empty scene as background/CAMERA.png, or masks/CAMERA/*.png",
                )
            clip = iter_clip(session.image_sources[camera.name], size=camera.size, camera=camera.name)
            clip = islice(clip, session.frames.start, session.frames.stop)
            if source == "first":
                background = learn_background(islice(clip, config.first_frames))
            else:
                step = max(1, n_frames // config.median_frames)
                background = median_background(islice(clip, 0, None, step))
        warnings += [f"camera {camera.name}: {w}" for w in background.warnings]
        backgrounds.append(background)
    if config.background in ("auto", "median"):
        missing = [
            c.name
            for c in session.rig
            if config.background == "median" or c.name not in session.background_sources
        ]
        if missing:
            warnings.append(
                f"the background of {', '.join(missing)} was learnt as the temporal median of {n_frames} frames; a "
                "person who stays in place, or a short clip, is lost this way. Remedy: record an empty scene as "
                "background/CAMERA.mp4"
            )
    return backgrounds


def segment_stage(
    session: Session, config: Config, store: StageStore, key: str, *, n_threads: int, progress: Progress
) -> None:
    """Foreground masks of every frame into the store: computed, or taken over from masks/.

    Store: per frame `m0 .. mC-1`, (H, ceil(W / 8)) uint8, bits of the masks along rows in rig order; `share`
    (C,) foreground share; `usable` (C,) bool.
    Source: CF 2.2.3.
    """
    warnings: list[str] = []
    rig, frames = session.rig, session.frames
    n = len(frames)
    if session.mask_sources:
        with (
            store.writer("segment", key, {"source": "masks"}) as out,
            MaskReader(session.mask_sources, rig, frames) as reader,
        ):
            for i, (frame, masks) in enumerate(reader):
                _append_masks(out, frame, masks, np.ones(len(rig), dtype=np.bool_))
                progress("segment", i + 1, n)
        return
    backgrounds = learn_backgrounds(session, config.segmentation, warnings)
    settings = ForegroundSettings(method=config.segmentation.method)
    segmenters = [Segmenter(b, settings) for b in backgrounds]
    attrs: dict[str, object] = {"source": "images", "warnings": warnings}
    with (
        store.writer("segment", key, attrs) as out,
        FrameReader(session.image_sources, rig, frames) as images_of,
        ThreadPoolExecutor(max(1, n_threads)) as pool,
    ):
        for i, (frame, images) in enumerate(images_of):
            found = list(pool.map(lambda s, image: s.segment(image), segmenters, images))
            usable = np.array([m.is_usable for m in found])
            _append_masks(out, frame, [m.mask for m in found], usable)
            progress("segment", i + 1, n)


def _append_masks(
    out: StageWriter, frame: int, masks: Sequence[NDArray[np.bool_]], usable: NDArray[np.bool_]
) -> None:
    packed = {f"m{c}": np.packbits(mask, axis=1) for c, mask in enumerate(masks)}
    share = np.array([float(m.mean()) for m in masks], dtype=np.float32)
    out.append(frame, share=share, usable=usable, **packed)


def read_masks(store: StageStore, session: Session) -> Iterator[tuple[int, list[NDArray[np.bool_]]]]:
    """Frames and masks, one (H, W) bool per camera in rig order, from the store."""
    for frame, arrays in store.reader("segment"):
        yield frame, masks_from_arrays(arrays, session)


def masks_from_arrays(arrays: dict[str, NDArray[np.uint8]], session: Session) -> list[NDArray[np.bool_]]:
    """Masks of one frame of the `segment` product."""
    return [
        np.unpackbits(arrays[f"m{c}"], axis=1, count=camera.size[0]).view(np.bool_)
        for c, camera in enumerate(session.rig)
    ]


def segment_report(store: StageStore, session: Session) -> StageReport:
    """Warnings about the masks: backgrounds that do not fit, cameras that see nothing."""
    reader = store.reader("segment")
    warnings = list(reader.attrs.get("warnings", []))
    rows = [(arrays["share"], arrays["usable"]) for _, arrays in reader]
    share, usable = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
    for c, camera in enumerate(session.rig):
        bad = 1.0 - usable[:, c].mean()
        if bad > _UNUSABLE_SHARE:
            warnings.append(
                f"camera {camera.name}: the foreground fills most of the picture in {bad:.0%} of the frames; the "
                "background does not fit. Remedy: record background/ with the same light and camera settings, or "
                "give masks/"
            )
        if share[:, c].max() < 1e-4:
            warnings.append(f"camera {camera.name}: no foreground in any frame")
    return StageReport(
        tuple(warnings),
        {"mean_foreground_share": round(float(share.mean()), 4), "source": reader.attrs["source"]},
    )


def grid_of(session: Session, config: Config) -> VoxelGrid:
    """The voxel grid: configured bounds, else the session's, else the cameras' common view."""
    bounds = config.volume.room_bounds_m or session.room_bounds_m
    try:
        return choose_grid(session.rig, config.volume.voxel_size_m, bounds_m=bounds)
    except ValueError as error:
        raise MocapError(
            f"no voxel grid: {error}",
            path=session.calibration_path,
            remedy="set room_bounds_m in session.toml, or check the calibration with `mocap check`",
        ) from error


def faulty_views(session: Session, config: Config) -> int:
    """The tolerance k: with `auto` one camera of six or more may be wrong when masks were computed.

    Four cameras cannot afford it: a hull of three views is half as large again.
    """
    if config.volume.n_faulty_views != "auto":
        return config.volume.n_faulty_views
    return 1 if len(session.rig) >= 6 and not session.mask_sources else 0


def carve_stage(session: Session, config: Config, store: StageStore, key: str, *, progress: Progress) -> None:
    """Coloured hulls of every frame into the store.

    Store: per frame `voxels` (N,) int32, `is_surface` (N,) bool, `n_views` (N,) uint8, `rgb` (N, 3) uint8; the grid
    in the attributes.
    Source: CF 2.2.4.
    """
    grid = grid_of(session, config)
    k = faulty_views(session, config)
    min_views = None if config.volume.min_views == "auto" else config.volume.min_views
    try:
        carver = Carver(session.rig, grid)
        if not 0 <= k < len(session.rig):
            raise ValueError(f"n_faulty_views is {k}, the rig has {len(session.rig)} cameras")
    except ValueError as error:
        raise MocapError(
            f"the volume cannot be carved: {error}",
            remedy="use larger voxels (volume.voxel_size_m), a smaller room (room_bounds_m) or fewer faulty views",
        ) from error
    attrs = {
        "origin_m": grid.origin.tolist(),
        "shape": list(grid.shape),
        "voxel_size_m": grid.voxel_size_m,
        "n_faulty_views": k,
    }
    n = len(session.frames)
    with store.writer("carve", key, attrs) as out:
        images_of = (
            FrameReader(session.image_sources, session.rig, session.frames) if session.image_sources else None
        )
        try:
            images = iter(images_of) if images_of is not None else None
            for i, (frame, masks) in enumerate(read_masks(store, session)):
                picture = next(images)[1] if images is not None else None
                voxels = carver.carve(masks, n_faulty_views=k, min_views=min_views)
                hull = colour_hull(voxels, surface_voxels(voxels, grid), grid, session.rig, picture)
                out.append(
                    frame,
                    voxels=hull.voxels,
                    is_surface=hull.is_surface,
                    n_views=hull.n_views,
                    rgb=hull.rgb,
                )
                progress("carve", i + 1, n)
        finally:
            if images_of is not None:
                images_of.close()


def stored_grid(store: StageStore) -> VoxelGrid:
    """The grid that the hulls in the store live on."""
    attrs = store.reader("carve").attrs
    return VoxelGrid(np.array(attrs["origin_m"]), tuple(attrs["shape"]), attrs["voxel_size_m"])


def hull_from_arrays(grid: VoxelGrid, arrays: dict[str, NDArray[np.generic]]) -> Hull:
    """One frame of the `carve` product as a Hull."""
    return Hull(
        grid,
        arrays["voxels"].astype(np.int32, copy=False),
        arrays["is_surface"].astype(np.bool_, copy=False),
        arrays["n_views"].astype(np.uint8, copy=False),
        arrays["rgb"].astype(np.uint8, copy=False),
    )


def carve_report(store: StageStore) -> StageReport:
    """Warnings about empty hulls, and their mean volume."""
    grid = stored_grid(store)
    reader = store.reader("carve")
    sizes = np.array([len(arrays["voxels"]) for _, arrays in reader])
    empty = float((sizes == 0).mean()) if sizes.size else 1.0
    warnings = []
    if empty == 1.0:
        warnings.append(
            "the volume is empty in every frame: nobody stands where enough cameras see him. Remedy: look at the "
            "silhouettes in the report, check the calibration with `mocap check`, raise volume.n_faulty_views"
        )
    elif empty > _EMPTY_SHARE:
        warnings.append(f"the volume is empty in {empty:.0%} of the frames")
    litres = sizes * grid.voxel_size_m**3 * 1000.0
    return StageReport(
        tuple(warnings),
        {
            "mean_volume_litres": round(float(litres.mean()), 1) if sizes.size else 0.0,
            "n_faulty_views": int(reader.attrs["n_faulty_views"]),
            "grid": "x".join(map(str, grid.shape)),
        },
    )


def track_stage(
    session: Session, config: Config, store: StageStore, key: str, *, progress: Progress
) -> Tracks:
    """Persons over time: components, features, naive tracker; the owner of every voxel into the store.

    Store: per frame `owner` (N,) uint16, the person that holds each voxel of the hull, 0 = nobody.
    Source: CF 4.2-4.3.
    """
    grid = stored_grid(store)
    n = len(session.frames)
    settings = TrackerSettings(
        voxel_size_m=grid.voxel_size_m,
        confirm_frames=max(1, min(config.tracking.confirm_frames, n // 2)),
        lost_frames=config.tracking.lost_frames,
    )
    state = TrackerState()
    history = []
    with store.writer("track-owners", key, {}) as out:
        for i, (frame, arrays) in enumerate(store.reader("carve")):
            voxels = arrays["voxels"]
            centers = grid.centers(voxels)
            labels, _ = connected_components(voxels, grid)
            state, info = track_step(state, centers, labels, frame, settings)
            owner = np.zeros(len(voxels), dtype=np.uint16)
            for person, rows in info.voxels_of.items():
                owner[rows] = person
            history.append((info.frame, info.tracks))
            out.append(frame, owner=owner)
            progress("track", i + 1, n)
    tracks = tracks_from_history(history, session.fps, min_seen=settings.confirm_frames)
    with store.writer("track", key, {}) as out:
        for frame in store.reader("carve").frames:
            rows = tracks.frame == frame
            out.append(int(frame), person=tracks.person[rows], xyz=tracks.xyz[rows])
    return tracks


def stored_tracks(store: StageStore, fps: float) -> Tracks:
    """The table of tracks from the store."""
    frame, person, xyz = [], [], []
    for f, arrays in store.reader("track"):
        frame += [f] * len(arrays["person"])
        person.append(arrays["person"])
        xyz.append(arrays["xyz"])
    frames = np.array(frame, dtype=np.int64)
    return Tracks(
        frame=frames,
        person=np.concatenate(person).astype(np.int64) if person else np.zeros(0, dtype=np.int64),
        time_s=frames / fps,
        xyz=np.concatenate(xyz).reshape(-1, 3) if xyz else np.zeros((0, 3)),
    )


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
    """Poses of every tracked person, one filter each, into the store.

    Source: CF 6.3.3, 6.5.
    """
    grid = stored_grid(store)
    hulls, owners = store.reader("carve"), store.reader("track-owners")
    n_total = len(tracks)
    done = 0
    results = []

    def tick(n: int) -> None:
        nonlocal done
        done += n
        progress("pose", done, n_total)

    for person in tracks.persons:
        own = tracks.of(person)

        @lru_cache(maxsize=8)
        def hull_of(frame: int, person: int = person) -> PersonHull | None:
            arrays = hulls.read(frame)
            keep = owners.read(frame)["owner"] == person
            if not keep.any():
                return None
            # Surface of the person alone, so that a neighbour does not hide a side of him.
            voxels = arrays["voxels"][keep].astype(np.int32, copy=False)
            return PersonHull(voxels, surface_voxels(voxels, grid))

        given = config.body.height_m or session.person_height_m
        height = (
            HeightEstimate(given, True)
            if given is not None
            else estimate_height(grid, hull_of, own.frame.tolist())
        )
        tools = make_tools(
            grid,
            session.fps,
            height.height_m,
            config.body.model,
            config.pose,
            config.likelihood,
            n_threads,
        )
        results.append(
            follow_person(person, own.frame, own.xyz, hull_of, tools, height, seed=seed, progress=tick)
        )
    _store_poses(store, key, config, results)
    return results


def _store_poses(store: StageStore, key: str, config: Config, results: list[PersonPoses]) -> None:
    attrs = {
        "body_model": config.body.model,
        "persons": {
            str(r.person): {
                "height_m": r.height.height_m,
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


def stored_poses(store: StageStore) -> list[PersonPoses]:
    """Poses of all persons from the store."""
    reader = store.reader("pose")
    model = load_body_model(reader.attrs["body_model"])
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
                body=scale_body(model, about["height_m"]),
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
