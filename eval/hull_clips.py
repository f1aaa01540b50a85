"""Clips of hulls with exact truth, for experiments on filters alone: the first pose is given, to all alike."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.whole import write_csv
from mocap.body import Body, LookUpTable, landmarks_of, neutral_state
from mocap.data import VoxelGrid
from mocap.filters import FilterInfo, ParticleState, initial_particles
from mocap.likelihood.voxels import PackedVolume, VoxelLikelihoodSettings, VoxelProblem

Array = NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[1]
MASKS = ("true", "video")


@dataclass(frozen=True, eq=False)
class HullClip:
    """One person's hulls over a clip.

    voxels : per frame, linear indices.  volumes : what the likelihood reads.  xyz : (T, 3) m, track.
    truth : (T, 15, 3) m.  first : (D,) the body fitted to the truth of the first frame.  std : (D,) noise per frame.
    """

    name: str
    body: Body
    table: LookUpTable
    grid: VoxelGrid
    voxels: tuple[NDArray[np.int32], ...]
    volumes: tuple[PackedVolume, ...]
    xyz: Array
    truth: Array
    first: Array
    std: Array


def load_clip(
    scene: str,
    masks: str,
    work: Path,
    *,
    body_name: str = "anthropometric",
    settings: tuple[str, ...] = (),
    session_of: Callable[[Path], Path] = lambda folder: folder,
) -> HullClip:
    """A development scene, synthesised and carried to its tracks once in the folder `work`.

    masks : "video" = segmented from the pictures, "true" = the exact silhouettes.  settings : of the default preset.
    session_of : makes another session from the folder of this one.
    """
    from mocap.body import build_look_up_table, load_body_model, scale_body
    from mocap.io.store import StageStore
    from mocap.io.tables import read_landmarks_csv
    from mocap.pipeline.config import load_config
    from mocap.pipeline.run import run_session
    from mocap.pose.volume import PersonHull, pack_volume
    from mocap.products.hulls import stored_grid
    from mocap.synth import synthesise
    from mocap.volume import surface_voxels

    folder = work / "sessions" / scene
    if not (folder / "truth" / "landmarks.csv").exists():
        synthesise(scene, folder)
    session = folder
    if masks == "true":
        session = work / "sessions" / f"{scene}_true"
        if not session.exists():
            shutil.copytree(folder / "truth" / "masks", session / "masks")
            for file in ("calibration.toml", "session.toml"):
                shutil.copy(folder / file, session / file)
    session = session_of(session)
    out = work / "hulls" / session.name
    config = load_config("default", ("output.formats=[]", *settings))
    result = run_session(session, out, config=config, until="track", resume=True)
    tracks = result.tracks
    if tracks is None or not tracks.persons:
        raise ValueError(f"nobody was tracked in {scene} ({masks} masks)")
    store = StageStore(out / "store.zarr")
    grid = stored_grid(store)
    hulls, owners = store.reader("carve"), store.reader("track-owners")
    own = tracks.of(tracks.persons[0])
    voxels, volumes = [], []
    for frame in own.frame.tolist():
        found = hulls.read(frame)["voxels"][owners.read(frame)["owner"] == tracks.persons[0]]
        found = found.astype(np.int32)
        voxels.append(found)
        volumes.append(pack_volume(grid, PersonHull(found, surface_voxels(found, grid)), 1.0))
    height = json.loads((folder / "truth" / "truth.json").read_text("utf-8"))["persons"][0]["height_m"]
    body = scale_body(load_body_model(body_name), height)
    motion = read_landmarks_csv(folder / "truth" / "landmarks.csv")[0]
    truth = motion.landmarks[np.searchsorted(motion.frames, own.frame)]
    return HullClip(
        name=f"{scene} ({masks} masks)",
        body=body,
        table=build_look_up_table(body, grid.voxel_size_m),
        grid=grid,
        voxels=tuple(voxels),
        volumes=tuple(volumes),
        xyz=own.xyz,
        truth=truth,
        first=fitted_state(body, truth[0]),
        std=0.5 * body.max_speed / result.session.fps,
    )


def fitted_state(body: Body, landmarks: Array) -> Array:
    """The state (D,) whose landmarks lie closest to (15, 3) m, from four facing directions."""
    from scipy.optimize import least_squares

    layout = body.layout
    lower = np.where(np.isfinite(layout.lower), layout.lower, -1e3)
    upper = np.where(np.isfinite(layout.upper), layout.upper, 1e3)
    known = np.isfinite(landmarks).all(axis=1)

    def residual(state: Array) -> Array:
        return (landmarks_of(body, state[None])[0] - landmarks)[known].ravel()

    fits = []
    for yaw in (0.0, 1.57, 3.14, 4.71):
        start = neutral_state(body)
        start[:3] = np.nanmean(landmarks, axis=0)
        start[layout.names.index("root_yaw")] = yaw
        inside = np.clip(start, lower + 1e-6, upper - 1e-6)
        fits.append(least_squares(residual, inside, bounds=(lower, upper), max_nfev=200))
    return np.asarray(min(fits, key=lambda fit: fit.cost).x)


def run_filter(
    clip: HullClip,
    step: Callable[..., tuple[ParticleState, FilterInfo]],
    settings: Any,
    *,
    seed: int,
    likelihood: VoxelLikelihoodSettings | None = None,
) -> tuple[Array, list[FilterInfo]]:
    """Estimates (T, D) and infos of a filter over a clip, particles moved with the track as the pipeline does."""
    state: ParticleState | None = None
    estimates, infos = [], []
    for i, volume in enumerate(clip.volumes):
        problem = VoxelProblem(clip.body, clip.table, volume, likelihood or VoxelLikelihoodSettings())
        if state is None:
            state = initial_particles(problem, clip.first, settings.n_particles)
        else:
            moved = state.particles.copy()
            moved[:, :3] += clip.xyz[i] - clip.xyz[i - 1]
            state = replace(state, particles=moved)
        state, info = step(problem, state, settings, rng=np.random.default_rng([seed, i]))
        estimates.append(info.estimate)
        infos.append(info)
    return np.array(estimates), infos


def head(clip: HullClip, n_frames: int) -> HullClip:
    """The first frames of a clip."""
    return replace(
        clip,
        voxels=clip.voxels[:n_frames],
        volumes=clip.volumes[:n_frames],
        xyz=clip.xyz[:n_frames],
        truth=clip.truth[:n_frames],
    )


def compare_filters(
    description: str | None,
    *,
    scenes: str,
    n_frames: int,
    masks: str = ",".join(MASKS),
    seeds: int = 3,
    names: Sequence[str],
    measure: Callable[[HullClip, str, str, str, int], dict[str, Any]],
    summary: Callable[[Sequence[dict[str, Any]]], str],
    path: Path,
    fields: Sequence[str],
) -> list[dict[str, Any]]:
    """The command line of a comparison: every filter on every scene, kind of masks and seed, one row each in `path`.

    scenes, n_frames, masks, seeds : defaults of --scenes, --frames, --masks and --seeds.
    measure : (clip, scene, masks, filter, seed) -> row.
    summary : rows of one filter on one clip -> a few words.  The file is written when all are done.
    """
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", default=scenes)
    parser.add_argument("--masks", default=masks)
    parser.add_argument("--seeds", type=int, default=seeds)
    parser.add_argument("--frames", type=int, default=n_frames)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for scene in args.scenes.split(","):
        for kind in args.masks.split(","):
            clip = head(load_clip(scene, kind, args.work), args.frames)
            for name in names:
                own = [measure(clip, scene, kind, name, seed) for seed in range(args.seeds)]
                rows += own
                sys.stdout.write(f"{clip.name} {name}: {summary(own)}\n")
                sys.stdout.flush()
    write_csv(path, fields, rows)
    return rows
