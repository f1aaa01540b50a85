"""Files for other tools from a finished run, without running it again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import Hull, Motion
from mocap.errors import MocapError
from mocap.files import load_json
from mocap.io._files import writing
from mocap.io.formats import voxels
from mocap.io.store import StageStore
from mocap.pipeline.outputs import MotionStyle, motion_writers
from mocap.pose.result import PersonPoses, motion_of
from mocap.products import poses as poses_product
from mocap.products.hulls import PRODUCT, grid_from_attrs, hull_from_arrays
from mocap.products.one_run import check_one_run
from mocap.products.poses import stored_poses
from mocap.progress import Progress, no_progress

Frames = tuple[int | None, int | None]

_PLAIN = MotionStyle()
# What can be exported -> formats, the first by default.
EXPORTS: dict[str, tuple[str, ...]] = {
    "voxels": ("ply", "npz", "glb"),
    "motion": ("bvh", "trc", "c3d", "glb", "mot", "osim"),
}


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
    """Write voxels or motion of the run in `out` into `folder`; returns the files.

    what, format : see EXPORTS; format None = the first one.  frames : (start, stop) in frames of the session, either
    may be None. Motion holds the frames that a person was followed in.  cubes : voxels in PLY as coloured faces.
    style : how motion is written.
    Raises MocapError for an unknown kind or format, a folder without such a result, or a range without frames.
    """
    if what not in EXPORTS:
        raise MocapError(f"nothing named {what!r} can be exported", remedy=f"use one of {', '.join(EXPORTS)}")
    chosen = EXPORTS[what][0] if format is None else format
    if chosen not in EXPORTS[what]:
        raise MocapError(
            f"{what} cannot be written as {chosen!r}", remedy=f"use one of {', '.join(EXPORTS[what])}"
        )
    check_one_run(out, PRODUCT if what == "voxels" else poses_product.PRODUCT)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    store = StageStore(out / "store.zarr")
    tick = progress or no_progress
    if what == "voxels":
        return _export_voxels(store, folder, chosen, frames, cubes, tick)
    return _export_motion(store, folder, chosen, frames, _fps_of_run(out), style, tick)


def _export_voxels(
    store: StageStore, folder: Path, format: str, frames: Frames | None, cubes: bool, progress: Progress
) -> list[Path]:
    """One file per frame, voxels_000012.ply."""
    reader = store.reader(PRODUCT)
    grid = grid_from_attrs(reader.attrs)
    chosen = [int(f) for f in reader.frames if _is_in(int(f), frames)]
    if not chosen:
        raise _no_frames(frames, int(reader.frames[0]), int(reader.frames[-1]))
    write: dict[str, Callable[[Path, Hull], None]] = {
        "ply": lambda path, hull: voxels.write_voxels_ply(path, hull, cubes=cubes),
        "npz": voxels.write_voxels_npz,
        "glb": voxels.write_voxels_glb,
    }
    written = []
    for i, frame in enumerate(chosen):
        path = folder / f"voxels_{frame:06d}.{format}"
        write[format](path, hull_from_arrays(grid, reader.read(frame)))
        written.append(path)
        progress("export", i + 1, len(chosen))
    return written


def _export_motion(
    store: StageStore,
    folder: Path,
    format: str,
    frames: Frames | None,
    fps: float,
    style: MotionStyle,
    progress: Progress,
) -> list[Path]:
    """One file per person, person_1.bvh."""
    people = stored_poses(store)
    written = []
    for i, poses in enumerate(people):
        keep = np.array([_is_in(int(f), frames) for f in poses.frames], dtype=np.bool_)
        if not keep.any():
            continue
        path = folder / f"person_{poses.person}.{format}"
        _write_person(path, format, poses, keep, fps, style)
        written.append(path)
        progress("export", i + 1, len(people))
    if not people:
        raise MocapError("the run has found no person", remedy="look at its report.html")
    if not written:
        seen = np.concatenate([p.frames for p in people])
        raise _no_frames(frames, int(seen.min()), int(seen.max()))
    return written


def _write_person(
    path: Path, format: str, poses: PersonPoses, keep: NDArray[np.bool_], fps: float, style: MotionStyle
) -> None:
    """One person in the frames to keep, (T,)."""
    motion = motion_of(poses, fps)
    kept = Motion(motion.person, motion.frames[keep], motion.time_s[keep], motion.landmarks[keep])
    shown = replace(
        poses,
        frames=poses.frames[keep],
        states=poses.states[keep],
        landmarks=poses.landmarks[keep],
        observed=poses.observed[keep],
        landmark_covariance=poses.landmark_covariance[keep],
    )
    motion_writers(shown, kept, fps, style)[format](path)


def _is_in(frame: int, frames: Frames | None) -> bool:
    start, stop = frames or (None, None)
    return (start is None or frame >= start) and (stop is None or frame < stop)


def _no_frames(frames: Frames | None, first: int, last: int) -> MocapError:
    return MocapError(
        f"no frame lies in the range {frames}",
        remedy=f"the result holds frames {first} to {last}; write --frames {first}:{last + 1}",
    )


def _fps_of_run(out: Path) -> float:
    try:
        return float(load_json(out / "run.json")["fps"])
    except (MocapError, ValueError, KeyError, TypeError) as error:
        raise MocapError(
            "the frame rate of the run is not known",
            path=out / "run.json",
            remedy="run `mocap run SESSION -o OUT` to its end",
        ) from error
