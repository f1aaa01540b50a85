"""Everything a run writes beside the store: tables, poses, exports, 3D scene, report."""

from __future__ import annotations

import io
import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, cones_of, skeleton_of
from mocap.data import Hull
from mocap.errors import MissingExtra, MocapError
from mocap.io import export
from mocap.io._files import writing
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv, read_tracks_csv, write_landmarks_csv, write_tracks_csv
from mocap.io.video import FrameReader
from mocap.metrics import point_errors
from mocap.pipeline.config import Config
from mocap.pipeline.pose import PersonPoses
from mocap.pipeline.stages import detections_at, hull_from_arrays, masks_from_arrays, stored_grid
from mocap.pipeline.tracking import every_frame
from mocap.view import BodyPart, Figure, FramePanel
from mocap.volume import choose_grid, silhouette_residuals

if TYPE_CHECKING:
    from mocap.pipeline.run import RunResult

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Progress = Callable[[str, int, int], None]
Bounds = tuple[list[float], list[float]]

_PANEL_HEIGHT_PX = 420
_BOUNDS_STEP_M = 0.1
_RESIDUAL_FRAMES = 12  # of which hull and silhouettes are compared
_UNPUBLISHED = ".outputs.partial"

OUTPUT_WORDS = {
    "run.json": "configuration, versions, seed, timings and warnings of this run",
    "tracks.csv": "where every person is in every frame, how certain that is, and whether he was seen",
    "landmarks.csv": "15 landmarks per person and frame, with standard deviations, metres",
    "pose.npz": "joint angles, root, landmark covariances",
    "body.toml": "the person's body as sized, for `body.model` of another run (body_1.toml and so on of several)",
    "scene.rrd": "cameras, images, voxels and bodies on a time line, for the Rerun viewer",
    "store.zarr": "masks and volumes of every frame; lets a run be resumed",
    ".bvh": "animated skeleton for animation tools (y up, centimetres)",
    ".trc": "landmark trajectories for biomechanics tools (y up, metres)",
    ".c3d": "landmark trajectories for biomechanics tools (z up, millimetres)",
    ".glb": "animated stick body for 3D viewers (y up, metres)",
}


def body_parts(body: Body, state: Array) -> list[BodyPart]:
    """The flesh of a pose, part by part, as the views draw it.  state : (D,)."""
    start, end = cones_of(body, state)
    radii = body.cones.radii
    parts = []
    for p, (name, side) in enumerate(zip(body.layout.parts, body.part_sides, strict=True)):
        rows = np.flatnonzero(body.cones.part == p)
        cones = tuple((start[k], end[k], float(radii[k, 0]), float(radii[k, 1])) for k in rows)
        parts.append(BodyPart(name=name, side=side, cones=cones))
    return parts


def write_outputs(
    result: RunResult,
    store: StageStore,
    config: Config,
    folder: Path,
    *,
    seed: int,
    until: str,
    command: str,
    progress: Progress,
) -> None:
    """Write into `folder` what the stages up to `until` give: tables, then exports, scene and report.

    Where nobody was found the tables are empty. Each file is whole or absent.
    """
    fps = result.session.fps
    if result.tracks is not None:
        write_tracks_csv(folder / "tracks.csv", result.tracks)
    if until in ("pose", "report"):
        write_landmarks_csv(folder / "landmarks.csv", result.motions)
        write_pose_npz(folder / "pose.npz", result.poses)
    if until != "report":
        return
    formats = config.output.formats
    steps: list[tuple[str, Callable[[], None]]] = []
    for poses, motion in zip(result.poses, result.motions, strict=True):
        stem = folder / f"person_{poses.person}"
        skeleton = skeleton_of(poses.body, every_frame(poses.frames, poses.states), poses.person)
        if "bvh" in formats:
            steps.append(("bvh", partial(export.write_bvh, stem.with_suffix(".bvh"), skeleton, fps)))
        if "glb" in formats:
            steps.append(("glb", partial(export.write_glb, stem.with_suffix(".glb"), skeleton, fps)))
        if "trc" in formats:
            steps.append(("trc", partial(export.write_trc, stem.with_suffix(".trc"), motion, fps)))
        if "c3d" in formats:
            steps.append(("c3d", partial(export.write_c3d, stem.with_suffix(".c3d"), motion, fps)))
    if "rrd" in formats:
        steps.append(("rrd", partial(write_scene, result, store, folder / "scene.rrd")))
    left_out = []
    for i, (name, write) in enumerate(steps):
        try:
            write()
        except MissingExtra as error:
            left_out.append(f"{name} was left out: {error}")
        progress("report", i, len(steps) + 1)
    if left_out:
        object.__setattr__(result, "warnings", (*result.warnings, *dict.fromkeys(left_out)))
    if "report" in formats:
        write_run_report(result, store, config, folder, seed=seed, command=command)
    progress("report", len(steps) + 1, len(steps) + 1)


