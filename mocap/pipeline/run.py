"""A run from camera folder to motion: the stages in order, each reused when nothing it depends on has changed."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from mocap.data import Motion, Tracks
from mocap.errors import DISTRIBUTION, MocapError
from mocap.io.session import Session, open_session
from mocap.io.store import StageStore
from mocap.pipeline import stages
from mocap.pipeline.config import Config, config_hash, load_config
from mocap.pipeline.pose import PersonPoses, motion_numbers

STAGES = ("segment", "carve", "track", "pose", "report")
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class RunResult:
    """What a run has found and how it went.

    timings_s : stage -> seconds; a stage that was reused is absent.  scores : as `mocap eval`, None without truth.
    """

    out: Path
    session: Session
    status: str
    tracks: Tracks | None
    poses: tuple[PersonPoses, ...]
    scores: dict[str, Any] | None
    timings_s: dict[str, float]
    reused: tuple[str, ...]
    warnings: tuple[str, ...]
    numbers: dict[str, Any] = field(default_factory=dict)

    @property
    def motions(self) -> list[Motion]:
        """Landmarks of every person."""
        return [motion_of(p, self.session.fps) for p in self.poses]


def motion_of(poses: PersonPoses, fps: float) -> Motion:
    """The landmarks of one person with their standard deviations."""
    import numpy as np

    return Motion(
        person=poses.person,
        frames=poses.frames,
        time_s=poses.frames / fps,
        landmarks=poses.landmarks,
        std=np.sqrt(np.diagonal(poses.landmark_covariance, axis1=2, axis2=3)),
        observed=poses.observed,
    )


def run_session(
    session: Session | Path | str,
    out: Path | str,
    *,
    config: Config | None = None,
    seed: int = 0,
    until: str = "report",
    resume: bool = False,
    frames: tuple[int | None, int | None] | None = None,
    calibration: Path | str | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
    command: str = "",
) -> RunResult:
    """Run the pipeline on a session folder and write every output of the run into `out`.

    config : None = the preset `default`.  until : last stage to run, one of STAGES.  resume : reuse stage products
    in `out` whose configuration, inputs and code are the same; otherwise everything is computed anew.
    frames : (start, stop).  n_threads : None = up to 2; the result does not depend on it.
    progress : called as progress(stage, done, total).
    Raises MocapError for bad input, before anything in `out` is touched where possible; finished stage products
    are never damaged, and tables, exports and report replace earlier ones together, when all are written.
    """
    if until not in STAGES:
        raise ValueError(f"until must be one of {', '.join(STAGES)}, got {until!r}")
    config = config or load_config()
    _check_config(config)
    tick: Progress = progress or (lambda stage, done, total: None)
    threads = n_threads or min(2, os.cpu_count() or 1)
    if not isinstance(session, Session):
        session = open_session(session, calibration=calibration, frames=frames)
    kind = stages.observation_kind(session, config)
    if kind == "markers":
        stages.check_marker_config(config)
    out = Path(out)
    _check_writable(out)
    store = StageStore(out / "store.zarr")

    keys = stage_keys(session, config, seed, kind)
    timings: dict[str, float] = {}
    reused: list[str] = []
    warnings: list[str] = list(session.warnings)
    numbers: dict[str, Any] = {}
    last = STAGES.index(until)

    def do(stage: str, compute: Callable[[], object]) -> object | None:
        if resume and store.is_complete(stage, keys[stage]):
            reused.append(stage)
            return None
        started = time.perf_counter()
        result = compute()
        timings[stage] = time.perf_counter() - started
        return result

    tracks: Tracks | None = None
    if kind == "markers":
        do("detect", lambda: stages.detect_stage(session, config, store, keys["detect"], progress=tick))
        report = stages.detect_report(store, session)
        warnings += report.warnings
        numbers["detect"] = report.numbers
    else:
        do(
            "segment",
            lambda: stages.segment_stage(
                session, config, store, keys["segment"], n_threads=threads, progress=tick
            ),
        )
        report = stages.segment_report(store, session)
        warnings += report.warnings
        numbers["segment"] = report.numbers

        if last >= 1:
            do("carve", lambda: stages.carve_stage(session, config, store, keys["carve"], progress=tick))
            report = stages.carve_report(store)
            warnings += report.warnings
            numbers["carve"] = report.numbers

        if last >= 2:
            do(
                "track",
                lambda: stages.track_stage(session, config, store, keys["track"], seed=seed, progress=tick),
            )
            tracks = stages.stored_tracks(store, session.fps)
            numbers["track"] = {"n_persons": len(tracks.persons)}
            if not tracks.persons:
                warnings.append(
                    "no person was found in the volume. Remedy: look at the silhouettes and the hull in the report; "
                    "a person needs some 15 to 500 litres of connected volume"
                )

    poses: list[PersonPoses] = []
    if last >= 3 and kind == "markers":
        do(
            "pose",
            lambda: stages.marker_pose_stage(session, config, store, keys["pose"], seed=seed, progress=tick),
        )
        tracks = stages.stored_tracks(store, session.fps)
        numbers["track"] = {"n_persons": len(tracks.persons)}
        if not tracks.persons:
            warnings.append(
                "no person was found in the detections. Remedy: look at the detections in the report; the cameras "
                "must agree on some markers, and the calibration must be that of the detections"
            )
    elif last >= 3 and tracks is not None:
        do(
            "pose",
            lambda: stages.pose_stage(
                session,
                config,
                store,
                keys["pose"],
                tracks,
                seed=seed,
                n_threads=threads,
                progress=tick,
            ),
        )
    if last >= 3:
        poses = stages.stored_poses(store)
        warnings += [w for p in poses for w in p.warnings]
        numbers["pose"] = {
            "persons": {
                str(p.person): {
                    "height_m": round(p.height.height_m, 3),
                    "first_frame": int(p.frames[0]),
                    "last_frame": int(p.frames[-1]),
                    "start_frame": p.start_frame,
                    **motion_numbers(p, session.fps),
                }
                for p in poses
            }
        }

    from mocap.pipeline.outputs import published, write_outputs
    from mocap.pipeline.scoring import score_run

    result = RunResult(
        out=out,
        session=session,
        status="complete" if until == "report" else f"complete until {until}",
        tracks=tracks,
        poses=tuple(poses),
        scores=None,
        timings_s=timings,
        reused=tuple(reused),
        warnings=tuple(dict.fromkeys(warnings)),
        numbers=numbers,
    )
    scores = score_run(result, store) if session.truth_dir is not None and last >= 3 else None
    result = RunResult(**{**vars(result), "scores": scores})
    started = time.perf_counter()
    with published(out, {p.person for p in poses} if until == "report" else None) as folder:
        write_outputs(result, store, config, folder, seed=seed, until=until, command=command, progress=tick)
        for name, text in stages.body_files(store, poses).items() if last >= 3 else ():
            write_text(folder / name, text)
        timings["report"] = time.perf_counter() - started
        write_run_json(result, config, keys, folder, seed=seed, command=command)
    return result


def stage_keys(session: Session, config: Config, seed: int, kind: str = "voxels") -> dict[str, str]:
    """The key of every stage: a hash of its configuration, its inputs, the code and the stage before.

    kind : `markers` or `voxels`, which have stages of their own.
    """
    inputs = _fingerprint_inputs(session)
    code = code_hash()
    named = _fingerprint_named_files(config)
    if kind == "markers":
        detect = config_hash(code, inputs, config.markers)
        pose = config_hash(
            detect, config.body, config.pose, named, seed, session.person_height_m, session.fps
        )
        return {"detect": detect, "pose": pose}
    segment = config_hash(code, inputs, config.segmentation)
    carve = config_hash(segment, config.volume, str(session.room_bounds_m))
    track = config_hash(carve, config.tracking, seed if config.tracking.tracker != "naive" else 0)
    pose = config_hash(
        track, config.body, config.likelihood, config.pose, named, seed, session.person_height_m, session.fps
    )
    return {"segment": segment, "carve": carve, "track": track, "pose": pose}


@cache
def code_hash() -> str:
    """Hash of the package's own source files: a product made by other code is not reused."""
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for path in sorted([*root.rglob("*.py"), *root.rglob("*.toml")]):
        digest.update(path.relative_to(root).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _fingerprint_inputs(session: Session) -> str:
    """Hash of frame range, calibration and source files (size and first and last 64 kB of each)."""
    digest = hashlib.sha256()
    digest.update(repr((session.frames.start, session.frames.stop, session.rig.names)).encode())
    for camera in session.rig:
        for array in (camera.K, camera.dist, camera.R, camera.t):
            digest.update(array.tobytes())
    digest.update(repr((session.fps, sorted(session.roi_px.items()))).encode())
    marker_files = {path.name: path for path in stages.marker_inputs(session)}
    masks = (session.mask_sources, session.roi_sources)
    for kind in (session.image_sources, session.background_sources, *masks, marker_files):
        for name in sorted(kind):
            source = kind[name]
            files = sorted(p for p in source.rglob("*") if p.is_file()) if source.is_dir() else [source]
            for file in files:
                size = file.stat().st_size
                digest.update(f"{name} {file.name} {size}".encode())
                with file.open("rb") as stream:
                    digest.update(stream.read(65536))
                    if size > 131072:
                        stream.seek(-65536, os.SEEK_END)
                        digest.update(stream.read())
    return digest.hexdigest()[:16]


def _fingerprint_named_files(config: Config) -> str:
    """Hash of the user's files that the configuration names; those that come with the package are in `code_hash`."""
    digest = hashlib.sha256()
    for name in (config.body.model, config.body.marker_set, config.pose.hierarchy, config.pose.limbs):
        path = Path(name)
        digest.update(f"{name} ".encode())
        if path.is_file():
            content = path.read_bytes()
            digest.update(f"{len(content)} ".encode() + content)
    return digest.hexdigest()[:16]


def _check_config(config: Config) -> None:
    """Names that only the code knows are checked before any work is done."""
    from mocap.body import load_body_model
    from mocap.pipeline.pose_settings import check_filter

    check_filter(config.pose, "likelihood", factorised=config.likelihood.factorised)
    load_body_model(config.body_model("voxels"))


def _check_writable(out: Path) -> None:
    probe = out / ".mocap-write-test"
    try:
        out.mkdir(parents=True, exist_ok=True)
        try:
            probe.write_bytes(b"x")
        finally:
            probe.unlink(missing_ok=True)
    except OSError as error:
        raise MocapError(
            f"the output folder cannot be written: {error.strerror or error}",
            path=out,
            remedy="choose another folder with -o, or free space and check its permissions",
        ) from error


def write_run_json(
    result: RunResult, config: Config, keys: dict[str, str], folder: Path, *, seed: int, command: str
) -> None:
    """run.json: what was run, with what, how fast, and what it warns of."""
    n_frames = len(result.session.frames)
    about = {
        "status": result.status,
        "session": result.session.name,
        "command": command,
        "n_frames": n_frames,
        "frames": [result.session.frames.start, result.session.frames.stop],
        "fps": result.session.fps,
        "cameras": list(result.session.rig.names),
        "seed": seed,
        "config": config.model_dump(mode="json"),
        "config_hash": config_hash(config),
        "code_hash": code_hash(),
        "stage_keys": keys,
        "stages": {
            stage: {
                "wall_s": round(seconds, 3),
                "frames_per_s": round(n_frames / seconds, 2) if seconds > 0 else None,
            }
            for stage, seconds in result.timings_s.items()
        },
        "reused": list(result.reused),
        "total_s": round(sum(result.timings_s.values()), 3),
        "peak_memory_mb": peak_memory_mb(),
        "warnings": list(result.warnings),
        "numbers": result.numbers,
        "scores": result.scores,
        "versions": versions(),
    }
    write_text(folder / "run.json", json.dumps(about, indent=1) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise MocapError(
            f"the file cannot be written: {error.strerror or error}",
            path=path,
            remedy="free space or choose another folder with -o",
        ) from error


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far, MB."""
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, 1)


def versions() -> dict[str, str]:
    """Versions of this package and what its results depend on."""
    from importlib.metadata import PackageNotFoundError, version

    found = {"python": platform.python_version(), "platform": sys.platform}
    for name in ("mocap", "numpy", "scipy", "numba", "opencv-python-headless", "zarr"):
        try:
            found[name] = version(DISTRIBUTION if name == "mocap" else name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
