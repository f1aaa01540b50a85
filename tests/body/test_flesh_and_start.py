"""Flesh as look-up tables against volumes of cones; first poses and standing height."""

from dataclasses import replace

import numpy as np
import pytest
from flesh_voxels import Flesh, make_flesh, rasterise
from hypothesis import given
from hypothesis import strategies as st

from mocap.body import (
    Body,
    build_look_up_table,
    candidate_states,
    cones_of,
    head_top,
    height_from_tops,
    is_upright,
    joint_transforms,
    landmarks_of,
    load_body_model,
    neutral_state,
    scale_body,
)
from mocap.body.flesh import cone_distances
from mocap.body.initial import DEFAULT_HEIGHT_M, is_low
from mocap.data import LANDMARKS

THESIS = scale_body(load_body_model("thesis"), 1.76)
DEFAULT = scale_body(load_body_model("anthropometric"), 1.76)


def cone_volume(a: float, b: float, length: float) -> float:
    return np.pi * length * (a * a + a * b + b * b) / 3


def test_cone_distance_of_a_cylinder_is_exact() -> None:
    points = np.array([[0.0, 0.0, 0.5], [0.3, 0.0, 0.2], [0.0, 0.05, 0.9], [0.0, 0.0, 1.5], [0.4, 0.0, 1.3]])
    start, end, radii = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([[0.1, 0.1]])
    flat = cone_distances(points, start, end, radii, False)[:, 0]
    np.testing.assert_allclose(flat, [-0.1, 0.2, -0.05, 0.5, 0.3], atol=1e-12)
    capsule = cone_distances(points, start, end, radii, True)[:, 0]
    np.testing.assert_allclose(capsule, [-0.1, 0.2, -0.05, 0.4, 0.5 - 0.1], atol=1e-12)


@given(
    along=st.floats(-0.4, 1.4),
    across=st.floats(0, 0.4),
    radii=st.tuples(st.floats(0.02, 0.2), st.floats(0.02, 0.2)),
)
def test_sign_of_the_distance_is_membership(along: float, across: float, radii: tuple[float, float]) -> None:
    """Inside a flat-ended cone exactly when between the ends and within the radius there."""
    value = cone_distances(
        np.array([[across, 0.0, along]]),
        np.zeros((1, 3)),
        np.array([[0.0, 0.0, 1.0]]),
        np.array([radii]),
        False,
    )[0, 0]
    here = radii[0] + along * (radii[1] - radii[0])
    inside = 0 <= along <= 1 and across <= here
    if abs(across - here) > 1e-9 and min(abs(along), abs(along - 1)) > 1e-9:
        assert (value <= 0) == inside


@pytest.mark.parametrize(("spacing", "tolerance"), [(0.02, 0.08), (0.01, 0.03)])
def test_volume_of_every_part_is_that_of_its_cone(spacing: float, tolerance: float) -> None:
    """Closed form. Tolerances: a lattice of spacing d errs by about d / r of the surface layer; measured."""
    table = build_look_up_table(THESIS, spacing)
    length = np.linalg.norm(THESIS.cones.end - THESIS.cones.start, axis=1)
    expected = np.array(
        [cone_volume(*r, n) for r, n in zip(THESIS.cones.radii, length, strict=True)]
    )  # one cone per part, in the order of the parts
    np.testing.assert_allclose(table.part_sizes.sum() * spacing**3, expected.sum(), rtol=tolerance)
    np.testing.assert_allclose(table.part_sizes * spacing**3, expected, rtol=3 * tolerance)


def test_number_of_points_scales_with_the_cube_of_the_density() -> None:
    """CF Eq. 6.26: density 2 means an eighth of the points; surface points go with the square."""
    fine, coarse = build_look_up_table(DEFAULT, 0.01), build_look_up_table(DEFAULT, 0.02)
    assert len(fine.points) / len(coarse.points) == pytest.approx(8.0, rel=0.03)
    assert 3.0 < fine.n_surface.sum() / coarse.n_surface.sum() < 5.0
    assert fine.spacing_m == 0.01


