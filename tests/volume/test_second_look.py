"""Shadows that are none, told by the other cameras: what stands comes back, what lies on the floor does not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from test_occluders import on_floor, ring_rig, standing_silhouettes

from mocap.data import VoxelGrid
from mocap.volume import SecondLook
from mocap.volume.second_look import LEAST_CAMERAS

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
    again = look.masks([p & ~s for p, s in zip(persons, shadows, strict=True)], shadows)
    for found, person, shadow in zip(again, persons, shadows, strict=True):
        assert np.array_equal(found & ~shadow, person & ~shadow)
        assert not shadow.any() or (found & shadow).sum() > 0.8 * shadow.sum()


def test_a_shadow_on_the_floor_stays_one(look: SecondLook, persons: list[np.ndarray]) -> None:
    """It begins at the feet, and its part behind the person is seen between his legs by nobody else."""
    shadows = [on_floor(i, AT + np.array([0.35, 0.2]), 0.4) & ~person for i, person in enumerate(persons)]
    for again, person in zip(look.masks(persons, shadows), persons, strict=True):
        assert np.array_equal(again, person)


def test_a_shadow_on_a_wall_that_one_camera_sees_stays_one(
    look: SecondLook, persons: list[np.ndarray]
) -> None:
    """It is as high as the person and beside him; a rim as wide as a voxel may be taken for him."""
    shadows = nothing(persons)
    near = cv2.dilate(persons[1].astype(np.uint8), np.ones((1, 31), np.uint8)) > 0
    shadows[1] = near & ~persons[1]
    again = look.masks(persons, shadows)
    close = cv2.dilate(persons[1].astype(np.uint8), np.ones((2 * VOXEL_PX + 1,) * 2, np.uint8)) > 0
    assert not (again[1] & ~close).any()
    assert np.count_nonzero(again[1] & ~persons[1]) < 0.1 * np.count_nonzero(shadows[1])


def test_most_cameras_must_see_the_person(look: SecondLook, persons: list[np.ndarray]) -> None:
    """Where more than half of the cameras see a shadow nobody stands."""
    n = len(persons) // 2 + 1
    shadows = [middle_of(p) if c < n else np.zeros_like(p) for c, p in enumerate(persons)]
    masks = [p & ~s for p, s in zip(persons, shadows, strict=True)]
    middle = [again & s for again, s in zip(look.masks(masks, shadows), shadows, strict=True)]
    assert sum(int(m.sum()) for m in middle) < 0.25 * sum(int(s.sum()) for s in shadows)


def test_an_empty_room_stays_empty(look: SecondLook, persons: list[np.ndarray]) -> None:
    assert not any(mask.any() for mask in look.masks(nothing(persons), nothing(persons)))


def test_too_few_cameras_are_refused() -> None:
    rig = ring_rig()
    with pytest.raises(ValueError, match="at least 6 cameras"):
        SecondLook(rig.subset(rig.names[: LEAST_CAMERAS - 1]), ROOM)
