"""Volume scores: how well one set of voxels covers another."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class VolumeScores:
    """Overlap of two voxel sets as counts; the ratios are None where undefined (empty sets)."""

    n_estimate: int
    n_truth: int
    n_common: int

    @property
    def iou(self) -> float | None:
        """Common voxels over the union's."""
        union = self.n_estimate + self.n_truth - self.n_common
        return self.n_common / union if union else None

    @property
    def precision(self) -> float | None:
        """Share of the estimate that is true."""
        return self.n_common / self.n_estimate if self.n_estimate else None

    @property
    def recall(self) -> float | None:
        """Share of the truth that was found."""
        return self.n_common / self.n_truth if self.n_truth else None


def volume_scores(estimate: NDArray[np.integer], truth: NDArray[np.integer]) -> VolumeScores:
    """Overlap of two voxel sets of one grid, linear indices (N,) and (K,) in any order; empty is allowed."""
    a, b = np.unique(np.asarray(estimate)), np.unique(np.asarray(truth))
    return VolumeScores(len(a), len(b), len(np.intersect1d(a, b, assume_unique=True)))


def sum_volume_scores(scores: Iterable[VolumeScores]) -> VolumeScores:
    """Scores of a clip: counts are summed over frames, so that large frames weigh more."""
    rows = [(s.n_estimate, s.n_truth, s.n_common) for s in scores]
    n_estimate, n_truth, n_common = np.array(rows, dtype=np.int64).reshape(-1, 3).sum(axis=0)
    return VolumeScores(int(n_estimate), int(n_truth), int(n_common))
