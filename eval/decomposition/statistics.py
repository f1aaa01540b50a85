"""Means over runs, and how firmly one filter is better than another."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eval.decomposition.store import Row

Array = NDArray[np.float64]

_N_BOOTSTRAP = 2000
_SEED = 17


@dataclass(frozen=True)
class Group:
    """Runs of one filter in one cell of a table, over scenes and seeds.

    mean, std : of the error over all runs (std with n - 1; NaN for one run).  std_in_scene : over the seeds of a
    scene, pooled; the sources' standard deviation is of this kind.
    """

    n: int
    n_failed: int
    mean: float
    std: float
    std_in_scene: float
    resampling_ms: float
    swapping_ms: float
    step_ms: float
    evaluations: float


def grouped(rows: Iterable[Row], *fields: str) -> dict[tuple[str, ...], list[Row]]:
    """Rows by the values of some fields, in order of appearance."""
    found: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[f] for f in fields), []).append(row)
    return found


def values(rows: Sequence[Row], field: str = "error_px") -> Array:
    """A field of the rows that worked."""
    return np.array([float(r[field]) for r in rows if r["status"] == "ok" and r[field]])


def group(rows: Sequence[Row]) -> Group:
    """Mean and spread of some runs."""
    error = values(rows)
    within = [values(own) for own in grouped(rows, "scene_seed").values()]
    freedom = sum(max(0, len(v) - 1) for v in within)
    squares = sum(((v - v.mean()) ** 2).sum() for v in within if len(v))

    def mean(field: str) -> float:
        v = values(rows, field)
        return float(v.mean()) if len(v) else float("nan")

    return Group(
        n=len(error),
        n_failed=len(rows) - len(error),
        mean=mean("error_px"),
        std=float(error.std(ddof=1)) if len(error) > 1 else float("nan"),
        std_in_scene=float(np.sqrt(squares / freedom)) if freedom else float("nan"),
        resampling_ms=mean("resampling_ms"),
        swapping_ms=mean("swapping_ms"),
        step_ms=mean("step_ms"),
        evaluations=mean("evaluations"),
    )


@dataclass(frozen=True)
class Ratio:
    """Mean error of the one that should be better over that of the other, with its 95 % interval."""

    ratio: float
    low: float
    high: float
    n: int

    @property
    def holds(self) -> bool:
        return self.ratio < 1.0

    @property
    def verdict(self) -> str:
        """yes or no where the interval excludes 1, else 'open'."""
        if self.high < 1.0:
            return "yes"
        return "no" if self.low > 1.0 else "open"


Compare = Callable[[Sequence[Row], Sequence[Row]], Ratio]


def _paired(better: Sequence[Row], worse: Sequence[Row]) -> tuple[list[str], Array, Array]:
    """Scenes and both errors of the runs that both have (same scene and seed)."""
    one = {(r["scene_seed"], r["run_seed"]): float(r["error_px"]) for r in better if r["status"] == "ok"}
    two = {(r["scene_seed"], r["run_seed"]): float(r["error_px"]) for r in worse if r["status"] == "ok"}
    common = sorted(one.keys() & two.keys())
    return (
        [scene for scene, _ in common],
        np.array([one[k] for k in common]),
        np.array([two[k] for k in common]),
    )


def _drawn_ratio(a: Array, b: Array, n: int) -> Ratio:
    """Ratio of the means of paired errors with its bootstrap interval; n : runs behind it. NaN without any."""
    if not len(a):
        return Ratio(float("nan"), float("nan"), float("nan"), 0)
    picks = np.random.default_rng(_SEED).integers(0, len(a), (_N_BOOTSTRAP, len(a)))
    low, high = np.quantile(a[picks].mean(axis=1) / b[picks].mean(axis=1), [0.025, 0.975])
    return Ratio(float(a.mean() / b.mean()), float(low), float(high), n)


def ratio_of_means(better: Sequence[Row], worse: Sequence[Row]) -> Ratio:
    """Ratio of the mean errors over the runs that both have, paired bootstrap over runs: of these scenes.

    NaN without common runs.
    """
    _, a, b = _paired(better, worse)
    return _drawn_ratio(a, b, len(a))


def ratio_over_scenes(better: Sequence[Row], worse: Sequence[Row]) -> Ratio:
    """The same with whole scenes drawn instead of runs, so that it speaks of other scenes as well."""
    scenes, a, b = _paired(better, worse)
    rows = [np.array([s == scene for s in scenes]) for scene in dict.fromkeys(scenes)]
    means = [np.array([errors[own].mean() for own in rows]) for errors in (a, b)]
    return _drawn_ratio(means[0], means[1], len(a))


@dataclass(frozen=True)
class Claim:
    """A published order in one cell: `better` has the lower error than `worse`.

    cell : what the cell is, in words.  published : their ratio, NaN where only a figure or a sentence says so.
    """

    source: str
    cell: str
    better: str
    worse: str
    published: float
    ours: Ratio


def share_that_holds(claims: Sequence[Claim]) -> tuple[int, int, int, int]:
    """Of the claims with a result: how many there are, hold, are decided for, are decided against."""
    known = [c for c in claims if np.isfinite(c.ours.ratio)]
    verdicts = [c.ours.verdict for c in known]
    return len(known), sum(c.ours.holds for c in known), verdicts.count("yes"), verdicts.count("no")


def claims_between(
    source: str,
    rows: Sequence[Row],
    *,
    cell_fields: Sequence[str],
    pairs: Callable[[tuple[str, ...]], Iterable[tuple[str, str, float]]],
    name_of: Callable[[Row], str],
    compare: Compare = ratio_of_means,
) -> list[Claim]:
    """Claims of every cell of a table.

    cell_fields : fields that tell the cells apart.  pairs : (better, worse, published ratio) of a cell.
    name_of : what a row's method is called.  compare : the ratio of two groups of runs.
    """
    found = []
    for cell, own in grouped(rows, *cell_fields).items():
        by_name: dict[str, list[Row]] = {}
        for row in own:
            by_name.setdefault(name_of(row), []).append(row)
        for better, worse, published in pairs(cell):
            if better in by_name and worse in by_name:
                ours = compare(by_name[better], by_name[worse])
                words = ", ".join(f"{_SHORT.get(f, f)}={v}" for f, v in zip(cell_fields, cell, strict=True))
                found.append(Claim(source, words, better, worse, published, ours))
    return found


_SHORT = {
    "n_arms": "|P_j|",
    "n_levels": "K",
    "n_objects": "M",
    "n_evaluations": "N",
    "n_clutter": "clutter",
    "n_layers": "layers",
}
