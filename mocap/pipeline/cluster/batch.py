"""Batches: one whole run for every session, side by side, and one table of their scores."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mocap.errors import MocapError
from mocap.io.session import open_session
from mocap.pipeline.chains import observation_kind
from mocap.pipeline.cluster.engine import Engine, Job, Outcome, Progress, run_jobs
from mocap.pipeline.cluster.spec import session_names
from mocap.pipeline.cluster.sweep import SweepResult, summary_of, truth_hash
from mocap.pipeline.cluster.tables import Row, write_tables
from mocap.pipeline.config import config_hash, load_config, presets
from mocap.pipeline.join import check_joinable, join_runs, piece_frames
from mocap.pipeline.keys import stage_keys
from mocap.pipeline.outside import check_outside
from mocap.pipeline.reach import code_hash
from mocap.pipeline.record import OUTPUTS
from mocap.pipeline.run import run_session
from mocap.pipeline.stretches import run_recording

# The filter of a piece has found its pose, and tracks are confirmed, in less.
OVERLAP_S = 2.0
_PARTS = ("session.toml", "videos", "images", "masks", "detections")


@dataclass(frozen=True)
class Pieces:
    """How recordings are cut.  n : pieces, 1 = not at all.  overlap_s : that neighbours share."""

    n: int = 1
    overlap_s: float = OVERLAP_S

    def of(self, frames: range, fps: float) -> list[range]:
        """The frames of every piece. Raises MocapError for pieces that are too short."""
        return piece_frames(frames, self.n, round(self.overlap_s * fps))


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
    pieces: Pieces | None = None,
    n_threads: int = 1,
    progress: Progress | None = None,
) -> SweepResult:
    """Run every session into OUT/runs/NAME, whole, and write the tables of all into `out`.

    pieces : into which every recording is cut; each is run for itself, in OUT/pieces/NAME, and they are joined.
    A session whose run is there, with the same inputs, configuration, seed and code, is not run again.
    A session that fails is a row with its error. Raises as `run_sweep`.
    """
    check_outside(out, *sessions)
    names = session_names(sessions)
    common = {
        "preset": preset if preset in presets() else str(Path(preset).resolve()),
        "settings": list(settings),
        "seed": seed,
        "n_threads": n_threads,
    }
    planned = list(_plan(sessions, names, out, common, frames, pieces or Pieces()))
    jobs = {job.key: job for _, chain in planned if isinstance(chain, list) for job in chain}
    for job in jobs.values():
        if not (Path(job.parameters["out"]) / "run.json").is_file():
            (out / "cells" / f"{job.key}.json").unlink(missing_ok=True)  # somebody has removed the run
    outcomes = run_jobs(
        list(jobs.values()), out / "cells", engine=engine, code=code_hash(), progress=progress
    )
    rows = [
        Row({"session": name}, chain if isinstance(chain, Outcome) else outcomes[chain[-1].key])
        for name, chain in planned
    ]
    files = write_tables(out, rows, groups=(), over=("session",), title="Batch")
    return SweepResult(tuple(rows), tuple(files))


def run_one(parameters: dict[str, Any]) -> dict[str, Any]:
    """The whole run of one session, or one of some of its frames up to the poses."""
    frames = parameters["frames"]
    out = Path(parameters["out"])
    # A piece is short: the camera that was pushed in it is left out.
    run = run_recording if parameters["until"] == OUTPUTS else run_session
    result = run(
        parameters["session"],
        out,
        config=load_config(parameters["preset"], tuple(parameters["settings"])),
        seed=parameters["seed"],
        until=parameters["until"],
        resume=True,
        frames=None if frames is None else (frames[0], frames[1]),
        n_threads=parameters["n_threads"],
        command="mocap batch",
    )
    return {**summary_of(result), "run": f"{out.parent.name}/{out.name}"}


def join_one(parameters: dict[str, Any]) -> dict[str, Any]:
    """The whole run of one session, joined from its pieces."""
    out = Path(parameters["out"])
    pieces = [Path(piece) for piece in parameters["pieces"]]
    result = join_runs(Path(parameters["session"]), pieces, out, command="mocap batch")
    return {**summary_of(result), "run": f"runs/{out.name}"}


def _plan(
    sessions: Sequence[Path],
    names: Sequence[str],
    out: Path,
    common: dict[str, Any],
    frames: tuple[int | None, int | None] | None,
    pieces: Pieces,
) -> Iterator[tuple[str, list[Job] | Outcome]]:
    """Every session with its jobs, the one that ends it last, or with its failure when it cannot be opened."""
    config = load_config(common["preset"], tuple(common["settings"]))
    for path, name in zip(sessions, names, strict=True):
        try:
            session = open_session(path, frames=frames)
            kind = observation_kind(session, config)
            if pieces.n > 1:
                check_joinable(kind, path)
            key = stage_keys(session, config, common["seed"], kind)["pose"]
            whole = {**common, "session": str(path), "out": str(out.resolve() / "runs" / name)}
            chain = (
                [Job("run", run_one, {**whole, "frames": list(frames) if frames else None, "until": OUTPUTS})]
                if pieces.n == 1
                else list(_jobs_of_pieces(whole, name, pieces.of(session.frames, session.fps)))
            )
        except MocapError as error:
            yield name, Outcome(None, str(error))
            continue
        about = config_hash(key, truth_hash(session), config.output, name, pieces.n, pieces.overlap_s)
        yield (
            name,
            [
                replace(job, key=f"{job.key}-{about}", needs=tuple(f"{need}-{about}" for need in job.needs))
                for job in chain
            ],
        )


def _jobs_of_pieces(whole: dict[str, Any], name: str, pieces: Sequence[range]) -> Iterator[Job]:
    """A run of every piece, and what joins them."""
    outs = [Path(whole["out"]).parents[1] / "pieces" / name / f"{p.start}-{p.stop}" for p in pieces]
    for piece, out in zip(pieces, outs, strict=True):
        own = {"out": str(out), "frames": [piece.start, piece.stop], "until": "pose"}
        yield Job(f"piece-{piece.start}", run_one, {**whole, **own}, is_kept=False)
    needs = tuple(f"piece-{piece.start}" for piece in pieces)
    yield Job("joined", join_one, {**whole, "pieces": [str(out) for out in outs]}, needs=needs)
