"""The life of a track, the same for every tracker: creation, confirmation, coasting, deletion, and who is who.

    new --tentative--> confirmed <--> coasting --> lost (and recognised when he returns)

A new track is tentative until it was seen as a person in `confirm_frames` frames; in the first frame of a
clip it is confirmed at once, because there is no earlier frame that could speak against it.  A confirmed
track that is not seen coasts and is deleted after `lost_frames` frames.  Source: CF 4.2.3.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from mocap.arrays import Array
from mocap.tracking import motion
from mocap.tracking.claims import Claim, Frame, Histogram, claim_of, likeness
from mocap.tracking.colour import adapt
from mocap.tracking.features import is_stretched_out
from mocap.tracking.state import (
    COASTING,
    CONFIRMED,
    RANK,
    TENTATIVE,
    LostPerson,
    Track,
    TrackerSettings,
    TrackerState,
)

Start = Callable[[Track, Frame, Claim], Track]

_USUAL_RATE = 0.1  # of the running means of weight and height
_SLOW_RATE = 0.02  # of the slow colour model, once it has seen fifty frames
_MIN_VIEWS = 3  # frames of a colour model that identities may rest on
_MIXED_S = 1.0  # after persons were close, an exchange of identities is looked for so long
_MIXED_M = 0.6  # separate blobs nearer than this are close
_STRAY_M = 0.3  # samples whose mean is further from the owned voxels have lost the person
_PATIENCE = 8  # times lost_frames, for a person who is expected and still has voxels
_SAME = 0.7  # Bhattacharyya coefficient from which on two colour models may be of one person
_EMBRACE_S = 5.0  # two tracks in different clothes may be in one place for so long
_RETURN_M_S = 2.5  # a person who returns cannot have been faster


@dataclass
class Lives:
    """Tracks of one step in the making, with their claims by serial; reports what happened to whom."""

    tracks: list[Track] = field(default_factory=list)
    claims: dict[int, Claim] = field(default_factory=dict)
    created: list[int] = field(default_factory=list)
    deleted: dict[int, str] = field(default_factory=dict)
    exchanged: list[tuple[int, int]] = field(default_factory=list)
    recognised: list[int] = field(default_factory=list)
    renamed: list[int] = field(default_factory=list)
    lost: list[LostPerson] = field(default_factory=list)
    replaced: set[int] = field(default_factory=set)


def advance_lives(
    state: TrackerState,
    predicted: tuple[Track, ...],
    tracks: tuple[Track, ...],
    claims: dict[int, Claim],
    newborn: list[int],
    n_frames: int,
    frame: Frame,
    start: Start,
) -> tuple[TrackerState, Lives]:
    """Advance the life of every track by n_frames, start those of the newborn slots, and settle who is who.

    predicted, tracks : live tracks after the prediction, and as the filter left them; both in the order of
    state.tracks.  claims : slot -> claim.
    start : makes the filter's samples for a track from a claim.
    """
    lives = Lives(lost=_still_remembered(state, frame))
    for slot, (before, track) in enumerate(zip(predicted, tracks, strict=True)):
        claim = claims.get(slot) or claim_of(frame, np.zeros(0, dtype=np.int64), verdict=False)
        _advance(lives, before, track, claim, n_frames, frame, start)
    _exchange(lives, frame)
    used = {t.person for t in lives.tracks} | set(lives.deleted)
    _confirm(lives, state, used, frame)
    lives.tracks = [t for t in lives.tracks if t.serial not in lives.replaced]
    n_serials = state.n_serials
    for slot in newborn:
        _give_birth(lives, state, claims[slot], n_serials, used, frame, start)
        n_serials += 1
    _merge(lives, n_frames, frame)
    _learn_colours(lives, n_frames, frame)
    confirmed = {t.person for t in lives.tracks if t.status != TENTATIVE}
    lives.tracks.sort(key=lambda t: t.person)
    known = (state.confirmed_ids - set(lives.renamed)) | confirmed
    lost = tuple(p for p in lives.lost if p.person not in confirmed)
    return TrackerState(tuple(lives.tracks), frame.voxels.frame, known, lost, n_serials), lives


def _still_remembered(state: TrackerState, frame: Frame) -> list[LostPerson]:
    settings = frame.settings
    if settings.expected_persons is not None:
        return list(state.lost)
    oldest = frame.voxels.frame - settings.reid_s * settings.fps
    return [p for p in state.lost if p.frame >= oldest]


def _advance(
    lives: Lives,
    predicted: Track,
    track: Track,
    claim: Claim,
    n_frames: int,
    frame: Frame,
    start: Start,
) -> None:
    """One track with its claim: position, status, usual weight; or its end."""
    settings = frame.settings
    is_supported = claim.weight_kg >= settings.min_support_kg
    is_lost_filter = settings.estimate == "filter" and track.efficiency <= 0.0
    is_person = claim.is_person and not is_lost_filter
    aged = _aged(track, n_frames, is_person=is_person)
    if aged.misses > _patience(aged, settings, is_supported=is_supported):
        _end(lives, track, "lost", frame)
        return
    if aged.status == TENTATIVE and aged.age > max(settings.tentative_frames, 3 * settings.confirm_frames):
        _end(lives, track, "unconfirmed", frame)
        return
    track = _place(predicted, aged, claim, is_supported, frame, start)
    track = track.replace(n_several=track.n_several + n_frames if claim.is_several else 0)
    if claim.is_parted:
        track = _alone(track, claim)
    elif is_person and not claim.is_shared:
        track = _with_size(track, claim, settings)
    lives.tracks.append(track)
    lives.claims[track.serial] = claim


def _aged(track: Track, n_frames: int, *, is_person: bool) -> Track:
    """The track n_frames later, seen as a person now or not."""
    is_tentative = track.status == TENTATIVE
    if is_person:
        status = TENTATIVE if is_tentative else CONFIRMED
        return track.replace(status=status, age=track.age + n_frames, hits=track.hits + 1, misses=0)
    status = TENTATIVE if is_tentative else COASTING
    return track.replace(status=status, age=track.age + n_frames, misses=track.misses + n_frames)


def _patience(track: Track, settings: TrackerSettings, *, is_supported: bool) -> int:
    """Frames without a sighting after which a track ends."""
    if track.status == TENTATIVE:
        return settings.tentative_misses
    if settings.expected_persons is not None and track.status == COASTING and is_supported:
        return settings.lost_frames * _PATIENCE
    return settings.lost_frames


def _with_size(track: Track, claim: Claim, settings: TrackerSettings) -> Track:
    """Usual weight and height after a frame in which the person stood alone, and whether it has moved."""
    # What is a person by its usual weight must not change it: a blob that shrinks would take the track along.
    rate = 0.0 if claim.is_low else _USUAL_RATE
    track = track.replace(
        weight_kg=track.weight_kg + rate * (claim.weight_kg - track.weight_kg),
        top_m=track.top_m + _USUAL_RATE * (claim.features.top_m - track.top_m),
        last_kg=claim.weight_kg,
        last_top_m=claim.features.top_m,
    )
    # What has just come off a person is not yet itself: its first sightings say where and how large it is.
    here = _posture(claim)
    if track.hits <= settings.confirm_frames:
        return track.replace(home=here)
    if not track.has_moved and np.abs(here - track.home).max() >= settings.min_move_m:
        return track.replace(has_moved=True)
    return track


def _alone(track: Track, claim: Claim) -> Track:
    """A track that was several persons until now, with the size of what it has left, and colours yet to be learnt."""
    top_m = claim.features.top_m
    return track.replace(
        weight_kg=claim.weight_kg,
        top_m=top_m,
        last_kg=claim.weight_kg,
        last_top_m=top_m,
        histogram=None,
        appearance=None,
        n_appearance=0,
    )


def _place(
    predicted: Track, track: Track, claim: Claim, is_supported: bool, frame: Frame, start: Start
) -> Track:
    """Position and covariance after the claim, and new samples where the filter has lost its person."""
    settings = frame.settings
    estimate, spread = track.xyz, track.covariance
    has_estimate = settings.estimate == "filter" and settings.tracker != "naive" and track.efficiency > 0.0
    track = track.replace(xyz=predicted.xyz, covariance=predicted.covariance)
    floor = motion.place_covariance(settings, is_certain=claim.is_person and not claim.is_shared)
    if has_estimate:
        return motion.observe(track, estimate, spread + floor, settings)
    if not is_supported:
        return track  # nothing to stand on: where the person was going, with the uncertainty of that
    if claim.is_new:
        # Found again from afar: the jump is no velocity.
        track = track.replace(
            xyz=claim.centroid,
            covariance=floor,
            velocity=np.zeros(3),
            motion=motion.start_motion(settings),
        )
    else:
        track = motion.observe(track, claim.centroid, floor, settings)
    is_stray = float(np.linalg.norm(estimate[:2] - claim.centroid[:2])) > _STRAY_M
    if track.efficiency <= 0.0 or claim.is_new or is_stray:
        track = start(track, frame, claim)
    return track


def _end(lives: Lives, track: Track, reason: str, frame: Frame, *, is_remembered: bool = True) -> None:
    """Delete a track; a person who was confirmed is remembered."""
    lives.deleted[track.person] = reason
    if track.status != TENTATIVE and is_remembered:
        lives.lost.append(
            LostPerson(
                track.person,
                track.appearance if track.n_appearance >= _MIN_VIEWS else None,
                track.xyz,
                frame.voxels.frame - track.misses,
            )
        )


def _exchange(lives: Lives, frame: Frame) -> None:
    """Exchange the identities of two tracks that were close, where their colours say so.

    Only what stands alone now is compared, with colour models of the time before: a share of a blob shows the colours
    of both.
    """
    settings = frame.settings
    if frame.bins is None or not settings.keep_identity:
        return
    ready = [i for i, track in enumerate(lives.tracks) if _may_be_mixed_up(lives, track)]
    looks = {i: frame.appearance(lives.claims[lives.tracks[i].serial].voxels) for i in ready}
    for i, j in itertools.combinations(ready, 2):
        a, b = lives.tracks[i], lives.tracks[j]
        gain = _gain_of_exchange(a, b, looks[i], looks[j])
        if gain is not None and gain > settings.identity_margin:
            lives.tracks[i], lives.tracks[j] = _with_body_of(a, b), _with_body_of(b, a)
            looks[i], looks[j] = looks[j], looks[i]
            claims = lives.claims
            claims[a.serial], claims[b.serial] = claims[b.serial], claims[a.serial]
            lives.exchanged.append((a.person, b.person))


def _may_be_mixed_up(lives: Lives, track: Track) -> bool:
    """Whether a track was close to another one, stands alone now, and has colours of the time before."""
    return (
        track.mixed > 0
        and track.is_seen
        and track.status != TENTATIVE
        and track.n_appearance >= _MIN_VIEWS
        and not lives.claims[track.serial].is_shared
    )


def _gain_of_exchange(a: Track, b: Track, look_a: Histogram | None, look_b: Histogram | None) -> float | None:
    """How much better the colours agree if a is b; None where colours are missing."""
    crossed = likeness(a.appearance, look_b), likeness(b.appearance, look_a)
    straight = likeness(a.appearance, look_a), likeness(b.appearance, look_b)
    if crossed[0] is None or crossed[1] is None or straight[0] is None or straight[1] is None:
        return None
    return float(crossed[0] + crossed[1] - straight[0] - straight[1])


def _with_body_of(track: Track, other: Track) -> Track:
    """The identity of a track in the place of another one."""
    return track.replace(
        xyz=other.xyz,
        covariance=other.covariance,
        velocity=other.velocity,
        motion=other.motion,
        samples=other.samples,
        weights=other.weights,
        efficiency=other.efficiency,
        misses=other.misses,
        last_kg=other.last_kg,
        last_top_m=other.last_top_m,
        close=other.close,
        mixed=other.mixed,
    )


def _posture(claim: Claim) -> Array:
    """Position xy, both sides of the box, and top: (5,) m."""
    box = (claim.features.box_max_m, claim.features.box_min_m, claim.features.top_m)
    return np.array([*claim.centroid[:2], *box])


def _is_credible(track: Track, claim: Claim, settings: TrackerSettings) -> bool:
    """Tall enough for somebody new, or on the move: a chair is neither; or stretched out where nothing lay before."""
    if track.has_moved or not track.top_m < settings.min_new_top_m:
        return True
    least = settings.lying_frames
    return least is not None and track.hits >= least and is_stretched_out(claim.features)


def _confirm(lives: Lives, state: TrackerState, used: set[int], frame: Frame) -> None:
    """Tentative tracks that were seen often enough become persons, known ones or new ones.

    Who comes in is half outside at first: for a second after the confirmation he may still be recognised.
    """
    settings = frame.settings
    for i, track in enumerate(lives.tracks):
        if track.is_named:
            continue
        is_new = track.status == TENTATIVE
        if is_new and (
            track.hits < settings.confirm_frames
            or not _is_credible(track, lives.claims[track.serial], settings)
        ):
            continue
        person = _identity(lives, state, track, frame)
        if person is None:
            continue
        if person != track.person:
            track = _renamed(lives, track, person, used)
        lives.tracks[i] = track.replace(
            is_named=track.is_named or _is_final(lives, track, settings),
            status=CONFIRMED if is_new else track.status,
        )


def _identity(lives: Lives, state: TrackerState, track: Track, frame: Frame) -> int | None:
    """The number of a track that is not named: of a lost person who has returned, its own, or None = nobody's."""
    colours = _colours_of(track, lives.claims[track.serial], frame)
    person = _recognised(lives, track, colours, frame)
    if person is not None:
        return person
    return (
        _new_or_expected(lives, state, track, colours, frame) if track.status == TENTATIVE else track.person
    )


