"""A smooth skinned human body: blended profiles over the skeleton, polygonised once, skinned to it.

The flesh is an implicit surface: elliptic (superelliptic) sections with free profiles along each segment plus
muscle ellipsoids, joined by a smooth minimum. It shares no shape with the truncated cones of the filter's body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.sparse import coo_matrix, diags

from data_synth.figure import JOINT, JOINTS, SIDES, SOLE_M, Figure, forward_kinematics, rotation_about
from data_synth.polygonise import surface_nets

Array = NDArray[np.float64]

_BLEND_M = 0.011  # scale of the smooth minimum
_MEMBERSHIP_M = 0.018  # reach of a primitive's claim on the skinning weights
_FAR_M = 0.09  # beyond this distance from its box a primitive is not evaluated
_N_BONES = 4  # largest number of bones per vertex
_MODEL_ARM_RAD = np.deg2rad(48.0)  # limbs are modelled spread, so that they do not grow together
_MODEL_LEG_RAD = np.deg2rad(9.0)


@dataclass(frozen=True, eq=False)
class _Part:
    """One blended primitive: an axis (local z) with elliptic sections, closed by ellipsoidal caps.

    z : (n,) m ascending.  half_x, half_y, center_x, center_y : (n,) m.  caps : lengths of the two caps, m.
    power : exponent of the superellipse.  bones, cuts, widths : the bones in the order of rising z; bone i
    hands over to bone i + 1 at cuts[i] within +- widths[i].  floor_z : nothing below this local z.
    """

    origin: Array
    R: Array
    z: Array
    half_x: Array
    half_y: Array
    center_x: Array
    center_y: Array
    caps: tuple[float, float]
    bones: tuple[int, ...]
    cuts: tuple[float, ...] = ()
    widths: tuple[float, ...] = ()
    power: float = 2.0
    floor_z: float | None = None

    def distance(self, points: Array) -> Array:
        """Approximate signed distance, (N,) m, negative inside."""
        local = (points - self.origin) @ self.R
        z = np.clip(local[:, 2], self.z[0], self.z[-1])
        over = local[:, 2] - z
        x = local[:, 0] - np.interp(z, self.z, self.center_x)
        y = local[:, 1] - np.interp(z, self.z, self.center_y)
        cap = np.where(over < 0, self.caps[0], self.caps[1])
        a, b = np.interp(z, self.z, self.half_x), np.interp(z, self.z, self.half_y)
        p = self.power
        k = (np.abs(x / a) ** p + np.abs(y / b) ** p + np.abs(over / cap) ** p) ** (1 / p)
        length = np.sqrt(x * x + y * y + over * over)
        small = np.minimum(np.minimum(a, b), np.where(over == 0, np.inf, cap))
        # Along the ray from the axis the surface is at length / k; on the axis itself the nearest wall counts.
        d = np.where(k > 0.3, length * (1 - 1 / np.maximum(k, 0.3)), (k - 1) * small)
        if self.floor_z is not None:
            d = np.maximum(d, self.floor_z - local[:, 2])
        return d

    def box(self) -> tuple[Array, Array]:
        """Corners of the axis-aligned box in model space that holds the part."""
        side = np.array([np.abs(self.center_x) + self.half_x, np.abs(self.center_y) + self.half_y]).max(
            axis=1
        )
        low = np.array([-side[0], -side[1], self.z[0] - self.caps[0]])
        high = np.array([side[0], side[1], self.z[-1] + self.caps[1]])
        corners = np.array([[(low, high)[i >> k & 1][k] for k in range(3)] for i in range(8)])
        world = corners @ self.R.T + self.origin
        return world.min(axis=0), world.max(axis=0)

    def bone_weights(self, points: Array) -> Array:
        """Weights of all joints for points of this part, (N, J), rows sum to 1."""
        z = ((points - self.origin) @ self.R)[:, 2]
        out = np.zeros((len(points), len(JOINTS)))
        rest = np.ones(len(points))
        for i, cut in enumerate(self.cuts):
            s = np.clip((z - cut) / (2 * self.widths[i]) + 0.5, 0, 1)
            s = s * s * (3 - 2 * s)
            out[:, self.bones[i]] += rest * (1 - s)
            rest = rest * s
        out[:, self.bones[-1]] += rest
        return out


@dataclass(frozen=True, eq=False)
class Body:
    """A person's rest mesh with skinning.

    vertices : (V, 3) m, modelling pose, pelvis at the origin.  faces : (F, 3), outward.  weights : (V, J).
    normals : (V, 3) unit.
    rest_position : (J, 3) m, rest_rotation : (J, 3, 3), joints of the modelling pose.
    """

    figure: Figure
    vertices: Array
    faces: NDArray[np.int64]
    normals: Array
    weights: Array
    rest_position: Array
    rest_rotation: Array

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
    parts = _flesh(figure, rest_position[0], rest_rotation[0])
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
    figure = Figure(
        figure.stature_m,
        figure.sex,
        figure.build,
        figure.offsets,
        figure.girth,
        np.array([figure.head_top[0], 0.0, top]),
    )
    return Body(figure, vertices, faces, normals, weights, rest_position[0], rest_rotation[0])


def mesh_volume_and_centroid(vertices: Array, faces: NDArray[np.int64]) -> tuple[float, Array]:
    """Volume (m^3) and centroid (3,) m of a closed mesh by the divergence theorem."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    sixth = np.einsum("ij,ij->i", a, np.cross(b, c))
    centroid = ((a + b + c) * sixth[:, None]).sum(axis=0) / (4 * sixth.sum())
    return float(sixth.sum() / 6), centroid


