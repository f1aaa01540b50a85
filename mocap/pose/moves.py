"""Jumps and squats: how high somebody jumps with both feet, and how far he lowers himself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mocap.data.motion import ALL_LANDMARKS
from mocap.pose.angles import angles_of_states, body_angles
from mocap.pose.contacts import unbroken_runs
from mocap.pose.result import PersonPoses
from mocap.pose.steps import SIDES, Gait, over_floor, unbroken_stretches

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_GRAVITY = 9.81  # m/s^2
# Feet that leave or land farther apart in time step or run; a jump of 2 cm flies for 0.13 s.
_TOGETHER_S, _LEAST_FLIGHT_S = 0.15, 0.12
# A walking pelvis sinks by 5 cm, a jogging one by 10; a squat lasts while the pelvis is down by a quarter of its depth.
_LEAST_DEPTH_M, _OUT_SHARE = 0.15, 0.25
# Of the pelvis' heights while heels rest: who stands and squats by turns stands a tenth of it.
_STANDING_QUANTILE = 0.9


@dataclass(frozen=True)
class Move:
    """A jump or a squat of one person.

    begin, end : rows; of a jump its first frame in the air and the first one after it, of a squat where a quarter of
    the depth begins and ends.  extreme : row of the highest or lowest place.  height_m : of the pelvis there over its
    height in standing, below 0 in a squat.  flight_s : in the air, and `flight_height_m` : what a body that flies so
    long rises after its toes have left, None of a squat.  knee_flexion_rad : of the more bent knee, None of a jump.
    """

    kind: Literal["jump", "squat"]
    begin: int
    extreme: int
    end: int
    height_m: float
    flight_s: float | None = None
    flight_height_m: float | None = None
    knee_flexion_rad: float | None = None


def moves_of(poses: PersonPoses, gait: Gait, fps: float) -> tuple[Move, ...]:
    """The jumps and squats of one person by time, those of every stretch between two absences; none where contacts are
    not told."""
    if gait.contacts is None:
        return ()
    pelvis = over_floor(poses.landmarks[:, [ALL_LANDMARKS.index("pelvis")]], gait.slope)[:, 0, 2]
    names = body_angles(poses.body)
    knees = [names.index(f"{side}_knee_flexion") for side in SIDES]
    bent = angles_of_states(poses.body, poses.states)[:, knees].max(axis=1)
    rests, found = gait.contacts.probability > 0.5, []
    for rows in unbroken_stretches(poses.frames):
        found += [
            replace(m, **{name: getattr(m, name) + rows.start for name in ("begin", "extreme", "end")})
            for m in find_moves(pelvis[rows], rests[rows], bent[rows], fps)
        ]
    return tuple(found)


def find_moves(pelvis: Array, rests: Mask, knee: Array, fps: float) -> tuple[Move, ...]:
    """Jumps and squats by time.

    pelvis : (T,) m, heights over the floor.  rests : (T, 4), heel and toe of the left foot and of the right.
    knee : (T,) rad, of the more bent knee.
    """
    heels = rests[:, ::2].all(axis=1)
    if not heels.any():
        return ()
    standing = float(np.quantile(pelvis[heels], _STANDING_QUANTILE))
    feet: Mask = np.asarray(rests.reshape(-1, 2, 2).any(axis=2))
    jumps = _jumps(pelvis - standing, feet, fps)
    squats = _squats(standing - pelvis, np.asarray(feet.any(axis=1)), knee, fps)
    return tuple(sorted([*jumps, *squats], key=lambda move: move.begin))


def _jumps(over: Array, feet: Mask, fps: float) -> list[Move]:
    """over : (T,) m, of the pelvis over its height in standing.  feet : (T, 2), which of them rest."""
    near = max(1, round(_TOGETHER_S * fps))
    found = []
    for run in unbroken_runs(~np.asarray(feet.any(axis=1))):
        begin, end = int(run[0]), int(run[-1]) + 1
        before, after = feet[max(begin - near, 0) : begin], feet[end : end + near]
        flight_s = len(run) / fps
        if flight_s < _LEAST_FLIGHT_S or not (before.any(axis=0).all() and after.any(axis=0).all()):
            continue
        top = begin + int(over[begin:end].argmax())
        rise = _GRAVITY * flight_s**2 / 8.0
        found.append(Move("jump", begin, top, end, _flown_height(over[begin:end], fps), flight_s, rise))
    return found


def _flown_height(over: Array, fps: float) -> float:
    """The top m of the parabola through heights (n,) m in the air: it lies between frames, and each is a bit off."""
    t = np.arange(len(over)) / fps
    flown = over + 0.5 * _GRAVITY * t**2
    speed, start = np.polyfit(t, flown, 1)
    return float(start + speed**2 / (2.0 * _GRAVITY))


def _squats(depth: Array, is_down: Mask, knee: Array, fps: float) -> list[Move]:
    """depth : (T,) m, of the pelvis under its height in standing.  is_down : (T,) whether a foot rests."""
    near = round(_TOGETHER_S * fps)
    found: list[Move] = []
    for deep in unbroken_runs((depth > _LEAST_DEPTH_M) & is_down):
        bottom = int(deep[0] + depth[deep].argmax())
        deepest = float(depth[bottom])
        (whole,) = (run for run in unbroken_runs(depth > _OUT_SHARE * deepest) if run[0] <= bottom <= run[-1])
        begin, end = int(whole[0]), int(whole[-1]) + 1
        # What is sunk to take off and to land belongs to a jump, also to one that the clip cuts off.
        of_jump = not is_down[max(begin - near, 0) : end + near].all()
        if not of_jump and not any(begin < squat.end and squat.begin < end for squat in found):
            found.append(Move("squat", begin, bottom, end, -deepest, knee_flexion_rad=float(knee[bottom])))
    return found


def move_numbers(moves: tuple[Move, ...]) -> dict[str, float]:
    """How many jumps and squats there were, and the highest and the deepest; nothing of what there was not."""
    jumps = [move.height_m for move in moves if move.kind == "jump"]
    squats = [move.height_m for move in moves if move.kind == "squat"]
    numbers: dict[str, float] = {}
    if jumps:
        numbers |= {"jumps": float(len(jumps)), "highest_jump_m": max(jumps)}
    if squats:
        numbers |= {"squats": float(len(squats)), "deepest_squat_m": -min(squats)}
    return numbers
