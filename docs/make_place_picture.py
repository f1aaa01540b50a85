"""Cameras that `mocap calibrate --place` has placed from nothing, beside the truth: docs/pictures/place.png.

python -m docs.make_place_picture
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from eval.place_rig import stated_height_m
from eval.refine_rig import fitted_places
from mocap.io.calibration import read_calibration
from mocap.pipeline.refine import place_session
from mocap.synth import synthesise
from mocap.synth.scene import load_scene
from mocap.view.plotting import LINE_COLOURS, finish, new_figure, png

PICTURE = Path(__file__).parent / "pictures" / "place.png"
SCENE, N_FRAMES = "walk", 150
ENLARGED, LOOK_M = 10, 0.5


def main() -> None:
    """Film, place, draw."""
    with tempfile.TemporaryDirectory() as folder:
        session = synthesise(
            load_scene(SCENE).model_copy(update={"n_frames": N_FRAMES}), Path(folder) / "session"
        )
        truth = read_calibration(session / "calibration.toml").rig
        placed = place_session(session, height_m=stated_height_m(session))
    found, _ = fitted_places(placed.rig, truth)
    figure, (plan,) = new_figure(1, height=4.2, width=5.2)
    for camera, place in zip(truth, found, strict=True):
        true = camera.center[:2]
        sight = np.stack([true, true + LOOK_M * camera.R[2, :2]])
        plan.plot(*sight.T, color="0.75", lw=1.0)
        plan.plot(*true, "o", color=LINE_COLOURS[0], ms=5)
        off = np.stack([true, true + ENLARGED * (place[:2] - true)])
        plan.plot(*off.T, color=LINE_COLOURS[1], lw=1.6)
        plan.annotate(camera.name, true, textcoords="offset points", xytext=(6, 5), fontsize=8)
    plan.set_aspect("equal")
    plan.margins(0.15)
    finish(plan, f"from above; errors x {ENLARGED}", "x, m", "y, m", legend=False, small=True)
    PICTURE.write_bytes(png(figure))


if __name__ == "__main__":
    main()
