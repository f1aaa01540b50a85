"""Scores of lost limbs: how well a filter knows which limbs have data, lost ones found out, present ones left alone."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array, Mask
from mocap.data import VoxelGrid

_POINTS_PER_BONE = 9
_INNER = (0.1, 0.9)  # ends of a bone lie at joints, which the neighbour's flesh fills too


@dataclass(frozen=True)
class LimbScores:
    """Scores of "lost" over frames and limbs; None where nothing was, or was said to be, lost.

    n_lost : lost in truth.  n_said : said to be lost.  n_scored : judged at all.
    """

    precision: float | None
    recall: float | None
    f1: float | None
    n_lost: int
    n_said: int
    n_scored: int


def limb_scores(lost: Mask, said: Mask, is_scored: Mask | None = None) -> LimbScores:
    """Precision, recall and F1 of the statement that a limb is lost.

    lost, said : (T, K) bool, truth and statement.  is_scored : (T, K) bool, None = all; leave out limbs that are half
    there. Raises ValueError for shapes that differ.
    """
    scored = np.ones_like(lost) if is_scored is None else is_scored
    if not lost.shape == said.shape == scored.shape:
        raise ValueError(
            f"lost, said and is_scored have shapes {lost.shape}, {said.shape} and {scored.shape}"
        )
    hit = int((lost & said & scored).sum())
    n_lost, n_said = int((lost & scored).sum()), int((said & scored).sum())
    return LimbScores(
        precision=hit / n_said if n_said else None,
        recall=hit / n_lost if n_lost else None,
        f1=2 * hit / (n_lost + n_said) if n_lost + n_said else None,
        n_lost=n_lost,
        n_said=n_said,
        n_scored=int(scored.sum()),
    )


def share_in_hull(chain: Array, voxels: NDArray[np.integer], grid: VoxelGrid) -> float:
    """Share of a limb's true bones that lies in a hull: 1 = the limb has data, 0 = it is lost.

    chain : (J, 3) m, world, landmarks along the limb from the trunk outwards.  voxels : linear indices, any order.
    A bone is deep in its flesh, so that no body model is needed. NaN when a landmark is unknown.
    """
    if not np.isfinite(chain).all():
        return float("nan")
    along = np.linspace(*_INNER, _POINTS_PER_BONE)[:, None]
    points = np.concatenate([(1 - along) * a + along * b for a, b in itertools.pairwise(chain)])
    return float(np.isin(grid.voxels_of(points), voxels).mean())
