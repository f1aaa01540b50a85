"""Distance between the posed flesh and the surface of the hull, as residuals for a second-order refinement."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.body.flesh import LookUpTable
from mocap.body.kinematics import cones_of, cones_of_particles, cones_on, joint_transforms
from mocap.body.model import Body
from mocap.data.problem import StateLayout
from mocap.data.voxels import VoxelGrid, Voxels
from mocap.likelihood.residuals._pull_kernels import FleshPoints
from mocap.likelihood.residuals._surface_kernels import (
    Blocks,
    HullPoints,
    SurfacePull,
    SurfaceTerms,
    Volume,
    distance_to_cones,
    share_within,
    sort_into_blocks,
    surface_equations,
    surface_normals,
)
from mocap.likelihood.voxels.exact import PackedVolume

_APART_M = 0.03
_BLOCK_VOXELS = 4  # side of the cubes in which the nearest hull point is looked for
_NORMAL_RADIUS_VOXELS = 2  # neighbourhood of the hull's normals: five voxels wide


@dataclass(frozen=True)
class SurfaceFitSettings:
    """How hull and flesh pull each other."""

    n_hull_points: int = 1500
    """Surface voxels used per frame, evenly thinned out."""
    n_flesh_points: int = 400
    """Flesh surface points tested for sticking out of the hull."""
    scale_m: float = 0.04
    """Residual at which a hull point loses three quarters of its pull (Geman-McClure)."""
    flesh_scale_m: float = 0.10
    normal_cost_m: float = 0.06
    """Distance that opposite normals are worth when the nearest cone is chosen."""
    flesh_gain: float = 1.0
    """Total weight of the flesh points against that of the hull points."""
    measured_weight: int = 4
    """Hull points that a point counts for whose place a depth camera has measured: a hull's others lie centimetres
    outside the body where few cameras see it. Chosen on depth_walk and depth_gesture (`python -m eval.depth`)."""
    penetration_gain: float = 1.0
    """Total weight of flesh points inside other parts against that of the hull points."""
    floor_gain: float = 0.1
    """Weight of an end of a cone below the floor against that of the hull points: the floor, and a sole on it, are
    known to a centimetre (decision 93)."""
    floor_scale_m: float = 0.05
    """Depth at which the floor loses three quarters of its pull: of a calibration whose floor is elsewhere it says
    nothing."""


@dataclass(frozen=True, eq=False)
class HullSurface:
    """Surface points of one frame's hull with outward normals.  points, normals : (M, 3) m, world."""

    points: Array
    normals: Array
    volume: PackedVolume

    def at(self, measured: NDArray[np.float32], weight: int = 1) -> HullSurface:
        """The surface with its points where they were measured, (M, 3) m; NaN leaves a point where it is.

        weight : times that a measured point is there. The body's surface itself is measured; a hull lies half a voxel
        outside, and the points go there.
        """
        is_measured = np.isfinite(measured).all(axis=1)
        points = self.points.copy()
        half_m = 0.5 * self.volume.grid.voxel_size_m
        points[is_measured] = measured[is_measured] + half_m * self.normals[is_measured]
        times = np.where(is_measured, weight, 1)
        return HullSurface(
            np.repeat(points, times, axis=0), np.repeat(self.normals, times, axis=0), self.volume
        )

    @cached_property
    def blocks(self) -> Blocks:
        """The points by cubes, as the kernels look for the nearest in them."""
        side = _BLOCK_VOXELS * self.volume.grid.voxel_size_m
        low, high = (
            (self.points.min(axis=0), self.points.max(axis=0))
            if len(self.points)
            else (np.zeros(3), np.zeros(3))
        )
        shape = np.floor((high - low) / side).astype(np.int64) + 1
        first = np.empty(int(shape.prod()) + 1, dtype=np.int64)
        blocks = Blocks(low, side, shape, first, np.empty(len(self.points), dtype=np.int64))
        sort_into_blocks(self.points, blocks)
        return blocks


def hull_surface(
    voxels: Voxels, is_surface: NDArray[np.bool_], grid: VoxelGrid, volume: PackedVolume
) -> HullSurface:
    """Points and normals of a hull.  voxels : (N,) linear indices inside the volume's crop."""
    surface = voxels[is_surface]
    normals = np.zeros((len(surface), 3))
    surface_normals(
        voxels,
        is_surface,
        volume.crop,
        volume.lower_subscript,
        grid.shape[1],
        grid.shape[2],
        _NORMAL_RADIUS_VOXELS,
        normals,
    )
    return HullSurface(grid.centers(surface), normals, volume)


@lru_cache(maxsize=64)
def flesh_sample(table: LookUpTable, n: int) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """About n surface points of the flesh, evenly spread: (M, 3) m in joint frames, their joints and parts (M,).

    Kept and shared: not to be written to.
    """
    rows = np.concatenate([a + np.arange(k) for a, k in zip(table.start[:-1], table.n_surface, strict=True)])
    joints = np.repeat(table.joint, table.n_surface)
    parts = np.repeat(table.part, table.n_surface)
    # A stride that is coprime to lattice rows would do; a fixed permutation is simpler and as even.
    chosen = np.sort(np.random.default_rng(0).permutation(len(rows))[:n])
    return table.points[rows[chosen]].astype(np.float64), joints[chosen], parts[chosen]


