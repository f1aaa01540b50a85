"""Batches: one whole run for every session, side by side, and one table of their scores."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mocap.errors import MocapError
from mocap.io.session import open_session
from mocap.pipeline.chains import observation_kind
from mocap.pipeline.cluster.engine import Engine, Job, Outcome, Progress, run_jobs
from mocap.pipeline.cluster.spec import session_names
from mocap.pipeline.cluster.sweep import SweepResult, summary_of, truth_hash
from mocap.pipeline.cluster.tables import Row, write_tables
from mocap.pipeline.config import Config, config_hash, load_config, presets
from mocap.pipeline.keys import stage_keys
from mocap.pipeline.reach import code_hash
from mocap.pipeline.run import run_session

_PARTS = ("session.toml", "videos", "images", "masks", "detections")


def is_session(folder: Path) -> bool:
    """Whether a folder looks like a session; one with faults still does, so that they are reported."""
    return any((folder / name).exists() for name in _PARTS) or any(folder.glob("calibration.*"))


def find_sessions(paths: Sequence[Path]) -> list[Path]:
    """Session folders, and those in folders of sessions by name; each once.

    Raises MocapError for a path that is no folder or holds no session.
    """
    found: dict[Path, None] = {}
    for path in paths:
        if not path.is_dir():
            raise MocapError(
                "there is no such folder", path=path, remedy="name sessions, or folders of sessions"
            )
        inside = (
            [path]
            if is_session(path)
            else [p for p in sorted(path.iterdir()) if p.is_dir() and is_session(p)]
        )
        if not inside:
            raise MocapError(
                "the folder is no session and holds none",
                path=path,
                remedy="a session has videos/, images/, masks/ or detections/ and a calibration; see docs/session.md",
            )
        found.update(dict.fromkeys(p.resolve() for p in inside))
    return list(found)


def run_batch(
    sessions: Sequence[Path],
    out: Path,
    *,
    engine: Engine,
    preset: str = "default",
    settings: Sequence[str] = (),
    seed: int = 0,
    frames: tuple[int | None, int | None] | None = None,
    n_threads: int = 1,
    progress: Progress | None = None,
) -> SweepResult:
    """Run every session into OUT/runs/NAME, whole, and write the tables of all into `out`.

    A session whose run is there, with the same inputs, configuration, seed and code, is not run again.
    A session that fails is a row with its error. Raises as `run_sweep`.
    """
    config = load_config(preset, tuple(settings))
    names = session_names(sessions)
    planned = list(_plan(sessions, names, out, config, preset, settings, seed, frames, n_threads))
    jobs = {job.key: job for _, job in planned if isinstance(job, Job)}
    for job in jobs.values():
        if not (Path(job.parameters["out"]) / "run.json").is_file():
            (out / "cells" / f"{job.key}.json").unlink(missing_ok=True)  # somebody has removed the run
    outcomes = run_jobs(
        list(jobs.values()), out / "cells", engine=engine, code=code_hash(), progress=progress
    )
    rows = [
        Row({"session": name}, job if isinstance(job, Outcome) else outcomes[job.key])
        for name, job in planned
    ]
    files = write_tables(out, rows, groups=(), over=("session",), title="Batch")
    return SweepResult(tuple(rows), tuple(files))


def run_one(parameters: dict[str, Any]) -> dict[str, Any]:
    """The whole run of one session."""
    frames = parameters["frames"]
    name = Path(parameters["out"]).name
    result = run_session(
        parameters["session"],
        parameters["out"],
        config=load_config(parameters["preset"], tuple(parameters["settings"])),
        seed=parameters["seed"],
        resume=True,
        frames=None if frames is None else (frames[0], frames[1]),
        n_threads=parameters["n_threads"],
        command="mocap batch",
    )
    return {**summary_of(result), "run": f"runs/{name}"}


def _plan(
    sessions: Sequence[Path],
    names: Sequence[str],
    out: Path,
    config: Config,
    preset: str,
    settings: Sequence[str],
    seed: int,
    frames: tuple[int | None, int | None] | None,
    n_threads: int,
) -> Iterator[tuple[str, Job | Outcome]]:
    for path, name in zip(sessions, names, strict=True):
        try:
            session = open_session(path, frames=frames)
            kind = observation_kind(session, config)
            pose = stage_keys(session, config, seed, kind)["pose"]
        except MocapError as error:
            yield name, Outcome(None, str(error))
            continue
        parameters = {
            "session": str(path),
            "out": str(out.resolve() / "runs" / name),
            "preset": preset if preset in presets() else str(Path(preset).resolve()),
            "settings": list(settings),
            "seed": seed,
            "frames": list(frames) if frames else None,
            "n_threads": n_threads,
        }
        yield (
            name,
            Job(f"run-{config_hash(pose, truth_hash(session), config.output, name)}", run_one, parameters),
        )
