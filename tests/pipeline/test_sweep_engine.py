"""Jobs: each is run once, failures stay alone, and where and by how many they are run changes nothing."""

from __future__ import annotations

import fcntl
import gc
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import cluster_work
import pytest

import mocap
from mocap.errors import MocapError
from mocap.pipeline.cluster import Engine, Job, Outcome, Standing, engine, run_jobs
from mocap.pipeline.cluster.tables import Row, write_tables
from mocap.pipeline.reach import code_hash

ROOT = Path(mocap.__file__).resolve().parents[1]
HERE = Engine(n_workers=0)
# For processes of our own: they find this checkout and the tests' work.
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(Path(__file__).parent)])}


def jobs(n: int, kinds: dict[int, str] | None = None, **parameters: object) -> list[Job]:
    """Jobs 0 to n - 1 that square their numbers, but for those of another kind."""
    kinds = kinds or {}
    return [
        Job(f"job-{i}", cluster_work.work, {"number": i, "kind": kinds.get(i, "square"), **parameters})
        for i in range(n)
    ]


def run(some: list[Job], folder: Path, where: Engine = HERE, **more: object) -> dict[str, Outcome]:
    return run_jobs(some, folder, engine=where, code=code_hash(), **more)  # type: ignore[arg-type]


def tables(folder: Path, outcomes: dict[str, Outcome]) -> bytes:
    """The bytes of every table that must not depend on how the jobs were run."""
    rows = [
        Row(
            {"job": key},
            Outcome({"scores": outcome.result}, seconds=outcome.seconds) if outcome.result else outcome,
        )
        for key, outcome in sorted(outcomes.items())
    ]
    files = write_tables(folder, rows, groups=(), over=("job",))
    return b"".join(path.read_bytes() for path in files if path.name != "times.csv")


