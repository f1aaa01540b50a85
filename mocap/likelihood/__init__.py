"""How well a pose explains the data of a frame; all give per-part log-likelihoods."""

from mocap.likelihood.problem import VoxelProblem
from mocap.likelihood.surface import HullSurface, SurfaceFitSettings, SurfaceProblem, hull_surface
from mocap.likelihood.voxels import (
    PackedVolume,
    PartScores,
    VoxelLikelihoodSettings,
    factorised_log_likelihood,
    global_log_likelihood,
    part_scores,
    part_scores_numpy,
)

__all__ = [
    "HullSurface",
    "PackedVolume",
    "PartScores",
    "SurfaceFitSettings",
    "SurfaceProblem",
    "VoxelLikelihoodSettings",
    "VoxelProblem",
    "factorised_log_likelihood",
    "global_log_likelihood",
    "hull_surface",
    "part_scores",
    "part_scores_numpy",
]
