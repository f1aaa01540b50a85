"""The flesh of a body as one smooth surface that moves with its joints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.body.flesh import cone_distances
from mocap.body.kinematics import joint_transforms
from mocap.body.model import Body
from mocap.data.skin import Skin
from mocap.geometry.surface_nets import surface_nets

# Side of the lattice on which the surface is sampled: a wrist has four cells across.
_CELL_M = 0.018
# Over so much neighbouring cones melt into each other; larger values fatten where cones overlap.
_MELT_M = 0.008
# Standard deviation of a joint's pull on the skin: bends are spread over some two of it.
_PULL_M = 0.035
_N_PULLS = 4


def body_skin(body: Body) -> Skin:
    """The body's cones at rest, melted into one surface, each vertex pulled by the joints whose flesh is near.

    A vertex between two parts belongs to both by exp(-d^2 / 2 s^2) of its distance to their flesh.
    """
    R, t = joint_transforms(body, np.zeros((1, body.layout.n_columns)))
    cones = body.cones
    ends = [
        np.einsum("krc,kc->kr", R[0, cones.joint], e) + t[0, cones.joint] for e in (cones.start, cones.end)
    ]
    spare = 4 * _CELL_M
    lower = (np.minimum(*ends) - cones.radii.max(axis=1)[:, None]).min(axis=0) - spare
    upper = (np.maximum(*ends) + cones.radii.max(axis=1)[:, None]).max(axis=0) + spare
    shape = np.ceil((upper - lower) / _CELL_M).astype(int) + 1
    # Smooth minimum of the distances, d = -m log(sum of exp(-d_k / m)); far from a cone its term is nothing.
    terms = np.zeros(shape)
    for start, end, radii in zip(*ends, cones.radii, strict=True):
        reach = radii.max() + spare
        first = np.floor((np.minimum(start, end) - reach - lower) / _CELL_M).astype(int).clip(0)
        last = np.ceil((np.maximum(start, end) + reach - lower) / _CELL_M).astype(int) + 1
        box = tuple(slice(a, b) for a, b in zip(first, np.minimum(last, shape), strict=True))
        places = np.moveaxis(np.mgrid[box], 0, -1) * _CELL_M + lower
        d = cone_distances(places.reshape(-1, 3), start[None], end[None], radii[None], round_ends=True)
        terms[box] += np.exp(-d.reshape(places.shape[:3]) / _MELT_M)
    field = -_MELT_M * np.log(np.maximum(terms, np.exp(-spare / _MELT_M)))
    vertices, faces = surface_nets(field, lower, _CELL_M)
    distances = cone_distances(vertices, ends[0], ends[1], cones.radii, round_ends=True)
    joints, weights = _pulls(distances, cones.joint)
    return Skin(vertices, _normals(vertices, faces), faces, joints, weights)


def _pulls(distances: Array, joint: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
    """The joints that pull each vertex the most and their shares, from its distances to the cones (V, K) m."""
    by_joint = np.stack([distances[:, joint == j].min(axis=1) for j in np.unique(joint)], axis=1)
    outside = np.maximum(by_joint, 0.0)
    # Inside several parts the deeper one holds the vertex.
    pull = np.exp(-0.5 * (outside / _PULL_M) ** 2 - by_joint / _PULL_M)
    best = np.argsort(-pull, axis=1, kind="stable")[:, :_N_PULLS]
    weights = np.take_along_axis(pull, best, axis=1)
    return np.unique(joint)[best], weights / weights.sum(axis=1, keepdims=True)


def _normals(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """Of every vertex: the mean of its faces by their areas, unit length."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    by_face = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], by_face)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))
