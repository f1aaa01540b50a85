"""Gait cycles: the angles of a walk from each strike of a foot to its next, on one scale, as laboratories read them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mocap.data import AngleSeries
from mocap.geometry.rigid import wrap_angle
from mocap.pose.steps import SIDES, Gait

Array = NDArray[np.float64]

PERCENT = np.arange(101.0)  # of a cycle: 0 = strike, 100 = the next strike of the same foot
_LEAST_WAY_M = 0.2  # of the pelvis in a cycle; who goes less far marches on the spot
# A cycle of the left foot holds the angles of the left leg and those of the middle; arms swing as well.
_OTHER_SIDE = {"left": "right_", "right": "left_"}


@dataclass(frozen=True, eq=False)
class GaitCycles:
    """The gait cycles of one foot, N of them, with A angles at every percent.

    names : of the angles of this side and of the middle.  rows : (N, 2) of both strikes.  off_percent : (N,) when the
    toe leaves the floor.  values : (N, A, 101) rad.  std : (N, A, 101) rad, of each value, NaN = unknown.
    observed : (A,) in which share of the frames of all cycles the angle was observed.
    """

    side: str
    names: tuple[str, ...]
    rows: NDArray[np.int64]
    off_percent: Array
    values: Array
    std: Array
    observed: Array

    def __len__(self) -> int:
        return len(self.rows)

    def mean(self, name: str) -> tuple[Array, Array, Array]:
        """One angle over all cycles, (101,) rad each: its mean, its standard deviation between the cycles (NaN of a
        single one), and the standard deviation that a single cycle has for what was measured."""
        a = self.names.index(name)
        values, std = self.values[:, a], self.std[:, a]
        between = values.std(axis=0, ddof=1) if len(values) > 1 else np.full(len(PERCENT), np.nan)
        return values.mean(axis=0), between, np.sqrt((std**2).mean(axis=0))


def cycles_of(gait: Gait, angles: AngleSeries, pelvis: Array | None = None) -> tuple[GaitCycles, ...]:
    """The gait cycles of both feet; none where nobody walks, or contacts are not told.

    angles : of the same frames as the gait.  A cycle goes from a strike to the next one of the same foot; between them
    the foot leaves the floor once and the other one strikes once. What the clip cuts off, and where a step was missed,
    is no cycle.
    pelvis : (T, 2) m, over the floor. With it `pelvis_rotation` counts from the way that the pelvis goes in the cycle,
    as laboratories have it, or from its mean where it stays; without it from +x of the world.
    """
    found = (_cycles(side, gait, angles, pelvis) for side in SIDES)
    return tuple(cycles for cycles in found if len(cycles))


def _cycles(side: str, gait: Gait, angles: AngleSeries, pelvis: Array | None) -> GaitCycles:
    own = [s for s in gait.stances if s.side == side and s.strike is not None]
    others = [s.strike for s in gait.stances if s.side != side and s.strike is not None]
    rows, offs = [], []
    for stance, following in pairwise(own):
        begin, off, end = stance.strike, stance.off, following.strike
        assert begin is not None
        assert end is not None
        is_unbroken = angles.frames[end] - angles.frames[begin] == end - begin
        if off is not None and is_unbroken and sum(begin < other < end for other in others) == 1:
            rows.append((begin, end))
            offs.append(100.0 * (off - begin) / (end - begin))
    names = [name for name in angles.names if not name.startswith(_OTHER_SIDE[side])]
    columns = [angles.names.index(name) for name in names]
    values = np.unwrap(angles.values[:, columns], axis=0)
    std = np.full(values.shape, np.nan) if angles.std is None else angles.std[:, columns]
    seen = np.ones(values.shape, dtype=bool) if angles.observed is None else angles.observed[:, columns]
    inside = (
        np.unique(np.concatenate([np.arange(a, b) for a, b in rows])) if rows else np.zeros(0, dtype=np.int64)
    )
    resampled = _resampled(values, rows)
    if pelvis is not None and "pelvis_rotation" in names:
        heading = resampled[:, names.index("pelvis_rotation")]
        for n, (begin, end) in enumerate(rows):
            way = pelvis[end] - pelvis[begin]
            ahead = np.arctan2(way[1], way[0]) if np.linalg.norm(way) >= _LEAST_WAY_M else heading[n].mean()
            turned = heading[n].mean() - ahead
            heading[n] += wrap_angle(turned) - heading[n].mean()
    return GaitCycles(
        side,
        tuple(names),
        np.array(rows, dtype=np.int64).reshape(-1, 2),
        np.array(offs, dtype=np.float64),
        resampled,
        _resampled(std, rows),
        seen[inside].mean(axis=0) if rows else np.zeros(len(names)),
    )


def _resampled(series: Array, rows: list[tuple[int, int]]) -> Array:
    """A series (T, A) at every percent of the spans from row to row, (N, A, 101)."""
    at = np.arange(len(series))
    out = np.empty((len(rows), series.shape[1], len(PERCENT)))
    for n, (begin, end) in enumerate(rows):
        when = begin + (end - begin) * PERCENT / 100.0
        for a in range(series.shape[1]):
            out[n, a] = np.interp(when, at, series[:, a])
    return out