@pytest.mark.parametrize("body", [DEFAULT, THESIS], ids=["anthropometric", "thesis"])
def test_segments_are_consistent(body: Body) -> None:
    table = build_look_up_table(body, 0.02)
    sizes = np.diff(table.start)
    assert table.start[0] == 0
    assert table.start[-1] == len(table.points)
    assert np.all(sizes > 0)
    assert np.all((table.n_surface > 0) & (table.n_surface <= sizes))
    assert set(table.part) == set(range(body.layout.n_parts))
    assert table.part_sizes.sum() == len(table.points)
    for s in range(len(sizes)):
        points = table.points[table.start[s] : table.start[s + 1]]
        assert np.linalg.norm(points - table.center[s], axis=1).max() <= table.radius[s] + 1e-6
        mine = (body.cones.joint == table.joint[s]) & (body.cones.part == table.part[s])
        distance = cone_distances(
            points.astype(float),
            body.cones.start[mine],
            body.cones.end[mine],
            body.cones.radii[mine],
            body.round_ends,
        )
        assert distance.min(axis=1).max() <= 1e-6, "a point lies outside its own cones"


def test_exclusive_flesh_shares_no_point_at_rest() -> None:
    """In the rest pose every lattice point belongs to one part; without the rule parts do overlap."""

    def shared(body: Body) -> int:
        table = build_look_up_table(body, 0.02)
        R, t = joint_transforms(body, np.zeros((1, body.layout.n_columns)))
        j = np.repeat(table.joint, np.diff(table.start))
        part = np.repeat(table.part, np.diff(table.start))
        world = np.einsum("mrc,mc->mr", R[0, j], table.points.astype(float)) + t[0, j]
        cell = np.round((world - world.min(axis=0)) / 0.02).astype(int)
        owners = np.unique(np.column_stack([cell, part]), axis=0)
        return len(owners) - len(np.unique(cell, axis=0))

    assert DEFAULT.exclusive
    assert shared(DEFAULT) == 0
    assert shared(replace(DEFAULT, exclusive=False)) > 0


def test_surface_points_are_those_beside_empty_space_at_rest() -> None:
    """Two implementations: a lattice point is surface when one of six steps leads out of every cone."""
    table = build_look_up_table(THESIS, 0.03)
    R, t = joint_transforms(THESIS, np.zeros((1, 27)))
    start, end = cones_of(THESIS, np.zeros(27))
    steps = 0.03 * np.concatenate([np.eye(3), -np.eye(3)])
    for s in range(len(table.joint)):
        j = table.joint[s]
        local = table.points[table.start[s] : table.start[s + 1]].astype(float)
        world = local @ R[0, j].T + t[0, j]
        around = (world[:, None] + steps).reshape(-1, 3)
        out = (cone_distances(around, start, end, THESIS.cones.radii, False).min(axis=1) > 1e-6).reshape(
            -1, 6
        )
        is_surface = np.arange(len(local)) < table.n_surface[s]
        # Points on the very border of a cone may fall either way in float32.
        assert np.mean(out.any(axis=1) == is_surface) > 0.99


@pytest.mark.parametrize("name", ["girdle", "whole"])
@pytest.mark.parametrize("spacing_m", [0.02, 0.03, 0.05, 0.06])
def test_bodies_of_all_sizes_fit_the_usual_voxels(name: str, spacing_m: float) -> None:
    for height_m in (1.2, 1.5, 1.8, 2.0):
        body = scale_body(load_body_model(name), height_m)
        assert (build_look_up_table(body, spacing_m).part_sizes > 0).all()


def test_too_thin_flesh_and_bad_spacings_are_refused() -> None:
    thin = replace(THESIS, cones=replace(THESIS.cones, radii=THESIS.cones.radii * 1e-3))
    with pytest.raises(ValueError, match="too thin"):
        build_look_up_table(thin, 0.03)
    for spacing in (0.0, -0.02, float("nan")):
        with pytest.raises(ValueError, match="spacing_m"):
            build_look_up_table(THESIS, spacing)


# Two lattices that do not meet differ by half a voxel on average.
TOP_TOLERANCE_M = 0.02


@pytest.mark.parametrize("arms_up", [False, True])
@pytest.mark.parametrize("margin_m", [0.0, 0.02])
def test_head_top_is_the_crown_even_below_raised_hands(flesh: Flesh, arms_up: bool, margin_m: float) -> None:
    """With a margin, as few cameras leave it, a forearm is as thick as a crown."""
    state = neutral_state(flesh.body)
    if arms_up:
        for name, value in (("left_shoulder_x", 1.3), ("right_shoulder_x", -1.3)):
            state[flesh.body.layout.names.index(name)] = value
    hull = flesh.hull(state, margin_m=margin_m)
    centers = flesh.grid.centers(hull.voxels)
    crown = landmarks_of(flesh.body, state[None])[0, LANDMARKS.index("head"), 2]
    if arms_up:
        assert centers[:, 2].max() > crown + 0.2
    assert head_top(centers, 0.02) - margin_m == pytest.approx(crown, abs=TOP_TOLERANCE_M)


