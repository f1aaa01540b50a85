"""Backgrounds of a session's cameras: from a clip of the empty scene, or from the recording itself."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Image, Mask
from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.foreground import (
    COVERED_WORTH_A_WORD,
    Background,
    KeyPictures,
    background_of_recording,
    bare_in,
    changes_in,
    first_cuts,
    held_things_in,
    key_pictures,
    learn_background,
    median_background,
    off_rim,
    pieces_within,
    reduction_of,
    refine_mask,
    still_pieces_in,
    stirring_of,
    things_in,
    with_floor,
    with_quiet_floor,
)
from mocap.io.session import Session
from mocap.io.session.reading import clip_of
from mocap.pipeline.config import SegmentationConfig
from mocap.pipeline.empty_clips import REMEDY, fit_of_clip, unlike_recording, words_of_fits
from mocap.volume import Floor, FloorPlaces, Guess, Witness, choose_grid

_LEAST_FRAMES = 3
_LEAST_CAMERAS = 3  # two are no witnesses of what one of them takes for the room (decision 99)
_VOXEL_M = 0.03
_OWN_CHANGE = 0.1  # of a piece: so much of a thing does not change in nearly all cameras at once
_SEAT = 0.5  # of a piece: so much of a chair does change, where somebody sits down on it
_A_SAY = 0.3  # of a piece: so much of it as the others have, as a person or as a thing, decides; furniture hides legs
_MUST_AGREE = 3  # cameras that have a thing in one place: rays of two cross beside what they see
# What most cameras have found is in nearly all cuts after the first pass, and is held to in the second.
_N_PASSES = 2


def learn_backgrounds(
    session: Session,
    config: SegmentationConfig,
    warnings: list[str],
    each: Callable[..., Iterable[Any]] = map,
) -> list[Background]:
    """One background per camera, from background/, the first frames, or the recording.

    each : `map`, perhaps over threads.
    Raises MocapError when there is nothing to learn from, saying how to help.
    """
    sources = {camera.name: _source(camera, session, config) for camera in session.rig}
    clips = [camera for camera in session.rig if sources[camera.name] == "clip"]
    fits = dict(
        zip((c.name for c in clips), each(lambda camera: fit_of_clip(camera, session), clips), strict=True)
    )
    replaced = unlike_recording(fits) if config.background == "auto" else []
    sources |= dict.fromkeys(replaced, _without_clip(session))
    warnings += words_of_fits(fits, session, replaced=replaced)
    from_recording = [name for name, source in sources.items() if source == "recording"]
    found = _of_recording(session, from_recording, warnings, each) if from_recording else {}
    found |= {name: fit.background for name, fit in fits.items() if sources[name] == "clip"}
    others = [camera for camera in session.rig if camera.name not in found]
    learnt = each(lambda camera: _of_one_camera(camera, session, config, sources[camera.name]), others)
    found |= {camera.name: background for camera, background in zip(others, learnt, strict=True)}
    backgrounds = [found[name] for name in session.rig.names]
    for name, background in zip(session.rig.names, backgrounds, strict=True):
        if name not in fits or not fits[name].gone.any():  # what moves there has been named
            warnings += [f"camera {name}: {w}" for w in background.warnings]
    shares = zip(session.rig.names, (background.covered_share for background in backgrounds), strict=True)
    if covered := ", ".join(f"{name} {share:.1%}" for name, share in shares if share > COVERED_WORTH_A_WORD):
        warnings.append(
            f"a part of the picture is never seen empty ({covered}): somebody stays there, and it counts as a person "
            "in every frame"
        )
    if from_recording:
        warnings.append(
            f"the background of {', '.join(from_recording)} was learnt from the recording itself: what stands still "
            f"and is seen by few cameras may be missing. Remedy: {REMEDY}"
        )
    if median := [name for name, source in sources.items() if source == "median"]:
        warnings.append(
            f"the background of {', '.join(median)} was learnt as the temporal median of {len(session.frames)} frames; "
            f"a person who stays in place, or a short clip, is lost this way. Remedy: {REMEDY}"
        )
    return backgrounds


def _source(camera: Camera, session: Session, config: SegmentationConfig) -> str:
    """clip, first, median or recording."""
    if config.background != "auto":
        return config.background
    if camera.name in session.background_sources:
        return "clip"
    return _without_clip(session)


def _without_clip(session: Session) -> str:
    return "recording" if len(session.rig) >= _LEAST_CAMERAS else "median"


def _of_one_camera(camera: Camera, session: Session, config: SegmentationConfig, source: str) -> Background:
    _check_frames(camera, session)
    if source == "first":
        return learn_background(islice(clip_of(session, camera), config.first_frames))
    stride = max(1, len(session.frames) // config.median_frames)
    return median_background(islice(clip_of(session, camera), 0, None, stride))


def _of_recording(
    session: Session, names: list[str], warnings: list[str], each: Callable[..., Iterable[Any]]
) -> dict[str, Background]:
    """Backgrounds of some cameras from the recording; all cameras are witnesses."""
    rig = session.rig
    for camera in rig:
        _check_frames(camera, session)
    keys: list[KeyPictures] = list(each(lambda camera: key_pictures(clip_of(session, camera)), rig))
    small = CameraRig(tuple(camera.reduced(reduction_of(camera.size[0])) for camera in rig))
    grid = choose_grid(small, _VOXEL_M, bounds_m=session.room_bounds_m)
    witness = Witness(small, grid, [key.is_active for key in keys])
    regions = witness.regions()
    if not any(region.any() for region in regions):
        warnings.append(
            "nobody moves in this recording where enough cameras see him; whoever is in it is learnt as background. "
            f"Remedy: {REMEDY}"
        )
    places = FloorPlaces(small, grid)
    keys = _with_known_floor(keys, places)
    cuts = _cuts_that_agree(keys, regions, witness, each)
    things = standing_things(cuts, keys, witness, each)
    cuts = [[cut & ~gone for cut in own] for own, gone in zip(cuts, things, strict=True)]
    free = _free_of_people(cuts, witness)
    floor = Floor(places, [key.pictures for key in keys], free)
    wanted = [(c, camera) for c, camera in enumerate(rig) if camera.name in names]
    learnt = each(lambda pair: background_of_recording(clip_of(session, pair[1]), cuts[pair[0]]), wanted)
    # What a camera shows while nobody is there stands there, as furniture does on the floor that others see behind it.
    return {
        camera.name: with_floor(
            background, *floor.behind(c), regions[c] & ~things[c] & ~np.any(free[c], axis=0)
        )
        for (c, camera), background in zip(wanted, learnt, strict=True)
    }


def _with_known_floor(keys: Sequence[KeyPictures], places: FloorPlaces) -> list[KeyPictures]:
    """Key pictures that know the floor on which people walk all the time: where others show its colour, too."""
    floor = Floor(places, [key.usual[None] for key in keys], [[np.ones_like(key.is_quiet)] for key in keys])
    return [with_quiet_floor(key, *floor.behind(c)) for c, key in enumerate(keys)]


def _cuts_that_agree(
    keys: Sequence[KeyPictures], regions: Sequence[Mask], witness: Witness, each: Callable[..., Iterable[Any]]
) -> list[list[Mask]]:
    """The persons in each key picture of each camera, once every camera has heard what the others see."""
    cuts: list[list[Mask]] = list(each(first_cuts, keys, regions))
    bare: list[list[Mask]] = list(each(bare_in, keys, cuts))
    for k in range(len(cuts[0])):
        pictures, room = [key.pictures[k] for key in keys], [own[k] for own in bare]
        for _ in range(_N_PASSES):
            again = each(_cut_again, pictures, witness.corrected([cut[k] for cut in cuts], room))
            for cut, better in zip(cuts, again, strict=True):
                cut[k] = better
    return cuts


def standing_things(
    cuts: Sequence[Sequence[Mask]],
    keys: Sequence[KeyPictures],
    witness: Witness,
    each: Callable[..., Iterable[Any]] = map,
) -> list[Mask]:
    """What stands still in all cuts of each camera, (H, W) bool: furniture that somebody walks round, or sits on.

    cuts : (H, W) bool per camera and key picture.  each : `map`, perhaps over threads.
    """
    always: list[Mask] = [np.logical_and.reduce(list(own)) for own in cuts]
    if not any(mask.any() for mask in always):
        return always
    stirring: list[NDArray[np.float32]] = list(each(stirring_of, keys))
    things: list[Mask] = list(each(things_in, always, stirring))
    # Whoever stays does so before enough cameras: what fewer have in all cuts needs no edges of its own.
    still = list(each(still_pieces_in, always, stirring))
    staying = _within(still, witness.in_some(always, _MUST_AGREE), _A_SAY)
    things = [found | more for found, more in zip(things, _beside(still, staying), strict=True)]
    held: list[Mask] = list(each(held_things_in, always, stirring))
    if not any(found.any() for found in (*things, *held)):
        return things
    changing = _changing_themselves(always, keys, witness, each)
    things = _without(things, changing, _OWN_CHANGE)
    things = _without(things, witness.agreed(_beside(always, things)), _A_SAY)
    things = _nobody_floats(things, cuts, witness, hands_only=True)
    held = _without(held, changing, _SEAT)
    # What goes from some cameras may have been what others agreed with.
    agreed = _agreed(_nobody_floats(_agreed(held, witness), cuts, witness, hands_only=False), witness)
    things = [found | more for found, more in zip(things, agreed, strict=True)]
    nobodys = _nobodys(_beside(held, things), things, always, cuts, witness)
    things = [found | more for found, more in zip(things, nobodys, strict=True)]
    # Somebody who is always before a thing, or behind it, is one piece with it in one camera: two others say where the
    # thing is, and nearly all where he is.
    rest = _beside(always, things)
    thing, person = witness.in_some(things, _MUST_AGREE - 1), witness.agreed(rest)
    alone = [own & a & ~b for own, a, b in zip(rest, thing, person, strict=True)]
    return [found | more for found, more in zip(things, each(still_pieces_in, alone, stirring), strict=True)]


def _beside(masks: Sequence[Mask], others: Sequence[Mask]) -> list[Mask]:
    return [mask & ~other for mask, other in zip(masks, others, strict=True)]


def _without(things: Sequence[Mask], persons: Sequence[Mask], least: float) -> list[Mask]:
    """The things of each camera but for pieces of which a share belongs to a person."""
    return _beside(things, _within(things, persons, least))


def _within(things: Sequence[Mask], others: Sequence[Mask], least: float) -> list[Mask]:
    """Those pieces of the things of each camera of which a share belongs to the others'."""
    return [pieces_within(own, other, least) for own, other in zip(things, others, strict=True)]


