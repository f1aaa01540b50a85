"""The table that the sources do not have: all filters on the 3D voxel body and on the marker body, equal evaluations.

A development scene (walk_markers) with true masks and marker detections; hulls, height and first pose come from the
pipeline, then every filter starts from the same pose and tracks the same frames at 500, 1,000, 2,200 and 3,600
evaluations of the whole body per frame. Error: mean over 15 landmarks and frames, mm.
Writes eval/results/decomposition_3d.csv and decomposition_3d.png.

    python -m eval.decomposition_3d [--full] [--only psipf] [--work out/eval/decomposition]

--quick (default): 24 frames, 2 runs; about 15 minutes on one core.  --full: 149 frames, 10 runs; about 8 hours.
Nothing is published. The voxel likelihood is the factorised one of the reference mode, so that filters which place
the body part after part can use it. Markers sit where the marker set says, not calibrated to the person.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.decomposition.store import RESULTS, ROOT
from eval.decomposition.tables import LABELS, read_csv
from eval.whole import save_figure, write_csv
from mocap.body import Body, landmarks_of
from mocap.data.problem import ArticulatedProblem
from mocap.filters import FILTERS, FilterBudget, ParticleState, filter_settings, initial_particles
from mocap.metrics import point_errors

Array = NDArray[np.float64]

SCENE = "walk_markers"
BUDGETS = (500, 1000, 2200, 3600)
# Scores of each particle per frame. XN's default of one annealed layer inside PS is two; three iterations of a swarm
# are four; the annealed filter on the whole state gets as many layers.
LAYERS = {
    "sir": 1,
    "apf": 4,
    "ps": 1,
    "parallel-ps": 1,
    "sbps": 1,
    "pfcr": 1,
    "pfcr-equal": 1,
    "psapf": 2,
    "sbapf": 2,
    "psipf": 1,
    "pso": 4,
    "hpso": 4,
    "apsopf": 4,
    "chapsopf": 4,
    "chapsopf-printed": 4,
    "hapsopf": 4,
    "hapsopf-printed": 4,
}
OTHERS = 4  # layers of filters that are registered later
FIELDS = (
    "body",
    "method",
    "evaluations",
    "runs",
    "error_mm",
    "std_mm",
    "lost_percent",
    "spent",
    "step_ms",
    "note",
)
LOST_MM = 250.0  # a frame counts as lost when the mean landmark error is beyond this


@dataclass(frozen=True, eq=False)
class Clip:
    """Frames that all filters see.

    problems : body name -> problem of a row.  bodies : body name -> Body.  truth : (T, 15, 3) m.
    start : (D,) state before the first frame.  std : (D,) noise per frame.
    """

    problems: dict[str, Callable[[int], ArticulatedProblem]]
    bodies: dict[str, Body]
    truth: Array
    start: Array
    std: Array


def prepare(work: Path, n_frames: int) -> Clip:
    """Synthesise the scene with true masks, carve and track it, and find the pose before the first frame."""
    from mocap.body.markers import load_marker_set, place_markers
    from mocap.io.session import open_session
    from mocap.io.store import StageStore
    from mocap.io.tables import read_detections_csv, read_landmarks_csv
    from mocap.likelihood.markers import MarkerLikelihoodSettings, MarkerProblem, marker_views, observe
    from mocap.likelihood.voxels import VoxelProblem
    from mocap.pipeline.config import load_config
    from mocap.pipeline.pose_settings import make_tools
    from mocap.pipeline.run import run_session
    from mocap.pose.volume import PersonHull, pack_volume
    from mocap.products.hulls import stored_grid
    from mocap.synth import load_scene, synthesise
    from mocap.volume import surface_voxels

    folder = work / f"{SCENE}_masks"
    if not folder.exists():
        synthesise(load_scene(SCENE).model_copy(update={"masks_only": True}), folder)
    # A folder per length, so that two evaluations do not share a store.
    home = work / f"start_{n_frames}"
    frames = range(1, n_frames + 1)
    config = load_config("default", ("output.formats=[]", "observation=voxels", "body.model=anthropometric"))
    result = run_session(folder, home, config=config, until="pose", frames=(0, n_frames + 1), resume=True)
    pose = result.poses[0]
    start = pose.states[0]
    store = StageStore(home / "store.zarr")
    grid = stored_grid(store)
    hulls, owners = store.reader("carve"), store.reader("track-owners")
    reference = load_config("reference")
    tools = make_tools(
        grid,
        result.session.fps,
        pose.height.height_m,
        config.body.model,
        reference.pose,
        reference.likelihood.model_copy(update={"factorised": True}),
        1,
    )

    def voxel_problem(row: int) -> ArticulatedProblem:
        keep = owners.read(frames[row])["owner"] == pose.person
        voxels = hulls.read(frames[row])["voxels"][keep].astype(np.int32, copy=False)
        hull = PersonHull(voxels, surface_voxels(voxels, grid))
        volume = pack_volume(grid, hull, reference.pose.surface_sigma_voxels)
        return VoxelProblem(tools.body, tools.table, volume, tools.likelihood, n_threads=1)

    session = open_session(folder)
    views = marker_views(session.rig)
    markers = place_markers(load_marker_set("markers_20"), tools.body)
    detections = [read_detections_csv(folder / "detections" / f"{c.name}.csv") for c in session.rig]

    def marker_problem(row: int) -> ArticulatedProblem:
        found = observe(views, [uv[frame == frames[row]] for frame, uv in detections])
        return MarkerProblem(tools.body, markers, found, MarkerLikelihoodSettings())

    truth = read_landmarks_csv(folder / "truth" / "landmarks.csv")[0]
    rows = np.searchsorted(truth.frames, np.array(frames))
    return Clip(
        problems={"voxels": voxel_problem, "markers": marker_problem},
        bodies={"voxels": tools.body, "markers": tools.body},
        truth=truth.landmarks[rows],
        start=start,
        std=tools.noise_std,
    )


def track_all(
    clip: Clip, body: str, budgets: Sequence[int], n_runs: int, names: Sequence[str] | None = None
) -> Iterator[dict[str, str]]:
    """Filters (None = all) and budgets side by side through the frames of one body: a CSV line for each."""
    import time

    layout = clip.bodies[body].layout
    runs: dict[tuple[str, int, int], dict[str, Any]] = {}
    names = list(FILTERS) if names is None else names
    for name in names:
        layers = LAYERS.get(name, OTHERS)
        for budget in budgets:
            for seed in range(n_runs):
                runs[name, budget, seed] = {
                    "rng": np.random.default_rng([seed, budget, *name.encode()]),
                    "settings": filter_settings(
                        FilterBudget(name, n_particles=budget // layers, n_layers=layers), layout, clip.std
                    ),
                    "layers": layers,
                    "states": [],
                    "spent": 0,
                    "seconds": 0.0,
                    "note": "",
                    "particles": None,
                }
    for row in range(len(clip.truth)):
        problem = clip.problems[body](row)
        for (name, budget, _), run in runs.items():
            if run["note"]:
                continue
            particles: ParticleState = run["particles"] or initial_particles(
                problem, clip.start, budget // run["layers"]
            )
            begun = time.perf_counter()
            try:
                run["particles"], info = FILTERS[name].step(
                    problem, particles, run["settings"], rng=run["rng"]
                )
            except Exception as error:  # one failed cell must not stop the others
                run["note"] = f"{type(error).__name__}: {error}".replace("\n", " ")[:120]
                continue
            run["seconds"] += time.perf_counter() - begun
            run["states"].append(info.estimate)
            run["spent"] += info.n_evaluations
        sys.stderr.write(f"{body}: frame {row + 1}/{len(clip.truth)}\n")
    for name in names:
        for budget in budgets:
            yield _line(clip, body, name, budget, [runs[name, budget, seed] for seed in range(n_runs)])


def _line(clip: Clip, body: str, name: str, budget: int, runs: Sequence[dict[str, Any]]) -> dict[str, str]:
    good = [run for run in runs if not run["note"]]
    line = dict.fromkeys(FIELDS, "") | {
        "body": body,
        "method": LABELS.get(name, name),
        "evaluations": str(budget),
        "runs": str(len(good)),
        "note": next((run["note"] for run in runs if run["note"]), ""),
    }
    if not good:
        return line
    errors = []
    for run in good:
        landmarks = landmarks_of(clip.bodies[body], np.array(run["states"]))
        errors.append(point_errors(landmarks, clip.truth).mean(axis=1))
    per_run = np.mean(errors, axis=1)
    n = len(clip.truth)
    return line | {
        "error_mm": f"{per_run.mean():.1f}",
        "std_mm": f"{per_run.std(ddof=1):.1f}" if len(good) > 1 else "",
        "lost_percent": f"{100 * np.mean(np.array(errors) > LOST_MM):.1f}",
        "spent": f"{np.mean([run['spent'] for run in good]) / n:.0f}",
        "step_ms": f"{1e3 * np.mean([run['seconds'] for run in good]) / n:.1f}",
    }


def picture() -> Path:
    """Error over evaluations, one panel per body."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from eval.decomposition.pictures import COLOURS, STYLES

    lines = read_csv(RESULTS / "decomposition_3d.csv")
    bodies = list(dict.fromkeys(line["body"] for line in lines))
    figure = Figure(figsize=(5.2 * len(bodies), 4.2), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    for i, body in enumerate(bodies):
        axes = figure.add_subplot(1, len(bodies), i + 1)
        methods: dict[str, list[dict[str, str]]] = {}
        for line in lines:
            if line["body"] == body and line["error_mm"]:
                methods.setdefault(line["method"], []).append(line)
        for k, (method, own) in enumerate(methods.items()):
            axes.plot(
                [float(line["evaluations"]) for line in own],
                [float(line["error_mm"]) for line in own],
                color=COLOURS[k % len(COLOURS)],
                ls=STYLES[k // len(COLOURS) % len(STYLES)],
                marker="o",
                ms=3,
                lw=1.4,
                label=method,
            )
        axes.set_yscale("log")
        axes.set_title(f"{body} body", fontsize=10)
        axes.set_xlabel("evaluations per frame", fontsize=8)
        axes.set_ylabel("mean landmark error (mm)", fontsize=8)
        axes.tick_params(labelsize=7, which="both")
        axes.grid(color="#d9dde2", lw=0.5, which="both")
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside right upper", fontsize=8)
    path = RESULTS / "decomposition_3d.png"
    save_figure(figure, path)
    return path


def main(argv: Sequence[str] | None = None) -> None:
    """Run all filters on both bodies."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="24 frames, 2 runs (default)")
    parser.add_argument("--full", action="store_true", help="149 frames, 10 runs")
    parser.add_argument("--frames", type=int)
    parser.add_argument("--runs", type=int)
    parser.add_argument("--budgets", default=",".join(map(str, BUDGETS)))
    parser.add_argument("--only", help="filters, with commas; their lines replace those of the table")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval" / "decomposition")
    args = parser.parse_args(argv)
    n_frames = args.frames or (149 if args.full else 24)
    n_runs = args.runs or (10 if args.full else 2)
    clip = prepare(args.work, n_frames)
    names = args.only.split(",") if args.only else list(FILTERS)
    again = {LABELS.get(name, name) for name in names}
    kept = read_csv(RESULTS / "decomposition_3d.csv") if args.only else []
    kept = [line for line in kept if line["method"] not in again]
    lines: list[dict[str, str]] = []
    for body in clip.problems:
        lines += [line for line in kept if line["body"] == body]
        lines += track_all(clip, body, [int(b) for b in args.budgets.split(",")], n_runs, names)
    write_csv(RESULTS / "decomposition_3d.csv", FIELDS, lines)
    picture()
    for line in lines:
        sys.stdout.write("  ".join(line[f] for f in FIELDS) + "\n")


if __name__ == "__main__":
    main()
