"""Colours of the body: evidence from inside the silhouettes, where an arm before the trunk leaves no other trace.

A body is divided into zones. What colours each zone has is learnt while the person is followed; a pose is good when the
pixels in which each zone is seen have its colours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.body.kinematics import cones_of, cones_of_particles, cones_on, joint_transforms
from mocap.body.model import Body
from mocap.data.problem import limbs_of
from mocap.likelihood.colours._kernels import limb_values, see_cones

_LUMA_BITS, _CHROMA_BITS = 3, 5
_CHROMA_LOW, _CHROMA_HIGH = 64, 192  # clothes and skin lie within; the rest goes into the outermost bins
N_COLOURS = 1 << (_LUMA_BITS + 2 * _CHROMA_BITS)
_PRIOR_PIXELS = 100.0  # a zone with fewer pixels still looks like the whole body
_BLUNT = 0.05  # share of pixels whose colour says nothing: shadows, seams, pixels of a neighbour
_TOUCH_M = 0.05  # a ray that passes the flesh this closely sees it: clothes
_LONG_SHARE = 0.08  # of the body's height: longer cones have two zones, such as sleeve and skin


def luma_and_chroma(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Colours (N, 3) as luma, red and blue difference."""
    if len(rgb) == 0:
        return np.zeros((0, 3), dtype=np.uint8)
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(rgb)[None], cv2.COLOR_RGB2YCrCb)[0], dtype=np.uint8)


