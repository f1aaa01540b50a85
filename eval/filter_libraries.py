"""The filters of this package beside `particles`, `filterpy` and `blackjax`: same model, same evaluations.

Two problems with known answers:

- arms: a linear-Gaussian tree, a centre and four arms of two parts (the shape of SW Table 1), 9 columns, one
  measurement per part. The exact posterior is a Kalman filter's, filterpy's (a direct solution agrees to 1e-9, a test).
- growth: the nonlinear series of Gordon, Salmond and Smith (1993), whose posterior often has two modes. Reference: the
  plain filter with 200,000 particles.

Error: distance of the estimate from the exact posterior mean in its standard deviations, root mean square over columns,
frames and series. Spread: variance that the particles have over the exact one, mean; 1 is honest. Evaluations: of the
likelihood of a whole state. An evaluation per second counts everything that a filter does, measured after a warm-up.

    pip install -e ".[eval]" && pip install --no-deps particles joblib    (it asks for numpy < 2 and runs with 2.4)
    python -m eval.filter_libraries [--series 6]

Writes eval/results/filter_libraries.csv. A few minutes on one core. `particles` and `blackjax` are left out, with a
word, when they are not installed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from eval.whole import write_csv
from mocap.data.problem import StateLayout
from mocap.filters import FILTERS, FilterBudget, filter_settings, initial_particles
from mocap.filters.resampling import systematic

Array = NDArray[np.float64]

RESULTS = Path(__file__).resolve().parents[1] / "eval" / "results" / "filter_libraries.csv"
FIELDS = ("problem", "library", "method", "evaluations", "spent", "error", "spread", "evaluations_per_s")
EVALUATIONS = (64, 256, 1024)
PARENTS = (-1, 0, 0, 0, 0, 1, 2, 3, 4)
_N_REFERENCE = 200_000
# Of a tempered sampler: steps of the likelihood's exponent, each a weighing, a start and one move of every particle.
_TEMPERATURES = (0.5, 1.0)
_EVALUATIONS_PER_TEMPERATURE = 3
_MOVE = 0.3  # standard deviation of a Metropolis move, in steps of the walk
_FILTERS_OF_ARMS = (
    "sir",
    "ps",
    "parallel-ps",
    "sbps",
    "pfcr",
    "pfcr-equal",
    "psapf",
    "sbapf",
    "apf",
    "hapsopf",
)


def line_layout(parents: Sequence[int]) -> StateLayout:
    """One unbounded column for every part."""
    n = len(parents)
    return StateLayout(
        names=tuple(f"part_{p}" for p in range(n)),
        lower=np.full(n, -np.inf),
        upper=np.full(n, np.inf),
        is_circular=np.zeros(n, dtype=np.bool_),
        parts=tuple(f"part_{p}" for p in range(n)),
        part_of_column=np.arange(n),
        parent_of_part=np.array(parents),
    )


@dataclass(frozen=True, eq=False)
class Model:
    """x_t = drift(t, x_{t-1}) + N(0, std^2), z_t = seen(x_t) + N(0, noise^2), one measurement per column.

    start : (D,) known.  z : (T, D).  `at` is a problem of this package, one frame's.
    """

    name: str
    layout: StateLayout
    start: Array
    std: Array
    noise: float
    drift: Callable[[int, Any], Any]
    seen: Callable[[Any], Any]
    z: Array

    def at(self, frame: int) -> Frame:
        return Frame(self, frame)

    @cached_property
    def n_columns(self) -> int:
        return self.layout.n_columns


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame of a model as an `ArticulatedProblem`."""

    model: Model
    frame: int

    @property
    def layout(self) -> StateLayout:
        return self.model.layout

    def propagate(self, particles: Array, std: Array, *, rng: np.random.Generator) -> Array:
        moved = self.model.drift(self.frame, particles) + std * rng.standard_normal(particles.shape)
        # Part after part: the other parts stay.
        return np.where(std > 0, moved, particles)

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        misfit = (self.model.z[self.frame] - self.model.seen(particles)) / self.model.noise
        value = -0.5 * misfit**2
        return np.asarray(value if parts is None else value[:, list(parts)])


