"""Named points of foreign files as our landmarks: known skeletons, the map of a user, units and axes."""

from mocap.io.poses.maps import SideMap, read_map, skeletons_known
from mocap.io.poses.motions import Reading, read_motions

__all__ = ["Reading", "SideMap", "read_map", "read_motions", "skeletons_known"]
