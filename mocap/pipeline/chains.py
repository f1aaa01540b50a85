"""The chains of stages that a run can take: through volumes, markers, or keypoints."""

from __future__ import annotations

from mocap.errors import MocapError
from mocap.io.detections import LABELS_FILE
from mocap.io.session import Session
from mocap.pipeline.config import Config
from mocap.pipeline.stage import Stage
from mocap.pipeline.stages.carve import CARVE
from mocap.pipeline.stages.detect import DETECT, labels_path
from mocap.pipeline.stages.fused_carve import FUSED_CARVE
from mocap.pipeline.stages.fused_pose import FUSED_POSE
from mocap.pipeline.stages.keypoint_pose import KEYPOINT_POSE
from mocap.pipeline.stages.keypoints import KEYPOINTS_STAGE
from mocap.pipeline.stages.markers import MARKER_POSE
from mocap.pipeline.stages.occluders import OCCLUDERS
from mocap.pipeline.stages.pose import POSE
from mocap.pipeline.stages.segment import SEGMENT
from mocap.pipeline.stages.track import TRACK

CHAINS: dict[str, tuple[Stage, ...]] = {
    "voxels": (SEGMENT, OCCLUDERS, CARVE, TRACK, POSE),
    "markers": (DETECT, MARKER_POSE),
    "keypoints": (KEYPOINTS_STAGE, KEYPOINT_POSE),
    "fused": (KEYPOINTS_STAGE, SEGMENT, OCCLUDERS, FUSED_CARVE, TRACK, FUSED_POSE),
}
# The chains that make a volume.
WITH_VOLUMES = ("voxels", "fused")
# The words that say where a run ends; the last one is after all stages.
UNTIL = ("segment", "occluders", "carve", "track", "pose", "report")


def stages_until(kind: str, until: str) -> tuple[Stage, ...]:
    """The stages of a chain that a run goes through, in order.  until : one of UNTIL."""
    last = UNTIL.index(until)
    return tuple(stage for stage in CHAINS[kind] if UNTIL.index(stage.until) <= last)


def observation_kind(session: Session, config: Config) -> str:
    """A chain of CHAINS: what the configuration asks for, or what the session offers.

    Raises MocapError when the session has nothing for what is asked for.
    """
    kind = config.observation if config.observation != "auto" else _offered(session)
    has_pictures = bool(session.image_sources or session.mask_sources)
    if kind in WITH_VOLUMES and not has_pictures:
        has = "marker detections" if session.detection_sources else "keypoints"
        raise MocapError(
            f"the session has {has} alone: there is no volume to work on",
            path=session.root,
            remedy=f"use --observation {has.split()[0].rstrip('s')}s, or add videos/, images/ or masks/",
        )
    if kind in ("keypoints", "fused") and not session.keypoint_sources:
        raise MocapError(
            "the session has no keypoints",
            path=session.root,
            remedy="add keypoints/CAM.csv, or keypoints/CAM/ with a JSON file for every picture (docs/keypoints.md)",
        )
    if kind == "markers" and not session.detection_sources and not labels_path(session).exists():
        raise MocapError(
            "the session has neither marker detections nor labels to learn the markers' colour from",
            path=session.root,
            remedy=f"add detections/CAM.csv, or videos and {LABELS_FILE} (frame,camera,u_px,v_px)",
        )
    return kind


def _offered(session: Session) -> str:
    """What poses are found from in a session when nobody says it."""
    if session.detection_sources:
        return "markers"
    is_keypoints = bool(session.keypoint_sources) and not session.image_sources and not session.mask_sources
    return "keypoints" if is_keypoints else "voxels"
