"""SHBM-APF and APF on five actions with masks from the video: CF Table 7.1 and Figure 8.1.

    python -m eval.shbm_actions [--scenes walk,jog] [--seeds 5] [--frames 60]

Filters with 550, 1,100 and 2,200 particle evaluations per frame, the first pose given. APF has four layers; SHBM-APF
shares them out as CF Eq. 7.29 does, 300 : 500 : 300 in two layers each. `apf 6x600` is CF Table 6.4's.
Writes eval/results/shbm_actions.csv and .png. About 15 minutes on one idle core.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from eval.hull_clips import ROOT, HullClip, compare_filters
from eval.shbm_against_apf import FIELDS, row_of
from eval.whole import save_figure

RESULTS = ROOT / "eval" / "results" / "shbm_actions.csv"
ACTIONS = ("walk", "jog", "box", "gesture", "throw")
EVALUATIONS = (550, 1100, 2200)
METHODS = ("apf", "shbm model1", "shbm model2")
FILTERS = (*(f"{name} {n}" for n in EVALUATIONS for name in METHODS), "apf 6x600")
_LAYERS = 4
_SHARES = (300, 500, 300)  # CF Eq. 7.29, in two layers each: 2,200 evaluations


def method_of(clip: HullClip, name: str) -> tuple[Callable[..., Any], Any]:
    """Step and settings of one of FILTERS."""
    from mocap.body import load_hierarchy
    from mocap.filters.apf import ApfSettings, apf_step
    from mocap.filters.shbm import ShbmSettings, shbm_step

    which, _, count = name.rpartition(" ")
    if count == "6x600":
        return apf_step, ApfSettings(n_layers=6, n_particles=600, std=clip.std)
    n = int(count)
    if which == "apf":
        return apf_step, ApfSettings(n_layers=_LAYERS, n_particles=n // _LAYERS, std=clip.std)
    particles = tuple(share * n // (2 * sum(_SHARES)) for share in _SHARES)
    hierarchy = load_hierarchy(which.removeprefix("shbm "))
    return shbm_step, ShbmSettings(std=clip.std, hierarchy=hierarchy, level_particles=particles)


def measure(clip: HullClip, scene: str, masks: str, name: str, seed: int) -> dict[str, Any]:
    """One filter over one clip with one seed."""
    key = {"scene": scene, "masks": masks, "filter": name, "seed": seed}
    return row_of(clip, key, method_of(clip, name))


def plot(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """MMTP and MMTA over the evaluations, means over actions and seeds.  Source: CF Figure 8.1."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from mocap.view.plotting import LINE_COLOURS

    figure = Figure(figsize=(8, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    fields = (("mmtp_mm", "MMTP, mm"), ("mmta_percent", "MMTA, %"))
    for ax, (field, label) in zip(figure.subplots(1, 2), fields, strict=True):
        for colour, name in zip(LINE_COLOURS, METHODS, strict=False):
            values = [
                statistics.fmean(float(r[field]) for r in rows if r["filter"] == f"{name} {n}")
                for n in EVALUATIONS
            ]
            ax.plot(EVALUATIONS, values, "o-", color=colour, label=name)
        ax.set_xscale("log")
        ax.set_xticks(EVALUATIONS, [f"{n:,}" for n in EVALUATIONS])
        ax.minorticks_off()
        ax.set(xlabel="particle evaluations per frame", ylabel=label)
        ax.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=8)
    save_figure(figure, path, dpi=100)


def _summary(own: Sequence[dict[str, Any]]) -> str:
    mean, mmtp, mmta = (statistics.fmean(r[f] for r in own) for f in ("mean_mm", "mmtp_mm", "mmta_percent"))
    return f"mean {mean:.1f} mm, MMTP {mmtp:.1f} mm, MMTA {mmta:.1f} %"


def main() -> None:
    """Run the actions, write the CSV, draw the figure."""
    rows = compare_filters(
        __doc__,
        scenes=",".join(ACTIONS),
        masks="video",
        seeds=5,
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