def test_a_job_is_run_once_and_a_failure_stays_alone(tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    some = jobs(5, {1: "mistake", 3: "bug"}, trace=str(trace))
    found = run(some, tmp_path / "cells")
    assert [found[f"job-{i}"].result for i in (0, 2, 4)] == [{"value": 0}, {"value": 4}, {"value": 16}]
    assert found["job-1"].error == "the camera is upside down (camera left). Remedy: turn it."
    assert found["job-1"].trace == ""
    assert found["job-3"].error == "ZeroDivisionError: by chance"
    assert "cluster_work.py" in found["job-3"].trace
    assert trace.read_text().split() == ["0", "1", "2", "3", "4"]
    standings: list[Standing] = []
    again = run(some, tmp_path / "cells", progress=standings.append)
    # What failed is tried again, what is done is not.
    assert trace.read_text().split()[5:] == ["1", "3"]
    assert {key: o.result for key, o in again.items()} == {key: o.result for key, o in found.items()}
    assert [(s.n_finished, s.n_failed, s.n_reused) for s in standings] == [(3, 0, 3), (4, 1, 3), (5, 2, 3)]


def test_a_damaged_result_is_made_again(tmp_path: Path) -> None:
    run(jobs(2), tmp_path)
    (tmp_path / "job-0.json").write_text('{"format": 1, "key": "job-0", "res')
    (tmp_path / "job-1.json").write_text(json.dumps({"format": 99, "key": "job-1"}))
    assert engine.read_outcome(tmp_path, "job-0") is None
    assert [o.result for o in run(jobs(2), tmp_path).values()] == [{"value": 0}, {"value": 1}]


def test_what_is_no_json_is_a_failure(tmp_path: Path) -> None:
    found = run(jobs(1, {0: "nan"}), tmp_path)
    assert found["job-0"].error.startswith("ValueError: Out of range float")


def test_what_a_job_needs_is_run_only_for_it(tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    shared = Job("shared", cluster_work.work, {"number": 9, "trace": str(trace)}, is_kept=False)
    broken = Job(
        "broken", cluster_work.work, {"number": 8, "trace": str(trace), "kind": "mistake"}, is_kept=False
    )
    cells = [
        Job(f"cell-{i}", cluster_work.work, {"number": i, "trace": str(trace)}, needs=(need,))
        for i, need in enumerate(["shared", "shared", "broken"])
    ]
    found = run([shared, broken, *cells], tmp_path / "cells")
    assert set(found) == {"cell-0", "cell-1", "cell-2"}
    assert "upside down" in found["cell-2"].error
    assert trace.read_text().split() == ["9", "8", "0", "1"]
    run([shared, *cells[:2]], tmp_path / "cells")
    assert trace.read_text().split() == ["9", "8", "0", "1"]  # nothing was left to do


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ([Job("a/b", cluster_work.work, {})], "letters, digits"),
        ([Job("a", cluster_work.work, {}), Job("a", cluster_work.work, {})], "two jobs have the key"),
        ([Job("a", cluster_work.work, {}, needs=("b",)), Job("b", cluster_work.work, {})], "needs 'b'"),
    ],
)
def test_wrong_lists_of_jobs(tmp_path: Path, wrong: list[Job], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        run(wrong, tmp_path)


def test_a_folder_in_use_is_refused(tmp_path: Path) -> None:
    with (tmp_path / ".lock").open("w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        with pytest.raises(MocapError, match="another command is working in this folder"):
            run(jobs(1), tmp_path)
    assert run(jobs(1), tmp_path)["job-0"].is_done


def test_other_code_is_refused(tmp_path: Path) -> None:
    found = run_jobs(jobs(1), tmp_path, engine=HERE, code="another")
    assert "another version of mocap" in found["job-0"].error


def test_time_left() -> None:
    standing = Standing(n_total=12, n_finished=6, n_failed=1, n_reused=2, n_workers=2, elapsed_s=20.0)
    assert standing.left_s == pytest.approx(30.0)
    assert Standing(12, 2, 0, 2, 2, 5.0).left_s is None


def test_a_cluster_of_this_machine_gives_the_same_and_listens_to_nobody_else(tmp_path: Path) -> None:
    psutil = pytest.importorskip("psutil")
    pytest.importorskip("distributed", reason="needs the extra cluster")
    some = jobs(6, {1: "mistake", 4: "death"})
    from distributed import Client, Security

    listening: set[str] = set()
    ports: set[int] = set()
    refused: list[int] = []
    processes: set[int] = set()

    def look(standing: Standing) -> None:
        for process in [psutil.Process(), *psutil.Process().children(recursive=True)]:
            processes.add(process.pid)
            with suppress(psutil.NoSuchProcess):  # the worker that died may be looked at in the middle of it
                found = [c.laddr for c in process.net_connections() if c.status == psutil.CONN_LISTEN]
                listening.update(place.ip for place in found)
                if process.pid == os.getpid():  # the scheduler's
                    ports.update(place.port for place in found)
        if standing.n_finished == 1:
            for port in ports:
                with pytest.raises(OSError) as refusal:
                    Client(f"tls://127.0.0.1:{port}", security=Security.temporary(), timeout=5)
                why = f"{type(refusal.value).__name__}: {refusal.value}"
                assert re.search("(?i)ssl|tls|timeout|timed out|closed", why), why
                refused.append(port)

    found = run(some, tmp_path / "dask", Engine(n_workers=2), progress=look)
    assert len(processes) > 2
    assert listening == {"127.0.0.1"}
    assert refused  # who has other keys, or none
    assert found["job-4"].error.startswith("the worker process died")
    alone = run(jobs(6, {1: "mistake", 4: "bug"}), tmp_path / "alone")
    for key in ("job-0", "job-1", "job-2", "job-3", "job-5"):
        assert (found[key].result, found[key].error) == (alone[key].result, alone[key].error)


def test_no_scheduler_at_the_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="needs the extra cluster")
    monkeypatch.setattr(engine, "_CONNECT_S", 0.5)
    for address in ("tcp://127.0.0.1:9", "nonsense://x"):
        with pytest.raises(MocapError, match="no dask scheduler answers at"):
            run(jobs(1), tmp_path, Engine(scheduler=address))


def test_a_client_that_failed_is_not_left_to_the_loop_of_the_next_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Collected there, it waits for a lock of the one who waits for the loop: the next command would hang."""
    pytest.importorskip("distributed", reason="needs the extra cluster")
    from distributed import utils

    monkeypatch.setattr(engine, "_CONNECT_S", 0.5)
    usual = utils.get_loop_factory
    monkeypatch.setattr(utils, "get_loop_factory", lambda: (gc.collect(), usual())[1])
    gc.disable()
    try:
        for address in ("nonsense://x", "tcp://127.0.0.1:9"):
            with pytest.raises(MocapError, match="no dask scheduler answers at"):
                run(jobs(1), tmp_path, Engine(scheduler=address))
    finally:
        gc.enable()


def test_without_dask_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MocapError, match=r'pip install "mocap-volumes\[cluster\]", or use --workers 0'):
        run(jobs(1), tmp_path, Engine(n_workers=1))


SCRIPT = """
import sys
from pathlib import Path
from test_sweep_engine import run, jobs, Engine, tables
if __name__ == "__main__":
    out = Path(sys.argv[1])
    found = run(jobs(8, {5: "mistake"}, sleep_s=0.3), out / "cells", Engine(n_workers=1))
    tables(out, found)
"""


def _start(script: Path, out: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, str(script), str(out)], env=ENVIRONMENT)


@pytest.mark.slow
def test_killed_and_resumed_gives_the_same_bytes(tmp_path: Path) -> None:
    psutil = pytest.importorskip("psutil")
    pytest.importorskip("distributed", reason="needs the extra cluster")
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    out, cells = tmp_path / "out", tmp_path / "out" / "cells"
    process = _start(script, out)
    try:
        _wait(lambda: len(list(cells.glob("job-*.json"))) >= 2)
        children = psutil.Process(process.pid).children(recursive=True)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    done = len(list(cells.glob("job-*.json")))
    assert 2 <= done < 8
    assert not (out / "table.csv").exists()
    assert len(children) >= 1
    _wait(lambda: not any(child.is_running() and child.status() != "zombie" for child in children))
    before = {
        path: path.stat().st_mtime_ns
        for path in cells.glob("job-*.json")
        if "mistake" not in path.read_text()
    }
    resumed = tables(out, run(jobs(8, {5: "mistake"}, sleep_s=0.0), cells))
    whole = tables(tmp_path / "whole", run(jobs(8, {5: "mistake"}), tmp_path / "whole" / "cells"))
    assert resumed == whole
    kept = [path for path, at in before.items() if path.stat().st_mtime_ns == at]
    assert len(kept) >= done - 1  # all but perhaps the failed one


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """The address and process of a `dask scheduler` on this machine, without workers."""
    pytest.importorskip("distributed", reason="needs the extra cluster")
    about = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    process = subprocess.Popen(
        [
            *dask,
            "scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--no-dashboard",
            "--scheduler-file",
            str(about),
        ],
        env=ENVIRONMENT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        _wait(lambda: about.exists() and about.stat().st_size > 0)
        yield json.loads(about.read_text())["address"], process
    finally:
        process.terminate()
        process.wait()


def dask_worker(address: str, folder: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "dask", "worker", address]
    return subprocess.Popen(
        [*command, "--host", "127.0.0.1", "--nthreads", "1", "--no-dashboard"],
        env=ENVIRONMENT,
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def test_a_scheduler_and_a_worker_of_the_user(
    tmp_path: Path, scheduler: tuple[str, subprocess.Popen[bytes]]
) -> None:
    address, process = scheduler
    there = Engine(scheduler=address)
    with pytest.raises(MocapError, match="has had no worker for 0 s"):
        run(jobs(1), tmp_path / "cells", Engine(scheduler=address, patience_s=0.0))
    worker = dask_worker(address, tmp_path)
    try:
        found = run(jobs(3, {1: "bug"}), tmp_path / "cells", there)
        # The scheduler serves the next command as well, until it goes away.
        more = run(jobs(4, {1: "bug"}), tmp_path / "cells", there)

        def kill(standing: Standing) -> None:
            if standing.n_finished == 2:
                process.kill()

        with pytest.raises(MocapError, match="went away"):
            run(jobs(9, sleep_s=0.1), tmp_path / "lost", there, progress=kill)
    finally:
        worker.terminate()
        worker.wait()
    assert [o.result for o in found.values()] == [{"value": 0}, None, {"value": 4}]
    assert more["job-3"].result == {"value": 9}
    assert more["job-1"].error == "ZeroDivisionError: by chance"
    assert 2 <= len(list((tmp_path / "lost").glob("*.json"))) < 9


def test_a_scheduler_that_falls_silent_is_not_waited_for_for_ever(
    tmp_path: Path, scheduler: tuple[str, subprocess.Popen[bytes]], monkeypatch: pytest.MonkeyPatch
) -> None:
    address, process = scheduler
    worker = dask_worker(address, tmp_path)

    def fall_silent(standing: Standing) -> None:
        if standing.n_finished == 2:
            # Not before: a busy machine may need a second for an answer.
            monkeypatch.setattr(engine, "_ANSWER_S", 1.0)
            monkeypatch.setattr(engine, "_CONNECT_S", 2.0)
            process.send_signal(signal.SIGSTOP)

    try:
        with pytest.raises(MocapError, match="went away"):
            run(jobs(9, sleep_s=0.1), tmp_path / "lost", Engine(scheduler=address), progress=fall_silent)
    finally:
        process.kill()
        worker.kill()
        worker.wait()
    assert 2 <= len(list((tmp_path / "lost").glob("*.json"))) < 9


def _wait(condition: object, limit_s: float = 60.0) -> None:
    end = time.monotonic() + limit_s
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < end
        time.sleep(0.05)
