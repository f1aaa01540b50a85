"""Things that were tracked as persons: who keeps still, and what no pose explains."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mocap.pose.method import ThingSettings
from mocap.pose.thing import Look, ThingWatch, colour_change, has_head, is_like_nobody, is_thing

NUMBERS = ThingSettings()
FPS, T = 10.0, 60
FAR = 2 * NUMBERS.stays_m


def track(n_away: int = 0, n: int = T) -> np.ndarray:
    """A place that is left for n_away of n frames; its height changes all the time."""
    xyz = np.zeros((n, 3))
    xyz[:n_away, 1] = FAR
    xyz[:, 2] = np.linspace(0, 2, n)
    return xyz


STRANGE, USUAL = NUMBERS.misfit_nats + 1, NUMBERS.misfit_nats - 1


def test_what_stays_and_has_no_pose_is_like_nobody() -> None:
    assert is_like_nobody(track(), np.full(T, STRANGE), NUMBERS)
    assert not is_like_nobody(track(), np.full(T, USUAL), NUMBERS)


def test_half_of_the_frames_decide() -> None:
    few, most = (np.where(np.arange(T) < n, STRANGE, USUAL) for n in (T // 2 - 1, T // 2 + 1))
    assert not is_like_nobody(track(), few, NUMBERS)
    assert is_like_nobody(track(), most, NUMBERS)


def test_who_was_never_seen_is_not_asked() -> None:
    assert not is_like_nobody(track(), np.zeros(0), NUMBERS)


def test_who_passes_a_thing_may_move_its_centre_for_a_moment() -> None:
    n_passing = round((1 - NUMBERS.stays_share) * T) - 1
    assert is_like_nobody(track(n_passing), np.full(T, STRANGE), NUMBERS)
    assert not is_like_nobody(track(n_passing + 2), np.full(T, STRANGE), NUMBERS)


NOTHING = np.zeros((0, 3))


def surface(colour_of: Any, n_looks: int = 10, n_voxels: int = 50) -> list[Look]:
    """Looks at the same voxels: look -> grey level, of every voxel."""
    voxels = np.arange(n_voxels, dtype=np.int32)
    return [
        Look(NOTHING, voxels, np.broadcast_to(np.asarray(colour_of(k), dtype=np.uint8), (n_voxels, 3)).copy())
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
    both = [
        Look(NOTHING, np.r_[a.surface, b.surface + 50], np.concatenate([a.rgb, b.rgb]))
        for a, b in zip(still, moving, strict=True)
    ]
    assert colour_change(both, 0.6) == pytest.approx(2.0)


def test_voxels_that_come_and_go_say_nothing() -> None:
    passing = [
        Look(NOTHING, np.r_[look.surface, [90]], np.concatenate([look.rgb, [[40 * k] * 3]]))
        if k < 5
        else look
        for k, look in enumerate(surface(lambda k: 100))
    ]
    assert colour_change(passing, 0.6) == 0.0
    assert colour_change(passing, 0.5) == pytest.approx(40 / 51)  # 0, 40, 80, 120, 160: 40 off in the middle


VOXEL_M = 0.02


def pile(*boxes: tuple[float, float, float]) -> np.ndarray:
    """Voxels of square boxes: side, lower and upper end in m."""
    parts = []
    for side, lower, upper in boxes:
        axis, up = (
            np.arange(a + VOXEL_M / 2, b, VOXEL_M) for a, b in ((-side / 2, side / 2), (lower, upper))
        )
        parts.append(np.stack(np.meshgrid(axis, axis, up, indexing="ij"), axis=-1).reshape(-1, 3))
    return np.concatenate(parts)


SITTER = pile((0.6, 0.0, 0.5), (0.36, 0.5, 1.0), (0.18, 1.0, 1.24))
BOX = pile((0.46, 0.0, 1.3))


@pytest.mark.parametrize(
    ("volume", "is_head"),
    [
        (SITTER, True),
        (SITTER - [0, 0, 0.2], True),
        (SITTER - [0, 0, 0.3], False),  # as low as a box
        (BOX, False),
        (pile((0.46, 0.0, 1.1), (0.18, 1.1, 1.2)), False),  # a roof that widens where a head does not
        (pile((0.46, 0.0, 1.1), (0.18, 1.1, 1.26)), False),
        (pile((0.46, 0.0, 1.1), (0.18, 1.1, 1.34)), True),
        (NOTHING, False),
    ],
)
def test_a_head_is_narrow_and_high(volume: np.ndarray, is_head: bool) -> None:
    assert has_head(volume, VOXEL_M, NUMBERS) == is_head


def test_sections_of_heads_are_measured_on_any_voxels() -> None:
    side = np.sqrt(NUMBERS.head_m2)
    for voxel_m in (0.02, 0.03):
        for factor, is_head in ((0.9, True), (1.1, False)):
            axis, up = np.arange(-0.2, 0.2, voxel_m), np.arange(0.8, 1.3, voxel_m)
            grid = np.stack(np.meshgrid(axis, axis, up, indexing="ij"), axis=-1).reshape(-1, 3)
            n_wanted = round(factor * side**2 / voxel_m**2)
            columns = np.unique(grid[:, :2], axis=0)[:n_wanted]
            kept = (grid[:, None, :2] == columns[None]).all(axis=2).any(axis=1)
            assert has_head(grid[kept], voxel_m, NUMBERS) == is_head, (voxel_m, factor)


def looks_of(volumes: list[np.ndarray], change: int = 0) -> list[Look]:
    """Looks at volumes whose colours are as far from the usual one as told."""
    coloured = surface(lambda k: 100 + 2 * change * (k % 2), len(volumes))
    return [Look(volume, look.surface, look.rgb) for volume, look in zip(volumes, coloured, strict=True)]


def test_a_thing_keeps_its_colours() -> None:
    assert is_thing(looks_of([BOX] * 10, change=1), VOXEL_M, NUMBERS)
    assert not is_thing(looks_of([BOX] * 10, change=3), VOXEL_M, NUMBERS)


def test_a_thing_has_no_head_in_most_looks() -> None:
    assert is_thing(looks_of([SITTER] * 4 + [BOX] * 6), VOXEL_M, NUMBERS)
    assert not is_thing(looks_of([SITTER] * 6 + [BOX] * 4), VOXEL_M, NUMBERS)


def test_without_colours_nothing_is_a_thing() -> None:
    nothing = [Look(BOX, np.zeros(0, dtype=np.int32), np.zeros((0, 3), dtype=np.uint8))] * 5
    assert colour_change(nothing, 0.6) is None
    assert colour_change([], 0.6) is None
    assert not is_thing(nothing, VOXEL_M, NUMBERS)


def watched(
    *,
    seconds: float,
    misfit: float | None = STRANGE,
    volume: np.ndarray = BOX,
    fps: float = FPS,
    watch: ThingWatch | None = None,
    from_s: float = 0.0,
    x_m: float = 0.0,
) -> ThingWatch:
    """A watch that has seen something for so long in one place."""
    watch = watch or ThingWatch(VOXEL_M, NUMBERS)
    for k in range(round(seconds * fps) + 1):
        watch.see(from_s + k / fps, np.array([x_m, 0.0, 0.5]), misfit, lambda: looks_of([volume])[0])
    return watch


def test_what_is_seen_without_end_is_a_thing_after_a_while() -> None:
    assert watched(seconds=NUMBERS.watched_s).is_thing
    assert not watched(seconds=0.8 * NUMBERS.watched_s).is_thing


def test_who_has_a_pose_or_a_head_is_no_thing() -> None:
    long_s = 3 * NUMBERS.watched_s
    assert not watched(seconds=long_s, misfit=USUAL).is_thing
    assert not watched(seconds=long_s, misfit=None).is_thing
    assert not watched(seconds=long_s, volume=SITTER).is_thing


def test_only_the_last_seconds_are_asked() -> None:
    watch = watched(seconds=3 * NUMBERS.watched_s, misfit=USUAL)
    at_s = 3 * NUMBERS.watched_s + 1 / FPS
    watched(seconds=0.4 * NUMBERS.watched_s, watch=watch, from_s=at_s)
    assert not watch.is_thing
    at_s += 0.4 * NUMBERS.watched_s + 1 / FPS
    watched(seconds=0.2 * NUMBERS.watched_s, watch=watch, from_s=at_s)
    assert watch.is_thing


def test_a_few_frames_a_second_do_and_two_moments_do_not() -> None:
    assert watched(seconds=NUMBERS.watched_s, fps=4.0).is_thing
    assert not watched(seconds=NUMBERS.watched_s, fps=1 / NUMBERS.watched_s).is_thing


def test_it_is_looked_at_now_and_then_and_no_more_once_it_is_a_thing() -> None:
    asked: list[float] = []
    watch = ThingWatch(VOXEL_M, NUMBERS)
    n = round(2 * NUMBERS.watched_s * 50)
    for k in range(n):
        watch.see(k / 50, np.zeros(3), STRANGE, lambda k=k: (asked.append(k / 50), looks_of([BOX])[0])[1])
    assert watch.is_thing
    assert np.diff(asked).min() >= NUMBERS.watched_s / NUMBERS.n_looks - 1e-9
    assert max(asked) <= NUMBERS.watched_s


def test_a_thing_that_is_taken_elsewhere_is_looked_at_anew() -> None:
    watch = watched(seconds=NUMBERS.watched_s)
    at_s = NUMBERS.watched_s + 1 / FPS
    # Who passes moves its centre for a moment.
    watched(seconds=0.4 * NUMBERS.watched_s, watch=watch, from_s=at_s, x_m=FAR, misfit=None)
    assert watch.is_thing
    at_s += 0.4 * NUMBERS.watched_s + 1 / FPS
    watched(seconds=0.2 * NUMBERS.watched_s, watch=watch, from_s=at_s, x_m=FAR, misfit=None)
    assert not watch.is_thing
    at_s += 0.2 * NUMBERS.watched_s + 1 / FPS
    watched(seconds=0.7 * NUMBERS.watched_s, watch=watch, from_s=at_s, x_m=FAR)
    assert not watch.is_thing
    at_s += 0.7 * NUMBERS.watched_s + 1 / FPS
    watched(seconds=0.4 * NUMBERS.watched_s, watch=watch, from_s=at_s, x_m=FAR)
    assert watch.is_thing
