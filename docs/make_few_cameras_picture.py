"""Where two cameras serve best, and how foreseen deviations meet measured errors: docs/pictures/few-cameras.png.

python -m docs.make_few_cameras_picture

Measured errors are those of eval/results/few_cameras_{development,test}.csv.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from eval.session_tables import RESULTS
from eval.whole import save_figure
from mocap.body import load_body_model, scale_body
from mocap.data import Camera, CameraRig
from mocap.pose.foresight import aimed, foresee
from mocap.view.plotting import LINE_COLOURS, finish, new_figure

PICTURE = Path(__file__).parent / "pictures" / "few-cameras.png"
SIZE, FOCAL_PX = (640, 480), 450.0
AWAY_M, HIGH_M = 3.5, 1.6
APART_DEG = np.arange(20, 181, 10)
OF_NUMBER = {2: LINE_COLOURS[0], 3: LINE_COLOURS[1], 4: LINE_COLOURS[2], 7: "0.4"}


def cameras_at(azimuths_deg: list[float]) -> CameraRig:
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


def main() -> None:
    """Foresee pairs, read what was measured, draw."""
    body = scale_body(load_body_model("girdle"), 1.75)
    foreseen = [
        1000 * float(foresee(cameras_at([0.0, float(apart)]), body, [(0.0, 0.0)]).mean_m[0])
        for apart in APART_DEG
    ]
    rows = []
    for name in ("development", "test"):
        with (RESULTS / f"few_cameras_{name}.csv").open(encoding="utf-8", newline="") as stream:
            rows += list(csv.DictReader(stream))
    figure, (angle, both) = new_figure(1, height=3.2, width=8.0, n_columns=2)
    angle.plot(APART_DEG, foreseen, color="0.3", lw=1.6)
    pairs = [row for row in rows if row["n_cameras"] == "2"]
    angle.plot(
        [float(row["places"].partition(" ")[0]) for row in pairs],
        [float(row["mean_error_mm"]) for row in pairs],
        "o",
        color=OF_NUMBER[2],
        ms=4,
    )
    angle.set_ylim(0, None)
    finish(angle, "two cameras", "degrees between them", "mm: foreseen (line), measured", small=True)
    most = max(float(row[key]) for row in rows for key in ("foreseen_mm", "mean_error_mm"))
    both.plot([0, most], [0, most], color="0.8", lw=1.0)
    for n, colour in OF_NUMBER.items():
        own = [row for row in rows if int(row["n_cameras"]) == n]
        both.plot(
            [float(row["foreseen_mm"]) for row in own],
            [float(row["mean_error_mm"]) for row in own],
            "o",
            color=colour,
            ms=4,
            label=f"{n} cameras",
        )
    finish(both, "all that was run", "foreseen, mm", "measured, mm", legend=True, small=True)
    save_figure(figure, PICTURE)


if __name__ == "__main__":
    main()
