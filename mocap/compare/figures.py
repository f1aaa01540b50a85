"""Figures of a comparison: what the plots of its page show, section by section, and the page as a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.compare.comparison import Comparison
from mocap.compare.page import EvalPage, write_eval_page
from mocap.compare.plots import plot_angle_errors, plot_epsilon, plot_reliability, plot_sweep
from mocap.metrics import EpsilonSearch, epsilon_search, point_errors
from mocap.view.html import Figure
from mocap.view.plots import plot_error_over_time, plot_landmark_errors

Array = NDArray[np.float64]


def write_page(path: Path, comparison: Comparison, *, command: str = "") -> None:
    """The comparison as one HTML file that stands alone."""
    estimate, truth = comparison.estimate.path.name, comparison.truth.path.name
    page = EvalPage(f"{estimate} against {truth}", comparison.scores, figures_of(comparison), command)
    write_eval_page(path, page)


def figures_of(comparison: Comparison) -> dict[str, list[Figure]]:
    """Section of the page -> its figures."""
    scores = comparison.scores
    errors = {p.person: (p.frames, point_errors(p.estimate, p.truth)) for p in comparison.pairs}
    return {
        "points": _point_figures(scores, errors),
        "epsilon": _epsilon_figures(scores, errors),
        "angles": [_angle_figure(scores)],
        "uncertainty": _uncertainty_figures(scores),
    }


def _point_figures(
    scores: dict[str, Any], errors: dict[int, tuple[NDArray[np.int64], Array]]
) -> list[Figure]:
    epsilon_mm, table = scores["epsilon_mm"], scores["per_landmark"]
    return [
        Figure(
            "Error over time.",
            "Mean and worst landmark of every person; what lies above the dotted line does not count as found.",
            plot_error_over_time(errors, epsilon_mm=epsilon_mm),
        ),
        Figure(
            "Error of each landmark.",
            "Mean with one standard deviation; blue is the person's left, orange the right.",
            plot_landmark_errors(
                {n: row["mean_mm"] for n, row in table.items()},
                {n: row["std_mm"] for n, row in table.items()},
                epsilon_mm=epsilon_mm,
            ),
        ),
    ]


def _epsilon_figures(
    scores: dict[str, Any], errors: dict[int, tuple[NDArray[np.int64], Array]]
) -> list[Figure]:
    everything = np.concatenate([e.ravel() for _, e in errors.values()]) if errors else np.zeros(0)
    search = epsilon_search(everything)
    figures = [] if search is None else [_search_figure(everything, search)]
    sweep = {k: np.array([np.nan if v is None else v for v in c]) for k, c in scores["sweep"].items()}
    marks = {"epsilon": scores["epsilon_mm"]}
    if search is not None:
        marks["natural"] = search.by_lilliefors_mm
    figures.append(
        Figure(
            "What epsilon does.",
            "Left: share of landmarks within it, which is also the curve of correct keypoints (PCK). "
            "Right: their error.",
            plot_sweep(**sweep, chosen_mm=marks),
        )
    )
    return figures


def _search_figure(errors_mm: Array, search: EpsilonSearch) -> Figure:
    return Figure(
        "How epsilon was found.",
        "Left: errors, and the Gaussian of those up to epsilon. Middle: their quantiles; a Gaussian is a line. "
        "Right: both tests over epsilon, dotted where they are best.",
        plot_epsilon(
            errors_mm,
            search.epsilon_mm,
            search.lilliefors,
            search.r2,
            search.by_lilliefors_mm,
            search.by_r2_mm,
        ),
    )


def _angle_figure(scores: dict[str, Any]) -> Figure:
    return Figure(
        "Error of each angle.",
        "Bars: read from the landmarks. Strokes: after the reference skeleton was fitted to both sides.",
        plot_angle_errors(
            scores["angles"]["direct"]["per_angle_deg"],
            scores["angles"]["inverse_kinematics"]["per_angle_deg"],
        ),
    )


def _uncertainty_figures(scores: dict[str, Any]) -> list[Figure]:
    found = scores["reliability"]
    if found is None:
        return []
    names = ("level_percent", "coverage_percent", "claimed_mm", "found_mm")
    return [
        Figure(
            "Reliability diagram.",
            "Left: how many true landmarks lie in a region that should hold so many. Right: errors of landmarks "
            "in ten groups, from the surest to the least sure.",
            plot_reliability(*(np.array(found[n]) for n in names)),
        )
    ]
