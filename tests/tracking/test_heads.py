"""People who touch when they are first seen: their heads, and one track for each of them."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from bodies import BLUE, GREEN, RED, box, confirmed, observe, person, run, settings
from marker_world import ring, spotted

from mocap.data import CameraRig, VoxelGrid
from mocap.tracking import FrameVoxels
from mocap.tracking.heads import ABOVE_M, has_shoulders, heads_of, nearest_head
from mocap.volume import Carver, connected_components, surface_voxels

# What few cameras see between people: as high as their shoulders, and wider than they are.
BETWEEN = box(0.0, 0.0, 0.6, 0.25, 0.0, 1.25)
TOUCHING = [BETWEEN, *person(-0.4, 0.0, RED), *person(0.4, 0.1, BLUE, height=1.55)]


def heads(boxes, side):
    return heads_of(observe(boxes, side=side).centers, side)[:, :2]


@pytest.mark.parametrize("side", [0.02, 0.05])
def test_heads_rise_from_what_is_between_people(side):
    np.testing.assert_allclose(heads(TOUCHING, side), [(-0.4, 0.0), (0.4, 0.1)], atol=side)
    three = [*TOUCHING, *person(0.0, -0.4, GREEN, height=1.9)]
    np.testing.assert_allclose(heads(three, side), [(0.0, -0.4), (-0.4, 0.0), (0.4, 0.1)], atol=side)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        (box(0.3, 0.0, 0.05, 0.05, 1.0, 1.9), "a raised arm is too thin"),
        (box(0.35, 0.0, 0.15, 0.15, 0.0, 0.9), "a seat is too low"),
        (box(0.3, 0.0, 0.15, 0.2, 1.2, 1.58), "what one comes down to by less than 15 cm is the same head"),
    ],
)
def test_one_person_has_one_head(more, why):
    assert len(heads([*person(0.0, 0.0), box(0.15, 0.0, 0.35, 0.2, 0.3, 0.5), more], 0.02)) == 1, why


def test_each_of_those_who_touch_is_a_person_from_the_first_frame():
    s = settings()
    infos, _ = run([TOUCHING] * 4, s)
    assert [t.person for t in infos[0].tracks] == [1, 2]
    assert confirmed(infos[-1]) == [1, 2]
    for info in infos:
        places = sorted(float(t.xyz[0]) for t in info.tracks)
        np.testing.assert_allclose(places, (-0.4, 0.4), atol=0.1)
        assert not np.intersect1d(*info.voxels_of.values()).size
        assert info.n_unassigned == 0


def test_two_who_hold_hands_far_apart_are_two():
    """No single person is so wide."""
    hands = box(0.0, 0.0, 1.4, 0.05, 1.0, 1.1)
    infos, _ = run([[*person(-1.3, 0.0, RED), hands, *person(1.3, 0.0, BLUE)]] * 4, settings())
    assert confirmed(infos[-1]) == [1, 2]


def test_as_published_they_are_nobody():
    infos, _ = run([TOUCHING] * 4, settings(whole_components=False))
    assert not infos[-1].tracks


@pytest.mark.parametrize(
    ("boxes", "why"),
    [
        ([box(0.0, 0.0, 1.2, 0.4, 0.0, 2.0)], "a wall has one top"),
        (
            [box(0.0, 0.0, 0.8, 0.8, 0.0, 1.2), *person(0.3, 0.0)],
            "one head is one person, and he is in a thing",
        ),
        (
            [
                box(0.0, 0.0, 0.2, 2.0, 0.0, 0.9),
                box(0, 0, 0.4, 0.4, 0, 1.2),
                *person(0.0, -1.8),
                *person(0.0, 1.8),
            ],
            "a share that is too heavy is no person",
        ),
    ],
)
def test_what_is_too_heavy_for_one_person_is_not_always_several(boxes, why):
    infos, _ = run([boxes] * 4, settings())
    assert not infos[-1].tracks, why


@pytest.mark.parametrize(("min_distance_m", "n_persons"), [(0.5, 3), (0.7, 1)])
def test_nobody_is_born_too_near_to_another(min_distance_m, n_persons):
    infos, _ = run([[*TOUCHING, *person(-0.4, -0.55, GREEN)]] * 4, settings(min_distance_m=min_distance_m))
    assert len(confirmed(infos[-1])) == n_persons


def test_somebody_who_was_followed_before_keeps_what_is_his():
    """Who comes to somebody whom one follows is a track of his own already, or none: the others are divided."""
    s = settings()
    infos, _ = run([person(-0.4, 0.0, RED)] * 5 + [TOUCHING] * 4, s)
    assert confirmed(infos[4]) == [1]
    assert [t.person for t in infos[5].tracks] == [1]


# Side by side they weigh and measure what one person may, and are one component.
ARMS = box(0.0, 0.0, 0.3, 0.1, 0.9, 1.2)
PAIR = [ARMS, *person(-0.3, 0.0, RED), *person(0.3, 0.1, BLUE, height=1.6)]
# The share of the second is .58 of an equal one.
UNEQUAL = [
    ARMS,
    *person(-0.3, 0.0, RED),
    box(0.3, 0.0, 0.1, 0.15, 0.0, 1.15, BLUE),
    box(0.3, 0.0, 0.1, 0.1, 1.15, 1.4, BLUE),
]


def persons_in(infos):
    return [len(info.tracks) for info in infos]


def test_two_side_by_side_are_two_from_the_first_frame():
    infos, _ = run([PAIR] * 4, settings())
    assert [t.person for t in infos[0].tracks] == [1, 2]
    assert confirmed(infos[0]) == [1, 2]
    for info in infos:
        np.testing.assert_allclose(sorted(float(t.xyz[0]) for t in info.tracks), (-0.3, 0.3), atol=0.1)
        assert info.n_unassigned == 0


def test_a_raised_hand_beside_two_is_nobody():
    infos, _ = run(
        [[*PAIR, box(0.65, 0.0, 0.1, 0.1, 1.0, 1.75), box(0.5, 0.0, 0.2, 0.1, 1.0, 1.2)]] * 4, settings()
    )
    assert persons_in(infos) == [2] * 4


def test_three_in_a_row_are_three():
    row = [*PAIR, *person(0.9, 0.0, GREEN), box(0.6, 0.0, 0.3, 0.1, 0.9, 1.2)]
    infos, _ = run([row] * 4, settings())
    assert confirmed(infos[-1]) == [1, 2, 3]


def test_who_has_two_heads_for_a_while_is_two():
    """At 20 frames per second from the seventh frame on; the one of before keeps his number, and has his own size."""
    s = settings()
    infos, _ = run([UNEQUAL] * 12, s)
    assert persons_in(infos) == [1] * 7 + [2] * 5
    assert confirmed(infos[7]) == [1, 2]
    places = {t.person: float(t.xyz[0]) for t in infos[-1].tracks}
    assert sorted(places.values()) == pytest.approx([-0.3, 0.3], abs=0.1)
    before, after = infos[6].tracks[0], {t.person: t for t in infos[7].tracks}
    assert sum(t.weight_kg for t in after.values()) == pytest.approx(before.weight_kg, rel=0.02)
    assert all(t.appearance is None for t in after.values())
    assert {t.top_m for t in after.values()} == {1.4, 1.7}


def test_who_was_followed_keeps_the_share_that_is_nearest():
    """Not that of the higher head."""
    trunk, head = box(0.3, 0.0, 0.1, 0.1, 0.0, 1.45, BLUE), box(0.3, 0.0, 0.1, 0.1, 1.6, 1.9, BLUE)
    tall = [trunk, box(0.3, 0.0, 0.15, 0.2, 1.45, 1.6, BLUE), head]
    infos, _ = run([[ARMS, *person(-0.3, 0.0, RED), *tall]] * 12, settings())
    assert persons_in(infos)[-1] == 2
    places = {t.person: float(t.xyz[0]) for t in infos[-1].tracks}
    assert places[1] < -0.2 < 0.2 < places[2]


@pytest.mark.parametrize(("y", "n_persons"), [(0.7, 2), (1.0, 3)])
def test_nobody_comes_apart_beside_somebody_else(y, n_persons):
    """What two people hide between them has heads, too."""
    infos, _ = run([[*UNEQUAL, *person(-0.1, y, GREEN)]] * 12, settings())
    assert persons_in(infos)[-1] == n_persons


def test_two_heads_for_a_moment_are_one():
    glimpse = [UNEQUAL] * 6 + [person(-0.3, 0.0, RED)]
    infos, _ = run([person(-0.3, 0.0, RED), *glimpse * 3], settings())
    assert persons_in(infos) == [1] * 22


def test_a_fist_held_up_is_no_second_head():
    raised = box(0.35, 0.0, 0.1, 0.1, 1.0, 1.7)
    shoulder = box(0.2, 0.0, 0.2, 0.1, 1.0, 1.3)
    boxes = [*person(0.0, 0.0), shoulder, raised]
    assert len(heads(boxes, 0.05)) == 2
    infos, _ = run([boxes] * 12, settings())
    assert persons_in(infos) == [1] * 12


# Legs apart: by the nearest of the head and a hand that is held up each has half.
STRADDLING = [
    *(box(x, 0.0, 0.1, 0.15, 0.0, 0.9) for x in (-0.15, 0.25)),
    box(0.05, 0.0, 0.25, 0.15, 0.9, 1.45),
    box(0.0, 0.0, 0.1, 0.1, 1.45, 1.75),
]
RAISED = box(0.35, 0.0, 0.1, 0.1, 1.3, 2.1)


def test_half_of_a_body_under_a_hand_held_up_is_no_person():
    boxes = [*STRADDLING, RAISED]
    found = heads(boxes, 0.05)
    assert len(found) == 2
    centers = observe(boxes).centers
    near = np.linalg.norm(centers[:, None, :2] - found[:, :2], axis=2).argmin(axis=1)
    assert np.bincount(near).min() > 0.7 * len(centers) / 2
    infos, _ = run([boxes] * 12, settings())
    assert persons_in(infos) == [1] * 12


@pytest.mark.parametrize("side", [0.02, 0.03, 0.04, 0.05, 0.08])
@pytest.mark.parametrize(("half_m", "is_wide"), [(0.13, True), (0.09, False)])
def test_shoulders_are_as_wide_with_voxels_of_any_size(side, half_m, is_wide):
    """551 cm² at 1.75 m: a square of 23.5 cm."""
    rows = np.arange(-0.3, 0.3, side)
    heights = np.arange(side / 2, 1.75, side)
    body = np.stack(np.meshgrid(rows, rows, heights, indexing="ij"), axis=-1).reshape(-1, 3)
    body = body[np.abs(body[:, :2]).max(axis=1) <= half_m]
    assert has_shoulders(body, np.zeros(2), side) == is_wide


def test_a_hand_that_has_more_than_a_child_is_no_person_and_the_child_is():
    child = box(-0.5, 0.0, 0.125, 0.15, 0.0, 1.15)
    infos, _ = run([[*STRADDLING, RAISED, box(-0.3, 0.0, 0.15, 0.05, 0.6, 0.7), child]] * 12, settings())
    assert persons_in(infos)[-1] == 2
    places = sorted(float(t.xyz[0]) for t in infos[-1].tracks)
    assert places[0] < -0.35 < 0.0 < places[1]


def test_a_child_has_shoulders_of_its_own_size():
    pair = [box(0.0, 0.0, 0.3, 0.05, 0.3, 0.6), *(box(x, 0.0, 0.1, 0.1, 0.0, 1.1) for x in (-0.3, 0.3))]
    infos, _ = run([pair] * 4, settings())
    assert persons_in(infos) == [2] * 4


def test_where_one_is_expected_nobody_parts_from_him():
    infos, _ = run([UNEQUAL] * 12, settings(expected_persons=1))
    assert persons_in(infos) == [1] * 12
    infos, _ = run([PAIR] * 12, settings(expected_persons=1))
    assert persons_in(infos)[2:] == [1] * 10  # the second was tentative
    assert infos[-1].n_unassigned == 0
    infos, _ = run([UNEQUAL] * 12, settings(expected_persons=2))
    assert persons_in(infos)[-1] == 2


def test_as_published_two_side_by_side_are_one():
    infos, _ = run([PAIR] * 10, settings(whole_components=False))
    assert persons_in(infos) == [1] * 10


def child(x, y):
    return [box(x, y, 0.125, 0.15, 0.0, 0.95, BLUE), box(x, y, 0.1, 0.1, 0.95, 1.15, BLUE)]


POST = [box(0.0, 0.425, 0.15, 0.15, 0.0, 0.5), box(0.0, 0.425, 0.075, 0.075, 0.5, 1.15)]
HANGING = [box(0.0, 0.45, 0.15, 0.2, 0.35, 1.25), box(0.0, 0.45, 0.1, 0.1, 1.25, 1.5)]


@pytest.mark.parametrize(
    ("beside", "n_persons"),
    [(child(0.0, 0.4), 2), (POST, 1), (HANGING, 1), ([box(0.0, 0.4, 0.1, 0.1, 0.0, 0.9)], 1)],
)
def test_a_whole_body_may_be_nearer_to_somebody_than_a_piece_of_him(beside, n_persons):
    for clip in (
        [[*person(0.0, 0.0, RED), *beside]] * 8,
        [person(0.0, 0.0, RED)] * 4 + [[*person(0.0, 0.0, RED), *beside]] * 8,
    ):
        infos, _ = run(clip, settings())
        assert infos[-1].n_components == 2
        assert len(confirmed(infos[-1])) == len(infos[-8].tracks) == n_persons


def test_nobody_is_born_within_somebody():
    """Two volumes whose axes are a hand's breadth from each other are of one body."""
    halves = [
        *(box(x, 0.0, 0.075, 0.2, 0.0, 1.45) for x in (-0.075, 0.125)),
        *(box(x, 0.0, 0.075, 0.1, 1.45, 1.7) for x in (-0.075, 0.125)),
    ]
    infos, _ = run([halves] * 8, settings())
    assert infos[-1].n_components == 2
    assert persons_in(infos) == [1] * 8


