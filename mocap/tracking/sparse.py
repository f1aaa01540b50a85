"""The sparse-sampling tracker: samples live in voxels of the person's surface.  Source: CF 4.3.3.

A sample is a point of the body and not a guess of its place: the centroid of the weighted samples is the estimate.
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.tracking import _kernels
from mocap.tracking.claims import Claim, Frame
from mocap.tracking.colour import N_BINS, similar_threshold
from mocap.tracking.state import Track

WALK_STEPS = 26  # steps in which a sample whose voxel is taken looks for an empty one


def start(track: Track, frame: Frame, claim: Claim, *, rng: np.random.Generator) -> Track:
    """Samples in randomly chosen surface voxels of a new track, each in one of its own."""
    surface = claim.voxels[frame.voxels.is_surface[claim.voxels]]
    pool = surface if len(surface) else claim.voxels
    n = min(frame.settings.samples, len(pool))
    chosen = np.sort(rng.choice(pool, size=n, replace=False))
    return track.replace(
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
        return track.replace(efficiency=0.0)
    crop, lower = _crop(track, frame)
    voxel, placed = np.empty((2, n, 3), dtype=np.int64)
    _kernels.systematic_voxels(track.samples, track.weights, float(rng.random()), lower, side, voxel)
    seed = rng.integers(0, 2**63, dtype=np.uint64)
    placed = placed[: _kernels.scatter(voxel, seed, radius, WALK_STEPS, crop, placed)]
    raw, colour, crowd, weights = np.empty((4, len(placed)))
    if radius <= 2 and sys.byteorder == "little":
        _kernels.local_shares_in_words(placed, radius, crop.view(np.uint64), raw, colour, crowd)
    else:
        _kernels.local_shares(placed, radius, crop, raw, colour, crowd)
    likelihood = raw
    if track.histogram is not None and frame.bins is not None:
        likelihood = (1.0 - settings.colour_weight) * raw + settings.colour_weight * colour
    points = np.empty((len(placed), 3))
    reach = settings.alpha * settings.semi_axis_xy_m
    k = settings.exclusion_scale / settings.semi_axis_xy_m**2
    total, mean, covariance = _kernels.weigh_samples(
        placed,
        lower,
        side,
        track.xyz,
        reach,
        likelihood,
        settings.even_samples,
        crowd,
        others,
        k,
        points,
        weights,
    )
    if not total > 0.0:
        return track.replace(efficiency=0.0)
    return track.replace(
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
    shape = np.floor((high - frame.anchor) / side).astype(np.int64) - first + 1
    shape[2] += -shape[2] % 8  # whole words
    crop = np.zeros(tuple(shape), dtype=np.uint8)
    bins, byte_of = np.zeros(0, dtype=np.int32), np.full(1, _kernels.OCCUPIED, dtype=np.uint8)
    if frame.bins is not None and track.histogram is not None:
        bins = frame.bins
        byte_of = np.full(N_BINS + 1, _kernels.OCCUPIED | _kernels.COLOURED, dtype=np.uint8)
        byte_of[0] = _kernels.OCCUPIED
        threshold = similar_threshold(track.histogram, settings.similar_share)
        _kernels.mark_similar(track.histogram, threshold, _kernels.SIMILAR, byte_of)
    corner = frame.anchor + first * side
    p = frame.parts
    _kernels.fill_crop(
        frame.voxels.centers, p.order, p.start, p.lower, p.upper, bins, byte_of, corner, side, crop
    )
    return crop, corner
