"""What other cameras let one see: shadows on the floor, a cut that is far too large, one that is too small."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from outline_world import box_silhouettes
from test_occluders import on_floor, ring_rig, standing_silhouettes

from mocap.data import Camera, CameraRig, VoxelGrid
from mocap.volume import Guess, Witness

AT = np.array([0.1, -0.2])
ROOM = VoxelGrid.from_bounds(np.array([-1.5, -1.5, 0.0]), np.array([1.5, 1.5, 2.0]), 0.04)
BESIDE_PX = 8  # a foot's reach of 0.14 m at 3 m and 150 px focal length, and a voxel


@pytest.fixture(scope="module")
def silhouettes() -> list[np.ndarray]:
    return standing_silhouettes(AT)


@pytest.fixture(scope="module")
def witness(silhouettes: list[np.ndarray]) -> Witness:
    """Somebody was where he stands, and nowhere else."""
    return Witness(ring_rig(), ROOM, silhouettes)


def grown(mask: np.ndarray, px: int) -> np.ndarray:
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * px + 1,) * 2, np.uint8)) > 0


def nowhere(masks: list[np.ndarray]) -> list[np.ndarray]:
    return [np.zeros_like(mask) for mask in masks]


def facing_away(camera: Camera) -> Camera:
    """The camera turned about its upward axis, so that it sees nothing of the room."""
    turn = np.diag([-1.0, 1.0, -1.0])
    return Camera(camera.name, camera.size, camera.K, camera.dist, turn @ camera.R, turn @ camera.t)


def lower_half(person: np.ndarray) -> np.ndarray:
    rows, lower = np.flatnonzero(person.any(axis=1)), person.copy()
    lower[: rows[0] + len(rows) // 2] = False
    return lower


def test_regions_hold_the_person_and_not_his_shadow(silhouettes: list[np.ndarray]) -> None:
    shadow = [on_floor(i, AT + np.array([0.9, 0.6]), 0.3) for i in range(len(silhouettes))]
    regions = Witness(ring_rig(), ROOM, [s | d for s, d in zip(silhouettes, shadow, strict=True)]).regions()
    for region, person, dark in zip(regions, silhouettes, shadow, strict=True):
        assert region[person].all()
        assert not region[dark & ~grown(person, 2 * BESIDE_PX)].any()


def test_feet_that_never_move_are_in_the_region(silhouettes: list[np.ndarray]) -> None:
    """Nothing moves below a quarter of the person's height."""
    active = []
    for person in silhouettes:
        rows = np.flatnonzero(person.any(axis=1))
        upper = person.copy()
        upper[rows[0] + round(0.8 * len(rows)) :] = False
        active.append(upper)
    for region, person in zip(Witness(ring_rig(), ROOM, active).regions(), silhouettes, strict=True):
        assert region[person].mean() > 0.99


@pytest.mark.parametrize("some", [(0, 1, 3, 4), (0, 2, 4)])
def test_legs_that_furniture_hides_from_one_of_few_are_in_the_region(
    silhouettes: list[np.ndarray], some: tuple[int, ...]
) -> None:
    """Of five cameras one may miss them; four and three believe where the others see something move, and not below him
    where nothing does."""
    rig = ring_rig().subset([f"c{i}" for i in some])
    persons = [silhouettes[i] for i in some]
    hidden = [persons[0] & ~lower_half(persons[0]), *persons[1:]]
    for region, person in zip(Witness(rig, ROOM, hidden).regions(), persons, strict=True):
        assert region[person].mean() > 0.97
    cut_off = [person & ~lower_half(person) for person in persons]
    for region, person, upper in zip(Witness(rig, ROOM, cut_off).regions(), persons, cut_off, strict=True):
        assert not region[person & ~grown(upper, 12)].any()


def test_a_cut_that_is_off_is_put_right(witness: Witness, silhouettes: list[np.ndarray]) -> None:
    cuts = [s.copy() for s in silhouettes]
    cuts[0][:, 20:] = True
    lower = lower_half(silhouettes[1])
    cuts[1] &= ~lower
    corrected = witness.corrected(cuts, nowhere(cuts))
    for (allowed, likely, _), person in zip(corrected, silhouettes, strict=True):
        assert allowed[person].mean() > 0.98
        # Four votes of six carry a place, one of them blindly: a margin of three voxels around 24 pixels.
        assert np.count_nonzero(allowed) < 3.5 * np.count_nonzero(person)
        assert not np.any(likely & ~allowed)
    # 24 pixels wide, without a rim of 7 on both sides. Two of six are wrong about it: it is likely, and not certain.
    assert corrected[1].likely[lower].mean() > 0.2
    assert not corrected[1].sure[lower].any()


