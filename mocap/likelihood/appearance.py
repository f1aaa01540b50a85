"""Colours of the body: evidence from inside the silhouettes, where an arm before the trunk leaves no other trace.

A body is divided into zones. What colours each zone has is learnt while the person is followed; a pose is good when the
surface voxels nearest to each zone have its colours.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.body.kinematics import cones_of, cones_of_particles
from mocap.body.model import Body
from mocap.likelihood._appearance_kernels import limb_values, zones_of_points

Array = NDArray[np.float64]

_LUMA_BITS, _CHROMA_BITS = 3, 5
_CHROMA_LOW, _CHROMA_HIGH = 64, 192  # clothes and skin lie within; the rest goes into the outermost bins
N_COLOURS = 1 << (_LUMA_BITS + 2 * _CHROMA_BITS)
_PRIOR_VOXELS = 50.0  # a zone with fewer voxels still looks like the whole body
_BLUNT = 0.05  # share of voxels whose colour says nothing: shadows, seams, pixels of a neighbour
_TOUCH_M = 0.05  # a zone learns from voxels within this distance of its flesh
_LONG_SHARE = 0.08  # of the body's height: longer cones have two zones, such as sleeve and skin


def colour_bins_of_voxels(rgb: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Colours (N, 3) uint8 as bins (N,): luma coarse, chroma fine."""
    if len(rgb) == 0:
        return np.zeros(0, dtype=np.int64)
    y = cv2.cvtColor(np.ascontiguousarray(rgb)[None], cv2.COLOR_RGB2YCrCb)[0].astype(np.int64)
    step = (_CHROMA_HIGH - _CHROMA_LOW) >> _CHROMA_BITS
    chroma = np.clip((y[:, 1:] - _CHROMA_LOW) // step, 0, (1 << _CHROMA_BITS) - 1)
    luma = y[:, 0] >> (8 - _LUMA_BITS)
    return (((luma << _CHROMA_BITS) + chroma[:, 0]) << _CHROMA_BITS) + chroma[:, 1]


@dataclass(frozen=True, eq=False)
class BodyZones:
    """Zones of a body by cone.  first, n : (K,) first zone of each cone, and how many it has along its axis.

    Cones that are mirror images share their zones: clothes are alike on both sides.
    """

    first: NDArray[np.int64]
    n: NDArray[np.int64]
    n_zones: int


def body_zones(body: Body) -> BodyZones:
    """Zones of a body: one for each cone, two for long ones."""
    cones = body.cones
    keys: dict[tuple[object, ...], int] = {}
    first = np.zeros(len(cones.part), dtype=np.int64)
    n = np.where(np.linalg.norm(cones.end - cones.start, axis=1) > _LONG_SHARE * body.height_m, 2, 1)
    n_zones = 0
    for k in range(len(cones.part)):
        ends = np.abs(np.concatenate([cones.start[k], cones.end[k]])).round(3)
        part, joint = body.layout.parts[cones.part[k]], body.joints[cones.joint[k]]
        key = (_unsided(part), _unsided(joint), *ends.tolist())
        if key not in keys:
            keys[key] = n_zones
            n_zones += int(n[k])
        first[k] = keys[key]
    return BodyZones(first, n.astype(np.int64), n_zones)


def _unsided(name: str) -> str:
    return name.removeprefix("left_").removeprefix("right_")


@dataclass(frozen=True, eq=False)
class Appearance:
    """What is known of one person's colours.  counts : (Z, N_COLOURS) surface voxels so far, by zone and colour."""

    zones: BodyZones
    counts: NDArray[np.float32]

    @cached_property
    def log_ratio(self) -> NDArray[np.float32]:
        """log p(colour | zone) / p(colour | body), (Z, N_COLOURS); 0 while nothing is known."""
        total = self.counts.sum(axis=0, dtype=np.float64) + 1e-3
        body = total / total.sum()
        of_zone = self.counts.sum(axis=1, keepdims=True, dtype=np.float64)
        zone = (self.counts + _PRIOR_VOXELS * body) / (of_zone + _PRIOR_VOXELS)
        return np.log((1.0 - _BLUNT) * zone / body + _BLUNT).astype(np.float32)


def new_appearance(body: Body) -> Appearance:
    """Nothing known yet."""
    zones = body_zones(body)
    return Appearance(zones, np.zeros((zones.n_zones, N_COLOURS), dtype=np.float32))


@dataclass(frozen=True, eq=False)
class ColourProblem:
    """Colours of one frame's hull surface, and how well poses explain them.

    points : (M, 3) m, surface voxels that a camera sees.  bins : (M,) their colours.
    """

    body: Body
    points: Array
    bins: NDArray[np.int64]
    appearance: Appearance
    _scratch: tuple[NDArray[np.int64], Array] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        n = len(self.points)
        object.__setattr__(self, "_scratch", (np.zeros(n, dtype=np.int64), np.zeros(n)))

    def log_ratio(self, states: Array) -> Array:
        """Mean over the points of log p(colour | zone under the pose) / p(colour | body), for states (K, D): (K,)."""
        if len(self.points) == 0:
            return np.zeros(len(states))
        table = self.appearance.log_ratio
        return np.array([table[self._zones(state)[0], self.bins].mean() for state in states])

    def learnt(self, state: Array, trusted: NDArray[np.bool_]) -> Appearance:
        """The appearance with this frame under a pose (D,) added.  trusted : (P,) parts that are where it says."""
        zone, distance = self._zones(state)
        owner = np.zeros(self.appearance.zones.n_zones, dtype=np.bool_)
        for k, part in enumerate(self.body.cones.part):
            first = self.appearance.zones.first[k]
            owner[first : first + self.appearance.zones.n[k]] |= trusted[part]
        near = (distance < _TOUCH_M) & owner[zone]
        counts = self.appearance.counts.copy()
        np.add.at(counts, (zone[near], self.bins[near]), 1.0)
        return Appearance(self.appearance.zones, counts)

    def limb_log_ratio(self, state: Array, particles: Array, limb: list[int], every: int = 1) -> Array:
        """`log_ratio` of particles (N, D) that differ from a state (D,) in one limb's columns only, less the state's.

        limb : its parts.  every : only every so many of the points, for a search.
        """
        if len(self.points) == 0:
            return np.zeros(len(particles))
        body, zones = self.body, self.appearance.zones
        own = np.isin(body.cones.part, limb)
        start, end = cones_of(body, state)
        points, bins = np.ascontiguousarray(self.points[::every]), np.ascontiguousarray(self.bins[::every])
        zone, distance = np.zeros(len(points), dtype=np.int64), np.zeros(len(points))
        rest = ~own
        zones_of_points(
            points,
            start[rest],
            end[rest],
            body.cones.radii[rest],
            zones.first[rest],
            zones.n[rest],
            zone,
            distance,
        )
        table = self.appearance.log_ratio
        other = table[zone, bins].astype(np.float64)
        starts, ends = cones_of_particles(body, particles, own)
        values = np.empty(len(particles))
        limb_values(
            points,
            bins,
            table,
            distance,
            other,
            starts,
            ends,
            body.cones.radii[own],
            zones.first[own],
            zones.n[own],
            values,
        )
        own_zone, _ = self._zones(state)
        return (values - table[own_zone[::every], bins].sum()) / len(points)

    def _zones(self, state: Array) -> tuple[NDArray[np.int64], Array]:
        start, end = cones_of(self.body, state)
        zones = self.appearance.zones
        zone, distance = self._scratch
        zones_of_points(self.points, start, end, self.body.cones.radii, zones.first, zones.n, zone, distance)
        return zone, distance
