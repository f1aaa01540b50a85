"""Claims of tracks to voxels: components, ellipsoids of influence, and blobs of several persons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mocap.arrays import Array, Indices
from mocap.data.covered import LEAST_CAMERAS, Covered
from mocap.tracking import _kernels
from mocap.tracking.colour import N_BINS, banded_histogram, bhattacharyya, colour_bins
from mocap.tracking.features import (
    BlobFeatures,
    Components,
    components_of,
    features_of,
    is_person,
    may_be_low,
    may_lie,
    measure_voxels,
    weight_kg,
)
from mocap.tracking.heads import ABOVE_M, has_shoulders, heads_of, nearest_head
from mocap.tracking.state import COASTING, RANK, TENTATIVE, Track, TrackerSettings
from mocap.tracking.voxels import FrameVoxels

Histogram = NDArray[np.floating]

MIN_HEIGHT_M = 0.3  # an ellipsoid stands on the floor; below 30 cm of centroid height it would hold nobody
MIN_COLOURED = 30  # voxels, for a histogram that means something
_RIVAL_SHARE = 0.3  # of the best component's votes, from which on another one may be the person as well
_SHRUNK_M = 0.35  # a component so much lower than the person was is what he has left behind ...
_ASIDE_M = 0.3  # ... when he himself stands beside it; above it is the rest of a body in two pieces
_UNLIKE = 0.4  # Bhattacharyya coefficient under which a blob is somebody else
_COLOUR_FLOOR = 0.002  # likelihood of a colour that a person has never shown
_LEAST_OF_TWO_KG = 40.0  # two children; what is lighter is not looked at
_TWO_HEADS_S = 0.3  # two heads for so long are two persons (decision 112)
BESIDE_M = 0.8  # people so near to each other touch
_ON_FLOOR_M = 0.2  # a whole body begins below
_WHOLE_GAP_M = 0.25  # and may be so near to another, axis to axis
_BOB_M = 0.04  # by which who walks is higher at times than usually
_FAR = 1e6  # ellipsoids away
_LOW_TOP_M = 0.8  # who was lower when last seen alone lies or squats; a child of a metre is not
# Of an equal share: under a hand that is held up is less (decision 112).
_LIKE_SHARE = 0.5
_ALIKE_SHARE = 0.75  # at first sight: a rucksack has had .71 for a moment
# Of what a person covers in a picture, the median over cameras (decision 131).
_OWN_SHARE = 0.15
_PULL_M = 0.4  # how far colours may move the place of a person in a blob of several
_WALK_M_S = 2.0  # who walks goes no further between two pictures, however far apart they are
# A person who sinks to the floor, from one frame to the next:
_LOW_SHARE = 0.6  # of the weight that has to remain
_DROP_M, _DROP_M_S = 0.4, 6.0  # nobody falls deeper at once, or faster; cut-off heads are no falls
_LOW_STEP_M, _LOW_STEP_M_S = 0.3, 4.0  # nor further to the side


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame as the trackers work on it: voxels, components, the classifier's verdicts, colour bins."""

    voxels: FrameVoxels
    parts: Components
    verdicts: NDArray[np.bool_]
    bins: NDArray[np.int32] | None
    settings: TrackerSettings

    @cached_property
    def anchor(self) -> Array:
        """Lower corner (3,) m of the first voxel: a point of the lattice; N > 0."""
        return np.asarray(self.voxels.centers[0] - self.settings.voxel_size_m / 2)

    @cached_property
    def side_kg(self) -> float:
        """Weight of one voxel."""
        return weight_kg(1, self.settings.voxel_size_m)

    def appearance(self, voxels: Indices, top_m: float | None = None) -> Histogram | None:
        """Histogram by height band of some voxels; None with too few coloured ones.  top_m : highest of them."""
        if self.bins is None:
            return None
        histogram, n = banded_histogram(self.bins, self.voxels.centers, voxels, top_m)
        return histogram if n >= MIN_COLOURED else None