def _renamed(lives: Lives, track: Track, person: int, used: set[int]) -> Track:
    """The track of somebody who has been here before, with the number of then."""
    used.add(person)
    lives.recognised.append(person)
    lives.renamed.append(track.person)
    lives.lost = [p for p in lives.lost if p.person != person]
    return track.replace(person=person, is_named=True)


def _is_final(lives: Lives, track: Track, settings: TrackerSettings) -> bool:
    """Whether nobody is left whom the track could be, or the time to recognise somebody is over."""
    waits = settings.reid_s > 0 and bool(lives.lost) and settings.expected_persons is None
    return not waits or track.hits >= settings.confirm_frames + _MIXED_S * settings.fps


def _colours_of(track: Track, claim: Claim, frame: Frame) -> Histogram | None:
    """The colours of a young track, this frame included; None without any."""
    now = None if claim.is_shared or not claim.is_person else frame.appearance(claim.voxels)
    if track.appearance is None or now is None:
        return track.appearance if now is None else now
    return adapt(track.appearance, now, track.n_appearance / (track.n_appearance + 1))


def _recognised(lives: Lives, track: Track, look: Histogram | None, frame: Frame) -> int | None:
    """The lost person whose colours agree with a track, clearly better than any other's; None = nobody."""
    settings = frame.settings
    if settings.reid_s <= 0:
        return None
    likely = [
        (alike, p)
        for p in lives.lost
        if (alike := likeness(p.appearance, look)) is not None and _can_return(p, track, frame)
    ]
    likely.sort(key=lambda c: (-c[0], c[1].person))
    if not likely or likely[0][0] < settings.reid_likeness:
        return None
    if len(likely) > 1 and likely[0][0] - likely[1][0] < settings.reid_margin:
        return None
    return likely[0][1].person


