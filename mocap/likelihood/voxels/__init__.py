"""Voxel likelihood: flesh against the hull of one frame, exact and fast."""

from mocap.likelihood.voxels.exact import (
    PackedVolume,
    PartScores,
    VoxelLikelihoodSettings,
    factorised_log_likelihood,
    global_log_likelihood,
    part_scores,
    part_scores_numpy,
)
from mocap.likelihood.voxels.fast import fast_part_scores
from mocap.likelihood.voxels.problem import VoxelProblem

__all__ = [
    "PackedVolume",
    "PartScores",
    "VoxelLikelihoodSettings",
    "VoxelProblem",
    "factorised_log_likelihood",
    "fast_part_scores",
    "global_log_likelihood",
    "part_scores",
    "part_scores_numpy",
]
