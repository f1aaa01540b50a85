"""The 2D polygon world of XN and SW: objects, colour likelihood and error, apart from the product's rooms."""

from mocap.polygons.error import corner_error
from mocap.polygons.likelihood import PolygonLikelihoodSettings, PolygonProblem, random_walk_std
from mocap.polygons.tree import PolygonTree, corner_positions, star_tree

__all__ = [
    "PolygonLikelihoodSettings",
    "PolygonProblem",
    "PolygonTree",
    "corner_error",
    "corner_positions",
    "random_walk_std",
    "star_tree",
]