def _new_or_expected(
    lives: Lives, state: TrackerState, track: Track, look: Histogram | None, frame: Frame
) -> int | None:
    """The id of a track whom nobody has recognised: its own, or None = nobody's.

    With a number of expected persons: new ids only while fewer than those were given; then that of the lost person
    who fits best, or of one who coasts.
    """
    expected = frame.settings.expected_persons
    given = state.confirmed_ids | {t.person for t in lives.tracks if t.status != TENTATIVE}
    if expected is None or len(given) < expected:
        return track.person
    if not lives.lost:
        return _replaced(lives, track, look)

    def rank(p: LostPerson) -> tuple[float, int, int]:
        alike = likeness(p.appearance, look)
        return (-(alike if alike is not None else 0.0), -p.frame, p.person)

    return min(lives.lost, key=rank).person


def _replaced(lives: Lives, track: Track, look: Histogram | None) -> int | None:
    """The id of the coasting track that a tentative one takes over, where no further person is expected."""
    coasting = [t for t in lives.tracks if t.status == COASTING and t.serial not in lives.replaced]
    if not coasting:
        return None

    def rank(t: Track) -> tuple[float, float, int]:
        alike = likeness(t.appearance, look)
        return (-(alike if alike is not None else 0.0), float(np.linalg.norm(t.xyz - track.xyz)), t.person)

    best = min(coasting, key=rank)
    lives.replaced.add(best.serial)
    return best.person


