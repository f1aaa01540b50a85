"""Every registered filter on the voxel body, with the settings that an equal budget gives it."""

import re
from pathlib import Path

import numpy as np
import pytest
from flesh_voxels import Flesh

from mocap.body import landmarks_of, neutral_state
from mocap.filters import FILTERS, FilterBudget, FilterSettings, filter_settings, initial_particles
from mocap.likelihood.voxels import VoxelLikelihoodSettings, VoxelProblem
from mocap.pose.volume import pack_volume

N_PARTICLES, N_LAYERS = 60, 4
# Every filter divides its budget into whole particles; what is left over stays unspent.
BUDGET_TOLERANCE = 0.1
IS_POSITION = np.arange(27) < 3
STD = np.where(IS_POSITION, 0.02, 0.08)
WHOLE_STATE = ("sir", "apf", "pso", "apsopf")


def body_problem(flesh: Flesh, *, factorised: bool = True) -> tuple[VoxelProblem, np.ndarray]:
    """The neutral pose as a hull with one voxel of margin."""
    truth = neutral_state(flesh.body)
    volume = pack_volume(flesh.grid, flesh.hull(truth, margin_m=flesh.grid.voxel_size_m), 1.0)
    settings = VoxelLikelihoodSettings(factorised=factorised)
    return VoxelProblem(flesh.body, flesh.table, volume, settings), truth


def test_every_filter_stands_under_its_own_name() -> None:
    assert [own.name for own in FILTERS.values()] == list(FILTERS)
    assert len({own.label for own in FILTERS.values()}) == len(FILTERS)


@pytest.mark.parametrize("name", sorted(FILTERS))
def test_a_filter_runs_within_its_budget_and_stays_sane(coarse_flesh: Flesh, name: str) -> None:
    problem, truth = body_problem(coarse_flesh)
    layout = problem.layout
    settings = filter_settings(FilterBudget(name, n_particles=N_PARTICLES, n_layers=N_LAYERS), layout, STD)
    rng = np.random.default_rng(0)
    state = initial_particles(problem, truth, settings.n_particles)
    for _ in range(2):
        state, info = FILTERS[name].step(problem, state, settings, rng=rng)
    assert info.n_evaluations == pytest.approx(N_PARTICLES * N_LAYERS, rel=BUDGET_TOLERANCE)
    assert not info.is_degenerate
    assert np.isfinite(state.particles).all()
    assert np.all(state.particles >= layout.lower)
    assert np.all(state.particles <= layout.upper)
    assert state.weights.shape == (len(state.particles),)
    assert state.weights.sum() == pytest.approx(1.0)
    assert np.isfinite(info.estimate).all()
    assert 0 < info.ess[-1] <= len(state.weights) * (1 + 1e-9)
    points = landmarks_of(problem.body, np.stack([info.estimate, truth]))
    assert np.linalg.norm(points[0] - points[1], axis=1).mean() < 0.5, "still the same person"


@pytest.mark.parametrize("name", sorted(FILTERS))
def test_the_same_seed_gives_the_same_estimate(coarse_flesh: Flesh, name: str) -> None:
    problem, truth = body_problem(coarse_flesh)
    settings = filter_settings(FilterBudget(name, n_particles=20, n_layers=2), problem.layout, STD)
    found = []
    for seed in (1, 1, 2):
        start = initial_particles(problem, truth, settings.n_particles)
        _, info = FILTERS[name].step(problem, start, settings, rng=np.random.default_rng(seed))
        found.append(info.estimate)
    assert found[0].tobytes() == found[1].tobytes()
    assert not np.array_equal(found[0], found[2])


@pytest.mark.parametrize("name", WHOLE_STATE)
def test_filters_of_the_whole_state_take_a_global_likelihood(coarse_flesh: Flesh, name: str) -> None:
    problem, truth = body_problem(coarse_flesh, factorised=False)
    settings = filter_settings(FilterBudget(name, n_particles=20, n_layers=2), problem.layout, STD)
    start = initial_particles(problem, truth, settings.n_particles)
    _, info = FILTERS[name].step(problem, start, settings, rng=np.random.default_rng(0))
    assert np.isfinite(info.estimate).all()


@pytest.mark.parametrize("name", sorted(name for name, own in FILTERS.items() if own.is_part_by_part))
def test_filters_of_parts_refuse_a_global_likelihood(coarse_flesh: Flesh, name: str) -> None:
    problem, truth = body_problem(coarse_flesh, factorised=False)
    settings = filter_settings(FilterBudget(name, n_particles=20, n_layers=2), problem.layout, STD)
    start = initial_particles(problem, truth, settings.n_particles)
    with pytest.raises(ValueError, match="part by part"):
        FILTERS[name].step(problem, start, settings, rng=np.random.default_rng(0))


def test_budgets_are_split_as_documented() -> None:
    from linear_gaussian_tree import tree_layout

    layout = tree_layout([-1, 0], [1, 1])

    def settings(name: str, n_layers: int = 3) -> FilterSettings:
        return filter_settings(FilterBudget(name, n_particles=50, n_layers=n_layers), layout, np.ones(2))

    assert settings("ps").n_particles == 150
    assert settings("psapf").n_particles == 50
    swarm = settings("hapsopf")
    assert (swarm.n_particles, swarm.n_iterations) == (50, 2)  # type: ignore[attr-defined]
    one = settings("pso", n_layers=1)
    assert (one.n_particles, one.n_iterations) == (25, 1)  # type: ignore[attr-defined]


def test_impossible_budgets_are_refused() -> None:
    from linear_gaussian_tree import tree_layout

    layout = tree_layout([-1, 0], [1, 1])
    with pytest.raises(ValueError, match="'lottery' is none of sir, apf"):
        filter_settings(FilterBudget("lottery", n_particles=50, n_layers=3), layout, np.ones(2))
    with pytest.raises(ValueError, match=r"std has shape \(3,\), expected \(2,\)"):
        filter_settings(FilterBudget("ps", n_particles=50, n_layers=3), layout, np.ones(3))
    for n_particles, n_layers in ((1, 3), (50, 0)):
        with pytest.raises(ValueError, match="n_layers >= 1 and n_particles >= 2"):
            filter_settings(
                FilterBudget("ps", n_particles=n_particles, n_layers=n_layers), layout, np.ones(2)
            )


def test_the_page_names_every_filter_and_its_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    text = (Path(__file__).parents[2] / "docs" / "decomposition.md").read_text(encoding="utf-8")
    spread = ("sir", "apf", "ps", "parallel-ps", "sbps", "sbapf", "pfcr", "pfcr-equal", "psapf")
    swarms = ("pso", "hpso", "apsopf", "chapsopf", "hapsopf", "chapsopf-printed", "hapsopf-printed")
    assert [name for name in (*spread, *swarms) if f"`{name}`" not in text] == []
    (example,) = re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)
    exec(compile(example, "decomposition.md", "exec"), {"__name__": "page"})
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("[['torso'], ['head',")
    assert said[1] == "300 3"
