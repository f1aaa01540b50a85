"""Sitting down on a seat, staying, and standing up again."""

from __future__ import annotations

import numpy as np

from mocap.synth.figure import Figure
from mocap.synth.motions.kit import Pose, identity
from mocap.synth.motions.seat import (
    SIT_DOWN_S,
    STAND_UP_S,
    Seating,
    check_seat,
    finish_seated,
    place_before,
    sit_on,
)
from mocap.synth.motions.steps import Footsteps, follow_feet, look_about, swing_arms, timeline


def sit(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    seat_height_m: float = 0.45,
    rng: np.random.Generator,
) -> Pose:
    """Stand before a seat, sit down, stay a while, stand up, again and again.

    position : (x, y) m, middle of the seat.  heading_rad : its front.
    Raises ValueError when the seat is too high for the person's legs.
    """
    check_seat(figure, seat_height_m)
    t, keep = timeline(n_frames, fps)
    plan = Footsteps(figure, place_before(figure, position, heading_rad), heading_rad)
    seatings = []
    clock = 0.25 + rng.uniform(0, 0.3)
    while clock < n_frames / fps:
        up_s = clock + SIT_DOWN_S + rng.uniform(0.7, 1.6)
        at = (position[0] + float(rng.normal(0, 0.01)), position[1] + float(rng.normal(0, 0.01)))
        seatings.append(Seating(at, heading_rad, seat_height_m, clock, up_s))
        clock = up_s + STAND_UP_S + rng.uniform(0.4, 0.9)
    gait = follow_feet(figure, plan, t, fps)
    rotations = identity(len(t))
    upright = gait.tilt
    seated, bend = sit_on(gait, seatings)
    look_about(gait, rotations, rng=rng, bend=bend)
    swing_arms(gait, rotations, rng=rng, lean=bend + gait.tilt - upright)
    return finish_seated(gait, rotations, seated, keep)
