"""Tracking: from hulls to persons over time, and the owner of every voxel."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import frames_in_words
from mocap.data import CameraRig, Tracks, VoxelGrid
from mocap.errors import MocapError
from mocap.io.store import StageStore
from mocap.pipeline.config import TrackingConfig
from mocap.pipeline.stage import Ending, FrameWork, Job, Row, Seen, Sources, Stage, StageReport
from mocap.pipeline.tracking import tracker_input, tracker_settings
from mocap.products import hulls as hulls_product
from mocap.products import owners as owners_product
from mocap.products import tracks as tracks_product
from mocap.products.hulls import read_hulls, stored_grid
from mocap.products.owners import owner_row, owners_at
from mocap.products.tracks import stored_tracks, track_row
from mocap.rng import rng_for
from mocap.tracking import Track, TrackerSettings, TrackerState, slim, track_step, tracks_from_history
from mocap.tracking.claims import BESIDE_M

# Who is cut off at the border of the room: a wrist is as thick, and who walks in through a wall is for some frames.
_WRIST_M2, _FEW_FRAMES, _FEW_SHARE = 0.002, 2, 0.1
_A_WHILE_S = 1.0  # who leaves a room with another is gone by then


@dataclass(frozen=True, eq=False)
class _Tracking:
    """settings : None until the first hull tells the grid.  n_frames : of the clip.  history : tracks of every frame so
    far, None where nobody asks for it.  owners : frames whose owners wait for the names of new tracks."""

    config: TrackingConfig
    seed: int
    fps: float
    n_frames: int
    is_room_known: bool
    rig: CameraRig
    tracker: TrackerState = field(default_factory=TrackerState)
    settings: TrackerSettings | None = None
    history: list[tuple[int, tuple[Track, ...]]] | None = None
    owners: _Owners = field(default_factory=lambda: _Owners())


def _reads(job: Job) -> Sources:
    return {"hull": read_hulls(job.store)}


def _start(job: Job) -> _Tracking:
    config, session = job.config.tracking, job.session
    return _Tracking(
        config,
        job.seed,
        session.fps,
        len(session.frames),
        session.has_empty_scene,
        session.rig,
        history=None if job.is_endless else [],
    )


def _settings(state: _Tracking, grid: VoxelGrid) -> TrackerSettings:
    """The tracker's settings on the grid of the hulls."""
    size = state.config.voxel_size_m
    if size is not None and size < grid.voxel_size_m - 1e-9:
        raise MocapError(
            f"configuration: tracking.voxel_size_m is {size}, finer than the volume's {grid.voxel_size_m}",
            remedy="leave tracking.voxel_size_m out, or carve finer voxels (volume.voxel_size_m)",
        )
    try:
        return tracker_settings(
            state.config, grid, state.fps, state.n_frames, is_room_known=state.is_room_known, rig=state.rig
        )
    except ValueError as error:
        raise MocapError(f"configuration: tracking: {error}", remedy="correct the setting") from error


def _step(state: _Tracking, seen: Seen) -> tuple[_Tracking, Seen, Sequence[Row]]:
    assert seen.hull is not None
    settings = state.settings or _settings(state, seen.hull.grid)
    shown = tracker_input(seen.frame, seen.hull, state.config.voxel_size_m)
    rng = rng_for(state.seed, "track", 0, seen.frame)
    tracker, info = track_step(state.tracker, shown.voxels, settings, rng=rng)
    serial_of = {t.person: t.serial for t in info.tracks}
    held = {serial_of[p] + 1: rows for p, rows in info.voxels_of.items()}
    owner = shown.owners(held)
    if state.history is not None:
        state.history.append((info.frame, slim(info.tracks)))
    rows = state.owners.add(seen.frame, owner, info.tracks)
    found = replace(seen, tracks=info.tracks, owner=owner)
    return replace(state, tracker=tracker, settings=settings), found, rows


def _finish(state: _Tracking) -> Ending:
    """The owners that still wait, and the table of tracks, which only the whole clip decides."""
    min_seen = 1 if state.settings is None else state.settings.confirm_frames
    history = state.history or []
    tracks = tracks_from_history(history, state.fps, min_seen=min_seen)
    rows = state.owners.rest()
    rows += [Row(tracks_product.PRODUCT, frame, track_row(tracks, frame)) for frame, _ in history]
    return Ending(rows)


class _Owners:
    """Gives owners frame by frame, as soon as it is known what every track in the frame is called.

    A new track may turn out to be somebody who returns; its frames wait until that is settled.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[int, NDArray[np.uint32]]] = []
        self._person_of: dict[int, int] = {}

    def add(self, frame: int, owner: NDArray[np.uint32], tracks: tuple[Track, ...]) -> list[Row]:
        """One frame; gives those that are settled.  owner : (N,) serial + 1 of the voxels' tracks, 0 = nobody."""
        self._waiting.append((frame, owner))
        self._person_of.update({t.serial: t.person for t in tracks})
        open_tracks = [t for t in tracks if not t.is_named]
        first_open = min((t.born for t in open_tracks), default=frame + 1)
        return self._settled(first_open)

    def rest(self) -> list[Row]:
        """Whatever waits."""
        return self._settled(None)

    def _settled(self, before: int | None) -> list[Row]:
        rows = []
        while self._waiting and (before is None or self._waiting[0][0] < before):
            frame, owner = self._waiting.pop(0)
            named = np.zeros(int(owner.max(initial=0)) + 1, dtype=np.uint16)
            for number in np.unique(owner):
                if number:
                    named[number] = self._person_of[int(number) - 1]
            rows.append(Row(owners_product.PRODUCT, frame, owner_row(named[owner])))
        return rows


