"""The particle-filter tracker: every particle is an ellipsoid that stands on the floor.  Source: CF 4.3.2."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.tracking import _kernels
from mocap.tracking.claims import MIN_HEIGHT_M, Claim, Frame
from mocap.tracking.state import Track


def start(track: Track, frame: Frame, claim: Claim, *, rng: np.random.Generator) -> Track:
    """Particles about the position of a new track."""
    n = frame.settings.samples
    noise = rng.normal(size=(n, 3)) * np.array(frame.settings.propagation_std_m)
    return track.replace(samples=track.xyz + noise, weights=np.full(n, 1.0 / n), efficiency=1.0)


def estimate(track: Track, others: Array, frame: Frame, *, rng: np.random.Generator) -> Track:
    """Resample, propagate, weigh and average the particles of one track.

    others : (L, 2) m, xy of the other targets.
    Returns the track with its new particles; xyz and covariance are their mean and covariance. When all weights are
    zero the predicted position stays and the efficiency is 0.
    Source: CF Eq. 4.8-4.12.
    """
    settings = frame.settings
    n = settings.samples
    chosen = systematic(track.weights, n, float(rng.random()))
    noise = rng.normal(size=(n, 3)) * np.array(settings.propagation_std_m)
    particles = track.samples[chosen] + noise
    raw, colour = particle_likelihoods(particles, track.histogram, frame)
    likelihood = raw
    if track.histogram is not None and frame.bins is not None:
        likelihood = (1.0 - settings.colour_weight) * raw + settings.colour_weight * colour
    weights = likelihood * exclusion(
        particles[:, :2], others, settings.semi_axis_xy_m, settings.exclusion_scale
    )
    total = float(weights.sum())
    if not total > 0.0 or not raw.any():
        return track.replace(samples=particles, weights=np.full(n, 1.0 / n), efficiency=0.0)
    weights = weights / total
    mean = weights @ particles
    centred = particles - mean
    covariance = (weights[:, None] * centred).T @ centred
    return track.replace(
        xyz=mean,
        covariance=covariance,
        samples=particles,
        weights=weights,
        efficiency=float(likelihood.mean()),
    )


def particle_likelihoods(particles: Array, histogram: Array | None, frame: Frame) -> tuple[Array, Array]:
    """Likelihoods of ellipsoids standing at particles (P, 3) m: of overlap (P,), of colour (P,), each in 0 .. 1.

    histogram : (9261,) of the target; None gives colour 0.  Source: CF Eq. 4.9, 4.10.
    """
    settings = frame.settings
    radius, side = settings.semi_axis_xy_m, settings.voxel_size_m
    centers = frame.voxels.centers
    margin = radius + side
    lower = particles.min(axis=0) - margin
    upper = particles.max(axis=0) + margin
    p = frame.parts
    near = np.empty(len(p.order), dtype=np.int64)
    near = near[: _kernels.rows_in_box(centers, p.order, p.start, p.lower, p.upper, lower, upper, near)]
    raw, colour = np.zeros(len(particles)), np.zeros(len(particles))
    if len(near):
        points = centers[near]
        # Half a voxel below the first centre: indices of the crop are those of the lattice.
        first, last = _kernels.extent(points)
        corner = first - side / 2
        shape = np.floor((last - corner) / side).astype(np.int64) + 1
        below = np.zeros((shape[0], shape[1], shape[2] + 1), dtype=np.int16)
        _kernels.fill_columns(points, corner, side, below)
        _kernels.overlap_shares(particles, radius, MIN_HEIGHT_M, side, corner, below, raw)
        if histogram is not None and frame.bins is not None:
            bins = frame.bins[near]
            has = bins >= 0
            root = np.sqrt(histogram.astype(np.float64))
            _kernels.colour_shares(particles, radius, MIN_HEIGHT_M, points[has], bins[has], root, colour)
    return raw, colour


def exclusion(points_xy: Array, others_xy: Array, radius_m: float, scale: float = 1.0) -> Array:
    """Factor in 0 .. 1 by which points (P, 2) m are punished for standing where another target is, (P,).

    others_xy : (L, 2) m, the other targets' last estimates; L = 0 gives 1.  k = scale / radius_m**2.
    Source: CF Eq. 4.12-4.13. Departs from CF Eq. 4.13: printed, it compares two targets and not the particle with a
    target, so that every particle of a target would get the same factor (reading guide 4).
    """
    gap = ((points_xy[:, None, :] - others_xy[None, :, :]) ** 2).sum(axis=2)
    return np.prod(1.0 - np.exp(-scale / radius_m**2 * gap), axis=1)


def systematic(weights: Array, n: int, offset: float) -> NDArray[np.int64]:
    """n indices by systematic resampling; weights (m,) with sum 1, offset in [0, 1). CF Alg. 2."""
    edges = np.cumsum(weights)
    places = (np.arange(n) + offset) / n * edges[-1]
    # Never beyond the last sample of positive weight, whatever rounding does to the sum.
    last = int(np.flatnonzero(weights > 0)[-1])
    return np.minimum(np.searchsorted(edges, places, side="right"), last).astype(np.int64)
