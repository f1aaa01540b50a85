"""Tracking: from hulls to persons over time, and the owner of every voxel."""

from __future__ import annotations

import numpy as np

from mocap.data import Tracks
from mocap.io.session import Session
from mocap.io.store import StageStore
from mocap.pipeline.config import Config
from mocap.pipeline.stages.carve import stored_grid
from mocap.pipeline.stages.report import Progress
from mocap.tracking import TrackerSettings, TrackerState, track_step, tracks_from_history
from mocap.volume import connected_components


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
