"""Background of a recording without an empty clip, where persons may stay in place all the time.

What stands still by itself is quiet; a person never is: he sways, limbs move, cloth folds. So a picture of how
unrestful each pixel is over the clip shows everybody who was there, and other cameras tell him from shadows. In a few
key pictures he is cut out; what no cut has covered is the background there, and what all have covered is always him.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Image, Mask, largest_channel
from mocap.foreground import _kernels
from mocap.foreground.model import (
    STD_FLOOR,
    Background,
    are_grey,
    are_noisy,
    calmed,
    statistics_of,
    thinned,
)
from mocap.foreground.refine import refine_mask

KEY_PICTURES = 12  # each takes 0.1 s per camera; what is free in one of them is learnt
WORKING_WIDTH_PX = 640  # larger pictures are cut reduced; their background is learnt in full
# Spread over the clip relative to noise. In the scenes gesture, box and stand 95 % of what a person always covers has
# more than 1.3 to 3, nine tenths of the room less than 1.7, shadows up to 7.
_UNREST = 2.0
_QUIET = 1.6
_LEAST_NOISE = 0.2  # levels: pictures that are drawn have none
# What is in all cuts of a camera: a tenth of its pixels are so many times the noise off their usual colour, once the
# shade that falls on them is divided out. Persons who stay in their places have 5.9 and more, most 7 to 12 (dev:reach,
# stand, in_place, gesture), furniture round which one to three walk 1.8 to 5.2 and one piece 5.7 (dev:furnished,
# dev:room; decision 88).
_LEAST_STIR = 5.5
# Levels, the most of these recordings: who stays stirs by 5 to 9, furniture by 2 to 3, in noise as well (decision 126).
_USUAL_NOISE = 1.0
_STIRS = 0.9  # of what must stir: a shirt is plain, outlines and folds move
_SHADE_PX = 11  # side of the square in which shade has one strength
# Chairs, tables and cabinets beside people stir less than this, and so do middles of plain clothes; but of their edges
# 0.35 to all lie beside what keeps still as well, of plain clothes' less (decision 96).
_STILL = 3.5  # times the noise
_CALM = 2.5  # times the noise: the room beside a thing
_EDGE_PX = 3  # between a thing and the room beside it, where blur and compression mix colours
_HELD = 0.35  # of the edges
# A tenth of the outline of what is in all cuts of a camera, and so many times the noise. In 34 recordings 172 pieces of
# which more than a twentieth is a person have 5.4 and more, and two (shanks, which stand still) less; of 70 pieces of
# furniture 55 have less (decision 128).
_OUTLINE_STIRS = 5.0
_ALL_HELD = 0.8  # of the edges of a whole piece; 51 of those 55 have more, and the shanks
_LEAST_HELD_PX = 150  # of a picture of the working size: shoes have less
_FAR = 20  # levels from the usual colour that count as "something else was here"
_SHADE_OFF = 8  # levels from a darker usual colour: more is no shade
_DARKEST = 0.5  # of the usual colour: what is darker is no shade
_MIDDLE, _CONTRAST = 128, 0.7  # of a picture of differences: nearly all fit into its levels
# Levels from what is quiet or painted in that make a pixel likely to show a person in the first cut.
_DIFFERS = 15
_LEAST_BARE = 3  # first cuts that leave a pixel free tell what is behind persons there
# Levels from that within which a pixel is bare: of the quiet pixels of a real room, compressed, 95 % keep within 4 of
# their usual colour and 99 % within 6 (decision 102).
_SAME = 6
_MOST_HOLE_PX = 6000  # of 640 x 480: a hole in what moves that may still be inside a person
_RIM_PX = 2  # blur and compression mix colours so far beside a person
_FLOOR_STD = 0.2  # of what makes a difference from a floor that others see
_LEAST_STD = 4.0  # times the usual spread that a background pixel may have at most


@dataclass(frozen=True, eq=False)
class KeyPictures:
    """What one camera's clip shows, reduced to the working size (h, w).

    pictures : (K, h, w, 3) uint8, evenly spread, changes of the light as a whole divided out.
    usual : (h, w, 3) uint8, the most persistent colour.  is_quiet : (h, w) bool, where that is what stands still.
    is_active : (h, w) bool, where something that moves was at some time: persons and their shadows.
    """

    pictures: NDArray[np.uint8]
    usual: Image
    is_quiet: Mask
    is_active: Mask


def reduction_of(width: int) -> int:
    """The whole number by which pictures of a width are reduced to the working size."""
    return max(1, round(width / WORKING_WIDTH_PX))


def key_pictures(images: Iterable[Image]) -> KeyPictures:
    """Key pictures of a clip, and where it is quiet and where not.

    images, errors : as of learn_background.
    """
    samples = thinned(images)
    factor = reduction_of(samples[0].shape[1])
    stack = np.stack([_reduced(image, factor) for image in _same_light(samples)])
    soft = np.stack([cv2.blur(image, (3, 3)) for image in stack])
    usual, spread, moved = statistics_of(soft, _FAR)
    within = largest_channel(spread)
    noise = max(float(np.median(within)), _LEAST_NOISE)
    total = largest_channel(soft.std(axis=0, dtype=np.float32))
    sway = cv2.blur(within / noise, (5, 5))
    unrest = cv2.blur(total / noise, (5, 5)) > _UNREST
    active = cv2.morphologyEx(unrest.astype(np.uint8), cv2.MORPH_OPEN, _disc(1))
    active = cv2.morphologyEx(active, cv2.MORPH_CLOSE, _disc(5))
    is_active = _without_holes(active > 0, _MOST_HOLE_PX * active.size / (640 * 480))
    near = np.mean([(np.abs(image - usual) < _FAR).all(axis=2) for image in soft], axis=0)
    # Somebody who stands can be quiet inside his outline; there nothing else was ever seen.
    quiet = (sway < _QUIET) & (near >= 0.5) & (~is_active | moved.any(axis=2))
    quiet = cv2.morphologyEx(quiet.astype(np.uint8), cv2.MORPH_OPEN, _disc(3)) > 0
    return KeyPictures(
        stack[keys_of(len(stack))],
        np.clip(np.round(usual), 0, 255).astype(np.uint8),
        quiet,
        is_active,
    )


def keys_of(n_samples: int) -> NDArray[np.int64]:
    """Which of the samples of a clip are its key pictures, (K,) ascending."""
    return np.unique(np.linspace(0, n_samples - 1, KEY_PICTURES).round().astype(np.int64))


def with_quiet_floor(
    keys: KeyPictures, colour: NDArray[np.float32], limit: NDArray[np.float32]
) -> KeyPictures:
    """Key pictures that are quiet as well where their usual colour is that of the floor which other cameras see there.

    Shade and shoes of people who walk on it leave it no more at rest than somebody who sways.
    colour, limit : (h, w, 3) and (h, w) grey levels, as of with_floor.
    """
    off = largest_channel(np.abs(cv2.blur(keys.usual, (3, 3)) - colour))
    return replace(keys, is_quiet=keys.is_quiet | ((limit >= 0) & (off < _DIFFERS)))


def first_cuts(keys: KeyPictures, region: Mask) -> list[Mask]:
    """The persons in each key picture, (h, w) bool, from one camera alone: often right, now and then far off.

    region : (h, w) bool, where persons can be; outside is background.
    """
    unknown = region & ~keys.is_quiet
    empty = cv2.inpaint(keys.usual, unknown.astype(np.uint8), 5, cv2.INPAINT_TELEA)
    cuts = []
    for picture in keys.pictures:
        differs = largest_channel(cv2.absdiff(picture, empty)) > _DIFFERS
        likely = region & keys.is_active & differs
        # A shirt of the floor's colour is told where it hides a wall, by how it differs from what is painted in there.
        unlike = np.clip(_MIDDLE + _CONTRAST * (picture.astype(np.float32) - empty), 0, 255).astype(np.uint8)
        cuts.append(refine_mask(picture, region, likely) | refine_mask(unlike, region, likely))
    return cuts


def bare_in(keys: KeyPictures, cuts: Sequence[Mask]) -> list[Mask]:
    """Where each key picture shows what is behind persons, as others of the camera show it too, (K) times (h, w) bool.

    cuts : (h, w) bool, the persons in each key picture. What none of them covers is not told: legs that never move are
    in none, either.
    """
    soft = np.stack([cv2.blur(picture, (3, 3)) for picture in keys.pictures])
    cover = np.stack([1 + 2 * cv2.dilate(cut.astype(np.uint8), _disc(_RIM_PX)) for cut in cuts])
    mean, _, n_free = _free_statistics(soft, cover)
    is_known = (n_free >= _LEAST_BARE) & (n_free < len(soft))
    return [is_known & (largest_channel(np.abs(picture - mean)) < _SAME) for picture in soft]


def background_of_recording(images: Iterable[Image], cuts: Sequence[Mask]) -> Background:
    """Background of a clip whose key pictures are cut.

    images : the clip that gave the key pictures.  cuts : (h, w) bool, the persons in each.
    A pixel that a cut leaves free takes the middle of these key pictures and the statistics of all samples near it;
    what is covered in all of them is `covered`, its colour painted in from around.
    Raises ValueError for another number of cuts than of key pictures.
    """
    samples = thinned(images)
    keys = keys_of(len(samples))
    if len(cuts) != len(keys):
        raise ValueError(f"cuts: expected {len(keys)}, one per key picture, got {len(cuts)}")
    height, width = samples[0].shape[:2]
    cover = np.zeros((len(samples), height, width), dtype=np.uint8)
    for k, cut in zip(keys, cuts, strict=True):
        own = cv2.resize(cut.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
        cover[k] = 1 + own + cv2.dilate(own, _disc(_RIM_PX * reduction_of(width)))
    stack = np.stack(_same_light(samples))
    mean, std, n_free = _free_statistics(stack, cover)
    if is_noisy := are_noisy(std):
        mean, std, n_free = _free_statistics(np.stack([calmed(image) for image in stack]), cover)
    covered = n_free == 0
    shown = np.clip(np.round(mean), 0, 255).astype(np.uint8)
    painted = cv2.inpaint(shown, covered.astype(np.uint8), 3, cv2.INPAINT_TELEA)
    mean[covered] = painted[covered]
    usual = max(float(np.median(std)), STD_FLOOR)
    std[covered] = usual
    np.clip(std, usual, _LEAST_STD * usual, out=std)
    moving = float((cover > 1).any(axis=0).mean())
    return Background(
        mean, std, len(samples), "recording", moving, covered, is_grey=are_grey(samples), is_noisy=is_noisy
    )


def _free_statistics(
    stack: NDArray[np.uint8], cover: NDArray[np.uint8]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Mean and spread (h, w, 3) of pictures (N, h, w, 3) where they are free, and in how many, (h, w).

    cover : (N, h, w), as of `_kernels.free_statistics`.
    """
    mean = np.empty(stack.shape[1:], dtype=np.float32)
    std, n_free = np.empty_like(mean), np.empty(stack.shape[1:3], dtype=np.uint8)
    _kernels.free_statistics(
        stack.reshape(len(stack), -1, 3), cover.reshape(len(stack), -1), _FAR,
        mean.reshape(-1, 3), std.reshape(-1, 3), n_free.reshape(-1),
    )  # fmt: skip
    return mean, std, n_free