def test_what_is_above_a_head_belongs_to_a_higher_one():
    tops = np.array([[0.0, 0.0, 1.7], [0.4, 0.0, 1.1]])
    beside_child = np.array(
        [[0.3, 0.0, z] for z in (0.5, 1.1 + 0.9 * ABOVE_M, 1.1 + 1.1 * ABOVE_M, 1.6, 1.9)]
    )
    assert nearest_head(beside_child, tops).tolist() == [1, 1, 0, 0, 1]  # what is above all is of the nearest


def test_tops_of_heads_have_their_height():
    found = heads_of(observe([*person(-0.4, 0.0), *person(0.4, 0.0, height=1.5)]).centers, 0.05)
    np.testing.assert_allclose(found[:, 2], [1.7, 1.5], atol=1e-6)


def test_what_is_higher_than_a_child_ever_is_belongs_to_the_adult():
    """The adult bends over it, so that the child's axis is the nearest one to his head."""
    apart = [[*person(-0.3, 0.0, RED), *child(0.3, 0.4)]] * 8
    over = [
        *child(0.3, 0.4),
        *person(-0.3, 0.0, RED)[:1],
        box(-0.05, 0.2, 0.4, 0.2, 0.85, 1.3, RED),
        box(0.3, 0.4, 0.1, 0.1, 1.3, 1.5),
    ]
    infos, _ = run([*apart, *[over] * 12], settings())
    assert infos[-1].n_components == 1
    tops = {person: found.top_m for person, found in infos[-1].features_of.items()}
    assert tops == pytest.approx({1: 1.5, 2: 1.15}, abs=0.11)


