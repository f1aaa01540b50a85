"""Camera faults put into clean silhouettes of a walking person, named again with camera and frame."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Literal

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from eval.bench.scene import person_mask, ring
from eval.camera_faults import evaluate
from mocap.data import Camera, CameraRig, VoxelGrid
from mocap.io.calibration import write_calibration
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.products.hulls import rig_offset_m, stored_faults
from mocap.volume import (
    CameraFault,
    ConsistencyMonitor,
    camera_faults,
    find_camera_faults,
    find_faults,
    find_late,
    usable_cameras,
)
from mocap.volume.camera_faults import _is_drift, background_shift, fit_states
from mocap.volume.consistency import FRAME_S, MAX_LAG_FRAMES, SHRINK, SilhouetteEvidence, Snapshot

T, C, SIZE = 64, 7, (320, 240)
RIG = ring(C, SIZE)
GRID = VoxelGrid(np.array([-1.6, -1.6, 0.0]), (64, 64, 40), 0.05)
START = 30
FRAMES_OFF = 5  # what the issue asks for
FIRST = 100  # number of the first frame
PX = 3.0  # a shift in pixels, told from cells of four


def person_at(camera: Camera, frame: int) -> np.ndarray:
    """The mask of a person on a circle."""
    angle = 0.055 * frame
    return person_mask(camera, np.array([0.8 * np.cos(angle), 0.8 * np.sin(angle)]), angle + np.pi / 2)


@cache
def walk() -> tuple[tuple[np.ndarray, ...], ...]:
    """masks[camera][frame] of a person on a circle, two centimetres in front of the last frame."""
    return tuple(tuple(person_at(c, f) for f in range(T + MAX_LAG_FRAMES)) for c in RIG)


def clean() -> list[list[np.ndarray]]:
    return [list(camera[:T]) for camera in walk()]


def find(
    masks: list[list[np.ndarray]], images: list[list[np.ndarray]] | None = None
) -> tuple[CameraFault, ...]:
    monitor = ConsistencyMonitor(RIG, GRID)
    for f in range(len(masks[0])):
        shown = None if images is None else monitor.glimpse([camera[f] for camera in images])
        monitor.add(FIRST + f, [camera[f] for camera in masks], shown)
    return find_camera_faults(monitor.evidence())


def rotated(mask: np.ndarray, c: int, rotation_deg: tuple[float, float, float]) -> np.ndarray:
    """What the camera would have seen had it been turned (its distortion left out)."""
    turn = Rotation.from_euler("xyz", rotation_deg, degrees=True).as_matrix()
    H = RIG[c].K @ turn @ np.linalg.inv(RIG[c].K)
    return cv2.warpPerspective(mask.astype(np.uint8), H, SIZE, flags=cv2.INTER_NEAREST).astype(bool)


def test_clean_cameras_are_left_alone() -> None:
    assert find(clean()) == ()
    rng = np.random.default_rng(4)
    noisy = clean()
    for camera in noisy:
        for f in range(T):
            # specks, holes, and one mask in twenty without its lower half
            camera[f] = (camera[f] | (rng.random(camera[f].shape) < 0.0005)) & (
                rng.random(camera[f].shape) > 0.01
            )
            if rng.random() < 0.05:
                camera[f][140:] = False
    assert find(noisy) == ()


@pytest.mark.parametrize("half_m", [0.75, 0.95])
def test_who_walks_out_of_the_room_in_view_of_all_cameras_is_no_fault_of_theirs(half_m: float) -> None:
    """The volume ends at the room's side, masks do not: what is cut there says nothing of cameras."""
    room = VoxelGrid.from_bounds(np.array([-1.6, -half_m, 0.0]), np.array([1.6, half_m, 2.0]), 0.05)
    monitor, whole = ConsistencyMonitor(RIG, room), 0
    for f in range(T):
        monitor.add(FIRST + f, [camera[f] for camera in walk()])
        whole += monitor.evidence().hull_cells[-1].min() > 0
    assert find_camera_faults(monitor.evidence()) == ()
    assert 10 < whole < T - 10  # he is inside for a part of the time