def positions(parents: Sequence[int]) -> Array:
    """H (P, P): a part lies at the sum of its own column and those of all it hangs on."""
    H = np.eye(len(parents))
    for part, parent in enumerate(parents):
        if parent >= 0:
            H[part] += H[parent]
    return H


def arms(seed: int, n_frames: int = 40) -> Model:
    """The linear-Gaussian tree."""
    rng = np.random.default_rng([1, seed])
    layout, H = line_layout(PARENTS), positions(PARENTS)
    std = np.ones(layout.n_columns)
    states = np.cumsum(std * rng.standard_normal((n_frames, len(std))), axis=0)
    z = states @ H.T + rng.standard_normal(states.shape)
    return Model("arms", layout, np.zeros(len(std)), std, 1.0, lambda t, x: x, lambda x: x @ H.T, z)


def growth(seed: int, n_frames: int = 60) -> Model:
    """x / 2 + 25 x / (1 + x^2) + 8 cos(1.2 t) + N(0, 10), seen as x^2 / 20 + N(0, 1); x_0 = 0.1.

    Source: Gordon, Salmond and Smith 1993.
    """
    rng = np.random.default_rng([2, seed])

    def drift(t: int, x: Any) -> Any:
        return 0.5 * x + 25.0 * x / (1.0 + x * x) + 8.0 * np.cos(1.2 * (t + 1))

    states, x = [], np.array([0.1])
    std = np.array([np.sqrt(10.0)])
    for t in range(n_frames):
        x = drift(t, x) + std * rng.standard_normal(1)
        states.append(x)
    z = np.array(states) ** 2 / 20.0 + rng.standard_normal((n_frames, 1))
    return Model("growth", line_layout((-1,)), np.array([0.1]), std, 1.0, drift, lambda x: x * x / 20.0, z)


PROBLEMS: dict[str, Callable[[int], Model]] = {"arms": arms, "growth": growth}


@dataclass(frozen=True, eq=False)
class Tracked:
    """What came out.  mean, variance : (T, D).  spent : evaluations per frame.  seconds : of all frames."""

    mean: Array
    variance: Array
    spent: float
    seconds: float


Run = Callable[[Model, int, int], Tracked]


def _moments(particles: Array, weights: Array) -> tuple[Array, Array]:
    mean = weights @ particles
    return mean, weights @ (particles - mean) ** 2


