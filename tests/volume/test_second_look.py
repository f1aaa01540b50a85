"""What is a shadow and what a person, told by the other cameras: what stands comes back, what lies at feet goes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from look_by_definition import LookByDefinition
from test_occluders import on_floor, ring_rig, standing_silhouettes

from mocap.data import VoxelGrid
from mocap.volume import SecondLook, second_look
from mocap.volume.second_look import least_cameras

AT = np.array([0.1, -0.2])
ROOM = VoxelGrid.from_bounds(np.array([-1.5, -1.5, 0.0]), np.array([1.5, 1.5, 2.0]), 0.04)
VOXEL_PX = 3  # 4 cm at 2 m from a lens of 150 px


@pytest.fixture(scope="module")
def look() -> SecondLook:
    return SecondLook(ring_rig(), ROOM)


@pytest.fixture(scope="module")
def persons() -> list[np.ndarray]:
    return standing_silhouettes(AT)


def middle_of(person: np.ndarray) -> np.ndarray:
    """The person between a third and two thirds of his height."""
    rows = np.flatnonzero(person.any(axis=1))
    part = person.copy()
    part[: rows[0] + len(rows) // 3] = part[rows[0] + 2 * len(rows) // 3 :] = False
    return part


def nothing(persons: list[np.ndarray]) -> list[np.ndarray]:
    return [np.zeros_like(person) for person in persons]


def test_what_two_cameras_took_for_shadow_comes_back(look: SecondLook, persons: list[np.ndarray]) -> None:
    shadows = nothing(persons)
    for c in (0, 2):
        shadows[c] = middle_of(persons[c])
    again = look.masks([p & ~s for p, s in zip(persons, shadows, strict=True)], shadows, nothing(persons))
    for found, person, shadow in zip(again, persons, shadows, strict=True):
        assert np.array_equal(found & ~shadow, person & ~shadow)
        assert not shadow.any() or (found & shadow).sum() > 0.8 * shadow.sum()


def test_a_shadow_on_the_floor_stays_one(look: SecondLook, persons: list[np.ndarray]) -> None:
    """It begins at the feet, and its part behind the person is seen between his legs by nobody else."""
    shadows = [on_floor(i, AT + np.array([0.35, 0.2]), 0.4) & ~person for i, person in enumerate(persons)]
    for again, person in zip(look.masks(persons, shadows, nothing(persons)), persons, strict=True):
        assert np.array_equal(again, person)


def test_a_shadow_on_a_wall_that_one_camera_sees_stays_one(
    look: SecondLook, persons: list[np.ndarray]
) -> None:
    """It is as high as the person and beside him; a rim as wide as a voxel may be taken for him."""
    shadows = nothing(persons)
    near = cv2.dilate(persons[1].astype(np.uint8), np.ones((1, 31), np.uint8)) > 0
    shadows[1] = near & ~persons[1]
    again = look.masks(persons, shadows, nothing(persons))
    close = cv2.dilate(persons[1].astype(np.uint8), np.ones((2 * VOXEL_PX + 1,) * 2, np.uint8)) > 0
    assert not (again[1] & ~close).any()
    assert np.count_nonzero(again[1] & ~persons[1]) < 0.1 * np.count_nonzero(shadows[1])


def test_most_cameras_must_see_the_person(look: SecondLook, persons: list[np.ndarray]) -> None:
    """Where more than half of the cameras see a shadow nobody stands."""
    n = len(persons) // 2 + 1
    shadows = [middle_of(p) if c < n else np.zeros_like(p) for c, p in enumerate(persons)]
    masks = [p & ~s for p, s in zip(persons, shadows, strict=True)]
    found = look.masks(masks, shadows, nothing(persons))
    middle = [again & s for again, s in zip(found, shadows, strict=True)]
    assert sum(int(m.sum()) for m in middle) < 0.25 * sum(int(s.sum()) for s in shadows)


@pytest.fixture(scope="module")
def at_feet(persons: list[np.ndarray]) -> list[np.ndarray]:
    """Contact shadows of 3 cm about the feet, as all cameras see them."""
    return [on_floor(i, AT, 0.23) & ~person for i, person in enumerate(persons)]


def test_a_contact_shadow_goes_and_the_person_stays(
    look: SecondLook, persons: list[np.ndarray], at_feet: list[np.ndarray]
) -> None:
    """Also when all of him is as dark as a shadow. What lies within a voxel of him, 4 cm, may be taken for him."""
    masks = [person | shadow for person, shadow in zip(persons, at_feet, strict=True)]
    again = look.masks(masks, nothing(persons), masks)
    gone = sum(np.count_nonzero(s & ~m) for m, s in zip(again, at_feet, strict=True))
    assert gone > 0.25 * sum(map(np.count_nonzero, at_feet))
    kept = sum(np.count_nonzero(p & m) for m, p in zip(again, persons, strict=True))
    assert kept > 0.99 * sum(map(np.count_nonzero, persons))


def test_what_has_not_the_colour_of_a_shadow_stays(
    look: SecondLook, persons: list[np.ndarray], at_feet: list[np.ndarray]
) -> None:
    masks = [person | shadow for person, shadow in zip(persons, at_feet, strict=True)]
    for again, mask in zip(look.masks(masks, nothing(persons), nothing(persons)), masks, strict=True):
        assert np.array_equal(again, mask)


def test_where_others_see_the_floor_bare_nothing_goes(
    look: SecondLook, persons: list[np.ndarray], at_feet: list[np.ndarray]
) -> None:
    """Feet that furniture hides from two cameras are no contact shadow for a third."""
    masks = [person | shadow for person, shadow in zip(persons, at_feet, strict=True)]
    masks[1:] = persons[1:]
    again = look.masks(masks, nothing(persons), at_feet)
    bare = np.count_nonzero(at_feet[0] & ~again[0])
    assert bare < 0.25 * np.count_nonzero(at_feet[0])


def blots(rng: np.random.Generator, shape: tuple[int, ...], share: float) -> np.ndarray:
    """Random patches of some pixels."""
    return cv2.blur(rng.random(shape), (9, 9)) > 0.5 + share


@pytest.mark.parametrize("are_grey", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_kernels_do_what_the_definition_says(seed: int, are_grey: bool) -> None:
    """With torn masks, shadows on the floor and in the persons, and doubt everywhere."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-0.6, 0.6, (2, 2))
    look, by_definition = (
        kind(ring_rig(), ROOM, are_grey=are_grey) for kind in (SecondLook, LookByDefinition)
    )
    pairs = zip(*(standing_silhouettes(at) for at in places), strict=True)
    persons = [a | b for a, b in pairs]
    lying = [on_floor(i, places[0] + 0.3, 0.4) | on_floor(i, places[1], 0.25) for i in range(len(persons))]
    torn = [blots(rng, p.shape, 0.08) for p in persons]
    masks = [(p & ~t) | (f & blots(rng, f.shape, 0.0)) for p, t, f in zip(persons, torn, lying, strict=True)]
    shadows = [
        ((p & t) | f | blots(rng, f.shape, 0.1)) & ~m
        for p, t, f, m in zip(persons, torn, lying, masks, strict=True)
    ]
    doubtful = [m & blots(rng, m.shape, -0.05) for m in masks]
    found, expected = (one.masks(masks, shadows, doubtful) for one in (look, by_definition))
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert any((m & ~o).any() for m, o in zip(masks, found, strict=True))
    assert any((s & o).any() for s, o in zip(shadows, found, strict=True))


