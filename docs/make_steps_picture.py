"""Draw foot contacts, steps and the gait cycle of a walk: pictures/steps.png.

python -m docs.make_steps_picture
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mocap.data import ALL_LANDMARKS, AngleSeries
from mocap.pose.contacts import SOLE_POINTS, contacts_of
from mocap.pose.cycles import PERCENT, cycles_of
from mocap.pose.method import ContactSettings
from mocap.pose.steps import Gait, stances_of
from mocap.synth.figure import feet_and_hands_of, forward_kinematics, landmarks_of, make_figure
from mocap.synth.motions import MOTIONS
from mocap.synth.motions import Path as Way

PICTURE = Path(__file__).parent / "pictures" / "steps.png"
FPS, N_FRAMES = 30.0, 120
N_COLOURS = 64
NOISE_M = 0.002
COLOURS = {"left": "#1f77d0", "right": "#e07b00"}


def walk() -> NDArray[np.float64]:
    """Landmarks (T, 21, 3) m of a synthetic walk, with a little noise."""
    rng = np.random.default_rng(4)
    figure = make_figure(1.75, "male", 1.0, rng=rng)
    way = Way((-1.6, 0.0), (0.0, 0.0), 0.0, False)
    pose = MOTIONS["walk"](figure, N_FRAMES, FPS, rng=rng, path=way, speed_m_s=1.3)
    where = forward_kinematics(figure.offsets, pose.rotations, pose.root_position)
    points = np.concatenate([landmarks_of(figure, *where), feet_and_hands_of(figure, *where)], axis=1)
    return np.asarray(points + NOISE_M * rng.standard_normal(points.shape))


def knees(points: NDArray[np.float64]) -> AngleSeries:
    """How far both knees of landmarks (T, 21, 3) are bent, from hip, knee and ankle."""
    bends = []
    for side in COLOURS:
        hip, knee, ankle = (
            points[:, ALL_LANDMARKS.index(f"{side}_{name}")] for name in ("hip", "knee", "ankle")
        )
        thigh, shank = knee - hip, ankle - knee
        along = (thigh * shank).sum(axis=1) / np.linalg.norm(thigh, axis=1) / np.linalg.norm(shank, axis=1)
        bends.append(np.arccos(along))
    frames = np.arange(len(points))
    names = tuple(f"{side}_knee_flexion" for side in COLOURS)
    return AngleSeries(1, names, frames, frames / FPS, np.stack(bends, axis=1))


def main() -> None:
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    landmarks = walk()
    points = landmarks[:, list(SOLE_POINTS)]
    contacts = contacts_of(points, np.zeros(points.shape[:2]), FPS, ContactSettings())
    time_s = np.arange(N_FRAMES) / FPS
    figure = plt.figure(figsize=(8.0, 6.4), constrained_layout=True)
    grid = figure.add_gridspec(3, 2, height_ratios=(2, 1, 1.5), width_ratios=(1.5, 1))
    heights, chances = (figure.add_subplot(grid[row, :]) for row in (0, 1))
    floor, cycle = (figure.add_subplot(grid[2, column]) for column in (0, 1))
    for cycles in cycles_of(Gait(1, contacts, tuple(stances_of(points, contacts, 0.0))), knees(landmarks)):
        mean, between, _ = np.rad2deg(cycles.mean(f"{cycles.side}_knee_flexion"))
        cycle.plot(PERCENT, mean, color=COLOURS[cycles.side])
        cycle.fill_between(
            PERCENT, mean - between, mean + between, color=COLOURS[cycles.side], alpha=0.2, lw=0
        )
        cycle.axvline(cycles.off_percent.mean(), color=COLOURS[cycles.side], lw=0.8, ls=":")
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
    heights.set_ylim(top=225)
    heights.legend(ncols=4, fontsize=8, frameon=False)
    chances.set_ylabel("probability\nof contact")
    chances.set_xlabel("time (s)")
    chances.sharex(heights)
    floor.set_xlabel("x (m)")
    floor.set_ylabel("y (m)")
    floor.set_ylim(-0.6, 0.6)
    floor.set_aspect("equal")
    cycle.set_xlabel("gait cycle (%)")
    cycle.set_ylabel("knee flexion (°)")
    for axes in (heights, chances, floor, cycle):
        axes.spines[["top", "right"]].set_visible(False)
    drawn = BytesIO()
    figure.savefig(drawn, dpi=110)
    Image.open(drawn).convert("RGB").quantize(N_COLOURS).save(PICTURE, optimize=True)
    print(f"wrote {PICTURE.name}")


if __name__ == "__main__":
    main()