def _agreed(things: Sequence[Mask], witness: Witness) -> list[Mask]:
    """Those pieces of the things of each camera that enough of these have in one place."""
    return _within(things, witness.in_some(things, _MUST_AGREE), _A_SAY)


def _nobodys(
    pieces: Sequence[Mask],
    things: Sequence[Mask],
    always: Sequence[Mask],
    cuts: Sequence[Sequence[Mask]],
    witness: Witness,
) -> list[Mask]:
    """What of the pieces of each camera is no part of somebody for nearly all, where most of a piece is not.

    Each camera may have taken another part of a table for one with somebody, so that no three have a thing in one
    place.  always : what is in all cuts of each camera.
    """
    if not any(piece.any() for piece in pieces):
        return list(pieces)
    persons = witness.agreed(always)
    nobodys = _beside(_without(pieces, persons, _A_SAY), persons)
    left = [[cut & ~gone for cut in own] for own, gone in zip(cuts, things, strict=True)]
    return _nobody_floats(nobodys, left, witness, hands_only=False)


def _nobody_floats(
    things: Sequence[Mask], cuts: Sequence[Sequence[Mask]], witness: Witness, *, hands_only: bool
) -> list[Mask]:
    """The things of each camera but for bodies of persons, who mostly hang in the air without them.

    Who sits on a thing, or walks round it, has his feet on the floor.  hands_only : as of Witness.carrying.
    """
    if not any(found.any() for found in things):
        return list(things)
    instants = list(zip(*cuts, strict=True))
    votes = [np.zeros(found.shape, dtype=np.int64) for found in things]
    for instant in instants:
        bodies = _within(things, witness.carrying(instant, things, hands_only=hands_only), _A_SAY)
        votes = [own + more for own, more in zip(votes, bodies, strict=True)]
    return [found & (2 * own <= len(instants)) for found, own in zip(things, votes, strict=True)]


