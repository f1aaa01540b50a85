"""The sparse-sampling tracker: samples live in voxels of the person's surface.  Source: CF 4.3.3.

A sample is a point of the body and not a guess of its place: the centroid of the weighted samples is the estimate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.tracking import _kernels
from mocap.tracking.claims import Claim, Frame
from mocap.tracking.colour import N_BINS, similar_colours
from mocap.tracking.particle import exclusion, systematic
from mocap.tracking.state import Track

Array = NDArray[np.float64]

WALK_STEPS = 26  # steps in which a sample whose voxel is taken looks for an empty one


def start(track: Track, frame: Frame, claim: Claim, *, rng: np.random.Generator) -> Track:
    """Samples in randomly chosen surface voxels of a new track, each in one of its own."""
    surface = claim.voxels[frame.voxels.is_surface[claim.voxels]]
    pool = surface if len(surface) else claim.voxels
    n = min(frame.settings.samples, len(pool))
    chosen = np.sort(rng.choice(pool, size=n, replace=False))
    return track.but(
        samples=frame.voxels.centers[chosen], weights=np.full(n, 1.0 / max(n, 1)), efficiency=1.0
    )


def estimate(track: Track, others: Array, frame: Frame, *, rng: np.random.Generator) -> Track:
    """Resample, scatter, weigh and average the samples of one track.

    others : (L, 2) m, xy of the other targets.
    Returns the track with its new samples; xyz is their weighted mean, the covariance that of the mean. When all
    weights are zero the predicted position stays, the samples of the frame before stay, and the efficiency is 0.
    Source: CF Eq. 4.14-4.19; intra-target rule: no sample further than alpha * s_x from the last estimate.
    Departs from CF Eq. 4.18: with even_samples the weights are divided by the number of samples around, because copies
    of copies gather on one side of a large surface, and a mean over it needs them everywhere.
    """
    settings = frame.settings
    n, side, radius = settings.samples, settings.voxel_size_m, settings.sample_radius
    if not len(track.samples) or not len(frame.voxels):
        return track.but(efficiency=0.0)
    crop, lower = _crop(track, frame)
    chosen = systematic(track.weights, n, float(rng.random()))
    voxel = np.floor((track.samples[chosen] - lower) / side).astype(np.int64)
    seed = rng.integers(0, 2**63, dtype=np.uint64)
    placed = np.empty((n, 3), dtype=np.int64)
    placed = placed[: _kernels.scatter(voxel, seed, radius, WALK_STEPS, crop, placed)]
    raw, colour, crowd = np.empty((3, len(placed)))
    _kernels.local_shares(placed, radius, crop, raw, colour, crowd)
    likelihood = raw
    if track.histogram is not None and frame.bins is not None:
        likelihood = (1.0 - settings.colour_weight) * raw + settings.colour_weight * colour
    points = lower + (placed + 0.5) * side
    reach = settings.alpha * settings.semi_axis_xy_m
    is_near = ((points[:, :2] - track.xyz[:2]) ** 2).sum(axis=1) <= reach**2
    weights = np.where(is_near, likelihood, 0.0)
    weights = weights * exclusion(points[:, :2], others, settings.semi_axis_xy_m, settings.exclusion_scale)
    if settings.even_samples:
        weights = weights / crowd
    total = float(weights.sum())
    if not total > 0.0:
        return track.but(efficiency=0.0)
    weights = weights / total
    mean = weights @ points
    centred = points - mean
    covariance = (weights[:, None] ** 2 * centred).T @ centred
    return track.but(
        xyz=mean,
        covariance=covariance,
        samples=points,
        weights=weights,
        efficiency=float(likelihood.mean()),
    )


def _crop(track: Track, frame: Frame) -> tuple[NDArray[np.uint8], Array]:
    """Occupancy and colours about one track as a dense block, and the block's lower corner (3,) m.

    Voxels and samples share one lattice, through the first voxel of the frame.
    """
    settings = frame.settings
    side = settings.voxel_size_m
    margin = (2 * settings.sample_radius + 1) * side
    reach = settings.alpha * settings.semi_axis_xy_m + margin
    low = np.array([track.xyz[0] - reach, track.xyz[1] - reach, track.samples[:, 2].min() - margin])
    high = np.array([track.xyz[0] + reach, track.xyz[1] + reach, track.samples[:, 2].max() + margin])
    first = np.floor((low - frame.anchor) / side).astype(np.int64)
    last = np.floor((high - frame.anchor) / side).astype(np.int64)
    crop = np.zeros(tuple(last - first + 1), dtype=np.uint8)
    is_similar = np.zeros(N_BINS, dtype=np.bool_)
    bins = frame.bins
    if bins is None or track.histogram is None:
        bins = np.full(len(frame.voxels), -1, dtype=np.int32)
    else:
        is_similar = similar_colours(track.histogram, settings.similar_share)
    lower = frame.anchor + first * side
    _kernels.fill_crop(frame.voxels.centers, bins, is_similar, lower, side, crop)
    return crop, lower