def test_what_two_cuts_of_six_lack_is_likely(witness: Witness, silhouettes: list[np.ndarray]) -> None:
    """Legs as dark as the floor are missing in more than one picture."""
    lower = [lower_half(person) for person in silhouettes]
    cuts = [
        p & ~dark if i in (1, 4) else p for i, (p, dark) in enumerate(zip(silhouettes, lower, strict=True))
    ]
    for guess, dark in zip(witness.corrected(cuts, nowhere(cuts)), lower, strict=True):
        assert guess.likely[dark].mean() > 0.2


def test_where_few_cameras_look_two_of_them_are_no_majority(silhouettes: list[np.ndarray]) -> None:
    """Somebody stands where four of six see him; two of them alone have his legs."""
    hidden = (2, 5)
    rig = ring_rig()
    place = VoxelGrid.from_bounds(np.array([-0.5, -0.8, 0.0]), np.array([0.7, 0.4, 2.0]), 0.04)
    turned = CameraRig(tuple(facing_away(c) if i in hidden else c for i, c in enumerate(rig)))
    seen = [p & (i not in hidden) for i, p in enumerate(silhouettes)]
    cuts = [p & ~lower_half(p) if i in (0, 3) else p for i, p in enumerate(seen)]
    guesses = Witness(turned, place, seen).corrected(cuts, nowhere(cuts))
    for i in (0, 3):
        assert not guesses[i].likely[lower_half(silhouettes[i]) & ~grown(cuts[i], 4)].any()


def test_a_camera_that_sees_the_room_as_it_knows_it_is_believed() -> None:
    """Two stand side by side, or one and what all cameras but one of four take for somebody."""
    one = standing_silhouettes(AT)
    both = [a | b for a, b in zip(one, standing_silhouettes(AT + np.array([0.4, 0.0])), strict=True)]
    some = (0, 1, 3, 4)
    witness = Witness(ring_rig().subset([f"c{i}" for i in some]), ROOM, [both[i] for i in some])
    cuts = [one[i] if i == 4 else both[i] for i in some]
    second = both[4] & ~grown(one[4], BESIDE_PX) & ~lower_half(both[4])  # feet have room beside them
    inner = cv2.erode(both[4].astype(np.uint8), np.ones((17, 17))) > 0
    assert np.count_nonzero(inner & second) > 50
    doubted = witness.corrected(cuts, nowhere(cuts))[-1]
    assert doubted.allowed[second].mean() > 0.9
    assert doubted.likely[inner & second].mean() > 0.5
    bare = [np.ones_like(cut) for cut in cuts]
    believed = witness.corrected(cuts, bare)[-1]
    assert not believed.allowed[second].any()
    assert believed.likely[one[4]].all()


@pytest.mark.parametrize(("lacking", "is_likely"), [((1,), True), ((1, 4), False)])
def test_nearly_all_others_are_believed_against_it(
    witness: Witness, silhouettes: list[np.ndarray], lacking: tuple[int, ...], is_likely: bool
) -> None:
    """Trousers like the wall before which a camera sees them: five of six have them, or only four."""
    cuts = [p & ~lower_half(p) if i in lacking else p for i, p in enumerate(silhouettes)]
    inner = lower_half(silhouettes[1]) & ~grown(cuts[1], 4)
    assert witness.corrected(cuts, nowhere(cuts))[1].likely[inner].any()
    bare = [np.ones_like(cut) for cut in cuts]
    assert witness.corrected(cuts, bare)[1].likely[inner].any() == is_likely


def broad(lacking: tuple[int, ...] = (), bare: bool = False) -> tuple[list[np.ndarray], list[Guess]]:
    """Somebody twice as broad, whom some cameras do not see, and what is said of him.

    bare : every camera shows the room, as it knows it, all over.
    """
    sides = [standing_silhouettes(AT + np.array([dx, dy])) for dx in (-0.2, 0.2) for dy in (-0.2, 0.2)]
    person = [np.logical_or.reduce(own) for own in zip(*sides, strict=True)]
    cuts = [p & (i not in lacking) for i, p in enumerate(person)]
    return person, Witness(ring_rig(), ROOM, person).corrected(cuts, [np.full_like(p, bare) for p in person])


def test_what_all_cuts_have_is_sure_but_for_its_rim() -> None:
    """A rim of 4 pixels of the own cut, and where the room shows of 11 from a hull that may be two pixels larger."""
    for bare, rim, inner in ((False, 3, 6), (True, 7, 14)):
        for person, guess in zip(*broad(bare=bare), strict=True):
            inside = cv2.distanceTransform(person.astype(np.uint8), cv2.DIST_L2, 5)
            assert not guess.sure[inside < rim].any()
            assert guess.sure[inside > inner].all()


