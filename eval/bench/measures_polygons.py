"""Colour likelihood of polygons: parts scored per second on one thread (CPU time)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from eval.bench.registry import interleaved_medians, measure
from mocap.polygons.likelihood import PolygonProblem

_SEED = 13
_N_PARTICLES = 600
_N_NUMPY = 2


@lru_cache(maxsize=1)
def _scene() -> tuple[PolygonProblem, NDArray[np.float64]]:
    """An object of 4 arms of 5 parts in 800 x 640 and particles around its true state."""
    from mocap.polygons.likelihood import random_walk_std
    from mocap.synth.polygons import PolygonSceneSettings, make_polygon_scene

    scene = make_polygon_scene(PolygonSceneSettings(n_arms=4, n_levels=6), rng=np.random.default_rng(_SEED))
    problem = scene.problem(60)
    start = np.repeat(scene.states[60:61], _N_PARTICLES, axis=0)
    return problem, problem.propagate(
        start, random_walk_std(problem.layout), rng=np.random.default_rng(_SEED)
    )


@measure("polygon_part_evals_per_s", unit="1/s", better="higher")
def polygon_part_evals_per_s() -> float:
    """Histogram, distance and log-likelihood of one part of one particle, in a batch of 600 particles x 21 parts."""
    problem, particles = _scene()
    seconds = interleaved_medians([lambda: problem.log_likelihood(particles)], 15)[0]
    return _N_PARTICLES * problem.layout.n_parts / seconds


@measure("polygon_over_numpy", unit="x", better="higher")
def polygon_over_numpy() -> float:
    """How many times faster than the same scores with numpy; both give the same numbers."""
    from mocap.polygons.likelihood import polygon_scores, polygon_scores_numpy

    problem, particles = _scene()
    args = problem.tree, problem.bins, problem.reference
    few = particles[:_N_NUMPY]
    assert np.allclose(polygon_scores(*args, few)[0], polygon_scores_numpy(*args, few)[0], atol=1e-12)
    ours, theirs = interleaved_medians(
        [lambda: polygon_scores(*args, particles), lambda: polygon_scores_numpy(*args, few)], 7
    )
    return (theirs / _N_NUMPY) / (ours / _N_PARTICLES)
