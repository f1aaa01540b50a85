"""The naive tracker: ellipsoids of influence over connected components, with a track lifecycle.

A step is a pure function `(state, hull of the frame, settings) -> (state, info)`.

    new --tentative--> confirmed <--> coasting --> deleted

A new track is tentative until it was seen as a person in `confirm_frames` frames; in the first frame of a
clip it is confirmed at once, because there is no earlier frame that could speak against it.  A confirmed
track that is not seen coasts in place and is deleted after `lost_frames` frames.  Source: CF 4.2.3, 4.3.1.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mocap.data import Tracks
from mocap.tracking.features import (
    PERSON_TREE,
    BlobFeatures,
    Components,
    Split,
    blob_features,
    components_of,
    is_person,
    weight_kg,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

TENTATIVE, CONFIRMED, COASTING = "tentative", "confirmed", "coasting"
_USUAL_WEIGHT_RATE = 0.1
_RANK = {CONFIRMED: 2, COASTING: 1, TENTATIVE: 0}


@dataclass(frozen=True)
class TrackerSettings:
    """What the tracker decides by; frame counts are numbers of calls of `track_step`.

    voxel_size_m : side of the voxels that are fed in.
    semi_axis_xy_m, alpha, beta : the ellipsoid's semi-axes are alpha * semi_axis_xy_m twice, and beta * height
        of the centroid. Source: CF 4.3.1 (30 cm, 1.5, 1.2).
    min_distance_m : no track is created nearer than this to another one (horizontally).
    merge_distance_m, merge_frames : of two tracks nearer than this for more than so many frames in a row
        one is deleted.
    confirm_frames : frames seen as a person until a tentative track is confirmed. Ghosts between two persons
        live about a quarter of a second, and offline the track is backdated: patience costs nothing. For a clip
        hardly longer than this, pass less.
    tentative_misses : a tentative track is deleted when it is missed in more frames in a row than this.
    lost_frames : a confirmed track coasts so many frames, then it is deleted: no phantom lives longer.
    reacquire_distance_m : a track without voxels takes over a free person blob within this distance.
    fragment_reach : loose parts whose centroid lies within so many ellipsoid radii belong to the track.
    min_fragment_kg : lighter loose parts are specks and belong to nobody.
    min_shared_weight : tracks share a component only while it has this share of their usual weights together;
        otherwise one of the persons is not in it.
    min_support_kg : with less weight than this a track's voxels do not move it, and a component is no person.
    person_tree : see `is_person`.
    """

    voxel_size_m: float
    semi_axis_xy_m: float = 0.3
    alpha: float = 1.5
    beta: float = 1.2
    min_distance_m: float = 0.5
    merge_distance_m: float = 0.25
    merge_frames: int = 5
    confirm_frames: int = 8
    tentative_misses: int = 2
    lost_frames: int = 15
    reacquire_distance_m: float = 1.0
    fragment_reach: float = 2.0
    min_fragment_kg: float = 0.1
    min_shared_weight: float = 0.6
    min_support_kg: float = 5.0
    person_tree: Split | bool = PERSON_TREE

    def __post_init__(self) -> None:
        for name in ("voxel_size_m", "semi_axis_xy_m", "alpha", "beta"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("merge_frames", "tentative_misses", "lost_frames"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        if self.confirm_frames < 1:
            raise ValueError(f"confirm_frames must be at least 1, got {self.confirm_frames}")


@dataclass(frozen=True, eq=False)
class Track:
    """One person as the tracker believes it.

    person : id >= 1, kept for life; ids of tracks that were never confirmed are used again.
    xyz : (3,) m, world, centroid of the person's voxels.  status : tentative, confirmed or coasting.
    born : frame of creation.  age : frames since then.  hits : frames seen as a person.
    misses : frames in a row not seen as a person.  close : frames in a row too near to a better track.
    weight_kg : usual weight of its voxels, a running mean over the frames in which it shared with nobody.
    """

    person: int
    xyz: Array
    status: str
    born: int
    age: int = 0
    hits: int = 1
    misses: int = 0
    close: int = 0
    weight_kg: float = 0.0

    @property
    def is_seen(self) -> bool:
        """Seen as a person in this very frame."""
        return self.misses == 0


@dataclass(frozen=True, eq=False)
class TrackerState:
    """What the next step needs.

    tracks : live tracks.  frame : last frame, None before the first.  confirmed_ids : ids given away for
    good.
    """

    tracks: tuple[Track, ...] = ()
    frame: int | None = None
    confirmed_ids: frozenset[int] = frozenset()


@dataclass(frozen=True, eq=False)
class TrackInfo:
    """What people, plots and the pose stage need of one step.

    tracks : live tracks after the step.  voxels_of : person -> ascending indices into `centers`; one entry
    per live track, empty where it coasts; the sets are disjoint.  features_of : of those voxels.
    created : ids.  deleted : id -> reason ("merged", "lost").  n_components : components in the input.
    n_unassigned : voxels that belong to nobody.
    """

    frame: int
    tracks: tuple[Track, ...]
    voxels_of: dict[int, Indices]
    features_of: dict[int, BlobFeatures]
    created: tuple[int, ...] = ()
    deleted: dict[int, str] = field(default_factory=dict)
    n_components: int = 0
    n_unassigned: int = 0


@dataclass(frozen=True, eq=False)
class _Claim:
    """Voxels that one track holds in this frame, and whether they are a person."""

    voxels: Indices
    is_person: bool
    is_shared: bool = False


def track_step(
    state: TrackerState, centers: Array, labels: NDArray[np.integer], frame: int, settings: TrackerSettings
) -> tuple[TrackerState, TrackInfo]:
    """One frame of the naive tracker.

    centers : (N, 3) m, world, voxel centres.  labels : (N,) int, connected component of each voxel, negative
    = ignore.  frame : larger than the one before.  N = 0 is a frame in which nobody is seen.
    Returns the new state and the info of the frame.

    Source: CF 4.2.3, Eq. 4.2-4.5, 4.7. Departs from CF Eq. 4.4: the ellipsoid decides which component belongs
    to which track, but a component that holds one track belongs to it whole, so that outstretched arms are
    kept; the ellipsoid cuts only where the whole is no person (fused with furniture). A component that holds
    several tracks is divided by the nearest ellipsoid instead of dropping the overlap of Eq. 4.7, which would
    tear a hole into both bodies.
    """
    # Column by column in memory: everything below reduces or compares single coordinates.
    centers = np.asarray(centers, dtype=np.float64, order="F")
    labels = np.asarray(labels)
    if centers.ndim != 2 or centers.shape[1] != 3:
        raise ValueError(f"centers has shape {centers.shape}, expected (N, 3)")
    if labels.shape != (len(centers),):
        raise ValueError(f"labels has shape {labels.shape}, expected ({len(centers)},)")
    if state.frame is not None and frame <= state.frame:
        raise ValueError(f"frame {frame} does not follow frame {state.frame}")

    parts = components_of(centers, labels, settings.voxel_size_m)
    verdicts = np.zeros(len(parts), dtype=bool)
    for k in np.flatnonzero(parts.weight_kg >= settings.min_support_kg):
        verdicts[k] = is_person(parts.features(int(k)), settings.person_tree)
    xyz = np.array([t.xyz for t in state.tracks]).reshape(-1, 3)
    distance = _ellipsoid_distance(centers, xyz, settings)

    claims, is_taken = _claim_components(parts, verdicts, distance, state.tracks, centers, settings)
    _reacquire(claims, is_taken, parts, verdicts, xyz, settings, centers)
    newborn = _create(claims, is_taken, parts, verdicts, centers, settings)

    # Positions by slot: existing tracks first, then newborn ones.
    claims.update({len(xyz) + i: _Claim(parts.voxels(k), True) for i, k in enumerate(newborn)})
    _add_fragments(claims, is_taken, parts, centers, settings)

    tracks, voxels_of, created, deleted = _live_on(state, claims, len(newborn), centers, frame, settings)
    tracks, voxels_of = _merge(tracks, voxels_of, deleted, settings)
    confirmed = {t.person for t in tracks if t.status != TENTATIVE}
    new_state = TrackerState(tracks, int(frame), state.confirmed_ids | confirmed)
    info = TrackInfo(
        frame=int(frame),
        tracks=tracks,
        voxels_of=voxels_of,
        features_of={p: _features_of(centers, v, settings) for p, v in voxels_of.items()},
        created=created,
        deleted=deleted,
        n_components=len(parts),
        n_unassigned=len(centers) - sum(len(v) for v in voxels_of.values()),
    )
    return new_state, info


def track_clip(
    frames: Iterable[tuple[int, Array, NDArray[np.integer]]], settings: TrackerSettings, fps: float
) -> Tracks:
    """Track a whole clip, offline.

    frames : (frame, centers (N, 3) m, labels (N,)) in ascending frame order; consumed one by one.
    Returns the tracks of `tracks_from_history`. A clip without persons gives an empty table.
    """
    history = []
    state = TrackerState()
    for frame, centers, labels in frames:
        state, info = track_step(state, centers, labels, frame, settings)
        history.append((info.frame, info.tracks))
    return tracks_from_history(history, fps, min_seen=settings.confirm_frames)


def tracks_from_history(
    history: Iterable[tuple[int, tuple[Track, ...]]],
    fps: float,
    *,
    backdate: bool = True,
    min_seen: int = 1,
) -> Tracks:
    """Positions of all confirmed tracks of a clip, from `(info.frame, info.tracks)` of each step.

    Offline use, with what is known afterwards: tentative positions before the confirmation belong to the
    track (`backdate`), frames in which it coasted and was found again are interpolated linearly, and the
    coasting frames before its deletion or the end of the clip are left out. Tracks that were never confirmed,
    or seen in fewer than `min_seen` frames of a clip that is at least that long, are left out.
    """
    if not fps > 0:
        raise ValueError(f"fps must be positive, got {fps}")
    rows: dict[tuple[int, int], list[tuple[int, Track]]] = {}
    n_frames = 0
    for frame, tracks in history:
        n_frames += 1
        for track in tracks:
            rows.setdefault((track.person, track.born), []).append((frame, track))

    table: list[tuple[int, int, Array]] = []
    for (person, _), life in rows.items():
        confirmed = [i for i, (_, t) in enumerate(life) if t.status != TENTATIVE]
        if not confirmed:
            continue
        if not backdate:
            life = life[confirmed[0] :]
        seen = [(frame, t.xyz) for frame, t in life if t.is_seen]
        if not seen or len(seen) < min(min_seen, n_frames):
            continue
        seen_frames = np.array([frame for frame, _ in seen])
        seen_xyz = np.array([xyz for _, xyz in seen])
        frames = [frame for frame, _ in life if seen_frames[0] <= frame <= seen_frames[-1]]
        xyz = np.column_stack([np.interp(frames, seen_frames, seen_xyz[:, i]) for i in range(3)])
        table += [(frame, person, xyz[i]) for i, frame in enumerate(frames)]
    table.sort(key=lambda row: row[:2])
    frame_column = np.array([row[0] for row in table], dtype=np.int64)
    return Tracks(
        frame=frame_column,
        person=np.array([row[1] for row in table], dtype=np.int64),
        time_s=frame_column / fps,
        xyz=np.array([row[2] for row in table], dtype=np.float64).reshape(-1, 3),
    )


def _centroid(centers: Array, voxels: Indices) -> Array:
    """Mean of some rows of centers (N, 3) in column order, (3,)."""
    return np.array([column[voxels].mean() for column in centers.T])


def _features_of(centers: Array, voxels: Indices, settings: TrackerSettings) -> BlobFeatures:
    return blob_features(np.array([column[voxels] for column in centers.T]).T, settings.voxel_size_m)


def _ellipsoid_distance(points: Array, xyz: Array, settings: TrackerSettings) -> Array:
    """Distance of points (N, 3) from tracks (T, 3) in ellipsoid radii, (T, N); <= 1 is inside. CF Eq. 4.2."""
    xy = settings.alpha * settings.semi_axis_xy_m
    columns = points.T
    out = np.empty((len(xyz), len(points)))
    for t, (x, y, z) in enumerate(xyz):
        # The ellipsoid stands on the floor; below 30 cm of centroid height it would hold nobody.
        axes = (xy, xy, settings.beta * max(z, 0.3))
        out[t] = sum(((c - m) / a) ** 2 for c, m, a in zip(columns, (x, y, z), axes, strict=True))
    return np.sqrt(out)


def _claim_components(
    parts: Components,
    verdicts: NDArray[np.bool_],
    distance: Array,
    tracks: tuple[Track, ...],
    centers: Array,
    settings: TrackerSettings,
) -> tuple[dict[int, _Claim], NDArray[np.bool_]]:
    """Give every track the component that fills its ellipsoid most; divide components that hold several."""
    n_tracks, n_parts = distance.shape[0], len(parts)
    members: dict[int, list[int]] = {}
    inside = (distance <= 1.0) & (parts.component_of >= 0)
    is_exclusive = inside.sum(axis=0) == 1  # CF Eq. 4.7: what two tracks see decides for neither
    for t in range(n_tracks):
        for votes in (inside[t] & is_exclusive, inside[t]):
            count = np.bincount(parts.component_of[votes], minlength=n_parts)
            if count.any() and weight_kg(int(count.max()), settings.voxel_size_m) >= settings.min_support_kg:
                members.setdefault(int(np.argmax(count)), []).append(t)
                break
    is_taken = np.zeros(n_parts, dtype=bool)
    claims: dict[int, _Claim] = {}
    for k, inside_k in members.items():
        is_taken[k] = True
        voxels = parts.voxels(k)
        if len(inside_k) == 1 and verdicts[k]:
            claims[inside_k[0]] = _Claim(voxels, True)
        else:
            claims.update(_divide(voxels, inside_k, distance, tracks, centers, settings))
    return claims, is_taken


def _divide(
    voxels: Indices,
    slots: list[int],
    distance: Array,
    tracks: tuple[Track, ...],
    centers: Array,
    settings: TrackerSettings,
) -> dict[int, _Claim]:
    """Divide one component among the tracks in it (by slot), by the nearest ellipsoid.

    A track gets nothing and leaves its share to the others when the share is no person, or when the component
    is too light for all of them: it is a track that has lost its person and stands beside another one, whose
    arms it must not take.
    """
    # A tentative track has not shown yet that it is a body of its own: beside a confirmed one it is a ghost.
    slots = [t for t in slots if tracks[t].status != TENTATIVE] or list(slots)
    total_kg = weight_kg(len(voxels), settings.voxel_size_m)
    while True:
        nearest = np.argmin(distance[slots][:, voxels], axis=0)
        claims = {}
        for i, t in enumerate(slots):
            claim = _best_claim(voxels[nearest == i], distance[t], centers, settings)
            claims[t] = replace(claim, is_shared=len(slots) > 1)
        failed = [t for t in slots if not claims[t].is_person]
        usual_kg = {t: max(tracks[t].weight_kg, 1e-9) for t in slots}
        if not failed and total_kg < settings.min_shared_weight * sum(usual_kg.values()):
            failed = slots
        if not failed or len(slots) == 1:
            return claims
        # Coasting tracks go first, otherwise two tracks on one person would take turns for ever.
        slots.remove(
            min(failed, key=lambda t: (_RANK[tracks[t].status], len(claims[t].voxels) / usual_kg[t]))
        )


def _best_claim(voxels: Indices, distance: Array, centers: Array, settings: TrackerSettings) -> _Claim:
    """The whole share if it is a person, otherwise the part inside the ellipsoid (CF Eq. 4.4)."""
    for candidate in (voxels, voxels[distance[voxels] <= 1.0]):
        features = _features_of(centers, candidate, settings)
        if is_person(features, settings.person_tree):
            return _Claim(candidate, True)
    return _Claim(candidate, False)


def _free_persons(
    claims: dict[int, _Claim],
    is_taken: NDArray[np.bool_],
    parts: Components,
    verdicts: NDArray[np.bool_],
    centers: Array,
    settings: TrackerSettings,
) -> list[int]:
    """Person components that belong to nobody and stand away from every track; heaviest first."""
    owners = np.array([_centroid(centers, c.voxels) for c in claims.values() if len(c.voxels)])
    free = [int(k) for k in np.flatnonzero(verdicts & ~is_taken)]
    if len(owners):
        gap = np.linalg.norm(parts.centroid[free, None, :2] - owners[None, :, :2], axis=2)
        free = [k for k, d in zip(free, gap, strict=True) if d.min() >= settings.min_distance_m]
    return sorted(free, key=lambda k: (-parts.weight_kg[k], k))


def _reacquire(
    claims: dict[int, _Claim],
    is_taken: NDArray[np.bool_],
    parts: Components,
    verdicts: NDArray[np.bool_],
    xyz: Array,
    settings: TrackerSettings,
    centers: Array,
) -> None:
    """Tracks without a person take over free person components within reach, nearest pair first."""
    missing = [t for t in range(len(xyz)) if t not in claims or not claims[t].is_person]
    healthy = {t: c for t, c in claims.items() if c.is_person}
    free = _free_persons(healthy, is_taken, parts, verdicts, centers, settings)
    pairs = sorted(
        (float(np.linalg.norm(parts.centroid[k, :2] - xyz[t, :2])), t, k) for t in missing for k in free
    )
    found: set[int] = set()
    for gap, t, k in pairs:
        if gap <= settings.reacquire_distance_m and t not in found and not is_taken[k]:
            claims[t] = _Claim(parts.voxels(k), True)
            is_taken[k] = True
            found.add(t)


def _create(
    claims: dict[int, _Claim],
    is_taken: NDArray[np.bool_],
    parts: Components,
    verdicts: NDArray[np.bool_],
    centers: Array,
    settings: TrackerSettings,
) -> list[int]:
    """Components that become new tracks. Source: CF 4.2.3, track creation criteria."""
    newborn: list[int] = []
    for k in _free_persons(claims, is_taken, parts, verdicts, centers, settings):
        gaps = [np.linalg.norm(parts.centroid[k, :2] - parts.centroid[n, :2]) for n in newborn]
        if all(gap >= settings.min_distance_m for gap in gaps):
            newborn.append(k)
            is_taken[k] = True
    return newborn


def _add_fragments(
    claims: dict[int, _Claim],
    is_taken: NDArray[np.bool_],
    parts: Components,
    centers: Array,
    settings: TrackerSettings,
) -> None:
    """Loose parts (a hand that the carving cut off) go to the nearest track within reach."""
    owners = [t for t, c in claims.items() if len(c.voxels)]
    loose = np.flatnonzero(~is_taken & (parts.weight_kg >= settings.min_fragment_kg))
    if not owners or not len(loose):
        return
    xyz = np.array([_centroid(centers, claims[t].voxels) for t in owners])
    weight = np.array([weight_kg(len(claims[t].voxels), settings.voxel_size_m) for t in owners])
    reach = _ellipsoid_distance(parts.centroid[loose], xyz, settings)
    nearest = np.argmin(reach, axis=0)
    belongs = (reach.min(axis=0) <= settings.fragment_reach) & (parts.weight_kg[loose] < weight[nearest])
    for i, t in enumerate(owners):
        mine = loose[belongs & (nearest == i)]
        if len(mine):
            voxels = np.concatenate([claims[t].voxels, *(parts.voxels(k) for k in mine)])
            features = _features_of(centers, voxels, settings)
            person = claims[t].is_person or is_person(features, settings.person_tree)
            claims[t] = replace(claims[t], voxels=voxels, is_person=person)
            is_taken[mine] = True


def _live_on(
    state: TrackerState,
    claims: dict[int, _Claim],
    n_newborn: int,
    centers: Array,
    frame: int,
    settings: TrackerSettings,
) -> tuple[tuple[Track, ...], dict[int, Indices], tuple[int, ...], dict[int, str]]:
    """Advance the lifecycle of every track, and start those of the newborn slots."""
    tracks: list[Track] = []
    voxels_of: dict[int, Indices] = {}
    deleted: dict[int, str] = {}
    nothing = _Claim(np.zeros(0, dtype=np.int64), False)
    for slot, track in enumerate(state.tracks):
        claim = claims.get(slot, nothing)
        is_supported = weight_kg(len(claim.voxels), settings.voxel_size_m) >= settings.min_support_kg
        xyz = _centroid(centers, claim.voxels) if is_supported else track.xyz
        if claim.is_person:
            hits, misses = track.hits + 1, 0
            is_confirmed = track.status != TENTATIVE or hits >= settings.confirm_frames
            status = CONFIRMED if is_confirmed else TENTATIVE
        else:
            hits, misses = track.hits, track.misses + 1
            status = TENTATIVE if track.status == TENTATIVE else COASTING
            patience = settings.tentative_misses if status == TENTATIVE else settings.lost_frames
            if misses > patience:
                deleted[track.person] = "lost"
                continue
        usual_kg = track.weight_kg
        if claim.is_person and not claim.is_shared:
            now_kg = weight_kg(len(claim.voxels), settings.voxel_size_m)
            usual_kg += _USUAL_WEIGHT_RATE * (now_kg - usual_kg)
        tracks.append(
            replace(
                track,
                xyz=xyz,
                status=status,
                age=track.age + 1,
                hits=hits,
                misses=misses,
                weight_kg=usual_kg,
            )
        )
        voxels_of[track.person] = np.sort(claim.voxels)

    created = []
    used = {t.person for t in tracks} | set(state.confirmed_ids) | set(deleted)
    is_first = state.frame is None
    status = CONFIRMED if is_first or settings.confirm_frames == 1 else TENTATIVE
    for slot in range(len(state.tracks), len(state.tracks) + n_newborn):
        person = 1
        while person in used:
            person += 1
        used.add(person)
        created.append(person)
        voxels = np.sort(claims[slot].voxels)
        usual_kg = weight_kg(len(voxels), settings.voxel_size_m)
        xyz = _centroid(centers, voxels)
        tracks.append(Track(person, xyz, status, int(frame), weight_kg=usual_kg))
        voxels_of[person] = voxels
    return tuple(tracks), voxels_of, tuple(created), deleted


def _merge(
    tracks: tuple[Track, ...],
    voxels_of: dict[int, Indices],
    deleted: dict[int, str],
    settings: TrackerSettings,
) -> tuple[tuple[Track, ...], dict[int, Indices]]:
    """Of tracks too near to one another for too long keep the best; its rivals' voxels become its own.

    Source: CF 4.2.3, track deletion criteria. Departs from it: a few frames of patience, because persons who
    pass each other are near for a moment as well.
    """
    ranked = sorted(tracks, key=lambda t: (-_RANK[t.status], -t.hits, t.person))
    kept: list[Track] = []
    voxels_of = dict(voxels_of)
    for track in ranked:
        rivals = [k for k in kept if np.linalg.norm(k.xyz[:2] - track.xyz[:2]) < settings.merge_distance_m]
        close = track.close + 1 if rivals else 0
        if close > settings.merge_frames:
            deleted[track.person] = "merged"
            best = rivals[0].person
            voxels_of[best] = np.sort(np.r_[voxels_of[best], voxels_of.pop(track.person)])
        else:
            kept.append(replace(track, close=close))
    return tuple(sorted(kept, key=lambda t: t.person)), voxels_of
