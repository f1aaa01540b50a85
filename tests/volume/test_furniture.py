"""Furniture told by the floor behind it: a cupboard, and what must not be taken for one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from test_floor import LIGHT, tiles
from test_occluders import (
    BLOCK,
    BOX,
    CABINET,
    ROOM,
    SIZE,
    hit_box,
    hit_cylinder,
    path,
    pictures,
    rays_of,
    ring_rig,
    seen,
)

from mocap.data import CameraRig
from mocap.volume import OccluderLearner, masks_by_cells, things_on_floor
from mocap.volume.occluders import VOXEL_M, painted

COLUMN = np.array([[0.3, -0.2, 0.0], [0.6, 0.1, 1.7]])
LOWER = np.array([COLUMN[0], [*COLUMN[1, :2], 1.1]])
WOOD = (70.0, 60.0, 160.0)
MAT_AT, MAT_M = np.array([-0.6, 0.4]), 0.5
# Somebody keeps to his place behind it, where others do not come.
LEDGE, STAYS_AT = np.array([[-1.4, -1.15, 0.0], [-0.6, -1.0, 0.9]]), np.array([-1.0, -0.75])
SHELF = np.array([[-1.4, 0.1, 0.0], [-0.6, 0.2, 1.2]])  # beyond his reach on the other side


def empty(i: int, *boxes: np.ndarray, floor: Callable[[np.ndarray], np.ndarray] = tiles) -> np.ndarray:
    """What camera i sees of the empty room, (H, W, 4): its floor, and boxes of wood."""
    eye, rays = rays_of(i)
    with np.errstate(divide="ignore"):
        t = np.where(rays[:, 2] < 0, -eye[2] / rays[:, 2], np.inf)
    colours = np.full((len(rays), 3), 200.0)
    hit = np.isfinite(t)
    colours[hit] = floor(eye[:2] + t[hit, None] * rays[hit, :2])
    for box in boxes:
        colours[hit_box(eye, rays, box) < t] = WOOD
    shown = np.clip(colours * LIGHT[i], 0, 255).reshape(*SIZE[::-1], 3).astype(np.uint8)
    return np.dstack([shown, np.full(SIZE[::-1], 255, np.uint8)])


def things(*boxes: np.ndarray, cameras: range = range(6), **more: object) -> np.ndarray:
    rig = CameraRig(tuple(ring_rig()[i] for i in cameras))
    return things_on_floor(rig, ROOM, [empty(i, *boxes, **more) for i in cameras])  # type: ignore[arg-type]


def inside(points: np.ndarray, box: np.ndarray, by_m: float = 0.0) -> np.ndarray:
    return ((points > box[0] - by_m) & (points < box[1] + by_m)).all(axis=1)


@pytest.mark.parametrize("cameras", [range(6), range(5), range(4)])
def test_what_stands_is_found_before_anybody_walks(cameras: range) -> None:
    points = things(BOX, cameras=cameras)
    assert len(np.unique(points, axis=0)) == len(points)
    assert inside(points, BOX, 2 * VOXEL_M if len(cameras) > 4 else 0.3).mean() > 0.95
    # In the middle of what it is, and half of it: cameras look at its upper edge against the wall.
    assert inside(points, BOX).sum() * VOXEL_M**3 > 0.4 * np.prod(np.ptp(BOX, axis=0))


@pytest.mark.parametrize("cameras", [range(6), range(5), range(4)])
def test_a_column_is_told_up_to_its_top(cameras: range) -> None:
    """Its upper half is seen against walls alone, by all cameras, and leans in their pictures."""
    points = things(COLUMN, cameras=cameras)
    assert inside(points, COLUMN).sum() * VOXEL_M**3 > 0.87 * np.prod(np.ptp(COLUMN, axis=0))
    assert points[:, 2].max() < COLUMN[1, 2] + 0.1
    upper = points[points[:, 2] > 1.0]
    assert inside(upper, COLUMN, 0.15).mean() > 0.95


@pytest.mark.parametrize(
    ("others", "alpha", "goes_on"), [((3,), 255, False), ((3,), 0, True), ((2, 3), 0, False)]
)
def test_three_cameras_see_a_column_go_on_and_none_something_else(
    others: tuple[int, ...], alpha: int, goes_on: bool
) -> None:
    """One shows the wall above its lower half, or one or two do not know what is there."""
    seen = [empty(i, COLUMN) for i in range(4)]
    for i in others:
        eye, rays = rays_of(i)
        upper = np.isfinite(hit_box(eye, rays, COLUMN)) & ~np.isfinite(hit_box(eye, rays, LOWER))
        seen[i][upper.reshape(SIZE[::-1])] = [*[min(200 * LIGHT[i], 255)] * 3, alpha]
    rig = CameraRig(tuple(ring_rig())[:4])
    points = things_on_floor(rig, ROOM, seen)
    assert ((points[:, 2] > LOWER[1, 2] + 0.1).sum() > 100) == goes_on


def test_an_empty_room_holds_nothing() -> None:
    assert len(things()) == 0


def test_a_mat_lies_and_hides_nobody() -> None:
    def floor(xy: np.ndarray) -> np.ndarray:
        is_mat = np.linalg.norm(xy - MAT_AT, axis=1) < MAT_M
        return np.where(is_mat[:, None], WOOD, tiles(xy))

    assert len(things(floor=floor)) == 0


def test_two_cameras_tell_nothing() -> None:
    assert len(things(BOX, cameras=range(2))) == 0


def test_who_is_always_there_is_no_furniture() -> None:
    """A person whom no picture lacks is not known to be empty, whatever colour is painted in."""
    pictures_ = []
    for i in range(6):
        eye, rays = rays_of(i)
        own = empty(i)
        person = np.isfinite(hit_cylinder(eye, rays, np.zeros(2))).reshape(SIZE[::-1])
        own[person] = (*WOOD, 0)
        pictures_.append(own)
    assert len(things_on_floor(ring_rig(), ROOM, pictures_)) == 0
    for own in pictures_:
        own[..., 3] = 255
    assert len(things_on_floor(ring_rig(), ROOM, pictures_)) > 0  # this is what would happen


def test_wood_on_a_wooden_floor_is_not_told() -> None:
    assert len(things(BOX, floor=lambda xy: np.broadcast_to(WOOD, (len(xy), 3)))) == 0


def test_learners_know_things_from_the_first_frame() -> None:
    """Where nobody has been behind them yet."""
    learner = OccluderLearner(ring_rig(), ROOM)
    (masks,) = pictures(path(12)[3:4], with_box=True)
    learner.add(masks_by_cells(masks))
    assert learner.occluders().is_empty
    learner.things = things(BLOCK)
    known = learner.occluders()
    for camera in ring_rig():
        depth = known.depth_m[camera.name]
        eye, rays = rays_of(int(camera.name[1:]))
        true = (hit_box(eye, rays, BLOCK) * (rays @ camera.R[2])).reshape(SIZE[::-1])[2::4, 2::4]
        told = np.isfinite(depth) & np.isfinite(true)
        assert told.sum() > 0.5 * np.isfinite(true).sum()
        # A hull is larger than the thing: it begins before it, and not behind but where its upper edge is not known.
        before = (true - np.where(told, depth, 0.0))[told]
        assert np.quantile(before, 0.2) > -0.1
        assert np.median(before) < 0.4


def test_who_is_seen_through_a_thing_is_believed() -> None:
    """Only cells that have shown nobody hide; others stay as they are known."""
    points, at = things(BLOCK), np.array([0.4, -0.05])
    places = at + 0.02 * np.random.default_rng(1).standard_normal((40, 2))
    through = OccluderLearner(ring_rig(), ROOM)
    through.things = points
    for masks in pictures(places, with_box=False):
        through.add(masks_by_cells(masks))
    known, all_of_it = through.occluders(), painted(ring_rig(), points, VOXEL_M)
    for camera in ring_rig():
        shows = masks_by_cells(pictures(places[:1], with_box=False)[0])[int(camera.name[1:])] == 2
        hides = np.isfinite(known.depth_m[camera.name])
        assert (hides & shows).sum() < 0.2 * shows.sum()
        assert (hides & ~shows).sum() > 0.8 * (np.isfinite(all_of_it.depth_m[camera.name]) & ~shows).sum()


def test_who_walks_about_says_better() -> None:
    plain, told = OccluderLearner(ring_rig(), ROOM), OccluderLearner(ring_rig(), ROOM)
    told.things = things(BLOCK)
    for masks in pictures(path(60), with_box=True):
        plain.add(masks_by_cells(masks))
        told.add(masks_by_cells(masks))
    assert not plain.occluders().is_empty
    for name, depth in plain.occluders().depth_m.items():
        np.testing.assert_array_equal(told.occluders().depth_m[name], depth)


@pytest.mark.parametrize("stays", [True, False])
def test_the_floor_tells_what_stands_before_who_stays_though_others_walk(stays: bool) -> None:
    """And nothing of the same things where nobody stays: there who walks says better."""
    ledge, far_off = cubes(LEDGE), cubes(CABINET)
    learner = OccluderLearner(ring_rig(), ROOM)
    learner.things = np.vstack([ledge, far_off, cubes(SHELF)])
    for k, at in enumerate(path(60)):
        together = (at, STAYS_AT) if stays or k % 3 == 0 else (at,)
        learner.add(masks_by_cells([seen(i, *together, box=LEDGE) for i in range(6)]))
    learner.n_blocked[:] = 0  # what people tell themselves
    known, cabinet = learner.occluders().depth_m, painted(ring_rig(), far_off, VOXEL_M).depth_m
    legs, of_legs, beside, of_cabinet = 0, 0, 0, 0
    for i, camera in enumerate(ring_rig()):
        hides = np.isfinite(known[camera.name])
        lost = masks_by_cells([seen(i, STAYS_AT) & ~seen(i, STAYS_AT, box=LEDGE)])[0] == 2
        middle_m = camera.R[2] @ [*STAYS_AT, 0.9] + camera.t[2]
        assert not (known[camera.name][hides] > middle_m + 0.7).any()
        legs, of_legs = legs + int(lost.sum()), of_legs + int((lost & hides).sum())
        far = np.isfinite(cabinet[camera.name]) & ~near_who_stays(i)
        beside, of_cabinet = beside + int(far.sum()), of_cabinet + int((far & hides).sum())
    assert legs > 50
    assert beside > 500
    assert of_cabinet == 0
    assert (of_legs > 0.8 * legs) if stays else of_legs == 0


def cubes(box: np.ndarray) -> np.ndarray:
    """Middles (N, 3) m of cubes that fill a box."""
    axes = [np.arange(lower, upper, VOXEL_M) + 0.5 * VOXEL_M for lower, upper in box.T]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def near_who_stays(i: int) -> np.ndarray:
    """Cells (h, w) in which somebody at an arm's length round STAYS_AT, with arms raised, may be seen by camera i."""
    turns = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    about = STAYS_AT + 0.5 * np.column_stack([np.cos(turns), np.sin(turns)])
    near = np.logical_or.reduce([seen(i, at) for at in about])
    raised = near | np.roll(near, -16, axis=0)  # by 0.3 m at the least
    return masks_by_cells([raised])[0] > 0