def test_a_small_head_is_a_head() -> None:
    child = make_flesh("anthropometric", 1.15, 0.02)
    state = neutral_state(child.body)
    centers = child.grid.centers(child.hull(state, margin_m=0.01).voxels)
    crown = landmarks_of(child.body, state[None])[0, LANDMARKS.index("head"), 2]
    assert head_top(centers, 0.02) - 0.01 == pytest.approx(crown, abs=TOP_TOLERANCE_M)


def test_head_top_of_nothing() -> None:
    assert np.isnan(head_top(np.zeros((0, 3)), 0.02))


def test_standing_height_from_tops() -> None:
    tops = np.array([np.nan, *np.linspace(1.70, 1.80, 101)])
    estimate = height_from_tops(tops, 0.02)
    assert estimate.is_measured
    assert estimate.height_m == pytest.approx(1.79 - 0.01)
    for bad in (np.array([]), np.array([np.nan]), np.full(5, 1.2), np.full(5, 2.6)):
        guess = height_from_tops(bad, 0.02)
        assert not guess.is_measured
        assert guess.height_m == DEFAULT_HEIGHT_M


def test_who_stands_is_slender_and_reaches_the_floor() -> None:
    """A hull is a voxel wider than the body, so the flesh here is made with that margin."""
    child, adult = make_flesh("anthropometric", 1.15, 0.02), make_flesh("anthropometric", 1.72, 0.02)
    small = child.grid.centers(child.hull(neutral_state(child.body), margin_m=0.02).voxels)
    standing = adult.hull(neutral_state(adult.body), margin_m=0.02)
    states, labels = candidate_states(adult.body, adult.grid.centers(standing.voxels), np.zeros(1))
    sitting = adult.grid.centers(adult.hull(states[labels.index("sit")], margin_m=0.02).voxels)
    large = adult.grid.centers(standing.voxels)
    assert is_upright(small, 0.02)
    assert is_upright(large, 0.02)
    assert not is_upright(sitting - [0.0, 0.0, sitting[:, 2].min()], 0.02)
    # Behind a table only the upper half is seen: as slender as a child, but it does not reach the floor.
    above = large[large[:, 2] > 0.7]
    assert len(above) * 0.02**3 < 0.032 * head_top(above, 0.02) ** 3
    assert not is_upright(above, 0.02)
    assert not is_upright(np.zeros((0, 3)), 0.02)


def test_a_low_top_is_the_height_of_who_stands_or_nobodys() -> None:
    tops = np.array([np.nan, 0.8, 1.16, 1.18, 1.2, 1.2])
    for upright in (None, np.array([0, 0, 1, 1, 1, 1], dtype=np.bool_), np.zeros(6, dtype=np.bool_)):
        estimate = height_from_tops(tops, 0.02, upright)
        assert not estimate.is_measured
        assert estimate.height_m == DEFAULT_HEIGHT_M
        assert estimate.low_m == pytest.approx(1.19)
    for top, low_m in ((0.69, None), (0.71, 0.7), (1.59, 1.58), (1.61, None), (2.21, None)):
        estimate = height_from_tops(np.full(5, top), 0.02)
        assert estimate.low_m == (None if low_m is None else pytest.approx(low_m))
        assert estimate.is_measured == (top == 1.61)


def test_who_stands_in_few_frames_is_as_tall_as_he_stands_there() -> None:
    """The highest tenth of all frames is that of somebody who rises."""
    lying, standing = np.full(94, 0.6), np.linspace(1.60, 1.70, 6)
    upright = np.repeat([False, True], [94, 6])
    estimate = height_from_tops(np.concatenate([lying, standing]), 0.02, upright)
    assert estimate.is_measured
    assert estimate.height_m == pytest.approx(1.69 - 0.01)
    assert not height_from_tops(np.concatenate([lying, standing]), 0.02, ~upright).is_measured
    # Who bends now and then is no other case: all his frames count, as before.
    bending = np.concatenate([np.linspace(1.40, 1.62, 20), np.full(40, 1.66)])
    estimate = height_from_tops(bending, 0.02, bending > 1.65)
    assert estimate.height_m == pytest.approx(float(np.quantile(bending, 0.9)) - 0.01)


