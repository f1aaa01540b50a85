"""Jobs with content-addressed results: in this process, on a cluster of this machine, or on any dask scheduler.

A job is a plain function of plain values. Its result is a JSON file named by the job's key, which the caller makes
from everything that the result depends on; a job whose file is there is not run again. A job that fails does not
stop the others. Which worker runs a job, and how many there are, changes nothing but the time.
"""

from __future__ import annotations

import gc
import json
import logging
import os
import queue
import time
import traceback
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from mocap.errors import MissingExtra, MocapError
from mocap.io._files import atomic_text, writing
from mocap.pipeline.lock import sole_use

Work = Callable[[dict[str, Any]], dict[str, Any]]

_FORMAT = 1
_TICK_S = 2.0  # how often an idle client looks whether there are workers
_CONNECT_S = 10.0
_ANSWER_S = 60.0  # a scheduler that says nothing for longer has gone; dask itself would wait for ever
_DEAD_WORKER = (
    "the worker process died without an answer. Remedy: it may have run out of memory; use fewer workers."
)


@dataclass(frozen=True)
class Job:
    """work(parameters) -> result; both plain JSON.  work : a function that a worker can import by name.

    key : names the result, in letters, digits, `-` and `_`.  needs : keys of jobs, earlier in the list, that must be
    done first.  is_kept : its result is written; other jobs only prepare something, and run when a kept one waits.
    """

    key: str
    work: Work
    parameters: dict[str, Any]
    needs: tuple[str, ...] = ()
    is_kept: bool = True


@dataclass(frozen=True)
class Outcome:
    """What became of a job.  result : as returned, None when it failed.  error : why.  trace : for unexpected errors.
    seconds : wall time of the work itself."""

    result: dict[str, Any] | None
    error: str = ""
    trace: str = ""
    seconds: float = 0.0

    @property
    def is_done(self) -> bool:
        return self.result is not None


@dataclass(frozen=True)
class Standing:
    """Kept jobs so far.  n_reused : done in an earlier run.  n_finished : done or failed, with the reused ones."""

    n_total: int
    n_finished: int
    n_failed: int
    n_reused: int
    n_workers: int
    elapsed_s: float

    @property
    def left_s(self) -> float | None:
        """Time left at the speed so far, None before the first job of this run."""
        n = self.n_finished - self.n_reused
        return None if n == 0 else self.elapsed_s / n * (self.n_total - self.n_finished)


Progress = Callable[[Standing], None]


@dataclass(frozen=True)
class Engine:
    """Where jobs run.

    scheduler : address of a running dask scheduler, None = this machine.  n_workers : processes on this machine, None =
    one per CPU, 0 = in this process, without dask.  patience_s : how long to wait for the first worker.
    """

    scheduler: str | None = None
    n_workers: int | None = None
    patience_s: float = 300.0


def run_jobs(
    jobs: Sequence[Job], folder: Path, *, engine: Engine, code: str, progress: Progress | None = None
) -> dict[str, Outcome]:
    """Run what has no result in `folder` yet; gives the outcome of every kept job by key.

    code : hash of the program; workers that run another one refuse.  progress : called after every job.
    Raises ValueError for jobs that need unknown ones, MocapError when the scheduler cannot be reached, has no workers
    or goes away, or when the folder cannot be written or is in use. Results so far are kept then.
    """
    _check_jobs(jobs)
    tick: Progress = progress or (lambda standing: None)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with sole_use(folder, "mocap sweep or batch"):
        kept = {job.key: job for job in jobs if job.is_kept}
        outcomes = _done_before(folder, kept)
        n_reused, started = len(outcomes), time.monotonic()
        pending = _pending(jobs, set(outcomes))

        def say(n_workers: int) -> None:
            failed = sum(not outcome.is_done for outcome in outcomes.values())
            tick(Standing(len(kept), len(outcomes), failed, n_reused, n_workers, time.monotonic() - started))

        def settle(job: Job, outcome: Outcome, n_workers: Callable[[], int]) -> None:
            if job.is_kept:
                write_outcome(folder, job.key, outcome)
                outcomes[job.key] = outcome
                say(n_workers())

        say(0)
        if not pending:
            return outcomes
        if engine.scheduler is None and engine.n_workers == 0:
            _run_here(pending, code, settle)
        else:
            _run_on_dask(pending, engine, code, settle)
    return outcomes


def _done_before(folder: Path, keys: Iterable[str]) -> dict[str, Outcome]:
    """Results of earlier commands; what has failed is tried again."""
    found = {key: read_outcome(folder, key) for key in keys}
    return {key: outcome for key, outcome in found.items() if outcome is not None and outcome.is_done}


