"""Draw foot contacts and steps of a walk: pictures/steps.png.

python -m docs.make_steps_picture
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from mocap.data import ALL_LANDMARKS
from mocap.pose.contacts import SOLE_POINTS, contacts_of
from mocap.pose.method import ContactSettings
from mocap.synth.figure import feet_and_hands_of, forward_kinematics, make_figure
from mocap.synth.motions import MOTIONS
from mocap.synth.motions import Path as Way

PICTURE = Path(__file__).parent / "pictures" / "steps.png"
FPS, N_FRAMES = 30.0, 75
NOISE_M = 0.002
COLOURS = {"left": "#1f77d0", "right": "#e07b00"}


def sole_points() -> NDArray[np.float64]:
    """Heels and toes (T, 4, 3) m of a synthetic walk, with a little noise."""
    rng = np.random.default_rng(4)
    figure = make_figure(1.75, "male", 1.0, rng=rng)
    way = Way((-1.6, 0.0), (0.0, 0.0), 0.0, False)
    pose = MOTIONS["walk"](figure, N_FRAMES, FPS, rng=rng, path=way, speed_m_s=1.3)
    where = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    names = [ALL_LANDMARKS[k] for k in SOLE_POINTS]
    points = feet_and_hands_of(figure, *where)
    columns = [ALL_LANDMARKS[15:].index(name) for name in names]
    return np.asarray(points[:, columns] + NOISE_M * rng.standard_normal((N_FRAMES, 4, 3)))


def main() -> None:
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    points = sole_points()
    contacts = contacts_of(points, np.zeros(points.shape[:2]), FPS, ContactSettings())
    time_s = np.arange(N_FRAMES) / FPS
    figure, (heights, chances, floor) = plt.subplots(
        3, 1, figsize=(8.0, 6.4), height_ratios=(2, 1, 1.1), constrained_layout=True
    )
    for k, landmark in enumerate(SOLE_POINTS):
        side, _, point = ALL_LANDMARKS[landmark].partition("_")
        style = {"color": COLOURS[side], "ls": "-" if point == "heel" else "--"}
        heights.plot(time_s, 1000 * points[:, k, 2], label=f"{side} {point}", **style)
        chances.plot(time_s, contacts.probability[:, k], **style)
        floor.plot(points[:, k, 0], points[:, k, 1], color=COLOURS[side], lw=0.6, alpha=0.5)
        for run in contacts.runs[k]:
            at = np.median(points[run, k], axis=0)
            floor.plot(*at[:2], "o" if point == "heel" else "^", color=COLOURS[side], ms=7)
    heights.set_ylabel("height (mm)")
    heights.legend(ncols=4, fontsize=8, frameon=False)
    chances.set_ylabel("probability\nof contact")
    chances.set_xlabel("time (s)")
    chances.sharex(heights)
    floor.set_xlabel("x (m)")
    floor.set_ylabel("y (m)")
    floor.set_aspect("equal")
    for axes in (heights, chances, floor):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(PICTURE, dpi=110)
    print(f"wrote {PICTURE.name}")


if __name__ == "__main__":
    main()
