"""Jumps from standing, one after the other, on one spot: a dip, off the toes, a flight, and down again."""

from __future__ import annotations

import numpy as np

from mocap.synth.figure import SIDES, Figure
from mocap.synth.motions.kit import Array, Pose, Stance, hang_arm, on_toes, solve_legs, standing

_GRAVITY = 9.81  # m/s^2
_HEIGHT_M = 0.24  # by which the pelvis rises in the air
_DIP, _GIVE = 0.28, 0.22  # of the leg's length, by which the pelvis sinks before and after
_STAND_S, _DIP_S, _RISE_S = 0.6, 0.45, 0.6  # standing, sinking before, and rising after
_PITCH_RAD = np.deg2rad(35.0)  # of the feet when they leave the floor
_TOES_M = 0.06  # over the floor they may point down
_ROLL_S = 0.15  # in which heels leave the floor before the toes do, and come down after them


def jump(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
) -> Pose:
    """Standing, jumping with both feet and a swing of the arms, landing on the same spot, and again.

    The pelvis is thrown: it is sped up evenly from the lowest point on, flies a parabola, and is slowed down evenly.
    """
    height = rng.uniform(0.85, 1.15) * _HEIGHT_M
    leg = figure.thigh_m + figure.shank_m
    start = rng.uniform(0.0, 0.3)
    crouch, pitch, rise, swing = _course(start + np.arange(n_frames) / fps, height, _DIP * leg, _GIVE * leg)
    width = 0.14 * figure.stature_m
    stance = Stance(
        sway=0.3,
        width=width,
        crouch=0.003 + crouch / figure.stature_m,
        back=0.3 * crouch,
        bend=1.6 * crouch / leg,
        gaze_yaw=0.0,
    )
    rotations, root = standing(figure, n_frames, fps, position, heading_rad, rng, stance)
    ankles, feet = on_toes(figure, position, heading_rad, width, pitch)
    ankles = [ankle + rise[:, None] * [0.0, 0.0, 1.0] for ankle in ankles]
    root += 0.5 * (ankles[0] + ankles[1]) - [*position, figure.ankle_height_m]
    # In the air toes come in line with their feet, as fast as the floor lets them.
    toes = -pitch * np.clip(1.0 - rise / _TOES_M, 0.0, 1.0)
    solve_legs(figure, rotations, root, ankles, feet, [toes, toes])
    for side, sign in SIDES:
        hang_arm(rotations, side, sign, 0.05 + 1.2 * swing, 0.16, 0.15, 0.2 + 0.5 * np.abs(swing))
    return Pose(root, rotations, np.tile(((pitch < 1e-9) & (rise <= 0))[:, None], (1, 2)))


def _course(t: Array, height: float, dip: float, give: float) -> tuple[Array, Array, Array, Array]:
    """Crouch m, pitch of the feet rad, rise of the feet m and swing of the arms, (T,) each, at times (T,) s."""
    speed = np.sqrt(2.0 * _GRAVITY * height)
    push_s, flight_s, give_s = 2.0 * dip / speed, 2.0 * speed / _GRAVITY, 2.0 * give / speed
    off = _STAND_S + _DIP_S + push_s
    period = off + flight_s + give_s + _RISE_S
    t = np.mod(t, period)
    air = t - off
    down = air - flight_s

    def share(since: Array, length: float) -> Array:
        return np.clip(since / length, 0.0, 1.0)

    def ramp(since: Array, length: float) -> Array:
        return 0.5 - 0.5 * np.cos(np.pi * share(since, length))

    sunk = ramp(t - _STAND_S, _DIP_S)
    pushed = share(t - _STAND_S - _DIP_S, push_s)
    given = 1.0 - (1.0 - share(down, give_s)) ** 2
    risen = ramp(down - give_s, _RISE_S)
    crouch = dip * (sunk - pushed**2) + give * (given - risen)
    pitch = _PITCH_RAD * (share(air + _ROLL_S, _ROLL_S) - share(down, _ROLL_S))
    flies = (air > 0) & (down < 0)
    rise = np.where(flies, speed * air - 0.5 * _GRAVITY * air**2, 0.0)
    raised = ramp(t - _STAND_S - _DIP_S, push_s + 0.5 * flight_s)
    lowered = ramp(air - 0.5 * flight_s, 0.5 * flight_s + give_s + 0.2)
    swing = raised - lowered - 0.4 * (sunk - raised)
    return crouch, pitch, np.maximum(rise, 0.0), swing
