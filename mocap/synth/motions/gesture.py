"""Arm gestures while standing."""

from __future__ import annotations

import numpy as np

from mocap.synth.figure import SIDES, Figure
from mocap.synth.motions.kit import Array, Pose, Stance, solve_arms, standing, swing_round


def gesture(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
) -> Pose:
    """Standing with arm gestures in turn: wave, point, beckon, arms out, alternating between the arms."""
    rotations, root = standing(figure, n_frames, fps, position, heading_rad, rng, Stance(sway=1.3))
    reach = figure.upper_arm_m + figure.forearm_m
    rest = np.array([0.10, 0.12, -0.93])
    # Wrist targets relative to the shoulder, in arm lengths: forward, outward, up.
    shapes: dict[str, list[tuple[float, float, float]]] = {
        "wave": [
            (0.35, 0.35, 0.30),
            (0.30, 0.60, 0.42),
            (0.32, 0.22, 0.44),
            (0.30, 0.60, 0.42),
            (0.35, 0.3, 0.4),
        ],
        "point": [(0.80, 0.20, 0.05), (0.93, 0.18, 0.12), (0.92, 0.32, 0.14), (0.92, 0.05, 0.12)],
        "beckon": [(0.75, 0.10, 0.00), (0.42, 0.08, 0.12), (0.75, 0.10, 0.02), (0.42, 0.08, 0.12)],
        "wide": [(0.30, 0.80, -0.05), (0.25, 0.90, 0.10), (0.30, 0.85, 0.0)],
        "raise": [(0.45, 0.35, 0.55), (0.20, 0.25, 0.90), (0.15, 0.25, 0.92)],
    }
    names = list(shapes)
    duration = n_frames / fps
    knots: list[list[tuple[float, Array]]] = [[(0.0, rest)], [(0.0, rest)]]
    clock, turn = 0.15, int(rng.integers(2))
    order = [names[k] for k in rng.permutation(len(names))]
    for n in range(50):
        if clock > duration:
            break
        name = order[n % len(order)]
        arms = (0, 1) if name == "wide" else (turn,)
        turn = 1 - turn
        pause = rng.uniform(0.42, 0.55)
        moments = clock + pause * (1.6 + np.arange(len(shapes[name])))
        for arm in arms:
            knots[arm].append((clock, rest))
            jitter = rng.normal(0, 0.03, size=(len(moments), 3))
            knots[arm] += [
                (float(m), np.array(w) + j) for m, w, j in zip(moments, shapes[name], jitter, strict=True)
            ]
            knots[arm].append((float(moments[-1] + 1.7 * pause), rest))
        # The next gesture, with the other arm, begins while this one ends.
        clock = float(moments[-1]) + (1.75 * pause if name == "wide" else 0.7 * pause)
    knots = [sorted(k, key=lambda item: item[0]) for k in knots]
    goals = [swing_round(k, n_frames, fps) * reach for k in knots]
    poles = [np.tile([-0.75, 0.55, -0.75], (n_frames, 1)) for _ in SIDES]
    solve_arms(figure, rotations, root, goals, poles)
    return Pose(root, rotations, np.ones((n_frames, 2), dtype=bool))
