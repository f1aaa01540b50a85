"""Keypoints of other tools: files of one camera, each format in a module, read to figures by frame."""

from mocap.io.keypoints.reading import count_frames, read_keypoints
from mocap.io.keypoints.table import write_keypoints_csv

__all__ = ["count_frames", "read_keypoints", "write_keypoints_csv"]
