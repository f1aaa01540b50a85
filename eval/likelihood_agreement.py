"""Agreement of the fast likelihood with the exact one: ranks of particles, and what it costs in tracking.

    python -m eval.likelihood_agreement [--scenes walk,gesture] [--seeds 3] [--frames 60]

Writes eval/results/likelihood_agreement.csv (particles around true poses, masks from the video) and
likelihood_tracking.csv (SHBM-APF model 2 and APF with either kind, mean error over seeds). Takes about 4 minutes on one
idle core.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from eval.hull_clips import ROOT, HullClip, fitted_state, head, load_clip, run_filter
from eval.shbm_against_apf import filters
from eval.whole import write_csv

RESULTS = ROOT / "eval" / "results" / "likelihood_agreement.csv"
TRACKING = ROOT / "eval" / "results" / "likelihood_tracking.csv"
FIELDS = (
    "scene",
    "spread",
    "n_points",
    "pearson",
    "top_tenth_overlap",
    "difference_std_nats",
    "us",
    "us_exact",
)
TRACKING_FIELDS = ("scene", "filter", "kind", "seed", "frames", "mean_mm", "mmta_percent", "seconds")
# metres and radians around the true pose, as in a filter's first, middle and last layers.
SPREADS = {"wide": (0.08, 0.25), "mid": (0.03, 0.10), "narrow": (0.01, 0.03)}
_N_PARTICLES = 600
_N_POSES = 6
_TRACKED = ("apf", "shbm model2 mirror")


def agreement(clip: HullClip, scene: str, spread: str, n_points: int, seed: int) -> dict[str, Any]:
    """Means over poses spread over the clip."""
    from mocap.likelihood.voxels import VoxelLikelihoodSettings, VoxelProblem

    std_m, std_rad = SPREADS[spread]
    std = np.where(clip.body.is_position, std_m, std_rad)
    rng = np.random.default_rng(seed)
    rows = []
    for i in np.linspace(0, len(clip.volumes) - 1, _N_POSES).astype(int):
        args = clip.body, clip.table, clip.volumes[i]
        exact = VoxelProblem(*args, VoxelLikelihoodSettings())
        fast = VoxelProblem(*args, VoxelLikelihoodSettings(kind="fast", n_points=n_points))
        pose = fitted_state(clip.body, clip.truth[i])
        particles = exact.propagate(np.tile(pose, (_N_PARTICLES, 1)), std, rng=rng)
        values, times = [], []
        for problem in (exact, fast):
            problem.log_likelihood(particles[:2])  # compiled and sampled before it is timed
            begun = time.thread_time()
            values.append(problem.log_likelihood(particles).sum(axis=1))
            times.append((time.thread_time() - begun) / _N_PARTICLES * 1e6)
        best = [set(np.argsort(-v)[: _N_PARTICLES // 10].tolist()) for v in values]
        rows.append(
            (
                np.corrcoef(*values)[0, 1],
                len(best[0] & best[1]) / len(best[0]),
                np.std(values[0] - values[1]),
                times[1],
                times[0],
            )
        )
    means = np.mean(rows, axis=0)
    return dict(zip(FIELDS, (scene, spread, n_points, *(round(float(m), 4) for m in means)), strict=True))


def tracking(clip: HullClip, scene: str, name: str, kind: Any, seed: int) -> dict[str, Any]:
    """One filter over one clip with one kind of likelihood."""
    from mocap.body import landmarks_of
    from mocap.likelihood.voxels import VoxelLikelihoodSettings
    from mocap.metrics import point_scores

    step, settings = filters(clip)[name]
    begun = time.thread_time()
    states, _ = run_filter(clip, step, settings, seed=seed, likelihood=VoxelLikelihoodSettings(kind=kind))
    seconds = time.thread_time() - begun
    scores = point_scores(landmarks_of(clip.body, states), clip.truth)
    numbers = (round(v, 2) if v is not None else None for v in (scores.mean_mm, scores.mmta_percent, seconds))
    return dict(zip(TRACKING_FIELDS, (scene, name, kind, seed, len(states), *numbers), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", default="walk,gesture")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    runs: list[dict[str, Any]] = []
    for scene in args.scenes.split(","):
        clip = head(load_clip(scene, "video", args.work), args.frames)
        for spread in SPREADS:
            for n_points in (100, 200, 300):
                rows.append(agreement(clip, scene, spread, n_points, seed=3))
                sys.stdout.write(f"{rows[-1]}\n")
        for name in _TRACKED:
            for kind in ("exact", "fast"):
                own = [tracking(clip, scene, name, kind, seed) for seed in range(args.seeds)]
                runs += own
                errors = [r["mean_mm"] for r in own]
                spread_mm = statistics.stdev(errors) if len(errors) > 1 else 0.0
                sys.stdout.write(
                    f"{scene} {name} {kind}: {statistics.fmean(errors):.1f} +- {spread_mm:.1f} mm\n"
                )
                sys.stdout.flush()
    write_csv(RESULTS, FIELDS, rows)
    write_csv(TRACKING, TRACKING_FIELDS, runs)


if __name__ == "__main__":
    main()
