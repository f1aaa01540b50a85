"""Captured motion from BVH and ASF/AMC files on our figures."""

from __future__ import annotations

from mocap.synth.capture.asf_amc import read_amc
from mocap.synth.capture.bvh import read_bvh
from mocap.synth.capture.recording import Recording
from mocap.synth.capture.retarget import JointMap, built_in_maps, read_capture, read_map, retarget

__all__ = [
    "JointMap",
    "Recording",
    "built_in_maps",
    "read_amc",
    "read_bvh",
    "read_capture",
    "read_map",
    "retarget",
]
