"""Plots of a run as PNG bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import LANDMARKS
from mocap.view.overlay import SIDE_COLOURS, side_of_landmark
from mocap.view.plotting import (
    INK,
    LINE_COLOURS,
    empty,
    finish,
    hex_colour,
    marker_of,
    new_figure,
    note,
    png,
    words,
)

Array = NDArray[np.float64]
Frames = NDArray[np.integer]


def plot_error_over_time(
    errors_mm: Mapping[int, tuple[Frames, Array]],
    *,
    epsilon_mm: float = 100.0,
    names: Sequence[str] = LANDMARKS,
) -> bytes:
    """Mean and worst landmark error of each person in each frame, with the line of epsilon.

    errors_mm : person -> (frames (T,), errors (T, M) mm); NaN = not scored. No persons give an empty plot.
    The landmark that is worst most often is named.
    """
    figure, axes = new_figure(max(1, len(errors_mm)), height=2.5)
    for ax, (person, (frames, errors)) in zip(axes, errors_mm.items(), strict=False):
        mean, worst = _row_statistic(errors, np.mean), _row_statistic(errors, np.max)
        ax.plot(
            frames,
            worst,
            marker=marker_of(frames),
            color=LINE_COLOURS[1],
            lw=1.1,
            ls="--",
            label="worst landmark",
        )
        ax.plot(
            frames,
            mean,
            marker=marker_of(frames),
            color=LINE_COLOURS[0],
            lw=2.0,
            label="mean of all landmarks",
        )
        ax.axhline(epsilon_mm, color=INK, lw=1.0, ls=":", label=f"epsilon = {epsilon_mm:g} mm")
        ax.set_ylim(0, 1.08 * max(epsilon_mm, float(np.nanmax(worst)) if np.isfinite(worst).any() else 0))
        known = np.isfinite(errors).any(axis=1)
        title = f"Person {person}"
        if known.any():
            often = np.bincount(np.nanargmax(errors[known], axis=1), minlength=errors.shape[1])
            title += f" (worst most often: {words(names[int(np.argmax(often))])})"
        finish(ax, title, "", "error (mm)", legend=True)
    if not errors_mm:
        empty(axes[0], "no truth to compare with")
    axes[-1].set_xlabel("frame")
    return png(figure)


def plot_landmark_errors(
    mean_mm: Mapping[str, float], std_mm: Mapping[str, float] | None = None, *, epsilon_mm: float = 100.0
) -> bytes:
    """Mean error of each landmark as bars, coloured by side, with the spread where given.

    mean_mm, std_mm : landmark name -> mm; NaN = never scored.
    """
    figure, (ax,) = new_figure(1, height=0.6 + 0.27 * max(4, len(mean_mm)))
    values = [float(v) if v is not None else np.nan for v in mean_mm.values()]
    place = np.arange(len(values))
    spread = None if std_mm is None else [std_mm.get(name, 0.0) or 0.0 for name in mean_mm]
    colours = [hex_colour(SIDE_COLOURS[side_of_landmark(name)]) for name in mean_mm]
    if values:
        ax.barh(
            place, np.nan_to_num(values), xerr=spread, color=colours, edgecolor=INK, lw=0.6, height=0.72,
            error_kw={"ecolor": INK, "elinewidth": 0.9, "capsize": 2},
        )  # fmt: skip
        _note_values(ax, values)
        ax.axvline(epsilon_mm, color=INK, lw=1.0, ls=":")
        note(ax, f"epsilon = {epsilon_mm:g}", (epsilon_mm, -0.5), (3, 2))
    else:
        empty(ax, "no truth to compare with")
    ax.set_yticks(place, [words(name) for name in mean_mm])
    ax.invert_yaxis()
    finish(
        ax,
        "",
        "mean error (mm); whisker: one standard deviation" if std_mm else "mean error (mm)",
        "",
        grid="x",
    )
    return png(figure)


def _note_values(ax: Any, values: Sequence[float]) -> None:
    """The number of each bar at its foot."""
    for y, value in enumerate(values):
        text = f"{value:.0f}" if np.isfinite(value) else "not scored"
        plate = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.8}
        note(ax, text, (0, y), (5, -3), bbox=plate)


def _row_statistic(errors: Array, statistic: Any) -> Array:
    """Statistic of the finite errors of each row, NaN where a row has none."""
    rows = [row[np.isfinite(row)] for row in np.asarray(errors, dtype=np.float64)]
    return np.array([float(statistic(row)) if row.size else np.nan for row in rows])
