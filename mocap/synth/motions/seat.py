"""Sitting down on a seat and standing up from it, for any motion on planned feet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from mocap.synth.figure import JOINT, SIDES, Figure, forward_kinematics, rotation_about
from mocap.synth.motions.kit import Array, Pose, blend_rotations, solve_arms
from mocap.synth.motions.steps import Gait

SIT_DOWN_S = 1.9
STAND_UP_S = 1.8
_FEET_BEFORE = (
    0.225  # ankles before the middle of the seat, of stature: shanks upright, calves clear of the edge
)
_PELVIS_OVER = 0.068  # pelvis over the seat, of stature: flesh under the hip joint
_LEAN_PELVIS_RAD, _LEAN_TRUNK_RAD = 0.38, 0.42  # the trunk leans over the feet until the seat bears it
_LONGEST_LEG = 0.97  # of the straight leg, when seated


@dataclass(frozen=True)
class Seating:
    """One stay on a seat.

    at : (x, y) m, middle of the seat.  heading_rad : its front.  height_m : of the seat.
    down_s, up_s : when sitting down and standing up begin.
    """

    at: tuple[float, float]
    heading_rad: float
    height_m: float
    down_s: float
    up_s: float


def place_before(figure: Figure, at: tuple[float, float], heading_rad: float) -> tuple[float, float]:
    """Where to stand, back to the seat, to sit down on it: (x, y) m between the ankles."""
    ahead = _FEET_BEFORE * figure.stature_m
    return at[0] + ahead * float(np.cos(heading_rad)), at[1] + ahead * float(np.sin(heading_rad))


def check_seat(figure: Figure, height_m: float) -> None:
    """Raises ValueError when the feet of a seated person would not reach the floor."""
    H = figure.stature_m
    rise = height_m + _PELVIS_OVER * H - figure.ankle_height_m
    longest = _LONGEST_LEG * (figure.thigh_m + figure.shank_m)
    if np.hypot(rise, _FEET_BEFORE * H) > longest:
        highest = np.sqrt(longest**2 - (_FEET_BEFORE * H) ** 2) + figure.ankle_height_m - _PELVIS_OVER * H
        raise ValueError(
            f"seat_height_m must be at most {highest:.2f} for a stature of {H:.2f} m, got {height_m}"
        )


def sit_on(gait: Gait, seatings: Sequence[Seating]) -> tuple[Array, Array]:
    """Move the pelvis to the seats and back; returns how seated (T,) 0 .. 1 and the bend of the trunk (T,) rad."""
    H = gait.figure.stature_m
    seated, lean = np.zeros(len(gait.t)), np.zeros(len(gait.t))
    for seat in seatings:
        # The trunk leans first, then the pelvis moves; getting up the lean leads too.
        times = np.array([0.0, 0.45, 0.75, 1.15]) * SIT_DOWN_S + seat.down_s
        times = np.concatenate([times, np.array([0.0, 0.42, 0.68, 1.05]) * STAND_UP_S + seat.up_s])
        leaning = PchipInterpolator(times, [0, 1, 0.85, 0, 0, 1, 0.75, 0], extrapolate=False)(gait.t)
        now = _ease((gait.t - seat.down_s) / SIT_DOWN_S, 0.08) - _ease(
            (gait.t - seat.up_s) / STAND_UP_S, 0.28
        )
        back = 0.5 * now + 0.5 * np.sin(0.5 * np.pi * now)
        down = 0.5 * now + 0.5 * (1 - np.cos(0.5 * np.pi * now))
        target = np.array([*seat.at, seat.height_m + _PELVIS_OVER * H])
        share = np.column_stack([back, back, down])
        gait.root += share * (target - gait.root)
        seated += now
        lean += np.nan_to_num(leaning)
    gait.tilt = gait.tilt + _LEAN_PELVIS_RAD * lean - 0.20 * seated
    return seated, _LEAN_TRUNK_RAD * lean + 0.16 * seated


def finish_seated(gait: Gait, rotations: Array, seated: Array, keep: slice) -> Pose:
    """Solve the legs, lay the hands on the thighs while seated, and cut out the wanted frames."""
    gait.finish(rotations, keep)
    figure = gait.figure
    on_lap = np.clip((seated - 0.35) / 0.5, 0, 1)
    on_lap = on_lap * on_lap * (3 - 2 * on_lap)
    frames = np.flatnonzero(on_lap > 0)
    if len(frames):
        resting = rotations[frames].copy()
        for _ in range(2):  # the shoulder moves with the arm, so the second pass starts nearer
            _hands_on_thighs(figure, resting, gait.root[frames])
        rotations[frames] = blend_rotations(rotations[frames], resting, on_lap[frames, None])
    return Pose(gait.root[keep], rotations[keep], gait.contact[keep])


def _hands_on_thighs(figure: Figure, rotations: Array, root: Array) -> None:
    H = figure.stature_m
    position, rotation = forward_kinematics(figure.offsets, rotations, root)
    chest = rotation[:, JOINT["chest"]]
    goals = []
    for side, sign in SIDES:
        hip, knee = position[:, JOINT[f"{side}_hip"]], position[:, JOINT[f"{side}_knee"]]
        over = rotation[:, JOINT[f"{side}_hip"], :, 0]  # front of the thigh: upwards when seated
        axis_m = (1 - 0.55) * figure.surface[JOINT[f"{side}_hip"], 0]  # of the thigh's flesh, before the bone
        target = hip + 0.55 * (knee - hip) + ((0.050 * figure.build**0.9 + 0.022) * H + axis_m) * over
        local = np.einsum("tba,tb->ta", chest, target - position[:, JOINT[f"{side}_shoulder"]])
        goals.append(local * np.array([1.0, sign, 1.0]))
    poles = [np.tile([-0.8, 0.6, -0.4], (len(root), 1)) for _ in SIDES]
    solve_arms(figure, rotations, root, goals, poles)
    _, rotation = forward_kinematics(figure.offsets, rotations, root)
    for side, sign in SIDES:
        # The hand lies along the thigh, the palm half turned down.
        fore = rotation[:, JOINT[f"{side}_elbow"]]
        along = -rotation[:, JOINT[f"{side}_hip"], :, 2]
        local = np.einsum("tba,tb->ta", fore, along)
        axis = np.cross([0.0, 0.0, -1.0], local)
        angle = np.arctan2(np.linalg.norm(axis, axis=1), -local[:, 2])
        axis *= (angle / np.maximum(np.linalg.norm(axis, axis=1), 1e-9))[:, None]
        bent = Rotation.from_rotvec(axis).as_matrix()
        rotations[:, JOINT[f"{side}_wrist"]] = bent @ rotation_about(2, -sign * np.deg2rad(40.0))


def _ease(tau: Array, begin: float) -> Array:
    """Minimum-jerk rise from 0 to 1 for tau from `begin` to 1."""
    u = np.clip((tau - begin) / (1 - begin), 0, 1)
    return u**3 * (10 - 15 * u + 6 * u**2)