def frame_of(voxels: FrameVoxels, settings: TrackerSettings) -> Frame:
    """Components, verdicts and colours of one frame."""
    parts = components_of(voxels.centers, voxels.labels, settings.voxel_size_m)
    verdicts = np.zeros(len(parts), dtype=bool)
    for k in np.flatnonzero(parts.weight_kg >= settings.min_support_kg):
        verdicts[k] = is_person(parts.features(int(k)), settings.person_tree)
    bins = None
    if settings.colour and voxels.has_colour.any():
        bins = colour_bins(voxels.rgb, voxels.has_colour)
    return Frame(voxels, parts, verdicts, bins, settings)


@dataclass(frozen=True, eq=False)
class Claim:
    """Voxels (ascending) that one track holds in this frame, and whether they are a person.

    centroid : (3,) m.  box : (2, 3) m, lower and upper corner about their centres.
    is_shared : they are a share of a blob of several persons.  is_new : the track has just got them, from afar.
    is_low : they are a person because the track says so, and not the classifier.
    is_several : they look like several persons.  is_parted : they are one of several who were one track until now.
    """

    voxels: Indices
    features: BlobFeatures
    centroid: Array
    box: Array
    is_person: bool
    is_shared: bool = False
    is_new: bool = False
    is_low: bool = False
    is_several: bool = False
    is_parted: bool = False

    @property
    def weight_kg(self) -> float:
        return self.features.weight_kg


def claim_of(frame: Frame, voxels: Indices, *, verdict: bool | None = None) -> Claim:
    """A claim on some voxels; verdict : None = ask the classifier."""
    features, centroid, box = measure_voxels(frame.voxels.centers, voxels, frame.settings.voxel_size_m)
    if verdict is None:
        verdict = is_person(features, frame.settings.person_tree)
    return Claim(voxels, features, centroid, box, verdict)


def part_claim(frame: Frame, k: int, *, is_new: bool = False) -> Claim:
    """A claim on a whole component."""
    parts = frame.parts
    box = np.stack([parts.lower[k], parts.upper[k]])
    verdict = bool(frame.verdicts[k])
    return Claim(parts.voxels(k), parts.features(k), parts.centroid[k], box, verdict, is_new=is_new)


def ellipsoid_axes(xyz: Array, settings: TrackerSettings) -> Array:
    """Semi-axes (T, 3) m of the ellipsoids of influence about xyz (T, 3). CF 4.3.1."""
    axes = np.empty((len(xyz), 3))
    axes[:, :2] = settings.alpha * settings.semi_axis_xy_m
    axes[:, 2] = settings.beta * np.maximum(xyz[:, 2], MIN_HEIGHT_M)
    return axes


def ellipsoid_distance(points: Array, xyz: Array, settings: TrackerSettings) -> Array:
    """Squared distance of points (N, 3) from tracks (T, 3) in ellipsoid radii, (T, N); <= 1 is inside. CF Eq. 4.2."""
    out = np.empty((len(xyz), len(points)))
    _kernels.ellipsoid_distances(points, xyz, ellipsoid_axes(xyz, settings), out)
    return out


def claim_voxels(frame: Frame, tracks: tuple[Track, ...], xyz: Array) -> tuple[dict[int, Claim], list[int]]:
    """Who holds which voxels.

    tracks : live tracks.  xyz : (T, 3) m, where the tracker believes them to be now.
    Returns slot -> claim, and the newborn slots, which are those from T on.
    Source: CF 4.2.3, Eq. 4.2-4.4, 4.7. Departs from CF Eq. 4.4: the ellipsoid decides which component belongs to which
    track, but a component that holds one track belongs to it whole, so that outstretched arms are kept; the ellipsoid
    cuts only where the whole is no person (fused with furniture). A component that holds several tracks is divided by
    the nearest ellipsoid instead of dropping the overlap of Eq. 4.7, which would tear a hole into both bodies.
    With whole_components = false both are as printed.
    """
    if frame.settings.whole_components:
        claims, is_taken = _claim_components(frame, tracks, xyz)
        _reacquire(frame, tracks, xyz, claims, is_taken)
    else:
        claims, is_taken = _claim_ellipsoids(frame, xyz)
    newborn = _create(frame, claims, is_taken, xyz)
    if frame.settings.whole_components:
        newborn += _create_several(frame, [*claims.values(), *newborn], is_taken)
        newborn += _come_apart(frame, tracks, claims)
    slots = list(range(len(tracks), len(tracks) + len(newborn)))
    claims.update(zip(slots, newborn, strict=True))
    if frame.settings.whole_components:
        _add_fragments(frame, claims, is_taken, [i for i, t in enumerate(tracks) if t.status != TENTATIVE])
    return claims, slots