def test_a_moved_camera_is_named_with_its_frame_and_shift() -> None:
    masks = clean()
    masks[3] = [rotated(m, 3, (0.0, 4.0, 0.0)) if f >= START else m for f, m in enumerate(masks[3])]
    (fault,) = find(masks)
    assert (fault.camera, fault.kind) == ("cam_3", "moved")
    assert abs(fault.first_frame - FIRST - START) <= FRAMES_OFF
    assert fault.is_to_end
    assert not fault.is_from_start
    assert fault.shift_px is not None
    expected = RIG[3].K[0, 0] * np.tan(np.radians(4.0))
    assert np.hypot(*fault.shift_px) == pytest.approx(expected, abs=2 * SHRINK)
    assert fault.message.startswith(f"camera cam_3 moved at frame {fault.first_frame}")


def empty_rooms() -> list[list[np.ndarray]]:
    """Pictures of rooms in which nobody is: backgrounds to be followed, with noise."""
    rng = np.random.default_rng(8)
    rooms = [
        cv2.GaussianBlur(rng.integers(0, 256, (240, 320, 3), dtype=np.uint8), (0, 0), 4.0) for _ in range(C)
    ]
    rooms = [np.clip((r.astype(np.float32) - 128) * 8 + 128, 0, 255) for r in rooms]
    return [
        [np.clip(room + rng.normal(0, 2, room.shape), 0, 255).astype(np.uint8) for _ in range(T)]
        for room in rooms
    ]


def test_a_background_that_stays_where_it_was_clears_a_camera() -> None:
    """Its silhouettes fit as badly as those of a moved camera, but its pictures show that it stands."""
    masks = clean()
    masks[3] = [rotated(m, 3, (0.0, 4.0, 0.0)) if f >= START else m for f, m in enumerate(masks[3])]
    images = empty_rooms()
    assert find(masks, images) == ()
    images[3] = [np.roll(i, 21, axis=1) if f >= START else i for f, i in enumerate(images[3])]
    (fault,) = find(masks, images)
    assert (fault.camera, fault.kind) == ("cam_3", "moved")


def test_masks_that_hold_more_than_the_others_for_a_while_are_no_fault_of_a_camera_that_stands() -> None:
    """Somebody whom the others lose behind something cuts nothing from the volume; what is wrong with a calibration is
    so most of the time."""
    for_a_while, always = clean(), clean()
    for f, mask in enumerate(walk()[3][:T]):
        always[3][f] = mask | np.roll(mask, 50, axis=1) | np.roll(mask, -50, axis=1)
        for_a_while[3][f] = always[3][f] if f > T // 2 else mask
    images = empty_rooms()
    assert [(f.camera, f.kind) for f in find(for_a_while)] == [("cam_3", "misfit")]
    assert find(for_a_while, images) == ()
    assert [(f.camera, f.kind) for f in find(always, images)] == [("cam_3", "misfit")]


@pytest.mark.parametrize(("n_late", "is_told"), [(16, False), (28, True)])
def test_a_lag_is_told_by_its_own_frames(n_late: int, is_told: bool) -> None:
    """Not by those before it in which masks did not fit either."""
    monitor = ConsistencyMonitor(RIG, GRID)
    for f in range(T):
        monitor.add(FIRST + f, [camera[f] for camera in clean()])
    evidence = monitor.evidence()
    uncovered, strict = evidence.uncovered.copy(), evidence.strict.copy()
    late = slice(20, 48)
    uncovered[late, 2] = 0.9
    uncovered[late, 2, MAX_LAG_FRAMES + 3] = 0.0
    strict[:, 2] = 1.0
    strict[: 48 - n_late, 2, MAX_LAG_FRAMES] = 0.0
    strict[48 - n_late :, 2, MAX_LAG_FRAMES + 3] = 0.0
    found = find_camera_faults(replace(evidence, uncovered=uncovered, strict=strict))
    assert [(f.camera, f.kind, f.first_frame) for f in found] == [
        ("cam_2", "lag", FIRST + 48 - n_late)
    ] * is_told


@pytest.mark.parametrize("lag", [2, 3, 5, -3])
def test_a_lag_is_counted_from_its_frame_on(lag: int) -> None:
    masks = clean()
    masks[2] = [walk()[2][f - lag] if f >= START else m for f, m in enumerate(masks[2])]
    (fault,) = find(masks)
    assert (fault.camera, fault.kind, fault.lag_frames) == ("cam_2", "lag", lag)
    assert abs(fault.first_frame - FIRST - START) <= FRAMES_OFF
    words = "lags" if lag > 0 else "its file has lost pictures"
    assert words in fault.message


def test_a_dozen_early_frames_are_no_lag() -> None:
    """Whoever comes in by the door is seen by one camera first; the hull has him a few frames later."""
    masks = clean()
    masks[2] = [walk()[2][f + 6] if START <= f < START + 12 else m for f, m in enumerate(masks[2])]
    assert find(masks) == ()