def of_this_package(name: str) -> Run:
    """A filter of `FILTERS`."""

    def run(model: Model, n: int, seed: int) -> Tracked:
        n_layers = 2 if name in ("psapf", "sbapf", "apf", "hapsopf") else 1
        budget = FilterBudget(name, n_particles=n // n_layers, n_layers=n_layers)
        settings = filter_settings(budget, model.layout, model.std)
        step, rng = FILTERS[name].step, np.random.default_rng(seed)
        state = initial_particles(model.at(0), model.start, n // n_layers)
        found, spent = [], 0
        begun = time.perf_counter()
        for frame in range(len(model.z)):
            state, info = step(model.at(frame), state, settings, rng=rng)
            found.append(_moments(state.particles, state.weights))
            spent += info.n_evaluations
        seconds = time.perf_counter() - begun
        mean, variance = (np.array(v) for v in zip(*found, strict=True))
        return Tracked(mean, variance, spent / len(model.z), seconds)

    return run


def exact(model: Model) -> tuple[Array, Array]:
    """Mean and variance (T, D) of the posterior: filterpy's Kalman filter, or very many particles."""
    if model.name != "arms":
        reference = of_this_package("sir")(model, _N_REFERENCE, 0)
        return reference.mean, reference.variance
    from filterpy.kalman import KalmanFilter

    D = model.n_columns
    kalman = KalmanFilter(dim_x=D, dim_z=D)
    kalman.x, kalman.P = model.start[:, None].copy(), np.zeros((D, D))
    kalman.F, kalman.Q = np.eye(D), np.diag(model.std**2)
    kalman.H, kalman.R = model.seen(np.eye(D)).T, model.noise**2 * np.eye(D)
    found = []
    for z in model.z:
        kalman.predict()
        kalman.update(z[:, None])
        found.append((kalman.x[:, 0].copy(), np.diag(kalman.P).copy()))
    mean, variance = (np.array(v) for v in zip(*found, strict=True))
    return mean, variance


def of_filterpy(model: Model, n: int, seed: int) -> Tracked:
    """The plain filter as filterpy's book has it, with its systematic resampling."""
    from filterpy.monte_carlo import resampling

    rng = np.random.default_rng(seed)
    particles, weights = np.tile(model.start, (n, 1)), np.full(n, 1.0 / n)
    found = []
    begun = time.perf_counter()
    with mock.patch.object(resampling, "random", np.random.RandomState(seed).random):
        for frame in range(len(model.z)):
            problem = model.at(frame)
            drawn = resampling.systematic_resample(weights)
            particles = problem.propagate(particles[drawn], model.std, rng=rng)
            log_weights = problem.log_likelihood(particles).sum(axis=1)
            weights = np.exp(log_weights - log_weights.max())
            weights /= weights.sum()
            found.append(_moments(particles, weights))
    seconds = time.perf_counter() - begun
    mean, variance = (np.array(v) for v in zip(*found, strict=True))
    return Tracked(mean, variance, n, seconds)


def of_filterpy_unscented(model: Model, n: int, seed: int) -> Tracked:
    """filterpy's unscented Kalman filter: no particles, 2 D + 1 evaluations."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    D = model.n_columns
    frame_of = iter(range(len(model.z)))
    now = [0]
    points = MerweScaledSigmaPoints(D, alpha=1.0, beta=2.0, kappa=3.0 - D)
    kalman = UnscentedKalmanFilter(
        D, D, 1.0, hx=model.seen, fx=lambda x, dt: model.drift(now[0], x), points=points
    )
    kalman.x, kalman.P = model.start.copy(), 1e-6 * np.eye(D)
    kalman.Q, kalman.R = np.diag(model.std**2), model.noise**2 * np.eye(D)
    found = []
    begun = time.perf_counter()
    for now[0] in frame_of:
        kalman.predict()
        kalman.update(model.z[now[0]])
        found.append((kalman.x.copy(), np.diag(kalman.P).copy()))
    seconds = time.perf_counter() - begun
    mean, variance = (np.array(v) for v in zip(*found, strict=True))
    return Tracked(mean, variance, 2 * D + 1, seconds)


@contextmanager
def _particles_draws_from(state: np.random.RandomState) -> Iterator[None]:
    """`particles` with a generator of its own; by itself it draws from numpy's global one, its Gaussians through
    scipy."""
    from particles import resampling
    from scipy import stats

    before = stats.norm.random_state
    stats.norm.random_state = state
    try:
        with mock.patch.object(resampling, "random", state):
            yield
    finally:
        stats.norm.random_state = before


def of_particles(*, is_guided: bool) -> Run:
    """The bootstrap filter of `particles`, or its guided filter with the exact proposal of the linear model."""

    def run(model: Model, n: int, seed: int) -> Tracked:
        import particles
        from particles import collectors, distributions, state_space_models

        normal = distributions.MvNormal
        Q, R = np.diag(model.std**2), model.noise**2 * np.eye(model.n_columns)
        H = model.seen(np.eye(model.n_columns)).T  # used where the model is linear
        posterior = np.linalg.inv(np.linalg.inv(Q) + H.T @ np.linalg.inv(R) @ H)

        class Series(state_space_models.StateSpaceModel):  # type: ignore[misc]
            def PX0(self) -> Any:
                return normal(loc=model.drift(0, model.start), cov=Q)

            def PX(self, t: int, xp: Array) -> Any:
                return normal(loc=model.drift(t, xp), cov=Q)

            def PY(self, t: int, xp: Array, x: Array) -> Any:
                return normal(loc=model.seen(x), cov=R)

            def proposal0(self, data: Array) -> Any:
                return self.proposal(0, model.start[None], data)

            def proposal(self, t: int, xp: Array, data: Array) -> Any:
                pull = xp @ np.linalg.inv(Q) + data[t] @ np.linalg.inv(R) @ H
                return normal(loc=pull @ posterior, cov=posterior)

        kind = state_space_models.GuidedPF if is_guided else state_space_models.Bootstrap
        filter_ = particles.SMC(
            fk=kind(ssm=Series(), data=model.z),
            N=n,
            resampling="systematic",
            ESSrmin=1.0,
            collect=[collectors.Moments()],
        )
        begun = time.perf_counter()
        with _particles_draws_from(np.random.RandomState(seed)):
            filter_.run()
        seconds = time.perf_counter() - begun
        moments = filter_.summaries.moments
        mean, variance = (np.array([m[k] for m in moments]) for k in ("mean", "var"))
        return Tracked(mean, variance, n, seconds)

    return run


@cache
def _annealer(problem: str) -> Callable[..., Any]:
    """(key, particles before the noise, measurement) -> particles and weights after it, compiled once."""
    import jax
    import jax.numpy as jnp
    from blackjax import rmh, tempered_smc
    from blackjax.smc import resampling

    jax.config.update("jax_enable_x64", True)
    model = PROBLEMS[problem](0)
    D, std = model.n_columns, jnp.asarray(model.std)
    kernel = rmh.build_kernel()

    def log_prior(pair: Any) -> Any:
        return -0.5 * jnp.sum(((pair[D:] - pair[:D]) / std) ** 2)

    def move(key: Any, pair: Any) -> Any:
        return pair.at[D:].add(_MOVE * std * jax.random.normal(key, (D,)))

    def anneal(key: Any, before: Any, z: Any) -> Any:
        own, *keys = jax.random.split(key, 1 + len(_TEMPERATURES))
        after = before + std * jax.random.normal(own, before.shape)
        sampler = tempered_smc(
            log_prior,
            lambda pair: -0.5 * jnp.sum(((z - model.seen(pair[D:])) / model.noise) ** 2),
            lambda key, state, log_density: kernel(key, state, log_density, move),
            rmh.init,
            {},
            resampling.systematic,
            num_mcmc_steps=1,
        )
        state = sampler.init(jnp.concatenate([before, after], axis=1))
        for own, exponent in zip(keys, _TEMPERATURES, strict=True):
            state, _ = sampler.step(own, state, exponent)
        return state.particles[:, D:], state.weights

    return jax.jit(anneal)


def of_blackjax(model: Model, n: int, seed: int) -> Tracked:
    """blackjax's tempered SMC in every frame, one random-walk Metropolis move at each exponent: its annealed filter.

    A particle is its state before the noise and after it; moves leave the former alone.
    """
    import jax

    anneal = _annealer(model.name)
    n_particles = n // (len(_TEMPERATURES) * _EVALUATIONS_PER_TEMPERATURE)
    keys = jax.random.split(jax.random.PRNGKey(seed), len(model.z))
    rng = np.random.default_rng(seed)
    x, weights = np.tile(model.start, (n_particles, 1)), np.full(n_particles, 1.0 / n_particles)
    found = []
    begun = time.perf_counter()
    for frame, z in enumerate(model.z):
        x = x[systematic(weights, n_particles, rng=rng)]
        x, weights = (np.asarray(v) for v in anneal(keys[frame], model.drift(frame, x), z))
        found.append(_moments(x, weights))
    seconds = time.perf_counter() - begun
    mean, variance = (np.array(v) for v in zip(*found, strict=True))
    spent = n_particles * len(_TEMPERATURES) * _EVALUATIONS_PER_TEMPERATURE
    return Tracked(mean, variance, spent, seconds)


def methods(problem: str) -> list[tuple[str, str, Run]]:
    """(library, method, run) of the installed libraries."""
    names = _FILTERS_OF_ARMS if problem == "arms" else ("sir",)
    found: list[tuple[str, str, Run]] = [("mocap", name, of_this_package(name)) for name in names]
    if find_spec("particles"):
        found.append(("particles", "bootstrap", of_particles(is_guided=False)))
        if problem == "arms":
            found.append(("particles", "guided, exact proposal", of_particles(is_guided=True)))
    if find_spec("filterpy"):
        found.append(("filterpy", "systematic resampling", of_filterpy))
        found.append(("filterpy", "unscented Kalman", of_filterpy_unscented))
    if find_spec("blackjax"):
        found.append(("blackjax", "tempered SMC", of_blackjax))
    return found


def rows_of(problem: str, n_series: int, evaluations: Sequence[int] = EVALUATIONS) -> list[dict[str, Any]]:
    """Every installed method on one problem, one row for each number of evaluations."""
    models = [PROBLEMS[problem](seed) for seed in range(n_series)]
    answers = [exact(model) for model in models]
    rows = []
    for library, method, run in methods(problem):
        for n in evaluations if method != "unscented Kalman" else evaluations[:1]:
            run(models[0], n, 0)  # compiles
            found = [run(model, n, seed) for seed, model in enumerate(models)]
            squares, spreads = [], []
            for one, (mean, variance) in zip(found, answers, strict=True):
                squares.append(np.mean((one.mean - mean) ** 2 / variance))
                spreads.append(np.mean(one.variance / variance))
            spent = float(np.mean([one.spent for one in found]))
            seconds = sum(one.seconds for one in found)
            frames = sum(len(model.z) for model in models)
            rows.append(
                {
                    "problem": problem,
                    "library": library,
                    "method": method,
                    "evaluations": n,
                    "spent": round(spent),
                    "error": round(float(np.sqrt(np.mean(squares))), 3),
                    "spread": round(float(np.mean(spreads)), 3),
                    "evaluations_per_s": int(float(f"{spent * frames / seconds:.2g}")),
                }
            )
    return rows


def table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Error and spread at every number of evaluations, and the speed at the largest: lines of Markdown."""
    lines = []
    for problem in dict.fromkeys(r["problem"] for r in rows):
        own = [r for r in rows if r["problem"] == problem]
        counts = sorted({int(r["evaluations"]) for r in own})
        head = ["library", "method", *(f"{n}" for n in counts), "spread", "evaluations per s"]
        lines += ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
        for library, method in dict.fromkeys((r["library"], r["method"]) for r in own):
            at = {int(r["evaluations"]): r for r in own if (r["library"], r["method"]) == (library, method)}
            last = at[max(at)]
            errors = [f"{float(at[n]['error']):.2f}" if n in at else "" for n in counts]
            speed = f"{int(last['evaluations_per_s']):,}"
            lines.append(
                "| " + " | ".join([library, method, *errors, f"{float(last['spread']):.2f}", speed]) + " |"
            )
        lines.append("")
    return lines


def main(argv: Sequence[str] | None = None) -> int:
    """Run everything that is installed, write the CSV, print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--series", type=int, default=6, help="series of each problem (default 6)")
    n_series = parser.parse_args(argv).series
    missing = [name for name in ("particles", "filterpy", "blackjax") if not find_spec(name)]
    if "filterpy" in missing:
        sys.stderr.write("filterpy is not installed, and with it the exact answers\n")
        return 2
    if missing:
        sys.stderr.write(f"left out, not installed: {', '.join(missing)}\n")
    rows = [row for problem in PROBLEMS for row in rows_of(problem, n_series)]
    write_csv(RESULTS, FIELDS, rows)
    print("\n".join(table(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
