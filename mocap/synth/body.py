"""A smooth skinned human body: blended profiles over the skeleton, polygonised once, skinned to it.

The flesh is an implicit surface: elliptic (superelliptic) sections with free profiles along each segment plus
muscle ellipsoids, joined by a smooth minimum. It shares no shape with the truncated cones of the filter's body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, diags

from mocap.geometry.surface_nets import surface_nets
from mocap.synth.figure import JOINT, JOINTS, SIDES, Figure, forward_kinematics, rotation_about
from mocap.synth.flesh import Part, flesh_of

Array = NDArray[np.float64]

_BLEND_M = 0.011  # scale of the smooth minimum
_MEMBERSHIP_M = 0.018  # reach of a primitive's claim on the skinning weights
_FAR_M = 0.09  # beyond this distance from its box a primitive is not evaluated
_N_BONES = 4  # largest number of bones per vertex
_MODEL_ARM_RAD = np.deg2rad(48.0)  # limbs are modelled spread, so that they do not grow together
_MODEL_LEG_RAD = np.deg2rad(9.0)


@dataclass(frozen=True, eq=False)
class Body:
    """A person's rest mesh with skinning.

    vertices : (V, 3) m, modelling pose, pelvis at the origin.  faces : (F, 3), outward.  weights : (V, J).
    normals : (V, 3) unit.
    rest_position : (J, 3) m, rest_rotation : (J, 3, 3), joints of the modelling pose.
    parts : the primitives of which the surface was blended; the first is the trunk.
    """

    figure: Figure
    vertices: Array
    faces: NDArray[np.int64]
    normals: Array
    weights: Array
    rest_position: Array
    rest_rotation: Array
    parts: tuple[Part, ...]

    def pose(self, position: Array, rotation: Array) -> tuple[Array, Array]:
        """Posed vertices and unit normals, each (V, 3), by linear blend skinning.

        position : (J, 3) m, rotation : (J, 3, 3), world, one frame of forward kinematics.
        """
        relative = rotation @ self.rest_rotation.transpose(0, 2, 1)
        shift = position - np.einsum("jab,jb->ja", relative, self.rest_position)
        blended = self.weights @ np.concatenate([relative.reshape(-1, 9), shift], axis=1)
        R = blended[:, :9].reshape(-1, 3, 3)
        vertices = np.einsum("vab,vb->va", R, self.vertices) + blended[:, 9:]
        normals = np.einsum("vab,vb->va", R, self.normals)
        return vertices, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)


def rest_rotations() -> Array:
    """Local rotations (1, J, 3, 3) of the modelling pose: arms and legs spread."""
    rotations = np.tile(np.eye(3), (1, len(JOINTS), 1, 1))
    for side, sign in SIDES:
        rotations[0, JOINT[f"{side}_shoulder"]] = rotation_about(0, sign * _MODEL_ARM_RAD)
        rotations[0, JOINT[f"{side}_hip"]] = rotation_about(0, sign * _MODEL_LEG_RAD)
    return rotations


def build_body(figure: Figure, *, cell_m: float = 0.019) -> Body:
    """The skinned mesh of a figure; figure.head_top is moved onto the surface.

    cell_m : polygonising cell. Raises RuntimeError if the mesh is not closed (a defect of the shape).
    """
    rest_position, rest_rotation = forward_kinematics(figure.offsets, rest_rotations(), np.zeros((1, 3)))
    parts = flesh_of(figure, rest_position[0], rest_rotation[0])
    boxes = [part.box() for part in parts]
    margin = 0.05
    low = np.min([b[0] for b in boxes], axis=0) - margin
    high = np.max([b[1] for b in boxes], axis=0) + margin
    shape = np.ceil((high - low) / cell_m).astype(int) + 1
    axes = [low[k] + cell_m * np.arange(shape[k]) for k in range(3)]
    mixture = np.zeros(tuple(shape))
    for part, (lower, upper) in zip(parts, boxes, strict=True):
        reach = 0.6 * _FAR_M
        window = tuple(
            slice(
                int(np.searchsorted(axes[k], lower[k] - reach)),
                int(np.searchsorted(axes[k], upper[k] + reach)),
            )
            for k in range(3)
        )
        grid = np.stack(np.meshgrid(*[axes[k][window[k]] for k in range(3)], indexing="ij"), axis=-1)
        d = part.distance(grid.reshape(-1, 3)).reshape(grid.shape[:-1])
        mixture[window] += np.exp(-np.clip(d, -0.25, _FAR_M) / _BLEND_M)
    with np.errstate(divide="ignore"):
        field = np.where(mixture > 0, -_BLEND_M * np.log(mixture), _FAR_M)
    vertices, faces = surface_nets(np.minimum(field, _FAR_M), low, cell_m)
    vertices, faces = _largest_component(vertices, faces)
    _check_closed(faces)
    vertices = _relax(vertices, faces)
    for _ in range(4):
        value, gradient = _field(parts, boxes, vertices)
        step = value[:, None] * gradient / np.maximum(np.sum(gradient**2, axis=1, keepdims=True), 0.25)
        vertices = vertices - np.clip(step, -0.6 * cell_m, 0.6 * cell_m)
    _, gradient = _field(parts, boxes, vertices)
    normals = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    weights = _skin(parts, boxes, vertices, faces)
    head = JOINT["head"]
    on_axis = vertices[np.hypot(vertices[:, 0] - rest_position[0, head, 0], vertices[:, 1]) < 0.06]
    top = float(on_axis[:, 2].max()) - rest_position[0, head, 2]
    figure = replace(figure, head_top=np.array([figure.head_top[0], 0.0, top]))
    return Body(figure, vertices, faces, normals, weights, rest_position[0], rest_rotation[0], tuple(parts))


def mesh_volume_and_centroid(vertices: Array, faces: NDArray[np.int64]) -> tuple[float, Array]:
    """Volume (m^3) and centroid (3,) m of a closed mesh by the divergence theorem."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    sixth = np.einsum("ij,ij->i", a, np.cross(b, c))
    centroid = ((a + b + c) * sixth[:, None]).sum(axis=0) / (4 * sixth.sum())
    return float(sixth.sum() / 6), centroid