def test_a_dozen_late_frames_before_he_is_gone_are_no_lag() -> None:
    """Whoever leaves is seen by one camera last; the frames without him tell nothing."""
    masks = clean()
    masks[2] = [walk()[2][f - 6] if START <= f < START + 12 else m for f, m in enumerate(masks[2])]
    gone = [[m if f < START + 12 else np.zeros_like(m) for f, m in enumerate(camera)] for camera in masks]
    assert find(gone) == ()


def test_a_lag_at_the_end_that_the_tighter_hull_contradicts_is_none() -> None:
    """As it was for somebody who walked past four cameras; there was no frame at which it began."""
    monitor = ConsistencyMonitor(RIG, GRID)
    for f in range(T):
        monitor.add(FIRST + f, [camera[f] for camera in clean()])
    evidence = monitor.evidence()
    uncovered, strict = evidence.uncovered.copy(), evidence.strict.copy()
    uncovered[-10:, 2] = 0.9
    uncovered[-10:, 2, MAX_LAG_FRAMES + 3] = 0.0
    strict[:, 2] = 1.0
    strict[:, 2, MAX_LAG_FRAMES] = 0.0
    found = find_camera_faults(replace(evidence, uncovered=uncovered, strict=strict))
    assert "lag" not in {fault.kind for fault in found}


def test_pictures_that_were_lost_do_not_come_back() -> None:
    """Early for a second and then in time no camera can be: the hull of the others was wrong for as long."""
    start, stop = 12, T - MAX_LAG_FRAMES - 12
    masks = clean()
    masks[2] = [walk()[2][f + 5] if start <= f < stop else m for f, m in enumerate(masks[2])]
    assert find(masks) == ()
    masks[2] = [walk()[2][f + 5] if start <= f else m for f, m in enumerate(masks[2])]
    (fault,) = find(masks)
    assert (fault.camera, fault.kind, fault.lag_frames) == ("cam_2", "lag", -5)


@pytest.mark.parametrize("jumps", [True, False])
def test_where_pictures_were_lost_people_are_elsewhere_all_at_once(jumps: bool) -> None:
    """As it was not of two persons before four cameras, of whom the hull of later frames held more."""
    monitor = ConsistencyMonitor(RIG, GRID)
    for f in range(T):
        monitor.add(FIRST + f, [camera[f] for camera in clean()])
    evidence = monitor.evidence()
    uncovered, change = evidence.uncovered.copy(), evidence.change.copy()
    uncovered[START:, 2] = 0.1
    uncovered[START:, 2, MAX_LAG_FRAMES - 4] = 0.0
    change[START, 2] *= 4.0 if jumps else 1.0
    found = find_camera_faults(replace(evidence, uncovered=uncovered, strict=uncovered, change=change))
    assert [(f.camera, f.kind, f.lag_frames) for f in found] == ([("cam_2", "lag", -4)] if jumps else [])


@pytest.mark.parametrize(("frames_each", "drifts"), [(4, True), (2, True), (1, False)])
def test_a_clock_runs_away_slower_than_the_time_goes(frames_each: int, drifts: bool) -> None:
    """Frame by frame the lag grows where of one moment alone the hull holds what the masks show."""
    lags = np.repeat(np.arange(1, MAX_LAG_FRAMES + 1), frames_each)
    states = np.concatenate([MAX_LAG_FRAMES + lags, np.full(9, 2 * MAX_LAG_FRAMES + 1)])
    assert _is_drift(states) == drifts


def test_a_lag_from_the_start_is_told_as_such() -> None:
    masks = clean()
    masks[5] = [walk()[5][max(f - 3, 0)] for f in range(T)]
    (fault,) = find(masks)
    assert (fault.camera, fault.kind, fault.lag_frames, fault.is_from_start) == ("cam_5", "lag", 3, True)
    assert fault.message == "camera cam_5 lags 3 frames all the time"


def filmed_late(lags: dict[int, int]) -> list[list[np.ndarray]]:
    """Masks of the walk; some cameras show what was some frames ago, or is to come."""
    masks = clean()
    for c, lag in lags.items():
        masks[c] = [walk()[c][max(f - lag, 0)] for f in range(T)]
    return masks


def watched(masks: list[list[np.ndarray]]) -> ConsistencyMonitor:
    monitor = ConsistencyMonitor(RIG, GRID)
    for f in range(T):
        monitor.add(FIRST + f, [camera[f] for camera in masks])
    return monitor


