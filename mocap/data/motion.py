"""Landmarks and tracks over time: what comes out of the pipeline, and what truth is given as."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array

LANDMARKS: tuple[str, ...] = (
    "pelvis",
    "neck",
    "head",
    "left_shoulder",
    "left_elbow",
    "left_wrist",
    "right_shoulder",
    "right_elbow",
    "right_wrist",
    "left_hip",
    "left_knee",
    "left_ankle",
    "right_hip",
    "right_knee",
    "right_ankle",
)

# Landmarks of bodies that have feet and hands: they follow the fifteen in every array, and are scored apart from them.
# Heel and toe lie on the sole, below the back of the heel bone and at the tip of the great toe; the hand's tip is that
# of the middle finger.
FURTHER_LANDMARKS: tuple[str, ...] = (
    "left_heel",
    "left_toe",
    "left_hand_tip",
    "right_heel",
    "right_toe",
    "right_hand_tip",
)
ALL_LANDMARKS: tuple[str, ...] = (*LANDMARKS, *FURTHER_LANDMARKS)

# Bones of the stick figure, as pairs of landmark names.
BONES: tuple[tuple[str, str], ...] = (
    ("pelvis", "neck"),
    ("neck", "head"),
    ("neck", "left_shoulder"),
    ("left_shoulder", "left_elbow"),
    ("left_elbow", "left_wrist"),
    ("neck", "right_shoulder"),
    ("right_shoulder", "right_elbow"),
    ("right_elbow", "right_wrist"),
    ("pelvis", "left_hip"),
    ("left_hip", "left_knee"),
    ("left_knee", "left_ankle"),
    ("pelvis", "right_hip"),
    ("right_hip", "right_knee"),
    ("right_knee", "right_ankle"),
    ("left_ankle", "left_heel"),
    ("left_ankle", "left_toe"),
    ("left_heel", "left_toe"),
    ("left_wrist", "left_hand_tip"),
    ("right_ankle", "right_heel"),
    ("right_ankle", "right_toe"),
    ("right_heel", "right_toe"),
    ("right_wrist", "right_hand_tip"),
)


def landmark_names(n_landmarks: int) -> tuple[str, ...]:
    """Names of so many landmarks: the fifteen, or all with feet and hands.  Raises ValueError for another number."""
    if n_landmarks not in (len(LANDMARKS), len(ALL_LANDMARKS)):
        raise ValueError(
            f"{n_landmarks} landmarks, expected {len(LANDMARKS)}, or {len(ALL_LANDMARKS)} with feet and hands"
        )
    return ALL_LANDMARKS[:n_landmarks]


def bones_between(n_landmarks: int) -> list[tuple[int, int]]:
    """The bones of a stick figure of so many landmarks, as pairs of their columns."""
    names = landmark_names(n_landmarks)
    return [(names.index(a), names.index(b)) for a, b in BONES if a in names and b in names]


@dataclass(frozen=True, eq=False)
class Motion:
    """Landmarks of one person over time.

    frames : (T,) int64, ascending.  time_s : (T,).  landmarks : (T, M, 3) m, world, NaN = unknown; M is 15,
    in the order of LANDMARKS, or 21 with FURTHER_LANDMARKS after them.  std : (T, M, 3) m or None.  observed : (T, M)
    bool or None.
    """

    person: int
    frames: NDArray[np.int64]
    time_s: Array
    landmarks: Array
    std: Array | None = None
    observed: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        expected = (len(self.frames), len(LANDMARKS), 3)
        more = (len(self.frames), len(ALL_LANDMARKS), 3)
        if self.landmarks.shape not in (expected, more):
            raise ValueError(f"landmarks has shape {self.landmarks.shape}, expected {expected} or {more}")

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def names(self) -> tuple[str, ...]:
        """The landmarks in the order of their columns, (M,)."""
        return landmark_names(self.landmarks.shape[1])


_SAME_INSTANT = 0.05  # of the time between two frames: times in files are rounded


def at_times(motion: Motion, frames: NDArray[np.int64], times: Array, fps: float) -> Motion:
    """A motion read at other times, linearly between neighbours that are both known, and numbered by other frames.

    frames (K,), times (K,) s, ascending.  fps : of the motion. Times in a hole of it, before its first frame or after
    its last one are left out. A motion of fewer than two frames has none.
    """
    if len(motion) < 2:
        return Motion(motion.person, frames[:0], times[:0], motion.landmarks[:0])
    step = 1.0 / fps
    after = np.clip(np.searchsorted(motion.time_s, times, side="left"), 1, len(motion) - 1)
    before = after - 1
    gap = motion.time_s[after] - motion.time_s[before]
    share = (times - motion.time_s[before]) / gap
    # A frame at this very instant needs no neighbour; a hole in the recording, or its end, stays one.
    snap = np.abs(share - share.round()) * gap < _SAME_INSTANT * step
    share = np.where(snap, share.round(), share)
    usable = (share >= 0.0) & (share <= 1.0) & (snap | (gap < 1.5 * step))
    low, high, weight = before[usable], after[usable], share[usable]
    std = None if motion.std is None else _between(motion.std[low], motion.std[high], weight)
    landmarks = _between(motion.landmarks[low], motion.landmarks[high], weight)
    return Motion(motion.person, frames[usable], times[usable], landmarks, std)


def _between(low: Array, high: Array, share: Array) -> Array:
    """(T, M, 3) between two frames; a neighbour of weight zero counts for nothing even where it is unknown."""
    share = share[:, None, None]
    return np.where(share == 0.0, low, np.where(share == 1.0, high, (1 - share) * low + share * high))


@dataclass(frozen=True, eq=False)
class Tracks:
    """Positions of persons over time as one table, rows sorted by frame, then person.

    frame : (M,) int64.  person : (M,) int64.  time_s : (M,).  xyz : (M, 3) m, world, volume centroid.
    covariance : (M, 3, 3) m^2, of xyz; None where unknown, as in a truth.
    observed : (M,) bool, false where a person was out of sight and xyz is interpolated; None where unknown.
    """

    frame: NDArray[np.int64]
    person: NDArray[np.int64]
    time_s: Array
    xyz: Array
    covariance: Array | None = None
    observed: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        n = len(self.frame)
        for name, shape in (("covariance", (n, 3, 3)), ("observed", (n,))):
            value = getattr(self, name)
            if value is not None and np.shape(value) != shape:
                raise ValueError(f"{name} has shape {np.shape(value)}, expected {shape}")

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def persons(self) -> tuple[int, ...]:
        return tuple(int(p) for p in np.unique(self.person))

    def rows(self, rows: NDArray[Any]) -> Tracks:
        """Some of the rows, as indices (K,) or as (M,) bool."""
        return Tracks(
            self.frame[rows],
            self.person[rows],
            self.time_s[rows],
            self.xyz[rows],
            None if self.covariance is None else self.covariance[rows],
            None if self.observed is None else self.observed[rows],
        )

    def of(self, *persons: int) -> Tracks:
        """The rows of one person, or of several."""
        return self.rows(np.isin(self.person, persons))

    def paths(self, person: int) -> list[Tracks]:
        """The rows of one person in pieces without missing frames: one for each time that he was there."""
        own = self.of(person)
        cuts = np.flatnonzero(np.diff(own.frame) > 1) + 1
        return [own.rows(rows) for rows in np.split(np.arange(len(own)), cuts) if len(rows)]

    @property
    def std(self) -> Array | None:
        """(M, 3) m, standard deviation of xyz along the world axes; None where unknown."""
        return None if self.covariance is None else np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
