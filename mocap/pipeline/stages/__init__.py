"""The stages on files: each reads the products of the one before from the store and writes its own."""

from mocap.pipeline.stages.carve import carve_report, carve_stage, hull_from_arrays, stored_grid
from mocap.pipeline.stages.markers import (
    check_marker_config,
    detect_report,
    detect_stage,
    detections_at,
    marker_inputs,
    marker_pose_stage,
    observation_kind,
    stored_detections,
)
from mocap.pipeline.stages.pose import body_files, estimate_poses, pose_stage, stored_poses
from mocap.pipeline.stages.report import Progress, StageReport
from mocap.pipeline.stages.segment import masks_from_arrays, read_masks, segment_report, segment_stage
from mocap.pipeline.stages.track import stored_tracks, track_stage

__all__ = [
    "Progress",
    "StageReport",
    "body_files",
    "carve_report",
    "carve_stage",
    "check_marker_config",
    "detect_report",
    "detect_stage",
    "detections_at",
    "estimate_poses",
    "hull_from_arrays",
    "marker_inputs",
    "marker_pose_stage",
    "masks_from_arrays",
    "observation_kind",
    "pose_stage",
    "read_masks",
    "segment_report",
    "segment_stage",
    "stored_detections",
    "stored_grid",
    "stored_poses",
    "stored_tracks",
    "track_stage",
]
