"""Repair: limbs that jump from one frame to the next, alone or both legs, carried over from the side that was right.

The filter finds a lost limb again sooner or later, and it may lose one between two frames; what it knew on one side of
such a jump is carried to the other, frame by frame, for as long as the evidence gains by it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, landmarks_of
from mocap.pose.evidence import FrameEvidence
from mocap.pose.limbs import Limb, arms_of, legs_of, limbs_with_landmarks
from mocap.pose.method import RepairSettings

Array = NDArray[np.float64]
EvidenceOf = Callable[[int], FrameEvidence | None]


def repair_limbs(
    body: Body, states: Array, fps: float, evidence_of: EvidenceOf, settings: RepairSettings
) -> dict[int, Array]:
    """New states by row for the frames in which a limb is carried over from the other side of a jump.

    states : (T, D), consecutive frames.  evidence_of : row -> what poses are judged by there, or None where nothing is
    seen.
    """
    watched = _watched(body, settings, fps)
    groups = [group for group, _ in watched]
    found: dict[int, Array] = {}
    current = states.copy()
    for step in (-1, 1):
        rows = np.arange(len(states) - 1, 0, -1) if step < 0 else np.arange(len(states) - 1)
        gaps = np.zeros((len(groups), len(states)))
        gaps[:, rows] = _gaps(body, current[rows], current[rows + step], groups)
        for row in rows.tolist():
            for k, (group, limit_m) in enumerate(watched):
                if gaps[k, row] < limit_m:
                    continue
                for at, state in carried(body, current, row, step, group, evidence_of, settings):
                    current[at] = found[at] = state
                    beside = rows[(rows == at) | (rows == at - step)]
                    gaps[:, beside] = _gaps(body, current[beside], current[beside + step], groups)
    return found


def _watched(body: Body, settings: RepairSettings, fps: float) -> list[tuple[Sequence[Limb], float]]:
    """Limbs that may jump, some of them together, each with how far it moves in a frame at most, m."""
    legs, arms = legs_of(body), arms_of(body, with_hands=False) or ()
    others = [
        limb for limb in limbs_with_landmarks(body) if all(limb.columns[0] != arm.columns[0] for arm in arms)
    ]
    # Legs that have changed places come back together or not at all.
    swinging: list[Sequence[Limb]] = [*([legs] if legs else []), *((limb,) for limb in others)]
    # A foot swings, and its toes swing further; elbows and wrists seldom are as fast, and are lost most often.
    fast_m = settings.fast_m_s / fps
    return [*((group, settings.jump_m + fast_m) for group in swinging), *(((arm,), fast_m) for arm in arms)]


def carried(
    body: Body,
    states: Array,
    row: int,
    step: int,
    group: Sequence[Limb],
    evidence_of: EvidenceOf,
    settings: RepairSettings,
) -> list[tuple[int, Array]]:
    """The limbs of a row carried in the direction of step: the new states of the frames that gain by it."""
    chain: list[tuple[int, Array]] = []
    source, columns = states[row], np.concatenate([limb.columns for limb in group])
    gain, best, n_best = 0.0, 0.0, 0
    at = row + step
    while 0 <= at < len(states):
        evidence = evidence_of(at)
        if evidence is None:
            break
        mixed = states[at].copy()
        mixed[columns] = source[columns]
        candidate = evidence.all_refined([mixed], settings.n_iterations)[0]
        new, old = evidence.evidence([candidate, states[at]])
        gain += float(np.clip(new - old, -settings.largest_nats, settings.largest_nats))
        is_joined = bool(
            (
                _gaps(body, candidate[None], states[at, None], [[limb] for limb in group]) < settings.same_m
            ).all()
        )
        if is_joined:
            gain += settings.joined_nats
        chain.append((at, candidate))
        if gain > best:
            best, n_best = gain, len(chain)
        if is_joined or gain < best - settings.give_up_nats:
            break
        source = candidate
        at += step
    return chain[:n_best]


def _gaps(body: Body, a: Array, b: Array, groups: Sequence[Sequence[Limb]]) -> Array:
    """How far the limbs of each group lie apart in pairs of poses (N, D), on the body of the second, (G, N) m: the
    largest distance between landmarks, of the limb that lies least apart."""
    places = landmarks_of(body, b)
    out = np.full((len(groups), len(a)), np.inf)
    for own, group in zip(out, groups, strict=True):
        for limb in group:
            mixed = b.copy()
            mixed[:, limb.columns] = a[:, limb.columns]
            apart = (landmarks_of(body, mixed) - places)[:, limb.landmarks]
            np.minimum(own, np.linalg.norm(apart, axis=2).max(axis=1), out=own)
    return out
