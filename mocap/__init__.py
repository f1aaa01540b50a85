"""Calibrated multi-camera video to 3D human motion: volumes, particle filters, no neural weights.

The names below are imported when they are first used, so that `import mocap` takes no time.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOMES = {
    # containers
    "Camera": "mocap.data",
    "CameraRig": "mocap.data",
    "Hull": "mocap.data",
    "LANDMARKS": "mocap.data",
    "Motion": "mocap.data",
    "Tracks": "mocap.data",
    "VoxelGrid": "mocap.data",
    "MocapError": "mocap.errors",
    # input
    "FrameReader": "mocap.io.video",
    "MaskReader": "mocap.io.video",
    "check_session": "mocap.io.session",
    "iter_clip": "mocap.io.video",
    "open_session": "mocap.io.session",
    "read_calibration": "mocap.io.calibration",
    "read_landmarks_csv": "mocap.io.tables",
    # stages
    "Background": "mocap.foreground",
    "Segmenter": "mocap.foreground",
    "learn_background": "mocap.foreground",
    "Carver": "mocap.volume",
    "choose_grid": "mocap.volume",
    "colour_hull": "mocap.volume",
    "person_rays": "mocap.likelihood.colours",
    "sample_silhouettes": "mocap.foreground.pixels",
    "connected_components": "mocap.volume",
    "surface_voxels": "mocap.volume",
    "TrackerSettings": "mocap.tracking",
    "track_clip": "mocap.tracking",
    "tracker_input": "mocap.pipeline.tracking",
    "load_body_model": "mocap.body",
    "scale_body": "mocap.body",
    "landmarks_of": "mocap.body",
    "PersonHull": "mocap.pose.volume",
    "estimate_height": "mocap.pose.volume",
    "VolumeClip": "mocap.pose.person",
    "VolumeObservation": "mocap.pose.volume",
    "follow_person": "mocap.pose.person",
    "make_tools": "mocap.pipeline.pose_settings",
    "evaluate": "mocap.compare",
    # the whole
    "Config": "mocap.pipeline.config",
    "RunResult": "mocap.pipeline.record",
    "load_config": "mocap.pipeline.config",
    "run_session": "mocap.pipeline.run",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
