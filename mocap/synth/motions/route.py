"""Walking along way-points with stops, turns on the spot and chairs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mocap.synth.figure import Figure
from mocap.synth.motions.kit import Array, Pose, identity
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

_ROUNDING_M = 0.45  # corners are cut from this far before them
_TURN_FIRST_RAD = np.deg2rad(40.0)  # a larger change of direction is made on the spot
_SHARP_RAD = np.deg2rad(65.0)  # sharper corners are turned on the spot
_ALIGNED_RAD = np.deg2rad(8.0)
_SHORTEST_SIT_S = 0.6
_LONG_S = 60.0
_SHIFT_S = 0.35  # the weight goes to one leg before the first step


@dataclass(frozen=True)
class Stop:
    """A point of a route.

    at : (x, y) m where the person passes or stands; with a seat the middle of the seat.
    pause_s : time spent there (0 = passes).  heading_rad : where the person looks during the pause.
    seat_height_m : height of a seat to sit on, None = stands.
    """

    at: tuple[float, float]
    pause_s: float = 0.0
    heading_rad: float | None = None
    seat_height_m: float | None = None

    def __post_init__(self) -> None:
        if self.seat_height_m is not None and self.heading_rad is None:
            raise ValueError("a stop with a seat needs heading_rad, the front of the seat")


def route(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    stops: Sequence[Stop],
    speed_m_s: float,
    start_s: float = 0.0,
    repeat: bool = False,
    rng: np.random.Generator,
) -> Pose:
    """Walk from stop to stop, pause, sit down and get up.

    start_s : when the person leaves the first stop (negative: already on its way in frame 0).
    repeat : walk on to the first stop after the last and begin again.
    Raises ValueError without stops, or when a seat is too high for the person's legs.
    """
    if not stops:
        raise ValueError("a route needs at least one stop, got none")
    t, keep = timeline(n_frames, fps)
    plan, seatings = _plan(figure, stops, speed_m_s, start_s, t[-1] if repeat else None, rng)
    gait = follow_feet(figure, plan, t, fps)
    rotations = identity(len(t))
    upright = gait.tilt
    seated, bend = sit_on(gait, seatings)
    look_about(gait, rotations, rng=rng, bend=bend, calm=1.0 + 0.4 * seated)
    swing_arms(gait, rotations, rng=rng, lean=bend + gait.tilt - upright)
    return finish_seated(gait, rotations, seated, keep)


def _plan(
    figure: Figure,
    stops: Sequence[Stop],
    speed: float,
    start_s: float,
    until_s: float | None,
    rng: np.random.Generator,
) -> tuple[Footsteps, list[Seating]]:
    """Footsteps and stays on seats; until_s : repeat until then."""
    stride = 0.71 * figure.stature_m * (speed / 1.2) ** 0.5 * rng.uniform(0.96, 1.04)
    step_m, step_s = 0.5 * stride, 0.5 * stride / speed
    side = int(rng.integers(2))
    seatings: list[Seating] = []
    places = [_place(figure, stop) for stop in stops]
    first, clock = stops[0], start_s
    heading = _first_heading(first, places)
    plan = Footsteps(figure, (float(places[0][0]), float(places[0][1])), heading)
    if first.seat_height_m is not None:
        # Seated since long before the first frame.
        seatings.append(Seating(first.at, heading, first.seat_height_m, min(clock, 0.0) - _LONG_S, clock))
        clock += STAND_UP_S
    for stop, points in _legs(stops, places, until_s is not None):
        clock, heading, side = _walk_leg(plan, points, heading, clock, side, step_m, step_s)
        if stop.heading_rad is not None:
            wanted = _nearest_turn(heading, stop.heading_rad)
            if abs(wanted - heading) > _ALIGNED_RAD or stop.seat_height_m is not None:
                here = (float(points[-1][0]), float(points[-1][1]))
                clock = plan.turn(here, heading, wanted, clock)
                heading = wanted
        if stop.seat_height_m is None:
            clock += stop.pause_s
        else:
            is_last = until_s is None and stop is stops[-1]  # nobody calls the person up again
            up_s = clock + SIT_DOWN_S + (_LONG_S * 1e4 if is_last else max(stop.pause_s, _SHORTEST_SIT_S))
            seatings.append(Seating(stop.at, heading, stop.seat_height_m, clock, up_s))
            clock = up_s + STAND_UP_S
        if until_s is not None and clock > until_s:
            break
    return plan, seatings


def _place(figure: Figure, stop: Stop) -> Array:
    """Where one stands at a stop, (2,) m: at it, or before its seat."""
    if stop.seat_height_m is None or stop.heading_rad is None:
        return np.array(stop.at)
    check_seat(figure, stop.seat_height_m)
    return np.array(place_before(figure, stop.at, stop.heading_rad))


def _first_heading(first: Stop, places: Sequence[Array]) -> float:
    if first.heading_rad is not None:
        return first.heading_rad
    away = next(
        (p - places[0] for p in places[1:] if np.linalg.norm(p - places[0]) > 1e-6), np.array([1.0, 0.0])
    )
    return float(np.arctan2(away[1], away[0]))


def _legs(stops: Sequence[Stop], places: Sequence[Array], repeat: bool) -> Iterator[tuple[Stop, Array]]:
    """The way (n, 2) m to each stop at which the person halts: to pause, to sit, at a sharp corner, at the end."""
    n = len(stops)
    repeat = repeat and any(np.linalg.norm(p - places[0]) > 1e-6 for p in places)
    points = [places[0]]
    k = 0
    while repeat or k + 1 < n:
        k += 1
        stop, here = stops[k % n], places[k % n]
        points.append(here)
        is_end = k % n == 0 if repeat else k + 1 == n
        before, after = points[-2], places[(k + 1) % n]
        turn = np.arctan2(*(after - here)[::-1]) - np.arctan2(*(here - before)[::-1])
        is_sharp = abs(np.angle(np.exp(1j * turn))) > _SHARP_RAD
        if is_end or is_sharp or stop.pause_s > 0 or stop.seat_height_m is not None:
            yield stop, np.array(points)
            points = [here]


def _walk_leg(
    plan: Footsteps,
    points: Array,
    heading: float,
    clock: float,
    side: int,
    step_m: float,
    step_s: float,
) -> tuple[float, float, int]:
    """Steps along one polyline (n, 2) m; returns the time of arrival, the heading and the foot that goes next."""
    keep = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6])
    points = points[keep]
    if len(points) < 2:
        return clock, heading, side
    along, xy, headings = _rounded(points)
    headings = headings + 2 * np.pi * np.round((heading - headings[0]) / (2 * np.pi))
    if abs(headings[0] - heading) > _TURN_FIRST_RAD:
        clock = plan.turn((float(xy[0, 0]), float(xy[0, 1])), heading, float(headings[0]), clock)
    n = max(int(np.ceil(along[-1] / step_m - 0.2)), 1)
    if headings[0] != heading:
        side = 0 if headings[0] > heading else 1
    land = clock + _SHIFT_S
    walking = 0.6 * plan.half_m  # feet are closer together when walking than when standing
    for k in range(1, n + 2):
        s = along[-1] * min(k / n, 1.0)
        at = (float(np.interp(s, along, xy[:, 0])), float(np.interp(s, along, xy[:, 1])))
        direction = float(np.interp(s, along, headings))
        land += step_s
        where, yaw = plan.beside(side, at, direction, plan.half_m if k >= n else walking)
        plan.step(side, land - 0.76 * step_s, land, where, yaw)
        side = 1 - side
    return land + 0.2, float(headings[-1]), side


def _rounded(points: Array) -> tuple[Array, Array, Array]:
    """A polyline (n, 2) m with rounded corners: arc lengths (N,) m, points (N, 2) m and headings (N,) rad."""
    pieces = [points[:1]]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        reach = [min(_ROUNDING_M, 0.45 * float(np.linalg.norm(p - corner))) for p in (before, after)]
        enter, leave = (
            corner + r * (p - corner) / np.linalg.norm(p - corner)
            for r, p in zip(reach, (before, after), strict=True)
        )
        u = np.linspace(0, 1, 25)[:, None]
        pieces.append((1 - u) ** 2 * enter + 2 * u * (1 - u) * corner + u**2 * leave)
    pieces.append(points[-1:])
    coarse = np.concatenate(pieces)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(coarse, axis=0), axis=1))])
    along = np.linspace(0, length[-1], max(int(length[-1] / 0.01), 8))
    xy = np.column_stack([np.interp(along, length, coarse[:, k]) for k in range(2)])
    step = np.gradient(xy, along, axis=0)
    headings = gaussian_filter1d(np.unwrap(np.arctan2(step[:, 1], step[:, 0])), 8, mode="nearest")
    return along, xy, headings


def _nearest_turn(heading: float, wanted: float) -> float:
    """`wanted` plus whole turns, as near to `heading` as possible."""
    return wanted + 2 * np.pi * float(np.round((heading - wanted) / (2 * np.pi)))
