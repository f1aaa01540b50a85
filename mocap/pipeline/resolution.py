"""Resolution: large pictures are reduced to what the voxels can use before anything looks at them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap.data import Camera, CameraRig
from mocap.io.session import Session
from mocap.pipeline.config import Config
from mocap.volume import look_at_point

_LEAST_SIDES_PX = (640, 360)  # longer and shorter side of the smallest picture that is made


def at_useful_size(session: Session, config: Config, kind: str) -> Session:
    """The session with its cameras reduced by whole factors, so that a voxel is still `segmentation.pixels_per_voxel`
    wide; as it is where points in the pictures are the evidence, markers or keypoints.
    """
    if kind != "voxels" or not config.segmentation.pixels_per_voxel:
        return session
    place = look_at_point(session.rig)

    def reduced(camera: Camera) -> Camera:
        distance_m = max(float(np.linalg.norm(camera.center - place)), 0.1)
        per_voxel = min(camera.K[0, 0], camera.K[1, 1]) * config.volume.voxel_size_m / distance_m
        sides = max(camera.size), min(camera.size)
        largest = min(side // least for side, least in zip(sides, _LEAST_SIDES_PX, strict=True))
        factor = min(int(per_voxel / config.segmentation.pixels_per_voxel), largest)
        return camera.reduced(factor) if factor > 1 else camera

    return replace(session, rig=CameraRig(tuple(reduced(camera) for camera in session.rig)))
