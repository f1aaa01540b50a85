"""CF Figure 6.13: the marker filter at all synthetic detectors and 20 filter settings, through the sweep engine.

CF counts 360 detectors and 7200 combinations; the levels that it prints (5 rates x 6 numbers of false detections x 6
variances) make 180 and 3600, and those are run here.

A detector is a detection rate, a mean number of false detections and a variance of the noise; a filter is a number of
layers and of particles in each. The figure shows the share of landmarks within 100 mm (MMTA) at a detection rate of
0.9 as colours, without numbers; published are the text's three findings and the average of Table 6.3 (95.32 % at rate
0.9, 20 false detections, variance 4, 3 layers of 700). CF gives the variance in mm; the noise is added to pixels, and
so is ours.

Every cell is a job of `mocap.pipeline.cluster`: a run that was stopped is continued, and `--scheduler` gives the cells
to any dask cluster whose workers have this checkout.

    python -m eval.markers_figure_6_13                  the figure: 36 detectors x 20 filters, 20 frames of one walk
    python -m eval.markers_figure_6_13 --sample 500     500 of all 3600 combinations, by chance
    python -m eval.markers_figure_6_13 --full           all 3600 on five actions and all frames: days on one CPU

The committed table took 23 minutes with one worker beside other work on the machine; a cell of it takes 0.2 to 0.5 s
when the CPU is free. One clip and one seed per cell: single cells scatter by some 10 percent points.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from eval.markers_table_6_3 import PUBLISHED, Clip, Detector, Filter, make_clip, prepare, run_cell
from eval.whole import save_figure, write_csv
from mocap.errors import MocapError
from mocap.pipeline.cluster import Engine, Job, Standing, run_jobs
from mocap.pipeline.cluster.spec import sample_indices
from mocap.pipeline.config import config_hash
from mocap.pipeline.reach import code_hash
from mocap.pose.marker_person import Prepared

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "eval" / "results" / "markers_figure_6_13.csv"
PICTURE = RESULTS.with_suffix(".png")

RATES = (1.0, 0.9, 0.8, 0.7, 0.6)
LEVELS = (0, 20, 40, 60, 80, 100)
LAYERS = (1, 3, 5, 7)
PARTICLES = (100, 300, 500, 700, 900)
FIGURE_RATE = 0.9
PUBLISHED_MMTA = 95.32

Cell = tuple[Detector, Filter]


def cells(rates: Sequence[float]) -> list[Cell]:
    """Detectors x filters, the filters fastest."""
    return [
        (Detector(rate, fp, variance), Filter(layers, n))
        for rate in rates
        for fp in LEVELS
        for variance in LEVELS
        for layers in LAYERS
        for n in PARTICLES
    ]


@cache
def _clip(action: str, n_frames: int | None) -> Clip:
    return make_clip(action, n_frames)


@cache
def _prepared(action: str, n_frames: int | None, seed: int) -> Prepared | None:
    return prepare(_clip(action, n_frames), seed)


def work(parameters: dict[str, Any]) -> dict[str, Any]:
    """One cell; clip and first pose are kept by the worker for its next cells."""
    action, n_frames, seed = parameters["action"], parameters["n_frames"], parameters["seed"]
    person = _prepared(action, n_frames, seed)
    if person is None:
        raise MocapError(f"no first pose was found in {action}", remedy="take another seed")
    detector = Detector(parameters["rate"], parameters["false_positives"], parameters["variance_px2"])
    which = Filter(parameters["n_layers"], parameters["n_particles"])
    return run_cell(_clip(action, n_frames), person, detector, which, seed)


def job_of(action: str, n_frames: int | None, seed: int, cell: Cell, code: str) -> Job:
    """The cell as a job whose key is all that its result depends on."""
    detector, which = cell
    parameters = {
        "action": action,
        "n_frames": n_frames,
        "seed": seed,
        "rate": detector.rate,
        "false_positives": detector.false_positives,
        "variance_px2": detector.variance,
        "n_layers": which.n_layers,
        "n_particles": which.n_particles,
    }
    return Job(f"cell-{config_hash(code, repr(sorted(parameters.items())))}", work, parameters)


def own_code() -> str:
    """Hash of all code that a cell runs: the package, the scenes and these scripts."""
    digest = hashlib.sha256(code_hash().encode())
    here = Path(__file__).resolve()
    for path in [
        *sorted((ROOT / "mocap" / "synth").rglob("*.py")),
        here.with_name("markers_table_6_3.py"),
        here,
    ]:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def mean_mmta(rows: Sequence[dict[str, Any]], **where: float) -> float:
    """Mean MMTA of the rows that match, %, NaN when there are none."""
    found = [r["mmta_percent"] for r in rows if all(r[k] == v for k, v in where.items())]
    return float(np.mean(found)) if found else float("nan")


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """The figure's layout: a panel per detector at rate 0.9, layers down and particles across, MMTA as colour."""
    from matplotlib.figure import Figure

    fps = sorted({r["false_positives"] for r in rows})
    variances = sorted({r["variance_px2"] for r in rows})
    figure = Figure(figsize=(1.75 * len(fps) + 1.4, 1.4 * len(variances) + 0.7), layout="constrained")
    axes = figure.subplots(len(variances), len(fps), squeeze=False, sharex=True, sharey=True)
    for i, variance in enumerate(variances):
        for j, fp in enumerate(fps):
            where = {"rate": FIGURE_RATE, "false_positives": fp, "variance_px2": variance}
            table = [
                [mean_mmta(rows, **where, n_layers=layers, n_particles=n) for n in PARTICLES]
                for layers in LAYERS
            ]
            ax = axes[i, j]
            ax.set_facecolor("#dddddd")
            shown = ax.imshow(table, vmin=0, vmax=100, cmap="viridis", aspect="auto", origin="lower")
            for (y, x), value in np.ndenumerate(table):
                if np.isfinite(value):
                    ax.text(
                        x,
                        y,
                        f"{value:.0f}",
                        ha="center",
                        va="center",
                        size=6.5,
                        color="w" if value < 60 else "k",
                    )
            ax.set_xticks(range(len(PARTICLES)), [str(n) for n in PARTICLES], size=7)
            ax.set_yticks(range(len(LAYERS)), [str(n) for n in LAYERS], size=7)
            if i == 0:
                ax.set_title(f"{fp:g} false per picture", size=9)
            if j == 0:
                ax.set_ylabel(f"variance {variance:g} px$^2$\nlayers", size=8)
            if i == len(variances) - 1:
                ax.set_xlabel("particles per layer", size=8)
    figure.colorbar(shown, ax=axes, label="MMTA, % of landmarks within 100 mm", shrink=0.6)
    save_figure(figure, path, dpi=64)