def test_an_arm_above_a_childs_head_is_not_its_own_where_each_has_a_head():
    hands, arm = box(0.0, 0.0, 0.3, 0.05, 0.3, 0.6), box(-0.05, -0.2, 0.15, 0.1, 1.25, 1.4)
    apart = [*person(-0.3, 0.0, RED), *child(0.3, 0.0)]
    together = [*apart, hands, arm]
    assert len(heads(together, 0.05)) == 2
    infos, _ = run([*[apart] * 8, *[together] * 8], settings())
    assert infos[-1].n_components == 1
    tops = {person: found.top_m for person, found in infos[-1].features_of.items()}
    assert tops == pytest.approx({1: 1.7, 2: 1.2}, abs=0.051)


# Before so few cameras, what several leave between them is as high and as heavy as they are.
FOUR_CAMERAS = ring(4, size=(320, 248), dist=np.zeros(4))
ROOM = VoxelGrid.from_bounds(np.array([-1.8, -1.8, 0.0]), np.array([1.8, 1.8, 1.9]), 0.05)


@lru_cache
def hull(*places):
    """What the four cameras leave of people in these places."""
    points = observe([box for place in places for box in person(*place)]).centers
    masks = spotted(FOUR_CAMERAS, points)
    voxels = Carver(FOUR_CAMERAS, ROOM).carve(masks, n_faulty_views=0)
    labels, _ = connected_components(voxels, ROOM)
    return FrameVoxels.of_grid(0, ROOM, voxels, labels, surface_voxels(voxels, ROOM))


