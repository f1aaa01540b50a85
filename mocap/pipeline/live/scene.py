"""The live 3D scene: what a live run finds, shown in the Rerun viewer on this machine."""

from __future__ import annotations

import math
import time

from mocap.io.session import Session
from mocap.pipeline.live.engine import FrameResult
from mocap.pipeline.scene_frames import body_parts
from mocap.view import SceneFrame
from mocap.view.viewer import PLACES, LiveViewer
from mocap.volume import choose_grid

# Bodies and voxels are shown so often, pictures less: to code these costs more than the rest.
_PERIOD_S, _PICTURES_S = 0.05, 0.25
_BOUNDS_STEP_M = 0.1

__all__ = ["PLACES", "LiveScene"]


class LiveScene:
    """A sink that shows results in the viewer, not more often than eyes need.

    where : as of `LiveViewer`.  url : of the page, None of a window.
    """

    def __init__(self, session: Session, where: str) -> None:
        room = choose_grid(session.rig, _BOUNDS_STEP_M, bounds_m=session.room_bounds_m)
        bounds_m = (room.origin.tolist(), room.upper.tolist())
        self._viewer, self._names = LiveViewer(session.rig, where, bounds_m=bounds_m), session.rig.names
        self.url = self._viewer.url
        self._shown_s = self._pictures_s = -math.inf

    def put(self, result: FrameResult) -> None:
        now_s = time.monotonic()
        if now_s - self._shown_s < _PERIOD_S:
            return
        self._shown_s = now_s
        pictures = None
        if now_s - self._pictures_s >= _PICTURES_S:
            self._pictures_s = now_s
            pictures = {n: p for n, p in zip(self._names, result.pictures, strict=True) if p is not None}
        followed = [(p.person, p.body, p.pose) for p in result.persons]
        known = [
            (person, body, pose) for person, body, pose in followed if body is not None and pose is not None
        ]
        self._viewer.put(
            SceneFrame(
                frame=result.frame,
                time_s=result.time_s,
                hull=result.hull,
                persons={person: pose.landmarks for person, _, pose in known},
                parts={person: body_parts(body, pose.state) for person, body, pose in known},
            ),
            pictures,
        )

    def close(self) -> None:
        self._viewer.close()