def test_boxes_and_room_for_feet_change_nothing(
    look: SecondLook, persons: list[np.ndarray], at_feet: list[np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The floor of more pixels than are kept is computed again."""
    masks = [person | shadow for person, shadow in zip(persons, at_feet, strict=True)]
    expected = look.masks(masks, nothing(persons), masks)
    monkeypatch.setattr(second_look, "_MOST_KEPT", 50)
    other = SecondLook(ring_rig(), ROOM)
    boxes = []
    for mask in masks:
        (v0, u0), (v1, u1) = (f(np.argwhere(mask), axis=0) for f in (np.min, np.max))
        boxes.append((max(int(u0) - 2, 0), int(u1), int(v0), int(v1)))
    for _ in range(2):
        for ours, theirs in zip(other.masks(masks, nothing(persons), masks, boxes), expected, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_an_empty_room_stays_empty(look: SecondLook, persons: list[np.ndarray]) -> None:
    assert not any(mask.any() for mask in look.masks(*(nothing(persons) for _ in range(3))))


@pytest.mark.parametrize("are_grey", [False, True])
def test_too_few_cameras_are_refused(are_grey: bool) -> None:
    rig, least = ring_rig(), least_cameras(are_grey=are_grey)
    with pytest.raises(ValueError, match=f"at least {least} cameras"):
        SecondLook(rig.subset(rig.names[: least - 1]), ROOM, are_grey=are_grey)
    SecondLook(rig.subset(rig.names[:least]), ROOM, are_grey=are_grey)


@pytest.mark.parametrize("n_cameras", [4, 5, 6])
def test_without_colours_two_cameras_tell_that_the_others_see_no_shadow(
    persons: list[np.ndarray], n_cameras: int
) -> None:
    rig = ring_rig()
    chosen = np.linspace(0, len(rig), n_cameras, endpoint=False).astype(int)
    look = SecondLook(rig.subset([rig.names[c] for c in chosen]), ROOM, are_grey=True)
    seen = [persons[c] for c in chosen]
    shadows = [middle_of(p) if c >= 2 else np.zeros_like(p) for c, p in enumerate(seen)]
    masks = [p & ~s for p, s in zip(seen, shadows, strict=True)]
    for found, shadow in zip(look.masks(masks, shadows, nothing(seen)), shadows, strict=True):
        assert np.count_nonzero(found & shadow) >= 0.8 * np.count_nonzero(shadow)


def test_without_colours_gaps_close_where_others_have_a_person(persons: list[np.ndarray]) -> None:
    """A shirt as bright as the wall leaves a gap; a gap beside the person is the view past him."""
    look = SecondLook(ring_rig(), ROOM, are_grey=True)
    masks = [person.copy() for person in persons]
    rows, columns = (np.flatnonzero(masks[0].any(axis=axis)) for axis in (1, 0))
    gap = (slice(rows[len(rows) // 2], rows[len(rows) // 2] + 2), slice(None))
    masks[0][gap] = False
    far = np.zeros_like(masks[0])
    far[rows[0] : rows[-1], columns[-1] + 30 : columns[-1] + 40] = True
    far[gap] = False
    masks[0] |= far
    found = look.masks(masks, nothing(persons), nothing(persons))[0]
    assert found[gap][:, : columns[-1] + 1].sum() > 0.9 * persons[0][gap].sum()
    assert not found[gap][:, columns[-1] + 20 :].any()
    np.testing.assert_array_equal(look.masks(persons, nothing(persons), nothing(persons))[1], persons[1])
