"""Scores against the truth: points, angles, tracking, volume, uncertainty, and all of them at once."""

from mocap.metrics.angles import ANGLES, AngleScores, angle_scores, joint_angles
from mocap.metrics.evaluate import associate_persons, evaluate, length_unit
from mocap.metrics.limbs import LimbScores, limb_scores, share_in_hull
from mocap.metrics.points import (
    PointScores,
    epsilon_lilliefors,
    epsilon_qq,
    lost_wrist_percent,
    offset_corrected,
    pck_percent,
    point_errors,
    point_scores,
)
from mocap.metrics.polygons import corner_error
from mocap.metrics.tracking import TrackingScores, tracking_scores
from mocap.metrics.uncertainty import CoverageScores, coverage_scores
from mocap.metrics.volume import VolumeScores, sum_volume_scores, volume_scores

__all__ = [
    "ANGLES",
    "AngleScores",
    "CoverageScores",
    "LimbScores",
    "PointScores",
    "TrackingScores",
    "VolumeScores",
    "angle_scores",
    "associate_persons",
    "corner_error",
    "coverage_scores",
    "epsilon_lilliefors",
    "epsilon_qq",
    "evaluate",
    "joint_angles",
    "length_unit",
    "limb_scores",
    "lost_wrist_percent",
    "offset_corrected",
    "pck_percent",
    "point_errors",
    "point_scores",
    "share_in_hull",
    "sum_volume_scores",
    "tracking_scores",
    "volume_scores",
]
