"""Voxel likelihood: compiled kernel against numpy, closed forms, and where the maximum lies."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from flesh_voxels import Flesh, make_flesh

from mocap.body import joint_transforms, landmarks_of, neutral_state
from mocap.data import VoxelGrid
from mocap.data.problem import limbs_of
from mocap.likelihood.voxels import (
    PackedVolume,
    PartScores,
    VoxelLikelihoodSettings,
    VoxelProblem,
    factorised_log_likelihood,
    global_log_likelihood,
    part_scores,
    part_scores_numpy,
)
from mocap.likelihood.voxels import _exact_kernels as _kernels
from mocap.likelihood.voxels._exact_kernels import part_scores_kernel
from mocap.likelihood.voxels.exact import SURFACE_MAX, held_body, selected
from mocap.pose.volume import PersonHull, pack_volume

FIELDS = ("out", "double", "occupied", "surface")


def volume_of(flesh: Flesh, hull: PersonHull) -> PackedVolume:
    return pack_volume(flesh.grid, hull, 1.0)


def assert_same(a: PartScores, b: PartScores) -> None:
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field), err_msg=field)


def scatter(flesh: Flesh, n: int, std_m: float, std_rad: float, seed: int = 0) -> np.ndarray:
    truth = neutral_state(flesh.body)
    std = np.where(np.arange(27) < 3, std_m, std_rad)
    noise = np.random.default_rng(seed).normal(size=(n, 27)) * std
    return np.clip(truth + noise, flesh.body.layout.lower, flesh.body.layout.upper)


@pytest.fixture(scope="module")
def volume(coarse_flesh: Flesh) -> PackedVolume:
    return volume_of(coarse_flesh, coarse_flesh.hull(neutral_state(coarse_flesh.body)))


@pytest.mark.parametrize(("std_m", "std_rad"), [(0.0, 0.0), (0.03, 0.1), (0.2, 0.8), (1.5, 3.0)])
def test_kernel_is_the_numpy_twin(
    coarse_flesh: Flesh, volume: PackedVolume, std_m: float, std_rad: float
) -> None:
    states = scatter(coarse_flesh, 23, std_m, std_rad)
    args = coarse_flesh.body, coarse_flesh.table, volume
    assert_same(part_scores(*args, states), part_scores_numpy(*args, states))


def test_kernel_is_the_numpy_twin_at_two_centimetres(flesh: Flesh) -> None:
    volume = volume_of(flesh, flesh.hull(neutral_state(flesh.body)))
    states = scatter(flesh, 9, 0.05, 0.3, seed=4)
    args = flesh.body, flesh.table, volume
    fast, slow = part_scores(*args, states), part_scores_numpy(*args, states)
    assert_same(fast, slow)
    assert fast.double.max() > 0, "the scene must exercise double occupancy"


def test_nan_and_far_away_states(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    states = scatter(coarse_flesh, 4, 0.02, 0.1)
    states[1, 0] = np.nan
    states[2, 9] = np.nan
    states[3, :3] = [50.0, -80.0, 9.0]
    args = coarse_flesh.body, coarse_flesh.table, volume
    fast = part_scores(*args, states)
    assert_same(fast, part_scores_numpy(*args, states))
    assert np.all(fast.occupied[1] == 0)
    assert np.all(fast.out[3] == 1)
    assert np.all(fast.double[3] == 0)
    assert np.all(fast.surface[3] == 1)


@pytest.mark.parametrize("shape", [(1, 1, 1), (3, 2, 1), (4, 5, 6)])
def test_tiny_crops(coarse_flesh: Flesh, shape: tuple[int, int, int]) -> None:
    """A crop smaller than the body, with one occupied voxel where there is an inside."""
    crop = np.zeros(shape, dtype=np.uint8)
    if min(shape) > 2:
        crop[1:-1, 1:-1, 1:-1] = 255
    volume = PackedVolume(crop, np.array([39, 36, 20]), coarse_flesh.grid)
    states = scatter(coarse_flesh, 16, 0.1, 0.5)
    args = coarse_flesh.body, coarse_flesh.table, volume
    assert_same(part_scores(*args, states), part_scores_numpy(*args, states))


def test_float32_costs_next_to_nothing(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    """Against float64: a point changes its voxel only within 1e-4 voxels of a border."""
    states = scatter(coarse_flesh, 5, 0.05, 0.3)
    body, table = coarse_flesh.body, coarse_flesh.table
    R, t = joint_transforms(body, states)
    j = np.repeat(table.joint, np.diff(table.start))
    part = np.repeat(table.part, np.diff(table.start))
    fast = part_scores(body, table, volume, states).occupied * table.part_sizes
    for n in range(len(states)):
        world = np.einsum("mrc,mc->mr", R[n, j], table.points.astype(float)) + t[n, j]
        at = (world - volume.lower_m) / volume.grid.voxel_size_m
        cell = np.floor(at).astype(int)
        inside = np.all((cell >= 0) & (cell < volume.crop.shape), axis=1)
        value = np.where(inside, volume.crop[tuple(np.where(inside[:, None], cell, 0).T)] >> 7, 0)
        close = np.any(np.abs(at - np.round(at)) < 1e-4, axis=1)
        exact = np.bincount(part, weights=value, minlength=body.layout.n_parts)
        slack = np.bincount(part, weights=close, minlength=body.layout.n_parts)
        assert np.all(np.abs(fast[n] - exact) <= slack + 1e-9)


def test_threads_do_not_change_the_result(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    states = scatter(coarse_flesh, 19, 0.05, 0.3)
    args = coarse_flesh.body, coarse_flesh.table, volume, states
    one = part_scores(*args, n_threads=1)
    for n in (2, 3, 50):
        assert_same(one, part_scores(*args, n_threads=n))


def test_order_of_particles_does_not_matter(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    """Invariance: every particle is scored as if it were alone."""
    states = scatter(coarse_flesh, 15, 0.05, 0.3)
    args = coarse_flesh.body, coarse_flesh.table, volume
    together = part_scores(*args, states)
    for i in (0, 6, 7, 14):
        alone = part_scores(*args, states[i : i + 1])
        for field in FIELDS:
            np.testing.assert_array_equal(getattr(alone, field)[0], getattr(together, field)[i])
    none = part_scores(*args, states[:0])
    assert none.out.shape == (0, coarse_flesh.body.layout.n_parts)


@pytest.mark.parametrize("n_tags", [2**18, 3])
def test_python_twin_of_the_kernel(monkeypatch: pytest.MonkeyPatch, n_tags: int) -> None:
    """Interpreted, and with so few particle tags that they begin anew after every second particle."""
    flesh = make_flesh("thesis", 1.7, 0.05)
    volume = volume_of(flesh, flesh.hull(neutral_state(flesh.body)))
    states = scatter(flesh, 5, 0.05, 0.3)
    counts = np.zeros((5, flesh.body.layout.n_parts, 4), dtype=np.int64)
    segments = selected(flesh.table, tuple(range(flesh.body.layout.n_parts)), ())[0]
    crop = volume.crop.reshape(-1)
    cells = np.full(crop.size, 2**31 + 12345, dtype=np.uint32)
    monkeypatch.setattr(_kernels, "_N_TAGS", n_tags)
    with np.errstate(over="ignore"):  # the kernel's unsigned subtraction wraps around on purpose
        part_scores_kernel.py_func(states, flesh.body.chain, segments, volume.box, crop, cells, counts)
    scores = part_scores(flesh.body, flesh.table, volume, states)
    np.testing.assert_allclose(counts[..., 2] / flesh.table.part_sizes, scores.occupied)
    np.testing.assert_allclose(counts[..., 1] / flesh.table.part_sizes, scores.double)
    assert scores.double.max() > 0


# A chain of four parts, pairwise different; out of order, and with parts that only take up room.
SUBSETS = [((3,), ()), ((5, 0), ()), ((9, 2, 0), (4, 8)), ((1,), (0, 2, 3)), ((), (1,)), ((2, 3), (3, 0))]


@pytest.mark.parametrize(("parts", "given"), SUBSETS)
def test_kernel_is_the_numpy_twin_on_a_subset_of_parts(
    coarse_flesh: Flesh, volume: PackedVolume, parts: tuple[int, ...], given: tuple[int, ...]
) -> None:
    args = coarse_flesh.body, coarse_flesh.table, volume, scatter(coarse_flesh, 11, 0.1, 0.5)
    fast = part_scores(*args, parts=parts, given=given)
    assert fast.out.shape == (11, len(parts))
    assert_same(fast, part_scores_numpy(*args, parts=parts, given=given))
    assert_same(fast, part_scores(*args, parts=parts, given=given, n_threads=3))


def test_all_parts_named_are_all_parts(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    """In any order; and only double occupancy depends on which other parts are there."""
    args = coarse_flesh.body, coarse_flesh.table, volume, scatter(coarse_flesh, 13, 0.1, 0.5)
    P = coarse_flesh.body.layout.n_parts
    whole = part_scores(*args)
    order = list(np.random.default_rng(5).permutation(P))
    shuffled = part_scores(*args, parts=order)
    some = part_scores(*args, parts=order[:4], given=order[4:])
    alone = part_scores(*args, parts=order[:4])
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(shuffled, field), getattr(whole, field)[:, order])
        np.testing.assert_array_equal(getattr(some, field), getattr(whole, field)[:, order[:4]])
        if field != "double":
            np.testing.assert_array_equal(getattr(alone, field), getattr(whole, field)[:, order[:4]])
    assert np.all(alone.double <= some.double)
    assert alone.double.sum() < some.double.sum()
    single = part_scores(*args, parts=[order[0]])
    assert np.all(single.double == 0), "one part alone meets nobody"


@pytest.mark.parametrize("factorised", [True, False])
def test_a_problem_scores_the_parts_asked_for(
    coarse_flesh: Flesh, volume: PackedVolume, factorised: bool
) -> None:
    states = scatter(coarse_flesh, 6, 0.05, 0.3)
    args = coarse_flesh.body, coarse_flesh.table, volume
    problem = VoxelProblem(*args, VoxelLikelihoodSettings(factorised=factorised))
    P = coarse_flesh.body.layout.n_parts
    whole = problem.log_likelihood(states)
    named = problem.log_likelihood(states, range(P))
    np.testing.assert_array_equal(named, whole)
    some = problem.log_likelihood(states, (7, 2), tuple(p for p in range(P) if p not in (7, 2)))
    if factorised:
        np.testing.assert_array_equal(some, whole[:, [7, 2]])
    else:
        scores = part_scores(*args, states, parts=(7, 2), given=range(P))
        np.testing.assert_array_equal(
            some, global_log_likelihood(scores, coarse_flesh.table, problem.settings, (7, 2))
        )
        assert some.shape == (6, 1)


def test_scores_of_full_and_empty_volumes(coarse_flesh: Flesh) -> None:
    """Closed form: everything occupied and on the surface, or nothing."""
    state = neutral_state(coarse_flesh.body)[None]
    state[0, 2] += 0.1  # clear of the floor
    shape = (60, 60, 60)
    full = np.zeros(shape, dtype=np.uint8)
    full[1:-1, 1:-1, 1:-1] = 128 | SURFACE_MAX
    lower = np.array([10, 8, -3])
    for crop, occupied in ((full, 1.0), (np.zeros(shape, dtype=np.uint8), 0.0)):
        scores = part_scores(
            coarse_flesh.body, coarse_flesh.table, PackedVolume(crop, lower, coarse_flesh.grid), state
        )
        np.testing.assert_array_equal(scores.occupied, occupied)
        np.testing.assert_array_equal(scores.surface, 1.0 - occupied)
        np.testing.assert_array_equal(scores.out, 0.0)


def test_outside_means_outside_the_room(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    """Reading guide 10: not outside the crop, and not outside the body. A body half in the wall has half of it out."""
    body, table = coarse_flesh.body, coarse_flesh.table
    state = neutral_state(body)
    wall = state.copy()
    wall[0] = coarse_flesh.grid.upper[0] - 0.003
    beside = state.copy()
    beside[0] = coarse_flesh.grid.upper[0] - 0.5
    scores = part_scores(body, table, volume, np.stack([state, wall, beside]))
    assert scores.out[0].max() == 0
    assert 0.3 < scores.out[1] @ table.part_sizes / table.part_sizes.sum() < 0.7
    assert scores.out[2].max() == 0
    assert scores.occupied[2].max() == 0


def test_double_occupancy_counts_voxels_of_two_parts(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    """An arm laid into the torso shares voxels with it; at rest the default body hardly meets itself."""
    body = coarse_flesh.body
    names, parts = body.layout.names, body.layout.parts
    crossed = neutral_state(body)
    crossed[names.index("right_elbow_z")] = 2.5
    crossed[names.index("right_shoulder_y")] = -1.4
    open_arms = neutral_state(body)
    open_arms[names.index("right_shoulder_x")] = 0.6
    scores = part_scores(body, coarse_flesh.table, volume, np.stack([crossed, open_arms]))
    forearm = parts.index("right_forearm")
    assert scores.double[0, forearm] > scores.double[1, forearm] + 0.2


def test_factorised_likelihood_is_the_closed_form(coarse_flesh: Flesh) -> None:
    """CF Eq. 6.23-6.25 with Table 6.2, part by part with plain numbers."""
    body = coarse_flesh.body
    P = body.layout.n_parts
    rng = np.random.default_rng(0)
    scores = PartScores(*(rng.random((3, P)) for _ in FIELDS))
    settings = VoxelLikelihoodSettings(0.02, 0.03, 0.4, 0.5)
    got = factorised_log_likelihood(scores, body, settings)
    for n, p in itertools.product(range(3), range(P)):
        f = body.variance[p]
        expected = -0.5 * (
            scores.out[n, p] ** 2 / (0.02 * f[0])
            + scores.double[n, p] ** 2 / (0.03 * f[1])
            + (1 - scores.occupied[n, p]) ** 2 / (0.4 * f[2])
            + scores.surface[n, p] ** 2 / (0.5 * f[3])
        )
        assert got[n, p] == pytest.approx(expected)


def test_global_likelihood_pools_points(coarse_flesh: Flesh) -> None:
    """CF Eq. 6.17-6.22: pooled scores are weighted by points, the surface score by surface points."""
    table, P = coarse_flesh.table, coarse_flesh.body.layout.n_parts
    rng = np.random.default_rng(1)
    scores = PartScores(*(rng.random((2, P)) for _ in FIELDS))
    size = table.part_sizes
    surface = np.bincount(table.part, weights=table.n_surface)
    settings = VoxelLikelihoodSettings(0.02, 0.03, 0.4, 0.5)
    got = global_log_likelihood(scores, table, settings)
    assert got.shape == (2, 1)
    for n in range(2):
        d = [
            (scores.out[n] * size).sum() / size.sum(),
            (scores.double[n] * size).sum() / size.sum(),
            1 - (scores.occupied[n] * size).sum() / size.sum(),
            (scores.surface[n] * surface).sum() / surface.sum(),
        ]
        expected = -0.5 * sum(x * x / v for x, v in zip(d, (0.02, 0.03, 0.4, 0.5), strict=True))
        assert got[n, 0] == pytest.approx(expected)


def test_equal_parts_make_both_likelihoods_proportional(coarse_flesh: Flesh) -> None:
    """When every part has the same scores and variance, factorised = P x global."""
    P = coarse_flesh.body.layout.n_parts
    scores = PartScores(*(np.full((1, P), v) for v in (0.1, 0.2, 0.7, 0.3)))
    even = replace(coarse_flesh.body, variance=np.ones((P, 4)))
    settings = VoxelLikelihoodSettings()
    factorised = factorised_log_likelihood(scores, even, settings).sum()
    assert factorised == pytest.approx(P * global_log_likelihood(scores, coarse_flesh.table, settings)[0, 0])


@pytest.mark.parametrize("factorised", [True, False])
def test_the_maximum_lies_at_the_truth(flesh: Flesh, factorised: bool) -> None:
    """In the body's own hull no pose of 150 around the truth that moves a landmark by 5 cm scores higher."""
    truth = neutral_state(flesh.body)
    truth[flesh.body.layout.names.index("right_shoulder_x")] = 0.9
    problem = VoxelProblem(
        flesh.body,
        flesh.table,
        volume_of(flesh, flesh.hull(truth)),
        VoxelLikelihoodSettings(factorised=factorised),
    )
    std = np.where(np.arange(27) < 3, 0.05, 0.25)
    particles = problem.propagate(np.tile(truth, (150, 1)), std, rng=np.random.default_rng(2))
    value = problem.log_likelihood(particles).sum(axis=1)
    at_truth = float(problem.log_likelihood(truth[None]).sum())
    moved = np.linalg.norm(
        landmarks_of(flesh.body, particles) - landmarks_of(flesh.body, truth[None]), axis=-1
    )
    far = moved.max(axis=1) > 0.05
    assert far.sum() > 100
    assert np.all(value[far] < at_truth)


