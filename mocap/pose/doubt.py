"""Doubt: which frames of a person are worth looking at, judged without truth, most doubtful first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data import landmark_names
from mocap.pose.deviation import fallen_nats
from mocap.pose.method import DoubtSettings
from mocap.pose.result import PersonPoses

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Doubt:
    """Frames of one person that follow each other and are in doubt.

    worst : the most doubtful of them.  value : its doubt, 1 = as much as a whole limb that is 0.3 m off for sure.
    reasons : why, in words.
    """

    person: int
    frames: range
    worst: int
    value: float
    reasons: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Reason:
    """One reason for doubt.  value : (T,).  words : of a row."""

    value: Array
    names: tuple[str, ...]
    each: Array
    what: str


def doubts_of(poses: PersonPoses, fps: float, settings: DoubtSettings) -> list[Doubt]:
    """The doubtful frames of a person in stretches, most doubtful first.

    Doubt is the sum of what deviations, landmarks that nobody saw, jumps, and evidence that is far below the usual one
    say, each in units of its own limit.
    """
    if not len(poses.frames):
        return []
    reasons = _reasons(poses, fps, settings)
    total = np.sum([reason.value for reason in reasons], axis=0)
    is_in = total >= settings.least
    rows = np.flatnonzero(is_in)
    together = max(1, round(settings.together_s * fps))
    cuts = np.flatnonzero(np.diff(poses.frames[rows]) > together) + 1
    found = [_stretch(poses, own, total, reasons, settings) for own in np.split(rows, cuts) if len(own)]
    return sorted(found, key=lambda doubt: (-doubt.value, doubt.worst))


def doubts_of_all(persons: Sequence[PersonPoses], fps: float, settings: DoubtSettings) -> list[Doubt]:
    """The doubtful stretches of several persons, most doubtful first."""
    found = [doubt for poses in persons for doubt in doubts_of(poses, fps, settings)]
    return sorted(found, key=lambda doubt: (-doubt.value, doubt.person, doubt.worst))


def _stretch(
    poses: PersonPoses,
    rows: NDArray[np.int64],
    total: Array,
    reasons: Sequence[_Reason],
    numbers: DoubtSettings,
) -> Doubt:
    worst = int(rows[np.argmax(total[rows])])
    given = sorted((r for r in reasons if r.value[worst] >= numbers.told), key=lambda r: -r.value[worst])
    return Doubt(
        person=poses.person,
        frames=range(int(poses.frames[rows[0]]), int(poses.frames[rows[-1]]) + 1),
        worst=int(poses.frames[worst]),
        value=float(total[worst]),
        reasons=tuple(_told(r, worst) for r in given),
    )


def _told(reason: _Reason, row: int) -> str:
    """A reason in words, with the landmarks that it is most true of."""
    if not reason.names:
        return reason.what
    own = reason.each[row]
    order = [m for m in np.argsort(-own, kind="stable") if own[m] >= 0.5 * own.max() and own[m] > 0]
    names = ", ".join(reason.names[m].replace("_", " ") for m in order[:3])
    return f"{names}{' and others' if len(order) > 3 else ''} {reason.what}"


def _reasons(poses: PersonPoses, fps: float, numbers: DoubtSettings) -> list[_Reason]:
    names = landmark_names(poses.landmarks.shape[1])
    std = np.sqrt(np.trace(poses.landmark_covariance, axis1=2, axis2=3) / 3.0)
    unsure = np.maximum(std - numbers.usual_std_m, 0.0) / numbers.std_m
    unseen = (~poses.observed).astype(np.float64)
    is_blind = ~np.isfinite(poses.log_likelihood)
    unseen[is_blind] = 0.0
    jump = _jumps_m(poses, fps, numbers) / numbers.jump_m
    return [
        _Reason(unsure.max(axis=1), names, unsure, "uncertain"),
        _Reason(unseen.mean(axis=1) / numbers.unseen_share, names, unseen, "not observed"),
        _Reason(jump.max(axis=1), names, jump, "jumps"),
        _Reason(
            fallen_nats(poses.log_likelihood, numbers.usual_nats) / numbers.fallen_nats,
            (),
            np.zeros((len(poses.frames), 0)),
            "the pose explains what was seen badly",
        ),
        _Reason(is_blind * 1.0, (), np.zeros((len(poses.frames), 0)), "nothing was seen of the person"),
    ]


def _jumps_m(poses: PersonPoses, fps: float, numbers: DoubtSettings) -> Array:
    """By how much a landmark moves further to the next frame, or from the one before, than limbs do, (T, M) m."""
    out = np.zeros(poses.landmarks.shape[:2])
    moved = np.linalg.norm(np.diff(poses.landmarks, axis=0), axis=2)
    moved -= np.diff(poses.frames)[:, None] * numbers.fast_m_s / fps
    moved = np.maximum(moved, 0.0)
    out[1:] = moved
    out[:-1] = np.maximum(out[:-1], moved)
    return out