def _run_here(jobs: Sequence[Job], code: str, settle: Callable[..., None]) -> None:
    """One job after the other in this process."""
    done: dict[str, Outcome] = {}
    for job in jobs:
        done[job.key] = attempt(job.work, job.parameters, code, *(done[key] for key in job.needs))
        settle(job, done[job.key], lambda: 0)


def attempt(work: Work, parameters: dict[str, Any], code: str, *needs: Outcome) -> Outcome:
    """One job where it runs: every exception becomes an outcome, so that it stops neither worker nor sweep."""
    from mocap.pipeline.reach import code_hash

    for need in needs:
        if not need.is_done:
            return need
    if code_hash() != code:
        return Outcome(
            None,
            "a worker runs another version of mocap than the command. Remedy: install the same version everywhere and "
            "start the workers again.",
        )
    started = time.perf_counter()
    try:
        result = work(parameters)
        json.dumps(result, allow_nan=False)
    except MocapError as error:
        return Outcome(None, str(error), "", time.perf_counter() - started)
    except Exception as error:  # whatever a cell does, the others go on; the trace goes into its result
        message = f"{type(error).__name__}: {error}"
        return Outcome(None, message, traceback.format_exc(), time.perf_counter() - started)
    return Outcome(result, "", "", time.perf_counter() - started)


