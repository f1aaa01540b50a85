"""The other readings of the published experiment: each changes what it says, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from eval import decomposition_own_worlds as own
from eval.decomposition.cells import WORLDS, RunKey, SceneKey, run_scene, scene_of, start_of
from eval.decomposition.readings import (
    READINGS,
    AbsoluteAngles,
    LogDistanceProblem,
    filter_named,
    to_relative,
)
from eval.decomposition.tables import Seeds, Table
from eval.decomposition_as_printed import as_printed
from eval.decomposition_regimes import FIRST_SCENE, WORLDS_4_5, WORLDS_6, chapter_6, chapters_4_5
from mocap.filters import FILTERS, FilterBudget, ParticleState, filter_settings, initial_particles
from mocap.filters.partitioned import Partial
from mocap.filters.pfcr import combine_parts, combine_parts_weighted
from mocap.polygons.likelihood import (
    PolygonLikelihoodSettings,
    PolygonProblem,
    polygon_scores,
    random_walk_std,
)
from mocap.polygons.tree import part_frames, star_tree

SEEDS = Seeds(scenes=(0, 1), runs=(0, 1, 2), n_workers=1, is_full=False, n_frames=5)
TREE = star_tree(n_arms=3, n_levels=4)


def test_absolute_angles_are_those_of_the_parts_in_the_picture() -> None:
    rng = np.random.default_rng(0)
    absolute = rng.normal(size=(5, TREE.layout.n_columns))
    _, angle = part_frames(TREE, absolute @ to_relative(TREE).T)
    _, at_rest = part_frames(TREE, np.zeros((1, TREE.layout.n_columns)))
    wanted = absolute[:, TREE.first_column]
    wanted[:, 0] = absolute[:, 2]
    np.testing.assert_allclose(angle - at_rest, wanted, atol=1e-12)


def test_with_absolute_angles_a_parent_that_turns_does_not_turn_what_hangs_on_it() -> None:
    key = SceneKey("sw", 3, 4, n_frames=2)
    scene = scene_of(key)
    inner = scene.problem(0)
    problem = AbsoluteAngles(inner, to_relative(scene.tree))
    state = np.linalg.solve(to_relative(scene.tree), scene.states[0])[None]
    np.testing.assert_allclose(problem.log_likelihood(state), inner.log_likelihood(scene.states[:1]))
    column = scene.tree.first_column[1]
    turned = state.copy()
    turned[:, column] += 0.1
    before, after = (part_frames(scene.tree, s @ to_relative(scene.tree).T)[1] for s in (state, turned))
    changed = ~np.isclose(before[0], after[0], atol=1e-12)
    assert changed.tolist() == [part == 1 for part in range(scene.tree.layout.n_parts)]
    assert problem.layout is inner.layout


def test_the_log_distance_is_flatter_near_and_steeper_far() -> None:
    """d^2 = ln(overlap)^2 against 1 - overlap, lambda for both: closed form from the overlap itself."""
    scene = scene_of(SceneKey("sw", 3, 3, n_frames=2))
    settings = PolygonLikelihoodSettings(lambda_silhouette=7.0)
    plain = PolygonProblem(scene.tree, scene.bins(0), scene.reference, settings)
    log = LogDistanceProblem(scene.tree, scene.bins(0), scene.reference, settings)
    rng = np.random.default_rng(1)
    states = scene.states[0] + 0.3 * rng.normal(size=(40, scene.states.shape[1])) * random_walk_std(
        scene.tree.layout, 30.0, 1.0
    )
    states[0] = np.nan
    squared, uncovered = polygon_scores(scene.tree, scene.bins(0), scene.reference, states)
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = -50.0 * np.log(1.0 - squared) ** 2 - 7.0 * uncovered
    found = log.log_likelihood(states)
    assert np.isneginf(found[0]).all()
    seen = np.isfinite(expected) & (squared < 1)
    assert seen.sum() > 100
    np.testing.assert_allclose(found[seen], expected[seen], rtol=1e-9)
    near = seen & (squared < 0.2) & (squared > 1e-6)
    assert near.any()
    assert np.all(found[near] > plain.log_likelihood(states)[near])
    assert np.isfinite(log.log_likelihood(states + 1e4)[1:]).all()


@pytest.mark.parametrize("name", [n for n in READINGS if n.endswith("smooth")])
def test_smoothing_layers_never_sharpen(name: str) -> None:
    """A flat likelihood: the survival rate asks for more than 1 in the filter itself."""
    scene = scene_of(SceneKey("sw_15", 3, 3, n_frames=2))
    layout = scene.tree.layout
    base = name.removesuffix("-smooth")
    settings = filter_settings(
        FilterBudget(base, n_particles=40, n_layers=2), layout, random_walk_std(layout)
    )
    problem = scene.problem(1, WORLDS["sw_15"].likelihood)
    state = initial_particles(problem, scene.states[0], 40)
    _, sharp = FILTERS[base].step(problem, state, settings, rng=np.random.default_rng(0))
    _, smooth = filter_named(name).step(problem, state, settings, rng=np.random.default_rng(0))
    assert sharp.beta.max() > 1
    assert smooth.beta.max() == 1


def test_drawn_particles_of_pfcr_keep_their_weights() -> None:
    rng = np.random.default_rng(3)
    scores = np.zeros((20, TREE.layout.n_parts))
    scores[:, :4] = rng.normal(size=(20, 4))
    placed = np.zeros(scores.shape, dtype=np.int64)
    placed[:, 0] = np.arange(20) // 4
    placed[:, 1:4] = np.arange(20)[:, None]
    particles = rng.normal(size=(20, TREE.layout.n_columns))
    partial = Partial(particles, np.full(20, 0.05), scores, placed)
    drawn, kept = (
        combine(TREE.layout, partial, [1, 2, 3], scheme="systematic", rng=np.random.default_rng(5))
        for combine in (combine_parts, combine_parts_weighted)
    )
    np.testing.assert_array_equal(drawn.particles, kept.particles)
    product = np.exp(drawn.scores[:, 1:4].sum(axis=1))
    np.testing.assert_allclose(kept.weights, product / product.sum(), rtol=1e-12)
    assert np.ptp(kept.weights) > 0


def test_drawn_swarms_start_from_particles_of_weight() -> None:
    """All weight on one particle: every other one is forgotten, while HAPSOPF as printed carries them on."""
    scene = scene_of(SceneKey("xn6", 2, 3, n_frames=2))
    layout = scene.tree.layout
    std = 1e-6 * random_walk_std(layout)
    settings = filter_settings(FilterBudget("hapsopf-printed", n_particles=10, n_layers=4), layout, std)
    particles = scene.states[0] + 40.0 * np.arange(10)[:, None]
    state = ParticleState(particles, np.eye(10)[0])
    problem = scene.problem(1)
    drawn, info = filter_named("hapsopf-frame-drawn").step(
        problem, state, settings, rng=np.random.default_rng(0)
    )
    carried, _ = FILTERS["hapsopf-printed"].step(problem, state, settings, rng=np.random.default_rng(0))
    assert np.abs(drawn.particles - scene.states[0]).max() < 0.1
    assert np.abs(carried.particles - scene.states[0]).max() > 10
    assert info.n_evaluations == 40


def test_worlds_differ_from_their_base_in_one_thing() -> None:
    allowed = {
        "by-hand": {"start_px", "start_rad"},
        "log": {"is_log_distance"},
        "fast": {"scene"},
        "absolute": {"has_absolute_state"},
        "absolute-film": {"has_absolute_state", "has_absolute_motion"},
        "colour-only": {"likelihood"},
        "clutter-in-sight": {"scene"},
        "slow": {"scene"},
        "slow-by-hand": {"scene", "start_px", "start_rad"},
        "loose": {"has_loose_joints"},
        "loose-slow": {"has_loose_joints", "scene"},
        "loose-slow-by-hand": {"has_loose_joints", "scene", "start_px", "start_rad"},
        "15": {"likelihood"},
        "200": {"likelihood"},
        "141": {"std_px", "std_rad"},
    }
    for name in WORLDS_4_5 + WORLDS_6 + own.WORLDS:
        base, _, what = name.replace("step", "sw").partition("_")
        one, two = vars(WORLDS[name]), vars(WORLDS[base])
        assert {field for field in one if one[field] != two[field]} == allowed.get(what, set()), name


def test_a_start_by_hand_is_the_same_in_all_runs_and_as_far_off_as_said() -> None:
    """1,200 starts: a standard deviation is known to 2 % of itself."""
    key = SceneKey("sw_by-hand", 4, 3, n_frames=1)
    scene = scene_of(key)
    off = []
    for seed in range(1200):
        start = start_of(replace(key, seed=seed), scene)
        np.testing.assert_array_equal(start, start_of(replace(key, seed=seed), scene))
        off.append(np.linalg.solve(to_relative(scene.tree), start - scene.states[0]))
    std = np.std(off, axis=0)
    np.testing.assert_allclose(std[:2], 2.0, rtol=0.1)
    np.testing.assert_allclose(std[2:], 0.08, rtol=0.1)
    np.testing.assert_array_equal(start_of(replace(key, world="sw"), scene), scene.states[0])


def test_an_absolute_film_has_the_same_numbers_as_angles_of_the_picture() -> None:
    plain, turned = (scene_of(SceneKey(w, 3, 3, n_frames=4)) for w in ("sw", "sw_absolute-film"))
    np.testing.assert_allclose(np.linalg.solve(to_relative(turned.tree), turned.states.T).T, plain.states)
    same = scene_of(SceneKey("sw_absolute", 3, 3, n_frames=4))
    np.testing.assert_array_equal(same.states, plain.states)


def test_a_slow_film_is_the_same_film_with_smaller_steps() -> None:
    fast, slow = WORLDS["sw"].scene, WORLDS["sw_slow"].scene
    assert slow.speed_px == pytest.approx(0.4 * fast.speed_px)
    assert slow.speed_rad == pytest.approx(0.4 * fast.speed_rad)
    assert replace(slow, speed_px=fast.speed_px, speed_rad=fast.speed_rad) == fast


def test_loose_joints_start_where_jointed_parts_start_and_move_with_noise_of_their_own() -> None:
    """Without noise both states stay at the start, so the errors agree; with it the looser state errs more."""
    still = {w: replace(WORLDS[w], std_px=0.0, std_rad=0.0) for w in ("sw", "sw_loose")}
    rows = {}
    for name, world in still.items():
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(WORLDS, name, world)
            rows[name] = run_scene(SceneKey(name, 3, 3, n_frames=4), [RunKey("ps", 10)])[0]
    assert rows["sw"]["error_px"] == rows["sw_loose"]["error_px"]
    jointed, loose = (
        run_scene(SceneKey(w, 3, 6, n_frames=12), [RunKey("ps", 30)])[0]["error_px"] for w in still
    )
    assert float(loose) > 1.2 * float(jointed)


@pytest.mark.parametrize("world", [w for w in WORLDS_4_5 + WORLDS_6 + own.WORLDS if "_" in w])
def test_every_world_and_reading_tracks(world: str) -> None:
    """Two frames: nobody can be lost yet."""
    names = (
        ("hapsopf", "hapsopf-frame-drawn", "psapf-smooth")
        if world.startswith("xn6")
        else ("pfcr-carried", "sbps")
    )
    found = run_scene(SceneKey(world, 2, 3, n_frames=3), [RunKey(n, 40, 2) for n in names])
    n_corners = 4 * 5
    for row in found:
        assert row["status"] == "ok", row
        assert float(row["error_px"]) < 8 * n_corners
        assert float(row["evaluations"]) == pytest.approx(40, abs=1)


@pytest.mark.parametrize(
    "table", [chapters_4_5(SEEDS), chapter_6(SEEDS), own.own_worlds(SEEDS), *as_printed(SEEDS)]
)
def test_every_order_compares_two_methods_that_some_cell_has(table: Table) -> None:
    found: dict[tuple[str, ...], dict[str, int]] = {}
    for cell in table.cells:
        row = cell.key()
        key = tuple(row[field] for field in table.cell_fields)
        names = found.setdefault(key, {})
        names[table.name_of(row)] = names.get(table.name_of(row), 0) + 1
    assert {counts for names in found.values() for counts in names.values()} == {6}
    everything = {name for names in found.values() for name in names}
    for key in found:
        for better, worse, _ in table.pairs(key):
            assert {better, worse} <= everything
            assert better != worse


def test_the_scenes_are_in_no_reported_table() -> None:
    """Reported tables number their scenes from 0."""
    assert FIRST_SCENE >= 1000
    assert own.FIRST_SCENE >= FIRST_SCENE + 1000
