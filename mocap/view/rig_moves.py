"""Where cameras were and are: a refined calibration seen from above, and what it gained."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mocap.arrays import Array
from mocap.view.plotting import LINE_COLOURS, finish, new_figure, png

_MM = 1000.0
_LOOK_M = 0.5  # length of a line of sight in the picture
_ENLARGED = 10  # moves are centimetres in a room of metres


class CameraShift(NamedTuple):
    """One camera, seen from above.

    before, after : (2,) m.  looks : (2,) direction.  apart_m : median distance of its lines of sight from
    others', before and after.
    """

    name: str
    before: Array
    after: Array
    looks: Array
    apart_m: tuple[float, float]


def plot_moves(cameras: Sequence[CameraShift]) -> bytes:
    """PNG: the rig from above with moves drawn ten times as long, and the distance of lines of sight by camera."""
    figure, (plan, bars) = new_figure(1, height=4.4, width=11.0, n_columns=2)
    for camera in cameras:
        end = camera.before + _ENLARGED * (camera.after - camera.before)
        plan.annotate(
            "", end, camera.before, arrowprops={"arrowstyle": "->", "color": LINE_COLOURS[1], "lw": 1.6}
        )
        sight = np.stack([camera.before, camera.before + _LOOK_M * camera.looks])
        plan.plot(*sight.T, color="0.75", lw=1.0)
        plan.plot(*camera.before, "o", color=LINE_COLOURS[0], ms=4)
        plan.annotate(camera.name, camera.before, textcoords="offset points", xytext=(6, 5), fontsize=8)
    plan.set_aspect("equal")
    plan.margins(0.2)
    finish(plan, f"from above; moves x {_ENLARGED}", "x, m", "y, m", legend=False, small=True)
    at = np.arange(len(cameras))
    for k, (word, colour) in enumerate((("as calibrated", "0.75"), ("refined", LINE_COLOURS[1]))):
        bars.bar(at + 0.4 * k - 0.2, [_MM * c.apart_m[k] for c in cameras], 0.4, label=word, color=colour)
    bars.set_xticks(at, [c.name for c in cameras])
    bars.set_yscale("log")
    finish(bars, "lines of sight along tangents", "", "apart, mm (median)", legend=True, small=True)
    return png(figure)
