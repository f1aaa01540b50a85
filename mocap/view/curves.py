"""Curves over time with bands, as drawings inside a page."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mocap.view.html import escaped

Array = NDArray[np.float64]

_WIDTH, _HEIGHT = 420, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 398, 12, 164  # half of "100 %" stands beyond the right end
N_COLOURS = 8
_MOST_POINTS = 400  # a picture has no more columns
# Half width of a band that holds 90 % of a normal distribution, in standard deviations.
_WIDTH_90 = 1.6449


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve.  values, std : (T,), NaN = unknown.  observed : (T,) bool or None = everywhere; dashed elsewhere."""

    label: str
    kind: str
    values: Array
    std: Array | None = None
    observed: NDArray[np.bool_] | None = None


@dataclass(frozen=True, eq=False)
class Chart:
    """Curves with one axis.  frames : (T,).  kind of a curve, for its colour : left, right, middle, or that
    of `colour_of`.  along : what the axis counts: seconds, at which the replay can be put, or percent of something."""

    title: str
    unit: str
    frames: NDArray[np.int64]
    fps: float
    curves: tuple[Curve, ...]
    along: Literal["s", "%"] = "s"


def on_every_frame(chart: Chart) -> Chart:
    """The chart with a row for every frame from the first to the last; new rows are gaps."""
    first, last = int(chart.frames[0]), int(chart.frames[-1])
    if len(chart.frames) == last - first + 1:
        return chart
    rows, n = chart.frames - first, last - first + 1

    def spread(values: Array | None) -> Array | None:
        if values is None:
            return None
        out = np.full(n, np.nan)
        out[rows] = values
        return out

    def seen(observed: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
        if observed is None:
            return None
        out = np.zeros(n, dtype=np.bool_)
        out[rows] = observed
        return out

    curves = tuple(
        replace(c, values=np.asarray(spread(c.values)), std=spread(c.std), observed=seen(c.observed))
        for c in chart.curves
    )
    return replace(chart, frames=np.arange(first, last + 1), curves=curves)


def colour_of(i: int) -> str:
    """The kind of the i-th of several curves that have no sides, for its colour; colours come again after eight."""
    return f"c{i % N_COLOURS}"


def charts_html(charts: Iterable[Chart]) -> str:
    """Charts side by side, as many as fit."""
    return f'<div class="charts">{"".join(_chart(chart) for chart in charts)}</div>'


def _chart(chart: Chart) -> str:
    keep = slice(None, None, max(1, -(-len(chart.frames) // _MOST_POINTS)))
    frames = chart.frames[keep].astype(np.float64)
    low, high = _limits(chart)
    first, last = float(chart.frames[0]), float(max(chart.frames[-1], chart.frames[0] + 1))

    def x_of(frame: Array | float) -> Array:
        return np.asarray(_LEFT + (_RIGHT - _LEFT) * (np.asarray(frame) - first) / (last - first))

    def y_of(value: Array | float) -> Array:
        return np.asarray(_BOTTOM - (_BOTTOM - _TOP) * (np.asarray(value) - low) / (high - low))

    drawn = "".join(
        f'<line class="grid" x1="{_LEFT}" x2="{_RIGHT}" y1="{y_of(v):.1f}" y2="{y_of(v):.1f}"/>'
        f'<text x="{_LEFT - 6}" y="{y_of(v) + 4:.1f}" text-anchor="end">{v + 0.0:g}</text>'
        for v in ticks(low, high)
    )
    drawn += "".join(
        f'<text x="{x_of(s * chart.fps):.1f}" y="{_HEIGHT - 8}" text-anchor="middle">{s:g} {chart.along}</text>'
        for s in ticks(first / chart.fps, last / chart.fps)
    )
    for curve in chart.curves:
        drawn += _drawn(curve, keep, x_of(frames), y_of)
    words = ", ".join(curve.label for curve in chart.curves)
    keys = "".join(f'<span><i class="key {c.kind}"></i>{escaped(c.label)}</span>' for c in chart.curves)
    legend = f'<span class="keys">{keys}</span>' if len(chart.curves) > 1 else ""
    kind, data = "chart", ""
    if chart.along == "s":
        kind = "chart timed"
        data = f' data-first="{first:g}" data-last="{last:g}" data-left="{_LEFT}" data-right="{_RIGHT}"'
        drawn += f'<line class="cursor" x1="{_LEFT}" x2="{_LEFT}" y1="{_TOP}" y2="{_BOTTOM}"/>'
    return (
        f'<figure class="curve"><figcaption><strong>{escaped(chart.title)}</strong> '
        f"<small>{escaped(chart.unit)}</small>{legend}</figcaption>"
        f'<svg class="{kind}" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" '
        f'aria-label="{escaped(chart.title)}: {escaped(words)}"{data}>{drawn}</svg></figure>'
    )


def _drawn(curve: Curve, keep: slice, x: Array, y_of: object) -> str:
    """A curve with its band."""
    assert callable(y_of)
    values = curve.values[keep]
    out = ""
    if curve.std is not None:
        half = _WIDTH_90 * curve.std[keep]
        for rows in _runs(np.isfinite(values) & np.isfinite(half)):
            edges = (y_of(values[rows] + half[rows]), y_of(values[rows] - half[rows]))
            upper, lower = (np.clip(edge, _TOP, _BOTTOM) for edge in edges)
            points = [*zip(x[rows], upper, strict=True), *zip(x[rows][::-1], lower[::-1], strict=True)]
            out += f'<path class="band {curve.kind}" d="{_path(points)}Z"/>'
    known = np.isfinite(values)
    seen = np.ones(len(values), dtype=np.bool_) if curve.observed is None else curve.observed[keep]
    for which, style in ((known & seen, ""), (known, " unseen")):
        for rows in _runs(which):
            points = list(zip(x[rows], y_of(values[rows]), strict=True))
            out += f'<path class="line {curve.kind}{style}" d="{_path(points)}"/>'
    return out


def _limits(chart: Chart) -> tuple[float, float]:
    """Range of the axis: all values, and bands as far as twice the values' own range or twice their usual width; a limb
    that is unknown for a while does not flatten the rest."""
    values = np.concatenate([c.values[np.isfinite(c.values)] for c in chart.curves])
    if not len(values):
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    stds = [c.std[np.isfinite(c.std)] for c in chart.curves if c.std is not None]
    usual = max((float(np.median(own)) for own in stds if len(own)), default=0.0)
    room = max(2.0 * (high - low), 2.0 * _WIDTH_90 * usual, 1e-3)
    for c in chart.curves:
        if c.std is not None:
            known = np.isfinite(c.values) & np.isfinite(c.std)
            if known.any():
                low = min(
                    low, max(float((c.values - _WIDTH_90 * c.std)[known].min()), float(values.min()) - room)
                )
                high = max(
                    high, min(float((c.values + _WIDTH_90 * c.std)[known].max()), float(values.max()) + room)
                )
    margin = 0.04 * max(high - low, 1e-3)
    return low - margin, high + margin


def ticks(low: float, high: float) -> list[float]:
    """Two to six round numbers in a range."""
    step = 10.0 ** np.floor(np.log10(max(high - low, 1e-9)))
    for share in (0.2, 0.5, 1.0, 2.0):
        if (high - low) / (step * share) <= 5:
            step *= share
            break
    return [round(float(v), 6) + 0.0 for v in np.arange(np.ceil(low / step) * step, high + 1e-9, step)]


def _runs(which: NDArray[np.bool_]) -> list[slice]:
    """Stretches of at least two neighbours that are true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], which, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 1]


def _path(points: Iterable[tuple[float, float]]) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
