"""Swarm filters: their schedules in closed form, and what they find on problems with one maximum."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from linear_gaussian_tree import LinearGaussianTree, positions_of, tree_layout

from mocap.filters import FILTERS, ParticleState, initial_particles
from mocap.filters._swarm import Swarm, SwarmSettings, annealed_attraction, constant_attraction, fly
from mocap.filters.apsopf import exponential_attraction
from mocap.filters.partitioned import PartitionedSettings

TREE = tree_layout([-1, 0, 0, 1, 2], [2, 1, 1, 1, 2])
D, P = TREE.n_columns, TREE.n_parts
Z = np.array([0.5, -0.3, 0.9, -0.8, 0.2])
NOISE = 0.1
WHOLE = ("pso", "apsopf")
PRINTED = ("chapsopf-printed", "hapsopf-printed")
PART_BY_PART = ("hpso", "chapsopf", "hapsopf", *PRINTED)
SWARMS = (*WHOLE, *PART_BY_PART)


def settings(
    n_particles: int = 40, n_iterations: int = 5, n_columns: int = D, **more: object
) -> SwarmSettings:
    return SwarmSettings(
        n_particles=n_particles,
        n_iterations=n_iterations,
        std=np.full(n_columns, 0.3),
        **more,  # type: ignore[arg-type]
    )


def start_of(problem: LinearGaussianTree) -> ParticleState:
    return initial_particles(problem, np.zeros(problem.layout.n_columns), 3)


def test_the_attraction_falls_from_beta_max_to_beta_min() -> None:
    """XN Eq. 6.3 with XN 6.2's numbers: beta_0 beta_max = 1.5 at m = 0, beta_0 beta_min = 0.5 at m = M."""
    s = settings(n_iterations=3)
    found = [annealed_attraction(s, m) for m in range(4)]
    np.testing.assert_allclose(found, 1.5 * 3.0 ** (-np.arange(4) / 3))
    assert found[-1] == pytest.approx(s.beta_0 * s.beta_min)
    np.testing.assert_allclose(
        [exponential_attraction(s, m) for m in range(4)], 0.5 * np.exp(1 - np.arange(4) / 3)
    )
    assert constant_attraction(s, 1) == constant_attraction(s, 3) == 2.0


# Largest distance of a part from its measurement (0.9 at the start) after three frames. Over 100 seeds it was at most
# 0.148, 0.066, 0.002, 0.011, 0.014, 0.009 and 0.027.
FOUND_WITHIN = {
    "pso": 0.2,
    "apsopf": 0.1,
    "hpso": 0.005,
    "chapsopf": 0.02,
    "hapsopf": 0.035,
    "chapsopf-printed": 0.02,
    "hapsopf-printed": 0.035,
}


