"""Persons of boxes in a voxel world, with clothes, for the tests of the trackers."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.ndimage import binary_erosion, label

from mocap.tracking import FrameVoxels, TrackerSettings, TrackerState, track_step, tracks_from_history

SIDE = 0.05
SHAPE = (110, 100, 50)
ORIGIN = np.array([-2.75, -2.5, 0.0])
FPS = 20.0
RED, BLUE, GREEN = (200, 40, 30), (30, 50, 190), (40, 150, 50)


def box(x, y, half_x, half_y, z0, z1, rgb=(128, 128, 128)):
    return (x - half_x, y - half_y, z0), (x + half_x, y + half_y, z1), rgb


def person(x, y, shirt=(128, 128, 128), trousers=(60, 60, 60), height=1.7):
    """Trousers up to half of the height, a shirt, and a head."""
    hip, neck = height * 0.5, height * 0.85
    return [
        box(x, y, 0.15, 0.2, 0.0, hip, trousers),
        box(x, y, 0.15, 0.2, hip, neck, shirt),
        box(x, y, 0.1, 0.1, neck, height, (220, 180, 150)),
    ]


def chair(x, y):
    return [
        box(x, y, 0.25, 0.25, 0.0, 0.45, (90, 60, 30)),
        box(x - 0.2, y, 0.05, 0.25, 0.45, 0.9, (90, 60, 30)),
    ]


def observe(boxes, frame=0, side=SIDE, colours=True):
    """The observation of a union of boxes; made once for all tests that ask for the same."""
    return _observe(tuple(boxes), frame, side, colours)


@lru_cache(maxsize=2000)
def _observe(boxes, frame, side, colours):
    """The observation of a union of boxes; of boxes that overlap the later one gives the colour."""
    if not boxes:
        return FrameVoxels(frame, np.zeros((0, 3)), np.zeros(0, dtype=int))
    room = np.array(SHAPE) * SIDE / side
    ends = [
        [np.round((np.array(end) - ORIGIN) / side).clip(0, room).astype(int) for end in b[:2]] for b in boxes
    ]
    first = np.min([a for a, _ in ends], axis=0) - 1
    shape = tuple(np.max([b for _, b in ends], axis=0) - first + 1)
    dense, rgb = np.zeros(shape, dtype=bool), np.zeros((*shape, 3), dtype=np.uint8)
    for (a, b), (_, _, colour) in zip(ends, boxes, strict=True):
        where = tuple(slice(i, j) for i, j in zip(a - first, b - first, strict=True))
        dense[where], rgb[where] = True, colour
    labels, _ = label(dense, structure=np.ones((3, 3, 3)))
    is_surface = (dense & ~binary_erosion(dense))[dense]
    return FrameVoxels(
        frame,
        ORIGIN + (np.argwhere(dense) + first + 0.5) * side,
        labels[dense] - 1,
        is_surface,
        rgb[dense] if colours else None,
        is_surface if colours else None,
    )


def settings(**changes):
    values = {"fps": FPS, "confirm_frames": 3, "lost_frames": 6, "tentative_misses": 1} | changes
    return TrackerSettings(values.pop("voxel_size_m", SIDE), **values)


def run(clip, s, *, state=None, seed=0, frames=None, colours=True):
    """Infos of all frames and the last state.  frames : numbers of the frames, None = 0, 1, ..."""
    rng = np.random.default_rng(seed)
    state = TrackerState() if state is None else state
    infos = []
    for i, boxes in enumerate(clip):
        frame = i if frames is None else frames[i]
        observation = (
            boxes if isinstance(boxes, FrameVoxels) else observe(boxes, frame, s.voxel_size_m, colours)
        )
        state, info = track_step(state, observation, s, rng=rng)
        infos.append(info)
    return infos, state


def table(infos, s):
    return tracks_from_history([(i.frame, i.tracks) for i in infos], s.fps, min_seen=s.confirm_frames)


def confirmed(info):
    return [t.person for t in info.tracks if t.status != "tentative"]
