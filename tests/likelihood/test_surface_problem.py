"""Hull-to-body distance: gradient against finite differences, normals, and what an empty hull gives."""

from dataclasses import replace

import numpy as np
import pytest
from flesh_voxels import Flesh

from mocap.body import Body, cones_of, joint_transforms, neutral_state
from mocap.body._kernels import chain_axes
from mocap.filters.refine import RefineSettings, refine
from mocap.likelihood.residuals import HullSurface, SurfaceFitSettings, SurfaceProblem, hull_surface
from mocap.likelihood.residuals._pull_kernels import from_axis
from mocap.likelihood.voxels import PackedVolume
from mocap.pose.volume import PersonHull, pack_volume
from mocap.volume import surface_voxels

STEP = 1e-6


def bent(body: Body) -> np.ndarray:
    state = neutral_state(body)
    names = body.layout.names
    for name, value in (
        ("root_yaw", 0.6),
        ("root_pitch", 0.1),
        ("waist_y", 0.2),
        ("right_shoulder_x", 0.5),
        ("left_shoulder_z", -0.6),
        ("left_elbow_z", -0.8),
        ("right_hip_y", -0.5),
        ("right_knee_y", 0.7),
    ):
        state[names.index(name)] = value
    state[:2] = [0.2, -0.1]
    return state