@pytest.mark.parametrize("lags", [{1: 5, 4: 5}, {1: 4, 2: -4}, {1: 4, 3: 4, 5: 4}])
def test_several_cameras_that_are_late_are_told_from_those_that_only_seem_so(lags: dict[int, int]) -> None:
    """The hull of two moments blames healthy cameras too; of three late ones it says that the room has changed."""
    monitor = watched(filmed_late(lags))
    found = find_faults(monitor)
    assert {f.camera for f in found} - {f"cam_{c}" for c in lags}
    late = find_late(monitor, found)
    assert {f.camera: f.lag_frames for f in late} == {f"cam_{c}": lag for c, lag in lags.items()}
    assert all(f.kind == "lag" and f.is_from_start and f.is_to_end for f in late)
    assert (late[0].first_frame, late[0].last_frame) == (FIRST, FIRST + T - 1)


def test_one_late_camera_alone_asks_for_no_clocks() -> None:
    monitor = watched(filmed_late({2: 3}))
    (fault,) = found = find_faults(monitor)
    assert (fault.camera, fault.lag_frames) == ("cam_2", 3)
    assert find_late(monitor, found) == ()


def test_where_every_second_camera_is_late_nobody_knows_which() -> None:
    monitor = watched(filmed_late({0: 4, 1: 4, 2: 4, 3: 4}))
    late = find_late(monitor, find_faults(monitor))
    assert {f.camera for f in late} == {"cam_4", "cam_5", "cam_6"}  # three are early, as seen by four
    four = RIG.subset(RIG.names[:4])
    monitor = ConsistencyMonitor(four, GRID)
    masks = filmed_late({0: 4, 1: 4})
    for f in range(T):
        monitor.add(f, [masks[c][f] for c in range(4)])
    everybody = [CameraFault(name, "lag", 0, T - 1, True, True) for name in four.names]
    assert find_late(monitor, everybody) == ()


def test_a_turned_camera_that_seems_to_lag_is_told_by_its_clock() -> None:
    cameras = list(RIG)
    for c, angle in ((1, -1.2), (4, 1.2)):
        turn = Rotation.from_rotvec([0.0, np.radians(angle), 0.0]).as_matrix()
        cameras[c] = replace(RIG[c], R=turn.T @ RIG[c].R, t=-turn.T @ RIG[c].R @ RIG[c].center)
    monitor = ConsistencyMonitor(CameraRig(tuple(cameras)), GRID)
    for f in range(40):
        monitor.add(f, [camera[f] for camera in walk()])
    (seeming,) = find_camera_faults(monitor.evidence())
    assert (seeming.camera, seeming.kind, seeming.is_from_start) == ("cam_4", "lag", True)
    found = find_faults(monitor)
    assert [(f.camera, f.kind) for f in found] == [("cam_1", "calibration"), ("cam_4", "calibration")]
    assert [f.turn_deg for f in found] == pytest.approx([1.2, 1.2], abs=0.2)


def test_a_clock_that_no_mask_bears_out_makes_nobody_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monitor = watched(clean())
    lies = {name: SimpleNamespace(offset_s=-3 * FRAME_S, is_off=True) for name in ("cam_1", "cam_2")}
    monkeypatch.setattr(camera_faults, "_clocks", lambda monitor: lies)
    blamed = [CameraFault(name, "lag", 0, T - 1, True, True, lag_frames=3) for name in lies]
    assert find_late(monitor, blamed) == ()
    late = find_late(watched(filmed_late({1: 3, 2: 3})), blamed)
    assert [(f.camera, f.lag_frames) for f in late] == [("cam_1", 3), ("cam_2", 3)]


