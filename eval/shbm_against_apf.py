"""SHBM-APF against APF at 2,200 particle evaluations per frame, the first pose given (CF 7.5.1, Tables 6.4 and 7.1).

    python -m eval.shbm_against_apf [--scenes walk,gesture] [--masks true,video] [--seeds 3] [--frames 60]

Writes eval/results/shbm_against_apf.csv and .png. Takes about 5 minutes on one idle core, most of it filtering (the
scenes are synthesised once, about a minute each). Published on HumanEva-I, epsilon = 100 mm: APF (3,600 evaluations)
MMTP 90.2 mm, MMTA 71.4 %; SHBM-APF (2,200) 47.5 / 76.9 (model 1) and 45.3 / 76.4 (model 2); at 2,200 evaluations each
SHBM-APF is said to gain 58 % in MMTP and 51 % in MMTA.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from eval.hull_clips import ROOT, HullClip, compare_filters, run_filter
from eval.whole import save_figure

RESULTS = ROOT / "eval" / "results" / "shbm_against_apf.csv"
FIELDS = (
    "scene",
    "masks",
    "filter",
    "seed",
    "frames",
    "mean_mm",
    "mmtp_mm",
    "mmta_percent",
    "lost_wrist_percent",
    "particle_evaluations",
    "body_evaluations",
    "best_log_likelihood",
    "seconds",
)
# mean, MMTP (mm) and MMTA (%) of the source, averages over five actions.
PUBLISHED = {
    "apf": (121.18, 90.17, 71.36),
    "shbm model1 mirror": (54.06, 47.46, 76.85),
    "shbm model2 mirror": (51.34, 45.31, 76.42),
}


FILTERS = (
    "apf",
    "apf 6x600",
    "shbm model1 mirror",
    "shbm model1 direct",
    "shbm model2 mirror",
    "shbm model2 direct",
    "shbm model1_printed mirror",
)


def filters(clip: HullClip) -> dict[str, tuple[Callable[..., Any], Any]]:
    """Name -> step and settings; all spend 2,200 particle evaluations except `apf 6x600` (3,600)."""
    from mocap.body import load_hierarchy
    from mocap.filters.apf import ApfSettings, apf_step
    from mocap.filters.shbm import ShbmSettings, shbm_step

    found: dict[str, tuple[Callable[..., Any], Any]] = {
        "apf": (apf_step, ApfSettings(n_layers=4, n_particles=550, std=clip.std)),
        "apf 6x600": (apf_step, ApfSettings(n_layers=6, n_particles=600, std=clip.std)),
    }
    for model in ("model1", "model2"):
        for crossing in ("mirror", "direct"):
            settings = ShbmSettings(std=clip.std, hierarchy=load_hierarchy(model), crossing=crossing)
            found[f"shbm {model} {crossing}"] = (shbm_step, settings)
    found["shbm model1_printed mirror"] = (
        shbm_step,
        ShbmSettings(std=clip.std, hierarchy=load_hierarchy("model1_printed")),
    )
    return found


def measure(clip: HullClip, scene: str, masks: str, name: str, seed: int) -> dict[str, Any]:
    """One filter over one clip with one seed."""
    return row_of(clip, {"scene": scene, "masks": masks, "filter": name, "seed": seed}, filters(clip)[name])


def row_of(clip: HullClip, key: dict[str, Any], method: tuple[Callable[..., Any], Any]) -> dict[str, Any]:
    """A line of the table: its key and what came out.

    key : what tells the line apart, with its seed.  method : step and settings.
    """
    from mocap.body import landmarks_of
    from mocap.metrics import lost_wrist_percent, point_scores

    step, settings = method
    begun = time.thread_time()
    states, infos = run_filter(clip, step, settings, seed=key["seed"])
    seconds = time.thread_time() - begun
    landmarks = landmarks_of(clip.body, states)
    scores = point_scores(landmarks, clip.truth)
    particles = (
        sum(n * k for n, k in zip(settings.level_particles, settings.n_layers, strict=True))
        if hasattr(settings, "level_particles")
        else settings.n_particles * settings.n_layers
    )
    values = {
        "mean_mm": scores.mean_mm,
        "mmtp_mm": scores.mmtp_mm,
        "mmta_percent": scores.mmta_percent,
        "lost_wrist_percent": lost_wrist_percent(landmarks, clip.truth),
        "best_log_likelihood": statistics.fmean(info.best_log_likelihood for info in infos),
        "seconds": seconds,
    }
    return {
        **key,
        "frames": len(states),
        "particle_evaluations": particles,
        "body_evaluations": infos[0].n_evaluations,
        **{name: None if value is None else round(value, 2) for name, value in values.items()},
    }


def plot(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """MMTP and MMTA of every filter per clip, one dot per seed, published values as lines."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from mocap.view.plotting import LINE_COLOURS

    names = list(dict.fromkeys(r["filter"] for r in rows))
    clips = list(dict.fromkeys((r["scene"], r["masks"]) for r in rows))
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    for ax, field, column, label in zip(
        figure.subplots(1, 2), ("mmtp_mm", "mmta_percent"), (1, 2), ("MMTP, mm", "MMTA, %"), strict=True
    ):
        for i, name in enumerate(names):
            colour = LINE_COLOURS[i % len(LINE_COLOURS)]
            for k, clip in enumerate(clips):
                own = [r[field] for r in rows if r["filter"] == name and (r["scene"], r["masks"]) == clip]
                x = k + (i - len(names) / 2) * 0.11
                ax.plot([x] * len(own), own, ".", color=colour, label=name if k == 0 else None)
            if name in PUBLISHED:
                ax.axhline(PUBLISHED[name][column], color=colour, ls=":", lw=1)
        ax.set_xticks(range(len(clips)), [f"{scene}\n{masks} masks" for scene, masks in clips])
        ax.set_ylabel(label)
        ax.grid(axis="y", alpha=0.3)
    figure.axes[0].legend(fontsize=7, loc="upper left")
    figure.suptitle("APF and SHBM-APF, 2,200 particle evaluations (dotted: published on HumanEva-I)")
    save_figure(figure, path, dpi=110)


def _summary(own: Sequence[dict[str, Any]]) -> str:
    means = {f: statistics.fmean(r[f] for r in own) for f in FIELDS[5:]}
    return (
        f"mean {means['mean_mm']:.1f} mm, MMTP {means['mmtp_mm']:.1f} mm, MMTA {means['mmta_percent']:.1f} %, "
        f"{means['seconds']:.1f} s"
    )


def main() -> None:
    rows = compare_filters(
        __doc__,
        scenes="walk,gesture",
        n_frames=60,
        names=FILTERS,
        measure=measure,
        summary=_summary,
        path=RESULTS,
        fields=FIELDS,
    )
    plot(rows, RESULTS.with_suffix(".png"))


if __name__ == "__main__":
    main()
