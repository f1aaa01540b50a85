"""The 3D scene of a run: frame by frame what the viewer shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, cones_of
from mocap.io.session.reading import pictures_of
from mocap.pipeline.record import Found
from mocap.pose.result import PersonPoses
from mocap.products.hulls import PRODUCT, hull_at, stored_grid
from mocap.view import BodyPart
from mocap.volume import choose_grid

if TYPE_CHECKING:
    from mocap.view import SceneFrame

Array = NDArray[np.float64]
# frame -> person -> points (K, 3) m of every layer.
LayersOf = Callable[[int], Mapping[int, Sequence[Array]]]
Bounds = tuple[list[float], list[float]]

_BOUNDS_STEP_M = 0.1
# Of a longer recording every k-th frame is shown: bodies of 3000 frames take 18 MB a person, of an hour 650.
_MOST_FRAMES = 3000


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


def rows_at(poses: Sequence[PersonPoses], frame: int) -> list[tuple[PersonPoses, int]]:
    """The persons who have a pose in a frame, each with its row."""
    rows = []
    for p in poses:
        i = int(np.searchsorted(p.frames, frame))
        if i < len(p.frames) and p.frames[i] == frame:
            rows.append((p, i))
    return rows


def write_scene(
    found: Found,
    path: Path,
    *,
    pictures: Sequence[str] | None = None,
    layers_of: LayersOf | None = None,
) -> None:
    """scene.rrd: cameras, images, coloured voxels and bodies on a time line.

    pictures : cameras whose pictures are kept, None = all.  layers_of : frame -> the filter's particles, as
    `SceneFrame` has them; None = they are not shown.
    """
    from mocap.view import write_rrd

    session = found.session
    write_rrd(
        path,
        session.rig,
        scene_frames(found, pictures, layers_of or (lambda frame: {})),
        tracks=found.tracks,
        bounds_m=room_bounds(found),
        n_frames=len(shown_frames(session.frames)),
    )


def shown_frames(frames: range) -> range:
    """All frames, or every k-th of a long recording."""
    return frames[:: -(-len(frames) // _MOST_FRAMES) or 1]


def scene_frames(
    found: Found, kept: Sequence[str] | None = None, layers_of: LayersOf = lambda frame: {}
) -> Iterator[SceneFrame]:
    """The frames that are shown, in order, with pictures, hull and bodies; every product is opened once.

    kept : cameras whose pictures are shown, None = all; the clips of others are not read.
    """
    from mocap.view import SceneFrame

    session = found.session
    frames = shown_frames(session.frames)
    with ExitStack() as stack:
        pictures = hull_of = None
        names = tuple(name for name in session.rig.names if kept is None or name in kept)
        if session.image_sources and names:
            pictures = iter(stack.enter_context(pictures_of(session, frames, names)))
        if found.hulls is not None:
            hull_of = partial(hull_at, found.hulls.reader(PRODUCT))
        for frame in frames:
            rows = rows_at(found.poses, frame)
            images = next(pictures)[1] if pictures is not None else None
            yield SceneFrame(
                frame=frame,
                time_s=frame / session.fps,
                images=dict(zip(names, images, strict=True)) if images else None,
                hull=None if hull_of is None else hull_of(frame),
                persons={p.person: p.landmarks[i] for p, i in rows},
                parts={p.person: body_parts(p.body, p.states[i]) for p, i in rows},
                layers=layers_of(frame),
            )


def room_bounds(found: Found) -> Bounds:
    """Lower and upper corner of the room, m: the voxel grid's, the session's, or the cameras' common view."""
    if found.hulls is not None:
        grid = stored_grid(found.hulls)
    else:
        grid = choose_grid(found.session.rig, _BOUNDS_STEP_M, bounds_m=found.session.room_bounds_m)
    return grid.origin.tolist(), grid.upper.tolist()
