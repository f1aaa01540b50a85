"""Standing upright."""

from __future__ import annotations

import numpy as np

from mocap.synth.figure import SIDES, Figure
from mocap.synth.motions.kit import Pose, Stance, hang_arm, standing, wander


def stand(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
) -> Pose:
    """Standing upright, looking about, shifting the weight a little."""
    rotations, root = standing(figure, n_frames, fps, position, heading_rad, rng, Stance())
    for side, sign in SIDES:
        drift = np.deg2rad(2.5) * wander(n_frames, fps, slowest_s=4.0, rng=rng)
        hang_arm(
            rotations, side, sign, drift + 0.03, np.deg2rad(9.0) + 0.4 * drift, np.deg2rad(15.0), 0.28 + drift
        )
    return Pose(root, rotations, np.ones((n_frames, 2), dtype=bool))
