"""The comparison with other libraries: its exact answers, its models as problems, and that all solve one problem."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from eval.filter_libraries import (
    PARENTS,
    Model,
    arms,
    exact,
    growth,
    methods,
    of_this_package,
    positions,
    rows_of,
    table,
)

pytest.importorskip("filterpy", reason="filterpy, a development dependency, is not installed")


def direct(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """The posterior of every frame from the joint Gaussian of the whole series, without any recursion."""
    H = positions(PARENTS)
    D = len(H)
    means, variances = [], []
    for t in range(1, len(model.z) + 1):
        # x_1 .. x_t are sums of independent steps: prior covariance min(i, j) std^2.
        steps = np.minimum.outer(np.arange(1, t + 1), np.arange(1, t + 1))
        prior = np.kron(steps, np.diag(model.std**2))
        seen = np.kron(np.eye(t), H)
        gain = prior @ seen.T @ np.linalg.inv(seen @ prior @ seen.T + model.noise**2 * np.eye(t * D))
        mean = gain @ model.z[:t].ravel()
        means.append(mean[-D:])
        variances.append(np.diag(prior - gain @ seen @ prior)[-D:])
    return np.array(means), np.array(variances)


def test_the_exact_answer_is_the_direct_solution() -> None:
    model = arms(0, n_frames=6)
    for ours, theirs in zip(exact(model), direct(model), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_filters_of_this_package_come_to_the_exact_answer() -> None:
    """30,000 particles for 9 columns in 5 frames; the plain filter keeps a hundredth of them."""
    model = arms(1, n_frames=5)
    mean, variance = exact(model)
    for name, most in (("sir", 0.25), ("ps", 0.1), ("pfcr-equal", 0.1)):
        found = of_this_package(name)(model, 30_000, 0)
        assert np.sqrt(np.mean((found.mean - mean) ** 2 / variance)) < most, name
        assert found.spent == 30_000


def test_a_frame_moves_only_what_gets_noise_and_scores_the_parts_asked_for() -> None:
    model = arms(2, n_frames=3)
    frame = model.at(1)
    x = np.random.default_rng(0).normal(size=(4, len(PARENTS)))
    std = np.where(np.arange(len(PARENTS)) == 3, 1.0, 0.0)
    moved = frame.propagate(x, std, rng=np.random.default_rng(1))
    assert (moved != x).any(axis=0).tolist() == (std > 0).tolist()
    scores = frame.log_likelihood(x)
    np.testing.assert_allclose(scores[:, [5, 1]], frame.log_likelihood(x, parts=[5, 1]))
    # Part 5 hangs on part 1, part 1 on the root.
    expected = -0.5 * ((model.z[1, 5] - x[:, [0, 1, 5]].sum(axis=1)) / model.noise) ** 2
    np.testing.assert_allclose(scores[:, 5], expected)


def test_the_growth_series_is_that_of_its_paper() -> None:
    model = growth(0)
    x = np.array([[3.0]])
    np.testing.assert_allclose(model.drift(0, x), 1.5 + 75.0 / 10.0 + 8.0 * np.cos(1.2))
    np.testing.assert_allclose(model.seen(x), 0.45)
    still = replace(model, std=np.zeros(1))
    np.testing.assert_array_equal(still.at(0).propagate(x, still.std, rng=np.random.default_rng(0)), x)


@pytest.mark.parametrize("problem", ["arms", "growth"])
@pytest.mark.filterwarnings("ignore")  # of other libraries
def test_every_installed_library_solves_the_problems(problem: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eval.filter_libraries._N_REFERENCE", 5_000)
    rows = rows_of(problem, 1, (60,))
    assert {r["library"] for r in rows} == {
        "mocap",
        *(name for name in ("particles", "filterpy", "blackjax") if find_spec(name)),
    }
    assert len(rows) == len(methods(problem))
    for row in rows:
        assert row["spent"] <= 60
        # One Gaussian for two modes: the unscented filter loses the growth series.
        if row["method"] != "unscented Kalman" or problem == "arms":
            assert row["error"] < 8.0, row
        assert row["evaluations_per_s"] > 0
    assert sum("| mocap | sir |" in line for line in table(rows)) == 1


@pytest.mark.parametrize(
    "library", ["filterpy", pytest.param("particles", marks=pytest.mark.filterwarnings("ignore"))]
)
def test_other_libraries_draw_from_the_seed_and_leave_the_global_generator_alone(library: str) -> None:
    if not find_spec(library):
        pytest.skip(f"{library} is not installed")
    model = arms(3, n_frames=4)
    run = next(run for of, _, run in methods("arms") if of == library)
    before = np.random.get_state()[1].copy()  # noqa: NPY002  (what must not change)
    first, again, other = run(model, 50, 0), run(model, 50, 0), run(model, 50, 1)
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002
    np.testing.assert_array_equal(first.mean, again.mean)
    assert (first.mean != other.mean).any()
