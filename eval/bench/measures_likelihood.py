"""Likelihood and refinement: the default body against its own hull at 2 cm, one thread.

Times are CPU times of the measuring thread, because microseconds of wall time say more about the neighbours.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from eval.bench.registry import measure
from mocap.data import VoxelGrid
from mocap.data.problem import limbs_of
from mocap.likelihood.residuals import SurfaceProblem
from mocap.likelihood.voxels import VoxelProblem

Array = NDArray[np.float64]

_SEED = 11
_HEIGHT_M = 1.75
_VOXEL_M = 0.02
_N_PARTICLES = 600
_N_NUMPY = 4
_FPS = 25.0
# Legs in stride, one arm raised, elbows bent: parts meet as they do in a clip.
_POSE = {
    "right_hip_y": -0.4,
    "left_hip_y": 0.3,
    "left_knee_y": 0.4,
    "right_shoulder_x": 0.6,
    "left_shoulder_z": -0.5,
    "left_elbow_z": -0.7,
    "right_elbow_z": 0.5,
}


@dataclass(frozen=True, eq=False)
class BodyScene:
    """voxels, surface : the problems of one frame.  truth : (D,).  particles : (N, D), as the first layer has them."""

    voxels: VoxelProblem
    surface: SurfaceProblem
    truth: Array
    particles: Array


@lru_cache(maxsize=1)
def body_scene() -> BodyScene:
    """The body of 1.75 m in its own hull, a voxel larger all around, as carving leaves it."""
    from mocap.body import build_look_up_table, cones_of, load_body_model, neutral_state, scale_body
    from mocap.body.flesh import cone_distances
    from mocap.likelihood.residuals import SurfaceFitSettings, hull_surface
    from mocap.likelihood.voxels import VoxelLikelihoodSettings
    from mocap.pose.volume import PersonHull, pack_volume
    from mocap.volume import surface_voxels

    body = scale_body(load_body_model("anthropometric"), _HEIGHT_M)
    grid = VoxelGrid.from_bounds(np.array([-2.5, -2.0, 0.0]), np.array([2.5, 2.0, 2.2]), _VOXEL_M)
    truth = neutral_state(body)
    for name, value in _POSE.items():
        truth[body.layout.names.index(name)] = value
    start, end = cones_of(body, truth)
    reach = body.cones.radii.max() + _VOXEL_M
    low = np.maximum(np.minimum(start, end).min(axis=0) - reach, grid.origin)
    high = np.minimum(np.maximum(start, end).max(axis=0) + reach, grid.upper - 1e-9)
    first, last = (np.floor((corner - grid.origin) / _VOXEL_M).astype(int) for corner in (low, high))
    axes = (np.arange(a, b + 1) for a, b in zip(first, last, strict=True))
    near = grid.linear(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3))
    distance = cone_distances(grid.centers(near), start, end, body.cones.radii, body.round_ends)
    voxels = near[distance.min(axis=1) <= _VOXEL_M]
    hull = PersonHull(voxels, surface_voxels(voxels, grid))
    volume = pack_volume(grid, hull, 1.0)
    table = build_look_up_table(body, _VOXEL_M)
    problem = VoxelProblem(body, table, volume, VoxelLikelihoodSettings())
    surface = hull_surface(hull.voxels, hull.is_surface, grid, volume)
    particles = problem.propagate(
        np.tile(truth, (_N_PARTICLES, 1)), 0.5 * body.max_speed / _FPS, rng=np.random.default_rng(_SEED)
    )
    return BodyScene(problem, SurfaceProblem(body, table, surface, SurfaceFitSettings()), truth, particles)


def _thread_medians(functions: Sequence[Callable[[], object]], n_rounds: int) -> list[float]:
    """Median CPU time (s) of each function on this thread, called in turn after one unmeasured call."""
    for function in functions:
        function()
    times: list[list[float]] = [[] for _ in functions]
    for _ in range(n_rounds):
        for function, own in zip(functions, times, strict=True):
            start = time.thread_time()
            function()
            own.append(time.thread_time() - start)
    return [statistics.median(own) for own in times]


@measure("likelihood_exact_us", unit="us", better="lower")
def likelihood_exact_us() -> float:
    """One particle's log-likelihood with all points of the look-up table, in a batch of 600."""
    s = body_scene()
    return _thread_medians([lambda: s.voxels.log_likelihood(s.particles)], 15)[0] / _N_PARTICLES * 1e6


@measure("likelihood_fast_us", unit="us", better="lower")
def likelihood_fast_us() -> float:
    """The same with the fast likelihood and its default sample; the scene's correlation with the exact one holds."""
    s = body_scene()
    fast = replace(s.voxels, settings=replace(s.voxels.settings, kind="fast"))
    values = [p.log_likelihood(s.particles).sum(axis=1) for p in (s.voxels, fast)]
    assert np.corrcoef(*values)[0, 1] > 0.98
    return _thread_medians([lambda: fast.log_likelihood(s.particles)], 15)[0] / _N_PARTICLES * 1e6


@measure("likelihood_limb_us", unit="us", better="lower")
def likelihood_limb_us() -> float:
    """One arm's exact log-likelihood while the rest of the body holds still, in a batch of 600."""
    problem, truth = body_scene().voxels, body_scene().truth
    limb = limbs_of(problem.layout)[1]
    columns = problem.layout.columns_of(limb)
    states = np.tile(truth, (_N_PARTICLES, 1))
    states[:, columns] += np.random.default_rng(_SEED).normal(0.0, 0.2, (_N_PARTICLES, len(columns)))
    value = problem.limb_log_likelihood(truth, limb)
    return _thread_medians([lambda: value(states)], 15)[0] / _N_PARTICLES * 1e6


@measure("likelihood_over_numpy", unit="x", better="higher")
def likelihood_over_numpy() -> float:
    """How many times faster than the same scores written with numpy; both give the same numbers."""
    from mocap.likelihood.voxels import part_scores, part_scores_numpy

    s = body_scene()
    args = s.voxels.body, s.voxels.table, s.voxels.volume
    few = s.particles[:_N_NUMPY]
    assert np.array_equal(part_scores(*args, few).occupied, part_scores_numpy(*args, few).occupied)
    ours, theirs = _thread_medians(
        [lambda: part_scores(*args, s.particles), lambda: part_scores_numpy(*args, few)], 7
    )
    return (theirs / _N_NUMPY) / (ours / _N_PARTICLES)


@measure("refine_ms", unit="ms", better="lower")
def refine_ms() -> float:
    """One refinement as the pose stage calls it, from starts 2 cm and 0.05 rad off the truth; mean of 8 starts."""
    from mocap.filters.refine import RefineSettings, refine

    s = body_scene()
    is_position = s.surface.body.is_position
    settings = RefineSettings(prior_std=np.where(is_position, 0.1, 0.5))
    noise = np.random.default_rng(_SEED).normal(size=(8, len(s.truth))) * np.where(is_position, 0.02, 0.05)
    layout = s.surface.layout
    starts = np.clip(s.truth + noise, layout.lower, layout.upper)

    def all_starts() -> None:
        for start in starts:
            refine(s.surface, start, settings)

    return _thread_medians([all_starts], 7)[0] / len(starts) * 1e3
