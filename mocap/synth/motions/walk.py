"""Walking at a constant speed along a path.

Joint curves follow the published shapes of normal gait (Perry, Gait Analysis; Winter, The Biomechanics and
Motor Control of Human Gait): the feet and the pelvis are given, the legs are solved to the planted feet.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from mocap.synth.figure import HEEL_BACK, JOINT, SIDES, Figure, rotation_about
from mocap.synth.motions.kit import (
    MAX_REACH,
    Array,
    Path,
    Pose,
    hang_arm,
    identity,
    set_trunk,
    solve_legs,
    wander,
)

_STANCE = 0.62  # share of the gait cycle with the foot on the floor
_MIDSTANCE = 0.275  # phase at which the pelvis passes over the planted ankle


def walk(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    path: Path,
    speed_m_s: float,
    backwards: bool = False,
    rng: np.random.Generator,
) -> Pose:
    """Normal walking along a path.

    speed_m_s : 0.5 .. 1.8. Stride length and cadence follow from speed and stature.
    backwards : the walk is played from its end, which is nearly how people walk backwards.
    Source: Thorstensson 1986 (backward walking).
    """
    H = figure.stature_m
    stride = 0.71 * H * (speed_m_s / 1.2) ** 0.5 * rng.uniform(0.96, 1.04)
    first_phase = rng.uniform()
    n_wanted = n_frames
    n_frames = max(n_frames, int(np.ceil(2 * stride / speed_m_s * fps)))  # whole cycles, to fit the pelvis to
    t = np.arange(n_frames) / fps
    s = speed_m_s * t
    phase = first_phase + s / stride  # of the left leg; integer = left heel strike
    scale = rng.uniform(0.9, 1.1, size=6)
    xy, heading = path.at(s)
    # Into the curve, positive = to the left; in tight turns people step round rather than lean.
    lean = 0.10 * np.tanh(5.0 * np.arctan(speed_m_s**2 * path.curvature(s) / 9.81))
    wave = 2 * np.pi * phase
    left_of = np.column_stack([-np.sin(heading), np.cos(heading)])
    # Pelvis: the left side leads at left heel strike, drops on the swing side, and rides over the stance leg.
    sway = 0.018 * scale[0] * np.sin(wave + 0.15)
    centripetal = -np.sin(lean) * 0.45 * figure.standing_height_m
    root = np.zeros((n_frames, 3))
    root[:, :2] = xy + left_of * (sway - centripetal)[:, None]
    yaw = -np.deg2rad(6.0) * scale[1] * np.cos(wave - 0.1)
    roll = np.deg2rad(4.0) * scale[2] * np.sin(wave + 0.1)
    tilt = np.deg2rad(5.0 + 1.0 * np.cos(2 * wave))
    R_pelvis = (
        rotation_about(2, heading + yaw)
        @ rotation_about(0, -lean * 0.6 + roll * 0.9)
        @ rotation_about(1, tilt)
    )
    ankles, feet, toes, contact = _walking_feet(figure, path, stride, phase, s, first_phase)
    offsets = figure.offsets
    limit = np.full(n_frames, np.inf)
    reach = MAX_REACH * (figure.thigh_m + figure.shank_m)
    for i, (side, _) in enumerate(SIDES):
        hip = np.einsum("tab,b->ta", R_pelvis, offsets[JOINT[f"{side}_hip"]])
        across = np.linalg.norm(ankles[i][:, :2] - root[:, :2] - hip[:, :2], axis=1)
        limit = np.minimum(
            limit, ankles[i][:, 2] + np.sqrt(np.maximum(reach**2 - across**2, 0.01)) - hip[:, 2]
        )
    # The pelvis rises and falls twice per cycle as far as the planted legs ask for.
    harmonics = np.column_stack([np.cos(2 * wave), np.sin(2 * wave)])
    fitted = np.linalg.lstsq(np.column_stack([np.ones(n_frames), harmonics]), limit, rcond=None)[0][1:]
    rise = harmonics @ fitted * (0.95 + 0.2 * (scale[3] - 1))
    # Between, it stays as high as the legs allow over half a stride: knees are nearly straight at midstance.
    half = int(np.ceil(0.5 * stride / speed_m_s * fps))
    lowest = minimum_filter1d(limit - rise, 2 * half + 1, mode="nearest")
    root[:, 2] = rise + gaussian_filter1d(lowest, 0.4 * half, mode="nearest", truncate=2.5)
    rotations = identity(n_frames)
    rotations[:, 0] = R_pelvis
    set_trunk(
        rotations,
        yaw=-1.75 * yaw + np.deg2rad(1.0) * wander(n_frames, fps, slowest_s=4.0, rng=rng),
        roll=-0.9 * roll,
        bend=np.deg2rad(-3.0 + 1.5 * np.cos(2 * wave + 0.6)),
        gaze_yaw=0.6 * yaw + np.deg2rad(4.0) * wander(n_frames, fps, slowest_s=3.5, rng=rng),
        gaze_down=np.deg2rad(3.0) + np.deg2rad(2.0) * wander(n_frames, fps, slowest_s=3.0, rng=rng),
    )
    swing = np.deg2rad(20.0) * scale[4] * np.clip(speed_m_s / 1.2, 0.5, 1.4)
    for i, (side, sign) in enumerate(SIDES):
        own = wave + np.pi * i
        flexion = np.deg2rad(3.0) - swing * np.cos(own - 0.1)
        elbow = np.deg2rad(22.0) + np.deg2rad(13.0) * scale[5] * (0.5 - 0.5 * np.cos(own - 0.45))
        abduction = np.deg2rad(8.0 + 3.0 * max(figure.build - 1.0, 0.0) * 10) + np.deg2rad(1.5) * np.cos(own)
        hang_arm(rotations, side, sign, flexion, abduction, np.deg2rad(12.0), elbow)
    solve_legs(figure, rotations, root, ankles, feet, toes)
    order = slice(None, None, -1 if backwards else 1)
    return Pose(root[:n_wanted][order], rotations[:n_wanted][order], contact[:n_wanted][order])


def _walking_feet(
    figure: Figure, path: Path, stride: float, phase: Array, s: Array, first_phase: float
) -> tuple[list[Array], list[Array], list[Array], NDArray[np.bool_]]:
    """Ankle positions, foot rotations and toe angles of both feet, and which of them stand flat."""
    H = figure.stature_m
    ankle_h = figure.ankle_height_m
    heel = np.array([-HEEL_BACK * H, 0.0, -ankle_h])
    ball = figure.offsets[
        JOINT["left_toe"]
    ]  # the toes stay on the floor and the foot turns about their joint
    toe_out = np.deg2rad(6.0)
    half_width = 0.030 * H
    flat_from, flat_to = 0.08, 0.38
    strike, push = np.deg2rad(20.0), np.deg2rad(58.0)
    # Foot pitch over the cycle, positive = toes down.
    knots = np.array([0.0, 0.04, flat_from, flat_to, 0.50, 0.57, _STANCE, 0.68, 0.78, 0.88, 0.96, 1.0])
    pitches = np.concatenate(
        [
            strike * np.array([-1.0, -0.55, 0, 0]),
            push * np.array([0.30, 0.66, 1.0, 0.85, 0.30]),
            strike * np.array([-0.25, -0.95, -1.0]),
        ]
    )
    pitch_at = PchipInterpolator(knots, pitches)

    def planted(step_s: float, sign: float, p: Array) -> Array:
        """Ankle (N, 3) of a foot in stance: rolls over the heel, stands, rolls over the ball."""
        point, heading = path.at(np.array([step_s]))
        yaw = heading[0] + sign * toe_out
        side = np.array([-np.sin(heading[0]), np.cos(heading[0])]) * sign * half_width
        base = np.array([point[0, 0] + side[0], point[0, 1] + side[1], ankle_h])
        turn = rotation_about(2, yaw)
        pitch = pitch_at(p)
        pivot = np.where((p < 0.2)[:, None], heel, ball)
        rolled = np.einsum("nab,nb->na", rotation_about(1, pitch), -pivot)
        return base + (rolled + pivot) @ turn.T

    ankles, feet, toes = [], [], []
    contact = np.zeros((len(phase), 2), dtype=bool)
    for i, (_, sign) in enumerate(SIDES):
        own = phase + 0.5 * i
        step = np.floor(own)
        p = own - step
        start = (step - 0.5 * i - first_phase) * stride  # path position of the pelvis at this heel strike
        ankle = np.zeros((len(p), 3))
        yaw = np.zeros(len(p))
        for k in np.unique(step):
            mine = step == k
            here = start[mine][0] + _MIDSTANCE * stride
            there = here + stride
            yaw_here = path.at(np.array([here, there]))[1] + sign * toe_out
            pm = p[mine]
            stance = pm <= _STANCE
            u = np.clip((pm - _STANCE) / (1 - _STANCE), 0, 1)
            ends = np.concatenate(
                [
                    planted(here, sign, np.array([_STANCE - 0.01, _STANCE])),
                    planted(there, sign, np.array([0.0, 0.01])),
                ]
            )
            span = 1 - _STANCE
            speed0 = (ends[1] - ends[0]) / 0.01 * span
            # The foot still travels forward when the heel strikes; a foot that waits would stretch the leg.
            onward = (ends[2] - ends[1]) * np.array([1.0, 1.0, 0.0])
            speed1 = 0.40 * stride * span * onward / np.linalg.norm(onward) + np.array([0, 0, -0.05])
            # Mid-swing: the ankle is halfway and still high, so that knee and toes clear the floor.
            middle = 0.5 * (ends[1] + ends[2])
            middle[2] = ankle_h + 0.040 * H
            slope = 1.25 * (ends[2] - ends[1])
            slope[2] = -0.12 * H
            fly = CubicHermiteSpline([0, 0.5, 1], [ends[1], middle, ends[2]], [speed0, slope, speed1])(u)
            fly[:, 2] += 0.010 * H * np.sin(np.pi * np.minimum(u / 0.4, 1.0)) ** 2  # toes clear the floor
            ankle[mine] = np.where(stance[:, None], planted(here, sign, pm), fly)
            blend = u * u * (3 - 2 * u)
            yaw[mine] = yaw_here[0] + blend * (yaw_here[1] - yaw_here[0])
        pitch = pitch_at(p)
        ankles.append(ankle)
        feet.append(rotation_about(2, yaw) @ rotation_about(1, pitch))
        # Toes stay flat while the heel rises, and straighten in early swing.
        fade = np.clip((p - _STANCE) / 0.12, 0, 1)
        toes.append(-np.maximum(pitch, 0) * np.where(p <= _STANCE, 1.0, 1 - fade))
        contact[:, i] = (p >= flat_from + 1e-9) & (p <= flat_to)
    return ankles, feet, toes, contact