@contextmanager
def published(out: Path, persons: set[int] | None) -> Iterator[Path]:
    """A hidden folder to write outputs into; they replace earlier ones in `out` together, after a clean exit.

    persons : those found by a run with exports; exports of others, from an earlier run, are then removed.
    """
    folder = out / _UNPUBLISHED
    try:
        with writing(folder):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
        yield folder
        with writing(out):
            for path in sorted(folder.iterdir()):
                os.replace(path, out / path.name)
            if persons is not None:
                _forget_others(out, persons)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _forget_others(out: Path, persons: set[int]) -> None:
    for path in out.glob("person_*"):
        number = path.stem.removeprefix("person_")
        if number.isdigit() and int(number) not in persons and path.suffix in OUTPUT_WORDS:
            path.unlink()


def write_pose_npz(path: Path, poses: Sequence[PersonPoses]) -> None:
    """Joint angles, root and landmark covariances of every person, SI units, z up."""
    arrays: dict[str, Any] = {
        "persons": np.array([p.person for p in poses], dtype=np.int64),
        "columns": np.array(poses[0].body.layout.names if poses else [], dtype=np.str_),
        "joints": np.array(poses[0].body.joints if poses else [], dtype=np.str_),
    }
    for p in poses:
        prefix = f"person_{p.person}_"
        arrays[prefix + "frames"] = p.frames
        arrays[prefix + "state"] = p.states
        arrays[prefix + "landmarks_m"] = p.landmarks
        arrays[prefix + "landmark_covariance_m2"] = p.landmark_covariance
        arrays[prefix + "observed"] = p.observed
        arrays[prefix + "log_likelihood"] = p.log_likelihood
        arrays[prefix + "height_m"] = np.array(p.body.height_m)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(buffer.getvalue())
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise MocapError(
            f"the file cannot be written: {error.strerror or error}",
            path=path,
            remedy="free space or choose another folder with -o",
        ) from error


def _rows_at(poses: Sequence[PersonPoses], frame: int) -> list[tuple[PersonPoses, int]]:
    rows = []
    for p in poses:
        i = int(np.searchsorted(p.frames, frame))
        if i < len(p.frames) and p.frames[i] == frame:
            rows.append((p, i))
    return rows


def write_scene(result: RunResult, store: StageStore, path: Path) -> None:
    """scene.rrd: cameras, images, coloured voxels and bodies on a time line."""
    from mocap.view import SceneFrame, write_rrd

    session = result.session
    has_volume = "carve" in result.numbers
    hulls = store.reader("carve") if has_volume else None
    bounds = _room_bounds(result, store)

    def scene_frames() -> Iterator[SceneFrame]:
        reader = (
            FrameReader(session.image_sources, session.rig, session.frames) if session.image_sources else None
        )
        try:
            images = iter(reader) if reader is not None else None
            for frame in session.frames:
                hull = None if hulls is None else hull_from_arrays(stored_grid(store), hulls.read(frame))
                rows = _rows_at(result.poses, frame)
                picture = next(images)[1] if images is not None else None
                yield SceneFrame(
                    frame=frame,
                    time_s=frame / session.fps,
                    images=dict(zip(session.rig.names, picture, strict=True)) if picture else None,
                    hull=hull,
                    persons={p.person: p.landmarks[i] for p, i in rows},
                    parts={p.person: body_parts(p.body, p.states[i]) for p, i in rows},
                )
        finally:
            if reader is not None:
                reader.close()

    write_rrd(
        path,
        session.rig,
        scene_frames(),
        tracks=result.tracks,
        bounds_m=bounds,
        n_frames=len(session.frames),
    )


def _room_bounds(result: RunResult, store: StageStore) -> Bounds:
    """Lower and upper corner of the room, m: the voxel grid's, the session's, or the cameras' common view."""
    if "carve" in result.numbers:
        grid = stored_grid(store)
    else:
        grid = choose_grid(result.session.rig, _BOUNDS_STEP_M, bounds_m=result.session.room_bounds_m)
    return grid.origin.tolist(), grid.upper.tolist()