def read_outcome(folder: Path, key: str) -> Outcome | None:
    """The stored outcome of a key, None when there is none that can be read."""
    try:
        document = json.loads((folder / f"{key}.json").read_text(encoding="utf-8"))
        if document["format"] != _FORMAT or document["key"] != key:
            return None
        result = document["result"]
        if result is not None and not isinstance(result, dict):
            return None
        return Outcome(
            result, str(document["error"]), str(document.get("trace", "")), float(document["seconds"])
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_outcome(folder: Path, key: str, outcome: Outcome) -> None:
    """KEY.json, whole or not at all."""
    document: dict[str, Any] = {
        "format": _FORMAT,
        "key": key,
        "result": outcome.result,
        "error": outcome.error,
        "seconds": round(outcome.seconds, 3),
    }
    if outcome.trace:
        document["trace"] = outcome.trace
    atomic_text(folder / f"{key}.json", json.dumps(document, indent=1) + "\n")


def _check_jobs(jobs: Sequence[Job]) -> None:
    seen: set[str] = set()
    for job in jobs:
        if not job.key or not all(c.isalnum() or c in "-_" for c in job.key):
            raise ValueError(f"key must be letters, digits, - and _, got {job.key!r}")
        if job.key in seen:
            raise ValueError(f"two jobs have the key {job.key!r}")
        missing = [key for key in job.needs if key not in seen]
        if missing:
            raise ValueError(f"job {job.key!r} needs {missing[0]!r}, which does not come before it")
        seen.add(job.key)


def _pending(jobs: Sequence[Job], done: set[str]) -> list[Job]:
    """Kept jobs without a result and what they need, in the order given."""
    wanted: set[str] = set()
    for job in reversed(jobs):
        if (job.is_kept and job.key not in done) or job.key in wanted:
            wanted |= {job.key, *job.needs}
    return [job for job in jobs if job.key in wanted]


def _run_on_dask(jobs: Sequence[Job], engine: Engine, code: str, settle: Callable[..., None]) -> None:
    with ExitStack() as stack:
        client = _connect(engine, len(jobs), stack)
        n_workers = partial(_n_workers, client, engine)
        run = uuid.uuid4().hex[:8]  # a scheduler that serves several commands keeps their jobs apart
        futures: dict[str, Any] = {}

        def submit(some: Sequence[Job], attempt_number: int) -> Iterator[tuple[Job, Any]]:
            arrived: queue.SimpleQueue[tuple[Job, Any]] = queue.SimpleQueue()
            for job in some:
                futures[job.key] = client.submit(
                    attempt,
                    job.work,
                    job.parameters,
                    code,
                    *(futures[key] for key in job.needs),
                    key=f"mocap-{run}-{attempt_number}-{job.key}",
                    pure=False,
                )
            for job in some:
                futures[job.key].add_done_callback(lambda future, job=job: arrived.put((job, future)))
            yield from _arrivals(arrived, len(some), client, engine)

        killed: list[Job] = []
        for job, future in submit(jobs, 1):
            if _is_killed(future):
                killed.append(job)
            else:
                settle(job, _outcome_of(future, engine), n_workers)
        # A process that dies takes along what merely waited for it: each of them is tried once more, alone.
        for job in sorted(killed, key=jobs.index):
            for _, future in submit([job], 2):
                settle(job, _outcome_of(future, engine), n_workers)


def _arrivals(arrived: Any, n_left: int, client: Any, engine: Engine) -> Iterator[tuple[Job, Any]]:
    """Jobs as they end, while there is a scheduler, and workers before patience runs out."""
    alone_since = time.monotonic()
    while n_left:
        try:
            yield arrived.get(timeout=_TICK_S)
            n_left -= 1
        except queue.Empty:
            if client.status != "running":
                raise _scheduler_left(engine) from None
            if _n_workers(client, engine):
                alone_since = time.monotonic()
            elif time.monotonic() - alone_since > engine.patience_s:
                raise MocapError(
                    f"the scheduler {engine.scheduler or ''} has had no worker for {engine.patience_s:.0f} s",
                    remedy="start workers with `dask worker ADDRESS`, then run the same command again",
                ) from None


def _connect(engine: Engine, n_jobs: int, stack: ExitStack) -> Any:
    """A client of the given scheduler, or of a cluster on this machine that nobody else can reach: neither from another
    machine nor, without the keys in this process' memory, as another user of this one."""
    try:
        import dask
        from distributed import Client, LocalCluster, Security
        from distributed.system import MEMORY_LIMIT

        keys = Security.temporary() if engine.scheduler is None else None
    except ImportError as error:
        raise MissingExtra(
            "sweeps and batches need dask.distributed",
            "cluster",
            otherwise="use --workers 0 to run in this process, one cell at a time",
        ) from error
    # An earlier client that is collected in the thread of a new one waits there for the lock that the new one holds.
    gc.collect()
    # Connections that end while a cluster closes are no news for the user.
    for name in ("distributed", "distributed.comm", "distributed.client", "distributed.nanny"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if engine.scheduler is not None:
        try:
            client = Client(engine.scheduler, timeout=_CONNECT_S, set_as_default=False, name="mocap")
        except (OSError, ValueError, RuntimeError) as error:
            raise MocapError(
                f"no dask scheduler answers at {engine.scheduler}: {error}",
                remedy="start one with `dask scheduler`, and give its address as --scheduler tcp://HOST:8786",
            ) from error
        stack.callback(_close, client)
        return client
    n_workers = engine.n_workers or max(1, min(os.cpu_count() or 1, n_jobs))
    # Jobs of a dead worker are tried again by us, one at a time.
    stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": 0}))
    import tempfile

    scratch = stack.enter_context(tempfile.TemporaryDirectory(prefix="mocap-dask-"))
    cluster = stack.enter_context(
        LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            processes=True,
            protocol="tls",
            security=keys,
            host="127.0.0.1",
            # Without an address dask listens on all interfaces, even where no dashboard can be drawn.
            dashboard_address="127.0.0.1:0",
            local_directory=scratch,
            memory_limit=MEMORY_LIMIT // n_workers,
            silence_logs=logging.CRITICAL,
        )
    )
    return stack.enter_context(Client(cluster, set_as_default=False, name="mocap"))


def _close(client: Any) -> None:
    # A scheduler that does not answer is no reason to keep the user from reading why.
    with suppress(TimeoutError):
        client.close()


def _n_workers(client: Any, engine: Engine) -> int:
    try:
        about = client.sync(client.scheduler.identity, n_workers=0, callback_timeout=_ANSWER_S)
    except (OSError, AttributeError) as lost:  # the client lets go of a scheduler that has closed
        raise _scheduler_left(engine) from lost
    return int(about["n_workers"])


def _is_killed(future: Any) -> bool:
    return future.status == "error" and type(future.exception()).__name__ == "KilledWorker"


def _outcome_of(future: Any, engine: Engine) -> Outcome:
    if future.status == "finished":
        try:
            outcome: Outcome = future.result(timeout=_ANSWER_S)
        except (OSError, CancelledError) as lost:  # the job is done, but nobody is left to fetch it from
            raise _scheduler_left(engine) from lost
        return outcome
    if future.status == "error":
        error = future.exception()
        return Outcome(None, _DEAD_WORKER if _is_killed(future) else f"{type(error).__name__}: {error}")
    raise _scheduler_left(engine)


def _scheduler_left(engine: Engine) -> MocapError:
    return MocapError(
        f"the scheduler {engine.scheduler or 'of this machine'} went away",
        remedy="start it again and repeat the command; finished cells are kept",
    )