def test_a_problem_has_one_column_per_part_or_one(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    states = scatter(coarse_flesh, 3, 0.0, 0.0)
    args = coarse_flesh.body, coarse_flesh.table, volume
    parts = VoxelProblem(*args, VoxelLikelihoodSettings()).log_likelihood(states)
    whole = VoxelProblem(*args, VoxelLikelihoodSettings(factorised=False)).log_likelihood(states)
    assert parts.shape == (3, coarse_flesh.body.layout.n_parts)
    assert whole.shape == (3, 1)
    assert np.isfinite(parts).all()


def test_own_occupancy_leaves_out_what_another_part_holds(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    """An arm sunk into the torso lies in data, but hardly in data of its own; a part alone owns all it lies in."""
    body = coarse_flesh.body
    names, parts = body.layout.names, body.layout.parts
    sunk = neutral_state(body)
    sunk[names.index("right_elbow_z")] = 2.5
    sunk[names.index("right_shoulder_y")] = -1.4
    problem = VoxelProblem(body, coarse_flesh.table, volume, VoxelLikelihoodSettings())
    forearm = parts.index("right_forearm")
    occupied = problem.occupancy(sunk[None])[0]
    own = problem.occupancy(sunk[None], own=True)[0]
    assert np.all(own <= occupied)
    assert np.all(own >= 0)
    assert own[forearm] < 0.6 * occupied[forearm]
    alone = problem.occupancy(sunk[None], [forearm], own=True)
    np.testing.assert_array_equal(alone[0], occupied[[forearm]])


def test_bad_input_is_refused(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    grid = VoxelGrid(np.zeros(3), (3, 4, 5), 0.1)
    for crop in (np.zeros((3, 4), np.uint8), np.zeros((3, 4, 5)), np.zeros((3, 4, 5), np.int8)):
        with pytest.raises(ValueError, match="3-D uint8"):
            PackedVolume(crop, np.zeros(3, np.int64), grid)
    with pytest.raises(ValueError, match="too large"):
        PackedVolume(np.zeros((256, 256, 256), np.uint8), np.zeros(3, np.int64), grid)
    with pytest.raises(ValueError, match="states has shape"):
        part_scores(coarse_flesh.body, coarse_flesh.table, volume, np.zeros((2, 26)))
    for parts, given in (((0, 0), ()), ((10,), ()), ((-1,), ()), ((0,), (99,))):
        with pytest.raises(ValueError, match="parts and given"):
            part_scores(
                coarse_flesh.body, coarse_flesh.table, volume, np.zeros((2, 27)), parts=parts, given=given
            )


def moved_limb(flesh: Flesh, limb: list[int], n: int) -> tuple[np.ndarray, np.ndarray]:
    """A pose, and n poses that differ from it in one limb, all over its range."""
    layout = flesh.body.layout
    held = scatter(flesh, 1, 0.02, 0.2)[0]
    columns = layout.columns_of(limb)
    particles = np.tile(held, (n, 1))
    rng = np.random.default_rng(5)
    particles[:, columns] = rng.uniform(layout.lower[columns], layout.upper[columns], (n, len(columns)))
    return held, particles


@pytest.mark.parametrize("first", range(1, 6))
def test_a_limb_of_a_held_body_scores_as_with_all_others_given(
    coarse_flesh: Flesh, volume: PackedVolume, first: int
) -> None:
    limb = limbs_of(coarse_flesh.body.layout)[first - 1]
    held, particles = moved_limb(coarse_flesh, limb, 31)
    args = coarse_flesh.body, coarse_flesh.table, volume
    rest = [p for p in range(coarse_flesh.body.layout.n_parts) if p not in limb]
    fixed = held_body(*args, held, limb)
    expected = part_scores(*args, particles, parts=limb, given=rest)
    assert_same(fixed.scores(particles), expected)
    assert expected.double.max() > 0
    assert_same(fixed.scores(particles), expected)  # nothing of the first call is left in the scratch


def test_a_held_limb_may_leave_the_crop_and_the_room(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    limb = limbs_of(coarse_flesh.body.layout)[1]
    held, particles = moved_limb(coarse_flesh, limb, 9)
    held[0] += 1.0
    particles[:, 0] += 1.0
    args = coarse_flesh.body, coarse_flesh.table, volume
    rest = [p for p in range(coarse_flesh.body.layout.n_parts) if p not in limb]
    expected = part_scores(*args, particles, parts=limb, given=rest)
    assert expected.out.max() > 0
    assert_same(held_body(*args, held, limb).scores(particles), expected)


@pytest.mark.parametrize("kind", ["exact", "fast"])
@pytest.mark.parametrize("factorised", [True, False])
def test_limb_log_likelihood_is_that_of_the_limb_s_parts(
    coarse_flesh: Flesh, volume: PackedVolume, kind: str, factorised: bool
) -> None:
    settings = VoxelLikelihoodSettings(kind=kind, factorised=factorised)
    problem = VoxelProblem(coarse_flesh.body, coarse_flesh.table, volume, settings)
    limb = limbs_of(problem.layout)[1]
    held, particles = moved_limb(coarse_flesh, limb, 12)
    rest = [p for p in range(problem.layout.n_parts) if p not in limb]
    # The fast kind is for whole bodies: a limb is always judged by all of its points, unless limbs are nothing.
    judge = replace(problem, settings=replace(settings, kind="exact")) if factorised else problem
    expected = judge.log_likelihood(particles, limb, rest).sum(axis=1)
    np.testing.assert_allclose(problem.limb_log_likelihood(held, limb)(particles), expected, atol=1e-12)


def test_held_kernels_agree_with_their_python(
    coarse_flesh: Flesh, volume: PackedVolume, monkeypatch: pytest.MonkeyPatch
) -> None:
    limb = limbs_of(coarse_flesh.body.layout)[1]
    held, particles = moved_limb(coarse_flesh, limb, 2)
    args = coarse_flesh.body, coarse_flesh.table, volume
    compiled = held_body(*args, held, limb).scores(particles)
    module = "mocap.likelihood.voxels.exact."
    monkeypatch.setattr(module + "take_voxels", _kernels.take_voxels.py_func)
    monkeypatch.setattr(module + "limb_scores_kernel", _kernels.limb_scores_kernel.py_func)
    monkeypatch.setattr(_kernels, "_placed_indices", _kernels._placed_indices.py_func)
    assert_same(held_body(*args, held, limb).scores(particles), compiled)


@pytest.mark.parametrize("limb", [[], list(range(8)), [2, 2], [40]])
def test_a_limb_that_is_none_is_refused(coarse_flesh: Flesh, volume: PackedVolume, limb: list[int]) -> None:
    state = neutral_state(coarse_flesh.body)
    with pytest.raises(ValueError, match=r"limb|parts"):
        held_body(coarse_flesh.body, coarse_flesh.table, volume, state, limb)


def test_limb_in_data_counts_the_axis(coarse_flesh: Flesh, volume: PackedVolume) -> None:
    """The body's own hull holds its axes; an arm stretched into the air leaves it."""
    problem = VoxelProblem(coarse_flesh.body, coarse_flesh.table, volume, VoxelLikelihoodSettings())
    truth = neutral_state(coarse_flesh.body)
    limb = limbs_of(problem.layout)[1]
    raised = truth.copy()
    raised[problem.layout.names.index("right_shoulder_x")] = -1.4
    found = problem.limb_in_data(np.stack([truth, raised]), limb)
    assert found[0] == 1.0
    assert found[1] < 0.4
    far = truth + np.where(np.arange(len(truth)) < 3, 100.0, 0.0)
    assert problem.limb_in_data(far[None], limb).tolist() == [0.0]
