"""Make docs/pictures/decomposition.png: the sets of parts of the body, and what swapping does to a posterior.

python -m docs.make_decomposition_picture
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mocap.body import load_body_model, scale_body
from mocap.data import StateLayout
from mocap.filters import FILTERS, FilterBudget, filter_settings, initial_particles
from mocap.filters.parts import part_sets
from mocap.view.plotting import LINE_COLOURS, LINE_STYLES

Array = NDArray[np.float64]

OUT = Path(__file__).parent / "pictures" / "decomposition.png"
STD, NOISE, SEEN = 0.6, 0.5, 0.4
N_PARTICLES = 40_000


@dataclass(frozen=True, eq=False)
class ThreeSiblings:
    """A known root with three parts of one column each, all seen at SEEN with Gaussian noise."""

    layout = StateLayout(
        names=("root", "a", "b", "c"),
        lower=np.full(4, -np.inf),
        upper=np.full(4, np.inf),
        is_circular=np.zeros(4, dtype=np.bool_),
        parts=("root", "a", "b", "c"),
        part_of_column=np.arange(4),
        parent_of_part=np.array([-1, 0, 0, 0]),
    )

    def propagate(self, particles: Array, std: Array, *, rng: np.random.Generator) -> Array:
        return particles + std * rng.normal(size=particles.shape)

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        scored = [0, 1, 2, 3] if parts is None else list(parts)
        value = -0.5 * ((particles[:, scored] - SEEN) / NOISE) ** 2
        value[:, np.array(scored) == 0] = 0.0
        return value


def draw_sets(ax: Any) -> None:
    """The part tree of the default body, one column of boxes for each set."""
    layout = scale_body(load_body_model("anthropometric"), 1.75).layout
    sets = part_sets(layout)
    at = {}
    rows = {p: i for i, p in enumerate([p for p in range(layout.n_parts) if p not in sets[0]])}
    for j, parts in enumerate(sets):
        for part in parts:
            below = [rows[p] for p in rows if p == part or int(layout.parent_of_part[p]) == part]
            at[part] = (1.6 * j, -float(np.mean(below)))
    for part, parent in enumerate(layout.parent_of_part):
        if parent >= 0:
            (x0, y0), (x1, y1) = at[int(parent)], at[part]
            ax.plot([x0, x1], [y0, y1], color="#8a939e", lw=1, zorder=1)
    for j, parts in enumerate(sets):
        for part in parts:
            ax.text(
                *at[part],
                layout.parts[part].replace("_", " "),
                ha="center",
                va="center",
                fontsize=8,
                color="white",
                bbox={"boxstyle": "round,pad=0.35", "fc": LINE_COLOURS[j], "ec": "none"},
            )
        ax.text(1.6 * j, 1.0, f"$P_{j + 1}$", ha="center", fontsize=11, color=LINE_COLOURS[j])
    ax.set_xlim(-0.7, 1.6 * (len(sets) - 1) + 0.7)
    ax.set_ylim(-len(rows), 1.8)
    ax.axis("off")
    ax.set_title("Sets of parts that are processed together", fontsize=10)


def draw_posteriors(ax: Any) -> None:
    """Marginal of one of three siblings: exact, with combinatorial resampling, and with swapping."""
    problem = ThreeSiblings()
    x = np.linspace(-0.9, 1.5, 49)
    precision = 1 / STD**2 + 1 / NOISE**2
    mean = SEEN / NOISE**2 / precision
    exact = np.sqrt(precision / (2 * np.pi)) * np.exp(-0.5 * precision * (x - mean) ** 2)
    ax.fill_between(x, exact, color="#d9dde2", label="posterior")
    for k, name in enumerate(("pfcr-equal", "sbps")):
        settings = filter_settings(
            FilterBudget(name, n_particles=N_PARTICLES, n_layers=1),
            problem.layout,
            np.array([0.0, STD, STD, STD]),
        )
        start = initial_particles(problem, np.zeros(4), 2)
        state, _ = FILTERS[name].step(problem, start, settings, rng=np.random.default_rng(0))
        density, edges = np.histogram(state.particles[:, 1], bins=x, weights=state.weights, density=True)
        ax.plot(0.5 * (edges[1:] + edges[:-1]), density, color=LINE_COLOURS[k], ls=LINE_STYLES[k], label=name)
    ax.set_title("One of three siblings of a known parent", fontsize=10)
    ax.set_xlabel("its column")
    ax.set_ylabel("density")
    ax.legend(fontsize=9, frameon=False)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def main() -> None:
    """Draw and write."""
    figure = Figure(figsize=(9.0, 3.6), dpi=100, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    draw_sets(left)
    draw_posteriors(right)
    figure.savefig(OUT, format="png")
    print(OUT, OUT.stat().st_size)


if __name__ == "__main__":
    main()