def _field(parts: list[_Part], boxes: list[tuple[Array, Array]], points: Array) -> tuple[Array, Array]:
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
    parts: list[_Part], boxes: list[tuple[Array, Array]], vertices: Array, faces: NDArray[np.int64]
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


def _flesh(figure: Figure, position: Array, rotation: Array) -> list[_Part]:
    """All primitives of the body in model space. Lengths below are fractions of stature.

    Source of breadths, depths and girths: Dreyfuss, The Measure of Man; shapes between them are our own.
    """
    H = figure.stature_m
    is_male = figure.sex == "male"
    build = figure.build
    parts: list[_Part] = []

    def add(
        joint: str,
        profile: Sequence[tuple[float, ...]],
        caps: tuple[float, float],
        bones: tuple[str, ...],
        cuts: tuple[float, ...] = (),
        widths: tuple[float, ...] = (),
        *,
        at: tuple[float, float, float] = (0.0, 0.0, 0.0),
        power: float = 2.0,
        tilt: Array | None = None,
        floor_z: float | None = None,
        girth: float = 1.0,
    ) -> None:
        # profile rows: z, half_x, half_y[, center_x[, center_y]]
        rows = np.array([[*row, *([0.0] * (5 - len(row)))] for row in sorted(profile)]) * H
        rows[:, 1:3] *= girth
        if len(rows) > 2:
            dense = np.linspace(rows[0, 0], rows[-1, 0], 48)
            rows = np.column_stack([dense, PchipInterpolator(rows[:, 0], rows[:, 1:])(dense)])
        j = JOINT[joint]
        R = rotation[j] if tilt is None else rotation[j] @ tilt
        parts.append(
            _Part(
                position[j] + rotation[j] @ (np.array(at) * H),
                R,
                rows[:, 0],
                rows[:, 1],
                rows[:, 2],
                rows[:, 3],
                rows[:, 4],
                (caps[0] * H, caps[1] * H),
                tuple(JOINT[b] for b in bones),
                tuple(c * H for c in cuts),
                tuple(w * H for w in widths),
                power,
                None if floor_z is None else floor_z,
            )
        )

    def ball(
        joint: str,
        at: tuple[float, float, float],
        radii: tuple[float, float, float],
        bones: tuple[str, ...],
        cuts: tuple[float, ...] = (),
        widths: tuple[float, ...] = (),
        *,
        tilt: Array | None = None,
    ) -> None:
        add(joint, [(0.0, radii[0], radii[1])], (radii[2], radii[2]), bones, cuts, widths, at=at, tilt=tilt)

    offset = figure.offsets / H
    spine_z = offset[JOINT["spine"], 2]
    chest_z = spine_z + offset[JOINT["chest"], 2]
    neck_z = chest_z + offset[JOINT["neck"], 2]
    trunk = neck_z / 0.315  # relative trunk length
    shoulder_y = abs(offset[JOINT["left_clavicle"], 1] + offset[JOINT["left_shoulder"], 1])
    hip_y = offset[JOINT["left_hip"], 1]
    wide = shoulder_y / 0.105
    torso = ("pelvis", "spine", "chest")
    torso_cuts = (0.85 * spine_z, chest_z)
    torso_widths = (0.030, 0.036)
    # z, half depth (x), half breadth (y), centre x
    if is_male:
        rows = [
            (-0.050, 0.046, 0.058, -0.004),
            (0.000, 0.058, 0.092, -0.006),
            (0.045, 0.057, 0.090, -0.004),
            (0.090, 0.054, 0.081, 0.002),
            (0.150, 0.058, 0.085 * wide, 0.004),
            (0.205, 0.062, 0.094 * wide, 0.003),
            (0.250, 0.054, 0.092 * wide, -0.004),
            (0.275, 0.044, 0.086 * wide, -0.009),
            (0.300, 0.032, 0.050, -0.012),
        ]
    else:
        rows = [
            (-0.050, 0.048, 0.064, -0.004),
            (0.000, 0.060, 0.102, -0.006),
            (0.045, 0.055, 0.092, -0.004),
            (0.095, 0.047, 0.071, 0.002),
            (0.150, 0.052, 0.078 * wide, 0.003),
            (0.205, 0.055, 0.089 * wide, 0.000),
            (0.250, 0.048, 0.087 * wide, -0.006),
            (0.275, 0.040, 0.080 * wide, -0.009),
            (0.300, 0.027, 0.042, -0.012),
        ]
    # A stout person is stout in front: the belly moves the section forward and deepens it.
    belly = max(build - 0.95, 0.0)
    stretched = [
        (z * trunk if z > 0 else z, a + 0.05 * belly * bulge, b, c + 0.06 * belly * bulge)
        for z, a, b, c in rows
        for bulge in (float(np.exp(-(((z - 0.085) / 0.06) ** 2))),)
    ]
    add("pelvis", stretched, (0.03, 0.02), torso, torso_cuts, torso_widths, power=2.35, girth=build)
    for side, sign in SIDES:
        ball(
            "pelvis",
            (-0.036, sign * 0.045, -0.016),
            (0.040 * build, 0.044 * build, 0.048),
            ("pelvis",),
        )
        if is_male:
            ball("pelvis", (0.030, sign * 0.043, 0.222 * trunk), (0.028, 0.046, 0.040), ("chest",))
        else:
            ball("pelvis", (0.034, sign * 0.041, 0.203 * trunk), (0.034, 0.038, 0.036), ("chest",))
        # Trapezius: a slope from the neck to the shoulder.
        start = np.array([-0.012, sign * 0.014, 0.012])
        end = np.array([-0.014, sign * 0.86 * shoulder_y, -0.027])
        along = (end - start) / np.linalg.norm(end - start)
        x_axis = np.array([1.0, 0, 0]) - along[0] * along
        x_axis /= np.linalg.norm(x_axis)
        frame = np.column_stack([x_axis, np.cross(along, x_axis), along])
        length = float(np.linalg.norm(end - start))
        add(
            "neck",
            [(0.0, 0.026, 0.020), (length, 0.030, 0.022)],
            (0.02, 0.02),
            ("chest", f"{side}_clavicle"),
            (0.5 * length,),
            (0.02,),
            at=(float(start[0]), float(start[1]), float(start[2])),
            tilt=frame,
            girth=0.5 + 0.5 * build,
        )
    # Neck and head.
    neck_r = (0.0335 if is_male else 0.0285) * build**0.4
    head_z = offset[JOINT["head"], 2]
    add(
        "neck",
        [(-0.025, neck_r, neck_r * 1.12, -0.004), (head_z + 0.02, neck_r, neck_r * 0.98, 0.006)],
        (0.02, 0.02),
        ("chest", "neck", "head"),
        (-0.012, 0.9 * head_z),
        (0.018, 0.016),
    )
    scale = (figure.head_top[2] / H) / 0.110
    face = 1.0 if is_male else 0.96
    for at, radii in (
        ((-0.004, 0, 0.058), (0.0560, 0.0430, 0.0500)),  # cranium
        ((0.022, 0, 0.020), (0.0330 * face, 0.0335 * face, 0.0450)),  # face
        ((0.034, 0, -0.010), (0.0170, 0.0200 * face, 0.0140)),  # chin
        ((0.055, 0, 0.028), (0.0075, 0.0065, 0.0130)),  # nose
        ((-0.006, 0.0435, 0.030), (0.0100, 0.0050, 0.0150)),  # ears
        ((-0.006, -0.0435, 0.030), (0.0100, 0.0050, 0.0150)),
    ):
        ball(
            "head", (at[0] * scale, at[1] * scale, at[2] * scale), tuple(r * scale for r in radii), ("head",)
        )
    if not is_male:
        ball("head", (-0.030, 0, 0.018), (0.036, 0.041, 0.058), ("neck", "head"), (-0.05,), (0.02,))
    arm = build**0.8 * (1.0 if is_male else 0.88)
    leg = build**0.9 * (1.0 if is_male else 1.02)
    foot_floor = -(0.039 * H + SOLE_M)
    for side, sign in SIDES:
        L = -offset[JOINT[f"{side}_elbow"], 2]
        F = -offset[JOINT[f"{side}_wrist"], 2]
        clavicle, upper, fore, hand = (f"{side}_{n}" for n in ("clavicle", "shoulder", "elbow", "wrist"))
        ball(
            upper,
            (-0.002, sign * 0.002, -0.012),
            (0.0330 * arm, 0.0310 * arm, 0.044),
            (upper, clavicle),
            (0.020,),
            (0.030,),
        )
        # The whole arm, and below the whole leg, is one profile: the limbs are straight in the modelling pose.
        add(
            upper,
            [
                (0.0, 0.0300, 0.0270),
                (-0.25 * L, 0.0305, 0.0272, 0.001),
                (-0.50 * L, 0.0300, 0.0265, 0.004),
                (-0.80 * L, 0.0255, 0.0240, 0.001),
                (-1.0 * L, 0.0240, 0.0245, -0.002),
                (-L - 0.22 * F, 0.0262, 0.0240, 0.002),
                (-L - 0.50 * F, 0.0222, 0.0202, 0.001),
                (-L - 0.80 * F, 0.0178, 0.0155),
                (-L - 1.0 * F, 0.0172, 0.0128),
            ],
            (0.012, 0.012),
            (hand, fore, upper, clavicle),
            (-L - F, -L, 0.008),
            (0.014, 0.022, 0.030),
            girth=arm,
        )
        add(
            hand,
            [
                (0.0, 0.0160, 0.0120),
                (-0.028, 0.0215, 0.0115, 0.002),
                (-0.052, 0.0230, 0.0105, 0.002, -sign * 0.001),
                (-0.078, 0.0195, 0.0085, 0.001, -sign * 0.007),
                (-0.097, 0.0140, 0.0075, 0.000, -sign * 0.016),
            ],
            (0.008, 0.012),
            (hand, fore),
            (0.0,),
            (0.014,),
            power=2.3,
        )
        thumb = rotation_about(1, -np.deg2rad(35)) @ rotation_about(0, -sign * np.deg2rad(12))
        add(
            hand,
            [(0.0, 0.0095, 0.0095), (-0.030, 0.0085, 0.0085), (-0.042, 0.0070, 0.0070)],
            (0.008, 0.010),
            (hand,),
            at=(0.012, -sign * 0.004, -0.018),
            tilt=thumb,
        )
        T = -offset[JOINT[f"{side}_knee"], 2]
        S = -offset[JOINT[f"{side}_ankle"], 2]
        hip, knee, ankle, toe = (f"{side}_{n}" for n in ("hip", "knee", "ankle", "toe"))
        inward = (0.048 - hip_y) * sign * 0.4
        add(
            hip,
            [
                (0.030, 0.040, 0.036, -0.006),
                (-0.02, 0.0520, 0.0470, -0.004, inward),
                (-0.25 * T, 0.0535, 0.0490, 0.000, inward),
                (-0.50 * T, 0.0495, 0.0450, 0.002),
                (-0.75 * T, 0.0430, 0.0395, 0.000),
                (-1.0 * T, 0.0380, 0.0360, 0.000),
                (-T - 0.10 * S, 0.0365, 0.0345, -0.001),
                (-T - 0.30 * S, 0.0375, 0.0355, -0.007),
                (-T - 0.55 * S, 0.0325, 0.0310, -0.006),
                (-T - 0.80 * S, 0.0270, 0.0260, -0.003),
                (-T - 1.0 * S, 0.0255, 0.0240, -0.001),
            ],
            (0.015, 0.018),
            (ankle, knee, hip, "pelvis"),
            (-T - S, -T, -0.004),
            (0.014, 0.028, 0.042),
            girth=leg,
        )
        # Shoe: along its own axis (local z = forward), flat below.
        forward = np.column_stack([[0.0, 0, 1], [0.0, 1, 0], [-1.0, 0, 0]])  # local x up, y left, z backwards
        low = foot_floor / H
        shoe = [
            (0.032, 0.0230, 0.0180),
            (0.010, 0.0270, 0.0195),
            (-0.030, 0.0260, 0.0215),
            (-0.066, 0.0180, 0.0275),
            (-0.100, 0.0130, 0.0230),
        ]
        sections = [(z, hx, hy, low + hx, sign * 0.001) for z, hx, hy in shoe]
        add(
            ankle,
            sections,
            (0.018, 0.012),
            (toe, ankle),
            (-offset[JOINT[toe], 0],),
            (0.014,),
            tilt=forward,
            power=2.6,
        )
        ball(ankle, (0.012, 0, -0.010), (0.030, 0.0215, 0.026), (ankle, knee), (0.012,), (0.014,))
    return parts