def with_floor(
    background: Background, colour: NDArray[np.float32], limit: NDArray[np.float32], region: Mask
) -> Background:
    """The background with the floor that other cameras see, where persons hide it from this one all the time.

    colour, limit : (h, w, 3) and (h, w) grey levels, of the bare floor as this camera would see it and by how much
    another thing differs from it; limit -1 where the floor is not known.  region : (h, w) bool, where persons can be.
    """
    height, width = background.mean.shape[:2]
    colour, limit = (_enlarged(part, (width, height)) for part in (colour, limit))
    is_asked = (_enlarged(region.astype(np.uint8), (width, height)) > 0) & (limit >= 0)
    differs = largest_channel(np.abs(cv2.blur(background.mean, (3, 3)) - colour)) > limit
    covered = np.zeros_like(is_asked) if background.covered is None else background.covered
    hidden = cv2.morphologyEx((is_asked & (differs | covered)).astype(np.uint8), cv2.MORPH_OPEN, _disc(1))
    hidden = (cv2.dilate(hidden, _disc(_RIM_PX * reduction_of(width))) > 0) & is_asked
    mean, std = background.mean.copy(), background.std.copy()
    mean[hidden] = colour[hidden]
    std[hidden] = np.maximum(std[hidden], _FLOOR_STD * limit[hidden, None])
    told = float((covered & hidden).mean())
    return replace(background, mean=mean, std=std, covered=covered & ~hidden, told_share=told)


