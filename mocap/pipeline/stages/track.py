"""Tracking: from hulls to persons over time, and the owner of every voxel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.data import Tracks
from mocap.errors import MocapError
from mocap.io.session import Session
from mocap.io.store import StageStore, StageWriter
from mocap.pipeline.config import Config
from mocap.pipeline.rng import rng_for
from mocap.pipeline.stages.carve import hull_from_arrays, stored_grid
from mocap.pipeline.stages.report import Progress
from mocap.pipeline.tracking import tracker_input, tracker_settings
from mocap.tracking import Track, TrackerState, slim, track_step, tracks_from_history


def track_stage(
    session: Session, config: Config, store: StageStore, key: str, *, seed: int = 0, progress: Progress
) -> Tracks:
    """Persons over time: components, features, tracker; the owner of every voxel into the store.

    Store: per frame `owner` (N,) uint16, the person that holds each voxel of the hull, 0 = nobody.
    Source: CF 4.2-4.3.
    """
    grid = stored_grid(store)
    n = len(session.frames)
    size = config.tracking.voxel_size_m
    if size is not None and size < grid.voxel_size_m - 1e-9:
        raise MocapError(
            f"configuration: tracking.voxel_size_m is {size}, finer than the volume's {grid.voxel_size_m}",
            remedy="leave tracking.voxel_size_m out, or carve finer voxels (volume.voxel_size_m)",
        )
    try:
        settings = tracker_settings(config.tracking, grid, session.fps, n)
    except ValueError as error:
        raise MocapError(f"configuration: tracking: {error}", remedy="correct the setting") from error
    state = TrackerState()
    history = []
    with store.writer("track-owners", key, {}) as out:
        owners = _Owners(out)
        for i, (frame, arrays) in enumerate(store.reader("carve")):
            seen = tracker_input(frame, hull_from_arrays(grid, arrays), config.tracking.voxel_size_m)
            state, info = track_step(state, seen.voxels, settings, rng=rng_for(seed, "track", 0, frame))
            serial_of = {t.person: t.serial for t in info.tracks}
            held = {serial_of[p] + 1: rows for p, rows in info.voxels_of.items()}
            owners.add(frame, seen.owners(held), info.tracks)
            history.append((info.frame, slim(info.tracks)))
            progress("track", i + 1, n)
        owners.flush()
    tracks = tracks_from_history(history, session.fps, min_seen=settings.confirm_frames)
    with store.writer("track", key, {}) as out:
        for frame in store.reader("carve").frames:
            rows = tracks.frame == frame
            assert tracks.covariance is not None
            assert tracks.observed is not None
            out.append(
                int(frame),
                person=tracks.person[rows],
                xyz=tracks.xyz[rows],
                covariance=tracks.covariance[rows],
                observed=tracks.observed[rows],
            )
    return tracks


class _Owners:
    """Writes owners frame by frame, as soon as it is known what every track in the frame is called.

    A new track may turn out to be somebody who returns; its frames wait until that is settled.
    """

    def __init__(self, out: StageWriter) -> None:
        self._out = out
        self._waiting: list[tuple[int, NDArray[np.uint32]]] = []
        self._person_of: dict[int, int] = {}

    def add(self, frame: int, owner: NDArray[np.uint32], tracks: tuple[Track, ...]) -> None:
        """One frame.  owner : (N,) serial + 1 of the track that holds each voxel, 0 = nobody."""
        self._waiting.append((frame, owner))
        self._person_of.update({t.serial: t.person for t in tracks})
        open_tracks = [t for t in tracks if not t.is_named]
        first_open = min((t.born for t in open_tracks), default=frame + 1)
        self._write(first_open)

    def flush(self) -> None:
        """Write whatever waits."""
        self._write(None)

    def _write(self, before: int | None) -> None:
        while self._waiting and (before is None or self._waiting[0][0] < before):
            frame, owner = self._waiting.pop(0)
            named = np.zeros(int(owner.max(initial=0)) + 1, dtype=np.uint16)
            for number in np.unique(owner):
                if number:
                    named[number] = self._person_of[int(number) - 1]
            self._out.append(frame, owner=named[owner])


def stored_tracks(store: StageStore, fps: float) -> Tracks:
    """The table of tracks from the store; those of the marker pipeline have no covariance."""
    columns: dict[str, list[NDArray[np.generic]]] = {}
    frame = []
    for f, arrays in store.reader("track"):
        frame += [f] * len(arrays["person"])
        for name, values in arrays.items():
            columns.setdefault(name, []).append(values)
    frames = np.array(frame, dtype=np.int64)
    joined = {name: np.concatenate(values) for name, values in columns.items()}
    n = len(frames)
    return Tracks(
        frame=frames,
        person=joined["person"].astype(np.int64) if "person" in joined else np.zeros(0, dtype=np.int64),
        time_s=frames / fps,
        xyz=joined["xyz"].reshape(-1, 3).astype(np.float64) if "xyz" in joined else np.zeros((0, 3)),
        covariance=joined["covariance"].reshape(n, 3, 3).astype(np.float64)
        if "covariance" in joined
        else None,
        observed=joined["observed"].astype(np.bool_) if "observed" in joined else None,
    )