def _votes(frame: Frame, xyz: Array) -> tuple[Indices, Indices]:
    shape = (len(xyz), len(frame.parts))
    exclusive, every = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
    if len(xyz):
        axes = ellipsoid_axes(xyz, frame.settings)
        p = frame.parts
        _kernels.count_votes(
            frame.voxels.centers, p.order, p.start, p.lower, p.upper, xyz, axes, exclusive, every
        )
    return exclusive, every


def _claim_ellipsoids(frame: Frame, xyz: Array) -> tuple[dict[int, Claim], NDArray[np.bool_]]:
    """The voxels in each ellipsoid, without those in two: CF Eq. 4.4, 4.7 as printed."""
    distance = ellipsoid_distance(frame.voxels.centers, xyz, frame.settings)
    inside = (distance <= 1.0) & (frame.parts.component_of >= 0)
    n_holders = inside.sum(axis=0)
    claims = {}
    for t, mine in enumerate(inside):
        own = np.flatnonzero(mine & (n_holders == 1))
        claims[t] = replace(claim_of(frame, own), is_shared=bool((n_holders[mine] > 1).any()))
    is_taken = np.zeros(len(frame.parts), dtype=bool)
    is_taken[np.unique(frame.parts.component_of[n_holders > 0])] = True
    return claims, is_taken


def _claim_components(
    frame: Frame, tracks: tuple[Track, ...], xyz: Array
) -> tuple[dict[int, Claim], NDArray[np.bool_]]:
    """Give every track the component that fills its ellipsoid most; divide components that hold several."""
    parts = frame.parts
    is_taken = np.zeros(len(parts), dtype=bool)
    claims: dict[int, Claim] = {}
    for k, inside_k in _members(frame, tracks, xyz).items():
        is_taken[k] = True
        # A tentative track has not shown yet that it is a body of its own: beside a confirmed one it is a ghost.
        inside_k = [t for t in inside_k if tracks[t].status != TENTATIVE] or inside_k
        if len(inside_k) == 1:
            alone = _judged(frame, tracks[inside_k[0]], part_claim(frame, k))
            if alone.is_person or frame.verdicts[k]:
                claims[inside_k[0]] = alone
                continue
        claims.update(_divide(frame, parts.voxels(k), inside_k, tracks, xyz))
    return claims, is_taken


def _members(frame: Frame, tracks: tuple[Track, ...], xyz: Array) -> dict[int, list[int]]:
    """Component -> tracks whose ellipsoid it fills most."""
    members: dict[int, list[int]] = {}
    exclusive, every = _votes(frame, xyz)
    for t, track in enumerate(tracks):
        for votes in (exclusive[t], every[t]):  # CF Eq. 4.7: what two tracks see decides for neither
            if votes.any() and votes.max() * frame.side_kg >= frame.settings.min_support_kg:
                members.setdefault(_best_component(frame, track, votes), []).append(t)
                break
    return members


def _judged(frame: Frame, track: Track, claim: Claim) -> Claim:
    """The claim with a verdict that minds what the track was like before; see follow_low."""
    if not frame.settings.follow_low:
        return claim
    if track.status == TENTATIVE:
        is_low = track.top_m < frame.settings.min_new_top_m and may_lie(claim.features)
    elif _is_left_behind(frame, track, claim):
        return replace(claim, is_person=False)
    else:
        is_low = _is_sunk(track, claim)
    return replace(claim, is_person=True, is_low=True) if is_low and not claim.is_person else claim


def _is_sunk(track: Track, claim: Claim) -> bool:
    """Whether a low blob that no tree calls a person may be a known one: it weighs what the person weighs."""
    return claim.weight_kg >= _LOW_SHARE * track.weight_kg and may_be_low(claim.features)


