"""What the depth cameras of a session measure: clouds of points, the room behind the people, and where one stands."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mocap.data import CameraRig
from mocap.data.depth import DepthNoise
from mocap.errors import MocapError, did_you_mean
from mocap.io._files import writing
from mocap.io.calibration import write_calibration
from mocap.io.formats import write_cloud, write_mesh
from mocap.io.formats.voxels import UNSEEN_GREY
from mocap.io.session import Session, open_session
from mocap.io.session.reading import depth_of, pictures_of
from mocap.io.video import Image
from mocap.pipeline.outside import check_outside
from mocap.pipeline.refine import check_new
from mocap.progress import Progress, no_progress
from mocap.volume.depth_fusion import fused_surface
from mocap.volume.depth_registration import Registration, register_depth
from mocap.volume.measured_room import RoomView, cloud_of, still_reading, together, without_edges

Frames = tuple[int | None, int | None]

_N_LOOKS = 25  # of the room behind the people; noise goes down to a fifth
_NOISE = DepthNoise()
# What a registration must show. Of the boxes of tests/volume/boxed_room.py, seen by two or three cameras: the right
# place has `fixed` 0.11 and `before` 0.000; wrong ones, and some that are open by centimetres, 0.003 and up to 0.15.
_LEAST_FIXED = 0.02
_LEAST_SHARED_M2, _MOST_BEFORE, _MOST_RIVAL = 0.1, 0.05, 0.8


@dataclass(frozen=True, eq=False)
class RegisteredSession:
    """found : where the camera stands.  rig : all cameras, it among them.  source : calibration of the others."""

    found: Registration
    rig: CameraRig
    source: Path


def export_clouds(
    session: Path | str,
    folder: Path,
    *,
    calibration: Path | str | None = None,
    frames: Frames | None = None,
    progress: Progress = no_progress,
) -> list[Path]:
    """Write what all depth cameras measure in each frame as folder/cloud_000012.ply, coloured points in the world.

    Readings at edges, which may lie where nothing is, are left out. Gives the files. Raises MocapError for a session
    that cannot be opened or has no depth.
    """
    check_outside(folder, session)
    opened = _with_depth(open_session(session, calibration=calibration, frames=frames))
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    written = []
    for i, (frame, views) in enumerate(_views_of(opened, list(opened.frames))):
        clear = [replace(view, depth_m=without_edges(view.depth_m, _NOISE)) for view in views]
        written.append(folder / f"cloud_{frame:06d}.ply")
        write_cloud(written[-1], together([cloud_of(view) for view in clear]))
        progress("clouds", i + 1, len(opened.frames))
    return written


def export_room(
    session: Path | str,
    path: Path,
    *,
    calibration: Path | str | None = None,
    frames: Frames | None = None,
    voxel_m: float = 0.02,
    progress: Progress = no_progress,
) -> int:
    """Write the room behind the people, as all depth cameras measure it together, as a coloured mesh; gives its faces.

    path : .ply in the world, or .glb with Y up.  People who stay for half of the looks stay in it.
    Raises MocapError for a session that cannot be opened or has no depth, MissingExtra without Open3D or trimesh.
    """
    check_outside(path, session)
    opened = _with_depth(open_session(session, calibration=calibration, frames=frames))
    mesh = fused_surface(_room_of(opened, progress), voxel_m=voxel_m)
    with writing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_mesh(path, mesh)
    return len(mesh.faces)


def register_session(
    session: Path | str,
    camera: str,
    *,
    calibration: Path | str | None = None,
    progress: Progress = no_progress,
) -> RegisteredSession:
    """Where a depth camera stands whose place is wrong or unknown, by the room that other depth cameras measure too.

    Its place in the calibration is a first guess that need not be right; its lens is kept, as is everything of the
    others. Raises MocapError for a session that cannot be opened, a camera that measures no depth, too little that
    stands in the view of two cameras, and places that what is measured leaves open; MissingExtra without Open3D.
    """
    opened = _with_depth(open_session(session, calibration=calibration, unplaced=(camera,)))
    names = list(opened.depth_sources)
    if camera not in names:
        raise MocapError(
            f"the session has no depth camera {camera}{did_you_mean(camera, names)}",
            path=opened.root,
            remedy=f"use one of {', '.join(names)}",
        )
    if len(names) == 1:
        raise MocapError(
            "no other camera of the session measures depth",
            path=opened.root,
            camera=camera,
            remedy=f"find it by people: mocap calibrate --refine {opened.root} -o FILE, or --place",
        )
    views = {view.camera.name: view for view in _room_of(opened, progress)}
    own = views.pop(camera)
    found = _checked(register_depth(own, list(views.values()), _NOISE), opened, camera)
    rig = CameraRig(tuple(found.camera if c.name == camera else c for c in opened.rig))
    return RegisteredSession(found, rig, opened.calibration_path)


def write_registered(path: Path, registered: RegisteredSession) -> None:
    """Write the new calibration, with how well the camera fits; never over a file that is there."""
    check_new(path)
    found = registered.found
    metadata: dict[str, object] = {
        "source": "mocap calibrate --register",
        "registered_from": registered.source.name,
        "registered_camera": found.camera.name,
        "residual_mm": round(1000 * found.residual_m, 2),
        "shared_m2": round(found.shared_m2, 3),
    }
    write_calibration(path, registered.rig, metadata=metadata)


def _checked(found: Registration | None, session: Session, camera: str) -> Registration:
    """The registration, or why there is none."""
    if found is None:
        why = "nothing that it measures above the floor lies on what other depth cameras measure"
    elif found.shared_m2 < _LEAST_SHARED_M2:
        why = (
            f"above the floor it has {found.shared_m2:.2f} m2 of surfaces in common with other depth cameras, needed "
            f"are {_LEAST_SHARED_M2}"
        )
    elif found.before > _MOST_BEFORE:
        why = f"{100 * found.before:.0f} % of what it measures would lie where others see that nothing is"
    elif found.fixed < _LEAST_FIXED:
        why = "the surfaces that it has in common with others, such as a bare floor, leave its place open"
    elif found.rival > _MOST_RIVAL:
        why = f"another place fits {100 * found.rival:.0f} % as well"
    else:
        return found
    raise MocapError(
        f"it cannot be told where it stands: {why}",
        path=session.root,
        camera=camera,
        remedy="let furniture or boxes of different sizes stand in the view of both cameras, or find it by people: "
        f"mocap calibrate --refine {session.root} -o FILE",
    )


def _with_depth(session: Session) -> Session:
    if not session.depth_sources:
        raise MocapError(
            "no camera of the session measures depth",
            path=session.root / "depth",
            remedy="put 16-bit maps into depth/CAM/000000.png",
        )
    return session


def _room_of(session: Session, progress: Progress) -> list[RoomView]:
    """What each depth camera has measured of the room behind the people."""
    frames = session.stretches[0]
    spread = np.unique(np.linspace(frames[0], frames[-1], _N_LOOKS).astype(int)).tolist()
    looks = []
    for i, (_, views) in enumerate(_views_of(session, spread)):
        looks.append(views)
        progress("depth", i + 1, len(spread))
    return [
        RoomView(
            views[0].camera,
            without_edges(still_reading([view.depth_m for view in views]), _NOISE),
            np.median([view.rgb for view in views], axis=0).astype(np.uint8),
        )
        for views in zip(*looks, strict=True)
    ]


def _views_of(session: Session, frames: Sequence[int]) -> Iterator[tuple[int, list[RoomView]]]:
    """What every depth camera measures, frame by frame; grey where the session has no pictures."""
    names = list(session.depth_sources)
    with ExitStack() as stack:
        depth = stack.enter_context(depth_of(session, frames))
        filmed: Iterator[tuple[int, tuple[Image, ...] | None]] = ((frame, None) for frame in frames)
        if session.image_sources:
            filmed = iter(stack.enter_context(pictures_of(session, frames, names)))
        for (frame, maps), (_, pictures) in zip(depth, filmed, strict=True):
            cameras = session.rig_at(frame).subset(names)
            grey = [np.full((*own.shape, 3), UNSEEN_GREY, dtype=np.uint8) for own in maps]
            yield frame, [RoomView(*view) for view in zip(cameras, maps, pictures or grey, strict=True)]