def things_in(always: Mask, stirring: NDArray[np.float32]) -> Mask:
    """What stands still of the pixels that are in all cuts of a camera, (h, w) bool: a table that somebody walks round.

    A connected piece is a thing or a person. Clothes of who only raises a hand keep as still as a table, and before the
    middle of a table is often somebody else; but somewhere along his outline everybody sways, and along that of a thing
    nothing does.  stirring : (h, w) of the same camera, see `stirring_of`.
    """
    still = _pieces_below(always, _rim(always, _EDGE_PX), stirring, _OUTLINE_STIRS)
    n, labels = cv2.connectedComponents(still.astype(np.uint8), connectivity=8)
    is_thing = _held_share(still, labels, n, ~always & (stirring < _STILL)) >= _ALL_HELD
    return np.asarray(is_thing[labels]) & still


def still_pieces_in(mask: Mask, stirring: NDArray[np.float32]) -> Mask:
    """The connected pieces of a mask that keep still, (h, w) bool.  stirring : as of things_in."""
    return _pieces_below(mask, mask, stirring, _LEAST_STIR)


def _pieces_below(mask: Mask, asked: Mask, stirring: NDArray[np.float32], limit: float) -> Mask:
    """The connected pieces of a mask of which nine tenths of what is asked stir less; none where nothing is."""
    n, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    parts = [stirring[asked & (labels == i)] for i in range(1, n)]
    is_still = [False] + [part.size > 0 and bool(np.quantile(part, _STIRS) < limit) for part in parts]
    return np.asarray(np.array(is_still)[labels])


