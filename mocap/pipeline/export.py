"""Files for other tools from a finished run, without running it again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from mocap.data import Hull
from mocap.errors import MocapError
from mocap.files import load_json
from mocap.io._files import writing
from mocap.io.formats import voxels, write_bids_motion, write_mesh, write_movement
from mocap.io.store import StageStore
from mocap.pipeline.config import Config
from mocap.pipeline.outputs import MotionStyle, motion_writers
from mocap.pipeline.outside import check_outside
from mocap.pose.kinematics import Kinematics
from mocap.pose.method import Method
from mocap.pose.result import PersonPoses, motion_of
from mocap.products import poses as poses_product
from mocap.products.hulls import PRODUCT, grid_from_attrs, hull_from_arrays
from mocap.products.one_run import check_one_run
from mocap.products.poses import stored_poses
from mocap.progress import Progress, no_progress
from mocap.volume import hull_mesh

Frames = tuple[int | None, int | None]

_PLAIN = MotionStyle()
# What can be exported -> formats, the first by default.
EXPORTS: dict[str, tuple[str, ...]] = {
    "voxels": ("ply", "npz", "glb"),
    "mesh": ("ply", "glb"),
    "motion": ("bvh", "trc", "c3d", "glb", "usd", "mot", "osim", "nc", "bids"),
}


class HullWriter(NamedTuple):
    """What writes the hull of one frame as STEM_000012.SUFFIX."""

    stem: str
    suffix: str
    write: Callable[[Path, Hull], None]


def export_run(
    out: Path,
    folder: Path,
    *,
    what: str,
    format: str | None = None,
    frames: Frames | None = None,
    cubes: bool = False,
    style: MotionStyle = _PLAIN,
    progress: Progress | None = None,
) -> list[Path]:
    """Write voxels, meshes of the hull, or motion of the run in `out` into `folder`; returns the files.

    what, format : see EXPORTS; format None = the first one.  frames : (start, stop) in frames of the session, either
    may be None. Motion holds the frames that a person was followed in.  cubes : voxels in PLY as coloured faces.
    style : how motion is written.
    Raises MocapError for an unknown kind or format, a folder without such a result, a range without frames, or a
    session as `folder`.
    """
    if what not in EXPORTS:
        raise MocapError(f"nothing named {what!r} can be exported", remedy=f"use one of {', '.join(EXPORTS)}")
    chosen = EXPORTS[what][0] if format is None else format
    if chosen not in EXPORTS[what]:
        raise MocapError(
            f"{what} cannot be written as {chosen!r}", remedy=f"use one of {', '.join(EXPORTS[what])}"
        )
    check_outside(folder)
    check_one_run(out, PRODUCT if what in ("voxels", "mesh") else poses_product.PRODUCT)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    store = StageStore(out / "store.zarr")
    tick = progress or no_progress
    if what != "motion":
        return _export_hulls(store, folder, _hull_writers(cubes)[what, chosen], frames, tick)
    fps, session, method = _about(out)
    if chosen in ("nc", "bids"):
        return _export_together(store, folder, chosen, frames, fps, style.task or session)
    return _export_motion(store, folder, chosen, frames, fps, method, style, tick)


def _hull_writers(cubes: bool) -> dict[tuple[str, str], HullWriter]:
    """Kind and format -> how files begin and end, and what writes one."""
    return {
        ("voxels", "ply"): HullWriter(
            "voxels", ".ply", lambda path, hull: voxels.write_voxels_ply(path, hull, cubes=cubes)
        ),
        ("voxels", "npz"): HullWriter("voxels", ".npz", voxels.write_voxels_npz),
        ("voxels", "glb"): HullWriter("voxels", ".glb", voxels.write_voxels_glb),
        **{
            ("mesh", suffix): HullWriter(
                "mesh", f".{suffix}", lambda path, hull: write_mesh(path, hull_mesh(hull))
            )
            for suffix in EXPORTS["mesh"]
        },
    }


def _export_hulls(
    store: StageStore, folder: Path, writer: HullWriter, frames: Frames | None, progress: Progress
) -> list[Path]:
    """One file per frame, voxels_000012.ply."""
    reader = store.reader(PRODUCT)
    grid = grid_from_attrs(reader.attrs)
    chosen = [int(f) for f in reader.frames if _is_in(int(f), frames)]
    if not chosen:
        raise _no_frames(frames, int(reader.frames[0]), int(reader.frames[-1]))
    written = []
    for i, frame in enumerate(chosen):
        path = folder / f"{writer.stem}_{frame:06d}{writer.suffix}"
        writer.write(path, hull_from_arrays(grid, reader.read(frame)))
        written.append(path)
        progress("export", i + 1, len(chosen))
    return written


def _export_motion(
    store: StageStore,
    folder: Path,
    format: str,
    frames: Frames | None,
    fps: float,
    method: Method,
    style: MotionStyle,
    progress: Progress,
) -> list[Path]:
    """One file per person, person_1.bvh."""
    people = _people_in(store, frames)
    written = []
    for i, poses in enumerate(people):
        path = folder / f"person_{poses.person}.{format}"
        motion_writers(Kinematics(poses, fps, method), style)[format](path)
        written.append(path)
        progress("export", i + 1, len(people))
    return written


def _export_together(
    store: StageStore, folder: Path, format: str, frames: Frames | None, fps: float, task: str
) -> list[Path]:
    """All persons in one file or data set."""
    motions = [motion_of(poses, fps) for poses in _people_in(store, frames)]
    if format == "bids":
        return write_bids_motion(folder, motions, fps, task)
    write_movement(folder / "motion.nc", motions, fps)
    return [folder / "motion.nc"]


def _people_in(store: StageStore, frames: Frames | None) -> list[PersonPoses]:
    """The persons in the range; those without a frame there are left out."""
    people = stored_poses(store)
    if not people:
        raise MocapError("the run has found no person", remedy="look at its report.html")
    cut = [_cut(p, np.array([_is_in(int(f), frames) for f in p.frames], dtype=np.bool_)) for p in people]
    present = [p for p in cut if len(p.frames)]
    if not present:
        seen = np.concatenate([p.frames for p in people])
        raise _no_frames(frames, int(seen.min()), int(seen.max()))
    return present


def _cut(poses: PersonPoses, keep: NDArray[np.bool_]) -> PersonPoses:
    """One person in the frames to keep, (T,)."""
    return replace(
        poses,
        frames=poses.frames[keep],
        states=poses.states[keep],
        landmarks=poses.landmarks[keep],
        observed=poses.observed[keep],
        landmark_covariance=poses.landmark_covariance[keep],
    )


def _is_in(frame: int, frames: Frames | None) -> bool:
    start, stop = frames or (None, None)
    return (start is None or frame >= start) and (stop is None or frame < stop)


def _no_frames(frames: Frames | None, first: int, last: int) -> MocapError:
    return MocapError(
        f"no frame lies in the range {frames}",
        remedy=f"the result holds frames {first} to {last}; write --frames {first}:{last + 1}",
    )


def _about(out: Path) -> tuple[float, str, Method]:
    """Frames a second of the run, what its session is called, and its settings of angles and contacts; the usual ones
    where another version has made it."""
    try:
        about = load_json(out / "run.json")
        config = about.get("config")
        method = Method() if config is None else _method_of(config)
        return float(about["fps"]), str(about.get("session", "session")), method
    except (MocapError, ValueError, KeyError, TypeError) as error:
        raise MocapError(
            "the frame rate of the run is not known",
            path=out / "run.json",
            remedy="run `mocap run SESSION -o OUT` to its end",
        ) from error


def _method_of(config: object) -> Method:
    try:
        return Config.model_validate(config).method
    except ValidationError:
        return Method()
