"""What few cameras give, where to put them: tables of docs/few-cameras.md and README.md, docs/pictures/few-cameras.png.

    python -m docs.make_few_cameras

Measured errors are those of eval/results/few_cameras_{development,test}.csv, and among furniture of
few_cameras_furnished{,_test}.csv (`python -m eval.few_cameras`), means over seeds; what is foreseen is computed here.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eval.few_cameras import PAIRS_DEG
from eval.session_tables import RESULTS
from eval.whole import save_figure, with_table, write_text
from mocap.arrays import Array
from mocap.body import Body, load_body_model, scale_body
from mocap.data import Camera, CameraRig
from mocap.pose.deviation import landmark_kind
from mocap.pose.foresight import aimed, foresee
from mocap.view.plotting import INK, LINE_COLOURS, finish, new_figure

HERE = Path(__file__).parent
PAGES = {"all": HERE / "few-cameras.md", "short": HERE.parent / "README.md"}
PICTURE = HERE / "pictures" / "few-cameras.png"
SESSIONS = {
    "walk": "a man walks about",
    "cross": "a man crosses the room, his shirt as grey as the wall",
    "steps": "a woman comes in at one side and leaves at the other",
}
# What three cameras are run in among furniture; the last three rooms were not looked at when that was built.
ROOMS = {
    "furnished": "a walk round a table",
    "furnished_throw": "a throw between sideboards",
    "furnished_pick_up": "something is picked up behind a table",
    "furnished_sit": "on a chair",
    "furnished_test": "*a walk in another room*",
    "furnished_few_test": "*another walk*",
    "furnished_pair_test": "*two persons*",
}
PLACES = ("all round", "side by side")
FURNISHED = ("furnished", "furnished_test")  # tables
NUMBERS = {2: "two", 3: "three", 4: "four", 7: "seven"}
SHORT = ("two, 100 degrees apart", "three, all round", "four, all round", "seven")
# The room of the picture, m: cameras on its walls look at the middle of somebody in its centre.
SIZE, FOCAL_PX = (640, 480), 450.0
AWAY_M, HIGH_M, HALF_M, CELL_M = 3.5, 1.6, 2.0, 0.4
APART_DEG = np.arange(20, 181, 10)
PLACES_DEG = {2: (40.0, 140.0), 3: (30.0, 90.0, 150.0), 4: (15.0, 65.0, 115.0, 165.0)}
OF_NUMBER = {2: LINE_COLOURS[0], 3: LINE_COLOURS[1], 4: LINE_COLOURS[3], 7: "0.4"}
KINDS = ("head", "shoulder", "elbow", "wrist", "hip", "knee", "ankle")
Row = dict[str, str]


def rows(names: Sequence[str] = ("development", "test")) -> list[Row]:
    """The rows of some tables."""
    found: list[Row] = []
    for name in names:
        with (RESULTS / f"few_cameras_{name}.csv").open(encoding="utf-8", newline="") as stream:
            found += list(csv.DictReader(stream))
    return found


def words_of(row: Row) -> str:
    """`two, 100 degrees apart`: pairs go by the angle that was looked for."""
    number = NUMBERS[int(row["n_cameras"])]
    if row["n_cameras"] == "2":
        apart = float(row["places"].partition(" ")[0])
        return f"{number}, {min(PAIRS_DEG, key=lambda a: abs(a - apart)):.0f} degrees apart"
    return number if row["places"] == "all" else f"{number}, {row['places']}"


def table(found: Sequence[Row], which: str) -> str:
    """Errors by cameras and session, means over seeds.  which : `all`, or `short` for some cameras, raw alone."""
    sessions = [name for name in SESSIONS if any(row["session"] == name for row in found)]
    lines = [
        f"| cameras | {' | '.join(SESSIONS[name] for name in sessions)} |",
        "|---" + "|---" * len(sessions) + "|",
    ]
    for cameras in dict.fromkeys(words_of(row) for row in found):
        if which == "all" or cameras in SHORT:
            own = [[r for r in found if (words_of(r), r["session"]) == (cameras, s)] for s in sessions]
            lines.append(f"| {cameras} | {' | '.join(_cell(cell, which) for cell in own)} |")
    return "\n".join(lines)


def table_of_rooms(found: Sequence[Row]) -> str:
    """Errors of three cameras by room and places, means over seeds."""
    lines = [f"| | {' | '.join(f'three, {places}' for places in PLACES)} |", "|---" * (1 + len(PLACES)) + "|"]
    for room, words in ROOMS.items():
        own = [[r for r in found if (r["session"], r["places"]) == (room, places)] for places in PLACES]
        lines.append(f"| {words} | {' | '.join(_cell(cell, 'all') for cell in own)} |")
    return "\n".join(lines)


def _cell(cell: Sequence[Row], which: str) -> str:
    raw = [float(row["mean_error_mm"]) for row in cell]
    after, share = (np.mean([float(row[k]) for row in cell]) for k in ("after_offset_mm", "mmta_percent"))
    if which == "short":
        return f"{np.mean(raw):.0f} mm, {share:.0f} %"
    span = f", {min(raw):.1f} to {max(raw):.1f}" if len(raw) > 1 else ""
    return f"{np.mean(raw):.1f} ({after:.1f}){span}; {share:.1f} %"


def cameras_at(azimuths_deg: Sequence[float]) -> CameraRig:
    """Cameras on a circle that look at the middle of somebody in its centre."""
    K = np.array([[FOCAL_PX, 0.0, SIZE[0] / 2], [0.0, FOCAL_PX, SIZE[1] / 2], [0.0, 0.0, 1.0]])
    like = Camera("like", SIZE, K, np.zeros(4), np.eye(3), np.zeros(3))
    around = np.radians(azimuths_deg)
    centers = np.column_stack(
        [AWAY_M * np.cos(around), AWAY_M * np.sin(around), np.full(len(around), HIGH_M)]
    )
    return CameraRig(
        tuple(aimed(like, f"cam_{i}", c, np.array([0.0, 0.0, 0.9])) for i, c in enumerate(centers))
    )


def foreseen_kinds_mm(body: Body, azimuths_deg: Sequence[float]) -> Array:
    """What is foreseen of each kind of landmark in the middle, mm."""
    found = foresee(cameras_at(azimuths_deg), body, [(0.0, 0.0)])
    square = found.deviation_m[0] ** 2
    kinds = [landmark_kind(name) for name in found.names]
    return np.array(
        [1000 * np.sqrt(np.mean([s for s, k in zip(square, kinds, strict=True) if k == w])) for w in KINDS]
    )


def draw_room(ax: Any, body: Body, n_cameras: int) -> Any:
    """A room from above: cameras, and what is foreseen from place to place; the filled contours."""
    rig = cameras_at(PLACES_DEG[n_cameras])
    axis = np.arange(-HALF_M, HALF_M + 0.5 * CELL_M, CELL_M)
    x, y = np.meshgrid(axis, axis)
    mean = 1000 * foresee(rig, body, np.column_stack([x.ravel(), y.ravel()])).mean_m.reshape(x.shape)
    levels = [20, 25, 30, 35, 40, 50, 70, 100]
    filled = ax.contourf(x, y, mean, levels=levels, cmap="cividis_r", extend="both")
    for camera in rig:
        ax.plot(*camera.center[:2], "s", color=INK, ms=5)
        ax.plot(*zip(camera.center[:2], 0.86 * camera.center[:2], strict=True), color=INK, lw=1.4)
    centre = len(axis) // 2
    ax.text(0, 0, f"{mean[centre, centre]:.0f}", ha="center", va="center", fontsize=9, color=INK)
    ax.set_xlim(-3.8, 3.8)
    ax.set_ylim(-2.3, 3.8)
    ax.set_aspect("equal")
    finish(ax, f"{NUMBERS[n_cameras]} cameras", "x, m", "y, m", small=True, grid="both")
    return filled


def draw(found: Sequence[Row]) -> Any:
    """Rooms from above; what is foreseen by angle and by joint; foreseen and measured."""
    body = scale_body(load_body_model("girdle"), 1.75)
    figure, axes = new_figure(2, height=2.7, width=9.0, n_columns=3)
    for ax, n in zip(axes, PLACES_DEG, strict=False):
        filled = draw_room(ax, body, n)
    bar = figure.colorbar(filled, ax=axes[2], shrink=0.8)
    bar.set_label("foreseen, mm", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    angle, joints, both = axes[3:]
    foreseen = [
        1000 * float(foresee(cameras_at([0.0, float(apart)]), body, [(0.0, 0.0)]).mean_m[0])
        for apart in APART_DEG
    ]
    angle.plot(APART_DEG, foreseen, color="0.3", lw=1.6)
    pairs = [row for row in found if row["n_cameras"] == "2"]
    angle.plot(
        [float(row["places"].partition(" ")[0]) for row in pairs],
        [float(row["mean_error_mm"]) for row in pairs],
        "o",
        color=OF_NUMBER[2],
        ms=4,
    )
    angle.set_ylim(0, None)
    finish(angle, "two cameras", "degrees between them", "mm: foreseen (line), measured", small=True)
    for n, azimuths in {**PLACES_DEG, 7: tuple(k * 360.0 / 7 for k in range(7))}.items():
        joints.plot(foreseen_kinds_mm(body, azimuths), KINDS, "o", color=OF_NUMBER[n], ms=4)
    joints.set_xlim(0, None)
    joints.invert_yaxis()
    finish(joints, "joint by joint, in the middle", "foreseen, mm", "", small=True, grid="both")
    most = max(float(row[key]) for row in found for key in ("foreseen_mm", "mean_error_mm"))
    both.plot([0, most], [0, most], color="0.8", lw=1.0)
    for n, colour in OF_NUMBER.items():
        own = [row for row in found if int(row["n_cameras"]) == n]
        both.plot(
            [float(row["foreseen_mm"]) for row in own],
            [float(row["mean_error_mm"]) for row in own],
            "o",
            color=colour,
            ms=4,
            label=f"{n} cameras",
        )
    finish(both, "all that was run", "foreseen, mm", "measured, mm", legend=True, small=True)
    return figure


def main() -> None:
    """Put the tables into the pages, foresee, draw."""
    found = rows()
    for which, page in PAGES.items():
        write_text(page, with_table(page.read_text(encoding="utf-8"), "few cameras", table(found, which)))
    rooms = table_of_rooms(rows(FURNISHED))
    page = PAGES["all"]
    write_text(page, with_table(page.read_text(encoding="utf-8"), "among furniture", rooms))
    save_figure(draw(found), PICTURE)


if __name__ == "__main__":
    main()