@dataclass(frozen=True, eq=False)
class SurfaceProblem:
    """Robust distance of a body to one frame's hull: `normal_equations(state)` for the refinement.

    Hull surface points pull the nearest flesh whose normal agrees; flesh points in empty voxels are pulled to the
    nearest hull point; flesh points inside another part are pushed out of it, and flesh below the floor is lifted.
    The hull contains the body, so its surface lies outside the flesh: half a voxel is allowed for.
    """

    body: Body
    table: LookUpTable
    hull: HullSurface
    settings: SurfaceFitSettings
    _points: Array = field(init=False, repr=False)
    _normals: Array = field(init=False, repr=False)
    _flesh: Array = field(init=False, repr=False)
    _flesh_joint: NDArray[np.int64] = field(init=False, repr=False)
    _may_meet: NDArray[np.bool_] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        every = max(1, len(self.hull.points) // self.settings.n_hull_points)
        table = self.table
        flesh, joint, _ = flesh_sample(table, self.settings.n_flesh_points)
        for name, value in (
            ("_may_meet", _parts_apart_at_rest(self.body, table, self.settings.n_flesh_points)),
            ("_points", np.ascontiguousarray(self.hull.points[::every])),
            ("_normals", np.ascontiguousarray(self.hull.normals[::every])),
            ("_flesh", flesh),
            ("_flesh_joint", joint),
        ):
            object.__setattr__(self, name, value)

    @property
    def layout(self) -> StateLayout:
        return self.body.layout

    @property
    def n_points(self) -> int:
        """Hull points used."""
        return len(self._points)

    @cached_property
    def terms(self) -> SurfaceTerms:
        """The problem as the kernels take it."""
        settings, volume = self.settings, self.hull.volume
        voxel = volume.grid.voxel_size_m
        per_flesh = len(self._points) / len(self._flesh)
        both = np.concatenate([self._points, self._normals], axis=1)
        columns = np.ascontiguousarray(both.T, dtype=np.float32)
        return SurfaceTerms(
            HullPoints(self._points, self._normals, columns, self.hull.points, self.hull.blocks),
            FleshPoints(self._flesh, self._flesh_joint),
            self._may_meet,
            Volume(volume.crop, volume.lower_m, voxel),
            SurfacePull(
                excess_m=0.5 * voxel,
                scale_m=settings.scale_m,
                normal_cost_m=settings.normal_cost_m,
                flesh_scale_m=settings.flesh_scale_m,
                flesh_gain=settings.flesh_gain * per_flesh,
                penetration_gain=settings.penetration_gain * per_flesh,
                floor_scale_m=settings.floor_scale_m,
                floor_gain=settings.floor_gain * len(self._points),
            ),
        )

    def normal_equations(self, state: Array) -> tuple[float, Array, Array]:
        """Robust cost, its Gauss-Newton matrix (D, D) and gradient (D,) at a state (D,).

        Units: metres squared, summed over the hull points used. An empty hull gives zeros.
        """
        body = self.body
        D = body.layout.n_columns
        H, g = np.zeros((D, D)), np.zeros(D)
        if len(self._points) == 0:
            return 0.0, H, g
        x = np.ascontiguousarray(state, dtype=np.float64)
        return float(surface_equations(x, body.arrays, self.terms, H, g)), H, g

    def unexplained(self, state: Array, distance_m: float) -> Array:
        """Hull points further than distance_m outside the flesh of a state (D,), furthest first: (U, 3) m, world."""
        start, end = cones_of(self.body, state)
        distance = np.empty(len(self._points))
        distance_to_cones(self._points, start, end, self.body.cones.radii, distance)
        out = np.flatnonzero(distance > distance_m)
        return self._points[out[np.argsort(-distance[out], kind="stable")]]

    def unexplained_share(self, state: Array, distance_m: float) -> float:
        """Share of the hull points used that `unexplained` returns; 0 without points."""
        return len(self.unexplained(state, distance_m)) / max(self.n_points, 1)

    def explained_share(self, points: Array, particles: Array, limb: list[int], distance_m: float) -> Array:
        """Share of points (U, 3) m that lie within distance_m of the flesh of one limb of particles (N, D): (N,).

        limb : its parts. The flesh counts with its mean radii.
        """
        cones = self.body.cones
        own = cones_on(self.body, limb)
        start, end = cones_of_particles(self.body, particles, own)
        share = np.empty(len(particles))
        share_within(points, start, end, cones.radii[own].mean(axis=1) + distance_m, share)
        return share


@lru_cache(maxsize=64)
def _parts_apart_at_rest(body: Body, table: LookUpTable, n: int) -> NDArray[np.bool_]:
    """Parts that each point of the flesh's sample is clear of in the rest pose, (P, M): neighbours at a joint touch
    always."""
    flesh, joint, part = flesh_sample(table, n)
    R, t = joint_transforms(body, np.zeros((1, body.layout.n_columns)))
    points = np.einsum("mrc,mc->mr", R[0, joint], flesh) + t[0, joint]
    start, end = cones_of(body, np.zeros(body.layout.n_columns))
    apart = np.ones((body.layout.n_parts, len(flesh)), dtype=np.bool_)
    for p in range(body.layout.n_parts):
        rows = body.cones.part == p
        distance = np.empty(len(points))
        distance_to_cones(points, start[rows], end[rows], body.cones.radii[rows], distance)
        apart[p] = distance > _APART_M
    apart[part, np.arange(len(flesh))] = False
    return apart
