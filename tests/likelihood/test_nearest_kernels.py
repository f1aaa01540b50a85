"""The choice of the nearest cone in single precision against the same written with numpy in double precision."""

import numpy as np
import pytest
from flesh_voxels import Flesh

from mocap.body import neutral_state
from mocap.likelihood.residuals._nearest_kernels import (
    deepest_in_cones,
    nearest_to_points,
    nearest_to_rays,
)
from mocap.likelihood.residuals._pull_kernels import FleshPoints, Placed, place_body

N = 203  # no multiple of a vector's width
EXCESS_M, NORMAL_COST_M = 0.01, 0.06
# Two cones whose scores differ by less are equally good; scores are of the order of 0.01 m^2, places of 3 m.
SAME_M2 = 1e-6


@pytest.fixture
def placed(coarse_flesh: Flesh) -> Placed:
    body = coarse_flesh.body
    state = neutral_state(body) + 0.3 * np.random.default_rng(3).normal(size=body.layout.n_columns)
    state[:3] += [2.0, -1.5, 0.0]
    return place_body(state, body.arrays, FleshPoints(np.zeros((0, 3)), np.zeros(0, dtype=np.int64)))


def units(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=(N, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def around(placed: Placed, rng: np.random.Generator) -> np.ndarray:
    middle = 0.5 * (placed.start + placed.end)
    return middle[rng.integers(0, len(middle), N)] + 0.15 * rng.normal(size=(N, 3))


def columns(*arrays: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.concatenate(arrays, axis=1).T, dtype=np.float32)


def feet(placed: Placed, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place along every axis in [0, 1], (N, K), and the way from there, (N, K, 3)."""
    axis = placed.end - placed.start
    way = points[:, None] - placed.start
    s = np.clip((way * axis).sum(-1) / (axis**2).sum(-1), 0.0, 1.0)
    return s, way - s[..., None] * axis


def scores(way: np.ndarray, radius: np.ndarray, normals: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(way, axis=-1)
    cosine = (way * normals[:, None]).sum(-1) / length
    return (length - radius) ** 2 + (NORMAL_COST_M * (1 - cosine)) ** 2


def test_the_cone_nearest_to_points_is_that_of_double_precision(coarse_flesh: Flesh, placed: Placed) -> None:
    rng, radii = np.random.default_rng(0), coarse_flesh.body.cones.radii
    points, normals = around(placed, rng), units(rng)
    s, way = feet(placed, points)
    score = scores(way, radii[:, 0] + s * (radii[:, 1] - radii[:, 0]) + EXCESS_M, normals)
    nearest = nearest_to_points(columns(points, normals), placed, radii, EXCESS_M, NORMAL_COST_M)
    assert len(np.unique(nearest)) > len(radii) // 2
    np.testing.assert_allclose(score[np.arange(N), nearest], score.min(axis=1), rtol=0, atol=SAME_M2)


def test_the_cone_a_ray_touches_best_is_that_of_double_precision(coarse_flesh: Flesh, placed: Placed) -> None:
    """The place on the axis comes from many tries, not from a formula."""
    rng, radii = np.random.default_rng(1), coarse_flesh.body.cones.radii
    origins = placed.start.mean(axis=0) + 3.0 * units(rng)
    rays = around(placed, rng) - origins
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    normals = np.cross(rays, units(rng))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tries = np.linspace(0.0, 1.0, 2001)
    score = np.empty((N, len(radii)))
    for k in range(len(radii)):
        axis_points = placed.start[k] + tries[:, None] * (placed.end[k] - placed.start[k])
        to_axis = axis_points[None] - origins[:, None]
        off = (to_axis * rays[:, None]).sum(-1)[..., None] * rays[:, None] - to_axis
        at = np.linalg.norm(off, axis=-1).argmin(axis=1)
        radius = radii[k, 0] + tries[at] * (radii[k, 1] - radii[k, 0])
        score[:, k] = scores(off[np.arange(N), at][:, None], radius[:, None], normals)[:, 0]
    nearest = nearest_to_rays(columns(origins, rays, normals), placed, radii, NORMAL_COST_M)
    assert len(np.unique(nearest)) > len(radii) // 2
    # A try lies up to half a thousandth of an axis from the place.
    np.testing.assert_allclose(score[np.arange(N), nearest], score.min(axis=1), rtol=0, atol=1e-4)


def test_a_ray_touches_nothing_that_lies_behind(coarse_flesh: Flesh, placed: Placed) -> None:
    rng, radii = np.random.default_rng(2), coarse_flesh.body.cones.radii
    origins = placed.start.mean(axis=0) + 3.0 * units(rng)
    rays = origins - placed.start.mean(axis=0)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    nearest = nearest_to_rays(columns(origins, rays, units(rng)), placed, radii, NORMAL_COST_M)
    assert (nearest == -1).all()


def test_a_point_lies_deepest_in_a_cone_that_counts(coarse_flesh: Flesh, placed: Placed) -> None:
    rng, body = np.random.default_rng(4), coarse_flesh.body
    cones, radii = body.cones, body.cones.radii
    points = around(placed, rng)
    may_meet = rng.random((body.layout.n_parts, N)) < 0.6
    s, way = feet(placed, points)
    depth = radii[:, 0] + s * (radii[:, 1] - radii[:, 0]) - np.linalg.norm(way, axis=-1)
    depth[~may_meet[cones.part].T] = -np.inf
    deepest = deepest_in_cones(points, may_meet, placed, cones.arrays)
    inside = depth.max(axis=1) > 0
    assert 20 < inside.sum() < N - 20
    np.testing.assert_array_equal(deepest >= 0, inside)
    chosen = depth[np.arange(N), deepest]
    np.testing.assert_allclose(chosen[inside], depth[inside].max(axis=1), rtol=0, atol=1e-5)
