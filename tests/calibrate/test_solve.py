"""Cameras from drawn corners: known ones are found, as certain as is said, and what cannot be right is refused."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from eval.board_calibration import BOARDS, FLOOR_FRAME, drawn_views, errors, looking_rig
from mocap.calibrate import Board, BoardViews, Lens, WorldPoints, calibrate
from mocap.calibrate.bundle import WORLD, Bundle, adjust
from mocap.calibrate.detect import Sighting
from mocap.calibrate.solve import lens_of_clip
from mocap.calibrate.uncertainty import point_deviations, uncertainty_map
from mocap.data import CameraRig
from mocap.errors import MocapError
from mocap.geometry.triangulation import triangulate

# `python -m eval.board_calibration`, 0.1 px of noise: the worst of 40 seeds.
FOCAL_TOLERANCE = 0.006
PLACE_TOLERANCE_M = 0.015


def check_against(found: CameraRig, truth: CameraRig) -> None:
    focal, place = errors(found, truth)
    assert focal < FOCAL_TOLERANCE
    assert place < PLACE_TOLERANCE_M


def views_of(
    seed: int = 1, board: Board = BOARDS[0], rig: CameraRig | None = None, n: int = 25
) -> BoardViews:
    rng = np.random.default_rng(seed)
    return drawn_views(rig or looking_rig(), n, rng=rng, noise_px=0.1, board=board)


@pytest.mark.parametrize("board", BOARDS, ids=str)
def test_known_cameras_are_found(board: Board) -> None:
    rig = looking_rig()
    found = calibrate(views_of(board=board), world=FLOOR_FRAME)
    check_against(found.rig, rig)
    assert found.adjusted.noise_px == pytest.approx(0.1, rel=0.1)
    assert not found.warnings
    for camera in rig:  # the floor is below the cameras, and z points up
        assert found.rig[camera.name].center[2] == pytest.approx(1.9, abs=PLACE_TOLERANCE_M)


def test_parts_of_boards_count() -> None:
    """Corners outside the pictures are missing there; whole boards alone would be fewer."""
    views = views_of(board=BOARDS[1])
    near = {
        f: {n: Sighting(s.points[: len(s.uv) // 2 + 4], s.uv[: len(s.uv) // 2 + 4]) for n, s in seen.items()}
        for f, seen in views.seen.items()
    }
    check_against(calibrate(replace(views, seen=near), world=FLOOR_FRAME).rig, looking_rig())


def test_the_board_sets_the_scale() -> None:
    views = views_of(5)
    board = replace(views.board, side_m=2 * views.board.side_m)
    larger = {f: {n: Sighting(2 * s.points, s.uv) for n, s in seen.items()} for f, seen in views.seen.items()}
    one = calibrate(views, world=FLOOR_FRAME)
    two = calibrate(replace(views, board=board, seen=larger), world=FLOOR_FRAME)
    for a, b in zip(one.rig, two.rig, strict=True):
        assert b.center == pytest.approx(2 * a.center, rel=1e-4, abs=1e-4)
        np.testing.assert_allclose(b.K, a.K, rtol=1e-4)


def test_a_view_that_fits_nothing_is_left_out() -> None:
    views = views_of()
    frame = next(f for f, seen in views.seen.items() if f != FLOOR_FRAME and len(seen) == 3)
    other = next(f for f, seen in views.seen.items() if f > frame and len(seen) == 3)
    views.seen[frame]["right"] = views.seen[other]["right"]  # a clip that hangs for a frame
    found = calibrate(views, world=FLOOR_FRAME)
    assert found.n_views_of["right"] == views.n_views()["right"] - 1
    check_against(found.rig, looking_rig())


def test_lenses_that_are_given_are_kept() -> None:
    rig = looking_rig()
    lenses = {c.name: Lens.of(c) for c in rig}
    found = calibrate(views_of(), world=FLOOR_FRAME, lenses=lenses)
    for camera in rig:
        np.testing.assert_array_equal(found.rig[camera.name].K, camera.K)
        assert found.focal_deviation[camera.name] == 0
    free = calibrate(views_of(), world=FLOOR_FRAME)
    assert max(found.center_deviation_m.values()) < max(free.center_deviation_m.values())
    assert errors(found.rig, rig)[1] < PLACE_TOLERANCE_M / 2


def test_lenses_come_from_clips_of_their_own() -> None:
    views = views_of(board=BOARDS[1])
    for camera in looking_rig():
        alone = BoardViews(
            views.board,
            {camera.name: camera.size},
            {f: {n: s for n, s in seen.items() if n == camera.name} for f, seen in views.seen.items()},
            views.n_frames,
        )
        lens = lens_of_clip(alone, camera.name, "radial")
        assert np.diag(lens.K)[:2] == pytest.approx(np.diag(camera.K)[:2], rel=2 * FOCAL_TOLERANCE)


def changed(rig: CameraRig, **what: object) -> CameraRig:
    return CameraRig(tuple(replace(c, **what) for c in rig))  # type: ignore[arg-type]


def test_decentring_is_found_where_it_is_asked_for() -> None:
    rig = changed(looking_rig(), dist=np.array([-0.05, 0.0, 0.012, -0.009, 0.0]))
    found = calibrate(views_of(rig=rig, n=40), world=FLOOR_FRAME, model="tangential")
    check_against(found.rig, rig)
    for camera in found.rig:
        assert camera.dist[2:4] == pytest.approx([0.012, -0.009], abs=1.5e-3)
    plain = calibrate(views_of(rig=rig, n=40), world=FLOOR_FRAME)
    assert plain.rms_px > 1.02 * found.rms_px
    assert all((camera.dist[2:4] == 0).all() for camera in plain.rig)


def test_fisheye_lenses_are_found() -> None:
    rig = changed(looking_rig(), dist=np.array([0.05, -0.01, 0.0, 0.0]), is_fisheye=True)
    found = calibrate(views_of(rig=rig, n=40), world=FLOOR_FRAME, model="fisheye")
    assert all(camera.is_fisheye for camera in found.rig)
    focal, place = errors(found.rig, rig)
    assert focal < 2 * FOCAL_TOLERANCE
    assert place < 2 * PLACE_TOLERANCE_M


def test_points_of_known_place_give_the_world() -> None:
    """Another world: turned and shifted, with the points off the board's plane."""
    rig = looking_rig()
    points = np.array(
        [
            [0.5, 0.4, 0.0],
            [-0.4, 0.5, 0.1],
            [0.3, -0.6, 0.0],
            [-0.5, -0.4, 0.9],
            [0.2, 0.1, 1.2],
            [0.0, 0.6, 0.5],
        ]
    )
    rng = np.random.default_rng(0)
    seen = {}
    for camera in rig:
        uv = camera.project(points)[0]
        seen[camera.name] = Sighting(points + np.array([10.0, 5.0, 1.0]), uv + rng.normal(0, 0.1, uv.shape))
    found = calibrate(views_of(board=BOARDS[1]), world=WorldPoints(seen))
    for camera in rig:
        own = found.rig[camera.name].center - [10.0, 5.0, 1.0]
        assert np.linalg.norm(own - camera.center) < PLACE_TOLERANCE_M
    with pytest.raises(MocapError, match="points of known place"):
        calibrate(views_of(), world=WorldPoints({"right": Sighting(points[:3], points[:3, :2])}))


