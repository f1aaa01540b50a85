"""Flesh: truncated cones as look-up tables of points (CF 6.11), and distances to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.body._kernels import cones_on_lattice
from mocap.body.kinematics import joint_transforms
from mocap.body.model import Body

_LATTICE_SHIFTS = (0.0, 0.5, 0.25, 0.75)  # of its side, tried in turn


@dataclass(frozen=True, eq=False)
class LookUpTable:
    """Points of the flesh in joint frames, grouped into segments (one joint and one part each).

    points : (M, 3) float32, m, in the segment's joint frame; within a segment surface points come first.
    start : (S + 1,) first point of each segment.  n_surface : (S,) surface points of each segment.
    joint, part : (S,).  spacing_m : side of the lattice.
    center : (S, 3) m and radius : (S,) m, bounding sphere of each segment in its joint's frame.
    """

    points: NDArray[np.float32]
    start: NDArray[np.int64]
    n_surface: NDArray[np.int64]
    joint: NDArray[np.int64]
    part: NDArray[np.int64]
    spacing_m: float
    center: Array
    radius: Array

    @property
    def part_sizes(self) -> NDArray[np.int64]:
        """Points of each part, (P,)."""
        return np.bincount(self.part, weights=np.diff(self.start)).astype(np.int64)


def cone_distances(points: Array, start: Array, end: Array, radii: Array, round_ends: bool) -> Array:
    """Distance of points to the side of truncated cones: negative inside, positive outside.

    points : (M, 3), start, end : (K, 3), radii : (K, 2), one frame, m. Returns (M, K). With round_ends the
    nearest axis point is clamped to the axis, which closes the cone with spheres; otherwise points beyond
    the flat ends get at least their distance to the end plane. The radius is taken at the foot of the
    perpendicular, so for a taper of angle a the value is 1 / cos(a) too large (< 1 % for limbs).
    """
    axis = end - start
    length = np.linalg.norm(axis, axis=1)
    safe = np.maximum(length, 1e-12)
    unit = axis / safe[:, None]
    along = np.einsum("mkc,kc->mk", points[:, None, :] - start[None], unit) / safe
    clamped = np.clip(along, 0.0, 1.0)
    foot = start[None] + clamped[..., None] * axis[None]
    radius = radii[:, 0] + clamped * (radii[:, 1] - radii[:, 0])
    distance = np.linalg.norm(points[:, None, :] - foot, axis=2) - radius
    if round_ends:
        return distance
    beyond = np.maximum(-along, along - 1.0) * length
    unclamped_foot = start[None] + along[..., None] * axis[None]
    lateral = np.linalg.norm(points[:, None, :] - unclamped_foot, axis=2) - radius
    return np.where(beyond > 0, np.maximum(beyond, lateral), lateral)


def lattice_in_cones(
    origin: Array,
    spacing_m: float,
    shape: Sequence[int],
    start: Array,
    end: Array,
    radii: Array,
    round_ends: bool,
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Which points of a lattice lie in truncated cones, (K, nx, ny, nz), and in which cone each lies deepest, (nx, ny,
    nz), -1 = none.

    origin : (3,) m, the first point.  shape : nx, ny, nz.  start, end, radii and distances as in `cone_distances`.
    """
    inside = np.zeros((len(start), *shape), dtype=np.bool_)
    deepest = np.full(tuple(shape), -1, dtype=np.int64)
    cones_on_lattice(origin, spacing_m, start, end, radii, round_ends, inside, deepest)
    return inside, deepest