def held_things_in(always: Mask, stirring: NDArray[np.float32]) -> Mask:
    """What stands still within edges that stand still, of the pixels that are in all cuts of a camera, (h, w) bool.

    The middle of a plain shirt keeps still, but what is beside it moves; a chair stands against the room with all its
    edges, except where somebody sits before them.  stirring : (h, w) of the same camera, see `stirring_of`.
    """
    still = cv2.morphologyEx((always & (stirring < _STILL)).astype(np.uint8), cv2.MORPH_OPEN, _disc(1)) > 0
    n, labels = cv2.connectedComponents(still.astype(np.uint8), connectivity=4)
    is_thing = _held_share(still, labels, n, ~always & (stirring < _CALM)) >= _HELD
    is_thing &= np.bincount(labels[still], minlength=n) >= _LEAST_HELD_PX
    return np.asarray(is_thing[labels])


def _held_share(pieces: Mask, labels: NDArray[np.int32], n: int, calm: Mask) -> NDArray[np.float64]:
    """How much of the edges of each of n labelled pieces lies beside what is calm, (n,)."""
    edges = _rim(pieces, 1)
    held = edges & (cv2.dilate(calm.astype(np.uint8), _disc(_EDGE_PX)) > 0)
    n_edges, n_held = (np.bincount(labels[part], minlength=n) for part in (edges, held))
    return np.asarray(n_held / np.maximum(n_edges, 1))


def changes_in(always: Mask, keys: KeyPictures) -> list[Mask]:
    """Where each key picture shows something else than usual of what is in all cuts of a camera, (K) times (h, w) bool.

    Somebody who crouches and rises shows other parts of himself there, a table whoever is before it. Shade is nothing
    else.
    """
    usual = keys.usual.astype(np.float32) + 1
    square = (usual**2).sum(axis=2)
    changes = []
    for picture in keys.pictures:
        own = cv2.blur(picture, (3, 3)).astype(np.float32) + 1
        light = (own * usual).sum(axis=2) / square
        is_shade = (
            (light >= _DARKEST)
            & (light < 1)
            & (np.abs(own - light[..., None] * usual) < _SHADE_OFF).all(axis=2)
        )
        changes.append(always & ~is_shade & (np.abs(own - usual) >= _FAR).any(axis=2))
    return changes


