"""Plots of a comparison as PNG bytes: the choice of epsilon, the sweep over it, the reliability diagram, angles."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mocap.view.overlay import SIDE_COLOURS, side_of_landmark
from mocap.view.plotting import (
    INK,
    LINE_COLOURS,
    empty,
    finish,
    hex_colour,
    inner_legend,
    new_figure,
    note,
    png,
    words,
)

Array = NDArray[np.float64]

_BLUE, _ORANGE, _GREEN = LINE_COLOURS[0], LINE_COLOURS[1], LINE_COLOURS[2]
_GREY = "#9aa5b1"
_MAX_POINTS = 2000


def plot_epsilon(
    errors_mm: Array,
    candidates_mm: Array,
    lilliefors: Array,
    r2: Array,
    by_lilliefors_mm: float,
    by_r2_mm: float,
) -> bytes:
    """How the parameter-free epsilon was found, in three panels (CF Figures 5.4 and 5.6).

    errors_mm : any shape, NaN = unknown.  candidates_mm, lilliefors, r2 : (K,) test functions.  Left: histogram, the
    part up to epsilon with its Gaussian. Middle: quantiles of all errors and of that part against a Gaussian's.
    Right: both test functions over epsilon.
    """
    figure, (left, middle, right) = new_figure(1, height=3.4, width=13.0, n_columns=3)
    errors = np.sort(np.asarray(errors_mm, dtype=np.float64).ravel())
    errors = errors[np.isfinite(errors)]
    kept = errors[errors <= by_lilliefors_mm]
    if len(kept) < 3 or kept[0] == kept[-1]:
        for ax in (left, middle, right):
            empty(ax, "too few errors")
        return png(figure)

    # The longest tail would squeeze what the picture is about into its first bins.
    reach = max(float(np.quantile(errors, 0.98)), 1.2 * by_lilliefors_mm)
    edges = np.linspace(0.0, reach, 50)
    left.hist(errors[errors > by_lilliefors_mm], edges, color=_GREY, label="beyond epsilon")
    left.hist(kept, edges, color=_GREEN, alpha=0.85, label="up to epsilon")
    at = np.linspace(0.0, reach, 300)
    mean, std = kept.mean(), kept.std()
    bell = np.exp(-0.5 * ((at - mean) / std) ** 2) / (std * np.sqrt(2 * np.pi))
    left.plot(at, bell * len(kept) * (edges[1] - edges[0]), color=_BLUE, lw=2.0, label="its Gaussian")
    left.axvline(by_lilliefors_mm, color=INK, lw=1.1, ls=":")
    n_beyond = int((errors > reach).sum())
    more = f" ({n_beyond} errors further right)" if n_beyond else ""
    finish(left, "Errors", f"error (mm){more}", "landmarks")
    inner_legend(left, "upper right")

    for values, colour, label in ((errors, _GREY, "all errors"), (kept, _GREEN, "up to epsilon")):
        quantiles, shown = _quantiles(values)
        middle.plot(quantiles, shown, ".", ms=3.5, color=colour, label=label)
        slope = float(quantiles @ shown / (quantiles @ quantiles))
        ends = np.array([-3.2, 3.2])
        middle.plot(ends, shown.mean() + slope * ends, color=_ORANGE if values is errors else _BLUE, lw=1.2)
    middle.set_ylim(min(0.0, float(kept.mean() - 3.2 * std)), reach)
    finish(middle, "Quantile-quantile plot", "Gaussian quantile", "error (mm)")
    inner_legend(middle, "upper left")

    right.plot(candidates_mm, lilliefors, color=_BLUE, lw=1.8)
    right.axvline(by_lilliefors_mm, color=_BLUE, lw=1.0, ls=":")
    finish(right, "Test functions", "epsilon (mm)", "Lilliefors statistic (least is best)")
    right.yaxis.label.set_color(_BLUE)
    other = right.twinx()
    other.plot(candidates_mm, r2, color=_ORANGE, lw=1.8, ls="--")
    other.axvline(by_r2_mm, color=_ORANGE, lw=1.0, ls=":")
    other.spines["top"].set_visible(False)
    other.tick_params(labelsize=9, colors=INK, color="#8a939e", length=3)
    other.set_ylabel("R² of the line (largest is best)", fontsize=10, color=_ORANGE)
    note(right, f"{by_lilliefors_mm:.0f}", (by_lilliefors_mm, right.get_ylim()[1]), (3, -10))
    return png(figure)


def plot_sweep(
    epsilon_mm: Array, mmta_percent: Array, mmtp_mm: Array, mmtp_std_mm: Array, chosen_mm: Mapping[str, float]
) -> bytes:
    """MMTA (the curve of correct keypoints) and MMTP with its deviation over epsilon.

    epsilon_mm and the others : (K,), NaN where nothing is matched.  chosen_mm : label -> epsilon to mark.
    """
    figure, (left, right) = new_figure(1, height=2.9, width=11.0, n_columns=2)
    left.plot(epsilon_mm, mmta_percent, color=_BLUE, lw=2.0)
    left.set_ylim(0, 103)
    finish(left, "MMTA: landmarks within epsilon", "epsilon (mm)", "%", grid="both")
    right.plot(epsilon_mm, mmtp_mm, color=_BLUE, lw=2.0, label="MMTP")
    right.fill_between(
        epsilon_mm,
        np.maximum(mmtp_mm - mmtp_std_mm, 0.0),
        mmtp_mm + mmtp_std_mm,
        color=_BLUE,
        alpha=0.18,
        lw=0,
        label="± one deviation",
    )
    right.set_ylim(bottom=0)
    finish(right, "MMTP: mean error of those", "epsilon (mm)", "mm", grid="both")
    for i, (label, value) in enumerate(chosen_mm.items()):
        for ax in (left, right):
            style = {"color": (INK, _ORANGE)[i % 2], "lw": 1.1, "ls": (":", "--")[i % 2]}
            ax.axvline(value, label=f"{label}: {value:.0f} mm", **style)
    inner_legend(left, "lower right")
    inner_legend(right, "lower right")
    return png(figure)


def plot_reliability(
    level_percent: Array, coverage_percent: Array, claimed_mm: Array, found_mm: Array
) -> bytes:
    """Whether the reported uncertainty comes true: coverage at every level, and errors against claims.

    level_percent, coverage_percent : (L,).  claimed_mm, found_mm : (B,) groups from the surest to the least sure.
    On the dashed lines the uncertainty is honest.
    """
    figure, (left, right) = new_figure(1, height=3.6, width=9.0, n_columns=2)
    left.plot([0, 100], [0, 100], color=INK, lw=1.0, ls="--")
    left.plot(level_percent, coverage_percent, color=_BLUE, lw=2.0, marker="o", ms=3.5)
    left.fill_between(level_percent, level_percent, coverage_percent, color=_BLUE, alpha=0.15, lw=0)
    left.set_xlim(0, 100)
    left.set_ylim(0, 101)
    left.set_aspect("equal")
    finish(
        left,
        "Reliability (below the line: overconfident)",
        "region should hold (%)",
        "region holds (%)",
        grid="both",
    )

    top = 1.1 * float(max(np.max(claimed_mm), np.max(found_mm)))
    right.plot([0, top], [0, top], color=INK, lw=1.0, ls="--")
    right.plot(claimed_mm, found_mm, color=_ORANGE, lw=1.4, marker="s", ms=4.5)
    right.set_xlim(0, top)
    right.set_ylim(0, top)
    right.set_aspect("equal")
    finish(
        right,
        "Error against claim (above: overconfident)",
        "claimed deviation (mm)",
        "error found, RMS (mm)",
        grid="both",
    )
    return png(figure)


def plot_angle_errors(
    direct_deg: Mapping[str, float | None], fitted_deg: Mapping[str, float | None]
) -> bytes:
    """Mean error of each angle of the reference skeleton: read from the landmarks, and after the fit as a line.

    direct_deg, fitted_deg : angle -> degrees, None = never compared.
    """
    figure, (ax,) = new_figure(1, height=0.6 + 0.27 * max(4, len(direct_deg)))
    place = np.arange(len(direct_deg))
    values = [np.nan if v is None else float(v) for v in direct_deg.values()]
    fitted = [np.nan if (v := fitted_deg.get(n)) is None else float(v) for n in direct_deg]
    colours = [hex_colour(SIDE_COLOURS[side_of_landmark(name)]) for name in direct_deg]
    ax.barh(place, np.nan_to_num(values), color=colours, edgecolor=INK, lw=0.6, height=0.72)
    ax.plot(fitted, place, "|", color=INK, ms=13, mew=2.2, label="after inverse kinematics")
    for y, value in zip(place, values, strict=True):
        plate = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.8}
        note(ax, f"{value:.1f}" if np.isfinite(value) else "not scored", (0, y), (5, -3), bbox=plate)
    ax.set_yticks(place, [words(name) for name in direct_deg])
    ax.invert_yaxis()
    finish(ax, "", "mean error (degrees)", "", grid="x")
    inner_legend(ax, "lower right")
    return png(figure)


def _quantiles(ordered: Array) -> tuple[Array, Array]:
    """At most 2,000 pairs of Gaussian quantile and error, evenly spaced in rank."""
    from scipy.special import ndtri

    n = len(ordered)
    ranks = np.unique(np.linspace(0, n - 1, min(n, _MAX_POINTS)).round().astype(int))
    return ndtri((ranks + 0.5) / n), ordered[ranks]
