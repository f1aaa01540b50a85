"""The 3D scene of a run: frame by frame what the viewer shows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, cones_of
from mocap.pipeline.record import Found
from mocap.pose.result import PersonPoses
from mocap.products.hulls import PRODUCT, hull_at, stored_grid
from mocap.view.overlay import BodyPart, Side
from mocap.volume import choose_grid

if TYPE_CHECKING:
    from mocap.view import CodedPictures, SceneFrame

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
    return [
        BodyPart(name=name, side=side, cones=tuple((start[k], end[k], r0, r1) for k, r0, r1 in cones))
        for name, side, cones in _flesh_of(body)
    ]


@cache
def _flesh_of(body: Body) -> list[tuple[str, Side, list[tuple[int, float, float]]]]:
    """Name and side of every part, and its cones: their places in the body, and their radii, m."""
    radii = body.cones.radii.tolist()
    own = [np.flatnonzero(body.cones.part == p).tolist() for p in range(body.layout.n_parts)]
    return [
        (name, side, [(k, *radii[k]) for k in rows])
        for name, side, rows in zip(body.layout.parts, body.part_sides, own, strict=True)
    ]


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
    pictures: Callable[[], Iterable[CodedPictures]] = tuple,
    layers_of: LayersOf | None = None,
) -> None:
    """scene.rrd: cameras, images, coloured voxels and bodies on a time line.

    pictures : gives those that are shown, when all else is in the scene.  layers_of : frame -> the filter's particles,
    as `SceneFrame` has them; None = they are not shown.
    """
    from mocap.view import write_rrd

    session = found.session
    write_rrd(
        path,
        session.rig,
        scene_frames(found, layers_of or (lambda frame: {})),
        pictures=pictures,
        tracks=found.tracks,
        bounds_m=room_bounds(found),
        n_frames=len(shown_frames(session.frames)),
    )


def shown_frames(frames: range) -> range:
    """All frames, or every k-th of a long recording."""
    return frames[:: -(-len(frames) // _MOST_FRAMES) or 1]


def scene_frames(found: Found, layers_of: LayersOf = lambda frame: {}) -> Iterator[SceneFrame]:
    """The frames that are shown, in order, with hull and bodies; the hulls are opened once."""
    from mocap.view import SceneFrame

    session = found.session
    hull_of = None if found.hulls is None else partial(hull_at, found.hulls.reader(PRODUCT))
    for frame in shown_frames(session.frames):
        rows = rows_at(found.poses, frame)
        yield SceneFrame(
            frame=frame,
            time_s=frame / session.fps,
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
