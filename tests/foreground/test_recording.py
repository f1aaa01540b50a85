"""A recording without an empty clip: who stays in place is found, and what he uncovers is learnt."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mocap.foreground import (
    KeyPictures,
    Segmenter,
    background_of_recording,
    bare_in,
    changes_in,
    first_cuts,
    held_things_in,
    key_pictures,
    median_background,
    pieces_within,
    still_pieces_in,
    stirring_of,
    things_in,
    with_floor,
    with_quiet_floor,
)
from mocap.foreground.recording import keys_of

H, W, N = 96, 136, 40
NOISE = 1.5


def recording(noise: float = NOISE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The empty wall, N pictures of somebody who sways by two pixels and waves, and his silhouettes."""
    rng = np.random.default_rng(11)
    wall = cv2.resize(rng.uniform(100, 130, (5, 7, 3)), (W, H), interpolation=cv2.INTER_CUBIC)
    cloth = cv2.resize(rng.uniform(40, 90, (H // 3, W // 3, 3)), (W, H), interpolation=cv2.INTER_LINEAR)
    pictures, silhouettes = [], []
    for i in range(N):
        sway = 2.0 * np.sin(0.4 * i)
        mask = np.zeros((H, W), np.uint8)
        centre = (round(64 + sway), 52)
        cv2.ellipse(mask, centre, (13, 32), 0, 0, 360, 1, -1)
        arm = np.deg2rad(-80 + 60 * np.sin(0.3 * i))
        hand = (round(centre[0] + 34 * np.cos(arm)), round(40 + 34 * np.sin(arm)))
        cv2.line(mask, (centre[0], 40), hand, 1, 7)
        moved = np.roll(cloth, round(sway), axis=1)
        picture = np.where(mask[:, :, None] > 0, moved, wall) + rng.normal(0, noise, (H, W, 3))
        pictures.append(np.clip(picture, 0, 255).astype(np.uint8))
        silhouettes.append(mask > 0)
    return wall, np.array(pictures), np.array(silhouettes)


def keys_in(silhouettes: np.ndarray) -> np.ndarray:
    """The silhouettes of the key pictures: every second of 40 pictures is a sample."""
    samples = silhouettes[::2]
    return samples[keys_of(len(samples))]


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


def test_where_somebody_is_it_is_not_quiet() -> None:
    _, pictures, silhouettes = recording()
    keys = key_pictures(pictures)
    somewhere, always = silhouettes.any(axis=0), silhouettes.all(axis=0)
    assert keys.is_active[somewhere].mean() > 0.97
    assert (
        keys.is_active[~cv2.dilate(somewhere.astype(np.uint8), np.ones((15, 15))).astype(bool)].mean() < 0.01
    )
    assert not keys.is_quiet[cv2.erode(always.astype(np.uint8), np.ones((5, 5))) > 0].any()
    assert len(keys.pictures) == len(keys_in(silhouettes))


def test_where_it_shows_the_floor_that_others_know_it_is_quiet() -> None:
    keys = key_pictures(recording()[1])
    restless = replace(keys, is_quiet=np.zeros_like(keys.is_quiet))
    colour = cv2.blur(keys.usual, (3, 3)).astype(np.float32) + np.array([0.0, -12.0, 8.0], dtype=np.float32)
    colour[:, 68:] += 10.0  # another thing than the floor
    limit = np.full((H, W), 15.0, dtype=np.float32)
    limit[:60] = -1.0  # there the floor ends
    expected = np.zeros((H, W), dtype=np.bool_)
    expected[60:, :68] = True
    np.testing.assert_array_equal(with_quiet_floor(restless, colour, limit).is_quiet, expected)
    quiet = with_quiet_floor(keys, colour, limit).is_quiet
    np.testing.assert_array_equal(quiet, keys.is_quiet | expected)


def test_he_is_cut_out_of_the_key_pictures() -> None:
    _, pictures, silhouettes = recording()
    region = cv2.dilate(silhouettes.any(axis=0).astype(np.uint8), np.ones((9, 9))) > 0
    cuts = first_cuts(key_pictures(pictures), region)
    for cut, truth in zip(cuts, keys_in(silhouettes), strict=True):
        assert iou(cut, truth) > 0.85  # cut at half the size: an outline of 230 pixels about 2,900


def test_a_shirt_of_the_floors_colour_is_cut_out_before_the_wall() -> None:
    """In colours alone he is floor, of which the picture is full."""
    rng = np.random.default_rng(12)
    _, _, silhouettes = recording()
    planks, room = np.array([150.0, 115.0, 75.0]), np.empty((H, W, 3))
    room[:60], room[60:] = (150, 155, 160), planks
    room += cv2.resize(rng.uniform(-14, 14, (H // 4, W // 4)), (W, H), interpolation=cv2.INTER_NEAREST)[
        ..., None
    ]
    cloth = planks + cv2.resize(rng.uniform(-14, 14, (H // 4, W // 4)), (W, H))[..., None]
    pictures = [
        np.where(mask[..., None], np.roll(cloth, round(2 * np.sin(0.4 * i)), axis=1), room)
        + rng.normal(0, NOISE, (H, W, 3))
        for i, mask in enumerate(silhouettes)
    ]
    region = cv2.dilate(silhouettes.any(axis=0).astype(np.uint8), np.ones((9, 9))) > 0
    cuts = first_cuts(key_pictures(np.clip(pictures, 0, 255).astype(np.uint8)), region)
    for cut, truth in zip(cuts, keys_in(silhouettes), strict=True):
        assert iou(cut[:58], truth[:58]) > 0.85


def test_the_background_behind_him_is_learnt_as_far_as_it_was_seen() -> None:
    wall, pictures, silhouettes = recording()
    background = background_of_recording(pictures, list(keys_in(silhouettes)))
    assert background.kind == "recording"
    assert background.covered is not None
    assert background.holds_somebody
    np.testing.assert_array_equal(background.covered, keys_in(silhouettes).all(axis=0))
    off = np.abs(background.mean + 0.5 - wall).max(axis=2)
    assert off[~background.covered].max() < 5 * NOISE
    segmenter, lost = Segmenter(background), Segmenter(median_background(pictures))
    for picture, truth in zip(pictures, silhouettes, strict=True):
        assert iou(segmenter.segment(picture).mask, truth) > 0.9
        assert iou(lost.segment(picture).mask, truth) < 0.6


def test_changes_of_the_light_as_a_whole_are_no_unrest() -> None:
    _, pictures, silhouettes = recording()
    flicker = 1 + 0.1 * np.sin(np.arange(N))
    lit = np.clip(pictures * flicker[:, None, None, None], 0, 255).astype(np.uint8)
    away = ~cv2.dilate(silhouettes.any(axis=0).astype(np.uint8), np.ones((15, 15))).astype(bool)
    assert key_pictures(lit).is_active[away].mean() < 0.01


def test_what_is_behind_somebody_is_known_where_others_leave_it_free() -> None:
    """A man at one of three places in turn, who is missing in one cut; a lamp goes on above him in the last one."""
    wall = np.full((H, W, 3), 120, np.uint8)
    pictures, men = np.repeat(wall[None], 12, axis=0), np.zeros((12, H, W), np.bool_)
    for k in range(12):
        left = 20 + 30 * (k % 3)
        men[k, 20:90, left : left + 20] = True
    men[:, 20:90, 115:125] = True  # somebody else never goes
    pictures[men] = 60
    pictures[11, :20] = 160
    cuts = list(men.copy())
    cuts[0][:] = False
    keys = KeyPictures(pictures, wall, ~men.any(axis=0), men.any(axis=0))
    ever = men.any(axis=0)
    for k, (own, man) in enumerate(zip(bare_in(keys, cuts), men, strict=True)):
        near = cv2.dilate((man | men.all(axis=0)).astype(np.uint8), np.ones((7, 7))) > 0
        below = np.arange(H)[:, None] > 21  # the lamp, with its blurred rim
        assert own[ever & ~near & (below | (k < 11))].all()
        assert not own[man & below].any()  # in the first picture, too, whose cut lacks him
        assert not own[:17].any()  # where nobody ever was in a cut nothing is told


@pytest.mark.parametrize(("n_free", "is_told"), [(2, False), (3, True), (11, True), (12, False)])
def test_a_place_is_known_that_some_cuts_cover_and_some_leave_free(n_free: int, is_told: bool) -> None:
    wall = np.full((H, W, 3), 120, np.uint8)
    keys = KeyPictures(np.repeat(wall[None], 12, axis=0), wall, wall[..., 0] > 0, wall[..., 0] > 0)
    cuts = [np.full((H, W), k >= n_free) for k in range(12)]
    assert bare_in(keys, cuts)[0].all() == is_told
    assert bare_in(keys, cuts)[0].any() == is_told


def test_every_key_picture_needs_its_cut() -> None:
    _, pictures, silhouettes = recording()
    with pytest.raises(ValueError, match="cuts"):
        background_of_recording(pictures, list(keys_in(silhouettes))[1:])


def test_shoes_that_every_cut_lacks_are_seen_before_the_floor_that_others_tell() -> None:
    wall, pictures, silhouettes = recording()
    feet = np.zeros((H, W), dtype=np.bool_)
    feet[76:83, 56:72] = True  # the lowest of the ellipse and a shoe beside it
    shown = pictures.copy()
    shown[:, feet] = (90, 140, 100)
    lacking = [mask & ~feet for mask in keys_in(silhouettes)]
    background = background_of_recording(shown, lacking)
    region = cv2.dilate((silhouettes.any(axis=0) | feet).astype(np.uint8), np.ones((9, 9))) > 0
    limit = np.full((H, W), 15.0, dtype=np.float32)
    limit[:60] = -1.0  # there the floor ends
    floor = with_floor(background, wall.astype(np.float32), limit, region)
    inside = cv2.erode(feet.astype(np.uint8), np.ones((3, 3))) > 0
    assert Segmenter(background).segment(shown[7]).mask[inside].mean() < 0.1
    assert Segmenter(floor).segment(shown[7]).mask[inside].mean() > 0.95
    assert floor.covered is not None
    assert background.covered is not None
    assert not floor.covered[feet].any()
    assert floor.told_share == pytest.approx((background.covered & ~floor.covered).mean())
    assert floor.holds_somebody  # as before: its outlines judge no calibration
    np.testing.assert_array_equal(floor.covered[:50], background.covered[:50])
    np.testing.assert_array_equal(floor.mean[:50], background.mean[:50])
    np.testing.assert_array_equal(floor.mean[~region], background.mean[~region])


@pytest.mark.parametrize(("shade", "noise"), [(0.0, NOISE), (0.2, NOISE), (0.0, 12.0), (0.2, 12.0)])
def test_what_is_in_all_cuts_and_stands_still_is_a_thing(shade: float, noise: float) -> None:
    """Somebody in plain clothes who sways stays in the cuts; a table goes, in the shade of who walks by as well."""
    rng = np.random.default_rng(3)
    _, pictures, silhouettes = recording(noise)
    table = np.zeros((H, W), dtype=np.bool_)
    table[60:80, 94:130] = True
    wood = cv2.resize(rng.uniform(60, 110, (4, 8, 3)), (36, 20), interpolation=cv2.INTER_NEAREST)
    falls = np.linspace(0.2, 1, 36)[None, :, None]  # one end lies deeper in it
    for i, picture in enumerate(pictures):
        shaded = wood * (1 - shade * falls * (1 + np.sin(0.7 * i)) / 2)
        picture[60:80, 94:130] = np.clip(shaded + rng.normal(0, noise, wood.shape), 0, 255)
        if i % 6 < 2:  # he hides a part of it himself, another one every time
            picture[60:80, 94 + i // 2 : 104 + i // 2] = 200
        shirt = cv2.erode(silhouettes[i].astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        picture[shirt] = np.clip(65 + rng.normal(0, noise, (np.count_nonzero(shirt), 3)), 0, 255)
    keys = key_pictures(pictures)
    person = silhouettes.all(axis=0)
    np.testing.assert_array_equal(things_in(person | table, stirring_of(keys)), table)


@pytest.mark.parametrize(("rows_moving", "is_thing"), [(0, True), (2, True), (8, False), (60, False)])
def test_who_keeps_still_within_outlines_that_move_is_no_thing(rows_moving: int, is_thing: bool) -> None:
    """Trunk and legs of who raises a hand stir as little as a table, before one end of which somebody passes."""
    trunk = np.zeros((H, W), dtype=np.bool_)
    trunk[20:80, 50:80] = True
    beside = (cv2.dilate(trunk.astype(np.uint8), np.ones((13, 13))) > 0) & ~trunk
    beside[20 + rows_moving :] = False
    stirring = np.where(trunk, np.float32(3), np.where(beside, np.float32(7), np.float32(1)))
    np.testing.assert_array_equal(still_pieces_in(trunk, stirring), trunk)
    np.testing.assert_array_equal(things_in(trunk, stirring), trunk & is_thing)
    assert not still_pieces_in(trunk, stirring + 3).any()
    assert not things_in(trunk, stirring + 3).any()


@pytest.mark.parametrize(
    ("rows", "columns", "is_thing"),
    [((35, 65), (58, 72), True), ((25, 48), (50, 62), False), ((25, 30), (50, 62), True)],
)
def test_along_the_outline_of_a_thing_nothing_stirs(
    rows: tuple[int, int], columns: tuple[int, int], is_thing: bool
) -> None:
    """Somebody passes again and again before the middle of a table, stays at one end of it, or brushes past."""
    table = np.zeros((H, W), dtype=np.bool_)
    table[20:80, 50:80] = True
    stirring = np.full((H, W), 2, dtype=np.float32)
    stirring[slice(*rows), slice(*columns)] = 9
    np.testing.assert_array_equal(things_in(table, stirring), table & is_thing)


def test_a_chair_keeps_its_edges_and_a_plain_shirt_does_not() -> None:
    """Both are one piece, and the middle of the shirt keeps as still as the chair."""
    rng = np.random.default_rng(5)
    _, pictures, silhouettes = recording()
    chair = np.zeros((H, W), dtype=np.bool_)
    chair[56:84, 70:112] = True
    shoe = np.zeros_like(chair)
    shoe[86:94, 104:118] = True
    for picture, silhouette in zip(pictures, silhouettes, strict=True):
        for grey, place in ((80, chair & ~silhouette), (60, silhouette)):
            picture[place] = np.clip(grey + rng.normal(0, NOISE, (np.count_nonzero(place), 3)), 0, 255)
    stirring = stirring_of(key_pictures(pictures))
    person = silhouettes.all(axis=0)
    assert np.count_nonzero(stirring[person] < 2) > 400
    assert cv2.connectedComponents((person | chair).astype(np.uint8))[0] == 2
    ever = cv2.dilate(silhouettes.any(axis=0).astype(np.uint8), np.ones((3, 3))) > 0
    held = held_things_in(person | chair | shoe, stirring)
    assert held[chair & ~ever].mean() > 0.9
    assert not held[(person | shoe) & ~chair].any()
    # Where something moves all round it nothing says that its edges are its own.
    beside = cv2.dilate(chair.astype(np.uint8), np.ones((9, 9))) > 0
    moving = np.where(beside & ~chair, np.float32(4), stirring)
    assert not held_things_in(person | chair, moving).any()


@pytest.mark.parametrize("covered", [False, True])
def test_where_nobody_stays_or_nothing_is_beside_him_is_no_thing(covered: bool) -> None:
    """What fills a picture from border to border has no outline."""
    always = np.full((H, W), covered)
    assert not things_in(always, stirring_of(key_pictures(recording()[1]))).any()


def test_changes_are_other_colours_and_no_shade() -> None:
    usual = np.full((H, W, 3), (120, 90, 60), dtype=np.uint8)
    always = np.zeros((H, W), dtype=np.bool_)
    always[20:80, 20:120] = True
    other, shade, light, dark = (np.zeros((H, W), dtype=np.bool_) for _ in range(4))
    other[30:50, 30:50], shade[30:50, 60:80], light[30:50, 90:110], dark[55:75, 60:80] = [True] * 4
    outside = ~always
    picture = usual.copy()
    picture[other | outside] = (60, 90, 120)
    picture[shade], picture[light] = (72, 54, 36), (180, 135, 90)
    picture[dark] = (42, 32, 21)  # too dark for a shade
    keys = KeyPictures(np.stack([usual, picture]), usual, always, always)
    nothing, changed = changes_in(always, keys)
    assert not nothing.any()
    told = (other | light | dark).astype(np.uint8)
    inside = cv2.erode(told, np.ones((3, 3))) > 0
    around = (cv2.dilate(told, np.ones((3, 3))) > 0) | (
        cv2.dilate(outside.astype(np.uint8), np.ones((3, 3))) > 0
    )
    assert changed[inside].all()
    assert not (changed & ~around).any()
    assert not (changed & outside).any()


def test_a_piece_is_taken_whole_by_its_share_in_a_region() -> None:
    mask, region = np.zeros((H, W), dtype=np.bool_), np.zeros((H, W), dtype=np.bool_)
    mask[10:20, 10:20], mask[10:20, 40:50] = True, True
    region[:, 18:46] = True  # a fifth of one piece, six tenths of the other
    second = mask & (np.arange(W) >= 30)
    np.testing.assert_array_equal(pieces_within(mask, region, 0.61), np.zeros_like(mask))
    np.testing.assert_array_equal(pieces_within(mask, region, 0.6), second)
    np.testing.assert_array_equal(pieces_within(mask, region, 0.2), mask)