def build_look_up_table(body: Body, spacing_m: float) -> LookUpTable:
    """Sample the flesh on a lattice of the given side in the rest pose.

    Source: CF Eq. 6.11; spacing_m / voxel size is the density factor of CF Eq. 6.26. A point counts as surface
    when a 6-neighbour of it lies outside the whole body in the rest pose, so that joints inside the body are
    no surface. With `body.exclusive` a point inside several parts belongs to the one it lies deepest in; a segment that
    lies in others altogether shares their points, and one between all points of the lattice is left out. A lattice that
    runs past a whole part, a thin forearm between two rows perhaps, is moved by parts of its side.
    Raises ValueError when a part is too thin to hold one point of any of these lattices.
    """
    if not spacing_m > 0:
        raise ValueError(f"spacing_m must be positive, got {spacing_m}")
    tables = (_table_on_lattice(body, spacing_m, shift) for shift in _LATTICE_SHIFTS)
    found = next((table for table in tables if len(set(table.part.tolist())) == body.layout.n_parts), None)
    if found is None:
        parts = set(_table_on_lattice(body, spacing_m, 0.0).part.tolist())
        thin = next(name for p, name in enumerate(body.layout.parts) if p not in parts)
        raise ValueError(f"part {thin} is too thin for a spacing of {spacing_m} m")
    return found


def _table_on_lattice(body: Body, spacing_m: float, shift: float) -> LookUpTable:
    """The table on one lattice, without parts that hold none of its points.  shift : of the lattice, in its side."""
    rest = np.zeros((1, body.layout.n_columns))
    R, t = joint_transforms(body, rest)
    cones = body.cones
    Rk, tk = R[0, cones.joint], t[0, cones.joint]
    start = np.einsum("krc,kc->kr", Rk, cones.start) + tk
    end = np.einsum("krc,kc->kr", Rk, cones.end) + tk
    reach = cones.radii.max(axis=1)[:, None]
    lower = np.minimum(start, end) - reach
    upper = np.maximum(start, end) + reach
    n = np.ceil((upper.max(axis=0) - lower.min(axis=0)) / spacing_m).astype(int) + 4
    origin = lower.min(axis=0) - (1.5 - shift) * spacing_m
    inside, deepest = lattice_in_cones(origin, spacing_m, tuple(n), start, end, cones.radii, body.round_ends)
    solid = deepest >= 0
    core = solid.copy()
    for axis in range(3):
        core &= np.roll(solid, 1, axis) & np.roll(solid, -1, axis)
    is_flesh = np.flatnonzero(solid)
    points = origin + np.stack(np.unravel_index(is_flesh, solid.shape), axis=1) * spacing_m
    surface = ~core.ravel()[is_flesh]
    member_of = (
        np.arange(len(cones.joint))[:, None] == deepest.ravel()[is_flesh]
        if body.exclusive
        else inside.reshape(len(cones.joint), -1)[:, is_flesh]
    )

    tables, starts, n_surface, joints, parts, centers, radii = [], [0], [], [], [], [], []
    pairs = list(dict.fromkeys(zip(cones.part.tolist(), cones.joint.tolist(), strict=True)))
    for part, joint in sorted(pairs, key=lambda pair: pair[0]):
        own = (cones.part == part) & (cones.joint == joint)
        rows = np.flatnonzero(member_of[own].any(axis=0))
        if not len(rows):
            rows = np.flatnonzero(inside.reshape(len(cones.joint), -1)[own][:, is_flesh].any(axis=0))
        if not len(rows):
            continue
        rows = rows[np.argsort(~surface[rows], kind="stable")]
        local = (points[rows] - t[0, joint]) @ R[0, joint]
        center = 0.5 * (local.min(axis=0) + local.max(axis=0))
        tables.append(local.astype(np.float32))
        starts.append(starts[-1] + len(rows))
        n_surface.append(int(surface[rows].sum()))
        joints.append(joint)
        parts.append(part)
        centers.append(center)
        radii.append(np.linalg.norm(local - center, axis=1).max())
    return LookUpTable(
        points=np.concatenate([np.zeros((0, 3), dtype=np.float32), *tables]),
        start=np.array(starts, dtype=np.int64),
        n_surface=np.array(n_surface, dtype=np.int64),
        joint=np.array(joints, dtype=np.int64),
        part=np.array(parts, dtype=np.int64),
        spacing_m=float(spacing_m),
        center=np.array(centers).reshape(-1, 3),
        radius=np.array(radii),
    )
