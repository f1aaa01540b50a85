"""The page of a calibration: how far it can be trusted, where the board was seen, and what is left over."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mocap.arrays import Array
from mocap.calibrate.bundle import WORLD
from mocap.calibrate.solve import Calibrated
from mocap.calibrate.uncertainty import UncertaintyMap
from mocap.calibrate.views import BoardViews
from mocap.data import Camera
from mocap.view.html import Figure, PageSection, escaped, figures_html, page_html, warning_list, write_html
from mocap.view.plotting import INK, LINE_COLOURS, finish, new_figure, note, png


def write_page(path: Path, found: Calibrated, views: BoardViews | None, room: UncertaintyMap) -> None:
    """One HTML file that stands alone; without views cameras were placed by points of known place."""
    sections = [
        PageSection("cameras", "Cameras", _cameras(found, views) + warning_list(found.warnings)),
        PageSection("trust", "How certain the room is", figures_html([room_figure(found, room)])),
        PageSection(
            "seen",
            "Where the board was seen" if views else "Where the points were seen",
            figures_html([coverage_figure(found)]),
        ),
    ]
    by, what = (views.board, "corners") if views else ("points of known place", "they are")
    subtitle = f"<p>{escaped(by)}, {len(found.rig)} cameras, {what} off by {found.rms_px:.2f} px</p>"
    write_html(
        path, page_html("Calibration", "mocap calibrate", sections, subtitle=subtitle), what="the page"
    )


def _cameras(found: Calibrated, views: BoardViews | None) -> str:
    """A table, a row per camera."""
    seen = ("views", "not found in") if views else ("points",)
    head = ("camera", *seen, "off by", "focal length", "above the floor", "place ±")
    rows = []
    for camera in found.rig:
        name = camera.name
        focal, sd = camera.K[0, 0], found.focal_deviation[name]
        rows.append(
            (
                name,
                *(
                    (found.n_views_of[name], views.why_missed(name) or "-")
                    if views
                    else (len(found.adjusted.bundle.sightings[WORLD, name].uv),)
                ),
                f"{found.rms_px_of[name]:.2f} px",
                f"{focal:.0f} ± {focal * sd:.1f} px" if sd else f"{focal:.0f} px, given",
                f"{camera.center[2]:.2f} m",
                f"{1000 * found.center_deviation_m[name]:.1f} mm",
            )
        )
    cells = "".join("<tr>" + "".join(f"<td>{escaped(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    titles = "".join(f'<th scope="col">{escaped(cell)}</th>' for cell in head)
    return f'<table class="wide"><thead><tr>{titles}</tr></thead><tbody>{cells}</tbody></table>'


def room_figure(found: Calibrated, room: UncertaintyMap) -> Figure:
    """Plan of the room with the deviation of a point by its place."""
    figure, (ax,) = new_figure(1, height=5.2, width=7.0)
    mm = 1000 * room.deviation_m
    if np.isfinite(mm).any():
        # The far corners would hide what happens in the middle.
        top = float(np.nanquantile(mm, 0.95))
        shown = ax.pcolormesh(
            room.x, room.y, mm, cmap="viridis_r", vmin=0, vmax=max(top, 1e-3), shading="nearest"
        )
        bar = figure.colorbar(shown, ax=ax, extend="max", shrink=0.8)
        bar.set_label("standard deviation (mm)", color=INK)
    for camera in found.rig:
        _draw_camera(ax, camera)
    ax.set_aspect("equal")
    finish(ax, "", "x (m)", "y (m)", grid="both")
    middle = (
        f"{np.nanmedian(mm):.1f} mm in the middle of all places"
        if np.isfinite(mm).any()
        else "no common view"
    )
    return Figure(
        f"A point {room.height_m:g} m above the floor",
        "By how much a point that all cameras see without error is uncertain because of the calibration alone, as a "
        f"standard deviation: {middle}. White: fewer than two cameras see it.",
        png(figure),
        alt="Plan of the room with the deviation of a point by its place",
    )


def _draw_camera(ax: Any, camera: Camera) -> None:
    at, forward = camera.center[:2], camera.R[2, :2]
    ax.plot(*at, marker="s", color=INK, ms=6)
    ax.plot(*zip(at, at + 0.5 * forward, strict=True), color=INK, lw=1.2)
    note(ax, camera.name, at, (6, 4))


def coverage_figure(found: Calibrated) -> Figure:
    """Where in every picture corners were seen, and which way they are off."""
    names = found.rig.names
    columns = min(len(names), 4)
    rows = -(-len(names) // columns)
    figure, axes = new_figure(rows, height=2.6, width=2.9 * columns, n_columns=columns)
    residuals = found.adjusted.bundle.residuals()
    scale = _arrow_scale(list(residuals.values()), max(camera.size[0] for camera in found.rig))
    for ax in axes[len(names) :]:
        ax.axis("off")
    for ax, camera in zip(axes, found.rig, strict=False):
        for (item, name), residual in residuals.items():
            if name != camera.name:
                continue
            uv = found.adjusted.bundle.sightings[item, name].uv
            colour = LINE_COLOURS[1] if item == WORLD else LINE_COLOURS[0]
            if item == WORLD:
                ax.plot(*uv.T, ".", color=colour, ms=3)
            ax.quiver(
                *uv.T, *residual.T, color=colour, angles="xy", scale_units="xy", scale=1 / scale, width=0.004
            )
        ax.set_xlim(0, camera.size[0])
        ax.set_ylim(camera.size[1], 0)
        ax.set_aspect("equal")
        finish(ax, camera.name, "", "", grid="both", small=True)
    return Figure(
        "Corners and what is left over",
        f"Every corner that was used, with what is left over {scale:.0f} times longer than it is. Orange: the board on "
        "the floor, or the points of known place. Arrows that all point one way in a part of a picture speak of a lens "
        "that the model does not hold; empty parts are lenses that nobody looked at.",
        png(figure),
        alt="Pictures of all cameras with the corners of the board as arrows",
    )


def _arrow_scale(residuals: Sequence[Array], width_px: int) -> float:
    """So that a usual arrow is as long as the eye can follow: a fortieth of a picture."""
    usual = float(np.median(np.linalg.norm(np.concatenate(residuals), axis=1)))
    return max(1.0, round(width_px / 40 / max(usual, 1e-3)))
