"""Residuals gathered per joint against the plain sum over rows, and the search for the nearest hull point."""

import numpy as np
import pytest
from flesh_voxels import Flesh
from scipy.spatial import cKDTree

from mocap.body import Body, joint_transforms, neutral_state
from mocap.likelihood.residuals import _pull_kernels as kernels
from mocap.likelihood.residuals._surface_kernels import Blocks, nearest_in_blocks, sort_into_blocks

STEP = 1e-6


def posed(body: Body) -> np.ndarray:
    rng = np.random.default_rng(3)
    state = neutral_state(body) + 0.3 * rng.normal(size=body.layout.n_columns)
    state[:3] += [3.0, -2.0, 0.5]  # far from the origin, about which moments are taken
    return state


def gathered(
    body: Body, state: np.ndarray, local: np.ndarray, joint: np.ndarray, n: np.ndarray, r: np.ndarray
):
    J, D = len(body.joints), body.layout.n_columns
    R, t, axes = np.empty((J, 3, 3)), np.empty((J, 3)), np.empty((len(body.dof_joint), 3))
    kernels.chain_axes(state, body.chain, R, t, axes)
    placed = np.empty_like(local)
    kernels.place_points(local, joint, R, t, placed)
    pulls, H, g = np.zeros((J, 7, 6)), np.zeros((D, D)), np.zeros(D)
    for x, direction, residual, j in zip(placed, n, r, joint, strict=True):
        kernels.add_pull(tuple(x), tuple(direction), residual, 0.7, j, pulls)
    kernels.spread_pulls(pulls, body.arrays, t, axes, H, g)
    return placed, H, g


def test_gathered_residuals_are_the_sum_over_the_rows_of_the_jacobian(coarse_flesh: Flesh) -> None:
    """The rows come from finite differences of the points, which know nothing of twists."""
    body = coarse_flesh.body
    rng = np.random.default_rng(0)
    state, M = posed(body), 90
    local, n, r = 0.2 * rng.normal(size=(M, 3)), rng.normal(size=(M, 3)), rng.normal(size=M)
    joint = rng.integers(0, len(body.joints), M)

    def places(s: np.ndarray) -> np.ndarray:
        R, t = joint_transforms(body, s[None])
        return np.einsum("mrc,mc->mr", R[0, joint], local) + t[0, joint]

    rows = np.empty((M, body.layout.n_columns))
    for i in range(len(state)):
        up, down = state.copy(), state.copy()
        up[i] += STEP
        down[i] -= STEP
        rows[:, i] = np.einsum("mr,mr->m", places(up) - places(down), n) / (2 * STEP)
    placed, H, g = gathered(body, state, local, joint, n, r)
    np.testing.assert_allclose(placed, places(state), atol=1e-12)
    np.testing.assert_allclose(H, 0.7 * rows.T @ rows, atol=1e-6)
    np.testing.assert_allclose(g, 0.7 * rows.T @ r, atol=1e-6)


def test_the_world_origin_is_irrelevant(coarse_flesh: Flesh) -> None:
    body = coarse_flesh.body
    rng = np.random.default_rng(1)
    M = 25
    local, n, r = 0.2 * rng.normal(size=(M, 3)), rng.normal(size=(M, 3)), rng.normal(size=M)
    joint = rng.integers(0, len(body.joints), M)
    near = posed(body)
    far = near.copy()
    far[:3] += [40.0, -25.0, 7.0]
    for a, b in zip(
        gathered(body, near, local, joint, n, r)[1:], gathered(body, far, local, joint, n, r)[1:], strict=True
    ):
        np.testing.assert_allclose(a, b, atol=1e-9)


@pytest.mark.parametrize("side", [0.07, 0.4, 5.0])
def test_the_nearest_point_is_that_of_a_search_tree(side: float) -> None:
    rng = np.random.default_rng(2)
    points = rng.normal(size=(700, 3)) * [0.2, 0.5, 0.9] + [1.0, -2.0, 3.0]
    low = points.min(axis=0)
    shape = np.floor((points.max(axis=0) - low) / side).astype(np.int64) + 1
    first, rows = np.empty(int(shape.prod()) + 1, np.int64), np.empty(len(points), np.int64)
    blocks = Blocks(low, side, shape, first, rows)
    sort_into_blocks(points, blocks)
    assert np.array_equal(np.sort(rows), np.arange(len(points)))
    asked = np.concatenate(
        [
            points + 0.01 * rng.normal(size=points.shape),
            points[:60] + rng.normal(size=(60, 3)),
            low + 9 * np.eye(3),
        ]
    )
    expected = cKDTree(points).query(asked)[1]
    found = [nearest_in_blocks(a, points, blocks) for a in asked]
    assert found == expected.tolist()


def test_compiled_and_plain_python_agree(coarse_flesh: Flesh) -> None:
    body = coarse_flesh.body
    rng = np.random.default_rng(5)
    pulls = rng.normal(size=(len(body.joints), 7, 6))
    J = len(body.joints)
    R, t, axes = np.empty((J, 3, 3)), np.empty((J, 3)), np.empty((len(body.dof_joint), 3))
    kernels.chain_axes(posed(body), body.chain, R, t, axes)
    D = body.layout.n_columns
    both = []
    for spread in (kernels.spread_pulls, kernels.spread_pulls.py_func):
        H, g = np.zeros((D, D)), np.zeros(D)
        spread(pulls.copy(), body.arrays, t, axes, H, g)
        both.append((H, g))
    np.testing.assert_allclose(both[0][0], both[1][0], rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(both[0][1], both[1][1], rtol=1e-12, atol=1e-9)
    a, b = np.zeros((2, 7, 6)), np.zeros((2, 7, 6))
    numbers = rng.normal(size=8)
    pull = (tuple(numbers[:3]), tuple(numbers[3:6]), *numbers[6:])
    kernels.add_pull(*pull, 1, a)
    kernels.add_pull.py_func(*pull, 1, b)
    np.testing.assert_allclose(a, b, rtol=1e-12)
