"""Occluders: a column that hides a walking cylinder, what must not be taken for one, and carving with abstention."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import pytest
from test_volume_carve import SMALLEST_TABLE_MB, hard_scene

from mocap.data import Camera, CameraRig, Occluders, VoxelGrid, n_judges
from mocap.volume import Carver, OccluderLearner, carve_bruteforce, learn_occluders, masks_by_cells
from mocap.volume import _occluder_kernels as kernels
from mocap.volume.carve import unknown_bruteforce
from mocap.volume.occluders import AGAIN_LOOKS, BLOCKED_MARGIN_M, painted, solid_voxels

SIZE = (240, 180)
N_CAMERAS = 6
N_FRAMES = 90
PERSON_RADIUS_M, PERSON_HEIGHT_M = 0.2, 1.75
BOX = np.array([[0.3, -0.5, 0.0], [0.6, 0.4, 0.8]])  # a cupboard that hides legs
BLOCK = np.array([[-0.1, -0.6, 0.0], [0.9, 0.5, 0.72]])  # as large as a table, to the floor
CABINET = np.array([[1.35, -0.6, 0.0], [1.6, 0.3, 1.4]])
ROOM = VoxelGrid.from_bounds(np.array([-1.8, -1.8, 0.0]), np.array([1.8, 1.8, 2.0]), 0.06)


def ring_rig() -> CameraRig:
    cameras = []
    for i in range(N_CAMERAS):
        angle = 2 * np.pi * (i + 0.3) / N_CAMERAS
        eye = np.array([3.2 * np.cos(angle), 3.2 * np.sin(angle), 1.7])
        forward = np.array([0.0, 0.0, 0.8]) - eye
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        R = np.array([right, np.cross(forward, right), forward])
        K = np.array([[150.0, 0.0, SIZE[0] / 2], [0.0, 150.0, SIZE[1] / 2], [0.0, 0.0, 1.0]])
        cameras.append(Camera(f"c{i}", SIZE, K, np.zeros(4), R, -R @ eye))
    return CameraRig(tuple(cameras))


@lru_cache
def rays_of(i: int) -> tuple[np.ndarray, np.ndarray]:
    camera = ring_rig()[i]
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    return camera.center, camera.rays(np.stack([u, v], axis=-1).reshape(-1, 2).astype(float))


def hit_cylinder(eye: np.ndarray, rays: np.ndarray, at: np.ndarray, foot_m: float = 0.0) -> np.ndarray:
    """Distance along rays (N, 3) to the person, inf beside it.  foot_m : over the floor, the head stays."""
    d, o = rays[:, :2], eye[:2] - at
    a, b, c = (d**2).sum(axis=1), d @ o, o @ o - PERSON_RADIUS_M**2
    root = b**2 - a * c
    t = (-b - np.sqrt(np.maximum(root, 0.0))) / a
    z = eye[2] + t * rays[:, 2]
    return np.where((root > 0) & (z > foot_m) & (z < PERSON_HEIGHT_M), t, np.inf)


def standing_silhouettes(at: np.ndarray) -> list[np.ndarray]:
    """What every camera sees of the person at (2,) m."""
    return [seen(i, at) for i in range(N_CAMERAS)]


def seen(i: int, *places: np.ndarray, box: np.ndarray | None = None) -> np.ndarray:
    """Mask (H, W) of camera i of persons at places (2,) m, behind a box."""
    eye, rays = rays_of(i)
    nearest = np.min([hit_cylinder(eye, rays, at) for at in places], axis=0)
    return (nearest < (np.inf if box is None else hit_box(eye, rays, box))).reshape(SIZE[::-1])


def on_floor(i: int, xy: np.ndarray, radius_m: float) -> np.ndarray:
    """What camera i sees of a disc on the floor."""
    eye, rays = rays_of(i)
    with np.errstate(divide="ignore"):
        t = -eye[2] / rays[:, 2]
    at = eye[:2] + t[:, None] * rays[:, :2]
    return ((t > 0) & (np.linalg.norm(at - xy, axis=1) < radius_m)).reshape(SIZE[1], SIZE[0])


def hit_box(eye: np.ndarray, rays: np.ndarray, box: np.ndarray = BOX) -> np.ndarray:
    with np.errstate(divide="ignore"):
        t = (box[:, None] - eye) / rays
    near, far = t.min(axis=0).max(axis=1), t.max(axis=0).min(axis=1)
    return np.where((near < far) & (near > 0), near, np.inf)


def path(n: int) -> np.ndarray:
    """Places (n, 2) of a person who walks round the cupboard."""
    turn = np.linspace(0.0, 2 * np.pi, n, endpoint=False)
    return np.column_stack([0.4 + 0.75 * np.cos(turn), -0.05 + 0.95 * np.sin(turn)])


def pictures(*places: np.ndarray, with_box: bool) -> list[list[np.ndarray]]:
    """Masks per frame and camera.  places : (n, 2) of each person."""
    box = BOX if with_box else None
    return [[seen(i, *together, box=box) for i in range(N_CAMERAS)] for together in zip(*places, strict=True)]


@lru_cache
def clip(with_box: bool) -> list[list[np.ndarray]]:
    return pictures(path(N_FRAMES), with_box=with_box)


@lru_cache
def learnt() -> Occluders:
    return learn_occluders(ring_rig(), ROOM, clip(True))


def volume_of(occluders: Occluders | None, masks: list[np.ndarray]) -> np.ndarray:
    return Carver(ring_rig(), ROOM, occluders=occluders).carve(masks, n_faulty_views=0)


def test_a_cupboard_is_learnt_and_legs_behind_it_are_carved():
    whole, plain, aware, surplus = 0, 0, 0, 0
    for masks, complete in list(zip(clip(True), clip(False), strict=True))[::6]:
        true = volume_of(None, complete)
        seen, better = volume_of(None, masks), volume_of(learnt(), masks)
        whole += len(true)
        plain += len(np.intersect1d(true, seen))
        aware += len(np.intersect1d(true, better))
        surplus += len(np.setdiff1d(better, true))
    assert plain < 0.75 * whole  # the experiment is worth something: a third is hidden from somebody
    assert aware > 0.95 * whole
    assert surplus < 0.15 * whole


def test_the_learner_knows_early_that_something_stands_there():
    with_box, without = OccluderLearner(ring_rig(), ROOM), OccluderLearner(ring_rig(), ROOM)
    has_found = []
    for masks, complete in zip(clip(True), clip(False), strict=True):
        with_box.add(masks_by_cells(masks))
        without.add(masks_by_cells(complete))
        has_found.append(with_box.has_found)
        assert not without.has_found
    assert not has_found[0]
    assert has_found[N_FRAMES // 2]
    assert has_found[-1]


def test_a_map_begins_before_what_it_hides_and_not_before_the_camera():
    for i, camera in enumerate(ring_rig()):
        depth = learnt().of(camera)
        if depth is None:
            continue
        eye, rays = rays_of(i)
        true = (hit_box(eye, rays) * (rays @ camera.R[2])).reshape(SIZE[::-1])[2::4, 2::4]
        both = np.isfinite(depth) & np.isfinite(true)
        assert np.median(np.abs(depth[both] - true[both])) < 0.2  # four voxels


def test_nothing_is_learnt_in_an_empty_room():
    assert learn_occluders(ring_rig(), ROOM, clip(False)).is_empty


def circle(n: int, x: float, y: float, start: float) -> np.ndarray:
    """Places (n, 2) of a person who walks on a small circle round (x, y)."""
    turn = start + np.linspace(0.0, 2 * np.pi, n, endpoint=False)
    return np.column_stack([x + 0.4 * np.cos(turn), y + 0.6 * np.sin(turn)])


def test_phantoms_between_persons_are_no_witnesses():
    n = 40
    stays = np.tile([0.1, 1.2], (n, 1))
    two = (circle(n, -0.8, -0.3, 0.4), circle(n, 0.8, -0.2, 2.5))
    for persons in (two, (*two, stays)):
        frames = pictures(*persons, with_box=False)
        generous = Carver(ring_rig(), ROOM).carve(frames[0], n_faulty_views=2)
        true = Carver(ring_rig(), ROOM).carve(frames[0], n_faulty_views=0)
        assert len(generous) > 2 * len(true)  # the experiment is worth something
        assert learn_occluders(ring_rig(), ROOM, frames).is_empty


@pytest.mark.parametrize("chosen", [(0, 2, 4), (0, 1, 3), (3, 4, 5)])
def test_phantoms_of_two_persons_are_no_witnesses_for_three_cameras(chosen):
    n = 40
    walkers = circle(n, -0.8, -0.3, 0.4), circle(n, 0.8, -0.2, 2.5)
    frames = [[masks[i] for i in chosen] for masks in pictures(*walkers, with_box=False)]
    rig = CameraRig(tuple(ring_rig()[i] for i in chosen))
    generous = Carver(rig, ROOM).carve(frames[0], n_faulty_views=1, min_votes=2)
    true = Carver(rig, ROOM).carve(frames[0], n_faulty_views=0)
    assert len(generous) > 2 * len(true)  # the experiment is worth something
    assert learn_occluders(rig, ROOM, frames).is_empty


def test_a_cupboard_is_learnt_from_two_persons():
    n, places = N_FRAMES, path(N_FRAMES)
    walkers = places, np.roll(places, n // 2, axis=0)
    seen, complete = (pictures(*walkers, with_box=with_box) for with_box in (True, False))
    found = learn_occluders(ring_rig(), ROOM, seen)
    whole, plain, aware, surplus = 0, 0, 0, 0
    for masks, entire in list(zip(seen, complete, strict=True))[::6]:
        true = volume_of(None, entire)
        better = volume_of(found, masks)
        whole += len(true)
        plain += len(np.intersect1d(true, volume_of(None, masks)))
        aware += len(np.intersect1d(true, better))
        surplus += len(np.setdiff1d(better, true))
    assert plain < 0.8 * whole
    assert aware > 0.85 * whole
    assert surplus < 0.25 * whole


def test_holes_that_come_and_go_with_the_person_are_no_furniture():
    rng, frames = np.random.default_rng(5), []
    for masks in clip(False):
        own = [m.copy() for m in masks]
        rows = np.flatnonzero(own[2].any(axis=1))
        first = int(rng.integers(rows[0], rows[-1]))
        own[2][first : first + len(rows) // 6] = False
        frames.append(own)
    assert learn_occluders(ring_rig(), ROOM, frames).is_empty


def test_a_cupboard_hides_who_goes_behind_it_though_others_were_seen_before_it():
    """Somebody seen at a pixel says nothing against what stands farther away there."""
    along = np.linspace(-0.6, 0.5, 14)
    before = np.column_stack([0.85 + 0.3 * (along + 0.05), along])
    behind = [np.column_stack([np.full(14, -0.05 - 0.06 * k), along[:: (-1) ** k]]) for k in range(8)]
    found = learn_occluders(ring_rig(), ROOM, pictures(np.concatenate([before, *behind]), with_box=True))
    camera = ring_rig()[0]
    points = np.concatenate([np.column_stack([b, np.full(14, z)]) for b in behind[::3] for z in (0.2, 0.4)])
    reach = hit_box(camera.center, points - camera.center)  # of one on the way there
    assert found.hides(camera, points[reach < 0.95]).mean() > 0.9
    shown = np.column_stack([before, np.full(14, 0.4)])
    assert not found.hides(camera, shown).any()


def block(learner: OccluderLearner, c: int, points: np.ndarray, n: int) -> np.ndarray:
    """Votes of camera c that something stands before what lies behind points (N, 3) m; its cells (h, w) that vote."""
    cubes = painted(ring_rig(), points, 0.05).depth_m[f"c{c}"]
    verdict = np.where(np.isfinite(cubes), kernels.BLOCKED, kernels.NO_VOTE).astype(np.uint8)
    for _ in range(n):
        learner._vote(c, cubes + np.float32(0.5), verdict)
    return verdict == kernels.BLOCKED


def test_what_hid_somebody_from_one_camera_says_nothing_to_the_others():
    learner, rig = OccluderLearner(ring_rig(), ROOM), ring_rig()
    side = np.arange(-0.2, 0.2, 0.05)
    thing = np.stack(np.meshgrid(side, side, side + 0.75), axis=-1).reshape(-1, 3)
    behind = [np.array([[0.0, 0.0, 0.75]]) * 1.2 - 0.2 * camera.center for camera in rig]
    cells = block(learner, 2, thing, 9)
    hidden = [learner.occluders().hides(camera, point)[0] for camera, point in zip(rig, behind, strict=True)]
    assert hidden == [False, False, True, False, False, False]
    is_known = np.isfinite(learner.occluders().depth_m["c2"])
    assert is_known[cells].all()
    beside = cv2.dilate(cells.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert not is_known[~beside].any()  # voxels near the camera are larger than cells
    block(learner, 4, thing, 2)  # rays of two cross there: it is a thing
    hidden = [learner.occluders().hides(camera, point)[0] for camera, point in zip(rig, behind, strict=True)]
    assert all(hidden)


def test_who_stands_still_is_one_vote_in_so_many_looks():
    masks = clip(True)[0]
    learner = OccluderLearner(ring_rig(), ROOM)
    assert learner.add(masks_by_cells(masks))
    before = learner.n_blocked.copy()
    said = [learner.add(masks_by_cells(masks)) for _ in range(2 * AGAIN_LOOKS)]
    assert np.flatnonzero(said).tolist() == [AGAIN_LOOKS - 1, 2 * AGAIN_LOOKS - 1]
    np.testing.assert_array_equal(learner.n_blocked, 3 * before)


def test_a_camera_from_which_somebody_in_his_place_is_hidden_is_not_asked():
    at = np.array([0.2, 0.1])
    masks = standing_silhouettes(at)
    masks[1] = np.zeros_like(masks[1])
    found = learn_occluders(ring_rig(), ROOM, [masks] * (5 * AGAIN_LOOKS))
    assert found.hides(ring_rig()[1], np.array([[*at, 0.9]])).all()


def test_legs_that_two_cameras_see_are_not_taken_for_air():
    """A low wall before each of four of six cameras."""
    rig, frames = ring_rig(), [[m.copy() for m in masks] for masks in clip(False)]
    tops = [camera.project(np.array([[0.4, -0.05, 0.9]]))[0][0, 1] for camera in rig]
    for masks in frames:
        for mask, top in list(zip(masks, tops, strict=True))[:4]:
            mask[int(top) :] = False
    found = learn_occluders(rig, ROOM, frames)
    legs = np.column_stack([path(N_FRAMES), np.full(N_FRAMES, 0.4)])
    for camera, top in list(zip(rig, tops, strict=True))[:4]:
        is_hidden = camera.project(legs)[0][:, 1] > top + 4  # a cell
        assert is_hidden.mean() > 0.5
        assert found.hides(camera, legs[is_hidden]).mean() > 0.9
    assert max(found.hides(camera, legs).mean() for camera in list(rig)[4:]) < 0.15
    assert not any(found.hides(camera, legs + np.array([0.0, 0.0, 1.0])).any() for camera in rig)


@pytest.mark.parametrize(
    "chosen", [(0, 1, 3, 4), (0, 2, 3, 5), (0, 1, 2, 4), (0, 2, 4), (0, 3, 5), (1, 2, 5)]
)
@pytest.mark.parametrize("things", [(BOX, CABINET), (BLOCK, CABINET)], ids=["cupboard", "block"])
def test_with_three_or_four_cameras_things_that_hide_from_one_or_two_at_once_are_learnt(things, chosen):
    """The others see what the hull lacks: they were taken for cameras that have moved, and nothing was learnt."""
    rig, walk = CameraRig(tuple(ring_rig()[i] for i in chosen)), path(N_FRAMES)
    frames = []
    for at in walk:
        views = [rays_of(i) for i in chosen]
        seen = [
            hit_cylinder(*v, at) < np.min([hit_box(*v, thing) for thing in things], axis=0) for v in views
        ]
        frames.append([mask.reshape(SIZE[::-1]) for mask in seen])
    found = learn_occluders(rig, ROOM, frames)
    n_hidden, n_known, n_seen, n_wrong = 0, 0, 0, 0
    for height in (0.2, 0.45):
        legs = np.column_stack([walk, np.full(N_FRAMES, height)])
        for camera in rig:
            towards = legs - camera.center
            is_hidden = np.min([hit_box(camera.center, towards, thing) for thing in things], axis=0) < 1.0
            behind = found.hides(camera, legs)
            n_hidden, n_known = n_hidden + is_hidden.sum(), n_known + (behind & is_hidden).sum()
            n_seen, n_wrong = n_seen + (~is_hidden).sum(), n_wrong + (behind & ~is_hidden).sum()
    assert n_hidden > 0.2 * (n_hidden + n_seen)
    assert n_known > 0.9 * n_hidden
    assert n_wrong < 0.05 * n_seen


def test_who_jumps_has_no_hidden_legs():
    """Nobody shows anything below his feet."""
    frames = []
    for at in path(N_FRAMES)[::2]:
        seen = [np.isfinite(hit_cylinder(*rays_of(i), at, foot_m=0.5)) for i in range(N_CAMERAS)]
        frames.append([mask.reshape(SIZE[::-1]) for mask in seen])
    assert learn_occluders(ring_rig(), ROOM, frames).is_empty


@pytest.mark.parametrize("shift_px", [15, 18, 25])
def test_a_camera_that_was_pushed_at_half_of_the_clip_is_hidden_by_nothing(shift_px: int):
    frames = [list(masks) for masks in clip(False)]
    for masks in frames[len(frames) // 2 :]:
        masks[2] = np.roll(masks[2], shift_px, axis=1)
    assert learn_occluders(ring_rig(), ROOM, frames).is_empty


def test_the_order_of_cameras_does_not_matter():
    order = [4, 0, 5, 2, 1, 3]
    rig = CameraRig(tuple(ring_rig()[i] for i in order))
    other = learn_occluders(rig, ROOM, [[masks[i] for i in order] for masks in clip(True)])
    for name, depth in learnt().depth_m.items():
        np.testing.assert_array_equal(other.depth_m[name], depth)


def test_frames_in_which_nobody_is_seen_say_nothing():
    nobody = [np.zeros(SIZE[::-1], dtype=np.bool_)] * N_CAMERAS
    with_gap = [*clip(True)[:40], *[nobody] * 20, *clip(True)[40:]]
    found = learn_occluders(ring_rig(), ROOM, with_gap)
    for name, depth in learnt().depth_m.items():
        np.testing.assert_array_equal(found.depth_m[name], depth)


def test_a_camera_that_never_sees_anybody_is_hidden_where_they_walk():
    frames = [[*masks[:3], np.zeros_like(masks[3]), *masks[4:]] for masks in clip(False)]
    found = learn_occluders(ring_rig(), ROOM, frames)
    camera = ring_rig()[3]
    middle = np.column_stack([path(N_FRAMES), np.full(N_FRAMES, 0.9)])
    assert found.hides(camera, middle).mean() > 0.9
    assert not any(found.hides(c, middle).any() for i, c in enumerate(ring_rig()) if i != 3)


def test_two_cameras_learn_nothing():
    rig = CameraRig(tuple(ring_rig())[:2])
    assert learn_occluders(rig, ROOM, [masks[:2] for masks in clip(True)]).is_empty
    with pytest.raises(ValueError, match="at least 3 cameras"):
        OccluderLearner(rig, ROOM)


def random_occluders(rig: CameraRig, rng: np.random.Generator) -> Occluders:
    """Rectangles at random depths in most pictures, which may have pixels left over beside the last cell."""
    maps = {}
    for camera in rig:
        left_over = rng.integers(0, 2)
        w, h = ((n + 3 * (1 - left_over)) // 4 for n in camera.size)
        depth = np.full((h, w), np.inf, dtype=np.float32)
        if rng.random() < 0.8:
            (v0, v1), (u0, u1) = (np.sort(rng.integers(0, n + 1, 2)) for n in (h, w))
            v0, u0 = (0 if rng.random() < 0.5 else n for n in (v0, u0))
            v1, u1 = (m if rng.random() < 0.5 else n for m, n in ((h, v1), (w, u1)))
            depth[v0:v1, u0:u1] = rng.uniform(0.3, 2.5)
        maps[camera.name] = depth
    return Occluders(maps, 4)


@pytest.mark.parametrize("seed", range(12))
def test_carving_and_the_unknown_equal_their_definitions(seed):
    rig, grid, masks = hard_scene(seed)
    occluders = random_occluders(rig, np.random.default_rng(seed))
    for carver in (
        Carver(rig, grid, occluders=occluders),
        Carver(rig, grid, occluders=occluders, max_table_mb=3 * SMALLEST_TABLE_MB),
    ):
        for k in range(min(3, len(rig))):
            expected = carve_bruteforce(rig, grid, masks, n_faulty_views=k, occluders=occluders)
            np.testing.assert_array_equal(carver.carve(masks, n_faulty_views=k), expected)
            if occluders.is_empty:
                continue
            unknown = unknown_bruteforce(rig, grid, masks, occluders, n_faulty_views=k)
            box = np.array([-1, 2, 0]), np.array([*grid.shape]) - [1, 0, 2]
            inside = np.all((s := grid.subscripts(unknown)) >= box[0], axis=1) & np.all(s < box[1], axis=1)
            np.testing.assert_array_equal(carver.unknown(masks, *box, n_faulty_views=k), unknown[inside])


@pytest.mark.parametrize("seed", range(20, 28))
def test_abstention_takes_no_voxel_away_but_makes_it_unknown(seed):
    rig, grid, masks = hard_scene(seed)
    occluders = random_occluders(rig, np.random.default_rng(seed))
    plain = carve_bruteforce(rig, grid, masks, n_faulty_views=0)
    aware = carve_bruteforce(rig, grid, masks, n_faulty_views=0, occluders=occluders)
    unknown = unknown_bruteforce(rig, grid, masks, occluders, n_faulty_views=0)
    assert len(np.intersect1d(aware, unknown)) == 0
    assert len(np.setdiff1d(plain, np.union1d(aware, unknown))) == 0


def test_a_box_of_pixels_may_be_hidden_where_one_of_its_pixels_may():
    rig, grid, _ = hard_scene(3)
    camera = rig[0]
    (width, height), cell = camera.size, 16
    assert width % cell
    assert height % cell
    depth = np.full((height // cell, width // cell), np.inf, dtype=np.float32)
    depth[-1, -1], depth[0, 1] = 1.0, 2.0
    carver = Carver(rig, grid, occluders=Occluders({camera.name: depth}, cell))
    v, u = (
        np.minimum(np.arange(n) // cell, m - 1) for n, m in zip((height, width), depth.shape, strict=True)
    )
    by_pixel = np.isfinite(depth[np.ix_(v, u)])
    rng = np.random.default_rng(0)
    boxes = [*(np.sort(rng.integers(0, n, (400, 2)), axis=1) for n in (width, height))]
    narrow = np.array([[width - 1, width - 1, height - 1, height - 1], [0, 0, height - 1, height - 1]])
    boxes = np.concatenate([np.hstack(boxes), narrow]).astype(np.int16)
    expected = [by_pixel[v0 : v1 + 1, u0 : u1 + 1].any() for u0, u1, v0, v1 in boxes]
    np.testing.assert_array_equal(carver._may_hide(camera, boxes), expected)
    assert 0 < np.mean(expected) < 1
    assert not carver._may_hide(rig[1], boxes).any()


def test_no_occluders_is_the_same_as_empty_ones():
    rig, grid, masks = hard_scene(3)
    carver = Carver(rig, grid, occluders=Occluders({}, 4))
    np.testing.assert_array_equal(
        carver.carve(masks, n_faulty_views=0), Carver(rig, grid).carve(masks, n_faulty_views=0)
    )
    assert len(carver.unknown(masks, np.zeros(3, int), np.array(grid.shape), n_faulty_views=0)) == 0


def test_occluders_and_a_strict_border_exclude_each_other():
    rig, grid, masks = hard_scene(3)
    carver = Carver(rig, grid, occluders=random_occluders(rig, np.random.default_rng(1)))
    with pytest.raises(ValueError, match="occluders"):
        carver.carve(masks, n_faulty_views=0, outside="background")


def test_judges_are_the_cameras_before_whom_nothing_stands():
    rig = ring_rig()
    points = np.array([[-0.5, 0.2, 1.0], [0.1, -0.3, 0.2], [0.0, 0.0, 40.0]])
    inside = sum(c.contains(c.project(points)[0]).astype(int) for c in rig)
    hidden = sum(learnt().hides(c, points).astype(int) for c in rig)
    np.testing.assert_array_equal(n_judges(rig, points, None), inside)
    np.testing.assert_array_equal(n_judges(rig, points, learnt()), inside - hidden)
    assert inside[2] == 0


def test_hidden_pixels_are_those_of_things_before_the_person():
    camera = ring_rig()[0]
    depth = np.full((45, 60), np.inf, dtype=np.float32)
    depth[10:20, 5:9], depth[30:40, 5:9] = 1.5, 3.5
    occluders = Occluders({"c0": depth}, 4)
    somebody = camera.unproject(np.array([[100.0, 90.0], [120.0, 80.0]]), np.array([2.5, 2.7]))
    hidden = occluders.hidden_pixels(camera, somebody)
    expected = np.zeros((180, 240), dtype=np.bool_)
    expected[40:80, 20:36] = True
    np.testing.assert_array_equal(hidden, expected)
    assert (
        occluders.hidden_pixels(camera, camera.unproject(np.array([[100.0, 90.0]]), np.array([1.0]))) is None
    )
    assert occluders.hidden_pixels(ring_rig()[1], somebody) is None


def test_votes_that_decide():
    space = VoxelGrid(np.zeros(3), (6, 7, 8), 0.05)
    n_blocked = np.zeros((2, space.n_voxels), dtype=np.uint16)
    n_free = np.zeros(space.n_voxels, dtype=np.uint16)
    thing = space.linear(np.array([[x, y, 1] for x in range(4) for y in range(5)]))
    n_blocked[0, thing] = 1
    n_blocked[1, thing[2:]] = 1
    assert len(solid_voxels(space, n_free, n_blocked)) == 0  # nowhere sure
    n_blocked[1, thing[5]] = 7
    np.testing.assert_array_equal(solid_voxels(space, n_free, n_blocked), np.sort(thing[2:]))
    n_free[thing[2]] = 1
    np.testing.assert_array_equal(solid_voxels(space, n_free, n_blocked), np.sort(thing[3:]))
    n_blocked[:, thing[7:]] = 0
    assert len(solid_voxels(space, n_free, n_blocked)) == 0  # six voxels, three quarters of a litre


# ------------------------------------------------------------------------------------ kernels and their twins


def cells_of_squares(cell: int, half: int, width: int, height: int) -> np.ndarray:
    """Which cells (height * width,) bool a square covers, by the definition."""
    v, u = np.mgrid[:height, :width]
    return ((np.abs(v - cell // width) <= half) & (np.abs(u - cell % width) <= half)).ravel()


def test_paint_nearest_is_the_smallest_depth_over_squares():
    rng = np.random.default_rng(4)
    cell = rng.integers(-1, 24 * 32, 70).astype(np.int32)
    depth, half = rng.uniform(0.5, 4.0, 70).astype(np.float32), rng.integers(0, 4, 70).astype(np.int32)
    is_painted, beyond = rng.random(70) < 0.8, rng.uniform(0.0, 3.0, (24, 32)).astype(np.float32)
    expected = np.full(24 * 32, np.inf, dtype=np.float32)
    for k, d, r in zip(cell[is_painted], depth[is_painted], half[is_painted], strict=True):
        if k >= 0:
            own = cells_of_squares(k, r, 32, 24) & (beyond.ravel() < d)
            expected[own] = np.minimum(expected[own], d)
    for run in (kernels.paint_nearest, kernels.paint_nearest.py_func):
        got = np.full((24, 32), np.inf, dtype=np.float32)
        run(cell, depth, half, is_painted, beyond, got)
        np.testing.assert_array_equal(got.ravel(), expected)


def needed_by_definition(cell, half, sees, n_objecting, n_needing, sizes, masks) -> np.ndarray:
    is_needed = np.zeros(cell.shape[1], dtype=np.bool_)
    left = [mask.copy() for mask in masks]
    for level in range(len(cell) + 1):
        own = n_objecting == level
        n_left = np.sum([s & m[k] for s, m, k in zip(sees, left, cell, strict=True)], axis=0)
        newly = own & ((n_left >= n_needing) | (level == 0))
        is_needed |= newly
        for c, (width, height) in enumerate(sizes):
            for i in np.flatnonzero(newly & sees[c]):
                left[c][cells_of_squares(cell[c, i], half[c, i], width, height)] = False
    return is_needed


@pytest.mark.parametrize("seed", range(4))
def test_needed_voxels_are_those_that_nothing_surer_explains(seed):
    rng, sizes, n = np.random.default_rng(seed), [(22, 19), (21, 18), (23, 17), (19, 20), (20, 21)], 300
    masks = [rng.random(w * h) < 0.7 for w, h in sizes]
    cell = np.array([rng.integers(-1, w * h, n) for w, h in sizes], dtype=np.int32)
    half = rng.integers(0, 2, cell.shape).astype(np.int32)
    sees = np.array([(k >= 0) & m[k] for k, m in zip(cell, masks, strict=True)])
    n_objecting = ((cell >= 0) & ~sees).sum(axis=0)
    n_objecting[n_objecting == 0] = rng.integers(0, 2, np.count_nonzero(n_objecting == 0))
    expected = needed_by_definition(cell, half, sees, n_objecting, 2, sizes, masks)
    assert 0 < expected[n_objecting > 1].mean() < 1
    first = np.cumsum([0, *(w * h for w, h in sizes)])
    for run in (kernels.needed_voxels, kernels.needed_voxels.py_func):
        is_needed = np.zeros(n, dtype=np.bool_)
        width = np.array([w for w, _ in sizes])
        run(cell, half, sees, n_objecting, 2, width, first, np.concatenate(masks), is_needed)
        np.testing.assert_array_equal(is_needed, expected)


def test_sort_by_cell_groups_points_in_their_order():
    cell = np.array([3, -1, 0, 3, 5, 0, -1, 3], dtype=np.int32)
    first, rows = np.empty(7, dtype=np.int64), np.empty(6, dtype=np.int32)
    for run in (kernels.sort_by_cell, kernels.sort_by_cell.py_func):
        run(cell, first, rows)
        np.testing.assert_array_equal(first, [0, 2, 2, 2, 5, 5, 6])
        np.testing.assert_array_equal(rows, [2, 5, 0, 3, 7, 4])


def test_votes_go_to_what_lies_well_before_the_person():
    first = np.array([0, 3, 5, 6], dtype=np.int64)
    rows = np.array([4, 0, 2, 1, 5, 3], dtype=np.int32)
    depth = np.array([1.0, 1.95, 3.0, 0.5, 2.5, 0.1], dtype=np.float32)
    near = np.array([2.0, 1.0, np.inf], dtype=np.float32)
    verdict = np.array([kernels.FREE, kernels.BLOCKED, kernels.NO_VOTE], dtype=np.uint8)
    for run in (kernels.vote_along_rays, kernels.vote_along_rays.py_func):
        n_free, n_blocked = np.zeros((2, 6), dtype=np.uint16)
        n_free[4] = 65535  # full counters stay full
        run(near, verdict, first, rows, depth, BLOCKED_MARGIN_M, n_free, n_blocked)
        np.testing.assert_array_equal(n_free, [0, 0, 0, 0, 65535, 0])
        np.testing.assert_array_equal(n_blocked, [0, 1, 0, 0, 0, 0])


def test_pixels_are_hidden_behind_the_map_only():
    map_depth = np.array([[1.0, np.inf], [2.0, 0.5]], dtype=np.float32)
    axis = np.array([0.0, 0.0, 1.0, 0.25])
    xs = ys = np.zeros(5)
    zs = np.array([0.7, 0.8, 9.0, 1.8, 0.3])
    pixels = np.array(
        [0, 9, 5, -1, 8 * 7 + 4], dtype=np.int32
    )  # 8 wide: (0, 0), (1, 1), (5, 0), outside, (4, 7)
    for run in (kernels.hide_pixels, kernels.hide_pixels.py_func):
        own = pixels.copy()
        run(own, xs, ys, zs, axis, 8, 4, map_depth, -2)
        np.testing.assert_array_equal(own, [0, -2, 5, -1, -2])