def shell(body: Body, state: np.ndarray, excess: float, residual_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Points around the cones at a known distance, with the normals of the cones; only unambiguous ones."""
    rng = np.random.default_rng(0)
    start, end = cones_of(body, state)
    points, normals, owners = [], [], []
    for k in range(len(start)):
        axis = end[k] - start[k]
        for _ in range(60):
            d = np.cross(axis, rng.normal(size=3))
            d /= np.linalg.norm(d)
            s = rng.uniform(0.1, 0.9)
            radius = body.cones.radii[k, 0] + s * (body.cones.radii[k, 1] - body.cones.radii[k, 0])
            points.append(start[k] + s * axis + (radius + excess + rng.uniform(-1, 1) * residual_m) * d)
            normals.append(d)
            owners.append(k)
    p, n, owner = np.array(points), np.array(normals), np.array(owners)
    axis = end - start
    s = np.clip(np.einsum("mkc,kc->mk", p[:, None] - start, axis) / (axis**2).sum(axis=1), 0, 1)
    away = p[:, None] - (start + s[..., None] * axis)
    length = np.linalg.norm(away, axis=2)
    radius = body.cones.radii[:, 0] + s * (body.cones.radii[:, 1] - body.cones.radii[:, 0])
    cosine = np.einsum("mkc,mc->mk", away, n) / length
    score = np.sort((length - radius - excess) ** 2 + (0.06 * (1 - cosine)) ** 2, axis=1)
    best = np.argmin((length - radius - excess) ** 2 + (0.06 * (1 - cosine)) ** 2, axis=1)
    clear = (best == owner) & (score[:, 1] > score[:, 0] + 1e-4)
    return p[clear], n[clear]


def finite_differences(problem: SurfaceProblem, state: np.ndarray) -> np.ndarray:
    gradient = np.zeros(len(state))
    for i in range(len(state)):
        up, down = state.copy(), state.copy()
        up[i] += STEP
        down[i] -= STEP
        gradient[i] = (problem.normal_equations(up)[0] - problem.normal_equations(down)[0]) / (2 * STEP)
    return gradient


def cylinders(body: Body) -> Body:
    """The body with cones of constant radius."""
    radii = np.repeat(body.cones.radii.mean(axis=1, keepdims=True), 2, axis=1)
    return replace(body, cones=replace(body.cones, radii=radii))


def empty_volume(flesh: Flesh, occupied: bool) -> PackedVolume:
    crop = np.zeros((85, 75, 57), dtype=np.uint8)
    crop[1:-1, 1:-1, 1:-1] = 128 if occupied else 0
    return PackedVolume(crop, np.array([-1, -1, -1]), flesh.grid)


@pytest.mark.parametrize("is_tapered", [False, True])
def test_gradient_of_the_hull_points_is_the_derivative_of_the_cost(
    coarse_flesh: Flesh, is_tapered: bool
) -> None:
    """Exact while the association stays and the normals agree."""
    body = coarse_flesh.body if is_tapered else cylinders(coarse_flesh.body)
    state = bent(body)
    points, normals = shell(body, state, 0.02, 0.02)
    assert len(points) > 400
    problem = SurfaceProblem(
        body,
        coarse_flesh.table,
        HullSurface(points, normals, empty_volume(coarse_flesh, True)),
        SurfaceFitSettings(n_hull_points=10_000, flesh_gain=0.0, penetration_gain=0.0),
    )
    cost, H, g = problem.normal_equations(state)
    assert cost > 0
    expected = finite_differences(problem, state)
    np.testing.assert_allclose(g, expected, atol=1e-6 * np.abs(expected).max() + 1e-9)
    np.testing.assert_allclose(H, H.T, atol=1e-12)
    assert np.linalg.eigvalsh(H).min() > -1e-9


def test_gradient_of_the_flesh_points_is_the_derivative_of_the_cost(coarse_flesh: Flesh) -> None:
    """All flesh is outside of an empty volume: what the second pull adds is exact."""
    body = coarse_flesh.body
    state = bent(body)
    points, normals = shell(body, state, 0.02, 0.05)
    hull = HullSurface(points, normals, empty_volume(coarse_flesh, False))
    args = body, coarse_flesh.table, hull
    with_flesh = SurfaceProblem(
        *args, SurfaceFitSettings(n_hull_points=10_000, flesh_gain=1.0, penetration_gain=0.0)
    )
    without = SurfaceProblem(
        *args, SurfaceFitSettings(n_hull_points=10_000, flesh_gain=0.0, penetration_gain=0.0)
    )
    g = with_flesh.normal_equations(state)[2] - without.normal_equations(state)[2]
    expected = finite_differences(with_flesh, state) - finite_differences(without, state)
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(g, expected, atol=1e-5 * np.abs(expected).max() + 1e-8)


def test_gradient_of_the_penetration_is_the_derivative_of_the_cost(coarse_flesh: Flesh) -> None:
    """A forearm inside the torso is pushed out; rotations that move both parts do not matter. Exact for cylinders."""
    body = cylinders(coarse_flesh.body)
    names = body.layout.names
    state = bent(body)
    for name, value in (("right_shoulder_y", -1.4), ("right_shoulder_x", 1.5), ("right_elbow_z", 1.9)):
        state[names.index(name)] = value
    points, normals = shell(body, state, 0.02, 0.02)
    hull = HullSurface(points, normals, empty_volume(coarse_flesh, True))
    with_it, without = (
        SurfaceProblem(
            body, coarse_flesh.table, hull, SurfaceFitSettings(flesh_gain=0.0, penetration_gain=gain)
        )
        for gain in (1.0, 0.0)
    )
    g = with_it.normal_equations(state)[2] - without.normal_equations(state)[2]
    expected = finite_differences(with_it, state) - finite_differences(without, state)
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(g, expected, atol=1e-4 * np.abs(expected).max())
    together = [names.index(n) for n in ("root_x", "root_y", "root_z", "root_yaw", "root_pitch", "root_roll")]
    np.testing.assert_allclose(g[together], 0.0, atol=1e-12)


def test_penetration_of_two_arms_pushes_both(coarse_flesh: Flesh) -> None:
    """Forearms that cross: what moves the other arm alone pulls the other way. Exact for cylinders."""
    body = cylinders(coarse_flesh.body)
    names = body.layout.names
    state = neutral_state(body)
    for name, value in (
        ("left_shoulder_x", 0.0),
        ("left_shoulder_z", -1.5),
        ("left_elbow_z", -1.6),
        ("right_shoulder_x", 0.0),
        ("right_shoulder_z", 1.5),
        ("right_elbow_z", 1.5),
    ):
        state[names.index(name)] = value
    nothing = HullSurface(np.full((1, 3), 50.0), np.eye(3)[:1], empty_volume(coarse_flesh, True))
    with_it, without = (
        SurfaceProblem(
            body, coarse_flesh.table, nothing, SurfaceFitSettings(flesh_gain=0.0, penetration_gain=gain)
        )
        for gain in (1000.0, 0.0)
    )
    g = with_it.normal_equations(state)[2] - without.normal_equations(state)[2]
    expected = finite_differences(with_it, state) - finite_differences(without, state)
    for side in ("left", "right"):
        assert np.abs(expected[names.index(f"{side}_elbow_z")]) > 0.1 * np.abs(expected).max(), side
    np.testing.assert_allclose(g, expected, atol=1e-4 * np.abs(expected).max())


def _sunk(body: Body, depth_m: float) -> np.ndarray:
    """A bent body whose lowest flesh lies so far below the floor."""
    state = bent(body)
    state[2] -= _lowest(body, state) + depth_m
    return state


def _lowest(body: Body, state: np.ndarray) -> float:
    start, end = cones_of(body, state)
    return float(
        min((start[:, 2] - body.cones.radii[:, 0]).min(), (end[:, 2] - body.cones.radii[:, 1]).min())
    )


def test_gradient_of_the_floor_is_the_derivative_of_the_cost(coarse_flesh: Flesh) -> None:
    body = coarse_flesh.body
    state = _sunk(body, 0.03)
    nothing = HullSurface(np.full((1, 3), 50.0), np.eye(3)[:1], empty_volume(coarse_flesh, True))
    with_it, without = (
        SurfaceProblem(
            body,
            coarse_flesh.table,
            nothing,
            SurfaceFitSettings(flesh_gain=0.0, penetration_gain=0.0, floor_gain=gain),
        )
        for gain in (10.0, 0.0)
    )
    g = with_it.normal_equations(state)[2] - without.normal_equations(state)[2]
    expected = finite_differences(with_it, state) - finite_differences(without, state)
    assert np.abs(expected).max() > 0.05
    np.testing.assert_allclose(g, expected, atol=1e-5 * np.abs(expected).max())
    # Sideways and about the vertical the floor is all the same.
    still = [body.layout.names.index(name) for name in ("root_x", "root_y", "root_yaw")]
    np.testing.assert_allclose(g[still], 0.0, atol=1e-12)


def test_flesh_above_the_floor_is_left_alone(coarse_flesh: Flesh) -> None:
    body, state = coarse_flesh.body, _sunk(coarse_flesh.body, -0.001)
    points, normals = shell(body, state, 0.02, 0.02)
    hull = HullSurface(points, normals, empty_volume(coarse_flesh, True))
    found = [
        SurfaceProblem(body, coarse_flesh.table, hull, SurfaceFitSettings(floor_gain=gain)).normal_equations(
            state
        )
        for gain in (0.1, 0.0)
    ]
    for a, b in zip(*found, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(("depth_m", "least_m", "most_m"), [(0.03, -0.015, 0.0), (0.5, -0.51, -0.42)])
def test_a_hull_below_the_floor_keeps_nobody_there(
    coarse_flesh: Flesh, depth_m: float, least_m: float, most_m: float
) -> None:
    """Shadows under soles lengthen a hull; but a floor that is half a metre off has little say."""
    body = coarse_flesh.body
    state = _sunk(body, depth_m)
    points, normals = shell(body, state, 0.02, 0.0)
    problem = SurfaceProblem(
        body,
        coarse_flesh.table,
        HullSurface(points, normals, empty_volume(coarse_flesh, True)),
        SurfaceFitSettings(n_hull_points=10_000, flesh_gain=0.0),
    )
    std = np.where(np.arange(len(state)) < 3, 0.1, 0.5)
    found, _ = refine(problem, state, RefineSettings(prior_std=std))
    assert least_m < _lowest(body, found) <= most_m


def test_beyond_its_ends_an_axis_is_its_end() -> None:
    start, end = np.zeros((1, 3)), np.array([[0.0, 0.0, 2.0]])
    for at, expected in (
        ((1.0, 0.0, 1.0), (0.5, 1.0, 0.0, 0.0)),
        ((0.0, 0.0, 3.0), (1.0, 0.0, 0.0, 1.0)),
        ((0.0, 3.0, -4.0), (0.0, 0.0, 3.0, -4.0)),
    ):
        np.testing.assert_allclose(from_axis(at, start, end, 0), expected, atol=1e-9)


def test_residuals_of_zero_leave_nothing_to_do(coarse_flesh: Flesh) -> None:
    """Points half a voxel outside the flesh are where the hull's surface is expected."""
    body = cylinders(coarse_flesh.body)
    state = bent(body)
    points, normals = shell(body, state, 0.02, 0.0)
    problem = SurfaceProblem(
        body,
        coarse_flesh.table,
        HullSurface(points, normals, empty_volume(coarse_flesh, True)),
        SurfaceFitSettings(n_hull_points=10_000, flesh_gain=0.0, penetration_gain=0.0, floor_gain=0.0),
    )
    cost, _, g = problem.normal_equations(state)
    assert cost == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(g, 0.0, atol=1e-9)


def test_axes_are_the_derivatives_of_the_frames(coarse_flesh: Flesh) -> None:
    """Closed form: d R_joint / d angle = [axis]x R_joint for every rotation up the chain, zero for others."""
    body = coarse_flesh.body
    state = bent(body)
    J, d_n = len(body.joints), len(body.dof_joint)
    R, t, axes = np.empty((J, 3, 3)), np.empty((J, 3)), np.empty((d_n, 3))
    chain_axes(state, body.chain, R, t, axes)
    R_ref, t_ref = joint_transforms(body, state[None])
    np.testing.assert_allclose(R, R_ref[0], atol=1e-12)
    np.testing.assert_allclose(t, t_ref[0], atol=1e-12)
    moves = body.moves
    for d in range(d_n):
        up, down = state.copy(), state.copy()
        up[body.dof_column[d]] += STEP
        down[body.dof_column[d]] -= STEP
        slope = (joint_transforms(body, up[None])[0][0] - joint_transforms(body, down[None])[0][0]) / (
            2 * STEP
        )
        x, y, z = axes[d]
        skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        for j in range(J):
            np.testing.assert_allclose(slope[j], skew @ R[j] if moves[j, d] else 0.0, atol=1e-8)


def test_a_rotation_moves_its_joint_and_all_below(coarse_flesh: Flesh) -> None:
    body = coarse_flesh.body
    moves = body.moves
    waist = np.flatnonzero(body.dof_joint == body.joints.index("waist"))[0]
    moved = {body.joints[j] for j in np.flatnonzero(moves[:, waist])}
    arms = {f"{side}_{joint}" for side in ("left", "right") for joint in ("shoulder", "elbow")}
    assert moved == {"waist", "neck"} | arms
    assert moves[:, :3].all(), "the root's rotations move everything"


def test_normals_of_a_ball_point_outwards(coarse_flesh: Flesh) -> None:
    grid = coarse_flesh.grid
    center, radius = np.array([0.1, 0.0, 1.1]), 0.4
    every = np.arange(grid.n_voxels, dtype=np.int32)
    voxels = every[np.linalg.norm(grid.centers(every) - center, axis=1) <= radius]
    hull = PersonHull(voxels, surface_voxels(voxels, grid))
    surface = hull_surface(hull.voxels, hull.is_surface, grid, pack_volume(grid, hull, 1.0))
    outwards = surface.points - center
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    cosine = np.sum(outwards * surface.normals, axis=1)
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0)
    # Staircase of a ball of ten voxels' radius, five-voxel window: at worst 16 degrees, 5 on average.
    assert cosine.min() > np.cos(np.deg2rad(20))
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() < 7


