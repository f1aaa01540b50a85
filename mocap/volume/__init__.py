"""Silhouettes to voxels: carving, surface, visibility and colour, components."""

from mocap.volume.carve import Carver, carve_bruteforce, default_min_views
from mocap.volume.colour import colour_hull, visible_views
from mocap.volume.components import connected_components
from mocap.volume.grid import choose_grid
from mocap.volume.residuals import SilhouetteResiduals, silhouette_residuals
from mocap.volume.surface import surface_map, surface_voxels

__all__ = [
    "Carver",
    "SilhouetteResiduals",
    "carve_bruteforce",
    "choose_grid",
    "colour_hull",
    "connected_components",
    "default_min_views",
    "silhouette_residuals",
    "surface_map",
    "surface_voxels",
    "visible_views",
]
