"""Silhouettes to voxels: carving, surface, visibility and colour, components; and what masks say about cameras."""

from mocap.volume.camera_faults import (
    CameraFault,
    find_camera_faults,
    find_faults,
    find_late,
    find_misfits,
    usable_cameras,
)
from mocap.volume.carve import Carver, VoteVolume, carve_bruteforce, default_min_views, votes_bruteforce
from mocap.volume.coarsen import CoarseVoxels, coarsen
from mocap.volume.colour import colour_hull, visible_views
from mocap.volume.components import connected_components
from mocap.volume.consistency import ConsistencyMonitor, SilhouetteEvidence
from mocap.volume.floor import Floor, FloorPlaces
from mocap.volume.furniture import things_on_floor
from mocap.volume.grid import choose_grid, look_at_point
from mocap.volume.mesh import hull_mesh
from mocap.volume.occluders import OccluderLearner, learn_occluders, masks_by_cells, no_occluders
from mocap.volume.residuals import SilhouetteResiduals, silhouette_residuals
from mocap.volume.second_look import SecondLook
from mocap.volume.shade import Shade, darkest_shadow
from mocap.volume.surface import surface_map, surface_voxels
from mocap.volume.witness import Guess, Witness

__all__ = [
    "CameraFault",
    "Carver",
    "CoarseVoxels",
    "ConsistencyMonitor",
    "Floor",
    "FloorPlaces",
    "Guess",
    "OccluderLearner",
    "SecondLook",
    "Shade",
    "SilhouetteEvidence",
    "SilhouetteResiduals",
    "VoteVolume",
    "Witness",
    "carve_bruteforce",
    "choose_grid",
    "coarsen",
    "colour_hull",
    "connected_components",
    "darkest_shadow",
    "default_min_views",
    "find_camera_faults",
    "find_faults",
    "find_late",
    "find_misfits",
    "hull_mesh",
    "learn_occluders",
    "look_at_point",
    "masks_by_cells",
    "no_occluders",
    "silhouette_residuals",
    "surface_map",
    "surface_voxels",
    "things_on_floor",
    "usable_cameras",
    "visible_views",
    "votes_bruteforce",
]