def _is_left_behind(frame: Frame, track: Track, claim: Claim) -> bool:
    """Whether a low blob under a confirmed track is what its person has left: a chair, a shadow, a coat.

    Who sits down, crouches or falls does so within several frames and takes his voxels along; a chair beside which
    somebody vanishes is lower, lighter or elsewhere at once.  Colours that agree outweigh all that.
    """
    settings, parts = frame.settings, frame.parts
    lowest_new = min(settings.min_new_top_m, track.last_top_m)
    if not claim.features.top_m < lowest_new:
        return False
    # Legs of a body in two pieces are low as well.
    gap = np.linalg.norm(parts.centroid[:, :2] - claim.centroid[:2], axis=1)
    above = (gap <= _ASIDE_M) & (parts.weight_kg >= settings.min_support_kg)
    top = float((parts.upper[above, 2] + settings.voxel_size_m / 2).max(initial=claim.features.top_m))
    if not top < lowest_new:
        return False
    dt = (frame.voxels.frame - track.born - track.age) / settings.fps
    alike = None
    if track.appearance is not None and (look := frame.appearance(claim.voxels)) is not None:
        # Who lies has his head where the legs were: the bands say nothing.
        alike = bhattacharyya(track.appearance.sum(axis=0), look.sum(axis=0))
    if alike is not None and (alike < _UNLIKE or alike >= settings.reid_likeness):
        return alike < _UNLIKE
    step = float(np.hypot(*(claim.centroid[:2] - track.xyz[:2])))
    return (
        track.last_top_m - top > max(_DROP_M, _DROP_M_S * dt)
        or step > max(_LOW_STEP_M, _LOW_STEP_M_S * dt)
        or claim.weight_kg < _LOW_SHARE * track.last_kg
    )


def _best_component(frame: Frame, track: Track, votes: Array) -> int:
    """The component with most votes, unless it is what the person has just left: a chair, a table."""
    best = int(np.argmax(votes))
    top = frame.parts.upper[:, 2]
    lowest = track.top_m - _SHRUNK_M
    if track.status == TENTATIVE or not (top[best] < lowest):
        return best
    aside = np.linalg.norm(frame.parts.centroid[:, :2] - frame.parts.centroid[best, :2], axis=1) > _ASIDE_M
    is_rival = (votes >= _RIVAL_SHARE * votes[best]) & frame.verdicts & (top >= lowest) & aside
    rivals = np.flatnonzero(is_rival)
    return int(rivals[np.argmax(votes[rivals])]) if len(rivals) else best


def _divide(
    frame: Frame,
    voxels: Indices,
    slots: list[int],
    tracks: tuple[Track, ...],
    xyz: Array,
) -> dict[int, Claim]:
    """Divide one component among the tracks in it (by slot), by the nearest ellipsoid.

    A track gets nothing and leaves its share to the others when the share is no person, or when the component
    is too light for all of them: it is a track that has lost its person and stands beside another one, whose
    arms it must not take.  Where colours tell the persons apart they say first who stands where, and heads then.
    The ellipsoids of all who stand are of one height: those of their own would give the head of the shorter one to the
    taller, and who loses his upper end sinks, and loses more (decision 123).
    """
    settings = frame.settings
    centers, places, tops_m = frame.voxels.centers[voxels], xyz[slots], np.full(len(slots), np.inf)
    if len(slots) > 1:
        places = _places_by_colour(frame, voxels, [tracks[t] for t in slots], places)
        tops_m = np.array([tracks[t].top_m + _BOB_M for t in slots])
        places, tops_m = _places_by_heads(frame, voxels, places, tops_m)
        is_low = np.array([tracks[t].last_top_m < _LOW_TOP_M for t in slots])
        places[~is_low, 2] = places[:, 2].max()
    near = ellipsoid_distance(centers, places, settings)
    # What is higher than somebody belongs to who is taller, if one is (decision 125).
    near[centers[:, 2] > tops_m[:, None]] += _FAR
    total_kg = len(voxels) * frame.side_kg
    rows = list(range(len(slots)))
    while True:
        nearest = np.argmin(near[rows], axis=0)
        claims = {}
        for i, row in enumerate(rows):
            mine = nearest == i
            claim = _best_claim(frame, tracks[slots[row]], voxels[mine], near[row][mine])
            claims[slots[row]] = replace(claim, is_shared=len(rows) > 1)
        failed = [r for r in rows if not claims[slots[r]].is_person]
        usual_kg = {r: max(tracks[slots[r]].weight_kg, 1e-9) for r in rows}
        if not failed and total_kg < settings.min_shared_weight * sum(usual_kg.values()):
            failed = rows
        if not failed or len(rows) == 1:
            return claims
        # Coasting tracks go first, otherwise two tracks on one person would take turns for ever.
        rows.remove(
            min(
                failed,
                key=lambda r: (RANK[tracks[slots[r]].status], claims[slots[r]].weight_kg / usual_kg[r]),
            )
        )


