"""The floor as all cameras know it: what a person hides of it from one is told by the others."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from test_occluders import SIZE, hit_cylinder, on_floor, rays_of, ring_rig, standing_silhouettes

from mocap.data import VoxelGrid
from mocap.volume import Floor, FloorPlaces, Witness
from mocap.volume.floor import floor_behind

AT = np.array([0.1, -0.2])
ROOM = VoxelGrid.from_bounds(np.array([-1.5, -1.5, 0.0]), np.array([1.5, 1.5, 2.0]), 0.03)
CUT_M = 0.3  # what stands lower is in no cut
SHOES = (45.0, 60.0, 110.0)
LIGHT = np.linspace(0.8, 1.2, 6)  # of each camera
SHADOW_AT, SHADOW_M = AT + np.array([0.5, 0.4]), 0.3


def tiles(xy: np.ndarray) -> np.ndarray:
    """Colours (N, 3) of a floor of tiles that differ in brightness."""
    colours = np.random.default_rng(3).uniform(115, 135, (20, 20, 1)) * np.array([1.0, 0.95, 0.9])
    at = np.clip(np.floor(xy / 0.3).astype(int) + 10, 0, 19)
    return colours[at[:, 0], at[:, 1]]


def picture(i: int, *, with_person: bool = True) -> np.ndarray:
    """What camera i sees: the floor, a shadow on it, and somebody in one colour from head to shoe."""
    eye, rays = rays_of(i)
    with np.errstate(divide="ignore"):
        t = np.where(rays[:, 2] < 0, -eye[2] / rays[:, 2], np.inf)
    colours = np.full((len(rays), 3), 200.0)
    hit = np.isfinite(t)
    xy = eye[:2] + t[hit, None] * rays[hit, :2]
    colours[hit] = tiles(xy) * np.where(np.linalg.norm(xy - SHADOW_AT, axis=1) < SHADOW_M, 0.6, 1.0)[:, None]
    if with_person:
        colours[np.isfinite(hit_cylinder(eye, rays, AT))] = SHOES
    return np.clip(colours * LIGHT[i], 0, 255).reshape(*SIZE[::-1], 3).astype(np.uint8)


def feet_of(i: int) -> np.ndarray:
    """What camera i sees of the person below CUT_M."""
    eye, rays = rays_of(i)
    t = hit_cylinder(eye, rays, AT)
    with np.errstate(invalid="ignore"):
        return (np.isfinite(t) & (eye[2] + t * rays[:, 2] < CUT_M)).reshape(SIZE[::-1])


@pytest.fixture(scope="module")
def cuts() -> list[np.ndarray]:
    return [person & ~feet_of(i) for i, person in enumerate(standing_silhouettes(AT))]


def floor_of(pictures: list[np.ndarray], free: list[np.ndarray]) -> Floor:
    return Floor(FloorPlaces(ring_rig(), ROOM), [own[None] for own in pictures], [[own] for own in free])


@pytest.fixture(scope="module")
def floor(cuts: list[np.ndarray]) -> Floor:
    under = Witness(ring_rig(), ROOM, cuts).columns(cuts)
    return floor_of(
        [picture(i) for i in range(6)], [~(cut | own) for cut, own in zip(cuts, under, strict=True)]
    )


def difference(floor: Floor, i: int, shown: np.ndarray) -> np.ndarray:
    """Where a picture of camera i differs from the floor that it is told, (H, W) bool."""
    colour, limit = floor.behind(i)
    off = np.abs(cv2.blur(shown, (3, 3)).astype(np.float32) - colour).max(axis=2)
    return (limit >= 0) & (off > limit)


def test_shoes_that_all_cuts_lack_are_no_floor(floor: Floor) -> None:
    for i in range(6):
        feet = feet_of(i)
        assert difference(floor, i, picture(i))[feet].mean() > 0.9


def test_the_floor_that_a_person_hides_is_told_in_each_cameras_light(floor: Floor) -> None:
    for i in range(6):
        empty, near = picture(i, with_person=False), on_floor(i, AT, 0.9)
        assert difference(floor, i, empty)[near].mean() < 0.03  # the shadow lies there for everybody
        colour, _ = floor.behind(i)
        assert np.abs(colour - empty)[feet_of(i)].mean() < 12.0 * LIGHT[i]  # the sole hides a tile from all


def test_without_what_stands_under_legs_shoes_are_taken_for_the_floor(cuts: list[np.ndarray]) -> None:
    naive = floor_of([picture(i) for i in range(6)], [~cut for cut in cuts])
    found = [difference(naive, i, picture(i))[feet_of(i)].mean() for i in range(6)]
    assert np.mean(found) < 0.7


def test_a_floor_about_which_cameras_do_not_agree_is_not_known(cuts: list[np.ndarray]) -> None:
    rng = np.random.default_rng(1)
    shine = [rng.integers(0, 255, picture(i).shape, dtype=np.uint8) for i in range(6)]
    floor = floor_of(shine, [~cut for cut in cuts])
    assert max((floor.behind(i)[1] >= 0).mean() for i in range(6)) < 0.4


def test_what_is_known_lends_its_colour_to_the_rim_of_a_large_place_that_is_not() -> None:
    """Where people walk all the time the middle stays unknown, and is no colour."""
    hidden = [on_floor(i, AT, 0.8) for i in range(6)]
    floor = floor_of([picture(i, with_person=False) for i in range(6)], [~own for own in hidden])
    for i in range(6):
        colour, limit = floor.behind(i)
        assert (limit[on_floor(i, AT, 0.3)] < 0).all()
        rim = hidden[i] & (limit >= 0)
        assert rim.any()
        assert np.abs(colour - picture(i, with_person=False))[rim].mean() < 12.0 * LIGHT[i]


def test_two_cameras_know_no_floor(cuts: list[np.ndarray]) -> None:
    free = [np.zeros_like(cut) if i > 1 else ~cut for i, cut in enumerate(cuts)]
    floor = floor_of([picture(i) for i in range(6)], free)
    assert not any((floor.behind(i)[1] >= 0).any() for i in range(6))


def test_the_floor_behind_a_pixel_projects_there() -> None:
    camera = ring_rig()[2]
    asked = np.arange(0, SIZE[0] * SIZE[1], 7)
    pixels, points = floor_behind(camera, ROOM, asked)
    assert 0 < len(pixels) < len(asked)
    uv, _ = camera.project(points)
    np.testing.assert_allclose(uv, np.column_stack([pixels % SIZE[0], pixels // SIZE[0]]), atol=1e-6)
    assert (np.abs(points[:, :2]) <= 1.5 + 1e-9).all()
    np.testing.assert_allclose(points[:, 2], 0.0, atol=1e-9)
