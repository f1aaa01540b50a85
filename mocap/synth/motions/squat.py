"""Squats and rises onto the toes, in turn, on one spot."""

from __future__ import annotations

import numpy as np

from mocap.synth.figure import SIDES, Figure
from mocap.synth.motions.kit import Array, Pose, Stance, follow, hang_arm, on_toes, solve_legs, standing

_PERIOD_S = 3.6  # of a squat and a rise together
_DEPTH = 0.30  # of the leg's length, by which the pelvis sinks
_BACK = 0.10  # of the leg's length, by which it goes back
_RISE_RAD = np.deg2rad(32.0)  # pitch of the feet on tiptoe


def squat(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
) -> Pose:
    """Squatting with the arms forward, standing up, rising onto the toes, and again.

    The feet stay where they are: on tiptoe they turn about the joints of the toes, which stay flat.
    """
    period = _PERIOD_S * rng.uniform(0.9, 1.1)
    leg = figure.thigh_m + figure.shank_m
    down, up = _course(n_frames, fps, period)
    depth, pitch = rng.uniform(0.9, 1.1) * _DEPTH * leg * down, rng.uniform(0.9, 1.1) * _RISE_RAD * up
    width = 0.15 * figure.stature_m
    stance = Stance(
        sway=0.4,
        width=width,
        crouch=0.003 + depth / figure.stature_m,
        back=_BACK * leg * down,
        bend=0.45 * down,
    )
    rotations, root = standing(figure, n_frames, fps, position, heading_rad, rng, stance)
    ankles, feet = on_toes(figure, position, heading_rad, width, pitch)
    # The pelvis goes with the ankles, up and forward.
    root += 0.5 * (ankles[0] + ankles[1]) - [*position, figure.ankle_height_m]
    solve_legs(figure, rotations, root, ankles, feet, [-pitch, -pitch])
    for side, sign in SIDES:
        hang_arm(rotations, side, sign, 0.05 + 1.1 * down, 0.16, 0.2, 0.25 + 0.1 * down)
    return Pose(root, rotations, np.tile((pitch < 1e-9)[:, None], (1, 2)))


def _course(n_frames: int, fps: float, period_s: float) -> tuple[Array, Array]:
    """How far somebody is down in the squat and up on the toes, (T,) each, from 0 to 1."""
    course = [(0.0, 0, 0), (0.08, 0, 0), (0.30, 1, 0), (0.36, 1, 0), (0.56, 0, 0)]
    course += [(0.62, 0, 0), (0.76, 0, 1), (0.84, 0, 1), (0.97, 0, 0)]
    n_periods = int(np.ceil(n_frames / fps / period_s)) + 1
    knots = [
        ((k + share) * period_s, np.array([down, up, 0.0]))
        for k in range(n_periods)
        for share, down, up in course
    ]
    down, up, _ = follow(knots, n_frames, fps).T
    return down, up