def _places_by_colour(frame: Frame, voxels: Indices, tracks: list[Track], xyz: Array) -> Array:
    """Where each person stands in a blob of several, (T, 3) m, by the colours of its voxels; xyz without them.

    Three rounds of expectation and maximisation over the coloured voxels, in the plane, from the predicted places.
    """
    if frame.bins is None or not frame.settings.keep_identity or any(t.appearance is None for t in tracks):
        return xyz
    rows = voxels[frame.bins[voxels] >= 0]
    if len(rows) < MIN_COLOURED:
        return xyz
    likelihood = np.empty((len(tracks), len(rows)))
    for i, track in enumerate(tracks):
        model = np.zeros(N_BINS) if track.appearance is None else track.appearance.sum(axis=0)
        likelihood[i] = model[frame.bins[rows]] + _COLOUR_FLOOR
    points = frame.voxels.centers[rows]
    places = xyz.copy()
    for _ in range(3):
        share = likelihood * np.exp(-0.5 * ellipsoid_distance(points, places, frame.settings))
        share /= np.maximum(share.sum(axis=0), 1e-300)
        mass = share.sum(axis=1)
        for i in range(len(tracks)):
            if mass[i] >= 0.05 * len(rows):
                shift = share[i] @ points[:, :2] / mass[i] - xyz[i, :2]
                far = float(np.hypot(shift[0], shift[1]))
                places[i, :2] = xyz[i, :2] + shift * min(1.0, _PULL_M / max(far, 1e-9))
    return places


def _places_by_heads(frame: Frame, voxels: Indices, places: Array, tops_m: Array) -> tuple[Array, Array]:
    """Places (T, 3) m and how high each is at most, (T,) m: by the heads of the component if each has one."""
    heads, _ = _heads(frame, voxels)
    if len(heads) != len(places):
        return places.copy(), tops_m
    _, own = linear_sum_assignment(np.linalg.norm(places[:, None, :2] - heads[:, :2], axis=2))
    return np.column_stack([heads[own, :2], places[:, 2]]), heads[own, 2] + ABOVE_M


def _best_claim(frame: Frame, track: Track, voxels: Indices, distance: Array) -> Claim:
    """The whole share if it is a person, otherwise the part inside the ellipsoid (CF Eq. 4.4)."""
    whole = _judged(frame, track, claim_of(frame, voxels))
    return whole if whole.is_person else _judged(frame, track, claim_of(frame, voxels[distance <= 1.0]))


def likeness(track_appearance: Histogram | None, blob_appearance: Histogram | None) -> float | None:
    """Bhattacharyya coefficient of two colour models; None when one is unknown."""
    if track_appearance is None or blob_appearance is None:
        return None
    return bhattacharyya(track_appearance, blob_appearance)


