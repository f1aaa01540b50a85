"""The skeleton, the mesh round it and its voxels."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mocap.data import LANDMARKS, VoxelGrid
from mocap.geometry.surface_nets import surface_nets
from mocap.synth.body import Body, build_body, mesh_volume_and_centroid
from mocap.synth.figure import (
    JOINT,
    JOINTS,
    SIDES,
    TURNING_CENTRES,
    TURNING_SPREAD,
    forward_kinematics,
    landmarks_of,
    make_figure,
    rotation_about,
)
from mocap.synth.voxelise import solid_voxels

CELL_M = 0.024  # coarser than the default: the tests are about shape, not finish


@pytest.fixture(scope="module", params=[("male", 1.83, 1.1), ("female", 1.61, 0.9)], ids=lambda p: p[0])
def body(request: pytest.FixtureRequest) -> Body:
    sex, height, build = request.param
    return build_body(make_figure(height, sex, build, rng=np.random.default_rng(3)), cell_m=CELL_M)


def _random_pose(rng: np.random.Generator) -> np.ndarray:
    rotations = np.tile(np.eye(3), (1, len(JOINTS), 1, 1))
    rotations[0, 0] = rotation_about(2, rng.uniform(0, 6))
    for side, sign in SIDES:
        rotations[0, JOINT[f"{side}_shoulder"]] = rotation_about(0, sign * rng.uniform(0.1, 1.4))
        rotations[0, JOINT[f"{side}_elbow"]] = rotation_about(1, -rng.uniform(0, 1.5))
        rotations[0, JOINT[f"{side}_hip"]] = rotation_about(1, rng.uniform(-0.8, 0.2))
        rotations[0, JOINT[f"{side}_knee"]] = rotation_about(1, rng.uniform(0, 1.0))
    return rotations


def test_surface_nets_of_a_ball_is_closed_and_has_its_volume() -> None:
    n, cell, radius = 40, 0.05, 0.8
    axis = cell * (np.arange(n) - n / 2)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    vertices, faces = surface_nets(np.sqrt(x**2 + y**2 + z**2) - radius, np.full(3, axis[0]), cell)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert np.abs(np.linalg.norm(vertices, axis=1) - radius).max() < 0.5 * cell
    # Chords cut corners: the mesh of a convex body is a little small, never large by more than rounding.
    assert 0.97 < mesh.volume / (4 / 3 * np.pi * radius**3) < 1.001


def test_surface_nets_refuses_a_surface_that_leaves_the_grid() -> None:
    with pytest.raises(ValueError, match="leaves the grid"):
        surface_nets(np.full((4, 5, 6), -1.0), np.zeros(3), 0.1)


def test_stature_is_the_sum_of_the_skeleton(body: Body) -> None:
    figure = body.figure
    position, rotation = forward_kinematics(
        figure.offsets,
        np.tile(np.eye(3), (1, len(JOINTS), 1, 1)),
        np.array([[0, 0, figure.standing_height_m]]),
    )
    landmarks = dict(zip(LANDMARKS, landmarks_of(figure, position, rotation)[0], strict=True))
    # Barefoot stature + sole + hair.
    assert 0.0 < landmarks["head"][2] - figure.stature_m < 0.04
    assert landmarks["left_hip"][1] > 0 > landmarks["right_hip"][1]
    assert np.allclose(landmarks["pelvis"], 0.5 * (landmarks["left_hip"] + landmarks["right_hip"]))
    vertices, _ = body.pose(position[0], rotation[0])
    assert abs(vertices[:, 2].min()) < 0.004
    assert abs(vertices[:, 2].max() - landmarks["head"][2]) < 0.003


def test_mesh_is_watertight_oriented_and_of_human_volume(body: Body) -> None:
    mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    volume, centroid = mesh_volume_and_centroid(body.vertices, body.faces)
    assert np.isclose(volume, mesh.volume)
    assert np.allclose(centroid, mesh.center_mass, atol=1e-6)
    # People have about the density of water; body-mass index of the volume between slim and heavy.
    assert 15 < volume * 1000 / body.figure.stature_m**2 < 34
    assert np.mean(np.sum(mesh.vertex_normals * body.normals, axis=1) > 0.8) > 0.98


def test_skinning_weights_are_a_partition_of_few_bones(body: Body) -> None:
    assert np.allclose(body.weights.sum(axis=1), 1)
    assert body.weights.min() >= 0
    assert np.count_nonzero(body.weights, axis=1).max() <= 4


def test_rest_pose_returns_the_rest_mesh(body: Body) -> None:
    vertices, normals = body.pose(body.rest_position, body.rest_rotation)
    assert np.allclose(vertices, body.vertices, atol=1e-12)
    assert np.allclose(normals, body.normals, atol=1e-9)


def test_joint_landmarks_lie_inside_the_posed_mesh(body: Body) -> None:
    rng = np.random.default_rng(5)
    for _ in range(3):
        position, rotation = forward_kinematics(
            body.figure.offsets, _random_pose(rng), np.array([[0.3, -0.2, 1.0]])
        )
        vertices, _ = body.pose(position[0], rotation[0])
        landmarks = landmarks_of(body.figure, position, rotation)[0]
        grid = VoxelGrid.from_bounds(vertices.min(axis=0) - 0.05, vertices.max(axis=0) + 0.05, 0.01)
        solid = solid_voxels(vertices, body.faces, grid)
        inner = np.array([n != "head" for n in LANDMARKS])
        assert np.isin(grid.voxels_of(landmarks[inner]), solid).all()
        # The top of the head is on the surface.
        head = landmarks[LANDMARKS.index("head")]
        assert np.linalg.norm(vertices - head, axis=1).min() < CELL_M


def test_segments_turn_where_those_of_skinned_people_do(body: Body) -> None:
    """Hips lie far apart, and behind the middle of the trunk over them; the leg's flesh goes through knee and ankle."""
    figure, h = body.figure, body.figure.stature_m
    upright = np.tile(np.eye(3), (1, len(JOINTS), 1, 1))
    position, rotation = forward_kinematics(figure.offsets, upright, np.zeros((1, 3)))
    joints = position[0]
    vertices, _ = body.pose(joints, rotation[0])
    centres = TURNING_CENTRES[figure.sex]
    hip = joints[JOINT["left_hip"]] / h
    assert abs(hip[1] - centres.hip_half) < 2.1 * TURNING_SPREAD.hip_half
    shoulders = joints[[JOINT["left_shoulder"], JOINT["right_shoulder"]], 2].mean() / h
    trunk = np.abs(vertices[:, 2] / h - 0.5 * shoulders) < 0.012
    trunk &= np.abs(vertices[:, 1] / h) < 0.12
    middle = 0.5 * (vertices[trunk, 0].min() + vertices[trunk, 0].max()) / h
    own_back = figure.surface[JOINT["pelvis"], 0] / h - centres.hip_back
    assert -0.032 < hip[0] - middle + own_back < -0.014  # MakeHuman shapes: -0.024 men, -0.026 women
    for name, owners in (("knee", ("hip", "knee")), ("ankle", ("knee", "ankle"))):
        at = joints[JOINT[f"left_{name}"]]
        own = np.isin(body.weights.argmax(axis=1), [JOINT[f"left_{o}"] for o in owners])
        own &= np.abs(vertices[:, 2] - at[2] - (0.03 * h if name == "ankle" else 0.0)) < 0.012 * h
        ring = vertices[own, :2]
        assert np.linalg.norm(0.5 * (ring.min(axis=0) + ring.max(axis=0)) - at[:2]) < 0.008 * h


