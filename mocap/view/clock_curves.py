"""A picture that proves clocks: what two cameras see of one plane, as filmed and on the clock that was found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap.view.plotting import LINE_COLOURS, empty, finish, new_figure, png

Array = NDArray[np.float64]

_MOST_SHOWN = 8


class ClockCurve(NamedTuple):
    """A curve of a camera and of another one that stands in for all others.

    names : of the camera and the other.  times_s : their times as filmed.  on_clock_s : the same, corrected.
    values : what they see or hear.  what : that is, with its unit.  said : in words, how the camera's clock is off.
    """

    names: tuple[str, str]
    times_s: tuple[Array, Array]
    on_clock_s: tuple[Array, Array]
    values: tuple[Array, Array]
    what: str
    said: str


def plot_clocks(curves: Sequence[ClockCurve]) -> bytes:
    """PNG: one row per camera, as filmed on the left, corrected on the right."""
    shown = curves[:_MOST_SHOWN]
    figure, axes = new_figure(max(1, len(shown)), height=1.9, width=11.0, n_columns=2)
    if not shown:
        for ax in axes:
            empty(ax, "all clocks agree")
    for row, curve in enumerate(shown):
        levels = _levels(curve)
        for column, (times, title) in enumerate(
            ((curve.times_s, f"{curve.names[0]}: as filmed"), (curve.on_clock_s, curve.said))
        ):
            ax = axes[2 * row + column]
            for i, (name, t, values) in enumerate(zip(curve.names, times, curve.values, strict=True)):
                ax.plot(t, values - levels[i], label=name, lw=1.3, color=LINE_COLOURS[i])
            is_last = row == len(shown) - 1
            finish(ax, title, "time, s" if is_last else "", curve.what, legend=column == 1, small=True)
    return png(figure)


def _levels(curve: ClockCurve) -> tuple[float, float]:
    """What to take off each of the two, m: calibration and masks keep them a constant apart."""
    (t_a, t_b), (a, b) = curve.on_clock_s, curve.values
    level = float(np.nanmedian(a))
    apart = np.interp(t_a, t_b, b, left=np.nan, right=np.nan) - a
    return level, level + (float(np.nanmedian(apart)) if np.isfinite(apart).any() else 0.0)
