"""Sweeps of real runs: the scores of `mocap run`, shared stages made once, results found again by content."""

from __future__ import annotations

import csv
import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from small_session import copy_session, mocap, small_session

from mocap.pipeline.cluster import Engine, plan_cells, read_sweep_spec, run_sweep
from mocap.pipeline.cluster.sweep import plan_jobs
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session

HERE = Engine(n_workers=0)
N_FRAMES = 2
SPEC = """
sessions = ["sessions/*"]
seeds = [{seeds}]
[set]
"volume.voxel_size_m" = 0.05
"pose.n_layers" = 1
"pose.n_start_frames" = 1
"pose.n_first_poses" = 1
[grid]
"pose.n_particles" = [40, 60]
"""


@pytest.fixture
def folder(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with sweep.toml and one session of masks."""
    whole = small_session(tmp_path_factory.getbasetemp())
    copy_session(whole, tmp_path / "sessions" / "walk", masks=True, n_frames=N_FRAMES)
    write_spec(tmp_path, "5")
    return tmp_path


def write_spec(folder: Path, seeds: str, more: str = "") -> Path:
    path = folder / "sweep.toml"
    path.write_text(more + SPEC.format(seeds=seeds))
    return path


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_scores_are_those_of_a_run_and_stages_are_shared(folder: Path) -> None:
    spec = read_sweep_spec(folder / "sweep.toml")
    out = folder / "out"
    result = run_sweep(spec, out, engine=HERE)
    assert result.n_failed == 0
    cells = plan_cells(spec)
    alone = run_session(
        folder / "sessions" / "walk",
        folder / "alone",
        config=load_config("default", cells[1].settings),
        seed=5,
        until="pose",
    )
    # By way of JSON, as the cell's result went.
    assert result.rows[1].scores == json.loads(json.dumps(alone.scores))
    assert result.rows[0].scores != result.rows[1].scores
    stages = sorted(p.name.split("-")[0] for p in (out / "stages").iterdir())
    assert stages == ["carve", "occluders", "segment", "track"]
    assert [r["pose.n_particles"] for r in rows(out / "table.csv")] == ["40", "60"]
    assert not list((out / "runs").iterdir())

    # The session may move, and the spec may grow: what is done stays done.
    before = {p.name: p.stat().st_mtime_ns for p in (out / "cells").glob("cell-*.json")}
    table = rows(out / "table.csv")
    shutil.move(folder / "sessions", folder / "moved")
    path = write_spec(folder, "5", "sample = 2\n")
    path.write_text(path.read_text().replace("sessions/*", "moved/walk"))
    run_sweep(read_sweep_spec(path), out, engine=HERE)
    assert {p.name: p.stat().st_mtime_ns for p in (out / "cells").glob("cell-*.json")} == before
    assert rows(out / "table.csv") == table

    # Another truth is another result, of the same stages.
    truth = folder / "moved" / "walk" / "truth" / "landmarks.csv"
    lines = truth.read_text().splitlines(keepends=True)
    truth.write_text("".join(lines[:-1]))
    cells_one = plan_cells(read_sweep_spec(path))[:1]
    run_sweep(read_sweep_spec(path), out, engine=HERE, cells=cells_one)
    assert len(list((out / "cells").glob("cell-*.json"))) == len(before) + 1
    assert len(list((out / "stages").iterdir())) == len(stages)


def test_a_broken_session_is_a_row_and_an_exit_code(folder: Path) -> None:
    broken = folder / "sessions" / "broken"
    shutil.copytree(folder / "sessions" / "walk", broken)
    (broken / "calibration.toml").write_text("cameras = 3\n")
    path = write_spec(folder, "5")
    path.write_text(path.read_text().replace("[40, 60]", "[40]"))
    said = mocap("sweep", path, "-o", folder / "out", "--workers", 0, "--keep")
    assert said.code == 1
    assert "failed: cell 0, session broken" in said.out
    assert "Traceback" not in said.out + said.err
    first, second = rows(folder / "out" / "table.csv")
    assert (first["status"], second["status"]) == ("failed", "done")
    assert "calibration" in first["error"]
    assert float(second["mean_error_mm"]) > 0
    (kept,) = (folder / "out" / "runs").iterdir()
    assert (kept / "landmarks.csv").is_file()
    page = (folder / "out" / "table.html").read_text()
    assert '<tr class="failed">' in page


def test_a_setting_that_does_not_exist_stops_the_sweep_before_it_begins(folder: Path) -> None:
    path = folder / "sweep.toml"
    path.write_text(path.read_text().replace("pose.n_particles", "pose.n_partikel"))
    for more in (("--plan",), ("-o", folder / "out", "--workers", 0)):
        said = mocap("sweep", path, *more)
        assert said.code == 2
        assert "pose.n_partikel: unknown key" in said.err
    assert not (folder / "out").exists()


@pytest.mark.parametrize(("tracker", "n_tracks"), [("naive", 1), ("particle", 2)])
def test_cells_share_what_does_not_depend_on_their_seed(folder: Path, tracker: str, n_tracks: int) -> None:
    path = write_spec(folder, "5, 8")
    path.write_text(path.read_text().replace("[set]", f'[set]\n"tracking.tracker" = "{tracker}"'))
    spec = read_sweep_spec(path)
    planned = plan_jobs(spec, plan_cells(spec), folder / "out", n_threads=1, keep_runs=False)
    chains = [chain for _, chain in planned if isinstance(chain, list)]
    assert len(chains) == 4
    stages = ("segment", "occluders", "carve", "track", "cell")
    keys = {stage: {c[i].key for c in chains} for i, stage in enumerate(stages)}
    assert [len(keys[stage]) for stage in keys] == [1, 1, 1, n_tracks, 4]
    # The product is made with the settings and the seed that its key stands for.
    seeds = {c[3].key: set() for c in chains}  # type: ignore[var-annotated]
    for chain in chains:
        seeds[chain[3].key].add(chain[3].parameters["seed"])
    assert all(len(found) == 2 // n_tracks for found in seeds.values())


def test_plan_prints_the_cells_and_runs_nothing(folder: Path) -> None:
    said = mocap("sweep", write_spec(folder, "5, 8"), "--plan", "--sample", 3)
    assert said.code == 0
    assert "3 cells; nothing was run" in said.out
    assert len(said.out.splitlines()) == 5
    assert sorted(p.name for p in folder.iterdir()) == ["sessions", "sweep.toml"]


def test_commands_that_do_not_fit(folder: Path) -> None:
    path = folder / "sweep.toml"
    assert "no folder for the results" in mocap("sweep", path).err
    both = mocap("sweep", path, "-o", folder / "out", "--workers", 1, "--scheduler", "tcp://127.0.0.1:9")
    assert both.code == 2
    assert "--workers and --scheduler were both given" in both.err


@pytest.mark.slow
def test_two_cells_on_a_scheduler_of_the_user_give_the_same_bytes(folder: Path) -> None:
    """`dask scheduler` and `dask worker` on this machine, two cells of a real session, against this process."""
    pytest.importorskip("distributed", reason="needs the extra cluster")
    from test_sweep_engine import ENVIRONMENT, _wait

    path = folder / "sweep.toml"
    about = folder / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    quiet = {"env": ENVIRONMENT, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    where = ("--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(about))
    scheduler = subprocess.Popen([*dask, "scheduler", "--port", "0", *where], **quiet)  # type: ignore[call-overload]
    try:
        _wait(lambda: about.exists() and about.stat().st_size > 0)
        worker = subprocess.Popen([*dask, "worker", "--nthreads", "1", *where], **quiet)  # type: ignore[call-overload]
        try:
            address = json.loads(about.read_text())["address"]
            said = mocap("sweep", path, "-o", folder / "there", "--scheduler", address)
        finally:
            worker.terminate()
            worker.wait()
    finally:
        scheduler.terminate()
        scheduler.wait()
    assert said.code == 0, said.err
    assert mocap("sweep", path, "-o", folder / "here", "--workers", 0).code == 0
    for name in ("table.csv", "table.json", "summary.csv", "table.html"):
        assert (folder / "there" / name).read_bytes() == (folder / "here" / name).read_bytes()


@pytest.mark.slow
def test_a_killed_sweep_is_continued_to_the_same_bytes(folder: Path) -> None:
    """kill -9 of the command in the middle of its cells; four cells of a real session on two workers."""
    pytest.importorskip("distributed", reason="needs the extra cluster")
    from test_sweep_engine import ENVIRONMENT, _wait

    path, out = write_spec(folder, "5, 8"), folder / "killed"
    command = [sys.executable, "-m", "mocap", "sweep", str(path), "-o", str(out), "--workers", "2"]
    process = subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        _wait(lambda: len(list((out / "cells").glob("cell-*.json"))) >= 1)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    n_done = len(list((out / "cells").glob("cell-*.json")))
    assert 1 <= n_done < 4
    assert mocap("sweep", path, "-o", out, "--workers", 2).code == 0
    assert mocap("sweep", path, "-o", folder / "whole", "--workers", 0).code == 0
    for name in ("table.csv", "table.json", "summary.csv", "table.html"):
        assert (out / name).read_bytes() == (folder / "whole" / name).read_bytes()
    assert not list((out / "runs").iterdir())