def pieces_within(mask: Mask, region: Mask, least: float) -> Mask:
    """The connected pieces of a mask of which at least a share lies in a region, (h, w) bool."""
    n, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    size = np.bincount(labels.ravel(), minlength=n)
    inside = np.bincount(labels[region], minlength=n)
    is_within = inside >= least * size
    is_within[0] = False
    return np.asarray(is_within[labels])


def stirring_of(keys: KeyPictures) -> NDArray[np.float32]:
    """How far each pixel is off its usual colour, relative to the noise, (h, w), without the shade of who walks by.

    Shade darkens a place and its neighbours alike; somebody who stays moves his outlines and folds.
    """
    usual = keys.usual.astype(np.float32) + 1
    squares, n = np.zeros_like(usual), np.zeros_like(usual[..., 0])
    for picture in keys.pictures:
        off = cv2.blur(picture, (3, 3)).astype(np.float32) + 1 - usual
        near = (np.abs(off) < _FAR).all(axis=2).astype(np.float32)
        weight = np.maximum(cv2.blur(near, (_SHADE_PX, _SHADE_PX)), 1e-3)[..., None]
        shade = cv2.blur(off / usual * near[..., None], (_SHADE_PX, _SHADE_PX)) / weight
        squares += ((off - shade * usual) * near[..., None]) ** 2
        n += near
    spread = np.sqrt(largest_channel(squares) / np.maximum(n, 1))
    noise = max(float(np.median(spread)), _LEAST_NOISE)
    stirring = cv2.blur(spread / noise, (5, 5))
    if noise <= _USUAL_NOISE:
        return stirring
    # In noisy pictures nobody moves more. What the noise leaves is measured as usual.
    own = np.maximum(stirring**2 - 1, 0) * (noise / _USUAL_NOISE) ** 2
    return np.sqrt(1 + own, dtype=np.float32)


def off_rim(cut: Mask) -> Mask:
    """Where a picture of the working size shows nothing of what is cut out (h, w), not even blurred."""
    return cv2.dilate(cut.astype(np.uint8), _disc(_RIM_PX)) == 0


def _same_light(samples: Sequence[Image]) -> list[Image]:
    """Pictures whose light as a whole is that of the middle one, channel by channel."""
    middle = samples[len(samples) // 2][::16, ::16].astype(np.float32) + 1
    out = []
    for image in samples:
        gain = np.median((image[::16, ::16] + np.float32(1)) / middle, axis=(0, 1))
        plain = np.clip(np.round(image / np.clip(gain, 0.5, 2.0)), 0, 255).astype(np.uint8)
        out.append(plain if np.abs(gain - 1).max() >= 0.004 else image)
    return out


def _reduced(image: Image, factor: int) -> Image:
    height, width = image.shape[:2]
    size = (width // factor, height // factor)
    area = image[: size[1] * factor, : size[0] * factor]
    return area if factor == 1 else cv2.resize(area, size, interpolation=cv2.INTER_AREA)


def _enlarged(picture: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """A picture of the working size in full, by nearest pixels.  size : (width, height)."""
    return (
        picture
        if picture.shape[1::-1] == size
        else cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST)
    )


def _without_holes(mask: Mask, most_px: float) -> Mask:
    """The mask with holes of up to so many pixels filled; what touches the border of the picture is no hole."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~mask).astype(np.uint8), connectivity=4)
    x, y, w, h, area = stats.T
    inner = (x > 0) & (y > 0) & (x + w < mask.shape[1]) & (y + h < mask.shape[0])
    fill = inner & (area <= most_px)
    fill[0] = False
    return mask | fill[labels]


def _rim(mask: Mask, px: int) -> Mask:
    """What of a mask lies so near to its edge; the border of the picture is none."""
    return mask & ~(cv2.erode(mask.astype(np.uint8), _disc(px)) > 0)


def _disc(radius: int) -> NDArray[np.uint8]:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
