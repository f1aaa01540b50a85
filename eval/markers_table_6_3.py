"""CF Table 6.3 and Figure 6.13: the marker filter against detection rate, false positives, noise, layers, particles.

The detections of CF 6.6.1 are simulated on five actions of synthetic persons; segment lengths, marker offsets and
first pose are found by the pipeline once per action, at the detector of Table 6.3. Every cell then runs the filter with
the printed cost from that first pose. Published values of Table 6.3 stand beside ours; the figure's colours have no
numbers.

    python -m eval.markers_table_6_3 [--frames 45] [--seeds 1] [--only walk,box] [--full]

Some 3 minutes on two idle cores; --full is the source's grid of 360 detectors and 20 filters on all frames, hours.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.whole import save_figure, write_csv
from mocap.body import Body
from mocap.body.markers import Markers
from mocap.likelihood.markers import MarkerObservation, MarkerViews, marker_views, observe
from mocap.pipeline.config import Config, load_config
from mocap.pose.marker import MarkerTools
from mocap.pose.marker_person import Prepared, prepare_person

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "eval" / "results" / "markers_table_6_3.csv"
PICTURE = RESULTS.with_suffix(".png")

# Action of the source -> development scene of ours: (mean mm, sigma, MMTP, MMTA %) as published.
PUBLISHED = {
    "walk": (56.01, 14.46, 45.81, 96.15),
    "jog": (62.51, 18.71, 47.77, 90.12),
    "throw": (58.31, 18.64, 47.13, 91.72),
    "gesture": (44.70, 4.31, 42.42, 97.46),
    "box": (77.89, 30.64, 46.12, 87.03),
}
PUBLISHED_AVERAGE = (59.88, 17.35, 45.85, 95.32)
EPSILON_MM = 100.0
_SEED = 63


@dataclass(frozen=True)
class Detector:
    """Detection rate, mean number of false detections, variance of the noise in px^2 (CF 6.6.1)."""

    rate: float
    false_positives: float
    variance: float


@dataclass(frozen=True)
class Filter:
    """n_layers, n_particles per layer; cost : `printed`, `reprojection` or `both`; mode : `filter` or `default`."""

    n_layers: int
    n_particles: int
    cost: str = "printed"
    mode: str = "filter"


TABLE_DETECTOR = Detector(0.9, 20, 4)
TABLE_FILTER = Filter(3, 700)
_WEIGHT = {"printed": 0.0, "both": 0.5, "reprojection": 1.0}


@dataclass(frozen=True, eq=False)
class Clip:
    """An action, seen by its cameras.  landmarks : (T, 15, 3) m.  uv, visible, box : per camera, as
    `mocap.synth.markers.simulate_detector` takes them."""

    action: str
    fps: float
    views: MarkerViews
    landmarks: Array
    uv: tuple[Array, ...]
    visible: tuple[NDArray[np.bool_], ...]
    box: tuple[Array, ...]

    @property
    def frames(self) -> range:
        return range(len(self.landmarks))


def make_clip(
    action: str, n_frames: int | None, *, in_joints: bool = False, hides: bool = True, times_fps: int = 1
) -> Clip:
    """The markers of a scene's person in every picture, what hides them, and the truth; nothing is rendered.

    in_joints : the fifteen landmarks themselves are the markers, as in CF 6.6.1, instead of twenty on the skin.
    hides : the body hides markers.  times_fps : as many times the frames in the same seconds.
    """
    from mocap.synth.markers import Sight
    from mocap.synth.render import CameraView
    from mocap.synth.scene import load_scene
    from mocap.synth.views import Witness
    from mocap.synth.world import build_world

    scene = load_scene(action)
    document = {**scene.model_dump(), "markers": {}, "fps": times_fps * scene.fps}
    n = scene.n_frames if n_frames is None else min(n_frames, scene.n_frames)
    document["n_frames"] = times_fps * n
    world = build_world(type(scene).model_validate(document))
    looking = [(Witness(world), CameraView(camera, world.room)) for camera in world.rig]
    for frame in range(document["n_frames"]):
        posed = world.at(float(frame), with_light=False)
        for witness, view in looking:
            witness.look(view, posed, float(frame), is_off=False)
    landmarks = world.actors[0].landmarks[: document["n_frames"]]
    if in_joints:
        uv = [np.stack([view.camera.project(x)[0] for x in landmarks])[:, None] for _, view in looking]
        states = [np.stack(w.landmark_states) for w, _ in looking]
    else:
        uv = [np.stack(w.marker_uvs) for w, _ in looking]
        states = [np.stack(w.marker_states) for w, _ in looking]
    return Clip(
        action,
        document["fps"],
        marker_views(world.rig),
        landmarks,
        tuple(uv),
        tuple((s == Sight.VISIBLE) | (not hides) for s in states),
        tuple(np.stack(w.boxes) for w, _ in looking),
    )


def observations(clip: Clip, detector: Detector, seed: int) -> list[MarkerObservation]:
    """Every frame of a clip through a detector."""
    from mocap.synth.markers import simulate_detector

    rng = np.random.default_rng([_SEED, seed])
    found = [
        simulate_detector(
            uv,
            visible,
            box,
            camera.size,
            detection_rate=detector.rate,
            false_positives=detector.false_positives,
            noise_variance_px2=detector.variance,
            rng=rng,
        )
        for camera, uv, visible, box in zip(clip.views.rig, clip.uv, clip.visible, clip.box, strict=True)
    ]
    return [observe(clip.views, [uv[frame == t] for frame, uv in found]) for t in clip.frames]


def configuration(which: Filter, *settings: str) -> Config:
    """The preset of a row with its layers, particles and cost, and further settings."""
    return load_config(
        "reference_markers" if which.mode == "filter" else "default",
        (
            *settings,
            f"pose.n_layers={which.n_layers}",
            f"pose.n_particles={which.n_particles}",
            *((f"markers.reprojection_weight={_WEIGHT[which.cost]}",) if which.mode == "filter" else ()),
        ),
    )


def prepare(
    clip: Clip,
    seed: int,
    *,
    detector: Detector = TABLE_DETECTOR,
    markers_of: Callable[[Body], Markers] | None = None,
) -> Prepared | None:
    """Body, markers and first pose of a clip's person, found by the default preset.

    markers_of : where the markers sit on a body; the preset's set when absent.
    """
    seen = observations(clip, detector, seed)
    from mocap.pipeline.pose_settings import make_marker_tools

    def tools_of(height_m: float) -> MarkerTools:
        tools = make_marker_tools(load_config(), clip.fps, height_m)
        return tools if markers_of is None else replace(tools, markers=markers_of(tools.body))

    return prepare_person(clip.frames, lambda f: seen[f], tools_of, height_m=None, seed=seed)


def run_cell(
    clip: Clip, person: Prepared, detector: Detector, which: Filter, seed: int, settings: Sequence[str] = ()
) -> dict[str, Any]:
    """One clip, detector and filter: errors in mm over all landmarks and frames.  Source: CF Table 6.3.

    settings : of the preset, besides those of the filter.
    """
    from mocap.pipeline.pose_settings import marker_tools
    from mocap.pose.marker_person import finish_markers, follow_prepared

    seen = observations(clip, detector, seed)
    config = configuration(which, *settings)
    tools = marker_tools(person.tools.body, person.tools.markers, person.tools.fps, config)
    followed = follow_prepared(clip.frames, lambda f: seen[f], replace(person, tools=tools), seed=seed)
    poses = finish_markers(followed)
    error = 1000.0 * np.linalg.norm(poses.landmarks - clip.landmarks, axis=2)
    matched = error[error < EPSILON_MM]
    return {
        "action": clip.action,
        "rate": detector.rate,
        "false_positives": detector.false_positives,
        "variance_px2": detector.variance,
        "n_layers": which.n_layers,
        "n_particles": which.n_particles,
        "cost": which.cost,
        "mode": which.mode,
        "seed": seed,
        "n_frames": len(clip.landmarks),
        "mean_error_mm": round(float(error.mean()), 2),
        "std_error_mm": round(float(error.mean(axis=1).std()), 2),
        "mmtp_mm": round(float(matched.mean()), 2) if len(matched) else None,
        "mmta_percent": round(100.0 * len(matched) / error.size, 2),
    }


def grid(*, is_full: bool) -> list[tuple[Detector, Filter]]:
    """Cells to run; the cell of Table 6.3 comes first."""
    if is_full:
        levels = (0, 20, 40, 60, 80, 100)
        return [
            (Detector(rate, fp, var), Filter(layers, n))
            for rate in (1.0, 0.9, 0.8, 0.7, 0.6)
            for fp in levels
            for var in levels
            for layers in (1, 3, 5, 7)
            for n in (100, 300, 500, 700, 900)
        ]
    cells = [(TABLE_DETECTOR, TABLE_FILTER)]
    cells += [(replace(TABLE_DETECTOR, false_positives=fp), TABLE_FILTER) for fp in (0, 5, 60)]
    cells += [(replace(TABLE_DETECTOR, variance=v), TABLE_FILTER) for v in (0, 20, 60)]
    cells += [(replace(TABLE_DETECTOR, rate=r), TABLE_FILTER) for r in (1.0, 0.7)]
    cells += [(TABLE_DETECTOR, replace(TABLE_FILTER, n_layers=n)) for n in (1, 5, 7)]
    cells += [(TABLE_DETECTOR, replace(TABLE_FILTER, n_particles=n)) for n in (100, 300)]
    cells += [(TABLE_DETECTOR, replace(TABLE_FILTER, cost=c)) for c in ("both", "reprojection")]
    cells.append((TABLE_DETECTOR, Filter(4, 300, "reprojection", "default")))
    return cells


def average(rows: Sequence[dict[str, Any]], field: str, **where: Any) -> float:
    """Mean of a field over the rows that match, NaN when there are none."""
    base = {
        "rate": TABLE_DETECTOR.rate,
        "false_positives": TABLE_DETECTOR.false_positives,
        "variance_px2": TABLE_DETECTOR.variance,
        "n_layers": TABLE_FILTER.n_layers,
        "n_particles": TABLE_FILTER.n_particles,
        "cost": "printed",
        "mode": "filter",
    } | where
    values = [r[field] for r in rows if all(r[k] == v for k, v in base.items()) and r[field] is not None]
    return float(np.mean(values)) if values else float("nan")


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """MMTA against each knob, and the rows of Table 6.3 beside the published ones."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6.4), layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    for ax, (key, words) in zip(
        axes,
        (
            ("false_positives", "false detections per person and picture"),
            ("variance_px2", "variance of the noise, px$^2$"),
            ("rate", "detection rate"),
            ("n_layers", "layers of 700 particles"),
            ("n_particles", "particles in each of 3 layers"),
        ),
        strict=False,
    ):
        levels = sorted({r[key] for r in rows if r["mode"] == "filter" and r["cost"] == "printed"})
        levels = [v for v in levels if np.isfinite(average(rows, "mmta_percent", **{key: v}))]
        ax.plot(levels, [average(rows, "mmta_percent", **{key: v}) for v in levels], "o-", color="#0072b2")
        ax.set(xlabel=words, ylabel="MMTA, %", ylim=(0, 101))
        ax.grid(alpha=0.3)
    actions = [a for a in PUBLISHED if any(r["action"] == a for r in rows)]
    at = np.arange(len(actions))
    default = {"n_layers": 4, "n_particles": 300, "cost": "reprojection", "mode": "default"}
    for k, (label, values) in enumerate(
        (
            ("published", [PUBLISHED[a][3] for a in actions]),
            ("ours, printed cost", [average(rows, "mmta_percent", action=a) for a in actions]),
            ("ours, default", [average(rows, "mmta_percent", action=a, **default) for a in actions]),
        )
    ):
        axes[5].bar(at + 0.27 * (k - 1), values, 0.26, label=label)
    axes[5].set_xticks(at, actions)
    axes[5].set(ylabel="MMTA, %", ylim=(0, 119))
    axes[5].legend(fontsize=6.5, loc="upper center", ncols=3, columnspacing=1.0)
    save_figure(figure, path, dpi=90)