@pytest.mark.parametrize("name", SWARMS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_swarms_find_the_maximum_of_a_problem_that_has_one(name: str, seed: int) -> None:
    problem = LinearGaussianTree(TREE, Z, NOISE)
    rng = np.random.default_rng(seed)
    state = start_of(problem)
    for _ in range(3):
        state, info = FILTERS[name].step(problem, state, settings(80, 8), rng=rng)
    assert np.abs(positions_of(TREE) @ info.estimate - Z).max() < FOUND_WITHIN[name]
    assert not info.is_degenerate


@pytest.mark.parametrize("name", SWARMS)
def test_swarms_stay_inside_their_bounds(name: str) -> None:
    tight = tree_layout([-1, 0, 0], [1, 2, 1], bound=0.25)
    problem = LinearGaussianTree(tight, np.array([2.0, 5.0, -1.0]), 0.2)
    state, info = FILTERS[name].step(
        problem, start_of(problem), settings(30, 6, 4), rng=np.random.default_rng(0)
    )
    assert np.abs(state.particles).max() <= 0.25
    assert np.all(info.estimate * [1, 1, 1, -1] > 0.03), "pressed against the bounds"


@dataclass(eq=False)
class Turning:
    """One angle whose likelihood peaks at pi, where the numbers jump."""

    layout = tree_layout([-1], [1], is_circular=True)
    seen: list[float] = field(default_factory=list)

    def propagate(self, particles: np.ndarray, std: np.ndarray, *, rng: np.random.Generator) -> np.ndarray:
        return particles + std * rng.normal(size=particles.shape)

    def log_likelihood(self, particles: np.ndarray, parts: object = None, given: object = ()) -> np.ndarray:
        self.seen.append(float(np.abs(np.cos(particles) + 1).max()))
        return 20.0 * (-np.cos(particles) - 1.0)


@pytest.mark.parametrize("name", SWARMS)
def test_angles_are_pulled_the_short_way_round(name: str) -> None:
    """Particles at +3 and -3 pull each other over pi, a way of 0.28, and never over 0, where cos + 1 is 2."""
    problem = Turning()
    start = ParticleState(np.array([[3.0], [-3.0]] * 10), np.full(20, 0.05))
    tiny = replace(settings(20, 4, 1), std=np.array([0.01]), inertia=0.1, attraction=1.0)
    _, info = FILTERS[name].step(problem, start, tiny, rng=np.random.default_rng(0))
    assert max(problem.seen) < 0.2
    assert np.cos(info.estimate[0]) < -0.99


@dataclass(eq=False)
class Recorder(LinearGaussianTree):
    """Notes the noise that every propagation was asked for."""

    stds: list[np.ndarray] = field(default_factory=list)

    def propagate(self, particles: np.ndarray, std: np.ndarray, *, rng: np.random.Generator) -> np.ndarray:
        self.stds.append(std.copy())
        return super().propagate(particles, std, rng=rng)


def test_the_noise_shrinks_by_alpha_of_its_covariance_part_by_part() -> None:
    """The first draw and the first move use P_(0), each later move one factor alpha_0 more."""
    problem = Recorder(TREE, Z, NOISE)
    FILTERS["hapsopf"].step(
        problem, start_of(problem), settings(10, 4, covariance_factor=0.25), rng=np.random.default_rng(0)
    )
    scales = np.array([1.0, 1.0, 0.5, 0.25, 0.125])
    for part in range(P):
        found = np.array(problem.stds[5 * part : 5 * part + 5])
        own = TREE.columns_of(part)
        np.testing.assert_allclose(found[:, own], 0.3 * np.repeat(scales[:, None], len(own), axis=1))
        assert np.all(np.delete(found, own, axis=1) == 0)
    whole = Recorder(TREE, Z, NOISE)
    FILTERS["apsopf"].step(
        whole, start_of(whole), settings(10, 2, covariance_factor=0.25), rng=np.random.default_rng(0)
    )
    np.testing.assert_allclose(whole.stds, 0.3 * np.ones((3, D)) * [[1.0], [1.0], [0.5]])


@pytest.mark.parametrize("name", SWARMS)
def test_the_noise_pushes_no_way(name: str) -> None:
    """Reading guide 21: on a symmetric problem the mean over 300 seeds is zero, within five standard errors."""
    layout = tree_layout([-1, 0], [1, 1])
    problem = LinearGaussianTree(layout, np.zeros(2), 0.5)
    found = np.array(
        [
            FILTERS[name]
            .step(problem, start_of(problem), settings(10, 3, 2), rng=np.random.default_rng(seed))[1]
            .estimate
            for seed in range(300)
        ]
    )
    assert np.all(np.abs(found.mean(axis=0)) < 5 * found.std(axis=0) / np.sqrt(300))


@pytest.mark.parametrize("name", SWARMS)
def test_all_evaluations_are_counted(name: str) -> None:
    problem = LinearGaussianTree(TREE, Z, NOISE)
    _, info = FILTERS[name].step(problem, start_of(problem), settings(20, 3), rng=np.random.default_rng(0))
    calls = problem.calls[1:] if name in PART_BY_PART else problem.calls
    assert sum(n * len(parts) for n, parts, _ in calls) == 20 * 4 * P
    assert info.n_evaluations == 80
    if name in PART_BY_PART:
        assert [(parts, given) for _, parts, given in calls] == [
            ((part,), tuple(range(part))) for part in range(P) for _ in range(4)
        ]
    assert info.seconds["likelihood"] > 0


@pytest.mark.parametrize("name", SWARMS)
def test_the_best_has_the_value_that_is_said(name: str) -> None:
    problem = LinearGaussianTree(TREE, Z, NOISE)
    state, info = FILTERS[name].step(problem, start_of(problem), settings(), rng=np.random.default_rng(0))
    value = problem.log_likelihood(info.best[None]).sum()
    assert info.best_log_likelihood == pytest.approx(value)
    assert value == pytest.approx(problem.log_likelihood(state.particles).sum(axis=1).max())
    assert state.weights.sum() == pytest.approx(1.0)
    if name in ("pso", "hpso"):
        np.testing.assert_array_equal(info.estimate, info.best)
    else:
        np.testing.assert_allclose(info.estimate, state.weights @ state.particles)
    if name == "hpso":
        assert np.ptp(state.particles, axis=0).max() == 0


@pytest.mark.parametrize("name", SWARMS)
def test_more_moves_never_end_lower(name: str) -> None:
    """The same draws, followed on: a particle keeps the best place it has seen, and so does the swarm."""
    layout = tree_layout([-1], [3])
    problem = LinearGaussianTree(layout, np.array([1.5]), NOISE)
    best = []
    for n_iterations in (0, 1, 2, 4):
        s = settings(15, n_iterations, 3, beta_max=1.0 + 1e-9)
        _, info = FILTERS[name].step(problem, start_of(problem), s, rng=np.random.default_rng(3))
        best.append(info.best_log_likelihood)
    assert best[0] <= best[1]
    assert best[0] <= best[2]
    assert best[0] <= best[3]


def test_hapsopf_without_moves_is_partitioned_sampling_to_the_byte() -> None:
    """XN 6.1.2, "in the same way as PS": what a swarm adds are its moves. As printed it lacks the draws."""
    problem = LinearGaussianTree(TREE, Z, NOISE)
    spread = ParticleState(np.random.default_rng(1).normal(size=(60, D)), np.full(60, 1 / 60))
    ps = PartitionedSettings(n_particles=60, std=np.full(D, 0.3))
    a, sampled = FILTERS["ps"].step(problem, spread, ps, rng=np.random.default_rng(2))
    b, swarm = FILTERS["hapsopf"].step(problem, spread, settings(60, 0), rng=np.random.default_rng(2))
    assert a.particles.tobytes() == b.particles.tobytes()
    assert a.weights.tobytes() == b.weights.tobytes()
    assert swarm.best_log_likelihood == pytest.approx(sampled.best_log_likelihood)
    c, _ = FILTERS["hapsopf-printed"].step(problem, spread, settings(60, 0), rng=np.random.default_rng(2))
    assert not np.array_equal(b.particles, c.particles)


@pytest.mark.parametrize(
    ("name", "is_drawn"), [*((n, False) for n in PRINTED), ("hapsopf", True), ("chapsopf", True)]
)
def test_a_bad_place_of_a_part_lives_on_only_without_a_draw(name: str, is_drawn: bool) -> None:
    """Every second particle has its root where the likelihood is nothing; no moves that could mend it."""
    layout = tree_layout([-1, 0, 1], [1, 1, 1])
    problem = LinearGaussianTree(layout, np.zeros(3), NOISE)
    particles = np.zeros((20, 3))
    particles[::2, 0] = 5.0
    still = replace(settings(20, 0, 3), std=np.full(3, 1e-6))
    state, info = FILTERS[name].step(
        problem, ParticleState(particles, np.full(20, 0.05)), still, rng=np.random.default_rng(0)
    )
    assert (np.abs(state.particles[:, 0]).max() < 1e-3) == is_drawn
    assert abs(info.estimate[0]) < 1e-3, "its weight is nothing either way"
    # Drawn, all particles are alike and weigh the same; else the good half shares the weight.
    assert info.ess[-1] == pytest.approx(20 if is_drawn else 10, rel=1e-3)


@pytest.mark.parametrize("name", SWARMS)
def test_the_same_seed_gives_the_same_bytes(name: str) -> None:
    problem = LinearGaussianTree(TREE, Z, NOISE)
    (a, _), (b, _), (c, _) = (
        FILTERS[name].step(problem, start_of(problem), settings(), rng=np.random.default_rng(seed))
        for seed in (4, 4, 5)
    )
    assert a.particles.tobytes() == b.particles.tobytes()
    assert a.weights.tobytes() == b.weights.tobytes()
    assert not np.array_equal(a.particles, c.particles)


@pytest.mark.parametrize("name", SWARMS)
@pytest.mark.parametrize("silence", [-np.inf, np.nan])
def test_zero_weights_everywhere_are_survived_and_said(name: str, silence: float) -> None:
    problem = LinearGaussianTree(TREE, Z, NOISE, silent=tuple(range(P)), silence=silence)
    state, info = FILTERS[name].step(problem, start_of(problem), settings(), rng=np.random.default_rng(0))
    assert info.is_degenerate
    assert np.isfinite(state.particles).all()
    assert np.isfinite(info.estimate).all()
    np.testing.assert_allclose(state.weights, 1 / 40)


@pytest.mark.parametrize("name", PART_BY_PART)
def test_a_part_without_data_does_not_stop_the_others(name: str) -> None:
    problem = LinearGaussianTree(TREE, Z, NOISE, silent=(2,))
    rng, state = np.random.default_rng(0), start_of(problem)
    for _ in range(3):
        state, info = FILTERS[name].step(problem, state, settings(80, 8), rng=rng)
    assert info.is_degenerate
    seen = [0, 1, 3]
    assert np.abs((positions_of(TREE) @ info.estimate - Z)[seen]).max() < 0.15


@pytest.mark.parametrize("name", SWARMS)
def test_two_particles_parts_without_columns_and_forests(name: str) -> None:
    forest = tree_layout([-1, -1, 0, 1, 1], [1, 2, 0, 1, 1])
    problem = LinearGaussianTree(forest, np.zeros(5), NOISE)
    s = settings(2, 1, forest.n_columns)
    state, info = FILTERS[name].step(problem, start_of(problem), s, rng=np.random.default_rng(0))
    assert state.particles.shape == (2, 5)
    assert np.isfinite(info.estimate).all()


@pytest.mark.parametrize("name", PART_BY_PART)
def test_a_global_likelihood_is_refused(name: str) -> None:
    problem = LinearGaussianTree(TREE, Z, NOISE, is_global=True)
    with pytest.raises(ValueError, match="part by part"):
        FILTERS[name].step(problem, start_of(problem), settings(), rng=np.random.default_rng(0))


def test_bad_settings_are_refused() -> None:
    bad: tuple[tuple[dict[str, object], str], ...] = (
        ({"n_particles": 1}, "n_particles"),
        ({"n_iterations": -1}, "n_iterations"),
        ({"covariance_factor": 0.0}, "covariance_factor"),
        ({"beta_0": 1.5}, "beta_0"),
        ({"beta_min": 4.0}, "beta_min"),
        ({"resampling": "lottery"}, "lottery"),
    )
    for change, message in bad:
        with pytest.raises(ValueError, match=message):
            replace(settings(), **change)  # type: ignore[arg-type]


@dataclass(eq=False)
class Still(LinearGaussianTree):
    """Nothing moves by itself, so that a swarm's moves stand alone."""

    def propagate(self, particles: np.ndarray, std: np.ndarray, *, rng: np.random.Generator) -> np.ndarray:
        return particles.copy()


def test_a_swarm_moves_by_inertia_its_own_best_and_the_leader() -> None:
    """XN Eq. 3.6 written out particle by particle, with the same draws."""
    problem = Still(TREE, Z, NOISE)
    s = settings(12, 6)
    start = np.random.default_rng(1).normal(size=(12, D))

    def score(x: np.ndarray) -> np.ndarray:
        return problem.log_likelihood(x).sum(axis=1)

    kind = Swarm(constant_attraction, has_velocity=True, is_estimate_best=True, is_carried_on=True)
    found, value = fly(problem, score, start, np.arange(D), s, kind, rng=np.random.default_rng(7))
    rng = np.random.default_rng(7)
    x, best = start.copy(), start.copy()
    v = (2.0 * rng.random((12, D)) - 1.0) * s.std
    n_returned = 0
    for _ in range(s.n_iterations):
        leader = best[np.argmax(score(best))].copy()
        own, common = rng.random((12, D)), rng.random((12, D))
        for k in range(12):
            v[k] = s.inertia * v[k] + s.attraction * (own[k] * (best[k] - x[k]) + common[k] * (leader - x[k]))
            x[k] = x[k] + v[k]
            if score(x[k : k + 1])[0] > score(best[k : k + 1])[0]:
                best[k] = x[k]
            else:
                n_returned += 1
    assert n_returned > 12, "some must have been better before"
    np.testing.assert_allclose(found, best, atol=1e-12)
    np.testing.assert_allclose(value, score(best), atol=1e-9)