@pytest.mark.parametrize("model", ["radial", "tangential", "fisheye"])
def test_derivatives_are_those_of_the_residuals(model: str) -> None:
    camera = looking_rig()["left"]
    dist = np.array([0.03, -0.02, 0.01, 0.005, 0.0])
    lens = Lens(camera.size, camera.K, dist[:4] if model == "fisheye" else dist, model == "fisheye")
    place = cv2.Rodrigues(camera.R)[0].ravel(), camera.t.copy()
    pose = np.array([0.2, -0.3, 0.4]), np.array([0.1, 0.2, 0.5])
    points = BOARDS[0].points[:7]
    sighting = Sighting(points, np.zeros((7, 2)))
    bundle = Bundle({"left": lens}, {"left": place}, {0: pose}, {(0, "left"): sighting}, model)  # type: ignore[arg-type]
    r, A, B = bundle._projected((0, "left"))
    step = 1e-5
    for k in range(bundle.block):
        d = np.zeros(bundle.block)
        d[k] = step
        up, down = (bundle._moved({"left": way * d}, {}).residuals()[0, "left"] for way in (1, -1))
        np.testing.assert_allclose(A[:, k], (up - down).ravel() / (2 * step), rtol=1e-4, atol=1e-3)
    for k in range(6):
        d = np.zeros(6)
        d[k] = step
        up, down = (bundle._moved({}, {0: way * d}).residuals()[0, "left"] for way in (1, -1))
        np.testing.assert_allclose(B[:, k], (up - down).ravel() / (2 * step), rtol=1e-4, atol=1e-3)
    assert r.shape == (7, 2)