def test_what_one_of_six_lacks_is_sure_in_the_cuts_of_the_others() -> None:
    for i, (person, guess) in enumerate(zip(*broad(lacking=(3,)), strict=True)):
        inside = cv2.distanceTransform(person.astype(np.uint8), cv2.DIST_L2, 5)
        assert guess.sure[inside > 6].all() if i != 3 else not guess.sure.any()


@pytest.mark.parametrize(("lacking", "bare"), [((3,), True), ((3, 5), False)])
def test_what_two_of_six_lack_or_what_is_bare_is_not_sure(lacking: tuple[int, ...], bare: bool) -> None:
    assert not any(guess.sure.any() for guess in broad(lacking, bare)[1])


@pytest.mark.parametrize(
    ("away", "lacking", "is_agreed"),
    [
        ((2, 5), (0,), False),
        ((2, 5), (), True),
        ((2,), (0,), True),
    ],
)
def test_where_four_look_three_of_them_do_not_agree(
    silhouettes: list[np.ndarray], away: tuple[int, ...], lacking: tuple[int, ...], is_agreed: bool
) -> None:
    """One of six may miss a person; at the border of the room, where four look, none of them may."""
    rig = CameraRig(tuple(facing_away(c) if i in away else c for i, c in enumerate(ring_rig())))
    seen = [p & (i not in away) for i, p in enumerate(silhouettes)]
    place = VoxelGrid.from_bounds(np.array([-0.5, -0.8, 0.0]), np.array([0.7, 0.4, 2.0]), 0.04)
    cuts = [np.zeros_like(p) if i in lacking else p for i, p in enumerate(seen)]
    found = Witness(rig, place, seen).agreed(cuts)
    assert (found[3][silhouettes[3]].mean() > 0.9) == is_agreed
    assert is_agreed or not any(mask.any() for mask in found)


def test_cuts_agree_only_where_somebody_was(witness: Witness) -> None:
    """What is as consistent as a person, and was never seen to move, is none: a pillar."""
    pillar = standing_silhouettes(AT + np.array([0.9, 0.6]))
    for guess in witness.corrected(pillar, nowhere(pillar)):
        assert not guess.sure.any()


def test_lower_legs_and_heads_that_all_cuts_lack_are_allowed(
    witness: Witness, silhouettes: list[np.ndarray]
) -> None:
    cuts = []
    for person in silhouettes:
        rows, cut = np.flatnonzero(person.any(axis=1)), person.copy()
        cut[: rows[0] + round(0.12 * len(rows))] = False
        cut[rows[0] + round(0.72 * len(rows)) :] = False
        cuts.append(cut)
    for (allowed, likely, _), person, cut in zip(
        witness.corrected(cuts, nowhere(cuts)), silhouettes, cuts, strict=True
    ):
        assert allowed[person].mean() > 0.97
        assert np.count_nonzero(allowed) < 3 * np.count_nonzero(person)
        # Only the picture can say that they are his.
        assert not likely[person & ~grown(cut, 2)].any()


def test_legs_that_all_cuts_lack_from_the_hips_on_are_allowed(
    witness: Witness, silhouettes: list[np.ndarray]
) -> None:
    cuts = [person & ~lower_half(person) for person in silhouettes]
    for (allowed, likely, _), person, cut in zip(
        witness.corrected(cuts, nowhere(cuts)), silhouettes, cuts, strict=True
    ):
        assert allowed[person].mean() > 0.97
        assert np.count_nonzero(allowed) < 4 * np.count_nonzero(person)  # room for a stride
        assert not likely[person & ~grown(cut, 2)].any()


def test_nobody_gives_nothing(witness: Witness, silhouettes: list[np.ndarray]) -> None:
    empty = [np.zeros_like(s) for s in silhouettes]
    assert not any(region.any() for region in Witness(ring_rig(), ROOM, empty).regions())
    assert not any(part.any() for guess in witness.corrected(empty, empty) for part in guess)


def shrunk(mask: np.ndarray, px: int) -> np.ndarray:
    return cv2.erode(mask.astype(np.uint8), np.ones((2 * px + 1,) * 2, np.uint8)) > 0


def test_who_would_hang_in_the_air_has_legs(witness: Witness, silhouettes: list[np.ndarray]) -> None:
    """Two cameras of six take them for a thing, and without its rim, which holds nobody up."""
    lower = [lower_half(person) for person in silhouettes]
    things = [shrunk(half, 4) & (i in (0, 2)) for i, half in enumerate(lower)]
    legs = witness.carrying(silhouettes, things, hands_only=False)
    for found, half, person in zip(legs, lower, silhouettes, strict=True):
        assert found[shrunk(half, 3)].mean() > 0.9
        assert not found[~grown(person, 4)].any()
    # A cupboard may hide legs of which the trunk is in sight.
    assert not any(found.any() for found in witness.carrying(silhouettes, things, hands_only=True))


