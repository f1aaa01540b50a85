"""Dancing on the spot to a steady beat: side steps, turns, swaying hips, arms that swing, rise and roll."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mocap.synth.figure import Figure
from mocap.synth.motions.kit import Array, Pose, follow, identity, solve_arms, swing_round
from mocap.synth.motions.steps import Footsteps, follow_feet, look_about, timeline

_FIGURES = ("side", "turn", "sway", "march")
_ARMS = ("swing", "high", "wide", "roll")


def dance(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
) -> Pose:
    """Figures of four beats, in an order drawn from rng, each with a movement of the arms."""
    t, keep = timeline(n_frames, fps)
    H = figure.stature_m
    reach = figure.upper_arm_m + figure.forearm_m
    beat = rng.uniform(0.48, 0.56)
    plan = Footsteps(figure, position, heading_rad)
    start = t[0] + 0.6
    rest = np.array([0.38, 0.14, -0.60])
    knots: list[list[tuple[float, Array]]] = [[(t[0], rest)], [(t[0], rest)]]
    hips: list[tuple[float, Array]] = [(t[0], np.zeros(3))]  # sideways, twist, bend
    heading, clock, last, last_arms = heading_rad, start, "", ""
    while clock + 4 * beat < t[-1]:
        last = str(rng.choice([f for f in _FIGURES if f != last]))
        if last == "side":
            _side_steps(plan, position, heading, clock, beat, 0.14 * H * rng.uniform(0.85, 1.15))
        elif last == "turn":
            way = float(rng.choice([-1.0, 1.0])) * np.pi / 2
            _turn_steps(plan, position, heading, heading + 2 * way, clock, beat)
            heading += 2 * way
        elif last == "march":
            for k in range(4):
                plan.stand(k % 2, clock + (k + 0.15) * beat, clock + (k + 0.85) * beat, position, heading)
        size = rng.uniform(0.8, 1.2) * (1.7 if last == "sway" else 0.8)
        for k in range(4):
            way = 1.0 if k % 2 == 0 else -1.0
            hips.append(
                (clock + (k + 0.6) * beat, np.array([way * 0.032 * size, way * 0.14 * size, 0.03 * size]))
            )
        last_arms = str(rng.choice([a for a in _ARMS if a != last_arms]))
        _move_arms(knots, last_arms, clock, beat, rng)
        clock += 4 * beat
    aside, twist, bend = gaussian_filter1d(follow(hips, len(t), fps, start_s=t[0]), 0.06 * fps, axis=0).T
    gait = follow_feet(figure, plan, t, fps, follow_s=0.17)
    left = np.column_stack([-np.sin(gait.yaw), np.cos(gait.yaw)])
    gait.root[:, :2] += (aside * H / 1.75)[:, None] * left
    bounce = 0.5 - 0.5 * np.cos(2 * np.pi * (t - start) / beat)
    gait.ride((0.006 + 0.022 * rng.uniform(0.7, 1.2) * bounce) * H)
    gait.pelvis_yaw = gait.pelvis_yaw + twist
    gait.roll = gait.roll + 1.6 * aside
    rotations = identity(len(t))
    look_about(gait, rotations, rng=rng, bend=bend, calm=0.6, twist=-1.3 * twist, gaze_down=0.06 * bounce)
    rotations[:, 0] = gait.pelvis
    goals = [swing_round(k, len(t), fps, start_s=t[0]) * reach for k in knots]
    poles = [np.tile([-0.6, 0.65, -0.6], (len(t), 1)) for _ in range(2)]
    solve_arms(figure, rotations, gait.root, goals, poles)
    return gait.finish(rotations, keep)


def _side_steps(
    plan: Footsteps, position: tuple[float, float], heading: float, clock: float, beat: float, step_m: float
) -> None:
    """Left, close, right, close."""
    left = np.array([-np.sin(heading), np.cos(heading)])
    out = (position[0] + step_m * float(left[0]), position[1] + step_m * float(left[1]))
    for k, (side, at) in enumerate(((0, out), (1, out), (1, position), (0, position))):
        plan.stand(side, clock + (k + 0.12) * beat, clock + (k + 0.85) * beat, at, heading)


def _turn_steps(
    plan: Footsteps, position: tuple[float, float], start: float, end: float, clock: float, beat: float
) -> None:
    """Half a turn in four steps; the inner foot opens."""
    first = 0 if end > start else 1
    for k, share in enumerate((0.3, 0.6, 0.9, 1.0)):
        side = first if k % 2 == 0 else 1 - first
        plan.stand(
            side,
            clock + (k + 0.12) * beat,
            clock + (k + 0.88) * beat,
            position,
            start + share * (end - start),
        )


def _move_arms(
    knots: list[list[tuple[float, Array]]], kind: str, clock: float, beat: float, rng: np.random.Generator
) -> None:
    """Wrist targets of both arms over four beats, in arm lengths from the shoulder: forward, outward, up."""
    for arm in range(2):
        for k in range(4):
            moment = clock + (k + 0.55) * beat
            turn = (k + arm) % 2 == 0
            goal = {
                "swing": np.array([0.62, -0.10, -0.22]) if turn else np.array([-0.12, 0.36, -0.70]),
                "high": np.array([0.30, 0.36 if turn else 0.16, 0.72]),
                "wide": np.array([0.28, 0.78, 0.10 if turn else -0.22]),
                "roll": np.array([0.52, -0.05, 0.02 if turn else -0.22]),
            }[kind]
            knots[arm].append((moment, goal + rng.normal(0, 0.025, 3)))
