"""The stages on files: each reads the products of the one before from the store and writes its own."""

from mocap.pipeline.stages.carve import carve_report, carve_stage, hull_from_arrays, stored_grid
from mocap.pipeline.stages.pose import estimate_poses, pose_stage, stored_poses
from mocap.pipeline.stages.report import Progress, StageReport
from mocap.pipeline.stages.segment import masks_from_arrays, read_masks, segment_report, segment_stage
from mocap.pipeline.stages.track import stored_tracks, track_stage

__all__ = [
    "Progress",
    "StageReport",
    "carve_report",
    "carve_stage",
    "estimate_poses",
    "hull_from_arrays",
    "masks_from_arrays",
    "pose_stage",
    "read_masks",
    "segment_report",
    "segment_stage",
    "stored_grid",
    "stored_poses",
    "stored_tracks",
    "track_stage",
]