def test_of_whom_a_hand_is_left_had_his_body_taken() -> None:
    """Beside him stands a cupboard, before which nobody moves a hand, and which goes as well."""
    rig = ring_rig()
    at, arm, cupboard = (
        box_silhouettes(rig, low, high, 0.02)
        for low, high in (
            ((0.1, -0.2, 0.0), (0.4, 0.1, 1.5)),
            ((0.4, -0.05, 1.25), (0.7, 0.05, 1.35)),
            ((-1.0, 0.2, 0.0), (-0.5, 0.6, 1.2)),
        )
    )
    cuts = [a | b | c for a, b, c in zip(at, arm, cupboard, strict=True)]
    things = [(a | c) & ~b & (i in (1, 3)) for i, (a, b, c) in enumerate(zip(at, arm, cupboard, strict=True))]
    witness = Witness(rig, ROOM, cuts)
    for found, body, case in zip(witness.carrying(cuts, things, hands_only=True), at, cupboard, strict=True):
        assert found[body].mean() > 0.7
        assert found[case & ~grown(body, 12)].mean() < 0.2


@pytest.mark.parametrize(("lifted_m", "hangs"), [(0.0, False), (0.3, True)])
def test_legs_of_a_chair_are_no_hand(lifted_m: float, hangs: bool) -> None:
    """Its back keeps still in two cameras of six, and below that some of it is left: it stands on the floor."""
    rig = ring_rig()
    back, legs = (
        box_silhouettes(rig, low, high, 0.02)
        for low, high in (
            ((0.0, 0.0, lifted_m + 0.3), (0.3, 0.3, 0.9)),
            ((0.0, 0.0, lifted_m), (0.15, 0.1, lifted_m + 0.3)),
        )
    )
    cuts = [a | b for a, b in zip(back, legs, strict=True)]
    things = [(a & ~b) & (i in (1, 3)) for i, (a, b) in enumerate(zip(back, legs, strict=True))]
    found = Witness(rig, ROOM, cuts).carrying(cuts, things, hands_only=True)
    assert any(part.any() for part in found) == hangs


def test_who_has_his_feet_on_the_floor_needs_no_more(witness: Witness, silhouettes: list[np.ndarray]) -> None:
    """Nothing is taken from him; or one camera of six has a thing where his legs are, and five see them."""
    nothing = [np.zeros_like(person) for person in silhouettes]
    for things in (nothing, [lower_half(silhouettes[0]), *nothing[1:]]):
        for hands_only in (False, True):
            found = witness.carrying(silhouettes, things, hands_only=hands_only)
            assert not any(part.any() for part in found)


def test_a_thing_is_where_enough_cameras_have_it(witness: Witness, silhouettes: list[np.ndarray]) -> None:
    nothing = [np.zeros_like(person) for person in silhouettes]
    some = [
        person if i in (0, 2, 3) else none
        for i, (person, none) in enumerate(zip(silhouettes, nothing, strict=True))
    ]
    assert not any(found.any() for found in witness.in_some(some, 4))
    for found, person in zip(witness.in_some(some, 3), some, strict=True):
        assert not person.any() or found[person].mean() > 0.8


@pytest.mark.parametrize(("seat_m", "is_thing"), [(0.0, False), (0.4, True)])
def test_shanks_that_keep_still_are_no_thing(seat_m: float, is_thing: bool) -> None:
    """Two of them before three cameras, or a stool of their height."""
    rig = CameraRig(tuple(ring_rig())[::2])
    room = VoxelGrid.from_bounds(np.array([-0.6, -0.6, 0.0]), np.array([0.6, 0.6, 2.0]), 0.04)
    witness = Witness(rig, room, [np.ones(camera.size[::-1], dtype=np.bool_) for camera in rig])
    boxes = [((x, 0.0, 0.0), (x + 0.1, 0.1, 0.45)) for x in (-0.2, 0.2)]
    if seat_m:
        boxes.append(((-0.2, -0.2, 0.1), (-0.2 + seat_m, -0.2 + seat_m, 0.45)))
    things = [
        np.logical_or.reduce(parts)
        for parts in zip(*(box_silhouettes(rig, *box, 0.02) for box in boxes), strict=True)
    ]
    for found, thing in zip(witness.in_some(things, 3), things, strict=True):
        assert found[thing].mean() > 0.5 if is_thing else not found.any()


def test_shoes_are_no_thing(witness: Witness) -> None:
    shoes = [on_floor(i, AT, 0.15) for i in range(len(ring_rig()))]
    assert not any(found.any() for found in witness.in_some(shoes, 3))
