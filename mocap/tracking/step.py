"""One step of any of the trackers, and a whole clip."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.data import Tracks
from mocap.tracking import motion, naive, particle, sparse
from mocap.tracking.claims import Claim, Frame, claim_voxels, frame_of
from mocap.tracking.lifecycle import advance_lives
from mocap.tracking.state import TENTATIVE, Track, TrackerSettings, TrackerState, TrackInfo
from mocap.tracking.voxels import FrameVoxels

_FILTERS = {"naive": naive, "particle": particle, "sparse": sparse}


def track_step(
    state: TrackerState, observation: FrameVoxels, settings: TrackerSettings, *, rng: np.random.Generator
) -> tuple[TrackerState, TrackInfo]:
    """One frame of a tracker: predict, filter, share the voxels out, and advance the life of every track.

    observation : of a frame later than the last one; frames in between that are missing age the tracks.
    Returns the new state and the info of the frame.  Source: CF 4.2-4.3.
    """
    if state.frame is not None and observation.frame <= state.frame:
        raise ValueError(f"frame {observation.frame} does not follow frame {state.frame}")
    n_frames = 1 if state.frame is None else observation.frame - state.frame
    frame = frame_of(observation, settings)
    predicted = tuple(motion.predict(t, n_frames, settings) for t in state.tracks)
    tracks = _filtered(predicted, frame, rng)
    xyz = np.array([t.xyz for t in tracks]).reshape(-1, 3)
    claims, newborn = claim_voxels(frame, tracks, xyz)

    method = _FILTERS[settings.tracker]

    def start(track: Track, frame: Frame, claim: Claim) -> Track:
        return method.start(track, frame, claim, rng=rng)

    state, lives = advance_lives(state, predicted, tracks, claims, newborn, n_frames, frame, start)
    owned = {t.person: lives.claims[t.serial] for t in state.tracks}
    info = TrackInfo(
        frame=observation.frame,
        tracks=state.tracks,
        voxels_of={p: c.voxels for p, c in owned.items()},
        features_of={p: c.features for p, c in owned.items()},
        created=tuple(lives.created),
        deleted=lives.deleted,
        exchanged=tuple(lives.exchanged),
        recognised=tuple(lives.recognised),
        n_components=len(frame.parts),
        n_unassigned=len(observation) - sum(len(c.voxels) for c in owned.values()),
    )
    return state, info


def _filtered(predicted: tuple[Track, ...], frame: Frame, rng: np.random.Generator) -> tuple[Track, ...]:
    """The predicted tracks after the filter, before anybody owns a voxel."""
    method = _FILTERS[frame.settings.tracker]
    places = np.array([t.xyz[:2] for t in predicted]).reshape(-1, 2)
    # Somebody who may be a ghost blocks nobody.
    is_firm = np.array([t.status != TENTATIVE for t in predicted], dtype=bool)
    out = []
    for i, track in enumerate(predicted):
        others = places[is_firm & (np.arange(len(predicted)) != i)]
        out.append(method.estimate(track, others, frame, rng=rng))
    return tuple(out)


def track_clip(
    frames: Iterable[FrameVoxels], settings: TrackerSettings, fps: float, *, rng: np.random.Generator
) -> Tracks:
    """Track a whole clip, offline.

    frames : in ascending order; consumed one by one.  fps : frames per second, in place of settings.fps.
    Returns the tracks of `tracks_from_history`. A clip without persons gives an empty table.
    """
    if not fps > 0:
        raise ValueError(f"fps must be positive, got {fps}")
    settings = replace(settings, fps=fps)
    history = []
    state = TrackerState()
    for observation in frames:
        state, info = track_step(state, observation, settings, rng=rng)
        history.append((info.frame, slim(info.tracks)))
    return tracks_from_history(history, fps, min_seen=settings.confirm_frames)


def slim(tracks: tuple[Track, ...]) -> tuple[Track, ...]:
    """Tracks without samples and colour models, for a history of a long clip."""
    none = np.zeros((0, 3))
    return tuple(t.replace(samples=none, weights=none[:, 0], histogram=None, appearance=None) for t in tracks)


def tracks_from_history(
    history: Iterable[tuple[int, tuple[Track, ...]]],
    fps: float,
    *,
    backdate: bool = True,
    min_seen: int = 1,
) -> Tracks:
    """Positions of all confirmed tracks of a clip, from `(info.frame, info.tracks)` of each step.

    Offline use, with what is known afterwards: tentative positions before the confirmation belong to the
    track (`backdate`), frames in which it coasted and was found again are interpolated linearly and have the status
    `coasting`, and the coasting frames before its deletion or the end of the clip are left out. Tracks that were never
    confirmed, or seen in fewer than `min_seen` frames of a clip that is at least that long, are left out.
    """
    if not fps > 0:
        raise ValueError(f"fps must be positive, got {fps}")
    lives: dict[int, list[tuple[int, Track]]] = {}
    n_frames = 0
    for frame, tracks in history:
        n_frames += 1
        for track in tracks:
            lives.setdefault(track.serial, []).append((frame, track))

    table: dict[tuple[int, int], tuple[Array, Array, bool]] = {}
    for life in lives.values():
        seen = _sightings(life, backdate=backdate)
        if not seen or len(seen) < min(min_seen, n_frames):
            continue
        person = life[-1][1].person
        frames = np.array([frame for frame, _ in life if seen[0][0] <= frame <= seen[-1][0]])
        for frame, xyz, covariance, is_seen in _filled(seen, frames, fps):
            # Of a person who returned before the old track had ended, the old track's sightings stand.
            table.setdefault((frame, person), (xyz, covariance, is_seen))
    return _tracks_of(table, fps)


def _sightings(life: list[tuple[int, Track]], *, backdate: bool) -> list[tuple[int, Track]]:
    """The frames in which a track was seen as a person; none if it was never confirmed.

    backdate : those before the confirmation belong to it.
    """
    confirmed = [i for i, (_, t) in enumerate(life) if t.status != TENTATIVE]
    if not confirmed:
        return []
    return [(frame, t) for frame, t in (life if backdate else life[confirmed[0] :]) if t.is_seen]


def _tracks_of(table: dict[tuple[int, int], tuple[Array, Array, bool]], fps: float) -> Tracks:
    """(frame, person) -> (xyz, covariance, is_seen) as tracks, in the order of frames and persons."""
    keys = sorted(table)
    rows = [table[key] for key in keys]
    index = np.array(keys, dtype=np.int64).reshape(-1, 2)
    return Tracks(
        frame=index[:, 0].copy(),
        person=index[:, 1].copy(),
        time_s=index[:, 0] / fps,
        xyz=np.array([xyz for xyz, _, _ in rows], dtype=np.float64).reshape(-1, 3),
        covariance=np.array([c for _, c, _ in rows], dtype=np.float64).reshape(-1, 3, 3),
        observed=np.array([s for _, _, s in rows], dtype=np.bool_),
    )


def _filled(
    seen: list[tuple[int, Track]], frames: NDArray[np.int64], fps: float
) -> list[tuple[int, Array, Array, bool]]:
    """(frame, xyz, covariance, is_seen) of one life, gaps between sightings interpolated."""
    at = np.array([frame for frame, _ in seen])
    xyz = np.array([t.xyz for _, t in seen])
    covariance = np.array([t.covariance for _, t in seen])
    after = np.searchsorted(at, frames)
    before = np.where(at[after] == frames, after, after - 1)
    n_before, n_after = frames - at[before], at[after] - frames
    share = (n_before / np.maximum(n_before + n_after, 1))[:, None]
    places = (1 - share) * xyz[before] + share * xyz[after]
    share = share[:, :, None]
    spread = (1 - share) * covariance[before] + share * covariance[after]
    extra = motion.bridge_variance(n_before, n_after, fps)
    spread = spread + extra[:, None, None] * np.eye(3)
    return [(int(f), p, c, bool(n == 0)) for f, p, c, n in zip(frames, places, spread, n_before, strict=True)]
