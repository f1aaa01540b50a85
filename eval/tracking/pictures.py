"""Pictures of the tracking evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from eval.whole import save_figure

Line = dict[str, str]
COLOURS = {
    "SS-Color": "tab:red",
    "SS-Raw": "tab:orange",
    "PF-Color": "tab:blue",
    "PF-Raw": "tab:cyan",
    "Naive": "0.4",
}


def _figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt.subplots(rows, columns, figsize=size, squeeze=False, constrained_layout=True)


def over_samples(lines: Sequence[Line], path: Path) -> None:
    """MOTP and MOTA over the number of samples, a column per voxel size (CF Figure 4.11)."""
    _over(lines, path, "n", "samples or particles per person")


def over_cost(lines: Sequence[Line], path: Path) -> None:
    """MOTP and MOTA over the cost, a column per voxel size (CF Figure 4.14)."""
    _over(lines, path, "step_ms", "ms per person and frame")


def _over(lines: Sequence[Line], path: Path, x: str, label: str) -> None:
    import matplotlib.pyplot as plt

    sizes = sorted({int(line["voxel_cm"]) for line in lines}, reverse=True)
    figure, axes = _figure(2, len(sizes), (2.6 * len(sizes) + 0.8, 4.6))
    for k, cm in enumerate(sizes):
        for method, colour in COLOURS.items():
            own = [line for line in lines if int(line["voxel_cm"]) == cm and line["method"] == method]
            own.sort(key=lambda line: int(line["n"]))
            for row, score in enumerate(("motp_mm", "mota_percent")):
                values = [float(line[score]) for line in own]
                if method == "Naive" and x == "n":
                    for value in values:
                        axes[row, k].axhline(value, color=colour, ls=":", label="Naive")
                elif own:
                    axes[row, k].plot(
                        [float(line[x]) for line in own], values, "o-", ms=3.5, color=colour, label=method
                    )
        axes[0, k].set_title(f"{cm} cm")
        axes[1, k].set_xlabel(label, fontsize=8)
        for row in range(2):
            axes[row, k].set_xscale("log" if x == "n" else "linear")
            axes[row, k].grid(alpha=0.3)
            axes[row, k].tick_params(labelsize=8)
    for row, score in enumerate(("MOTP, mm", "MOTA, %")):
        axes[row, 0].set_ylabel(score)
        low = min(a.get_ylim()[0] for a in axes[row])
        high = max(a.get_ylim()[1] for a in axes[row])
        if score.startswith("MOTA"):
            high = min(high, 100.5)
        for a in axes[row]:
            a.set_ylim(low, high)
    axes[0, -1].legend(fontsize=7)
    save_figure(figure, path, dpi=90)
    plt.close(figure)


def floor_plan(panels: Sequence[tuple[str, Any, Any, Sequence[Any]]], path: Path) -> None:
    """Tracks and truth from above.  panels : (title, tracks, truth, furniture boxes)."""
    import matplotlib.pyplot as plt
    import numpy as np
    from matplotlib.patches import Rectangle

    figure, axes = _figure(1, len(panels), (4.2 * len(panels), 3.6))
    for a, (title, tracks, truth, furniture) in zip(axes[0], panels, strict=True):
        for low, high in furniture:
            a.add_patch(Rectangle(low[:2], high[0] - low[0], high[1] - low[1], color="0.85"))
        for person in np.unique(truth.person):
            own = truth.xyz[truth.person == person]
            a.plot(own[:, 0], own[:, 1], color="black", lw=3.0, alpha=0.25)
        for k, person in enumerate(tracks.persons):
            own = tracks.xyz[tracks.person == person]
            a.plot(own[:, 0], own[:, 1], color=f"C{k}", lw=1.0, label=f"{person}")
        a.set_aspect("equal")
        a.set_title(title, fontsize=9)
        a.legend(fontsize=7, title="track", title_fontsize=7)
        a.tick_params(labelsize=8)
    axes[0, 0].set_xlabel("m")
    save_figure(figure, path, dpi=90)
    plt.close(figure)