def followed(places, **changes):
    seen = hull(*places)
    infos, _ = run([replace(seen, frame=frame) for frame in range(12)], settings(**changes))
    return infos[-1].tracks


@pytest.mark.parametrize(
    ("places", "n_heads"),
    [
        (((0.5, -0.5), (0.0, 0.6)), 3),
        (((-0.7, -0.5), (0.2, 0.2)), 3),
        (((0.8, 0.5), (0.0, 0.7), (-1.0, 0.3)), 4),
        (((0.7, 0.2), (-0.6, 0.4), (0.5, -0.8)), 5),
        (((0.0, -0.3), (-0.4, -0.7)), 3),
        (((0.2, 0.8), (0.3, -0.4), (-0.2, 0.0)), 5),
    ],
)
def test_what_has_no_pixels_of_its_own_is_nobody(places, n_heads):
    """Heads alone are more than people; the one with least of its own goes first."""
    assert len(followed(places)) == n_heads
    tracks = followed(places, rig=FOUR_CAMERAS)
    assert len(tracks) == len(places)
    found = np.array([track.xyz[:2] for track in tracks])
    gaps = np.linalg.norm(found[:, None] - np.array(places), axis=2)
    assert gaps.min(axis=0).max() < 0.25


@pytest.mark.parametrize("boxes", [PAIR, UNEQUAL])
def test_who_has_pixels_of_his_own_is_one_of_several(boxes):
    infos, _ = run([boxes] * 12, settings(rig=FOUR_CAMERAS))
    assert persons_in(infos)[-1] == 2


def test_three_cameras_are_not_asked_who_has_pixels_of_his_own():
    places = ((0.5, -0.5), (0.0, 0.6))
    three = CameraRig(FOUR_CAMERAS.cameras[:3])
    assert len(followed(places, rig=three)) == len(followed(places)) == 3