def _can_return(person: LostPerson, track: Track, frame: Frame) -> bool:
    elapsed = max(track.born - person.frame, 0) / frame.settings.fps
    gap = float(np.linalg.norm(track.home[:2] - person.xyz[:2]))
    return gap <= 1.0 + _RETURN_M_S * elapsed


def _give_birth(
    lives: Lives,
    state: TrackerState,
    claim: Claim,
    serial: int,
    used: set[int],
    frame: Frame,
    start: Start,
) -> None:
    """A new track on a free person blob."""
    settings = frame.settings
    person = 1
    while person in used or person in state.confirmed_ids:
        person += 1
    used.add(person)
    lives.created.append(person)
    track = Track(
        person,
        claim.centroid,
        TENTATIVE,
        frame.voxels.frame,
        weight_kg=claim.weight_kg,
        serial=serial,
        covariance=motion.place_covariance(settings),
        top_m=claim.features.top_m,
        last_kg=claim.weight_kg,
        last_top_m=claim.features.top_m,
        home=_posture(claim),
        motion=motion.start_motion(settings),
    )
    # Beside a confirmed track a tentative one has no voxels; who has parted from one has shown that he is there.
    is_at_once = state.frame is None or settings.confirm_frames == 1 or claim.is_parted
    n_confirmed = len(state.confirmed_ids | {t.person for t in lives.tracks if t.status != TENTATIVE})
    is_room = settings.expected_persons is None or n_confirmed < settings.expected_persons
    if is_at_once and is_room and _is_credible(track, claim, settings):
        track = track.replace(status=CONFIRMED, is_named=True)
    lives.tracks.append(start(track, frame, claim))
    lives.claims[serial] = claim


