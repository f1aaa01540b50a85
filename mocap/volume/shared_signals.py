"""Clocks told from what all cameras see or hear at the same time: a flash, a lamp, a clap, the sound of a room.

Every camera gives one curve on its own clock: how bright its pictures are, or how loud it is. Curves of all pairs are
compared at all lags, each pair says by how much its clocks are apart, and all clocks are put where most pairs agree.
No calibration is needed. Clocks are as good as what was shared: a flash tells half a frame, a clap what sound needs
from one camera to the other (3 ms per metre). `mocap.volume.synchrony` tells more, from people, once cameras have
places.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import correlate, correlation_lags

from mocap.volume.synchrony import ClockEstimate, Curve, Synchrony

Array = NDArray[np.float64]

_RIDGE = 1e-9  # keeps the equations solvable where a camera shares nothing


@dataclass(frozen=True)
class SignalSettings:
    """Numbers of the search, for one kind of signal.

    step_s : between the lags that are tried.  slow_s : what changes more slowly does not count (standard deviation of a
    Gaussian).  least_event : deviations (1.48 of the median one) that something must stand out by to be an event.
    rival_s : lags nearer to the best are no rivals of it.  clear : times that the best must be better than its rivals.
    alike : share of what happened in one of the two clips that must fall together.
    agree_s : pairs that miss the others by more are not believed.  finest_s : no clock is known better.
    harmless_s : by which clocks must be apart to count as off.
    """

    step_s: float
    slow_s: float
    finest_s: float
    agree_s: float
    harmless_s: float
    least_event: float = 8.0
    rival_s: float = 0.2
    clear: float = 1.3
    alike: float = 0.5


def light_settings(fps: float) -> SignalSettings:
    """Of how bright pictures are: a flash falls anywhere into the time of one picture."""
    frame = 1 / fps
    return SignalSettings(frame / 8, 0.5, frame / np.sqrt(12), 1.5 * frame, frame / 2)


SOUND = SignalSettings(step_s=0.001, slow_s=0.05, finest_s=0.005, agree_s=0.03, harmless_s=0.005)
"""Of how loud it is: sound needs 3 ms for a metre, cameras stand some metres apart."""


@dataclass(frozen=True, eq=False)
class Signal:
    """What one camera saw or heard: values (n,) at times_s (n,) of its own clock, ascending."""

    times_s: Array
    values: Array


def synchronise_signals(
    names: Sequence[str],
    signals: Sequence[Signal],
    settings: SignalSettings,
    *,
    max_lag_s: float = 10.0,
    reference: str | None = None,
) -> Synchrony:
    """The clocks of all cameras, from one signal of each.

    reference : camera whose clock counts; None = the one nearest to the middle of all. A camera that shares nothing
    clear with others is not certain. Clocks are taken to run equally fast.
    Raises ValueError for fewer than two cameras or another number of signals.
    """
    if len(names) < 2 or len(signals) != len(names):
        raise ValueError(
            f"synchronise_signals: {len(signals)} signals for {len(names)} cameras, expected two or more"
        )
    starts, events = zip(*(_events(signal, settings) for signal in signals), strict=True)
    lags: dict[tuple[int, int], float] = {}
    for i, j in combinations(range(len(names)), 2):
        lag = _lag(events[i], events[j], starts[i] - starts[j], max_lag_s, settings)
        if lag is not None:
            lags[i, j] = lag
    offset, spread, told = _clocks(lags, len(names), settings)
    middle = np.median(offset[told]) if told.any() else 0.0
    nearest = int(np.where(told, np.abs(offset - middle), np.inf).argmin()) if told.any() else 0
    base = nearest if reference is None else list(names).index(reference)
    offset = np.where(told, offset - offset[base], 0.0)
    clocks = {
        name: ClockEstimate(
            float(offset[c]),
            0.0,
            float(spread[c]),
            0.0,
            is_certain=bool(told[c]),
            is_off=bool(told[c] and abs(offset[c]) > settings.harmless_s),
        )
        for c, name in enumerate(names)
    }
    pairs = [
        (
            Curve(i, j, 0, signals[i].times_s, signals[i].values),
            Curve(j, i, 0, signals[j].times_s, signals[j].values),
        )
        for i, j in lags
    ]
    left = [lag - (offset[i] - offset[j]) for (i, j), lag in lags.items()]
    return Synchrony(
        clocks, names[base], pairs, float(np.sqrt(np.mean(np.square(left)))) if left else float("nan")
    )


def _events(signal: Signal, s: SignalSettings) -> tuple[float, Array]:
    """When an even series begins, and what stands out in it (n,), 0 elsewhere."""
    times = np.arange(signal.times_s[0], signal.times_s[-1] + s.step_s / 2, s.step_s)
    value = np.interp(times, signal.times_s, signal.values)
    fast = value - gaussian_filter1d(value, s.slow_s / s.step_s, mode="nearest")
    usual = 1.4826 * float(np.median(np.abs(fast - np.median(fast))))
    # Nothing at all happens in some clips (a lens cap, silence): then the least change would be an event.
    standing_out = np.abs(fast) / max(usual, 1e-3 * float(np.abs(value).max()), 1e-9)
    return float(times[0]), np.where(standing_out > s.least_event, np.sign(fast) * standing_out, 0.0)


def _lag(a: Array, b: Array, starts_apart: float, max_lag_s: float, s: SignalSettings) -> float | None:
    """Offset of a's clock less that of b's at which events fall together, s; None when it is not clear."""
    if not a.any() or not b.any():
        return None
    alike = np.asarray(correlate(a, b, mode="full", method="fft"))
    lag = correlation_lags(len(a), len(b)) * s.step_s + starts_apart
    allowed = np.abs(lag) <= max_lag_s
    if not allowed.any():
        return None
    alike = np.where(allowed, alike, -np.inf)
    best = int(alike.argmax())
    rivals = alike[np.abs(lag - lag[best]) > s.rival_s]
    most = min(float(a @ a), float(b @ b))
    if alike[best] < s.alike * most or (len(rivals) and alike[best] < s.clear * rivals.max()):
        return None
    top = alike[max(0, best - 1) : best + 2]
    if len(top) < 3 or not np.isfinite(top).all():
        return -float(lag[best])
    bend = top[0] - 2 * top[1] + top[2]
    return -float(lag[best] + (s.step_s * (top[0] - top[2]) / (2 * bend) if bend < 0 else 0.0))


def _clocks(
    lags: dict[tuple[int, int], float], n: int, s: SignalSettings
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Offsets (n,) s that most lags agree with (lag of i, j = offset of i less that of j), deviations, who is told."""
    best: tuple[int, Array] = (0, np.zeros(n))
    for root in range(n):
        # Each camera against one of them: the one that most pairs bear out.
        start = np.array(
            [lags.get((c, root), -lags[root, c] if (root, c) in lags else np.nan) for c in range(n)]
        )
        start[root] = 0.0
        votes = sum(abs(lag - (start[i] - start[j])) < s.agree_s for (i, j), lag in lags.items())
        best = max(best, (votes, start), key=lambda each: each[0])
    votes, offset = best
    kept = {
        pair: lag for pair, lag in lags.items() if abs(lag - (offset[pair[0]] - offset[pair[1]])) < s.agree_s
    }
    told = np.zeros(n, dtype=np.bool_)
    H, g = np.eye(n) * _RIDGE, np.zeros(n)
    for (i, j), lag in kept.items():
        told[[i, j]] = True
        H[[i, j, i, j], [i, j, j, i]] += (1, 1, -1, -1)
        g[[i, j]] += (lag, -lag)
    offset = np.asarray(np.linalg.solve(H, g), dtype=np.float64)
    left = [lag - (offset[i] - offset[j]) for (i, j), lag in kept.items()]
    spread = max(s.finest_s, float(np.sqrt(np.mean(np.square(left)))) if left else 0.0)
    return offset, np.full(n, spread), told
