"""Throwing a ball to a partner and catching it. The ball itself is not shown."""

from __future__ import annotations

import numpy as np

from mocap.synth.figure import Figure
from mocap.synth.motions.kit import Array, Pose, follow, identity, solve_arms, swing_round
from mocap.synth.motions.steps import Footsteps, follow_feet, look_about, timeline

PERIOD_S = 4.0  # from catch to catch, the same for everybody, so that two throwers stay in step
RELEASE_S = 1.85  # of the throw after the catch; half a period less the flight of the ball


def throw(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    is_second: bool = False,
    rng: np.random.Generator,
) -> Pose:
    """Catch with both hands before the chest, wind up, step forward and throw overhand, step back, wait.

    heading_rad : towards the partner.  is_second : half a period behind, so that two persons play together.
    """
    t, keep = timeline(n_frames, fps)
    lead = 0 if rng.uniform() < 0.85 else 1  # the foot that steps forward: left for right-handed people
    hand = 1 - lead
    plan = Footsteps(figure, position, heading_rad)
    reach = figure.upper_arm_m + figure.forearm_m
    forward = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    ready = np.array([0.48, -0.02, -0.30])
    knots: list[list[tuple[float, Array]]] = [[(t[0], ready)], [(t[0], ready)]]
    trunk: list[tuple[float, Array]] = [(t[0], np.zeros(3))]  # twist towards the throwing side, bend, crouch
    catch = float(rng.uniform(-0.6, -0.2)) + (0.5 * PERIOD_S if is_second else 0.0)
    catch -= PERIOD_S * np.ceil((catch - t[0] - 1.0) / PERIOD_S)
    while catch < t[-1]:
        height, aside = float(rng.normal(0.0, 0.12)), float(rng.normal(0.0, 0.10))
        slack = rng.uniform(0.92, 1.08, 6)
        step_m = 0.20 * figure.stature_m * slack[0]
        caught = [np.array([0.74, 0.10 + s * aside, -0.08 + height]) for s in (-1.0, 1.0)]
        lift = catch + 1.25
        if lift > t[0] + 0.5:
            out = (position[0] + step_m * forward[0], position[1] + step_m * forward[1])
            plan.stand(lead, lift, catch + 1.68, out, heading_rad)
            plan.stand(lead, catch + 2.75, catch + 3.2, position, heading_rad)
        for arm in range(2):
            knots[arm] += [
                (catch - 0.55, ready),
                (catch, caught[arm]),
                (catch + 0.25, np.array([0.46, -0.04, -0.22 + 0.6 * height])),
                (catch + 0.75, np.array([0.42, -0.06, -0.18])),
            ]
        release = catch + RELEASE_S
        knots[hand] += [
            (catch + 1.10, np.array([0.05, 0.62, 0.10])),
            (catch + 1.50, np.array([-0.16, 0.58, 0.36]) * slack[1]),
            (release - 0.13, np.array([0.10, 0.42, 0.62])),
            (release, np.array([0.72, 0.12, 0.50]) * slack[2]),
            (release + 0.16, np.array([0.82, -0.14, -0.15])),
            (release + 0.42, np.array([0.52, -0.14, -0.62]) * slack[3]),
            (release + 1.05, ready),
        ]
        knots[1 - hand] += [
            (catch + 1.15, np.array([0.62, 0.02, 0.00])),
            (catch + 1.50, np.array([0.86, 0.12, 0.14]) * slack[4]),
            (release, np.array([0.50, 0.22, -0.26])),
            (release + 0.35, np.array([0.20, 0.42, -0.55])),
            (release + 1.05, ready),
        ]
        wind = 0.75 * slack[5]
        trunk += [
            (catch - 0.5, np.array([0.0, 0.04, 0.012])),
            (catch, np.array([0.0, -0.02, 0.004])),
            (catch + 0.35, np.array([0.0, 0.12, 0.018])),
            (catch + 0.75, np.array([0.15, 0.05, 0.008])),
            (catch + 1.50, np.array([wind, -0.12, 0.016])),
            (release, np.array([-0.30, 0.10, 0.022])),
            (release + 0.40, np.array([-0.60, 0.42, 0.030])),
            (release + 1.15, np.array([0.0, 0.04, 0.010])),
        ]
        catch += PERIOD_S
    side = -1.0 if hand == 1 else 1.0  # turning towards the throwing side is to the right for a right hand
    turn, bend, crouch = follow(trunk, len(t), fps, start_s=t[0]).T
    gait = follow_feet(figure, plan, t, fps, follow_s=0.2)
    gait.ride(crouch * figure.stature_m)
    gait.pelvis_yaw = gait.pelvis_yaw + 0.45 * side * turn
    rotations = identity(len(t))
    look_about(
        gait, rotations, rng=rng, bend=bend, gaze_yaw=-0.75 * side * turn, calm=0.3, twist=0.55 * side * turn
    )
    rotations[:, 0] = gait.pelvis
    goals = [swing_round(k, len(t), fps, start_s=t[0]) * reach for k in knots]
    poles = [np.tile([-0.6, 0.6, -0.7], (len(t), 1)) for _ in range(2)]
    solve_arms(figure, rotations, gait.root, goals, poles)
    return gait.finish(rotations, keep)
