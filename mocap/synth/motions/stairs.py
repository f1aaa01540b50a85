"""Climbing a flight of stairs."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from mocap.synth.figure import HEEL_BACK, Figure
from mocap.synth.motions.kit import Pose, identity
from mocap.synth.motions.steps import Footsteps, follow_feet, look_about, swing_arms, timeline

FIRST_EDGE_M = 0.26  # from between the ankles of somebody who stands before the flight to its first edge
_HEEL_ROOM_M = 0.025  # heels stand so far behind an edge
_SWING = 0.74  # of a step, in the air
_RISE_S = 0.10  # the pelvis rises as smoothly as this


def stairs(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    n_stairs: int = 3,
    rise_m: float = 0.16,
    going_m: float = 0.30,
    rng: np.random.Generator,
) -> Pose:
    """Stand before a flight of stairs, climb it step over step, and stand on the uppermost stair.

    position : (x, y) m, between the ankles, before the first edge, which is `FIRST_EDGE_M` ahead.  heading_rad : up the
    flight.  rise_m, going_m : height and depth of a stair.
    """
    t, keep = timeline(n_frames, fps)
    plan = Footsteps(figure, position, heading_rad)
    ahead = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    step_s = rng.uniform(0.58, 0.68)
    clock = 0.3 + rng.uniform(0, 0.3)
    side = int(rng.integers(2))
    for k in range(1, n_stairs + 2):
        stair = min(k, n_stairs)  # the last foot comes to stand beside the other one
        on = FIRST_EDGE_M + (stair - 1) * going_m + HEEL_BACK * figure.stature_m + _HEEL_ROOM_M
        at, yaw = plan.beside(side, (position[0] + on * ahead[0], position[1] + on * ahead[1]), heading_rad)
        clock += step_s
        plan.step(side, clock - _SWING * step_s, clock, at, yaw, stair * rise_m)
        side = 1 - side
    gait = follow_feet(figure, plan, t, fps)
    # A leg that climbs bends: the pelvis rises evenly, and not as late as the lower leg would let it.
    lowest = minimum_filter1d(gait.highest(), 2 * int(np.ceil(1.2 * _RISE_S * fps)) + 1, mode="nearest")
    gait.root[:, 2] = gaussian_filter1d(lowest, _RISE_S * fps, mode="nearest") - 0.003 * figure.stature_m
    rotations = identity(len(t))
    look_about(gait, rotations, rng=rng, bend=0.10 * np.clip(gait.speed / 0.5, 0, 1), gaze_down=0.15)
    swing_arms(gait, rotations, rng=rng)
    return gait.finish(rotations, keep)
