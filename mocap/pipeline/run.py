"""A run: from camera folder to motion, stage by stage, each reused when nothing it depends on has changed."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from mocap.compare import score_run
from mocap.compiling import compilation_shown
from mocap.errors import MocapError
from mocap.forks import answering, begun, can_fork
from mocap.io._files import atomic_text
from mocap.io.session import Session, open_session
from mocap.io.store import StageStore
from mocap.pipeline.chains import UNTIL, WITH_VOLUMES, observation_kind, stages_until
from mocap.pipeline.checks import (
    check_config,
    check_device,
    check_flesh,
    check_out,
    check_truth,
    check_volume,
)
from mocap.pipeline.config import Config, OutputConfig, load_config
from mocap.pipeline.edits.beside import hand_words, tracks_after, with_edits
from mocap.pipeline.edits.model import Edits
from mocap.pipeline.inputs import FileHashes
from mocap.pipeline.keys import stage_keys
from mocap.pipeline.lock import sole_use
from mocap.pipeline.outputs import write_exports, write_tables, written_or_why
from mocap.pipeline.pictures import read_pictures
from mocap.pipeline.publish import RUN_FILE, outputs_in, published
from mocap.pipeline.reach import code_hash
from mocap.pipeline.record import (
    OUTPUTS,
    Found,
    RunRecord,
    RunResult,
    StageRecord,
    printable,
    record_to_json,
    versions,
)
from mocap.pipeline.report_data import gather_report, write_run_report
from mocap.pipeline.resolution import at_useful_size
from mocap.pipeline.stage import Job, Stage, StageReport, is_done
from mocap.pipeline.stale import forget_stale_kernels
from mocap.pipeline.walk import run_together, walks
from mocap.portable import peak_memory_mb
from mocap.products import hulls as hulls_product
from mocap.products import owners as owners_product
from mocap.products import poses as poses_product
from mocap.products import tracks as tracks_product
from mocap.products.one_run import hashes_in
from mocap.products.poses import stored_poses
from mocap.profiling import part
from mocap.progress import Progress, no_progress
from mocap.threads import AtOnce, quick_turns


def run_session(
    session: Session | Path | str,
    out: Path | str,
    *,
    config: Config | None = None,
    seed: int = 0,
    until: str = "report",
    resume: bool = False,
    rehash: bool = False,
    frames: tuple[int | None, int | None] | None = None,
    calibration: Path | str | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
    command: str = "",
) -> RunResult:
    """Run the pipeline on a session folder and write every output of the run into `out`.

    config : None = the preset `default`.  until : last stage to run, one of UNTIL.  resume : reuse stage products
    in `out` whose configuration, inputs and code are the same; otherwise everything is computed anew.
    rehash : distrust what an earlier run remembers of files whose size and times are the same.
    frames : (start, stop).  n_threads : None = up to 2; the result does not depend on it.
    progress : called as progress(stage, done, total).
    Raises MocapError for bad input, before the first stage where possible, and when another command works in `out`.
    Finished stage products are never damaged; tables, exports and report take the place of those of an earlier run
    together, when all are written, and what this run does not write is removed with them.
    """
    if until not in UNTIL:
        raise ValueError(f"until must be one of {', '.join(UNTIL)}, got {until!r}")
    forget_stale_kernels()
    config = config or load_config()
    if not isinstance(session, Session):
        session = open_session(session, calibration=calibration, frames=frames)
    out = Path(out)
    config = with_edits(config, out, session)
    kind = observation_kind(session, config)
    check_config(config, kind)
    session = at_useful_size(session, config, kind)
    check_out(out, session)
    if kind in WITH_VOLUMES and until != "segment":
        check_volume(session, config)
    if until in _WITH_POSES:
        check_flesh(session, config, kind)
        check_truth(session)
        if kind in WITH_VOLUMES:
            check_device(config)
    job = Job(
        session=session,
        config=config,
        store=StageStore(out / "store.zarr"),
        seed=seed,
        n_threads=n_threads or min(2, os.cpu_count() or 1),
        progress=progress or no_progress,
    )
    with sole_use(out, command), compilation_shown(job.progress), quick_turns():
        try:
            steps = list(_steps(job, kind, until, resume=resume, rehash=rehash))
            return publish_run(job, out, found_in(job, kind, until), steps, until=until, command=command)
        finally:
            job.store.remove_unfinished()


_WITH_POSES = ("pose", OUTPUTS)


def _steps(
    job: Job, kind: str, until: str, *, resume: bool, rehash: bool
) -> Iterator[tuple[StageRecord, StageReport]]:
    """The stages in order, each reused or computed."""
    # Only who resumes trusts what an earlier run remembers of the input files.
    hashes = FileHashes(job.store.path / ".inputs.json", is_trusted=resume and not rehash)
    keys = stage_keys(job.session, job.config, job.seed, kind, hashes)
    plain = job.config.model_copy(update={"edits": Edits()})
    unedited = stage_keys(job.session, plain, job.seed, kind, hashes)
    hashes.keep()
    jobs = {
        name: replace(job, key=key, unedited_key=unedited[name], is_resumed=resume)
        for name, key in keys.items()
    }
    stages = stages_until(kind, until)
    is_reused = {s.name: resume and is_done(s, job.store, keys[s.name]) for s in stages}
    walls_s: dict[str, float] = {}

    def reports(some: Sequence[Stage]) -> list[StageReport]:
        return [stage.report(jobs[stage.name]) for stage in some]

    *first, last = [*walks([stage for stage in stages if not is_reused[stage.name]])] or [()]
    for together in first:
        walls_s |= run_together([(stage, jobs[stage.name]) for stage in together])
    n_done = stages.index(last[0]) if last else 0
    # Beside the last walk: following people leaves processors idle while their first poses are looked for.
    with begun(lambda: reports(stages[:n_done]), job.n_threads if n_done else 1) as early:
        if last:
            walls_s |= run_together([(stage, jobs[stage.name]) for stage in last])
        every = [*early(), *reports(stages[n_done:])]
    for stage, report in zip(stages, every, strict=True):
        yield StageRecord(stage.name, keys[stage.name], walls_s.get(stage.name), report.numbers), report


def found_in(job: Job, kind: str, until: str) -> Found:
    """Tracks and poses out of the store, as far as the run went."""
    products = {product for stage in stages_until(kind, until) for product in stage.products}
    has_poses = poses_product.PRODUCT in products
    return Found(
        session=job.session,
        store=job.store,
        kind=kind,
        tracks=tracks_after(job.store, kind, job.session, job.config.edits, has_poses=has_poses)
        if tracks_product.PRODUCT in products
        else None,
        poses=tuple(stored_poses(job.store)) if has_poses else (),
        method=job.config.method,
    )


def publish_run(
    job: Job,
    out: Path,
    found: Found,
    steps: Sequence[tuple[StageRecord, StageReport]],
    *,
    until: str,
    command: str,
) -> RunResult:
    """Score what was found and write the outputs, which take the place of all those of an earlier run."""
    scores, unscored = _scores(found) if until in _WITH_POSES else (None, [])
    is_whole = until == OUTPUTS
    started = time.perf_counter()
    with part(OUTPUTS), published(out) as folder:
        write_tables(found, folder, has_poses=until in _WITH_POSES)
        record = _record(job, found, steps, until=until, command=command, scores=scores)
        record = _warning(record, unscored)
        if is_whole:
            record = _written(record, job, found, folder, out)
        files = {*(path.name for path in folder.iterdir()), RUN_FILE}
        record = replace(
            record,
            files=tuple(sorted(files)),
            hashes=hashes_in(folder),
            removed=tuple(sorted(outputs_in(out) - files)),
            outputs_s=time.perf_counter() - started,
            peak_memory_mb=peak_memory_mb(),
        )
        if is_whole:
            keep = job.config.output.keep
            kept = {p: key for p, key in record.product_keys.items() if p not in _not_kept(found, keep)}
            record = replace(record, product_keys=kept)
        atomic_text(folder / RUN_FILE, json.dumps(record_to_json(record), indent=1) + "\n")
    if is_whole:
        for product in _not_kept(found, job.config.output.keep):
            job.store.remove(product)
    return RunResult(record, out, found)


def _written(record: RunRecord, job: Job, found: Found, folder: Path, out: Path) -> RunRecord:
    """Exports and report in a folder, the latter gathered beside the former; the record with what failed of them."""
    output = job.config.output
    gathering = partial(_gathering, RunResult(record, out, found), output, job.n_threads)
    # Small calls of Python on both sides: two threads would wait for each other.
    is_apart = job.n_threads > 1 and can_fork() and {"rrd", "report"} & set(output.formats)
    with answering(gathering) if is_apart else gathering() as ask:
        left_out = write_exports(found, output, folder, pictures=lambda: ask("scene"), progress=job.progress)
        record = _warning(record, left_out)
        if "report" not in output.formats:
            return record
        result = RunResult(record, out, found)
        return _warning(
            record,
            written_or_why(
                folder / "report.html", lambda path: write_run_report(result, path, ask("report"))
            ),
        )


@contextmanager
def _gathering(result: RunResult, output: OutputConfig, n_threads: int) -> Iterator[Callable[[str], Any]]:
    """Reads the clips for scene and report; gives what tells, when it is there, the pictures of the `scene`, or all of
    the `report` but for what is known last."""
    thread = ThreadPoolExecutor(1) if n_threads > 1 else AtOnce()
    with_report = "report" in output.formats
    read = thread.submit(
        read_pictures,
        result.found,
        report=output if with_report else None,
        scene=None if "rrd" in output.formats else (),
        n_threads=n_threads,
    )
    gathered = thread.submit(lambda: gather_report(result, read.result())) if with_report else None
    try:
        yield lambda what: gathered.result() if gathered and what == "report" else read.result().scene
    finally:
        thread.shutdown(wait=False, cancel_futures=True)


def _not_kept(found: Found, keep: str) -> tuple[str, ...]:
    """The products that a finished run does not leave behind.  keep : as in the configuration."""
    if keep == "masks":
        return (hulls_product.PRODUCT, owners_product.PRODUCT) if found.hulls is not None else ()
    products = [product for stage in stages_until(found.kind, OUTPUTS) for product in stage.products]
    return tuple(products) if keep == "nothing" else ()


def _record(
    job: Job,
    found: Found,
    steps: Sequence[tuple[StageRecord, StageReport]],
    *,
    until: str,
    command: str,
    scores: dict[str, Any] | None,
) -> RunRecord:
    """What is known of the run when its stages are done."""
    session = job.session
    products = {stage.name: stage.products for stage in stages_until(found.kind, until)}
    record = RunRecord(
        session=printable(session.name),
        kind=found.kind,
        until=until,
        command=printable(command),
        frames=session.frames,
        fps=session.fps,
        cameras=session.rig.names,
        seed=job.seed,
        config=job.config,
        code=code_hash(),
        stages=tuple(stage for stage, _ in steps),
        product_keys={product: stage.key for stage, _ in steps for product in products.get(stage.name, ())},
        warnings=(),
        scores=scores,
        versions=versions(),
    )
    by_hand = [hand_words(job.config.edits)] if job.config.edits else []
    return _warning(
        record, [*by_hand, *session.warnings, *(w for _, report in steps for w in report.warnings)]
    )


def _warning(record: RunRecord, warnings: Sequence[str]) -> RunRecord:
    """The record with more warnings, each once."""
    every = (*record.warnings, *(printable(w) for w in warnings))
    return replace(record, warnings=tuple(dict.fromkeys(every)))


def _scores(found: Found) -> tuple[dict[str, Any] | None, list[str]]:
    """Scores against the truth, None without; and a warning when the truth turns out to be bad."""
    try:
        return score_run(found.session, found.motions, found.tracks, hulls=found.hulls), []
    except MocapError as error:
        return None, [f"the result is not scored: {error}"]
