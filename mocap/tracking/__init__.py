"""Tracking: blob features, the person verdict, three trackers and the life of a track."""

from mocap.tracking.features import (
    PERSON_TREE,
    BlobFeatures,
    Split,
    blob_features,
    is_person,
    person_tree,
    read_person_tree,
)
from mocap.tracking.state import (
    TRACKERS,
    LostPerson,
    Track,
    TrackerSettings,
    TrackerState,
    TrackInfo,
    published_settings,
)
from mocap.tracking.step import slim, track_clip, track_step, tracks_from_history
from mocap.tracking.voxels import FrameVoxels

__all__ = [
    "PERSON_TREE",
    "TRACKERS",
    "BlobFeatures",
    "FrameVoxels",
    "LostPerson",
    "Split",
    "Track",
    "TrackInfo",
    "TrackerSettings",
    "TrackerState",
    "blob_features",
    "is_person",
    "person_tree",
    "published_settings",
    "read_person_tree",
    "slim",
    "track_clip",
    "track_step",
    "tracks_from_history",
]
