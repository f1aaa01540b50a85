"""Resampling against a named library, and the evidence that poses are compared by (CPU time of one thread)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from eval.bench.measures_likelihood import body_scene
from eval.bench.registry import interleaved_medians, measure
from mocap.likelihood.colours import ColourProblem

_SEED = 5
_N_WEIGHTS = 600
_N_RAYS = 1600


@measure("resampling_over_filterpy", unit="x", better="higher")
def resampling_over_filterpy() -> float:
    """Systematic resampling of 600 weights against filterpy.monte_carlo.systematic_resample."""
    from filterpy.monte_carlo import systematic_resample

    from mocap.filters.resampling import systematic

    rng = np.random.default_rng(_SEED)
    weights = rng.dirichlet(np.full(_N_WEIGHTS, 0.3))
    ours, theirs = interleaved_medians(
        [lambda: systematic(weights, _N_WEIGHTS, rng=rng), lambda: systematic_resample(weights)], 200
    )
    return theirs / ours


@lru_cache(maxsize=1)
def _colours() -> ColourProblem:
    """Rays from four cameras through the surface of the scene's body, in two colours, learnt once."""
    from mocap.likelihood.colours import PixelRays, new_appearance

    s = body_scene()
    points = s.surface.hull.points
    points = points[:: max(1, len(points) // _N_RAYS)]
    rgb = np.where(points[:, 2:] > 1.0, [160, 50, 40], [50, 60, 90]).astype(np.uint8)
    body = s.voxels.body
    angle = np.arange(4) * np.pi / 2
    origins = points.mean(axis=0) + 3.0 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(4)])
    camera = np.sort(np.arange(len(points)) % 4)
    directions = points - origins[camera]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rays = PixelRays(origins, camera, directions, rgb)
    first = ColourProblem(body, rays, new_appearance(body))
    return ColourProblem(body, rays, first.learnt(s.truth, np.ones(body.layout.n_parts, dtype=np.bool_)))


@measure("colour_evidence_ms", unit="ms", better="lower")
def colour_evidence_ms() -> float:
    """Log-ratio of the colours of 1,600 pixels under one pose."""
    colours, state = _colours(), body_scene().truth[None]
    return interleaved_medians([lambda: colours.log_ratio(state)], 50)[0] * 1e3
