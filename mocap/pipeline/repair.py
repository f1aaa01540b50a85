"""Limbs that jump from one frame to the next: either side of the jump may be the right one.

The filter finds a lost limb again sooner or later, and it may lose one between two frames; what it knew on one side of
such a jump is carried to the other, frame by frame, for as long as the evidence gains by it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, landmarks_of
from mocap.data.problem import limbs_of
from mocap.pipeline.pose_problem import FrameProblem

Array = NDArray[np.float64]
FrameOf = Callable[[int], FrameProblem | None]

_JUMP_M = 0.15  # beyond what a limb may move in a frame
_FAST_M_S = 3.0
_SAME_M = 0.08
_JOINED_NATS = 6.0  # what it is worth that a jump vanishes
_GIVE_UP_NATS = 12.0
_LARGEST_NATS = 8.0  # of one frame, so that no single frame decides
_N_ITERATIONS = 8


def repair_limbs(body: Body, states: Array, fps: float, frame_of: FrameOf) -> dict[int, Array]:
    """New states by row for the frames in which a limb is carried over from the other side of a jump.

    states : (T, D), consecutive frames.  frame_of : row -> what poses are judged by there, or None where nothing is
    seen.
    """
    limbs = _limb_columns(body)
    found: dict[int, Array] = {}
    current = states.copy()
    for step in (-1, 1):
        rows = range(len(states) - 1, 0, -1) if step < 0 else range(len(states) - 1)
        for row in rows:
            for columns, landmarks in limbs:
                if (
                    _gap(body, current[row], current[row + step], columns, landmarks)
                    < _JUMP_M + _FAST_M_S / fps
                ):
                    continue
                for at, state in _carried(body, current, row, step, columns, landmarks, frame_of):
                    current[at] = found[at] = state
    return found


def _carried(
    body: Body,
    states: Array,
    row: int,
    step: int,
    columns: NDArray[np.int64],
    landmarks: NDArray[np.int64],
    frame_of: FrameOf,
) -> list[tuple[int, Array]]:
    """The limb of a row carried in the direction of step: the new states of the frames that gain by it."""
    chain: list[tuple[int, Array]] = []
    limb = states[row]
    gain, best, n_best = 0.0, 0.0, 0
    at = row + step
    while 0 <= at < len(states):
        frame = frame_of(at)
        if frame is None:
            break
        mixed = states[at].copy()
        mixed[columns] = limb[columns]
        candidate = frame.refined(mixed, _N_ITERATIONS)
        new, old = frame.evidence([candidate, states[at]])
        gain += float(np.clip(new - old, -_LARGEST_NATS, _LARGEST_NATS))
        is_joined = _gap(body, candidate, states[at], columns, landmarks) < _SAME_M
        if is_joined:
            gain += _JOINED_NATS
        chain.append((at, candidate))
        if gain > best:
            best, n_best = gain, len(chain)
        if is_joined or gain < best - _GIVE_UP_NATS:
            break
        limb = candidate
        at += step
    return chain[:n_best]


def _limb_columns(body: Body) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Columns and landmarks of each limb."""
    layout = body.layout
    part_of_joint = {int(j): int(p) for j, p in zip(body.cones.joint, body.cones.part, strict=True)}
    part_of_landmark = np.array([part_of_joint.get(int(j), 0) for j in body.landmark_joint])
    found = []
    for limb in limbs_of(layout):
        columns = np.flatnonzero(np.isin(layout.part_of_column, limb))
        landmarks = np.flatnonzero(np.isin(part_of_landmark, limb))
        if len(columns) and len(landmarks):
            found.append((columns, landmarks))
    return found


def _gap(body: Body, a: Array, b: Array, columns: NDArray[np.int64], landmarks: NDArray[np.int64]) -> float:
    """Largest distance between a limb's landmarks in two poses, on the body of the second, m."""
    mixed = b.copy()
    mixed[columns] = a[columns]
    both = landmarks_of(body, np.stack([mixed, b]))[:, landmarks]
    return float(np.linalg.norm(both[0] - both[1], axis=1).max())