def _merge(lives: Lives, n_frames: int, frame: Frame) -> None:
    """Of tracks too near to one another for too long keep the best; its rivals' voxels become its own.

    Source: CF 4.2.3, track deletion criteria. Departs from it: a few frames of patience, because persons who
    pass each other are near for a moment as well; and of seconds for two in different clothes who both have voxels.
    """
    settings = frame.settings
    kept: list[Track] = []
    for track in sorted(lives.tracks, key=lambda t: (-RANK[t.status], -t.hits, t.person)):
        rivals = [k for k in kept if np.linalg.norm(k.xyz[:2] - track.xyz[:2]) < settings.merge_distance_m]
        close = track.close + n_frames if rivals else 0
        is_another = bool(rivals) and settings.keep_identity and _is_another(track, rivals[0])
        is_embraced = is_another and track.is_seen and close <= _EMBRACE_S * settings.fps
        if close <= settings.merge_frames or is_embraced:
            kept.append(track.replace(close=close))
            continue
        _end(lives, track, "merged", frame, is_remembered=is_another)
        _hand_over(lives, track, rivals[0], frame)
    lives.tracks = kept


def _hand_over(lives: Lives, track: Track, heir: Track, frame: Frame) -> None:
    """The voxels of a track that has ended become another one's."""
    best, mine = lives.claims[heir.serial], lives.claims.pop(track.serial)
    if len(mine.voxels):
        both = claim_of(frame, np.sort(np.r_[best.voxels, mine.voxels]))
        lives.claims[heir.serial] = replace(both, is_person=best.is_person, is_new=best.is_new)


def _is_another(track: Track, rival: Track) -> bool:
    """Whether two confirmed tracks are known to be two persons, by their clothes."""
    if TENTATIVE in (track.status, rival.status) or min(track.n_appearance, rival.n_appearance) < _MIN_VIEWS:
        return False
    alike = likeness(track.appearance, rival.appearance)
    return alike is not None and alike < _SAME


def _learn_colours(lives: Lives, n_frames: int, frame: Frame) -> None:
    """Learn the colours of those who stand alone, and note who was close to whom."""
    places = np.array([t.xyz[:2] for t in lives.tracks]).reshape(-1, 2)
    for i, track in enumerate(lives.tracks):
        claim = lives.claims[track.serial]
        gap = np.linalg.norm(places - places[i], axis=1)
        gap[i] = np.inf
        # A person out of sight may come back in the place of another one.
        is_close = claim.is_shared or gap.min() < _MIXED_M or not claim.is_person
        mixed = max(track.mixed - n_frames, 0)
        if is_close or (claim.is_new and track.age > 0):
            mixed = max(1, round(_MIXED_S * frame.settings.fps))
        track = track.replace(mixed=mixed)
        if frame.bins is not None and claim.is_person:
            track = _with_colours(track, claim, frame)
        lives.tracks[i] = track


def _with_colours(track: Track, claim: Claim, frame: Frame) -> Track:
    """The colour models after a frame: the published one of every frame, the slow one of those alone."""
    settings = frame.settings
    if claim.is_shared and settings.whole_components:
        return track
    look = frame.appearance(claim.voxels, float(claim.box[1, 2]))
    if look is None:
        return track
    whole = look.sum(axis=0)
    histogram = whole
    if track.histogram is not None:
        histogram = adapt(track.histogram, whole, settings.colour_adaptation)
    if claim.is_shared or (track.mixed > 0 and track.n_appearance >= _MIN_VIEWS):
        return track.replace(histogram=histogram)
    n = track.n_appearance + 1
    rate = max(1.0 / n, _SLOW_RATE)
    appearance = look if track.appearance is None else adapt(track.appearance, look, 1.0 - rate)
    return track.replace(histogram=histogram, appearance=appearance, n_appearance=n)
