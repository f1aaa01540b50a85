"""Measures of estimates against the truth: points, angles, tracking, volume, uncertainty; and their catalogue."""

from mocap.metrics.alignment import procrustes_aligned, root_aligned
from mocap.metrics.angles import ANGLES, AngleScores, angle_differences, angle_scores, joint_angles
from mocap.metrics.image import image_scores
from mocap.metrics.limbs import LimbScores, limb_scores, share_in_hull
from mocap.metrics.points import (
    EpsilonSearch,
    PointScores,
    QuantileLine,
    epsilon_lilliefors,
    epsilon_qq,
    epsilon_search,
    landmark_offsets,
    lost_wrist_percent,
    offset_corrected,
    pck_auc_percent,
    pck_percent,
    point_errors,
    point_scores,
    quantile_line,
    with_offsets,
)
from mocap.metrics.reference import ReferenceFit, fit_reference_skeleton
from mocap.metrics.smoothness import SmoothnessScores, smoothness_scores
from mocap.metrics.tracking import IdentityScores, TrackingScores, identity_scores, tracking_scores
from mocap.metrics.uncertainty import (
    CoverageScores,
    Reliability,
    SilentErrors,
    coverage_scores,
    reliability,
    silent_errors,
)
from mocap.metrics.volume import VolumeScores, sum_volume_scores, volume_scores

__all__ = [
    "ANGLES",
    "AngleScores",
    "CoverageScores",
    "EpsilonSearch",
    "IdentityScores",
    "LimbScores",
    "PointScores",
    "QuantileLine",
    "ReferenceFit",
    "Reliability",
    "SilentErrors",
    "SmoothnessScores",
    "TrackingScores",
    "VolumeScores",
    "angle_differences",
    "angle_scores",
    "coverage_scores",
    "epsilon_lilliefors",
    "epsilon_qq",
    "epsilon_search",
    "fit_reference_skeleton",
    "identity_scores",
    "image_scores",
    "joint_angles",
    "landmark_offsets",
    "limb_scores",
    "lost_wrist_percent",
    "offset_corrected",
    "pck_auc_percent",
    "pck_percent",
    "point_errors",
    "point_scores",
    "procrustes_aligned",
    "quantile_line",
    "reliability",
    "root_aligned",
    "share_in_hull",
    "silent_errors",
    "smoothness_scores",
    "sum_volume_scores",
    "tracking_scores",
    "volume_scores",
    "with_offsets",
]
