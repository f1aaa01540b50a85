"""What a session's files hold, on the clock of the session."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from mocap.data import Camera
from mocap.data.detections import Detections
from mocap.data.keypoints import Figures
from mocap.io.detections import read_detections
from mocap.io.keypoints import read_keypoints
from mocap.io.session.record import Session
from mocap.io.video import DepthReader, FrameReader, Image, MaskReader


def pictures_of(
    session: Session, frames: Sequence[int] | None = None, cameras: Sequence[str] | None = None
) -> FrameReader:
    """The pictures of all cameras, frame by frame; of all frames and cameras, or of some."""
    rig = session.rig if cameras is None else session.rig.subset(cameras)
    sources = {name: session.image_sources[name] for name in rig.names}
    return FrameReader(
        sources, rig, session.frames if frames is None else frames, clip_frames=session.clip_frames
    )


def masks_of(
    session: Session, frames: Sequence[int] | None = None, cameras: Sequence[str] | None = None
) -> MaskReader:
    """The masks of all cameras, frame by frame; of all frames and cameras, or of some."""
    rig = session.rig if cameras is None else session.rig.subset(cameras)
    chosen = session.frames if frames is None else frames
    return MaskReader(session.mask_sources, rig, chosen, clip_frames=session.clip_frames)


def depth_of(session: Session, frames: Sequence[int] | None = None) -> DepthReader:
    """The depth maps of the cameras that have some, frame by frame, in the order of the rig; of all frames or some."""
    rig = session.rig.subset(list(session.depth_sources))
    chosen = session.frames if frames is None else frames
    return DepthReader(session.depth_sources, rig, chosen, session.depth, clip_frames=session.clip_frames)


def clip_of(session: Session, camera: Camera) -> Iterator[Image]:
    """The pictures of one camera, one for every frame of the session."""
    with pictures_of(session, cameras=(camera.name,)) as reader:
        for _, (picture,) in reader:
            yield picture


def detections_of(session: Session) -> Detections:
    """The detections of markers, by frame of the session."""
    return read_detections(session.detection_sources, session.rig, session.frames, session.clip_frames)


def keypoints_of(session: Session) -> dict[int, Figures]:
    """The figures of all cameras, by frame of the session."""
    return read_keypoints(session.keypoint_sources, session.rig, session.frames, session.clip_frames)