def test_people_turn_at_places_of_their_own() -> None:
    figures = [make_figure(1.75, "male", 1.0, rng=np.random.default_rng(k)) for k in range(40)]
    back = np.array([f.surface[JOINT["pelvis"], 0] / f.stature_m for f in figures])
    assert 0.6 < back.std() / TURNING_SPREAD.hip_back < 1.3
    assert abs(back.mean() - TURNING_CENTRES["male"].hip_back) < 0.5 * TURNING_SPREAD.hip_back
    equal = [make_figure(1.75, "male", 1.0, rng=np.random.default_rng(k), variation=0.0) for k in range(2)]
    assert np.array_equal(equal[0].offsets, equal[1].offsets)


def test_limb_lengths_do_not_depend_on_the_pose(body: Body) -> None:
    rng = np.random.default_rng(6)
    lengths = []
    for _ in range(4):
        position, _ = forward_kinematics(body.figure.offsets, _random_pose(rng), rng.normal(size=(1, 3)))
        p = position[0]
        lengths.append(
            [
                np.linalg.norm(p[JOINT[a]] - p[JOINT[b]])
                for a, b in (("left_hip", "left_knee"), ("right_elbow", "right_wrist"))
            ]
        )
    assert np.ptp(lengths, axis=0).max() < 1e-12
    assert np.isclose(lengths[0][0], body.figure.thigh_m)


def test_voxels_of_a_ball_are_its_voxel_centres() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.31)
    center = np.array([0.021, -0.013, 0.4])
    grid = VoxelGrid.from_bounds(np.array([-0.5, -0.4, 0.0]), np.array([0.45, 0.5, 1.0]), 0.03)
    found = solid_voxels(ball.vertices + center, ball.faces, grid)
    distance = np.linalg.norm(grid.centers(np.arange(grid.n_voxels, dtype=np.int32)) - center, axis=1)
    assert np.array_equal(found, np.unique(found))
    assert (
        set(np.flatnonzero(distance < 0.309)) <= set(found.tolist()) <= set(np.flatnonzero(distance <= 0.31))
    )


def test_voxels_of_crossing_boxes_are_their_union() -> None:
    a = trimesh.creation.box(extents=(0.4, 0.2, 0.3))
    b = a.copy()
    b.apply_translation([0.13, 0.05, 0.07])
    both = trimesh.util.concatenate([a, b])
    grid = VoxelGrid.from_bounds(np.full(3, -0.45), np.full(3, 0.5), 0.05)
    union = np.union1d(solid_voxels(a.vertices, a.faces, grid), solid_voxels(b.vertices, b.faces, grid))
    assert np.array_equal(solid_voxels(both.vertices, both.faces, grid), union)
    assert len(union) > 0


def test_voxels_outside_the_grid_are_left_out() -> None:
    a = trimesh.creation.box(extents=(0.4, 0.2, 0.3))
    grid = VoxelGrid(np.array([5.0, 5.0, 5.0]), (3, 4, 5), 0.1)
    assert len(solid_voxels(a.vertices, a.faces, grid)) == 0


def test_make_figure_refuses_impossible_people() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="stature_m"):
        make_figure(3.0, "male", 1.0, rng=rng)
    with pytest.raises(ValueError, match="sex"):
        make_figure(1.7, "martian", 1.0, rng=rng)
