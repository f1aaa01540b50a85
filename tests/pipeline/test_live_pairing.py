"""Pairing of live pictures: the newest complete set wins, drops are counted, a silent camera stops nobody."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from mocap.pipeline.live.capture import Shot
from mocap.pipeline.live.pairing import Pairing, PictureSet

CAMERAS = ("a", "b", "c", "d")
PICTURE = np.zeros((2, 3, 3), dtype=np.uint8)
FRAME_S = 1 / 25


def shot(time_s: float) -> Shot:
    return Shot(time_s, time_s + 100.0, PICTURE)


def pairing(tolerance_s: float = 0.02) -> Pairing:
    return Pairing(CAMERAS, tolerance_s, stalled_s=0.25, min_cameras=3)


def times(found: PictureSet | None) -> list[float | None]:
    assert found is not None
    return [None if s is None else s.time_s for s in found.shots]


def test_a_set_is_there_when_the_last_camera_is() -> None:
    pairs = pairing()
    for i, name in enumerate(CAMERAS):
        assert pairs.take(0.0) is None
        pairs.add(name, shot(1.0 + 0.004 * i))
    found = pairs.take(0.0)
    assert times(found) == [1.0, 1.004, 1.008, 1.012]
    assert found is not None
    assert (found.time_s, found.taken_s) == (1.012, 101.012)
    assert pairs.take(0.0) is None


@pytest.mark.parametrize("n_passed", [0, 1, 5])
def test_the_newest_set_wins_and_those_before_are_counted(n_passed: int) -> None:
    pairs = pairing()
    for k in range(n_passed + 1):
        for name in CAMERAS:
            pairs.add(name, shot(k * FRAME_S))
    assert times(pairs.take(0.0)) == [n_passed * FRAME_S] * 4
    assert pairs.take(0.0) is None
    assert (pairs.counts.n_sets, pairs.counts.n_dropped, pairs.counts.n_partial) == (1, n_passed, 0)


def test_pictures_of_other_frames_are_no_set() -> None:
    """Cameras half a frame apart are paired within a tolerance of half a frame, and not within a tenth."""
    for tolerance_s, is_set in ((0.51 * FRAME_S, True), (0.1 * FRAME_S, False)):
        pairs = pairing(tolerance_s)
        for k in range(3):
            for i, name in enumerate(CAMERAS):
                pairs.add(name, shot((k + 0.5 * (i % 2)) * FRAME_S))
        assert (pairs.take(0.0) is not None) == is_set


def test_the_slowest_camera_sets_the_time() -> None:
    """The others have newer pictures already: those of its time are taken."""
    pairs = pairing()
    for name in CAMERAS:
        for k in range(1 if name == "c" else 4):
            pairs.add(name, shot(k * FRAME_S))
    assert times(pairs.take(0.0)) == [0.0] * 4
    pairs.add("c", shot(FRAME_S))
    assert times(pairs.take(0.0)) == [FRAME_S] * 4


def test_a_silent_camera_is_waited_for_a_while_and_taken_again_when_it_is_back() -> None:
    pairs, found = pairing(), {}
    for k in range(30):
        for name in CAMERAS:
            if name != "b" or not 5 <= k < 20:
                pairs.add(name, shot(k * FRAME_S))
        got = pairs.take(0.0)
        if got is not None:
            found[k] = [s is not None for s in got.shots]
    assert all(found[k] == [True] * 4 for k in (*range(5), *range(20, 30)))
    silent = [k for k in range(5, 20) if k in found]
    assert all(found[k] == [True, False, True, True] for k in silent)
    assert silent == list(range(11, 20))  # a quarter of a second after its last picture
    assert pairs.counts.n_partial == len(silent)


def test_too_few_cameras_make_no_set() -> None:
    pairs = pairing()
    for k in range(20):
        for name in ("a", "b"):
            pairs.add(name, shot(k * FRAME_S))
    assert pairs.take(0.0) is None
    pairs.add("c", shot(19 * FRAME_S))
    assert times(pairs.take(0.0)) == [19 * FRAME_S] * 3 + [None]


def test_who_waits_is_woken() -> None:
    pairs = pairing()

    def film() -> None:
        time.sleep(0.05)
        for name in CAMERAS:
            pairs.add(name, shot(1.0))

    thread = threading.Thread(target=film)
    thread.start()
    assert pairs.take(5.0) is not None
    thread.join()