def _free_persons(
    frame: Frame, claims: dict[int, Claim], is_taken: NDArray[np.bool_], xyz: Array, *, lying: bool = False
) -> list[int]:
    """Person components that belong to nobody and stand away from every track; heaviest first.

    xyz : (T, 3) m, where the tracks are believed to be: of who is one volume with others but for his legs, what he
    holds may be elsewhere.  lying : those too that may be somebody on the floor.
    """
    parts = frame.parts
    slots = [slot for slot, claim in claims.items() if len(claim.voxels)]
    places = [claims[slot].centroid for slot in slots]
    owners = np.array([*places, *xyz[slots]] if frame.settings.whole_components else places)
    heavy = np.flatnonzero(~is_taken & (parts.weight_kg >= frame.settings.min_support_kg)).tolist()
    free = [k for k in heavy if frame.verdicts[k] or (lying and may_lie(parts.features(k)))]
    if len(owners) and free:
        gap = np.linalg.norm(parts.centroid[free, None, :2] - owners[None, :, :2], axis=2)
        free = [k for k, d in zip(free, gap, strict=True) if _is_apart(frame, k, d.min())]
    return sorted(free, key=lambda k: (-parts.weight_kg[k], k))


def _is_apart(frame: Frame, k: int, gap_m: float) -> bool:
    """Whether a person component is far enough from the nearest one who is followed.

    A piece of somebody is near him; what stands on the floor and has a head and shoulders is none, as a child at the
    hand of an adult (decision 125).
    """
    parts, settings = frame.parts, frame.settings
    if gap_m >= settings.min_distance_m or gap_m < _WHOLE_GAP_M:
        return gap_m >= settings.min_distance_m
    if not (settings.whole_components and frame.verdicts[k] and parts.lower[k, 2] < _ON_FLOOR_M):
        return False
    heads, _ = _heads(frame, parts.voxels(k))
    centers = frame.voxels.centers[parts.voxels(k)]
    return len(heads) == 1 and has_shoulders(centers, heads[0], settings.voxel_size_m)


def _reacquire(
    frame: Frame,
    tracks: tuple[Track, ...],
    xyz: Array,
    claims: dict[int, Claim],
    is_taken: NDArray[np.bool_],
) -> None:
    """Tracks without a person take over free person components within reach, nearest pair first.

    With colours: not of somebody else; and the longer a person was out of sight, the further away.
    """
    missing = [t for t in range(len(tracks)) if t not in claims or not claims[t].is_person]
    if not missing:
        return
    healthy = {t: c for t, c in claims.items() if c.is_person}
    pairs = []
    for k in _free_persons(frame, healthy, is_taken, xyz):
        look = frame.appearance(frame.parts.voxels(k)) if frame.settings.keep_identity else None
        for t in missing:
            gap = float(np.linalg.norm(frame.parts.centroid[k, :2] - xyz[t, :2]))
            if gap <= _reach(frame, tracks[t], k, look):
                pairs.append((gap, t, k))
    found: set[int] = set()
    for _, t, k in sorted(pairs):
        if t not in found and not is_taken[k]:
            claims[t] = part_claim(frame, k, is_new=True)
            is_taken[k] = True
            found.add(t)


def _reach(frame: Frame, track: Track, k: int, look: Histogram | None) -> float:
    """How far, m, a track that lost its person may be from component k to take it over; negative = from nowhere.

    look : the component's colours.
    """
    settings = frame.settings
    alike = likeness(track.appearance, look)
    if alike is not None and alike < _UNLIKE:
        return -1.0
    if settings.follow_low and _is_left_behind(frame, track, part_claim(frame, k)):
        return -1.0
    if alike is not None and alike >= settings.reid_likeness and track.status == COASTING:
        return settings.reacquire_distance_m + 1.5 * track.misses / settings.fps
    return max(settings.reacquire_distance_m, _WALK_M_S / settings.fps)


def _create(frame: Frame, claims: dict[int, Claim], is_taken: NDArray[np.bool_], xyz: Array) -> list[Claim]:
    """Components that become new tracks. Source: CF 4.2.3, track creation criteria."""
    newborn: list[int] = []
    for k in _free_persons(frame, claims, is_taken, xyz, lying=frame.settings.follow_low):
        centroid = frame.parts.centroid
        gaps = [float(np.linalg.norm(centroid[k, :2] - centroid[n, :2])) for n in newborn]
        if _is_apart(frame, k, min(gaps, default=np.inf)):
            newborn.append(k)
            is_taken[k] = True
    claims_of = (_born(frame, k) for k in newborn)
    return [claim for born in claims_of for claim in born]


