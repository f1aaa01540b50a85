"""SHBM-APF: operators between models in closed form, and the filter on problems whose answer is known."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from flesh_voxels import Flesh
from hypothesis import given
from hypothesis import strategies as st
from linear_gaussian_tree import LinearGaussianTree, positions_of, tree_layout

from mocap.body import landmarks_of, load_hierarchy, neutral_state
from mocap.data import Hierarchy, Level
from mocap.data.hierarchy import levels_on
from mocap.filters import FilterBudget, ParticleState, filter_settings, initial_particles
from mocap.filters.crossing import CROSS_EVERY, CROSSING, N_PARTITIONS, mirror
from mocap.filters.shbm import ShbmSettings, shbm_step, structural_noise, structural_settings
from mocap.filters.structural import backward, effective_particles, forward, level_std, particles_per_level
from mocap.likelihood.voxels import VoxelLikelihoodSettings, VoxelProblem
from mocap.pose.volume import pack_volume

# Five parts, one column each: a trunk, two branches of which one has two more joints.
PARENTS = (-1, 0, 0, 1, 3)
LAYOUT = tree_layout(PARENTS, (1, 1, 1, 1, 1))
HIERARCHY = Hierarchy(
    "three",
    (
        Level("H1", ("column_0",), ("part_0",)),
        Level("H2", ("column_1", "column_2"), ("part_0", "part_1", "part_2")),
        Level("H3", ("column_3", "column_4"), tuple(LAYOUT.parts)),
    ),
    {"column_3": 0.75},
)
STD = np.array([0.4, 0.5, 0.6, 0.7, 0.8])
LEVELS = levels_on(HIERARCHY, LAYOUT)


def settings(**more: object) -> ShbmSettings:
    values: dict[str, object] = {"level_particles": (40, 70, 50), "level_layers": (2, 3, 1)}
    return ShbmSettings(std=STD, hierarchy=HIERARCHY, **(values | more))  # type: ignore[arg-type]


@dataclass(eq=False)
class Recording(LinearGaussianTree):
    """Keeps what it scored."""

    scored: list[np.ndarray] = field(default_factory=list)

    def log_likelihood(
        self, particles: np.ndarray, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> np.ndarray:
        self.scored.append(particles.copy())
        return super().log_likelihood(particles, parts, given)


def problem(z: np.ndarray | None = None, noise: float = 0.1) -> Recording:
    return Recording(LAYOUT, np.array([0.5, 0.2, -0.4, 0.9, 1.1]) if z is None else z, noise)


def test_backward_sorts_and_pins() -> None:
    rng = np.random.default_rng(4)
    particles = rng.normal(size=(30, 5))
    weights = rng.random(30)
    weights /= weights.sum()
    sets = backward(particles, weights, LEVELS, (11, 23, 30), rng=rng)
    rank = {tuple(p): r for r, p in enumerate(particles[np.argsort(-weights)])}
    for own, level in zip(sets, LEVELS.levels, strict=True):
        np.testing.assert_array_equal(own[:, ~level.has], np.tile(LEVELS.pinned[~level.has], (len(own), 1)))
    ranks = [rank[tuple(p)] for p in sets[2]]
    assert ranks == sorted(ranks), "the index is a rank"
    heads = {p[0] for p in particles}
    assert all(p[0] in heads for p in sets[0])


@pytest.mark.parametrize("rule", sorted(CROSSING))
def test_forward_then_backward_returns_the_coarse_set(rule: str) -> None:
    """Nothing is lost on the way up: with equal weights and numbers the coarse columns come back, as a set."""
    rng = np.random.default_rng(9)
    n = 24
    even = np.full(n, 1.0 / n)
    coarse = np.where(LEVELS.levels[0].has, rng.normal(size=(n, 5)), LEVELS.pinned)
    fine = rng.normal(size=(n, 5))
    joined = forward(coarse, even, fine, LEVELS, 1, rule, rng=rng)
    back = backward(joined, even, LEVELS, (n, n, n), rng=rng)[0]
    np.testing.assert_array_equal(np.sort(back[:, 0]), np.sort(coarse[:, 0]))
    np.testing.assert_array_equal(back[:, 1:], coarse[:, 1:])


@pytest.mark.parametrize("rule", sorted(CROSSING))
def test_every_gene_comes_from_a_parent(rule: str) -> None:
    rng = np.random.default_rng(2)
    coarse, fine = rng.normal(size=(17, 5)), rng.normal(size=(41, 5))
    weights = rng.random(17)
    joined = forward(coarse, weights / weights.sum(), fine, LEVELS, 1, rule, rng=rng)
    assert joined.shape == fine.shape
    np.testing.assert_array_equal(joined[:, [1, 2]], fine[:, [1, 2]])
    parents = {tuple(p) for p in coarse[:, [0, 3, 4]]}
    assert all(tuple(p) in parents for p in joined[:, [0, 3, 4]]), "columns of one parent stay together"


@given(n=st.integers(0, 300), seed=st.integers(0, 99), rule=st.sampled_from(sorted(CROSSING)))
def test_crossing_is_a_permutation(n: int, seed: int, rule: str) -> None:
    partners = CROSSING[rule](n, rng=np.random.default_rng(seed))
    assert sorted(partners.tolist()) == list(range(n))


def test_mirror_is_mostly_like_with_like_and_a_share_high_with_low() -> None:
    n = 400
    partners = mirror(n, rng=np.random.default_rng(0))
    size = n // N_PARTITIONS
    own, theirs = np.arange(n) // size, partners // size
    is_same, is_opposite = own == theirs, own == N_PARTITIONS - 1 - theirs
    assert np.all(is_same | is_opposite)
    assert is_opposite.mean() == pytest.approx(1 / CROSS_EVERY)
    assert CROSSING["direct"](5, rng=np.random.default_rng(0)).tolist() == [0, 1, 2, 3, 4]


def test_noise_of_the_three_models_is_as_printed() -> None:
    """CF Eq. 7.23-7.25 with alpha_S = 0.8, alpha = 0.5 and unequal numbers of layers, in covariances."""
    layers = (2, 3, 1)
    variance = [
        level_std(LEVELS, i, STD, layers, survival_rate=0.5, structural_rate=0.8) ** 2 / STD**2
        for i in range(3)
    ]
    np.testing.assert_allclose(variance[0], [1, 0, 0, 0, 0])
    np.testing.assert_allclose(variance[1], [0.8 * 0.5**2, 1, 1, 0, 0])
    np.testing.assert_allclose(variance[2], [0.8**2 * 0.5**2 * 0.5**3, 0.8 * 0.5**3, 0.8 * 0.5**3, 1, 1])


def test_noise_of_all_layers_together_is_the_sum_of_their_variances() -> None:
    """Closed form for one column of each model: layers (2, 3, 1), alpha = 0.5, alpha_S = 0.8."""
    variance = structural_noise(LEVELS, settings()) ** 2 / STD**2
    first = 1.5 + 0.8 * 0.25 * 1.75 + 0.64 * 0.03125
    second = 1.75 + 0.8 * 0.125
    np.testing.assert_allclose(variance, [first, second, second, 1.0, 1.0])


def test_particles_are_shared_out_by_dimensions() -> None:
    """CF Eq. 7.28-7.29: 50 per column of 6 + 10 + 6; and 7.20."""
    assert particles_per_level((6, 10, 6), 1100) == (300, 500, 300)
    assert particles_per_level((6, 13, 8), 10) == (2, 5, 3)
    assert min(particles_per_level((1, 99), 3)) == 2
    assert effective_particles((300, 500, 300), (2, 2, 2)) == (2200, 1600, 600)


def test_settings_spend_the_budget_that_is_asked_for() -> None:
    """A particle of a coarse model costs its share of the parts; rounding to whole particles leaves a little."""
    for n in (500, 2200):
        budget = FilterBudget("shbm-apf", n_particles=n, n_layers=1, hierarchy=HIERARCHY)
        own = structural_settings(budget, LAYOUT, STD)
        cost = sum(
            k * 2 * len(level.parts) / 5 for k, level in zip(own.level_particles, LEVELS.levels, strict=True)
        )
        assert cost == pytest.approx(n, abs=5)
    spread = filter_settings(FilterBudget("shbm-apf", n_particles=120, n_layers=3), LAYOUT, STD)
    _, info = shbm_step(
        problem(), initial_particles(problem(), np.zeros(5), 9), spread, rng=np.random.default_rng(0)
    )
    assert info.n_evaluations == pytest.approx(360, abs=5)


def test_the_published_run_is_2200_particle_evaluations() -> None:
    p = problem()
    start = initial_particles(p, np.zeros(5), 300)
    _, info = shbm_step(p, start, ShbmSettings(std=STD, hierarchy=HIERARCHY), rng=np.random.default_rng(0))
    assert [n for n, _, _ in p.calls] == [300, 300, 500, 500, 300, 300]
    assert sum(n for n, _, _ in p.calls) == 2200
    assert info.n_evaluations == round(sum(n * len(parts) / 5 for n, parts, _ in p.calls))


def test_each_model_scores_its_parts_with_the_other_columns_pinned() -> None:
    p = problem()
    start = initial_particles(p, np.full(5, 0.3), 50)
    state, info = shbm_step(p, start, settings(), rng=np.random.default_rng(1))
    parts = [(0,)] * 2 + [(0, 1, 2)] * 3 + [(0, 1, 2, 3, 4)]
    assert [(n, own) for n, own, _ in p.calls] == list(zip([40] * 2 + [70] * 3 + [50], parts, strict=True))
    for particles, level in zip(p.scored, [0, 0, 1, 1, 1, 2], strict=True):
        absent = ~LEVELS.levels[level].has
        np.testing.assert_array_equal(
            particles[:, absent], np.tile(LEVELS.pinned[absent], (len(particles), 1))
        )
    assert state.particles.shape == (50, 5)
    assert state.weights.sum() == pytest.approx(1.0)
    assert info.beta.shape == info.ess.shape == (6,)
    assert info.level_estimates is not None
    np.testing.assert_array_equal(info.level_estimates[0, 1:], LEVELS.pinned[1:])
    np.testing.assert_allclose(info.estimate, state.weights @ state.particles)
    assert info.best_log_likelihood == pytest.approx(float(p.log_likelihood(info.best[None]).sum()))


# Over 100 seeds the largest distance of a column was 0.146, the mean of the largest per run 0.060.
FOUND = 0.2


@pytest.mark.parametrize("seed", range(3))
def test_it_finds_the_only_pose_that_explains_the_data(seed: int) -> None:
    """One measurement per column: the maximum of the likelihood is H^-1 z."""
    p = problem()
    rng = np.random.default_rng(seed)
    state: ParticleState = initial_particles(p, np.zeros(5), 300)
    info = None
    for _ in range(4):
        state, info = shbm_step(p, state, ShbmSettings(std=STD, hierarchy=HIERARCHY), rng=rng)
    assert info is not None
    np.testing.assert_allclose(info.estimate, np.linalg.solve(positions_of(LAYOUT), p.z), atol=FOUND)


def test_same_generator_same_answer() -> None:
    def run(seed: int, crossing: str) -> np.ndarray:
        rng = np.random.default_rng(seed)
        p = problem()
        state: ParticleState = initial_particles(p, np.zeros(5), 50)
        for _ in range(2):
            state, _ = shbm_step(p, state, settings(crossing=crossing), rng=rng)
        return state.particles

    for rule in CROSSING:
        np.testing.assert_array_equal(run(3, rule), run(3, rule))
        assert np.abs(run(3, rule) - run(4, rule)).max() > 0
    assert np.abs(run(3, "direct") - run(3, "random")).max() > 0


@pytest.mark.parametrize("value", [-np.inf, np.nan])
def test_a_frame_without_likelihood_is_said_and_survived(value: float) -> None:
    p = Recording(LAYOUT, np.zeros(5), 0.1, silent=(0, 1, 2, 3, 4), silence=value)
    state, info = shbm_step(p, initial_particles(p, np.zeros(5), 9), settings(), rng=np.random.default_rng(0))
    assert info.is_degenerate
    assert np.isfinite(info.estimate).all()
    np.testing.assert_allclose(state.weights, 1 / 50)


def test_bounds_and_circular_columns_hold() -> None:
    bounded = tree_layout(PARENTS, (1, 1, 1, 1, 1), bound=0.6)
    p = LinearGaussianTree(bounded, np.full(5, 9.0), 0.2)
    state, _ = shbm_step(p, initial_particles(p, np.zeros(5), 9), settings(), rng=np.random.default_rng(0))
    assert np.abs(state.particles).max() <= 0.6
    turned = tree_layout(PARENTS, (1, 1, 1, 1, 1), is_circular=True)
    around = LinearGaussianTree(turned, np.full(5, np.pi), 0.2)
    _, info = shbm_step(
        around, initial_particles(around, np.full(5, np.pi), 50), settings(), rng=np.random.default_rng(0)
    )
    assert np.all(np.cos(info.estimate[:1]) < 0)


def test_bad_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="level_particles >= 2"):
        settings(level_particles=(1, 2, 3))
    with pytest.raises(ValueError, match="level_layers >= 1"):
        settings(level_layers=(0,))
    with pytest.raises(ValueError, match="2 level_layers for 3"):
        settings(level_layers=(2, 2))
    with pytest.raises(ValueError, match="direct, mirror, random"):
        settings(crossing="incest")
    with pytest.raises(ValueError, match="systematic"):
        settings(resampling="lottery")
    with pytest.raises(ValueError, match="the hierarchy three has 3 levels"):
        shbm_step(
            problem(),
            initial_particles(problem(), np.zeros(5), 9),
            settings(level_particles=(5, 5), level_layers=(1,)),
            rng=np.random.default_rng(0),
        )


# Over 20 seeds at 4 cm with 740 particle evaluations per frame: 64 +- 9 (model 1), 51 +- 6 mm (model 2, printed);
# means of four seeds at most 68 and 55. The annealed filter with as many: 69 +- 14 mm.
TRACKED_MM = {"model1": 78.0, "model2_printed": 64.0}


def follow(flesh: Flesh, step: Callable[..., Any], own: Any, seed: int) -> float:
    """Mean landmark error, mm, after six frames in which an arm is raised, the other bent and a leg lifted."""
    body = flesh.body
    truth = neutral_state(body)
    move = np.zeros(body.layout.n_columns)
    for name, by in (
        ("right_shoulder_x", -0.12),
        ("left_elbow_z", -0.15),
        ("right_hip_y", -0.10),
        ("right_knee_y", 0.12),
    ):
        move[body.layout.names.index(name)] = by
    rng = np.random.default_rng(seed)
    state: ParticleState | None = None
    error = np.zeros(0)
    for _ in range(6):
        truth = truth + move
        volume = pack_volume(flesh.grid, flesh.hull(truth, margin_m=0.02), 1.0)
        p = VoxelProblem(body, flesh.table, volume, VoxelLikelihoodSettings())
        state, info = step(p, state or initial_particles(p, truth - move, 100), own, rng=rng)
        error = landmarks_of(body, info.estimate[None]) - landmarks_of(body, truth[None])
    return float(1000 * np.linalg.norm(error, axis=-1).mean())


@pytest.mark.parametrize("model", sorted(TRACKED_MM))
def test_it_follows_a_body_in_its_own_hull(coarse_flesh: Flesh, model: str) -> None:
    own = ShbmSettings(
        std=0.5 * coarse_flesh.body.max_speed / 25,
        hierarchy=load_hierarchy(model),
        level_particles=(100, 170, 100),
    )
    errors = [follow(coarse_flesh, shbm_step, own, seed) for seed in range(4)]
    assert np.mean(errors) < TRACKED_MM[model]