def test_deviations_hold_the_errors() -> None:
    """Over repetitions an error in units of its deviation has a root mean square of one per direction."""
    rig = looking_rig()
    focal, place = [], []
    for seed in range(12):
        found = calibrate(views_of(100 + seed, BOARDS[1], n=18), world=FLOOR_FRAME)
        for camera in rig:
            own = found.rig[camera.name]
            focal.append((own.K[0, 0] / camera.K[0, 0] - 1) / found.focal_deviation[camera.name])
            place.append(np.linalg.norm(own.center - camera.center) / found.center_deviation_m[camera.name])
    assert 0.6 < np.sqrt(np.mean(np.square(focal))) < 1.6
    # The deviation of a place is that along its worst axis: up to sqrt(3) of it in all.
    assert 0.6 < np.sqrt(np.mean(np.square(place))) < 2.2


def test_the_map_agrees_with_drawn_calibrations() -> None:
    """Cameras drawn from the covariance see a point at its pixels, and triangulate it elsewhere."""
    found = calibrate(views_of(board=BOARDS[1]), world=FLOOR_FRAME)
    adjusted, bundle = found.adjusted, found.adjusted.bundle
    points = np.array([[0.1, 0.2, 1.0], [0.6, -0.3, 0.4]])
    stated = point_deviations(adjusted, points)
    rng = np.random.default_rng(0)
    errors = []
    for draw in rng.multivariate_normal(np.zeros(len(adjusted.covariance)), adjusted.covariance, size=400):
        moved = bundle._moved({name: draw[adjusted.block_of(name)] for name in adjusted.names}, {})
        cameras = [moved.camera(name) for name in adjusted.names]
        P, pixels = [], []
        for camera in cameras:
            uv = found.rig[camera.name].project(points)[0]
            rays = camera.rays(uv) @ camera.R.T
            P.append(camera.K @ np.column_stack([camera.R, camera.t]))
            pixels.append((rays / rays[:, 2:]) @ camera.K.T)
        world = triangulate(np.array(P), np.array(pixels)[:, :, :2].transpose(1, 0, 2))
        errors.append(np.linalg.norm(world - points, axis=1))
    drawn = np.sqrt(np.mean(np.square(errors), axis=0))
    np.testing.assert_allclose(drawn, stated, rtol=0.15)
    room = uncertainty_map(adjusted, step_m=0.5)
    assert room.deviation_m.shape == (len(room.y), len(room.x))
    assert np.isnan(point_deviations(adjusted, np.array([[50.0, 0.0, 1.0]]))).all()


