"""The room from above as an SVG file: cameras, and the path of every person.

Drawn by hand: a plotting library takes longer to load than the rest of a report to be made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig, Tracks
from mocap.view.curves import ticks
from mocap.view.html import escaped
from mocap.view.overlay import person_colour
from mocap.view.plotting import FAINT, INK, hex_colour

Array = NDArray[np.float64]

_WIDTH, _HEIGHT = 620.0, 560.0  # px that the room may take
_LEFT, _TOP, _BOTTOM, _LEGEND = 52.0, 46.0, 44.0, 150.0
_MARGIN_M = 0.7
_EDGE_M = 0.6  # how far the directions of a picture's edges are drawn
_MOST_POINTS = 1500  # of one piece of a path
_MOST_NAMES = 16
_AXIS = "#8a939e"


@dataclass(frozen=True)
class _Plan:
    """Where the room lies in the drawing.  lower, upper : corners of what is shown, m."""

    lower: Array
    upper: Array

    @property
    def scale(self) -> float:
        """Px of a metre."""
        width, height = self.upper - self.lower
        return float(min(_WIDTH / width, _HEIGHT / height))

    @property
    def size(self) -> Array:
        return (self.upper - self.lower) * self.scale

    def at(self, places: Array) -> Array:
        """Places (..., 2) m in the drawing, px."""
        x = _LEFT + (places[..., 0] - self.lower[0]) * self.scale
        y = _TOP + (self.upper[1] - places[..., 1]) * self.scale
        return np.stack([x, y], axis=-1)


def track_map_svg(
    rig: CameraRig,
    tracks: Tracks | None,
    truth: Tracks | None = None,
    *,
    bounds_m: Sequence[Sequence[float]] | None = None,
) -> bytes:
    """The room from above: cameras with their viewing direction, paths of the persons, truth dashed.

    tracks, truth : world frame; None or empty draws no path.  bounds_m : lower and upper corner of the room.
    White dots on a path: the person was out of sight there.
    """
    corners = np.empty((0, 2)) if bounds_m is None else np.asarray(bounds_m, dtype=np.float64)[:, :2]
    shown = [np.array([camera.center[:2] for camera in rig]), corners]
    shown += [table.xyz[np.isfinite(table.xyz).all(axis=1), :2] for table in (tracks, truth) if table]
    everything = np.vstack(shown)
    plan = _Plan(everything.min(axis=0) - _MARGIN_M, everything.max(axis=0) + _MARGIN_M)
    drawn = [_axes(plan), *(_camera(plan, camera) for camera in rig)]
    names = []
    if len(corners):
        drawn.append(_line(plan, _box(*corners), f'stroke="{_AXIS}" stroke-width="1.4"'))
        names.append(("room", f'stroke="{_AXIS}" stroke-width="1.4"'))
    for table, is_truth in ((tracks, False), (truth, True)):
        for person in () if table is None else table.persons:
            assert table is not None
            colour = INK if is_truth else hex_colour(person_colour(person))
            style = f'stroke="{colour}" stroke-width="{1.2 if is_truth else 2.6}"'
            style += ' stroke-dasharray="6 4"' if is_truth else ""
            names.append((f"{'truth' if is_truth else 'person'} {person}", style))
            for piece in table.paths(person):
                drawn.append(_line(plan, piece.xyz[:, :2], style))
                drawn += [] if is_truth else [_marks(plan, piece, colour)]
    title = "Seen from above; circle = start, diamond = end, white dots = out of sight"
    return _file(plan, drawn + _legend(plan, names), title if tracks else "")


def _file(plan: _Plan, drawn: Sequence[str], title: str) -> bytes:
    width, height = plan.size[0] + _LEFT + _LEGEND, plan.size[1] + _TOP + _BOTTOM
    head = f'<text x="{_LEFT}" y="24" font-weight="bold">{title}</text>' if title else ""
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" font-family="system-ui, sans-serif" font-size="13" fill="{INK}">'
        f'<rect width="100%" height="100%" fill="white"/>{head}{"".join(drawn)}</svg>\n'
    )
    return text.encode("utf-8", "replace")


def _axes(plan: _Plan) -> str:
    """A faint grid of round metres, their numbers, and what they count."""
    (left, bottom), (right, top) = plan.at(plan.lower), plan.at(plan.upper)
    lines, numbers = "", ""
    for x in ticks(plan.lower[0], plan.upper[0]):
        u = plan.at(np.array([x, 0.0]))[0]
        lines += f"M{u:.1f} {bottom:.1f}V{top:.1f}"
        numbers += f'<text x="{u:.1f}" y="{bottom + 17:.1f}" text-anchor="middle">{x:g}</text>'
    for y in ticks(plan.lower[1], plan.upper[1]):
        v = plan.at(np.array([0.0, y]))[1]
        lines += f"M{left:.1f} {v:.1f}H{right:.1f}"
        numbers += f'<text x="{left - 7:.1f}" y="{v + 4:.1f}" text-anchor="end">{y:g}</text>'
    middle = (bottom + top) / 2
    return (
        f'<path d="{lines}" stroke="{FAINT}"/>'
        f'<path d="M{left:.1f} {top:.1f}V{bottom:.1f}H{right:.1f}" fill="none" stroke="{_AXIS}"/>{numbers}'
        f'<text x="{(left + right) / 2:.1f}" y="{bottom + 36:.1f}" text-anchor="middle">x (m)</text>'
        f'<text x="16" y="{middle:.1f}" text-anchor="middle" transform="rotate(-90 16 {middle:.1f})">y (m)</text>'
    )


def _camera(plan: _Plan, camera: Camera) -> str:
    """A square with the directions of the left and right edge of the picture."""
    w, h = camera.size
    edge = camera.rays(np.array([[0.0, h / 2], [w - 1.0, h / 2]]))[:, :2]
    edge = _EDGE_M * edge / np.maximum(np.linalg.norm(edge, axis=1, keepdims=True), 1e-9)
    (u, v), *ends = plan.at(camera.center[:2] + np.vstack([np.zeros(2), edge]))
    wedge = "L".join(f"{x:.1f} {y:.1f}" for x, y in [(u, v), *ends])
    return (
        f'<path d="M{wedge}Z" fill="#aab4bf" opacity="0.45"/>'
        f'<rect x="{u - 4:.1f}" y="{v - 4:.1f}" width="8" height="8"/>'
        f'<text x="{u + 7:.1f}" y="{v - 7:.1f}" font-size="12">{_printable(camera.name)}</text>'
    )


def _line(plan: _Plan, path: Array, style: str) -> str:
    """A line through places (T, 2) m, with a gap where one is unknown."""
    places = plan.at(path[:: max(1, -(-len(path) // _MOST_POINTS))])
    steps, pen = [], "M"
    for x, y in places:
        if np.isfinite(x + y):
            steps.append(f"{pen}{x:.1f} {y:.1f}")
        pen = "L" if np.isfinite(x + y) else "M"
    return f'<path d="{"".join(steps)}" fill="none" stroke-linejoin="round" {style}/>'


def _marks(plan: _Plan, piece: Tracks, colour: str) -> str:
    """Where a path begins and ends, and where the person was out of sight."""
    places = plan.at(piece.xyz[:, :2])
    known = np.isfinite(places).all(axis=1)
    if not known.any():
        return ""
    (u, v), (x, y) = places[known][0], places[known][-1]
    style = f'fill="{colour}" stroke="{INK}"'
    out = f'<circle cx="{u:.1f}" cy="{v:.1f}" r="5" {style}/>'
    out += f'<path d="M{x:.1f} {y - 6:.1f}l6 6l-6 6l-6 -6Z" {style}/>'
    if piece.observed is not None:
        hidden = places[known & ~piece.observed]
        hidden = hidden[:: max(1, -(-len(hidden) // _MOST_POINTS))]
        # Lines without length have round ends, one path for all dots.
        dots = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in hidden)
        if dots:
            out += f'<path d="{dots}" stroke="white" stroke-width="2.4" stroke-linecap="round"/>'
    return out


def _legend(plan: _Plan, names: Sequence[tuple[str, str]]) -> list[str]:
    """Names beside the room, each with a piece of its line."""
    x, y = _LEFT + plan.size[0] + 16, _TOP + 8
    return [
        f'<path d="M{x:.1f} {y + 20 * i:.1f}h24" {style}/>'
        f'<text x="{x + 32:.1f}" y="{y + 20 * i + 4:.1f}">{name}</text>'
        for i, (name, style) in enumerate(names[:_MOST_NAMES])
    ]


def _box(lower: Array, upper: Array) -> Array:
    """The corners of a rectangle, the first one twice."""
    (x0, y0), (x1, y1) = lower, upper
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])


def _printable(name: str) -> str:
    """A name for a drawing, which is no drawing any more with a control character in it."""
    return escaped("".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name))