def track_report(job: Job) -> StageReport:
    """How many persons there are, and advice where there is none, where the room does not hold one, and where two touch
    or one is lost in another.
    """
    tracks = stored_tracks(job.store, job.session.fps)
    n = len(tracks.persons)
    warnings = _told_by_volumes(job.store) + _lost_in_another(tracks, job.session.fps) if n else [_NOBODY]
    return StageReport(tuple(warnings), {"n_persons": n})


def _lost_in_another(tracks: Tracks, fps: float) -> list[str]:
    """Who is no longer followed from a frame on in which he is beside somebody who still is a while later."""
    warnings = []
    for person in tracks.persons:
        own = tracks.of(person)
        end, later = int(own.frame[-1]), int(own.frame[-1]) + max(1, round(_A_WHILE_S * fps))
        beside = tracks.rows((tracks.frame == end) & (tracks.person != person))
        gap_m = np.linalg.norm(beside.xyz[:, :2] - own.xyz[-1, :2], axis=1)
        for other in beside.person[gap_m < BESIDE_M].tolist():
            if (tracks.of(other).frame >= later).any():
                warnings.append(
                    f"person {person} is followed up to frame {end} only, where he is beside person {other}: unless "
                    "he left there, the two are one volume from then on, and poses of it are of neither. Remedy: a "
                    "camera overhead, or more of them, tells people apart who touch"
                )
    return warnings


def _told_by_volumes(store: StageStore) -> list[str]:
    """Which persons reach through the walls or the ceiling of the grid, beyond which nobody carves, and which touch."""
    grid, owners = stored_grid(store), store.reader(owners_product.PRODUCT)
    least = _WRIST_M2 / grid.voxel_size_m**2
    n_frames: Counter[int] = Counter()
    n_cut: dict[int, NDArray[np.int64]] = {}
    touching: dict[tuple[int, int], list[int]] = {}
    for frame, arrays in store.reader(hulls_product.PRODUCT).rows("voxels"):
        owner = owners_at(owners, frame)
        persons = {p: arrays["voxels"][owner == p] for p in np.unique(owner[owner > 0]).tolist()}
        for person, own in persons.items():
            n_frames[person] += 1
            is_cut = [np.count_nonzero(side) > least for side in grid.at_walls(own)]
            n_cut[person] = n_cut.get(person, 0) + np.array(is_cut, dtype=np.int64)
        for one, other in combinations(persons, 2):
            if sides_between(persons[one], persons[other], grid) > least:
                touching.setdefault((one, other), []).append(frame)
    warnings = []
    for person, counts in sorted(n_cut.items()):
        cut = [k for k in range(len(counts)) if counts[k] > max(_FEW_FRAMES, _FEW_SHARE * n_frames[person])]
        if cut:
            sides = np.array([grid.origin, grid.upper]).T.ravel()[[0, 1, 2, 3, 5]]
            walls = ", ".join(f"{'xxyyz'[k]} = {sides[k]:.2f} m in {counts[k]}" for k in cut)
            warnings.append(
                f"person {person}: the volume ends at the border of the room ({walls} of {n_frames[person]} frames): "
                "what is beyond it is not carved, and poses are uncertain there. Remedy: a larger room, room_bounds_m "
                "in session.toml"
            )
    for (one, other), frames in sorted(touching.items()):
        warnings.append(
            f"persons {one} and {other} are one volume in frames {frames_in_words(np.array(frames))}: an arm that "
            "reaches over to the other may count as his, and poses of arms are uncertain there. Remedy: more cameras"
        )
    return warnings


def sides_between(one: NDArray[np.int32], other: NDArray[np.int32], grid: VoxelGrid) -> int:
    """How many sides the voxels of two persons, (N,) and (M,), have in common."""
    a, b = grid.subscripts(one), grid.subscripts(other)
    lower = np.maximum(a.min(axis=0), b.min(axis=0)) - 1
    upper = np.minimum(a.max(axis=0), b.max(axis=0)) + 1
    if np.any(lower > upper):
        return 0
    mark = np.zeros(upper - lower + 1, dtype=np.int8)
    for subs, value in ((a, 1), (b, -1)):
        mark[tuple((subs[((subs >= lower) & (subs <= upper)).all(axis=1)] - lower).T)] = value
    return sum(
        int(np.count_nonzero(m[1:] * m[:-1] < 0)) for m in (np.moveaxis(mark, axis, 0) for axis in range(3))
    )


_NOBODY = (
    "no person was found in the volume. Remedy: look at the silhouettes and the hull in the report; "
    "a person needs some 15 to 500 litres of connected volume"
)

TRACK = Stage(
    name="track",
    until="track",
    products=(tracks_product.PRODUCT, owners_product.PRODUCT),
    # Persons over time, and the owner of every voxel. Source: CF 4.2-4.3.
    work=FrameWork(_reads, _start, _step, _finish, finds=("tracks", "owner")),
    report=track_report,
    needs=("carve",),
    sections=("tracking",),
    facts=("fps", "has_empty_scene"),
    is_random=lambda config: config.tracking.tracker != "naive",
)