def trunk_depth(body: Body, position: Array, rotation: Array) -> float:
    """How deep forearms and hands of a posed body reach into its trunk, m; 0 when they stay outside.

    position : (J, 3) m, rotation : (J, 3, 3), world.
    """
    vertices, _ = body.pose(position, rotation)
    bone = body.weights.argmax(axis=1)
    arms = [JOINT[f"{side}_{joint}"] for side, _ in SIDES for joint in ("elbow", "wrist")]
    points = vertices[np.isin(bone, arms)]
    outside = np.full(len(points), -np.inf)
    for name in ("pelvis", "spine", "chest"):
        # The trunk bends; a point is inside where it is for every one of its bones.
        j = JOINT[name]
        rest = (points - position[j]) @ rotation[j] @ body.rest_rotation[j].T + body.rest_position[j]
        outside = np.maximum(outside, body.parts[0].distance(rest))
    return max(0.0, -float(outside.min()))


def _field(parts: list[Part], boxes: list[tuple[Array, Array]], points: Array) -> tuple[Array, Array]:
    """Value (N,) and gradient (N, 3) of the blended field at points near the surface."""
    h = 5e-4
    probes = np.concatenate([points] + [points + s * h * np.eye(3)[k] for k in range(3) for s in (1, -1)])
    mixture = np.zeros(len(probes))
    for part, (low, high) in zip(parts, boxes, strict=True):
        near = np.all((probes > low - _FAR_M) & (probes < high + _FAR_M), axis=1)
        mixture[near] += np.exp(-np.clip(part.distance(probes[near]), -0.25, 2 * _FAR_M) / _BLEND_M)
    value = (-_BLEND_M * np.log(np.maximum(mixture, 1e-30))).reshape(7, -1)
    return value[0], np.stack([value[1 + 2 * k] - value[2 + 2 * k] for k in range(3)], axis=1) / (2 * h)


def _skin(
    parts: list[Part], boxes: list[tuple[Array, Array]], vertices: Array, faces: NDArray[np.int64]
) -> Array:
    weights = np.zeros((len(vertices), len(JOINTS)))
    for part, (low, high) in zip(parts, boxes, strict=True):
        near = np.all((vertices > low - _FAR_M) & (vertices < high + _FAR_M), axis=1)
        claim = np.exp(-np.clip(part.distance(vertices[near]), -0.1, _FAR_M) / _MEMBERSHIP_M)
        weights[near] += claim[:, None] * part.bone_weights(vertices[near])
    weights /= weights.sum(axis=1, keepdims=True)
    average = _neighbour_average(len(vertices), faces)
    for _ in range(8):
        weights = 0.5 * weights + 0.5 * (average @ weights)
    smallest = np.sort(weights, axis=1)[:, -_N_BONES][:, None]
    weights = np.where((weights >= smallest) & (weights > 0.01), weights, 0.0)
    return weights / weights.sum(axis=1, keepdims=True)


def _neighbour_average(n: int, faces: NDArray[np.int64]) -> coo_matrix:
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = np.unique(np.concatenate([edges, edges[:, ::-1]]), axis=0)
    adjacency = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n)).tocsr()
    return diags(1.0 / np.asarray(adjacency.sum(axis=1)).ravel()) @ adjacency


def _relax(vertices: Array, faces: NDArray[np.int64]) -> Array:
    average = _neighbour_average(len(vertices), faces)
    for _ in range(3):
        vertices = 0.4 * vertices + 0.6 * (average @ vertices)
    return vertices


def _largest_component(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(len(faces)), (faces[:, 0], faces[:, 1])), shape=(len(vertices),) * 2)
    graph = graph + coo_matrix((np.ones(len(faces)), (faces[:, 1], faces[:, 2])), shape=graph.shape)
    _, label = connected_components(graph, directed=False)
    keep = label == np.bincount(label).argmax()
    renumber = np.cumsum(keep) - 1
    return vertices[keep], renumber[faces[keep[faces[:, 0]]]]


def _check_closed(faces: NDArray[np.int64]) -> None:
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    if np.any(count != 2):
        raise RuntimeError(
            f"the body's mesh is not closed: {int(np.sum(count != 2))} edges without two faces"
        )