def write_run_report(
    result: RunResult, store: StageStore, config: Config, folder: Path, *, seed: int, command: str
) -> None:
    """report.html: what was found, pictures to judge it by, errors where truth exists, timing, settings."""
    from mocap.pipeline.run import versions
    from mocap.view import SCORES, ReportData, write_report

    session = result.session
    n = len(session.frames)
    outputs = []
    for name in sorted({"run.json", store.path.name, *(p.name for p in folder.iterdir())}):
        words = OUTPUT_WORDS.get(name) or OUTPUT_WORDS.get(Path(name).suffix)
        if words and not name.startswith("."):
            outputs.append((name, words))
    scores = result.scores or {}
    height = ", ".join(f"person {p.person}: {p.body.height_m:.2f} m" for p in result.poses)
    summary = [
        ("Cameras", ", ".join(session.rig.names)),
        ("Frames", f"{session.frames.start} to {session.frames.stop - 1} at {session.fps:g} frames/s"),
        ("Body height", height or "no person"),
        *_observation_words(result),
        *_motion_words(result),
        ("Pose filter", _filter_words(config, is_markers="detect" in result.numbers)),
        ("Seed", str(seed)),
    ]
    data = ReportData(
        title=f"Motion capture: {session.name}",
        session=session.name,
        status="complete",
        n_persons=len(result.poses),
        n_frames=n,
        n_cameras=len(session.rig),
        fps=session.fps,
        warnings=result.warnings,
        summary=tuple(summary),
        scores={k: scores[k] for k in SCORES if k in scores} or None,
        per_landmark_mm=scores.get("per_landmark_mm"),
        timings={
            stage: (seconds, 1000.0 * seconds / n)
            for stage, seconds in result.timings_s.items()
            if stage != "report"
        },
        figures=tuple(_figures(result, store)),
        frames=tuple(_panels(result, store, config)),
        outputs=tuple(outputs),
        command=command or f"mocap run {session.name} -o {result.out.name} --seed {seed}",
        config_text=json.dumps(config.model_dump(mode="json"), indent=1),
        versions=versions(),
        silhouettes=_silhouette_numbers(result, store),
    )
    write_report(folder / "report.html", data)


def _motion_words(result: RunResult) -> list[tuple[str, str]]:
    """What the poses say of themselves: how much of them was observed, and how calm they are."""
    persons = result.numbers.get("pose", {}).get("persons", {})
    observed = {p: n["observed_percent"] for p, n in persons.items() if n.get("observed_percent") is not None}
    jitter = {p: n["jitter_m_s3"] for p, n in persons.items() if n.get("jitter_m_s3") is not None}
    rows = []
    if observed:
        rows.append(("Landmarks observed", ", ".join(f"person {p}: {v:.1f} %" for p, v in observed.items())))
    if jitter:
        rows.append(
            ("Jitter of landmarks", ", ".join(f"person {p}: {v:.0f} m/s^3" for p, v in jitter.items()))
        )
    return rows


def _silhouette_numbers(result: RunResult, store: StageStore) -> dict[str, dict[str, float | None]]:
    """The quality of each camera's masks, with the share that the hull of some frames does not reach."""
    numbers = {name: dict(row) for name, row in result.numbers.get("segment", {}).get("cameras", {}).items()}
    if not numbers or "carve" not in result.numbers:
        return numbers
    grid, hulls, masks = stored_grid(store), store.reader("carve"), store.reader("segment")
    uncovered = []
    for frame in _chosen_frames(result, hulls.frames, _RESIDUAL_FRAMES):
        hull = hull_from_arrays(grid, hulls.read(int(frame)))
        silhouettes = masks_from_arrays(masks.read(int(frame)), result.session)
        if len(hull):
            uncovered.append(silhouette_residuals(hull, silhouettes, result.session.rig).uncovered)
    for c, name in enumerate(result.session.rig.names):
        known = [float(row[c]) for row in uncovered if np.isfinite(row[c])]
        numbers[name]["residual"] = float(np.median(known)) if known else None
    return numbers


def _observation_words(result: RunResult) -> list[tuple[str, str]]:
    """What the poses were found from."""
    detect, volume = result.numbers.get("detect"), result.numbers.get("carve", {})
    if detect is not None:
        source = {"detections": "detections/", "colour": "their colour in the pictures"}[detect["source"]]
        return [
            ("Markers found by", source),
            ("Marker detections", f"{detect['mean_detections_per_picture']} per picture"),
        ]
    return [
        ("Mean volume of the hull", f"{volume.get('mean_volume_litres', 0)} litres"),
        ("Cameras that may be wrong about a voxel", str(volume.get("n_faulty_views", 0))),
    ]


