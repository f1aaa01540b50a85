"""What geometry says of a session's keypoints, for `mocap check`."""

from __future__ import annotations

from mocap.errors import MocapError
from mocap.io.session import Session
from mocap.io.session.reading import keypoints_of
from mocap.io.session.record import Finding
from mocap.pipeline.stages.keypoints import persons_of_keypoints

# Half a minute of a clip tells what is wrong with it, in some seconds.
_WITHIN = 900


def check_figures(session: Session) -> list[Finding]:
    """How many persons the keypoints show, and what is wrong with them: the same that a run says."""
    if not session.keypoint_sources:
        return []
    try:
        read = keypoints_of(session)
    except MocapError:
        return []  # said already
    persons, faults = persons_of_keypoints(session, read, session.frames[:_WITHIN])
    said = [
        Finding(
            "warning",
            fault.message,
            None if fault.camera is None else session.rig.names[fault.camera],
            fault.remedy,
        )
        for fault in faults
    ]
    if not persons and not said:
        return [Finding("warning", "no two cameras' keypoints agree on a person")]
    return [Finding("ok", f"persons of the keypoints: {len(persons)}"), *said]