@pytest.mark.parametrize("is_turned", [True, False])
def test_who_seems_a_frame_late_beside_a_turned_camera_is_judged_by_outlines(
    is_turned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    turned, other = (
        CameraFault(c, "calibration", 0, 9, True, True, offset_m=0.06) for c in ("cam_1", "cam_4")
    )
    late = CameraFault("cam_4", "lag", 0, 9, True, True, lag_frames=1)
    more = (turned, other) if is_turned else (turned,)
    monkeypatch.setattr(camera_faults, "find_camera_faults", lambda evidence, each: (late,))
    monkeypatch.setattr(camera_faults, "_is_refuted", lambda fault, monitor: False)
    monkeypatch.setattr(camera_faults, "find_exchanged", lambda *args: ())
    monkeypatch.setattr(
        camera_faults, "find_misfits", lambda rig, samples, known, *args: (turned,) if known else more
    )
    assert find_faults(watched(clean())) == ((turned, other) if is_turned else (turned, late))


def still_picture(*, mask_change: float, n_cells: int) -> SilhouetteEvidence:
    """Five cameras, 40 frames; the picture of camera 2 hardly changes from frame 20 on."""
    n, n_cameras = 40, 5
    picture_change = np.ones((n, n_cameras), dtype=np.float32)
    picture_change[20:, 2] = 0.05
    change = np.full((n, n_cameras), 0.3, dtype=np.float32)
    change[20:, 2] = mask_change
    cells = np.full((n, n_cameras), 300, dtype=np.int32)
    cells[20:, 2] = n_cells
    lags = np.zeros((n, n_cameras, 17), dtype=np.float32)
    grey = np.full((n, n_cameras), 90.0, dtype=np.float32)
    return SilhouetteEvidence(
        names=tuple("abcde"), frames=np.arange(n), uncovered=lags, strict=lags, mask_cells=cells,
        hull_cells=cells, expected_cells=cells, change=change, picture_change=picture_change, brightness=grey,
        contrast=grey, snapshots=(),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("mask_change", "n_cells", "is_frozen"),
    [(0.0, 300, True), (0.09, 150, False), (np.nan, 0, False)],
    ids=["repeats", "somebody walks away far off", "nobody is in view"],
)
def test_a_picture_that_hardly_changes_need_not_be_frozen(
    mask_change: float, n_cells: int, is_frozen: bool
) -> None:
    kinds = [f.kind for f in find_camera_faults(still_picture(mask_change=mask_change, n_cells=n_cells))]
    assert kinds == (["frozen"] if is_frozen else [])


def test_a_frozen_camera_goes_on() -> None:
    masks = clean()
    masks[1] = [masks[1][START - 1] if START <= f < START + 22 else m for f, m in enumerate(masks[1])]
    (fault,) = find(masks)
    assert (fault.camera, fault.kind) == ("cam_1", "frozen")
    assert abs(fault.first_frame - FIRST - START) <= FRAMES_OFF
    assert abs(fault.last_frame - FIRST - START - 21) <= FRAMES_OFF
    assert not fault.is_to_end


def test_pictures_that_repeat_now_and_then_are_told_and_the_camera_kept() -> None:
    masks = clean()
    masks[3] = [masks[3][f - 1] if f % 4 == 3 else m for f, m in enumerate(masks[3])]
    (fault,) = find(masks)
    assert (fault.camera, fault.kind) == ("cam_3", "repeats")
    assert fault.share == pytest.approx(0.25, abs=0.03)
    assert "gives 25 % of its pictures twice" in fault.message
    assert usable_cameras([fault], RIG.names, np.arange(FIRST, FIRST + T)).all()


@pytest.mark.parametrize(("darker", "is_flicker"), [(0.3, True), (0.05, False)])
def test_a_camera_that_flickers_is_told_and_kept(darker: float, is_flicker: bool) -> None:
    evidence = still_picture(mask_change=0.3, n_cells=300)
    brightness = evidence.brightness.copy()
    brightness[::2, 1] *= 1 - darker
    found = find_camera_faults(replace(evidence, brightness=brightness))
    assert [(f.camera, f.kind, f.is_harmless) for f in found] == [("b", "flicker", True)] * is_flicker


def test_a_light_that_is_switched_off_is_no_flicker() -> None:
    evidence = still_picture(mask_change=0.3, n_cells=300)
    brightness = evidence.brightness.copy()
    brightness[20:] *= 0.5
    assert find_camera_faults(replace(evidence, brightness=brightness)) == ()


def test_exchanged_cameras_are_named_and_left_out() -> None:
    masks = clean()
    masks[1], masks[4] = masks[4], masks[1]
    monitor = ConsistencyMonitor(RIG, GRID)
    for f in range(T):
        monitor.add(FIRST + f, [camera[f] for camera in masks])
    found = find_faults(monitor)
    assert [(f.camera, f.kind, f.exchanged_with) for f in found] == [
        ("cam_1", "exchanged", "cam_4"),
        ("cam_4", "exchanged", "cam_1"),
    ]
    assert found[0].message == "camera cam_1 shows what camera cam_4 should, and the other way round"
    used = usable_cameras(found, RIG.names, np.array([FIRST + 5]))[0]
    assert used.tolist() == [True, False, True, True, False, True, True]


@pytest.mark.parametrize("kind", ["blind", "misfit"])
def test_exchanged_cameras_that_seem_to_see_nobody_are_named(
    kind: Literal["blind", "misfit"], monkeypatch: pytest.MonkeyPatch
) -> None:
    masks = clean()
    masks[1], masks[4] = masks[4], masks[1]
    seeming = tuple(CameraFault(c, kind, FIRST, FIRST + T - 1, True, True) for c in ("cam_1", "cam_4"))
    monkeypatch.setattr(camera_faults, "find_camera_faults", lambda evidence, each: seeming)
    monkeypatch.setattr(camera_faults, "find_misfits", lambda *args: ())
    assert [(f.camera, f.kind) for f in find_faults(watched(masks))] == [
        ("cam_1", "exchanged"),
        ("cam_4", "exchanged"),
    ]
    healthy = tuple(find_faults(watched(clean())))
    assert healthy == seeming


def test_a_camera_without_masks_sees_nobody() -> None:
    masks = clean()
    masks[0] = [m if f < START else np.zeros_like(m) for f, m in enumerate(masks[0])]
    (fault,) = find(masks)
    assert (fault.camera, fault.kind) == ("cam_0", "blind")
    assert abs(fault.first_frame - FIRST - START) <= FRAMES_OFF


def pictures(c: int, f: int, *, shift: int = 0) -> np.ndarray:
    """A textured room with the person in it and fresh noise, shifted by some pixels."""
    texture = np.random.default_rng(c).integers(60, 190, (24, 32, 3)).astype(np.uint8)
    image = cv2.resize(texture, SIZE, interpolation=cv2.INTER_NEAREST)
    image[walk()[c][f]] = (30, 30, 220)
    noise = np.random.default_rng((c, f)).integers(0, 6, image.shape).astype(np.uint8)
    return np.roll(image, shift, axis=1) + noise


def test_pictures_tell_a_black_camera_from_a_hidden_person_and_show_small_movements() -> None:
    n = 40
    masks = [camera[:n] for camera in clean()]
    images = [[pictures(c, f) for f in range(n)] for c in range(C)]
    assert find(masks, images) == ()
    black = [list(camera) for camera in images]
    masks_black = [list(camera) for camera in masks]
    for f in range(25, n):
        black[4][f] = np.zeros_like(black[4][f])
        masks_black[4][f] = np.zeros_like(masks_black[4][f])
    (fault,) = find(masks_black, black)
    assert (fault.camera, fault.kind, fault.first_frame) == ("cam_4", "black", FIRST + 25)
    # Four pixels: far too little for silhouettes.
    moved = [list(camera) for camera in images]
    moved[6] = [pictures(6, f, shift=4 if f >= 18 else 0) for f in range(n)]
    (fault,) = find(masks, moved)
    assert (fault.camera, fault.kind, fault.first_frame) == ("cam_6", "moved", FIRST + 18)
    assert fault.shift_px == pytest.approx((4.0, 0.0), abs=1.0)
    frozen = [list(camera) for camera in images]
    frozen[2] = [images[2][min(f, 15)] for f in range(n)]
    (fault,) = find([*masks[:2], [masks[2][min(f, 15)] for f in range(n)], *masks[3:]], frozen)
    assert (fault.camera, fault.kind) == ("cam_2", "frozen")
    assert abs(fault.first_frame - FIRST - 16) <= FRAMES_OFF


def test_a_change_of_all_cameras_is_no_cameras_fault() -> None:
    masks = clean()
    for c in range(C):
        # a stripe of false foreground beside the person, another one in each camera
        masks[c] = [
            m | np.roll(m, 40 if c % 2 else -40, axis=1) if f >= START else m for f, m in enumerate(masks[c])
        ]
    faults = find(masks)
    assert all(f.camera == "" and f.kind == "scene" for f in faults)


def test_background_shift_by_tracking() -> None:
    empty = np.zeros((1, 60, 80), dtype=np.uint8)
    small = [pictures(0, 0, shift=s)[::SHRINK, ::SHRINK, 1][None] for s in (0, 8)]
    first, second = (Snapshot(0, empty, empty, p) for p in small)
    shift = background_shift(first, second, 0)
    assert shift is not None
    assert shift == pytest.approx([2.0, 0.0], abs=0.2)
    flat = replace(first, pictures=np.full_like(small[0], 90))
    assert background_shift(flat, second, 0) is None


@pytest.mark.parametrize(("left", "right", "is_told"), [(0.65, 0.65, True), (0.1, 1.2, False)])
def test_a_light_that_creeps_over_a_wall_moves_no_camera(left: float, right: float, is_told: bool) -> None:
    """Half a cell and more in the middle, either way; a camera would move all of it."""
    empty = np.zeros((1, 60, 80), dtype=np.uint8)
    room = cv2.GaussianBlur(np.random.default_rng(2).normal(0, 1, (60, 80)), (0, 0), 1.5)
    room = np.clip(128 + 200 * room, 0, 255).astype(np.float32)
    v, u = np.mgrid[:60, :80].astype(np.float32)
    moved = cv2.remap(room, u - np.linspace(left, right, 80, dtype=np.float32), v, cv2.INTER_CUBIC)
    before, after = (
        Snapshot(0, empty, empty, np.clip(p, 0, 255).astype(np.uint8)[None]) for p in (room, moved)
    )
    shift = background_shift(before, after, 0)
    assert (shift is not None) == is_told
    if shift is not None:
        assert shift == pytest.approx([left, 0.0], abs=0.1)


@given(seed=st.integers(0, 10_000))
@hypothesis_settings(max_examples=30)
def test_the_fit_is_the_cheapest_of_all_sequences(seed: int) -> None:
    """Against all 4^6 sequences of states of six frames and three lags."""
    rng = np.random.default_rng(seed)
    shares = np.where(rng.random((6, 3)) < 0.15, np.nan, rng.choice([0.0, 0.02, 0.1, 0.4], (6, 3)))
    states, cost = fit_states(shares, 0.01)

    def price(sequence: np.ndarray) -> float:
        changes = np.count_nonzero(np.diff(sequence)) + (sequence[0] != 1)
        return float(cost[np.arange(6), sequence].sum() + 12.0 * changes)

    everything = np.stack(np.meshgrid(*[np.arange(4)] * 6, indexing="ij"), axis=-1).reshape(-1, 6)
    best = min(price(s) for s in everything)
    assert price(states) == pytest.approx(best)


def test_usable_cameras_by_frame() -> None:
    faults = (
        CameraFault("b", "moved", 12, 15, False, False),
        CameraFault("", "scene", 11, 15, False, True),
        CameraFault("c", "black", 10, 11, True, False),
        CameraFault("a", "lag", 10, 15, True, True, lag_frames=1),
        CameraFault("a", "calibration", 10, 15, True, True, offset_m=0.02),
    )
    worse = CameraFault("a", "calibration", 10, 15, True, True, offset_m=0.03)
    assert not usable_cameras((worse,), ("a", "b", "c"), np.arange(10, 16))[:, 0].any()
    usable = usable_cameras(faults, ("a", "b", "c"), np.arange(10, 16))
    assert usable[:, 0].all()
    np.testing.assert_array_equal(usable[:, 1], [True, True, False, False, False, False])
    np.testing.assert_array_equal(usable[:, 2], [False, False, True, True, True, True])


def test_too_little_to_tell_from() -> None:
    assert find([camera[:4] for camera in clean()]) == ()
    nobody = [[np.zeros_like(m) for m in camera[:8]] for camera in clean()]
    assert find(nobody) == ()


def mask_session(root: Path, masks: list[list[np.ndarray]]) -> Path:
    """A session folder of masks alone."""
    (root / "masks").mkdir(parents=True)
    write_calibration(root / "calibration.toml", RIG)
    lower, upper = GRID.origin.tolist(), GRID.upper.tolist()
    (root / "session.toml").write_text(f"fps = 30.0\nroom_bounds_m = [{lower}, {upper}]\n", encoding="utf-8")
    for camera, own in zip(RIG, masks, strict=True):
        np.savez_compressed(root / "masks" / f"{camera.name}.npz", masks=np.array(own))
    return root


def test_the_carve_stage_warns_and_goes_on_with_the_other_cameras(tmp_path: Path) -> None:
    n = 46
    masks = [camera[:n] for camera in clean()]
    masks[3] = [rotated(m, 3, (0.0, 5.0, 0.0)) if f >= 20 else m for f, m in enumerate(masks[3])]
    session = mask_session(tmp_path / "session", masks)
    sizes = {}
    for mode in ("warn", "exclude", "ignore"):
        config = load_config("default", ("volume.voxel_size_m=0.05", f"volume.on_bad_camera={mode}"))
        result = run_session(session, tmp_path / mode, config=config, until="carve")
        reader = StageStore(tmp_path / mode / "store.zarr").reader("carve")
        rows = [arrays for _, arrays in reader]
        used = np.array([row["used"] for row in rows])
        sizes[mode] = np.array([len(row["voxels"]) for row in rows])
        told = [w for w in result.warnings if "cam_3 moved at frame" in w]
        assert len(told) == (mode != "ignore")
        assert np.all(used[:, [0, 1, 2, 4, 5, 6]])
        if mode == "exclude":
            assert "left out" in told[0]
            (fault,) = stored_faults(StageStore(tmp_path / mode / "store.zarr"))
            assert abs(fault.first_frame - 20) <= FRAMES_OFF
            np.testing.assert_array_equal(used[:, 3], np.arange(n) < fault.first_frame)
        else:
            assert used.all()
    np.testing.assert_array_equal(sizes["warn"], sizes["ignore"])
    np.testing.assert_array_equal(sizes["warn"][:15], sizes["exclude"][:15])
    # The bad camera's masks cut the body away; without them it is whole again.
    assert sizes["exclude"][25:].mean() > 1.5 * sizes["warn"][25:].mean()
    settings = ("volume.voxel_size_m=0.05", "volume.on_bad_camera=exclude")
    again = run_session(
        session, tmp_path / "exclude", config=load_config("default", settings), until="carve", resume=True
    )
    assert again.reused == ("segment", "occluders", "carve")
    assert any("cam_3 moved" in w for w in again.warnings)


def test_the_others_are_judged_again_without_the_late_ones(tmp_path: Path) -> None:
    masks = filmed_late({1: 5, 4: 5})
    masks[6] = [m if f < START else np.zeros_like(m) for f, m in enumerate(masks[6])]
    session = mask_session(tmp_path / "session", masks)
    config = load_config("default", ("volume.voxel_size_m=0.05",))
    run_session(session, tmp_path / "out", config=config, until="carve")
    store = StageStore(tmp_path / "out" / "store.zarr")
    found = stored_faults(store)
    assert [(f.camera, f.kind) for f in found] == [("cam_1", "lag"), ("cam_4", "lag"), ("cam_6", "blind")]
    used = np.array([arrays["used"] for _, arrays in store.reader("carve")])
    assert np.flatnonzero(~used.any(axis=0)).tolist() == [1, 4]
    np.testing.assert_array_equal(used[:, 6], np.arange(T) < found[2].first_frame)


def test_a_wrong_calibration_is_named_left_out_and_else_widens_the_regions(tmp_path: Path) -> None:
    masks = [camera[:40:2] for camera in clean()]
    session = mask_session(tmp_path / "session", masks)
    turn = Rotation.from_rotvec([0.0, np.radians(2.0), 0.0]).as_matrix()
    cameras = [
        replace(c, R=turn.T @ c.R, t=-turn.T @ c.R @ c.center) if c.name == "cam_2" else c for c in RIG
    ]
    write_calibration(session / "calibration.toml", CameraRig(tuple(cameras)))
    for mode, is_out in (("exclude", True), ("warn", False)):
        config = load_config("default", ("volume.voxel_size_m=0.05", f"volume.on_bad_camera={mode}"))
        result = run_session(session, tmp_path / mode, config=config, until="carve")
        store = StageStore(tmp_path / mode / "store.zarr")
        (fault,) = stored_faults(store)
        assert (fault.camera, fault.kind) == ("cam_2", "calibration")
        assert fault.turn_deg == pytest.approx(2.0, abs=0.2)
        assert any("cam_2 does not stand where its calibration says" in w for w in result.warnings)
        used = np.array([arrays["used"] for _, arrays in store.reader("carve")])
        assert np.all(used[:, 2] == (not is_out))
        assert used[:, [0, 1, 3, 4, 5, 6]].all()
        # What is left out harms nobody.
        assert rig_offset_m(store) == (0.0 if is_out else fault.offset_m)


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["fault_moved", "fault_lag", "fault_frozen", "fault_dropped"])
def test_faults_of_rendered_scenes_are_named(scene: str, tmp_path: Path) -> None:
    """Videos, segmentation and all; three minutes a scene."""
    pytest.importorskip("embreex", reason="rendering needs the extra synth (embreex)")
    from mocap.synth import synthesise

    (row,) = evaluate(synthesise(scene, tmp_path / scene), "images")
    assert row["is_right"] == 1
    assert row["false_alarms"] == 0
