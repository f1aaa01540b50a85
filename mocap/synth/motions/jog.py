"""Jogging along a path, with both feet off the floor between the steps.

Shapes of the curves: running at a comfortable pace (Novacheck, The biomechanics of running, 1998): stance about 36 %
of the cycle, knee flexed to 40 degrees in stance and to about 95 degrees in swing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from mocap.synth.figure import HEEL_BACK, JOINT, SIDES, Figure, rotation_about
from mocap.synth.motions.kit import (
    Array,
    Path,
    Pose,
    hang_arm,
    highest_pelvis,
    identity,
    set_trunk,
    solve_legs,
    wander,
)

_STANCE = 0.36  # share of the cycle of one leg on the floor; less than half: the rest of each step is flight
_GRAVITY = 9.81
_FLAT_FROM, _FLAT_TO = 0.05, 0.17  # the foot is flat
_PUSH_RAD = np.deg2rad(62.0)
_STRAIGHT = 0.99  # longest hip-ankle distance as a share of the straight leg


def jog(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    path: Path,
    speed_m_s: float,
    rng: np.random.Generator,
) -> Pose:
    """Jogging along a path.

    speed_m_s : 1.4 .. 3.2. The cadence follows from speed and stature.
    """
    H = figure.stature_m
    # Slow jogging keeps its cadence and shortens the steps.
    period = 0.72 * (H / 1.75) ** 0.5 * (1.9 / speed_m_s) ** 0.18 * rng.uniform(0.97, 1.03)
    stride = speed_m_s * period
    first_phase = rng.uniform()
    t = np.arange(n_frames) / fps
    s = speed_m_s * t
    phase = first_phase + t / period  # of the left leg; integer = left foot strikes
    scale = rng.uniform(0.92, 1.08, size=6)
    xy, heading = path.at(s)
    lean = 0.30 * np.tanh(np.arctan(speed_m_s**2 * path.curvature(s) / _GRAVITY) / 0.30)
    wave = 2 * np.pi * phase
    left_of = np.column_stack([-np.sin(heading), np.cos(heading)])
    sway = 0.010 * scale[0] * np.sin(wave - 0.1)
    centripetal = -np.sin(lean) * 0.45 * figure.standing_height_m
    root = np.zeros((n_frames, 3))
    root[:, :2] = xy + left_of * (sway - centripetal)[:, None]
    root[:, 2] = _bob(phase, period)
    yaw = -np.deg2rad(7.0) * scale[1] * np.cos(wave - 0.2)
    roll = np.deg2rad(4.0) * scale[2] * np.sin(wave - 0.4)
    tilt = np.deg2rad(7.0) + np.deg2rad(1.5) * np.cos(2 * wave)
    R_pelvis = rotation_about(2, heading + yaw) @ rotation_about(0, -lean + roll) @ rotation_about(1, tilt)
    ankles, feet, toes, contact = _jogging_feet(figure, path, stride, phase, first_phase, s)
    # As high as the supporting leg allows where it is longest, at strike and toe-off.
    reach = _STRAIGHT * (figure.thigh_m + figure.shank_m)
    allowed = highest_pelvis(figure, R_pelvis, root, ankles, reach) - root[:, 2]
    root[:, 2] += min(figure.standing_height_m, float(allowed.min()))
    rotations = identity(n_frames)
    rotations[:, 0] = R_pelvis
    set_trunk(
        rotations,
        yaw=-2.3 * yaw + np.deg2rad(1.0) * wander(n_frames, fps, slowest_s=4.0, rng=rng),
        roll=-0.9 * roll,
        bend=np.deg2rad(2.0) + np.deg2rad(1.5) * np.cos(2 * wave + 0.6),
        gaze_yaw=1.2 * yaw + np.deg2rad(3.0) * wander(n_frames, fps, slowest_s=3.5, rng=rng),
        gaze_down=-0.05 + np.deg2rad(2.0) * wander(n_frames, fps, slowest_s=3.0, rng=rng),
    )
    for i, (side, sign) in enumerate(SIDES):
        own = wave + np.pi * i
        flexion = np.deg2rad(-8.0) - np.deg2rad(30.0) * scale[4] * np.cos(own - 0.2)
        elbow = np.deg2rad(88.0) * scale[5] - np.deg2rad(16.0) * np.cos(own - 0.6)
        abduction = np.deg2rad(15.0 + 40.0 * max(figure.build - 1.0, 0.0)) + np.deg2rad(2.0) * np.cos(own)
        hang_arm(rotations, side, sign, flexion, abduction, np.deg2rad(13.0), elbow)
    solve_legs(figure, rotations, root, ankles, feet, toes)
    return Pose(root, rotations, contact)


def _bob(phase: Array, period_s: float) -> Array:
    """Height of the pelvis (T,) m against strike: a ballistic arc in flight, a spring while a foot bears."""
    step = phase % 0.5
    flight_s = (0.5 - _STANCE) * period_s
    speed = 0.5 * _GRAVITY * flight_s  # downwards at strike, upwards at toe-off
    sink = speed * _STANCE * period_s / np.pi
    time = (step - _STANCE) * period_s
    return np.where(
        step < _STANCE, -sink * np.sin(np.pi * step / _STANCE), speed * time - 0.5 * _GRAVITY * time**2
    )


def _jogging_feet(
    figure: Figure, path: Path, stride: float, phase: Array, first_phase: float, s: Array
) -> tuple[list[Array], list[Array], list[Array], NDArray[np.bool_]]:
    """Ankle positions, foot rotations and toe angles of both feet, and which of them stand flat."""
    H = figure.stature_m
    ankle_h = figure.ankle_height_m
    heel = np.array([-HEEL_BACK * H, 0.0, -ankle_h])
    ball = figure.offsets[JOINT["left_toe"]]
    toe_out, half_width = np.deg2rad(4.0), 0.020 * H
    at = np.array([0.0, _FLAT_FROM, _FLAT_TO, 0.26, 0.32, _STANCE, 0.46, 0.56, 0.68, 0.80, 0.90, 1.0])
    degrees = np.array(
        [-5.0, 0.0, 0.0, 18.0, 42.0, np.rad2deg(_PUSH_RAD), 84.0, 80.0, 46.0, 12.0, -9.0, -5.0]
    )
    pitch_at = PchipInterpolator(at, np.deg2rad(degrees))
    # Ankle in the swing, forward of the pelvis and over the floor, for a stature of 1.75 m and a stride of 1.37 m.
    swing_p = np.array([0.46, 0.56, 0.66, 0.76, 0.86, 0.94])
    swing_x = np.array([-0.42, -0.32, -0.06, 0.18, 0.295, 0.255]) * (0.5 * H / 1.75 + 0.5 * stride / 1.37)
    swing_z = np.array([0.31, 0.375, 0.33, 0.225, 0.15, 0.11]) * H / 1.75

    def planted(step_s: float, sign: float, p: Array) -> Array:
        """Ankle (N, 3) of a foot in stance, world."""
        point, heading = path.at(np.array([step_s]))
        side = np.array([-np.sin(heading[0]), np.cos(heading[0])]) * sign * half_width
        pitch = pitch_at(p)
        pivot = np.where((pitch < 0)[:, None], heel, ball)
        rolled = np.einsum("nab,nb->na", rotation_about(1, pitch), -pivot)
        turn = rotation_about(2, heading[0] + sign * toe_out)
        return np.array([point[0, 0] + side[0], point[0, 1] + side[1], ankle_h]) + (rolled + pivot) @ turn.T

    def seen(world: Array, here_s: Array) -> Array:
        """World points (N, 3) in the frame of the pelvis' path at arc lengths (N,)."""
        origin, heading = path.at(here_s)
        local = np.einsum("nba,nb->na", rotation_about(2, heading)[:, :2, :2], world[:, :2] - origin)
        return np.column_stack([local, world[:, 2]])

    ankles, feet, toes = [], [], []
    contact = np.zeros((len(phase), 2), dtype=bool)
    for i, (_, sign) in enumerate(SIDES):
        own = phase + 0.5 * i
        step = np.floor(own)
        p = own - step
        ankle, yaw = np.zeros((len(p), 3)), np.zeros(len(p))
        for k in np.unique(step):
            mine = step == k
            strike_s = (k - 0.5 * i - first_phase) * stride  # of the pelvis when this foot strikes
            here = strike_s + 0.36 * _STANCE * stride
            there = here + stride
            headings = path.at(np.array([here, there]))[1] + sign * toe_out
            pm = p[mine]
            h = 1e-3
            before = np.array([_STANCE - h, _STANCE])
            after = np.array([0.0, h])
            leave = seen(planted(here, sign, before), strike_s + before * stride)
            land = seen(planted(there, sign, after), strike_s + stride + after * stride)
            knots = np.concatenate([[_STANCE], swing_p, [1.0]])
            share = (swing_p - _STANCE) / (1 - _STANCE)
            between = np.column_stack([swing_x, leave[1, 1] + share * (land[0, 1] - leave[1, 1]), swing_z])
            curve = CubicSpline(
                knots,
                np.concatenate([leave[1:], between, land[:1]]),
                bc_type=((1, (leave[1] - leave[0]) / h), (1, (land[1] - land[0]) / h)),
            )
            local = curve(np.clip(pm, _STANCE, 1.0))
            origin, heading = path.at(s[mine])
            fly = np.column_stack(
                [
                    origin + np.einsum("nab,nb->na", rotation_about(2, heading)[:, :2, :2], local[:, :2]),
                    local[:, 2],
                ]
            )
            ankle[mine] = np.where((pm <= _STANCE)[:, None], planted(here, sign, pm), fly)
            u = np.clip((pm - _STANCE) / (1 - _STANCE), 0, 1)
            yaw[mine] = headings[0] + u * u * (3 - 2 * u) * (headings[1] - headings[0])
        pitch = pitch_at(p)
        ankles.append(ankle)
        feet.append(rotation_about(2, yaw) @ rotation_about(1, pitch))
        fade = np.clip((p - _STANCE) / 0.12, 0, 1)
        toes.append(-np.maximum(pitch, 0) * np.where(p <= _STANCE, 1.0, 1 - fade))
        contact[:, i] = (p >= _FLAT_FROM) & (p <= _FLAT_TO)
    return ankles, feet, toes, contact
