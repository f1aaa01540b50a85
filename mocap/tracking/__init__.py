"""Who is where: blob features, the person verdict and the naive tracker with its track lifecycle."""

from mocap.tracking.features import PERSON_TREE, BlobFeatures, Split, blob_features, is_person
from mocap.tracking.naive import (
    Track,
    TrackerSettings,
    TrackerState,
    TrackInfo,
    track_clip,
    track_step,
    tracks_from_history,
)

__all__ = [
    "PERSON_TREE",
    "BlobFeatures",
    "Split",
    "Track",
    "TrackInfo",
    "TrackerSettings",
    "TrackerState",
    "blob_features",
    "is_person",
    "track_clip",
    "track_step",
    "tracks_from_history",
]
