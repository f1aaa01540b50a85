"""Things that were tracked as persons: who keeps still, and what no pose explains."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocap.pose.method import ThingSettings
from mocap.pose.thing import colour_change, is_like_nobody, keeps_its_colours

NUMBERS = ThingSettings()
FPS, T = 10.0, 40
FAR = 2 * NUMBERS.stays_m


def followed(misfit: float | np.ndarray, n_blind: int = 0) -> Any:
    """T frames in which two parts share a misfit; nothing was seen in the last n_blind."""
    of_part = np.repeat(np.broadcast_to(misfit, T)[:, None] / 2, 2, axis=1)
    blind_std = np.where(np.arange(T) < T - n_blind, 0.0, 0.5)
    return SimpleNamespace(
        tools=SimpleNamespace(fps=FPS), series=SimpleNamespace(misfit=of_part, blind_std=blind_std)
    )


def track(n_away: int = 0, n: int = T) -> np.ndarray:
    """A place that is left for n_away of n frames; its height changes all the time."""
    xyz = np.zeros((n, 3))
    xyz[:n_away, 1] = FAR
    xyz[:, 2] = np.linspace(0, 2, n)
    return xyz


STRANGE, USUAL = NUMBERS.misfit_nats + 1, NUMBERS.misfit_nats - 1


def test_what_stays_and_has_no_pose_is_like_nobody() -> None:
    assert is_like_nobody(followed(STRANGE), track(), NUMBERS)
    assert not is_like_nobody(followed(USUAL), track(), NUMBERS)


def test_half_of_the_frames_decide() -> None:
    few, most = (np.where(np.arange(T) < n, STRANGE, USUAL) for n in (T // 2 - 1, T // 2 + 1))
    assert not is_like_nobody(followed(few), track(), NUMBERS)
    assert is_like_nobody(followed(most), track(), NUMBERS)


def test_frames_in_which_nothing_was_seen_say_nothing() -> None:
    misfit = np.where(np.arange(T) < 10, STRANGE, 0.0)
    assert is_like_nobody(followed(misfit, n_blind=T - 10), track(), NUMBERS)
    assert not is_like_nobody(followed(misfit), track(), NUMBERS)
    assert not is_like_nobody(followed(STRANGE, n_blind=T), track(), NUMBERS)


def test_who_passes_a_thing_may_move_its_centre_for_a_moment() -> None:
    n_passing = round((1 - NUMBERS.stays_share) * T) - 1
    assert is_like_nobody(followed(STRANGE), track(n_passing), NUMBERS)
    assert not is_like_nobody(followed(STRANGE), track(n_passing + 2), NUMBERS)


def test_who_was_there_for_a_moment_is_not_asked() -> None:
    least = round(NUMBERS.least_s * FPS)
    assert is_like_nobody(followed(STRANGE), track(n=least), NUMBERS)
    assert not is_like_nobody(followed(STRANGE), track(n=least - 1), NUMBERS)


def surface(colour_of: Any, n_looks: int = 10, n_voxels: int = 50) -> list[Any]:
    """Looks at the same voxels: look -> grey level, of every voxel."""
    voxels = np.arange(n_voxels, dtype=np.int32)
    return [
        (voxels, np.broadcast_to(np.asarray(colour_of(k), dtype=np.uint8), (n_voxels, 3)).copy())
        for k in range(n_looks)
    ]


def test_colours_change_by_their_usual_distance_from_the_usual_one() -> None:
    assert colour_change(surface(lambda k: 100), 0.6) == 0.0
    # 100, 104, 100, 104 ...: the usual colour is 102.
    assert colour_change(surface(lambda k: 100 + 4 * (k % 2)), 0.6) == pytest.approx(2.0)
    # One channel of three changes.
    assert colour_change(surface(lambda k: [100, 100, 100 + 6 * (k % 2)]), 0.6) == pytest.approx(1.0)


def test_who_passes_before_a_thing_changes_few_of_its_looks() -> None:
    assert colour_change(surface(lambda k: 100 if k > 3 else 200), 0.6) == 0.0


def test_half_a_surface_that_changes_is_half_the_change() -> None:
    still, moving = surface(lambda k: 100), surface(lambda k: 100 + 8 * (k % 2))
    both = [(np.r_[a, b + 50], np.concatenate([c, d])) for (a, c), (b, d) in zip(still, moving, strict=True)]
    assert colour_change(both, 0.6) == pytest.approx(2.0)


def test_voxels_that_come_and_go_say_nothing() -> None:
    steady = surface(lambda k: 100)
    passing = [
        (np.r_[voxels, [90]] if k < 5 else voxels, np.concatenate([rgb, [[40 * k] * 3]]) if k < 5 else rgb)
        for k, (voxels, rgb) in enumerate(steady)
    ]
    assert colour_change(passing, 0.6) == 0.0
    assert colour_change(passing, 0.5) == pytest.approx(40 / 51)  # 0, 40, 80, 120, 160: 40 off in the middle


@pytest.mark.parametrize(("levels", "is_still"), [(2.1, True), (1.9, False)])
def test_a_thing_keeps_its_colours(levels: float, is_still: bool) -> None:
    looks = surface(lambda k: 100 + 4 * (k % 2))  # a change of 2
    assert keeps_its_colours(looks, ThingSettings(colour_levels=levels)) == is_still


def test_without_colours_nothing_is_a_thing() -> None:
    nothing = [(np.zeros(0, dtype=np.int32), np.zeros((0, 3), dtype=np.uint8))] * 5
    assert colour_change(nothing, 0.6) is None
    assert colour_change([], 0.6) is None
    assert not keeps_its_colours(nothing, NUMBERS)
