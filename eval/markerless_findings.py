"""Findings of the source on the markerless APF: layers, particles, cameras, voxel size, likelihood, density.

    python -m eval.markerless_findings [--scenes walk,gesture] [--masks true] [--seeds 3] [--frames 60]

Re-runs CF Figures 6.16 to 6.18 in reference mode (APF on the factorised voxel likelihood, no refinement, anthropometric
body, first pose given) on development scenes. Writes eval/results/markerless_findings.csv and .png. Takes about 15
minutes on one idle core; the scenes are synthesised and carved once. Published (MMTA, epsilon = 100 mm, pictures only):
best at L = 6 with 600 particles per layer, worse with more layers; 7 cameras beat 3; voxels of 2 cm beat 3 cm; the
factorised likelihood beats the global one; a density of the look-up table up to 2 costs little.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from eval.hull_clips import ROOT, HullClip, head, load_clip, run_filter
from eval.whole import save_figure, write_csv

RESULTS = ROOT / "eval" / "results" / "markerless_findings.csv"
FIELDS = (
    "finding",
    "variant",
    "scene",
    "masks",
    "seed",
    "frames",
    "layers",
    "particles",
    "mean_mm",
    "mmtp_mm",
    "mmta_percent",
    "ms_per_frame",
)
N_EVALUATIONS = 3600
LAYERS = (1, 2, 3, 4, 6, 9, 12, 18)
PER_LAYER = (150, 300, 600, 1200)


@dataclass(frozen=True)
class Variant:
    """One setting of one experiment; what is not named is as published: 7 cameras, 2 cm, 6 x 600, factorised."""

    finding: str
    name: str
    n_layers: int = 6
    n_particles: int = 600
    n_cameras: int = 7
    voxel_size_m: float = 0.02
    is_factorised: bool = True
    density: float = 1.0


def variants() -> list[Variant]:
    """All experiments; the published setting stands in each of them."""
    return [
        *(
            Variant("layers (equal evaluations)", f"L={n}", n_layers=n, n_particles=N_EVALUATIONS // n)
            for n in LAYERS
        ),
        *(Variant("particles per layer", f"N={n}", n_particles=n) for n in PER_LAYER),
        *(Variant("cameras", f"{n} cameras", n_cameras=n) for n in (3, 4, 5, 7)),
        *(Variant("voxel size", f"{1000 * s:.0f} mm", voxel_size_m=s) for s in (0.02, 0.03, 0.05)),
        Variant("likelihood", "factorised"),
        Variant("likelihood", "global", is_factorised=False),
        *(Variant("density", f"density {d:g}", density=d) for d in (0.7, 1.0, 1.5, 2.0)),
    ]


def with_cameras(folder: Path, n_cameras: int) -> Path:
    """A copy of a session of masks with some of its cameras, evenly spread on the ring."""
    from mocap.data import CameraRig
    from mocap.io.calibration import read_calibration, write_calibration

    rig = read_calibration(folder / "calibration.toml").rig
    if n_cameras >= len(rig):
        return folder
    chosen = [list(rig)[round(i * len(rig) / n_cameras) % len(rig)] for i in range(n_cameras)]
    fewer = folder.with_name(f"{folder.name}_{n_cameras}")
    if not fewer.exists():
        fewer.mkdir(parents=True)
        write_calibration(fewer / "calibration.toml", CameraRig(tuple(chosen)))
        shutil.copy(folder / "session.toml", fewer / "session.toml")
        (fewer / "masks").mkdir()
        for camera in chosen:
            shutil.copy(folder / "masks" / f"{camera.name}.npz", fewer / "masks")
    return fewer


def clip_of(variant: Variant, scene: str, masks: str, work: Path, n_frames: int) -> HullClip:
    """The hulls of a scene as a variant sees them, and the body at its density."""
    from mocap.body import build_look_up_table

    clip = head(
        load_clip(
            scene,
            masks,
            work,
            settings=(f"volume.voxel_size_m={variant.voxel_size_m}",),
            session_of=lambda folder: with_cameras(folder, variant.n_cameras),
        ),
        n_frames,
    )
    if variant.density == 1.0:
        return clip
    spacing = clip.grid.voxel_size_m * variant.density
    return replace(clip, table=build_look_up_table(clip.body, spacing))


def measure(clip: HullClip, variant: Variant, scene: str, masks: str, seed: int) -> dict[str, Any]:
    """One run of the published filter."""
    import time

    from mocap.body import landmarks_of
    from mocap.filters.apf import ApfSettings, apf_step
    from mocap.likelihood.voxels import VoxelLikelihoodSettings
    from mocap.metrics import point_scores

    settings = ApfSettings(n_layers=variant.n_layers, n_particles=variant.n_particles, std=clip.std)
    likelihood = VoxelLikelihoodSettings(factorised=variant.is_factorised)
    begun = time.thread_time()
    states, _ = run_filter(clip, apf_step, settings, seed=seed, likelihood=likelihood)
    ms = 1e3 * (time.thread_time() - begun) / len(states)
    scores = point_scores(landmarks_of(clip.body, states), clip.truth)
    values = {
        "mean_mm": scores.mean_mm,
        "mmtp_mm": scores.mmtp_mm,
        "mmta_percent": scores.mmta_percent,
        "ms_per_frame": ms,
    }
    return {
        "finding": variant.finding,
        "variant": variant.name,
        "scene": scene,
        "masks": masks,
        "seed": seed,
        "frames": len(states),
        "layers": variant.n_layers,
        "particles": variant.n_particles,
        **{key: None if value is None else round(value, 2) for key, value in values.items()},
    }


def plot(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """MMTA of every variant, one panel per finding, one line per scene, bars from the lowest to the highest seed."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from mocap.view.plotting import LINE_COLOURS

    findings = list(dict.fromkeys(r["finding"] for r in rows))
    figure = Figure(figsize=(11, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    for ax, finding in zip(figure.subplots(2, 3).ravel(), findings, strict=False):
        own = [r for r in rows if r["finding"] == finding]
        names = list(dict.fromkeys(r["variant"] for r in own))
        for k, scene in enumerate(dict.fromkeys(r["scene"] for r in own)):
            values = [
                [r["mmta_percent"] for r in own if (r["variant"], r["scene"]) == (name, scene)]
                for name in names
            ]
            means = [statistics.fmean(v) for v in values]
            spread = [
                [m - min(v) for m, v in zip(means, values, strict=True)],
                [max(v) - m for m, v in zip(means, values, strict=True)],
            ]
            x = [i + 0.08 * k for i in range(len(names))]
            ax.errorbar(x, means, spread, marker="o", capsize=3, color=LINE_COLOURS[k], label=scene)
        ax.set_xticks(range(len(names)), [n.split()[-1] if finding == "density" else n for n in names])
        ax.set_title(finding, fontsize=10)
        ax.grid(axis="y", alpha=0.3)
        ax.set_ylabel("MMTA, %")
    figure.axes[0].legend(fontsize=8)
    figure.suptitle("Markerless APF, 3,600 evaluations where not said otherwise (CF Figures 6.16 to 6.18)")
    save_figure(figure, path, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", default="walk,gesture")
    parser.add_argument("--masks", default="true")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for scene in args.scenes.split(","):
        known: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
        for variant in variants():
            # The published setting stands in every experiment but runs once.
            key = tuple(v for k, v in vars(variant).items() if k not in ("finding", "name"))
            if key not in known:
                clip = clip_of(variant, scene, args.masks, args.work, args.frames)
                known[key] = [measure(clip, variant, scene, args.masks, s) for s in range(args.seeds)]
            own = [r | {"finding": variant.finding, "variant": variant.name} for r in known[key]]
            rows += own
            sys.stdout.write(
                f"{scene} {variant.finding}, {variant.name}: mean {statistics.fmean(r['mean_mm'] for r in own):.1f} "
                f"mm, MMTA {statistics.fmean(r['mmta_percent'] for r in own):.1f} %\n"
            )
            sys.stdout.flush()
    write_csv(RESULTS, FIELDS, rows)
    plot(rows, RESULTS.with_suffix(".png"))


if __name__ == "__main__":
    main()
