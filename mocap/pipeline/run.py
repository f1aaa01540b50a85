"""A run: from camera folder to motion, stage by stage, each reused when nothing it depends on has changed."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mocap.compare import score_run
from mocap.io._files import atomic_text
from mocap.io.session import Session, open_session
from mocap.io.store import StageStore
from mocap.pipeline.chains import UNTIL, observation_kind, stages_until
from mocap.pipeline.checks import check_config, check_writable
from mocap.pipeline.config import Config, load_config
from mocap.pipeline.inputs import FileHashes
from mocap.pipeline.keys import stage_keys
from mocap.pipeline.outputs import write_exports, write_tables
from mocap.pipeline.publish import published
from mocap.pipeline.reach import code_hash
from mocap.pipeline.record import (
    OUTPUTS,
    Found,
    RunRecord,
    RunResult,
    StageRecord,
    record_to_json,
    versions,
)
from mocap.pipeline.report_data import write_run_report
from mocap.pipeline.stage import Job, Stage, StageReport, is_done, run_stage
from mocap.portable import peak_memory_mb
from mocap.products import poses as poses_product
from mocap.products import tracks as tracks_product
from mocap.products.poses import stored_poses
from mocap.products.tracks import stored_tracks
from mocap.progress import Progress, no_progress


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

    config : None = the preset `default`.  until : last stage to run, one of UNTIL.  resume : reuse stage products
    in `out` whose configuration, inputs and code are the same; otherwise everything is computed anew.
    frames : (start, stop).  n_threads : None = up to 2; the result does not depend on it.
    progress : called as progress(stage, done, total).
    Raises MocapError for bad input, before anything in `out` is touched where possible; finished stage products
    are never damaged, and tables, exports and report replace earlier ones together, when all are written.
    """
    if until not in UNTIL:
        raise ValueError(f"until must be one of {', '.join(UNTIL)}, got {until!r}")
    config = config or load_config()
    if not isinstance(session, Session):
        session = open_session(session, calibration=calibration, frames=frames)
    kind = observation_kind(session, config)
    check_config(config, kind)
    out = Path(out)
    check_writable(out)
    job = Job(
        session=session,
        config=config,
        store=StageStore(out / "store.zarr"),
        seed=seed,
        n_threads=n_threads or min(2, os.cpu_count() or 1),
        progress=progress or no_progress,
    )
    # Only who resumes trusts what an earlier run remembers of the input files.
    hashes = FileHashes(job.store.path / ".inputs.json", is_trusted=resume)
    keys = stage_keys(session, config, seed, kind, hashes)
    hashes.keep()
    steps = [
        _reuse_or_compute(stage, replace(job, key=keys[stage.name]), resume=resume)
        for stage in stages_until(kind, until)
    ]
    found = _collect(job, kind, until)
    return _publish(job, out, found, steps, until=until, command=command)


def _reuse_or_compute(stage: Stage, job: Job, *, resume: bool) -> tuple[StageRecord, StageReport]:
    wall_s = None
    if not (resume and is_done(stage, job.store, job.key)):
        started = time.perf_counter()
        run_stage(stage, job)
        wall_s = time.perf_counter() - started
    report = stage.report(job)
    return StageRecord(stage.name, job.key, wall_s, report.numbers), report


def _collect(job: Job, kind: str, until: str) -> Found:
    """Tracks and poses out of the store, as far as the run went."""
    products = {product for stage in stages_until(kind, until) for product in stage.products}
    return Found(
        session=job.session,
        store=job.store,
        kind=kind,
        tracks=stored_tracks(job.store, job.session.fps) if tracks_product.PRODUCT in products else None,
        poses=tuple(stored_poses(job.store)) if poses_product.PRODUCT in products else (),
    )


def _publish(
    job: Job,
    out: Path,
    found: Found,
    steps: Sequence[tuple[StageRecord, StageReport]],
    *,
    until: str,
    command: str,
) -> RunResult:
    """Score what was found and write the outputs, which replace those of an earlier run together."""
    session = job.session
    has_poses = until in ("pose", OUTPUTS)
    truth = session.truth_dir if has_poses else None
    scores = score_run(truth, found.motions, found.tracks, frames=session.frames, hulls=found.hulls)
    started = time.perf_counter()
    with published(out, {p.person for p in found.poses} if until == OUTPUTS else None) as folder:
        write_tables(found, folder, has_poses=has_poses)
        left_out = write_exports(found, job.config, folder, progress=job.progress) if until == OUTPUTS else []
        warnings = (*session.warnings, *(w for _, report in steps for w in report.warnings), *left_out)
        record = RunRecord(
            session=session.name,
            kind=found.kind,
            until=until,
            command=command,
            frames=session.frames,
            fps=session.fps,
            cameras=session.rig.names,
            seed=job.seed,
            config=job.config,
            code=code_hash(),
            stages=tuple(stage for stage, _ in steps),
            warnings=tuple(dict.fromkeys(warnings)),
            scores=scores,
            versions=versions(),
        )
        if until == OUTPUTS and "report" in job.config.output.formats:
            write_run_report(RunResult(record, out, found), folder)
        # The clock stops when everything but this very file is written.
        record = replace(record, outputs_s=time.perf_counter() - started, peak_memory_mb=peak_memory_mb())
        atomic_text(folder / "run.json", json.dumps(record_to_json(record), indent=1) + "\n")
    return RunResult(record, out, found)