def colour_bins_of_pixels(rgb: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Colours (N, 3) uint8 as bins (N,): luma coarse, chroma fine."""
    y = luma_and_chroma(rgb).astype(np.int64)
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
    """What is known of one person's colours.  counts : (Z, N_COLOURS) pixels so far, by zone and colour."""

    zones: BodyZones
    counts: NDArray[np.float32]

    @cached_property
    def log_ratio(self) -> NDArray[np.float32]:
        """log p(colour | zone) / p(colour | body), (Z, N_COLOURS); 0 while nothing is known."""
        total = self.counts.sum(axis=0, dtype=np.float64)
        of_zone = self.counts.sum(axis=1, keepdims=True, dtype=np.float64)
        # A person has a few hundred colours: all that were never seen say the same, how much is known of a zone.
        seen = np.flatnonzero(total)
        total += 1e-3
        body = total[seen] / total.sum()
        zone = (self.counts[:, seen] + _PRIOR_PIXELS * body) / (of_zone + _PRIOR_PIXELS)
        unseen = (1.0 - _BLUNT) * _PRIOR_PIXELS / (of_zone + _PRIOR_PIXELS) + _BLUNT
        out = np.empty(self.counts.shape, dtype=np.float32)
        out[:] = np.log(unseen)
        out[:, seen] = np.log((1.0 - _BLUNT) * zone / body + _BLUNT)
        return out


def new_appearance(body: Body) -> Appearance:
    """Nothing known yet."""
    zones = body_zones(body)
    return Appearance(zones, np.zeros((zones.n_zones, N_COLOURS), dtype=np.float32))


@dataclass(frozen=True, eq=False)
class PixelRays:
    """Pixels of one person in one frame.

    origins : (C, 3) m, the cameras' centres.  camera : (M,) index, ascending.  directions : (M, 3) unit, world.
    rgb : (M, 3) the pixels' colours.
    """

    origins: Array
    camera: NDArray[np.int64]
    directions: Array
    rgb: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.camera)

    @cached_property
    def bins(self) -> NDArray[np.int64]:
        """The bin of every pixel's colour, (M,)."""
        return colour_bins_of_pixels(self.rgb)

    @cached_property
    def columns(self) -> NDArray[np.float32]:
        """Origin and direction of every ray, (6, M), as the kernels take them."""
        out = np.empty((6, len(self)), dtype=np.float32)
        out[:3] = self.origins[self.camera].T
        out[3:] = self.directions.T
        return out

    def every(self, n: int) -> PixelRays:
        """Only every n-th of them."""
        return self if n <= 1 else self.taken(np.arange(0, len(self), n))

    def taken(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> PixelRays:
        """Only some of them, by index or as a mask."""
        return PixelRays(self.origins, self.camera[which], self.directions[which], self.rgb[which])


def _passing(rays: PixelRays, center: Array, radius: float) -> NDArray[np.bool_]:
    """Rays that pass a place (3,) within a radius, m, (M,)."""
    to = (center - rays.origins)[rays.camera]
    along = np.einsum("mc,mc->m", to, rays.directions)
    return np.asarray(np.einsum("mc,mc->m", to, to) - along**2 < radius**2)


@dataclass(frozen=True, eq=False)
class ColourProblem:
    """Colours of one frame's pixels, and how well poses explain them."""

    body: Body
    rays: PixelRays
    appearance: Appearance

    def log_ratio(self, states: Array) -> Array:
        """Mean over the pixels of log p(colour | zone seen under the pose) / p(colour | body), for states (K, D): (K,).

        A pixel in which no zone is seen says nothing.
        """
        if len(self.rays) == 0:
            return np.zeros(len(states))
        return np.array([self.pixel_values(state).mean() for state in states])

    def pixel_values(self, state: Array) -> Array:
        """What every pixel says of a state (D,): its log-ratio, (M,), 0 where no zone is seen."""
        return self._values(self.rays, self._seen(self.rays, cones_of(self.body, state)).zone)

    def learnt(self, state: Array, trusted: NDArray[np.bool_]) -> Appearance:
        """The appearance with this frame under a pose (D,) added.  trusted : (P,) parts that are where it says.

        A limb learns from pixels with nothing else of the body behind it: there it is needed to explain the
        silhouette. One that is wrongly thought to be before the trunk would learn the trunk's colours, and be believed
        ever after.
        """
        ends = cones_of(self.body, state)
        first = self._seen(self.rays, ends)
        part_of_cone = self.body.cones.part
        part = np.where(first.cone >= 0, part_of_cone[first.cone], -1)
        sure = (part >= 0) & (first.miss <= 0) & trusted[part]
        for limb in limbs_of(self.body.layout):
            is_own = cones_on(self.body, limb)
            own = np.flatnonzero(sure & is_own[first.cone])
            if len(own):
                rest = self._seen(self.rays.taken(own), ends, ~is_own)
                sure[own] = ~np.isfinite(rest.depth)
        zone, zones = first.zone, self.appearance.zones
        counts = self.appearance.counts.copy()
        np.add.at(counts, (zone[sure], self.rays.bins[sure]), 1.0)
        return Appearance(zones, counts)

    def limb_log_ratio(self, state: Array, limb: Sequence[int], every: int = 1) -> Callable[[Array], Array]:
        """A function of particles (N, D) that differ from a state (D,) in one limb's columns only: (N,), their
        `log_ratio` less the state's.

        limb : its parts.  every : only every so many of the pixels, for a search.
        """
        rays = self.rays.every(every)
        if len(rays) == 0:
            return lambda particles: np.zeros(len(particles))
        body, zones = self.body, self.appearance.zones
        own, ends = cones_on(body, limb), cones_of(body, state)
        near = rays.taken(_passing(rays, *self._reach(state, own)))
        rest = self._seen(near, ends, ~own)
        other = self._values(near, rest.zone)
        before = self._values(near, self._seen(near, ends).zone).sum()
        cones = body.cones.radii[own], zones.first[own], zones.n[own]

        def value(particles: Array) -> Array:
            starts, ends = cones_of_particles(body, particles, own)
            values = np.empty(len(particles))
            limb_values(
                near.columns,
                near.bins,
                self.appearance.log_ratio,
                rest.depth,
                rest.miss,
                other,
                starts,
                ends,
                *cones,
                values,
            )
            return np.asarray((values - before) / len(rays))

        return value

    def _reach(self, state: Array, own: NDArray[np.bool_]) -> tuple[Array, float]:
        """Where the limb of some cones is attached in a pose, (3,) m, and how far it can reach, m."""
        body = self.body
        joints = sorted(set(body.cones.joint[own].tolist()))
        _, t = joint_transforms(body, state[None])
        flesh = np.linalg.norm(body.cones.end[own], axis=1) + body.cones.radii[own].max(axis=1)
        bones = np.linalg.norm(body.offset[joints[1:]], axis=1).sum()
        return t[0, joints[0]], float(bones + flesh.max()) + _TOUCH_M

    def _values(self, rays: PixelRays, zone: NDArray[np.int64]) -> Array:
        """Log-ratio of every pixel's colour in its zone (M,); 0 for no zone."""
        found = self.appearance.log_ratio[np.maximum(zone, 0), rays.bins].astype(np.float64)
        return np.where(zone >= 0, found, 0.0)

    def _seen(
        self, rays: PixelRays, ends: tuple[Array, Array], which: NDArray[np.bool_] | None = None
    ) -> _Seen:
        """What of a pose is seen in every pixel.  ends : of its cones.  which : (K,) those there are, None = all."""
        cones, zones, n = self.body.cones, self.appearance.zones, len(rays)
        chosen = np.arange(len(cones.part)) if which is None else np.flatnonzero(which)
        start, end = ends
        cone, at = np.full(n, -1, dtype=np.int32), np.zeros(n, dtype=np.float32)
        depth, miss = np.full(n, np.inf, dtype=np.float32), np.full(n, _TOUCH_M, dtype=np.float32)
        arguments = start[chosen], end[chosen], cones.radii[chosen]
        see_cones(rays.columns, *arguments, depth, miss, cone, at)
        found = np.where(cone >= 0, chosen[cone], -1)
        along = np.minimum((at * zones.n[found]).astype(np.int64), zones.n[found] - 1)
        return _Seen(found, np.where(found >= 0, zones.first[found] + along, -1), depth, miss)


@dataclass(frozen=True, eq=False)
class _Seen:
    """What is seen in pixels: cone and zone (M,), -1 for none; depth, inf where a ray only passes by, and by how much
    it misses, m."""

    cone: NDArray[np.int64]
    zone: NDArray[np.int64]
    depth: NDArray[np.float32]
    miss: NDArray[np.float32]