def _filter_words(config: Config, *, is_markers: bool) -> str:
    pose = config.pose
    text = f"{pose.filter}, {pose.n_layers} layers of {pose.n_particles} particles"
    if pose.refine and is_markers:
        text += ", refined on the detections"
    elif pose.refine:
        text += ", refined on the hull's surface"
    return text


def _figures(result: RunResult, store: StageStore) -> Iterator[Figure]:
    from mocap.view import (
        Figure,
        FilterHealth,
        plot_error_over_time,
        plot_filter_health,
        plot_foreground_share,
        plot_landmark_errors,
        plot_mask_quality,
        plot_stage_timing,
        plot_track_map,
    )

    session = result.session
    truth = session.truth_dir
    if result.scores is not None and truth is not None and result.poses:
        errors = errors_by_person(result, truth)
        if errors:
            yield Figure(
                "Error over time",
                "Distance between estimated and true landmarks: mean and worst landmark of every frame.",
                plot_error_over_time(errors),
                section="accuracy",
            )
        per_landmark = result.scores.get("per_landmark_mm")
        if per_landmark:
            yield Figure(
                "Error by landmark",
                "Mean distance to the truth. Definitions of neck, head and hips differ between body models by "
                "a few centimetres.",
                plot_landmark_errors({k: v for k, v in per_landmark.items() if v is not None}),
                section="accuracy",
            )
    truth_tracks = None
    if truth is not None and (truth / "tracks.csv").exists():
        truth_tracks = read_tracks_csv(truth / "tracks.csv")
    yield Figure(
        "Paths from above",
        "Cameras, room and the path of every person; truth dashed where it is known.",
        plot_track_map(
            session.rig,
            result.tracks,
            truth_tracks,
            bounds_m=_room_bounds(result, store),
        ),
        section="tracks",
    )
    timing = {k: 1000.0 * v / len(session.frames) for k, v in result.timings_s.items() if k != "report"}
    if timing:
        yield Figure(
            "Time per stage",
            "Wall-clock milliseconds per frame.",
            plot_stage_timing(timing),
            section="timing",
        )
    if "segment" in result.numbers:
        frames, share = [], []
        for frame, arrays in store.reader("segment"):
            frames.append(frame)
            share.append(arrays["share"])
        shares = np.array(share, dtype=np.float64)
        yield Figure(
            "Foreground by camera",
            "Share of the picture that was taken for a person; a jump in one camera is a light or a bump.",
            plot_foreground_share(
                np.array(frames), {name: shares[:, c] for c, name in enumerate(session.rig.names)}
            ),
        )
    silhouettes = _silhouette_numbers(result, store)
    if silhouettes:
        yield Figure(
            "Defects of the silhouettes",
            "Long bars mark cameras whose silhouettes to look at.",
            plot_mask_quality(silhouettes),
            section="silhouettes",
        )
    if result.poses and len(session.frames) > 1:
        health = [
            FilterHealth(
                person=p.person,
                frames=p.frames,
                ess_share=p.ess_share,
                log_likelihood=p.log_likelihood,
            )
            for p in result.poses
        ]
        yield Figure(
            "Health of the filter",
            "Effective share of the particles and log-likelihood of the pose; a drop marks frames to look at.",
            plot_filter_health(health),
        )


def errors_by_person(result: RunResult, truth_dir: Path) -> dict[int, tuple[NDArray[np.int64], Array]]:
    """Frames (T,) and landmark errors (T, 15) mm of every estimated person that the truth knows."""
    from mocap.metrics import associate_persons

    truth = read_landmarks_csv(truth_dir / "landmarks.csv")
    errors = {}
    for estimate, true in associate_persons(result.motions, truth, frames=list(result.session.frames)):
        if estimate is None or true is None:
            continue
        common, i, j = np.intersect1d(estimate.frames, true.frames, return_indices=True)
        if len(common):
            errors[estimate.person] = (common, point_errors(estimate.landmarks[i], true.landmarks[j]))
    return errors


