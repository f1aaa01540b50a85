"""The chains of stages that a run can take: through volumes, or through markers."""

from __future__ import annotations

from mocap.errors import MocapError
from mocap.io.detections import LABELS_FILE
from mocap.io.session import Session
from mocap.pipeline.config import Config
from mocap.pipeline.stage import Stage
from mocap.pipeline.stages.carve import CARVE
from mocap.pipeline.stages.detect import DETECT, labels_path
from mocap.pipeline.stages.markers import MARKER_POSE
from mocap.pipeline.stages.occluders import OCCLUDERS
from mocap.pipeline.stages.pose import POSE
from mocap.pipeline.stages.segment import SEGMENT
from mocap.pipeline.stages.track import TRACK

CHAINS: dict[str, tuple[Stage, ...]] = {
    "voxels": (SEGMENT, OCCLUDERS, CARVE, TRACK, POSE),
    "markers": (DETECT, MARKER_POSE),
}
# The words that say where a run ends; the last one is after all stages.
UNTIL = ("segment", "occluders", "carve", "track", "pose", "report")


def stages_until(kind: str, until: str) -> tuple[Stage, ...]:
    """The stages of a chain that a run goes through, in order.  until : one of UNTIL."""
    last = UNTIL.index(until)
    return tuple(stage for stage in CHAINS[kind] if UNTIL.index(stage.until) <= last)


def observation_kind(session: Session, config: Config) -> str:
    """`markers` or `voxels`: what the configuration asks for, or what the session offers.

    Raises MocapError when the session has nothing for what is asked for.
    """
    if config.observation == "voxels" or (config.observation == "auto" and not session.detection_sources):
        if not session.image_sources and not session.mask_sources:
            raise MocapError(
                "the session has marker detections alone: there is no volume to work on",
                path=session.root,
                remedy="use --observation markers, or add videos/, images/ or masks/",
            )
        return "voxels"
    if not session.detection_sources and not labels_path(session).exists():
        raise MocapError(
            "the session has neither marker detections nor labels to learn the markers' colour from",
            path=session.root,
            remedy=f"add detections/CAM.csv, or videos and {LABELS_FILE} (frame,camera,u_px,v_px)",
        )
    return "markers"