def _born(frame: Frame, k: int) -> list[Claim]:
    """The person in a component, or several with much the same share of it."""
    apart = _apart(frame, frame.parts.voxels(k), _ALIKE_SHARE) if frame.settings.whole_components else []
    return apart or [replace(part_claim(frame, k), is_person=True, is_low=not frame.verdicts[k])]


def _create_several(frame: Frame, others: Sequence[Claim], is_taken: NDArray[np.bool_]) -> list[Claim]:
    """Persons who touch when first seen, in components that are too heavy or too wide for one. Not in the source."""
    newborn: list[Claim] = []
    for k in np.flatnonzero(~is_taken & ~frame.verdicts & (frame.parts.weight_kg >= _LEAST_OF_TWO_KG)):
        apart = _apart(frame, frame.parts.voxels(int(k)))
        owners = [c for c in (*others, *newborn) if len(c.voxels)]
        gaps = [np.linalg.norm(new.centroid[:2] - own.centroid[:2]) for new in apart for own in owners]
        if apart and all(gap >= frame.settings.min_distance_m for gap in gaps):
            newborn += apart
            is_taken[k] = True
    return newborn


def _come_apart(frame: Frame, tracks: tuple[Track, ...], claims: dict[int, Claim]) -> list[Claim]:
    """Persons who were one track with another until now: of a claim with two heads, for a while. Not in the source.

    The track keeps the share that is nearest to it, in place in `claims`. Nobody comes apart beside somebody else: what
    two people hide from the cameras between them is as high as their heads (decision 123).
    """
    settings = frame.settings
    n_known = sum(track.status != TENTATIVE for track in tracks)
    firm = [c for slot, c in claims.items() if tracks[slot].status != TENTATIVE and len(c.voxels)]
    newborn: list[Claim] = []
    for slot, claim in claims.items():
        track = tracks[slot]
        if track.status == TENTATIVE or claim.is_shared or claim.weight_kg < _LEAST_OF_TWO_KG:
            continue
        if any(
            np.linalg.norm(c.centroid[:2] - claim.centroid[:2]) < BESIDE_M for c in firm if c is not claim
        ):
            continue
        shares = _apart(frame, claim.voxels) if claim.is_person else []
        if not shares:
            continue
        claims[slot] = replace(claim, is_several=True)
        n_all = n_known + len(newborn) + len(shares) - 1
        is_room = settings.expected_persons is None or n_all <= settings.expected_persons
        if track.n_several < _TWO_HEADS_S * settings.fps or not is_room:
            continue
        gaps = [np.linalg.norm(share.centroid[:2] - track.xyz[:2]) for share in shares]
        parted = [replace(share, is_parted=True) for share in shares]
        claims[slot] = parted.pop(int(np.argmin(gaps)))
        newborn += parted
    return newborn


def _heads(frame: Frame, voxels: Indices, like_share: float = _LIKE_SHARE) -> tuple[Array, Indices]:
    """Heads (H, 3) m of a component that have a body each, and (N,) the head that is nearest to each of its voxels.

    like_share : what is less of an equal share has no head of its own; nor has what has no shoulders under it.
    """
    centers = frame.voxels.centers[voxels]
    heads = heads_of(centers, frame.settings.voxel_size_m)
    while len(heads) > 1:
        nearest = nearest_head(centers, heads)
        count = np.bincount(nearest, minlength=len(heads))
        is_body = count >= like_share * len(voxels) / len(heads)
        for i in np.flatnonzero(is_body):
            is_body[i] = has_shoulders(centers[nearest == i], heads[i], frame.settings.voxel_size_m)
        if is_body.all():
            return heads, nearest
        heads = np.delete(heads, np.where(is_body, len(voxels), count).argmin(), axis=0)
    return heads, np.zeros(len(voxels), dtype=np.int64)