def test_what_cannot_be_right_is_refused() -> None:
    views = views_of()
    with pytest.raises(MocapError, match="sees the board in the floor frame"):
        calibrate(views, world=99)
    rare = {f: {n: s for n, s in seen.items() if n != "right" or f < 4} for f, seen in views.seen.items()}
    with pytest.raises(MocapError, match="was found in 4 frames, needed are 6") as caught:
        calibrate(replace(views, seen=rare), world=FLOOR_FRAME)
    assert caught.value.camera == "right"
    apart = {
        f: {n: s for n, s in seen.items() if (n == "right") == (f % 2 == 0)} for f, seen in views.seen.items()
    }
    with pytest.raises(MocapError, match="at the same time as the others") as caught:
        calibrate(replace(views, seen=apart), world=FLOOR_FRAME)
    assert caught.value.camera == "right"


def test_a_board_that_does_not_move_is_refused() -> None:
    views = views_of()
    rng = np.random.default_rng(3)
    still = {
        f: {n: Sighting(s.points, s.uv + rng.normal(0, 0.1, s.uv.shape)) for n, s in views.seen[5].items()}
        for f in range(25)
    }
    with pytest.raises(MocapError, match="the board does not move"):
        calibrate(replace(views, seen=still), world=FLOOR_FRAME)


def test_a_board_that_is_never_tilted_is_refused() -> None:
    """Carried parallel to the pictures: near and a long lens look like far and a short one."""
    rig = looking_rig()
    rng = np.random.default_rng(3)
    seen: dict[int, dict[str, Sighting]] = {}
    middle = rig["middle"]
    for frame in range(25):
        seen[frame] = {}
        at = middle.center + middle.R[2] * 2.0 + middle.R[:2].T @ rng.uniform(-0.3, 0.3, 2)
        for camera in rig:
            uv = camera.project(BOARDS[0].points @ middle.R + at)[0]
            seen[frame][camera.name] = Sighting(BOARDS[0].points, uv + rng.normal(0, 0.1, uv.shape))
    views = BoardViews(BOARDS[0], {c.name: c.size for c in rig}, seen, 25)
    for name in ("left", "right"):
        for sightings in seen.values():
            sightings.pop(name)
    alone = BoardViews(BOARDS[0], {"middle": middle.size}, seen, 25)
    with pytest.raises(MocapError, match=r"uncertain by|determine"):
        calibrate(alone, world=0)
    assert views.names == ["left", "middle", "right"]


def test_stretched_pictures_are_refused() -> None:
    rig = looking_rig()
    wide = CameraRig(
        tuple(
            replace(c, K=c.K * [[1.25], [1.0], [1.0]], size=(int(c.size[0] * 1.25), c.size[1]))
            if c.name == "left"
            else c
            for c in rig
        )
    )
    with pytest.raises(MocapError, match=r"apart by 2. %") as caught:
        calibrate(views_of(rig=wide), world=FLOOR_FRAME)
    assert caught.value.camera == "left"


def test_clips_that_are_not_synchronised_are_named() -> None:
    """One camera a frame late: nothing fits, and it is said."""
    views = views_of(2, BOARDS[1], n=40)
    late = {
        f: {
            n: (views.seen[f + 1].get(n) if n == "right" and f + 1 in views.seen else s)
            for n, s in seen.items()
        }
        for f, seen in views.seen.items()
    }
    kept = {f: {n: s for n, s in seen.items() if s is not None} for f, seen in late.items()}
    with pytest.raises(MocapError, match=r"same time|synchronised"):
        calibrate(replace(views, seen=kept), world=FLOOR_FRAME)


def test_an_undetermined_bundle_is_an_error() -> None:
    camera = looking_rig()["left"]
    place = cv2.Rodrigues(camera.R)[0].ravel(), camera.t.copy()
    sighting = Sighting(BOARDS[0].points[:1], camera.project(BOARDS[0].points[:1])[0])
    bundle = Bundle({"left": Lens.of(camera)}, {"left": place}, {}, {(WORLD, "left"): sighting}, "radial")
    with pytest.raises(np.linalg.LinAlgError):
        adjust(bundle)
