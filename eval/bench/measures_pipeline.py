"""The whole: filter steps per second on one thread, tracker, start of the command line, memory."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from eval.bench.measures_likelihood import body_scene
from eval.bench.registry import measure

_SEED = 5


def _filter_fps(n_layers: int, n_particles: int, *, with_refinement: bool, is_fast: bool = False) -> float:
    from mocap.filters import ParticleState
    from mocap.filters.apf import ApfSettings, apf_step
    from mocap.filters.refine import RefineSettings, refine

    scene = body_scene()
    kind: Literal["exact", "fast"] = "fast" if is_fast else "exact"
    problem = replace(scene.voxels, settings=replace(scene.voxels.settings, kind=kind))
    std = 0.5 * scene.voxels.body.max_speed / 25.0
    settings = ApfSettings(n_layers=n_layers, n_particles=n_particles, std=std)
    refining = RefineSettings(prior_std=np.where(scene.voxels.body.is_position, 0.1, 0.5))
    start = ParticleState(np.tile(scene.truth, (n_particles, 1)), np.full(n_particles, 1.0 / n_particles))
    rng = np.random.default_rng(_SEED)
    times = []
    for _ in range(4):
        begun = time.thread_time()
        _, info = apf_step(problem, start, settings, rng=rng)
        if with_refinement:
            refine(scene.surface, info.estimate, refining)
        times.append(time.thread_time() - begun)
    return 1.0 / median(times[1:])


@measure("fps_exact", unit="frames/s", better="higher")
def fps_exact() -> float:
    """Published filter, 6 layers of 600 exact evaluations, one thread, one person, filter alone (CPU time)."""
    return _filter_fps(6, 600, with_refinement=False)


@measure("fps_fast", unit="frames/s", better="higher")
def fps_fast() -> float:
    """The same with the fast likelihood."""
    return _filter_fps(6, 600, with_refinement=False, is_fast=True)


@measure("fps_default", unit="frames/s", better="higher")
def fps_default() -> float:
    """Default preset, 4 layers of 200 fast evaluations and refinement, one thread, filter alone (CPU time).

    The whole pose stage, with searches, colours and outlines: `python -m eval.pose_speed`.
    """
    return _filter_fps(4, 200, with_refinement=True, is_fast=True)


@measure("tracker_ms_per_person", unit="ms", better="lower")
def tracker_ms_per_person() -> float:
    """Components and one step of the default tracker for one person at 2 cm, without colours (CPU time)."""
    return _tracker_ms("naive")


@measure("sparse_ms_per_person", unit="ms", better="lower")
def sparse_ms_per_person() -> float:
    """The same with the sparse-sampling tracker, 800 samples, and colours."""
    return _tracker_ms("sparse", has_colour=True)


def _tracker_ms(tracker: str, *, has_colour: bool = False) -> float:
    from mocap.data import Hull
    from mocap.pipeline.tracking import tracker_input
    from mocap.tracking import TrackerSettings, TrackerState, track_step
    from mocap.volume import surface_voxels

    volume = body_scene().voxels.volume
    grid = volume.grid
    subs = np.argwhere(volume.crop >= 128) + volume.lower_subscript
    inside = np.all((subs >= 0) & (subs < np.array(grid.shape)), axis=1)
    voxels = np.sort(grid.linear(subs[inside]))
    is_surface = surface_voxels(voxels, grid)
    # Clothes of two colours with some noise, on the surface alone, as the volume stage gives them.
    rng = np.random.default_rng(_SEED)
    rgb = np.where(grid.centers(voxels)[:, 2:] > 1.0, [160, 50, 40], [50, 60, 90])
    rgb = np.clip(rgb + rng.normal(0, 8, rgb.shape), 0, 255).astype(np.uint8) * is_surface[:, None]
    n_views = is_surface.astype(np.uint8) * has_colour
    hull = Hull(grid, voxels, is_surface, n_views, rgb)
    settings = TrackerSettings(grid.voxel_size_m, tracker=tracker)
    state = TrackerState()
    times = []
    for frame in range(12):
        begun = time.thread_time()
        state, _ = track_step(state, tracker_input(frame, hull).voxels, settings, rng=rng)
        times.append(time.thread_time() - begun)
    return 1000.0 * median(times[2:])


@measure("cli_help_s", unit="s", better="lower")
def cli_help_s() -> float:
    """`mocap --help` as a whole process, median of five."""
    times = []
    for _ in range(5):
        begun = time.perf_counter()
        subprocess.run([sys.executable, "-m", "mocap", "--help"], check=True, capture_output=True)
        times.append(time.perf_counter() - begun)
    return median(times)


@measure("peak_memory_mb", unit="MB", better="lower")
def peak_memory_mb() -> float:
    """Largest resident memory of a process that builds the tables of a 5 x 4 x 2.2 m room, 7 cameras, 2 cm."""
    code = (
        "import numpy as np, resource\n"
        "from eval.bench.scene import make_scene\n"
        "from mocap.volume import Carver\n"
        "scene = make_scene(1, rng=np.random.default_rng(0))\n"
        "Carver(scene.rig, scene.grid)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return float(done.stdout)


@measure("start_up_s", unit="s", better="lower")
def start_up_s() -> float:
    """CPU of a process that loads what a run needs before it looks at its session, median of five."""
    code = "import time; import mocap.pipeline.run; print(time.process_time())"
    times = []
    for _ in range(5):
        done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
        times.append(float(done.stdout))
    return median(times)


@measure("outputs_s_per_60_frames", unit="s", better="lower")
def outputs_s_per_60_frames() -> float:
    """CPU, of all threads together, of a run of `demo` whose stages are all reused: tables, exports, scene and report.

    Making and running the session first takes a minute of CPU. The libraries are loaded already.
    """
    from mocap.pipeline.run import run_session
    from mocap.synth import synthesise

    with TemporaryDirectory() as folder:
        session, out = Path(folder) / "session", Path(folder) / "result"
        synthesise("demo", session)
        n_frames = len(run_session(session, out, n_threads=1).session.frames)
        times = []
        for _ in range(3):
            begun = time.process_time()
            run_session(session, out, n_threads=1, resume=True)
            times.append(time.process_time() - begun)
    return median(times) * 60 / n_frames
