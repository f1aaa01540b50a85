"""Faults of keypoints that geometry tells: each is named, with its camera; good keypoints are not blamed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from keypoint_world import KeypointWorld, keypoint_world
from numpy.typing import NDArray

from mocap.data import CameraRig
from mocap.data.keypoints import KEYPOINTS, MIRRORED
from mocap.likelihood.markers import marker_views, undistort
from mocap.tracking.figure_faults import (
    Clip,
    FaultSettings,
    FigureFault,
    find_figure_faults,
    find_picture_fault,
)
from mocap.tracking.figures import FigureSettings, FigureViews, View2D, persons_of_figures

FPS = 25.0
N = 60


def figures_of(world: KeypointWorld) -> dict[int, list[View2D]]:
    return {
        f: [
            View2D(c, undistort(world.rig[c], p[:, :2]), np.nan_to_num(p[:, 2]))
            for c, seen in enumerate(frame)
            for p in seen
        ]
        for f, frame in enumerate(world.figures)
    }


def faults(figures: dict[int, list[View2D]], world: KeypointWorld) -> list[FigureFault]:
    own = marker_views(world.rig)
    views, settings = FigureViews(own.P, own.focal), FigureSettings()
    persons = persons_of_figures(figures, views, FPS, settings)
    return find_figure_faults(Clip(figures, persons, views, world.rig.names, FPS, settings, FaultSettings()))


@pytest.fixture(scope="module")
def world() -> KeypointWorld:
    return keypoint_world(N, noise_px=3.0, n_cameras=5)


def mirrored(figure: View2D) -> View2D:
    return replace(figure, uv=figure.uv[MIRRORED], confidence=figure.confidence[MIRRORED])


def test_good_keypoints_are_not_blamed(world: KeypointWorld) -> None:
    assert faults(figures_of(world), world) == []
    two = keypoint_world(N, noise_px=3.0, apart_m=1.1)
    assert faults(figures_of(two), two) == []


@pytest.mark.parametrize("order", [(0, 3, 2, 1, 4), (2, 0, 1, 4, 3)])
def test_exchanged_cameras_are_named(world: KeypointWorld, order: tuple[int, ...]) -> None:
    """Camera c is given the file of camera order[c]."""
    figures = {
        f: [replace(g, camera=order.index(g.camera)) for g in seen] for f, seen in figures_of(world).items()
    }
    (fault,) = faults(figures, world)
    assert "are exchanged" in fault.message
    for c, file in enumerate(order):
        # What camera c is called has the keypoints of camera `file`: they fit there.
        assert (f"those of cam_{c} fit camera cam_{file}" in fault.message) == (c != file)


def test_mirrored_names_of_one_camera_are_named(world: KeypointWorld) -> None:
    figures = {
        f: [mirrored(g) if g.camera == 2 else g for g in seen] for f, seen in figures_of(world).items()
    }
    (fault,) = faults(figures, world)
    assert "left and right are exchanged in the keypoints of camera cam_2" in fault.message
    assert fault.camera == 2


def test_mirrored_names_of_all_cameras_are_named(world: KeypointWorld) -> None:
    figures = {f: [mirrored(g) for g in seen] for f, seen in figures_of(world).items()}
    (fault,) = faults(figures, world)
    assert "in the keypoints of all cameras" in fault.message


def without(figure: View2D, *kinds: str) -> View2D:
    """A figure of a tool that does not name some kinds of points."""
    uv = figure.uv.copy()
    uv[[k for k, name in enumerate(KEYPOINTS) if name.rpartition("_")[2] in kinds]] = np.nan
    return replace(figure, uv=uv)


def test_knees_tell_mirrored_names_where_a_tool_names_neither_faces_nor_feet(world: KeypointWorld) -> None:
    own = figures_of(world)
    right = {f: [without(g, "nose", "eye", "ear", "heel", "toe") for g in own[f]] for f in own}
    assert faults(right, world) == []
    (fault,) = faults({f: [mirrored(g) for g in right[f]] for f in right}, world)
    assert "in the keypoints of all cameras" in fault.message


def test_a_late_camera_and_another_frame_rate_are_named(world: KeypointWorld) -> None:
    own = figures_of(world)
    late = {f: [g for g in own[f] if g.camera != 1] for f in own}
    half = {f: [g for g in own[f] if g.camera != 1] for f in own}
    for f in own:
        late[f] += [g for g in own.get(f - 22, []) if g.camera == 1]
        half[f] += [g for g in own.get(2 * f, []) if g.camera == 1]
    (fault,) = faults(late, world)
    assert "camera cam_1 are late by 22 frames" in fault.message
    (fault,) = faults(half, world)
    assert "camera cam_1 are at 0.5 times the frame rate" in fault.message


def test_a_camera_of_another_rig_is_named(world: KeypointWorld) -> None:
    rng = np.random.default_rng(2)
    turn = rng.uniform(-60, 60, (1, 2)) + np.array([90.0, -70.0])
    figures = {
        f: [replace(g, uv=0.7 * g.uv + turn) if g.camera == 3 else g for g in seen]
        for f, seen in figures_of(world).items()
    }
    (fault,) = faults(figures, world)
    assert "camera cam_3 do not agree" in fault.message


def test_a_camera_of_another_clip_is_not_called_early(world: KeypointWorld) -> None:
    """Somebody else comes nearer: shown earlier, he would be at half of the distance, and elsewhere still."""
    figures = {
        f: [replace(g, uv=g.uv + np.array([400.0 - 6.5 * f, 0.0])) if g.camera == 3 else g for g in seen]
        for f, seen in figures_of(world).items()
    }
    (fault,) = faults(figures, world)
    assert "camera cam_3 do not agree" in fault.message


def poster(world: KeypointWorld) -> NDArray[np.float64]:
    """A person painted on a wall at x = -2.2 m: the points of a frame, pressed flat."""
    from mocap.body.markers import marker_positions

    points = marker_positions(world.body, world.markers, world.states[0][:1])[0]
    return np.column_stack([np.full(len(points), -1.9), points[:, 1] - 0.4, points[:, 2]])


def test_a_poster_is_no_person(world: KeypointWorld) -> None:
    rng = np.random.default_rng(4)
    figures = figures_of(world)
    for seen in figures.values():
        for c, camera in enumerate(world.rig):
            uv, _ = camera.project(poster(world))
            uv = np.where(camera.contains(uv)[:, None], uv + rng.normal(0.0, 1.0, uv.shape), np.nan)
            seen.append(View2D(c, undistort(camera, uv), np.full(len(uv), 0.8)))
    found = faults(figures, world)
    assert [f.person for f in found if f.person is not None] != []
    assert len(found) == 1
    assert "never moves and is flat" in found[0].message


def test_a_poster_that_one_camera_alone_shows_is_named(world: KeypointWorld) -> None:
    """Noise of a pixel; a person who sways by 5 cm before one camera is no picture."""
    rng = np.random.default_rng(4)
    camera = world.rig[3]
    for sway_m, is_picture in ((0.0, True), (0.1, False)):
        figures = figures_of(world)
        for frame, seen in figures.items():
            uv, _ = camera.project(poster(world) + np.array([0.0, sway_m * np.sin(0.3 * frame), 0.0]))
            uv = np.where(camera.contains(uv)[:, None], uv + rng.normal(0.0, 1.0, uv.shape), np.nan)
            seen.append(View2D(3, undistort(camera, uv), np.full(len(uv), 0.8)))
        found = [f for f in faults(figures, world) if "never moves" in f.message]
        assert [f.camera for f in found] == [3] * is_picture


@pytest.fixture(scope="module")
def pair() -> KeypointWorld:
    """Two of five cameras: two that look at each other tell little."""
    five = keypoint_world(N, noise_px=1.5, n_cameras=5)
    return replace(five, rig=CameraRig(five.rig.cameras[:2]), figures=[seen[:2] for seen in five.figures])


def changed(
    world: KeypointWorld, second: Callable[[int], int], *, is_mirrored: bool = False
) -> dict[int, list[View2D]]:
    """Figures of two cameras, of which the second shows what it sees in another frame."""
    own = figures_of(world)
    out = {f: [g for g in own[f] if g.camera == 0] for f in own}
    for f in own:
        shown = [g for g in own.get(second(f), []) if g.camera == 1]
        out[f] += [mirrored(g) for g in shown] if is_mirrored else shown
    return out


def test_two_cameras_alone_are_not_blamed_for_good_keypoints(pair: KeypointWorld) -> None:
    assert faults(figures_of(pair), pair) == []


def test_what_is_wrong_between_two_cameras_is_named(pair: KeypointWorld) -> None:
    def said(figures: dict[int, list[View2D]]) -> str:
        return "; ".join(f.message for f in faults(figures, pair))

    swapped = {f: [replace(g, camera=1 - g.camera) for g in seen] for f, seen in figures_of(pair).items()}
    assert "cameras cam_0, cam_1 are exchanged" in said(swapped)
    crossed = changed(pair, lambda f: f, is_mirrored=True)
    assert "left and right are exchanged in the keypoints of camera cam_0 or of cam_1" in said(crossed)
    assert "camera cam_1 are at 0.5 times the frame rate of cam_0" in said(changed(pair, lambda f: 2 * f))
    assert "camera cam_1 are late by" in said(changed(pair, lambda f: f - 9))


def test_keypoints_of_another_rig_are_named_though_no_camera_can_be_blamed() -> None:
    world = keypoint_world(N, noise_px=1.5, n_cameras=3)
    rng = np.random.default_rng(5)
    places = rng.uniform(-150, 150, (3, 2))
    figures = {
        f: [replace(g, uv=0.6 * g.uv + [130, 100] + places[g.camera]) for g in seen]
        for f, seen in figures_of(world).items()
    }
    (fault,) = faults(figures, world)
    assert "agree on a person in" in fault.message
    assert fault.camera is None


def test_another_rig_is_no_single_cameras_fault() -> None:
    """Every camera looks at some other place: they meet in somebody now and then, and most agree with nobody."""
    world = keypoint_world(N, noise_px=1.5, n_cameras=5)
    rng = np.random.default_rng(7)
    places = rng.uniform(-40, 40, (5, 2))
    figures = {
        f: [replace(g, uv=g.uv + places[g.camera] * (1 + 0.05 * f)) for g in seen]
        for f, seen in figures_of(world).items()
    }
    (fault,) = faults(figures, world)
    assert fault.camera is None
    assert "of another rig or clip" in fault.message


def test_two_of_four_cameras_that_do_not_agree_are_no_minority() -> None:
    """The first two agree, the others do not, neither with them nor with each other: none is sure to be right."""
    world = keypoint_world(N, noise_px=1.5, n_cameras=4)
    away = {1: (140.0, -60.0), 3: (-120.0, 90.0)}
    figures = {
        f: [replace(g, uv=0.7 * g.uv + away[g.camera]) if g.camera in away else g for g in seen]
        for f, seen in figures_of(world).items()
    }
    (fault,) = faults(figures, world)
    assert fault.camera is None
    assert "cameras cam_1, cam_3 do not agree with those of the others, 2 of 4" in fault.message


def test_one_camera_is_not_blamed_where_the_others_seldom_agree() -> None:
    """Of three cameras two agree on somebody in a third of the frames."""
    world = keypoint_world(N, noise_px=1.5, n_cameras=3)
    away = {1: (150.0, -80.0), 2: (-140.0, 90.0)}
    figures = {
        f: [
            replace(g, uv=g.uv + away[g.camera]) if g.camera == 2 or (g.camera == 1 and f > N // 3) else g
            for g in seen
        ]
        for f, seen in figures_of(world).items()
    }
    (fault,) = faults(figures, world)
    assert fault.camera is None
    assert "agree on a person in" in fault.message


def test_keypoints_of_another_time_than_the_pictures_are_named() -> None:
    """Somebody walks 2 cm further in every frame, and back again after 2 s; silhouettes forgive 1 cm."""
    n = 120

    def x_m(frame: int) -> float:
        return 0.02 * abs(frame - n // 2)

    def shown(moved: Callable[[int], float]) -> FigureFault | None:
        def beside_m(frame: int, at: int) -> float:
            return max(0.0, abs(x_m(frame) - moved(at)) - 0.01) if 0 <= at < n else np.nan

        return find_picture_fault(beside_m, range(n), FaultSettings())

    def message(moved: Callable[[int], float]) -> str:
        fault = shown(moved)
        assert fault is not None
        return fault.message

    assert shown(x_m) is None
    assert "are late by 12 frames beside the pictures" in message(lambda at: x_m(at - 12))
    assert "are early by 7 frames beside" in message(lambda at: x_m(at + 7))
    assert "late by 60 frames or more" in message(lambda at: 0.02 * abs(at - 80 - n // 2))
    assert message(lambda at: x_m(2 * at)) == "the keypoints are at 0.5 times the frame rate of the pictures"
    assert "of another clip than the pictures" in message(lambda at: 7.0)
    assert shown(lambda at: np.nan) is None
