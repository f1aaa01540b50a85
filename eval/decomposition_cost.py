"""Costs of resampling and swapping, over the number of particles N and of parts P.

Objects with |P_j| arms of length K - 1 (XN 4.4.2) and a likelihood that costs next to nothing, so that only the work of
the filters is seen. Times are processor time of the fastest of several frames. Fits time = a N^x and a P^x and prints
the exponents: 1 is linear (sorting inside groups adds a logarithm).
Writes eval/results/decomposition_cost.csv and decomposition_cost.png.

    python -m eval.decomposition_cost

About one minute on one core. Published (XN Table 5.1, Figures 4-26 to 4-31, seconds for 300 frames): swapping times are
linear in N; at |P_j| = 8, K = 4, N = 600 resampling takes 80.5 s in PS and 22.3 s with combinatorial resampling.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from eval.whole import save_figure, write_csv
from mocap.data import StateLayout
from mocap.filters import FILTERS, FilterBudget, filter_settings, initial_particles

Array = NDArray[np.float64]

RESULTS = Path(__file__).with_name("results")
METHODS = ("ps", "parallel-ps", "sbps", "pfcr-equal")
PARTICLES = (100, 200, 400, 800, 1600, 3200, 6400)
ARMS = (2, 4, 8, 16, 32)
N_LEVELS = 4
N_FRAMES = 20
SIZES_FITTED = 4  # the larger ones: at the smaller, calls cost more than particles


@dataclass(frozen=True, eq=False)
class Cheap:
    """A random walk of an object with arms; part k is likely where its first column is small."""

    layout: StateLayout

    def propagate(self, particles: Array, std: Array, *, rng: np.random.Generator) -> Array:
        moving = np.flatnonzero(std)
        moved = particles.copy()
        moved[:, moving] += std[moving] * rng.normal(size=(len(particles), len(moving)))
        return moved

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        scored = range(self.layout.n_parts) if parts is None else parts
        return -50.0 * particles[:, [int(self.layout.columns_of(p)[0]) for p in scored]] ** 2


def arms_layout(n_arms: int, n_levels: int) -> StateLayout:
    """A center with x, y, theta and `n_arms` chains of n_levels - 1 parts with one angle each."""
    parents = [-1]
    for _ in range(n_arms):
        for level in range(n_levels - 1):
            parents.append(0 if level == 0 else len(parents) - 1)
    part_of_column = np.repeat(np.arange(len(parents)), [3] + [1] * (len(parents) - 1))
    D = len(part_of_column)
    return StateLayout(
        names=tuple(f"column_{c}" for c in range(D)),
        lower=np.full(D, -np.inf),
        upper=np.full(D, np.inf),
        is_circular=np.zeros(D, dtype=np.bool_),
        parts=tuple(f"part_{p}" for p in range(len(parents))),
        part_of_column=part_of_column,
        parent_of_part=np.array(parents),
    )


def milliseconds(name: str, layout: StateLayout, n_particles: int) -> tuple[float, float]:
    """Resampling and swapping time of the fastest frame, ms."""
    problem = Cheap(layout)
    std = np.full(layout.n_columns, 0.1)
    settings = filter_settings(FilterBudget(name, n_particles=n_particles, n_layers=1), layout, std)
    state = initial_particles(problem, np.zeros(layout.n_columns), n_particles)
    rng = np.random.default_rng(0)
    found = []
    with mock.patch.object(
        time, "perf_counter", time.thread_time
    ):  # other work on the machine must not count
        for _ in range(N_FRAMES):
            state, info = FILTERS[name].step(problem, state, settings, rng=rng)
            found.append((info.seconds["resampling"], info.seconds.get("swapping", 0.0)))
    resampling, swapping = 1000 * np.array(found)[1:].min(axis=0)
    return float(resampling), float(swapping)


def exponent(sizes: Sequence[int], times: Sequence[float]) -> float:
    """Slope of log time over log size at the larger sizes."""
    return float(np.polyfit(np.log(sizes[-SIZES_FITTED:]), np.log(times[-SIZES_FITTED:]), 1)[0])


def main() -> None:
    """Measure, print and write."""
    rows: list[dict[str, str | int | float]] = []
    for method in METHODS:
        for n_arms, n_particles in [(8, n) for n in PARTICLES] + [(a, 1600) for a in ARMS if a != 8]:
            layout = arms_layout(n_arms, N_LEVELS)
            resampling, swapping = milliseconds(method, layout, n_particles)
            rows.append(
                {
                    "method": method,
                    "n_particles": n_particles,
                    "n_parts": layout.n_parts,
                    "resampling_ms": round(resampling, 4),
                    "swapping_ms": round(swapping, 4),
                }
            )
    write_csv(RESULTS / "decomposition_cost.csv", list(rows[0]), rows)
    for axis, title in (("n_particles", "over N, P = 25"), ("n_parts", "over P, N = 1600")):
        print(title)
        for method in METHODS:
            sizes, times = _curve(rows, method, axis)
            shown = "  ".join(f"{n}: {t:.2f}" for n, t in zip(sizes, times, strict=True))
            print(f"  {method:12s} exponent {exponent(sizes, times):.2f}   ms  {shown}")
    _picture(rows)


def _curve(
    rows: Sequence[dict[str, str | int | float]], method: str, axis: str
) -> tuple[list[int], list[float]]:
    fixed, value = ("n_parts", 25) if axis == "n_particles" else ("n_particles", 1600)
    chosen = sorted(
        (int(r[axis]), float(r["resampling_ms"]) + float(r["swapping_ms"]))
        for r in rows
        if r["method"] == method and r[fixed] == value
    )
    return [n for n, _ in chosen], [t for _, t in chosen]


def _picture(rows: Sequence[dict[str, str | int | float]]) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from mocap.view.plotting import LINE_COLOURS, LINE_STYLES

    figure = Figure(figsize=(8.4, 3.4), dpi=100, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    for ax, axis, label in zip(
        figure.subplots(1, 2),
        ("n_particles", "n_parts"),
        ("particles N (25 parts)", "parts P (1600 particles)"),
        strict=True,
    ):
        for k, method in enumerate(METHODS):
            sizes, times = _curve(rows, method, axis)
            ax.plot(sizes, times, color=LINE_COLOURS[k], ls=LINE_STYLES[k], marker="o", ms=3, label=method)
        reference = np.array(sizes, dtype=np.float64)
        ax.plot(sizes, 0.05 * reference / reference[0], color="#8a939e", lw=0.8, label="linear")
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xlabel(label)
        ax.set_ylabel("ms per frame")
        ax.grid(color="#d9dde2", lw=0.5)
    figure.suptitle("Resampling and swapping, processor time", fontsize=11)
    ax.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    save_figure(figure, RESULTS / "decomposition_cost.png")


if __name__ == "__main__":
    main()
