"""Clocks told from flashes and claps: curves with known offsets, with noise, with what only some cameras notice."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mocap.volume.shared_signals import SOUND, Signal, light_settings, synchronise_signals

Array = NDArray[np.float64]

NAMES = ("a", "b", "c", "d")
OFFSETS = np.array([0.0, 1.234, -0.517, 3.3])
EVENTS_S = (6.21, 9.87, 10.4)
FPS = 30.0


def bright(
    offset: float, seed: int, *, fps: float = FPS, events: tuple[float, ...] = EVENTS_S, seconds: float = 18.0
) -> Signal:
    """Mean brightness of pictures, each open for half of its time, with noise and slow change."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(seconds * fps)) / fps
    level = 90 + 5 * np.sin(0.4 * (times + offset)) + rng.normal(0, 0.15, len(times))
    for at in events:
        # A torch, on for a twentieth of a second.
        opens, shuts = times + offset, times + offset + 0.5 / fps
        level += 40 * np.clip(np.minimum(shuts, at + 0.05) - np.maximum(opens, at), 0, None) * 2 * fps
    return Signal(times, level)


def offsets(found: dict[str, float]) -> Array:
    return np.array([found[name] for name in NAMES])


def test_flashes_tell_half_a_frame() -> None:
    signals = [bright(offset, k) for k, offset in enumerate(OFFSETS)]
    found = synchronise_signals(NAMES, signals, light_settings(FPS), reference="a")
    error = offsets({n: c.offset_s for n, c in found.clocks.items()}) - OFFSETS
    assert np.abs(error).max() < 1 / FPS
    assert found.reference == "a"
    assert [c.is_off for c in found.clocks.values()] == [False, True, True, True]
    assert all(c.offset_std_s >= 1 / FPS / np.sqrt(12) - 1e-12 for c in found.clocks.values())


def test_claps_tell_milliseconds() -> None:
    signals = []
    for k, offset in enumerate(OFFSETS):
        rng = np.random.default_rng(20 + k)
        times = np.arange(18000) * 0.001
        level = -60 + rng.normal(0, 1.0, len(times))
        for at in EVENTS_S:
            since = times + offset - at
            level = np.where(since > 0, np.maximum(level, -60 + 45 * np.exp(-since / 0.05)), level)
        signals.append(Signal(times, level))
    found = synchronise_signals(NAMES, signals, SOUND, reference="a")
    error = offsets({n: c.offset_s for n, c in found.clocks.items()}) - OFFSETS
    assert np.abs(error).max() < 0.003


def test_the_reference_is_the_camera_in_the_middle() -> None:
    signals = [bright(offset, k) for k, offset in enumerate(OFFSETS)]
    found = synchronise_signals(NAMES[:3], signals[:3], light_settings(FPS))
    assert found.reference == "a"
    assert found.clocks["a"].offset_s == 0.0


def test_cameras_of_different_rates() -> None:
    signals = [bright(0.0, 1), bright(1.0, 2, fps=50.0), bright(-0.4, 3, fps=25.0)]
    found = synchronise_signals(NAMES[:3], signals, light_settings(FPS), reference="a")
    got = [c.offset_s for c in found.clocks.values()]
    np.testing.assert_allclose(got, [0.0, 1.0, -0.4], atol=1 / FPS)


def test_a_camera_that_saw_no_flash_is_not_told() -> None:
    signals = [bright(offset, k) for k, offset in enumerate(OFFSETS)]
    signals[2] = bright(OFFSETS[2], 2, events=())
    found = synchronise_signals(NAMES, signals, light_settings(FPS), reference="a")
    assert [c.is_certain for c in found.clocks.values()] == [True, True, False, True]
    assert not found.clocks["c"].is_off


def test_lights_that_flash_evenly_tell_nothing() -> None:
    even = tuple(np.arange(1.0, 40.0, 1.5))
    signals = [bright(offset, k, events=even) for k, offset in enumerate(OFFSETS)]
    found = synchronise_signals(NAMES, signals, light_settings(FPS))
    assert not any(c.is_certain for c in found.clocks.values())


def test_one_camera_with_a_flash_of_its_own_does_not_move_the_others() -> None:
    signals = [bright(offset, k) for k, offset in enumerate(OFFSETS)]
    signals[3] = bright(OFFSETS[3], 3, events=(5.0, 12.0, 12.9))
    found = synchronise_signals(NAMES, signals, light_settings(FPS), reference="a")
    error = offsets({n: c.offset_s for n, c in found.clocks.items()})[:3] - OFFSETS[:3]
    assert np.abs(error).max() < 1 / FPS
    assert not found.clocks["d"].is_certain


def test_lags_beyond_the_limit_are_not_looked_for() -> None:
    signals = [bright(offset, k) for k, offset in enumerate(OFFSETS)]
    found = synchronise_signals(NAMES, signals, light_settings(FPS), max_lag_s=2.0, reference="a")
    assert not found.clocks["d"].is_off


def test_signals_that_do_not_belong_to_cameras() -> None:
    with pytest.raises(ValueError, match="1 signals for 2"):
        synchronise_signals(NAMES[:2], [bright(0.0, 1)], SOUND)