def test_an_empty_hull_pulls_nowhere(coarse_flesh: Flesh) -> None:
    nothing = HullSurface(np.zeros((0, 3)), np.zeros((0, 3)), empty_volume(coarse_flesh, False))
    problem = SurfaceProblem(coarse_flesh.body, coarse_flesh.table, nothing, SurfaceFitSettings())
    cost, H, g = problem.normal_equations(neutral_state(coarse_flesh.body))
    assert cost == 0.0
    assert not H.any()
    assert not g.any()
    assert problem.layout.n_columns == 27


def test_measured_points_stand_half_a_voxel_outside_and_the_others_stay(coarse_flesh: Flesh) -> None:
    grid = coarse_flesh.grid
    every = np.arange(grid.n_voxels, dtype=np.int32)
    voxels = every[np.linalg.norm(grid.centers(every) - [0.1, 0.0, 1.1], axis=1) <= 0.3]
    hull = PersonHull(voxels, surface_voxels(voxels, grid))
    surface = hull_surface(hull.voxels, hull.is_surface, grid, pack_volume(grid, hull, 1.0))
    measured = np.full(surface.points.shape, np.nan, dtype=np.float32)
    measured[::3] = surface.points[::3] + np.array([0.01, -0.02, 0.005])
    moved = surface.at(measured)
    half_m = 0.5 * grid.voxel_size_m
    np.testing.assert_allclose(moved.points[::3], measured[::3] + half_m * surface.normals[::3], atol=1e-6)
    rest = np.arange(len(measured)) % 3 > 0
    np.testing.assert_array_equal(moved.points[rest], surface.points[rest])
    assert moved.volume is surface.volume
    doubled = surface.at(measured, 2)
    assert len(doubled.points) == len(measured) + len(measured[::3])
    np.testing.assert_array_equal(doubled.points[:2], moved.points[[0, 0]])
    np.testing.assert_array_equal(doubled.normals[:3], surface.normals[[0, 0, 1]])
