"""A finished run read back from its folder, to write its report or its 3D scene again without running anything."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from mocap.errors import MocapError
from mocap.io._files import writing
from mocap.io.session import Session, open_session
from mocap.io.store import StageStore
from mocap.pipeline import stages
from mocap.pipeline.config import Config
from mocap.pipeline.run import RunResult


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """What a run has left.  result : as it was returned; timings to the millisecond.  command : that made it."""

    result: RunResult
    store: StageStore
    config: Config
    seed: int
    command: str


def open_run(out: Path, session: Path) -> FinishedRun:
    """Read the run in `out`; `session` is the folder that it was made from.

    Raises MocapError when there is no complete run, when its settings are of another version, or when the session has
    other cameras, frames or frame rate than the run.
    """
    about = _about(out)
    frames = (int(about["frames"][0]), int(about["frames"][1]))
    opened = open_session(session, frames=frames)
    _check_same(about, opened, out)
    try:
        config = Config.model_validate(about["config"])
    except ValidationError as error:
        raise MocapError(
            f"the run has settings that this version does not know: {error.errors()[0]['msg']}",
            path=out / "run.json",
            remedy="run the session again",
        ) from error
    store = StageStore(out / "store.zarr")
    result = RunResult(
        out=out,
        session=opened,
        status=str(about["status"]),
        tracks=stages.stored_tracks(store, opened.fps),
        poses=tuple(stages.stored_poses(store)),
        scores=about["scores"],
        timings_s={stage: float(row["wall_s"]) for stage, row in about["stages"].items()},
        reused=tuple(about["reused"]),
        warnings=tuple(about["warnings"]),
        numbers=about["numbers"],
    )
    return FinishedRun(result, store, config, int(about["seed"]), str(about["command"]))


def rewrite_report(out: Path, session: Path) -> Path:
    """report.html of a finished run, written again from its tables and its store; gives the file."""
    from mocap.pipeline.outputs import write_run_report

    run = open_run(out, session)
    with writing(out / "report.html"):
        write_run_report(run.result, run.store, run.config, out, seed=run.seed, command=run.command)
    return out / "report.html"


def rewrite_scene(out: Path, session: Path, path: Path | None = None) -> Path:
    """The Rerun scene of a finished run, into OUT/scene.rrd or another file; gives the file."""
    from mocap.pipeline.outputs import write_scene

    run = open_run(out, session)
    target = out / "scene.rrd" if path is None else path
    write_scene(run.result, run.store, target)
    return target


def _about(out: Path) -> dict[str, Any]:
    path = out / "run.json"
    try:
        about: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        missing = [key for key in _NEEDED if key not in about]
    except (OSError, ValueError, TypeError) as error:
        raise MocapError(
            "the folder holds no result of a run", path=path, remedy="run `mocap run SESSION -o OUT` first"
        ) from error
    if missing:
        raise MocapError(
            f"run.json says nothing of {missing[0]}",
            path=path,
            remedy="run the session again with this version",
        )
    if about["status"] not in ("complete", "complete until pose"):
        raise MocapError(
            f"the run is {about['status']} and has no poses",
            path=path,
            remedy="finish it with `mocap run SESSION -o OUT --resume`",
        )
    return about


_NEEDED = (
    "status",
    "frames",
    "fps",
    "cameras",
    "seed",
    "config",
    "stages",
    "numbers",
    "warnings",
    "scores",
    "reused",
)


def _check_same(about: dict[str, Any], session: Session, out: Path) -> None:
    there = {
        "cameras": list(session.rig.names),
        "frames": [session.frames.start, session.frames.stop],
        "fps": session.fps,
    }
    for key, found in there.items():
        if about[key] != found:
            raise MocapError(
                f"the session is not that of the run: {key} {found}, in the run {about[key]}",
                path=session.root,
                remedy=f"give the session that {out} was made from",
            )