def test_a_hull_that_is_lower_than_who_sits_has_poses_of_who_lies() -> None:
    whole = make_flesh("whole", 1.72, 0.03)
    upright, labels = candidate_states(
        whole.body, np.array([[0, 0, 0], [0, 0, 1.7], [0, 0, 1.7]]), np.zeros(1)
    )
    pitch = whole.body.layout.names.index("root_pitch")
    assert np.abs(upright[:, pitch]).max() < 0.5
    for kind in ("sit", "crouch"):
        seated = whole.grid.centers(whole.hull(upright[labels.index(kind)]).voxels)
        assert not is_low(seated, whole.body)
    flat = np.random.default_rng(0).uniform([-0.8, -0.2, 0], [0.8, 0.2, 0.3], (400, 3))
    assert is_low(flat, whole.body)
    lying, kinds = candidate_states(whole.body, flat, np.array([0.3]))
    assert {"sit", "crouch", "prone", "supine", "all_fours", "on_left_side", "on_right_side"} <= set(kinds)
    assert "stand" not in kinds
    for state, kind in zip(lying, kinds, strict=True):
        centers = whole.grid.centers(whole.hull(state).voxels)
        assert centers[:, 2].min() == pytest.approx(flat[:, 2].min(), abs=0.05)
        assert kind in ("sit", "crouch") or is_low(centers, whole.body), kind
    belly = {kind: _front(whole.body, state)[2] for state, kind in zip(lying, kinds, strict=True)}
    assert belly["prone"] < -0.9 < 0.9 < belly["supine"]


def _front(body: Body, state: np.ndarray) -> np.ndarray:
    return joint_transforms(body, state[None])[0][0, 0, :, 0]


def test_candidates_lie_over_the_hull_and_are_legal(flesh: Flesh) -> None:
    body = flesh.body
    truth = neutral_state(body)
    truth[:2] = [0.4, -0.3]
    truth[body.layout.names.index("root_yaw")] = 0.7
    centers = flesh.grid.centers(flesh.hull(truth).voxels)
    yaws = np.array([0.7, 2.0, -1.0])
    states, labels = candidate_states(body, centers, yaws)
    assert states.shape == (len(labels), body.layout.n_columns)
    assert len(labels) % 3 == 0
    assert np.all(states >= body.layout.lower)
    assert np.all(states <= body.layout.upper)
    yaw = body.layout.names.index("root_yaw")
    i = next(k for k, label in enumerate(labels) if label == "stand" and states[k, yaw] == 0.7)
    error = landmarks_of(body, states[i : i + 1]) - landmarks_of(body, truth[None])
    # The flesh of the cones weighs by length and radius squared, the hull by voxels.
    assert np.linalg.norm(error, axis=-1).max() < 0.04
    standing = set(candidate_states(body, centers, yaws, is_standing=True)[1])
    low = set(candidate_states(body, centers, yaws, is_standing=False)[1])
    assert low == {"sit", "crouch"}
    assert standing | low == set(labels)
    assert not standing & low


def test_candidates_mirror_each_other() -> None:
    """Invariance: mirroring every candidate gives the same set of kinds (left and right are treated alike)."""
    centers = np.random.default_rng(0).uniform([-0.2, -0.2, 0], [0.2, 0.2, 1.7], (400, 3))
    centers = np.concatenate([centers, centers * [1, -1, 1]])
    states, _ = candidate_states(DEFAULT, centers, np.zeros(1))
    names = DEFAULT.layout.names
    swap = [names.index(n.replace("left", "#").replace("right", "left").replace("#", "right")) for n in names]
    sign = np.array([-1.0 if n[-1] in "xz" and n not in ("root_x", "root_z") else 1.0 for n in names])
    sign[names.index("root_y")] = -1.0
    sign[names.index("root_yaw")] = -1.0
    sign[names.index("root_roll")] = -1.0
    mirrored = states[:, swap] * sign
    for state in mirrored:
        assert np.abs(states - state).max(axis=1).min() < 1e-6


def test_no_hull_no_candidates() -> None:
    with pytest.raises(ValueError, match="no hull"):
        candidate_states(DEFAULT, np.zeros((0, 3)), np.zeros(1))


def test_the_rasterised_body_is_the_look_up_table_in_place(flesh: Flesh) -> None:
    """The table's points fall into the voxels of the flesh, but for the rim."""
    state = neutral_state(flesh.body)
    hull = rasterise(flesh.body, flesh.grid, state)
    R, t = joint_transforms(flesh.body, state[None])
    j = np.repeat(flesh.table.joint, np.diff(flesh.table.start))
    world = np.einsum("mrc,mc->mr", R[0, j], flesh.table.points.astype(float)) + t[0, j]
    assert np.isin(flesh.grid.voxels_of(world), hull.voxels).mean() > 0.9
