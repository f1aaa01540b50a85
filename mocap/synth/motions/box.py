"""Shadow boxing."""

from __future__ import annotations

import numpy as np

from mocap.synth.figure import SIDES, Figure
from mocap.synth.motions.kit import Array, Pose, Stance, follow, solve_arms, standing


def box(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
) -> Pose:
    """Shadow boxing from a guard with one foot in front: jabs and crosses with the trunk behind them."""
    lead = 0 if rng.uniform() < 0.7 else 1  # the arm and leg in front: left for most people
    sign = 1 if lead == 0 else -1
    knots, turn_knots = _punches(lead, n_frames / fps, rng)
    turn = follow(turn_knots, n_frames, fps)
    stance_turn = np.deg2rad(-28.0) * sign  # side-on: the lead shoulder in front
    stance = Stance(
        sway=1.5,
        stagger=0.34 * sign,
        width=0.27,
        crouch=0.035,
        bounce=0.012,
        turn=stance_turn + 0.45 * turn[:, 0],
        trunk_turn=0.55 * turn[:, 0],
        bend=0.16 + turn[:, 1],
        gaze_yaw=-(stance_turn + turn[:, 0]),
    )
    rotations, root = standing(figure, n_frames, fps, position, heading_rad, rng, stance)
    reach = figure.upper_arm_m + figure.forearm_m
    goals = [follow(k, n_frames, fps) * reach for k in knots]
    poles = [np.tile([-0.35, 0.45, -0.9], (n_frames, 1)) for _ in SIDES]
    # Targets are meant along the line of sight, not along the turned chest.
    solve_arms(figure, rotations, root, goals, poles, heading=np.full(n_frames, heading_rad))
    return Pose(root, rotations, np.ones((n_frames, 2), dtype=bool))


def _punches(
    lead: int, duration_s: float, rng: np.random.Generator
) -> tuple[list[list[tuple[float, Array]]], list[tuple[float, Array]]]:
    """Moments, s, and wrist targets of both arms, in arm lengths; moments and twist, bend of the trunk.

    lead : the arm in front, 0 = left.
    """
    guard = [np.array([0.50, -0.05, 0.02]), np.array([0.40, -0.06, -0.02])]
    if lead == 1:
        guard = guard[::-1]
    knots: list[list[tuple[float, Array]]] = [[(0.0, g)] for g in guard]
    turn_knots: list[tuple[float, Array]] = [(0.0, np.zeros(3))]
    clock = 0.2 + rng.uniform(0, 0.2)
    while clock < duration_s:
        arm = lead if rng.uniform() < 0.6 else 1 - lead
        out = rng.uniform(0.17, 0.24)
        target = np.array([0.95, -0.12, 0.04]) + rng.normal(0, [0.02, 0.03, 0.06])
        knots[arm] += [
            (clock, guard[arm]),
            (clock + out, target),
            (clock + out + 0.05, target),
            (clock + 2.3 * out, guard[arm]),
        ]
        power = 0.25 if arm == lead else 0.55
        twist = np.array([power * (-1.0 if arm == 0 else 1.0), 0.05 + 0.12 * power, 0.0])
        turn_knots += [(clock, np.zeros(3)), (clock + out, twist), (clock + 2.3 * out, np.zeros(3))]
        clock += 2.3 * out + rng.uniform(0.08, 0.45)
    return knots, turn_knots