def _changing_themselves(
    always: Sequence[Mask],
    keys: Sequence[KeyPictures],
    witness: Witness,
    each: Callable[..., Iterable[Any]],
) -> list[Mask]:
    """Where each camera shows what looks different in it and in nearly all others at once, (H, W) bool: whoever passes
    before a thing hides it from one or two."""
    changes = list(each(changes_in, always, keys))
    at_once = zip(*(witness.agreed(instant) for instant in zip(*changes, strict=True)), strict=True)
    return [
        np.logical_or.reduce([seen & mask for seen, mask in zip(others, own, strict=True)])
        for others, own in zip(at_once, changes, strict=True)
    ]


def _cut_again(picture: Image, guess: Guess) -> Mask:
    # More than one look at the colours takes twice the time, and cuts are no better (decision 83).
    return refine_mask(picture, *guess, n_looks=1)


def _free_of_people(cuts: list[list[Mask]], witness: Witness) -> list[list[Mask]]:
    """Where each camera's pictures show nobody, nor what nobody's feet stand on, which cuts may lack."""
    under = zip(*(witness.columns(instant) for instant in zip(*cuts, strict=True)), strict=True)
    return [
        [off_rim(cut | column) for cut, column in zip(own, columns, strict=True)]
        for own, columns in zip(cuts, under, strict=True)
    ]


def _check_frames(camera: Camera, session: Session) -> None:
    if len(session.frames) < _LEAST_FRAMES:
        raise MocapError(
            f"no background to learn from: {len(session.frames)} frame(s) and no background/ folder",
            camera=camera.name,
            path=session.root,
            remedy="add pictures of the empty scene as background/CAMERA.png, or masks/CAMERA/*.png",
        )