def say(rows: Sequence[dict[str, Any]]) -> None:
    """The table as text."""
    default = {"n_layers": 4, "n_particles": 300, "cost": "reprojection", "mode": "default"}
    head = f"{'action':9}{'published':>18}{'printed cost':>18}{'reprojection':>18}{'default mode':>18}"
    print(head + "   mean mm / MMTA %")
    for action in [a for a in PUBLISHED if any(r["action"] == a for r in rows)]:
        ours = [
            (
                average(rows, "mean_error_mm", action=action, **w),
                average(rows, "mmta_percent", action=action, **w),
            )
            for w in ({}, {"cost": "reprojection"}, default)
        ]
        cells = [(PUBLISHED[action][0], PUBLISHED[action][3]), *ours]
        print(f"{action:9}" + "".join(f"{m:10.1f} /{p:6.1f}" for m, p in cells))
    for key in ("false_positives", "variance_px2", "rate", "n_layers", "n_particles"):
        levels = sorted({r[key] for r in rows if r["mode"] == "filter"})
        values = [(v, average(rows, "mmta_percent", **{key: v})) for v in levels]
        print(f"MMTA over {key}: " + ", ".join(f"{v:g}: {p:.1f}" for v, p in values if np.isfinite(p)))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the grid, write CSV and PNG, print the table."""
    parser = argparse.ArgumentParser(prog="python -m eval.markers_table_6_3", description=__doc__)
    parser.add_argument("--frames", type=int, default=45, help="frames per clip (default 45)")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--only", help="comma-separated actions")
    parser.add_argument("--full", action="store_true", help="the source's whole grid on all frames: hours")
    options = parser.parse_args(argv)
    rows: list[dict[str, Any]] = []
    for action in options.only.split(",") if options.only else PUBLISHED:
        clip = make_clip(action, None if options.full else options.frames)
        for seed in range(options.seeds):
            person = prepare(clip, seed)
            if person is None:
                print(f"{action}, seed {seed}: no first pose was found", file=sys.stderr)
                continue
            for detector, which in grid(is_full=options.full):
                rows.append(run_cell(clip, person, detector, which, seed))
            print(f"{action}, seed {seed}: done", file=sys.stderr, flush=True)
    write_csv(RESULTS, list(rows[0]), rows)
    draw(rows, PICTURE)
    say(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