def _panels(result: RunResult, store: StageStore, config: Config) -> Iterator[FramePanel]:
    """Pictures of a few frames: image, silhouette, hull and fitted body in a few cameras."""
    session = result.session
    if "detect" in result.numbers:
        yield from marker_panels(result, store, config)
        return
    grid = stored_grid(store)
    hulls, masks = store.reader("carve"), store.reader("segment")
    frames = hulls.frames
    for frame in _chosen_frames(result, frames, config.output.report_frames):
        images = _images_at(result, int(frame))
        arrays = hulls.read(int(frame))
        hull = hull_from_arrays(grid, arrays)
        mask = masks_from_arrays(masks.read(int(frame)), session)
        rows = _rows_at(result.poses, int(frame))
        step = max(1, -(-len(session.rig) // config.output.report_cameras))
        for c in list(range(0, len(session.rig), step))[: config.output.report_cameras]:
            yield FramePanel(
                frame=int(frame),
                title=f"{session.rig[c].name}",
                images=tuple(_views(result, c, images[c], mask[c], hull, rows)),
            )


def marker_panels(result: RunResult, store: StageStore, config: Config) -> Iterator[FramePanel]:
    """Pictures of a few frames: image, detections and fitted body in a few cameras."""
    from mocap.view import crop, draw_body, draw_skeleton, person_window
    from mocap.view.detections import draw_detections

    session = result.session
    frames = np.array(session.frames, dtype=np.int64)
    step = max(1, -(-len(session.rig) // config.output.report_cameras))
    for frame in _chosen_frames(result, frames, config.output.report_frames):
        images = _images_at(result, int(frame))
        detections = detections_at(store, session, int(frame))
        rows = _rows_at(result.poses, int(frame))
        for c in list(range(0, len(session.rig), step))[: config.output.report_cameras]:
            camera, image = session.rig[c], images[c]
            points = [p.landmarks[i] for p, i in rows]
            window = person_window(camera, np.concatenate(points)) if points else (0, 0, *camera.size)
            scale = _PANEL_HEIGHT_PX / max(1, window[3] - window[1])
            body, skeleton = image, draw_detections(image, camera, detections[c])
            for p, i in rows:
                body = draw_body(body, camera, body_parts(p.body, p.states[i]))
                skeleton = draw_skeleton(
                    skeleton, camera, p.landmarks[i], p.observed[i], label=f"person {p.person}"
                )
            views = (
                ("image", image),
                ("detections", draw_detections(image, camera, detections[c])),
                ("fitted body", body),
                ("skeleton and detections", skeleton),
            )
            yield FramePanel(
                frame=int(frame),
                title=camera.name,
                images=tuple((label, crop(picture, window, scale=scale)) for label, picture in views),
            )


def _views(
    result: RunResult,
    c: int,
    image: Image,
    mask: NDArray[np.bool_],
    hull: Hull,
    rows: list[tuple[PersonPoses, int]],
) -> Iterator[tuple[str, Image]]:
    from mocap.view import crop, draw_body, draw_hull, draw_mask, draw_skeleton, person_window

    camera = result.session.rig[c]
    points = hull.centers if len(hull) else np.zeros((0, 3))
    window = person_window(camera, points) if len(points) else (0, 0, *camera.size)
    scale = _PANEL_HEIGHT_PX / max(1, window[3] - window[1])
    body, skeleton = image, image
    for p, i in rows:
        body = draw_body(body, camera, body_parts(p.body, p.states[i]))
        skeleton = draw_skeleton(skeleton, camera, p.landmarks[i], p.observed[i], label=f"person {p.person}")
    for label, picture in (
        ("image", image),
        ("silhouette", draw_mask(image, mask)),
        ("hull", draw_hull(image, camera, hull)),
        ("fitted body", body),
        ("skeleton", skeleton),
    ):
        yield label, crop(picture, window, scale=scale)


def _images_at(result: RunResult, frame: int) -> tuple[Image, ...]:
    """Pictures of one frame; grey ones when the session has only masks."""
    session = result.session
    if not session.image_sources:
        return tuple(np.full((c.size[1], c.size[0], 3), 90, dtype=np.uint8) for c in session.rig)
    with FrameReader(session.image_sources, session.rig, range(frame, frame + 1)) as reader:
        return next(iter(reader))[1]


def _chosen_frames(result: RunResult, frames: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """Frames evenly spread over those in which somebody was found, or over the clip."""
    seen = sorted({int(f) for p in result.poses for f in p.frames})
    pool = np.array(seen if seen else frames, dtype=np.int64)
    return pool[np.unique(np.linspace(0, len(pool) - 1, n).round().astype(int))]


__all__ = ["body_parts", "write_outputs", "write_pose_npz", "write_run_report", "write_scene"]
