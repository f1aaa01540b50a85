"""Picking something up from the floor."""

from __future__ import annotations

import numpy as np

from mocap.synth.figure import SIDES, Figure
from mocap.synth.motions.kit import Array, Pose, Stance, follow, solve_arms, standing


def pick_up(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
) -> Pose:
    """Crouching to the floor with both arms and rising again, over and over, a little different each time."""
    clock = 0.3 + rng.uniform(0, 0.3)
    low: list[tuple[float, Array]] = [(0.0, np.zeros(3))]
    while clock < n_frames / fps:
        down, hold, up = rng.uniform(1.0, 1.3), rng.uniform(0.2, 0.5), rng.uniform(1.0, 1.3)
        # Depth of the knees, bend of the trunk, and how far to the front the hands go.
        deep = np.array([1.0, 1.0, 1.0]) * rng.uniform(0.8, 1.0, 3)
        low += [(clock, np.zeros(3)), (clock + down, deep), (clock + down + hold, deep)]
        clock += down + hold + up
        low.append((clock, np.zeros(3)))
        clock += rng.uniform(0.3, 0.8)
    depth, bend, front = follow(low, n_frames, fps).T
    stance = Stance(
        sway=0.8,
        width=0.26,
        crouch=0.003 + 0.23 * depth,
        back=0.055 * figure.stature_m * depth,
        bend=0.95 * bend,
        gaze_yaw=0.0,
    )
    rotations, root = standing(figure, n_frames, fps, position, heading_rad, rng, stance)
    reach = figure.upper_arm_m + figure.forearm_m
    hang = np.column_stack([0.08 + 0.30 * front, 0.12 - 0.10 * front, -0.95 + 0.09 * front])
    goals = [hang * reach] * 2
    poles = [np.tile([-0.8, 0.5, -0.3], (n_frames, 1)) for _ in SIDES]
    solve_arms(figure, rotations, root, goals, poles, heading=np.full(n_frames, heading_rad))
    return Pose(root, rotations, np.ones((n_frames, 2), dtype=bool))