def _apart(frame: Frame, voxels: Indices, like_share: float = _LIKE_SHARE) -> list[Claim]:
    """One claim for each head of a component, by the nearest head; none where there is one, or not all are persons.

    What two people leave between them in the volume has a head, too, but no pixels of its own.
    """
    heads, nearest = _heads(frame, voxels, like_share)
    while len(heads) > 1:
        own = _own_shares(frame, voxels, nearest, len(heads))
        if own.min() >= _OWN_SHARE:
            break
        heads = np.delete(heads, own.argmin(), axis=0)
        nearest = nearest_head(frame.voxels.centers[voxels], heads)
    if len(heads) < 2:
        return []
    shares = [replace(claim_of(frame, voxels[nearest == i]), is_shared=True) for i in range(len(heads))]
    return shares if all(share.is_person for share in shares) else []


def _own_shares(frame: Frame, voxels: Indices, nearest: Indices, n_heads: int) -> Array:
    """How much of what is under each head nobody else covers in the pictures, (n_heads,)."""
    rig = frame.settings.rig
    if rig is None or len(rig) < LEAST_CAMERAS:
        return np.ones(n_heads)
    label = np.full(len(frame.voxels), n_heads)  # what is somebody else's
    label[voxels] = nearest
    is_surface = frame.voxels.is_surface
    covered = Covered(rig, frame.voxels.centers[is_surface], label[is_surface], n_heads + 1)
    return np.array([covered.own_share(head) for head in range(n_heads)])


def _add_fragments(
    frame: Frame, claims: dict[int, Claim], is_taken: NDArray[np.bool_], firm: Sequence[int]
) -> None:
    """Loose parts go to the nearest track within reach: a hand that the carving cut off, or a trunk above its legs.

    What is heavier and stands on the floor is somebody else. firm : slots of tracks that are persons for sure.
    """
    parts, settings = frame.parts, frame.settings
    owners = [t for t, c in claims.items() if len(c.voxels)]
    loose = np.flatnonzero(~is_taken & (parts.weight_kg >= settings.min_fragment_kg))
    if not owners or not len(loose):
        return
    xyz = np.array([claims[t].centroid for t in owners])
    top = np.array([claims[t].box[1, 2] for t in owners])
    weight = np.array([claims[t].weight_kg for t in owners])
    aside = np.linalg.norm(xyz[:, None, :2] - parts.centroid[loose, :2], axis=2)
    reach = ellipsoid_distance(parts.centroid[loose], xyz, settings)
    # The ellipsoid of legs is low: that of somebody beside reaches farther up to the trunk above them.
    is_above = (aside <= _ASIDE_M) & (parts.centroid[loose, 2] > top[:, None])
    is_above &= np.isin(owners, firm)[:, None]
    nearest = np.argmin(np.where(is_above, 0.0, reach), axis=0)
    is_trunk = (parts.lower[loose, 2] > _ON_FLOOR_M) & (aside[nearest, range(len(loose))] <= _ASIDE_M)
    belongs = reach.min(axis=0) <= settings.fragment_reach**2
    belongs &= (parts.weight_kg[loose] < weight[nearest]) | is_trunk
    for i, t in enumerate(owners):
        mine = loose[belongs & (nearest == i)]
        if len(mine):
            claims[t] = _with_parts(frame, claims[t], mine)
            is_taken[mine] = True


def _with_parts(frame: Frame, claim: Claim, which: Indices) -> Claim:
    """A claim and some components together, a person if the claim is one or both are."""
    parts = frame.parts
    is_mine = np.zeros(len(frame.voxels), dtype=np.bool_)
    is_mine[claim.voxels] = True
    for k in which:
        is_mine[parts.voxels(int(k))] = True
    voxels = np.flatnonzero(is_mine)
    count = parts.start[which + 1] - parts.start[which]
    centroid = (len(claim.voxels) * claim.centroid + count @ parts.centroid[which]) / len(voxels)
    box = np.empty((2, 3))
    np.minimum(claim.box[0], parts.lower[which].min(axis=0), out=box[0])
    np.maximum(claim.box[1], parts.upper[which].max(axis=0), out=box[1])
    features = features_of(len(voxels), float(centroid[2]), box[0], box[1], frame.settings.voxel_size_m)
    return replace(
        claim,
        voxels=voxels,
        features=features,
        centroid=centroid,
        box=box,
        is_person=claim.is_person or is_person(features, frame.settings.person_tree),
    )