def say(rows: Sequence[dict[str, Any]]) -> None:
    """The three findings of the text, with our numbers."""
    near = {"rate": FIGURE_RATE, "false_positives": 20, "n_layers": 3, "n_particles": 700}
    print(
        f"published: {PUBLISHED_MMTA} % on average at rate 0.9, 20 false, variance 4, 3 layers of 700 (Table 6.3)"
    )
    for variance in sorted({r["variance_px2"] for r in rows}):
        print(
            f"ours:      {mean_mmta(rows, **near, variance_px2=variance):.1f} % at variance {variance:g} px2"
        )
    for key, finding in (
        ("false_positives", "published: robust against false detections"),
        ("variance_px2", "published: worse with noise"),
        ("n_layers", "published: more layers are better only up to a point"),
        ("n_particles", "published: 700 are enough"),
        ("rate", "published: rates of 0.6 to 1 were simulated"),
    ):
        levels = sorted({r[key] for r in rows})
        if len(levels) > 1:
            means = ", ".join(f"{v:g}: {mean_mmta(rows, **{key: v}):.1f}" for v in levels)
            print(f"{finding}; our mean MMTA over {key}: {means}")
    for variance in sorted({r["variance_px2"] for r in rows}):
        best = max(
            (
                (mean_mmta(rows, variance_px2=variance, n_layers=n, n_particles=k), n, k)
                for n in LAYERS
                for k in PARTICLES
            ),
            key=lambda found: (np.nan_to_num(found[0], nan=-1.0), -found[1] * found[2]),
        )
        print(f"best at variance {variance:g}: {best[1]} layers of {best[2]} ({best[0]:.1f} %)")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the cells that have no result yet, write CSV and PNG, print the findings."""
    parser = argparse.ArgumentParser(prog="python -m eval.markers_figure_6_13", description=__doc__)
    parser.add_argument("--frames", type=int, default=20, help="frames per clip (default 20)")
    parser.add_argument("--actions", help="comma-separated (default walk; --full: all five)")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--full", action="store_true", help="all detectors, actions and frames")
    parser.add_argument("--sample", type=int, help="so many of all detectors x filters, by chance")
    parser.add_argument("--sample-seed", type=int, default=0)
    parser.add_argument("--workers", type=int, help="processes; 0 = in this one, without dask")
    parser.add_argument("--scheduler", help="address of a running dask scheduler")
    parser.add_argument(
        "--out", type=Path, default=ROOT / "out" / "figure_6_13", help="results of every cell"
    )
    options = parser.parse_args(argv)
    # By its name, not as __main__: workers import the job's function.
    from eval.markers_figure_6_13 import job_of as job_by_name

    is_all = options.full or options.sample is not None
    grid = cells(RATES if is_all else (FIGURE_RATE,))
    chosen = [grid[i] for i in sample_indices(len(grid), options.sample, seed=options.sample_seed)]
    actions = options.actions.split(",") if options.actions else list(PUBLISHED) if options.full else ["walk"]
    n_frames, code = None if options.full else options.frames, own_code()
    jobs = [
        job_by_name(action, n_frames, seed, cell, code)
        for action in actions
        for seed in range(options.seeds)
        for cell in chosen
    ]
    started = time.perf_counter()
    last = [started]

    def progress(standing: Standing) -> None:
        if time.perf_counter() - last[0] > 15.0 or standing.n_finished == standing.n_total:
            last[0] = time.perf_counter()
            left = standing.left_s or 0.0
            print(f"{standing.n_finished}/{standing.n_total}, {left:.0f} s left", file=sys.stderr, flush=True)

    engine = Engine(scheduler=options.scheduler, n_workers=options.workers)
    try:
        found = run_jobs(jobs, options.out, engine=engine, code=code_hash(), progress=progress)
    except MocapError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    rows = [outcome.result for job in jobs if (outcome := found[job.key]).result is not None]
    for job in jobs:
        if not found[job.key].is_done:
            print(f"failed: {job.parameters}: {found[job.key].error}", file=sys.stderr)
    if not rows:
        return 1
    write_csv(RESULTS, list(rows[0]), rows)
    draw(rows, PICTURE)
    say(rows)
    print(f"{len(rows)} cells; this call took {time.perf_counter() - started:.0f} s")
    return 0 if len(rows) == len(jobs) else 1


if __name__ == "__main__":
    sys.exit(main())
