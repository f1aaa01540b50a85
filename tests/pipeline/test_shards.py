"""Shards of a sweep: parts that know nothing of each other, and joined give the tables of one sweep."""

from __future__ import annotations

import importlib.util
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from small_session import copy_session, mocap, small_session
from test_sweep_cells import HERE, N_FRAMES, write_spec

from mocap.errors import MocapError
from mocap.pipeline.cluster import join_shards, plan_cells, read_sweep_spec, run_sweep
from mocap.pipeline.cluster import sweep as sweeps
from mocap.pipeline.cluster.shards import WORKFLOWS, cells_of_shard, memory_to_ask_mb, parse_shard, workflow

TABLES = ("table.csv", "table.json", "summary.csv", "table.html")


@pytest.fixture
def folder(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a sweep of four cells on one session of masks."""
    whole = small_session(tmp_path_factory.getbasetemp())
    copy_session(whole, tmp_path / "sessions" / "walk", masks=True, n_frames=N_FRAMES)
    write_spec(tmp_path, "5, 8")
    return tmp_path


def test_every_cell_is_in_one_shard(folder: Path) -> None:
    cells = plan_cells(read_sweep_spec(folder / "sweep.toml"))
    assert len(cells) == 4
    for n in (1, 2, 3, 4, 7):
        shards = [cells_of_shard(cells, i, n) for i in range(1, n + 1)]
        assert [cell for shard in shards for cell in shard] == cells
        assert max(map(len, shards)) - min(map(len, shards)) <= 1


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "a/b", "1/0", "-1/3", "1/2/3"])
def test_what_is_no_shard_is_said_with_the_option(text: str) -> None:
    with pytest.raises(MocapError, match=r"--shard is .* write --shard i/n"):
        parse_shard(text)


def test_joined_shards_have_the_tables_of_one_sweep(folder: Path) -> None:
    path, parts, whole = folder / "sweep.toml", folder / "parts", folder / "whole"
    for i in (3, 1):
        said = mocap("sweep", path, "-o", parts, "--shard", f"{i}/3", "--workers", 0)
        assert said.code == 0, said.err
    said = mocap("sweep", path, "-o", parts, "--join")
    assert said.code == 2
    assert "1 of 4 cells have not been run by any shard: 1" in said.err
    assert not (parts / "table.csv").exists()
    assert mocap("sweep", path, "-o", parts, "--shard", "2/3", "--workers", 0).code == 0
    assert mocap("sweep", path, "-o", parts, "--join").code == 0
    run_sweep(read_sweep_spec(path), whole, engine=HERE)
    for name in TABLES:
        assert (parts / name).read_bytes() == (whole / name).read_bytes(), name
    assert memory_to_ask_mb(parts) is not None


def test_a_shard_without_cells_is_done(folder: Path) -> None:
    path = write_spec(folder, "5")
    said = mocap("sweep", path, "-o", folder / "parts", "--shard", "1/9", "--workers", 0)
    assert said.code == 0, said.err
    assert said.out.startswith("0 cells into")


def test_cells_that_fail_are_tried_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec, calls = read_sweep_spec(folder / "sweep.toml"), []
    work = sweeps.run_cell

    def flaky(parameters: dict[str, Any]) -> dict[str, Any]:
        calls.append(parameters["key"])
        if calls.count(parameters["key"]) == 1:
            raise MemoryError("once")
        return work(parameters)

    monkeypatch.setattr(sweeps, "run_cell", flaky)
    cells = plan_cells(spec)[:2]
    assert run_sweep(spec, folder / "out", engine=HERE, cells=cells, retries=1).n_failed == 0
    assert len(calls) == 4
    assert calls[:2] == calls[2:], "after all others"


@pytest.mark.parametrize("kind", WORKFLOWS)
def test_the_commands_of_a_workflow_run_the_sweep(folder: Path, kind: str) -> None:
    path, out = write_spec(folder, "5"), folder / "a folder"
    said = mocap("sweep", path, "-o", out, "--emit", kind, "--shards", 2)
    assert said.code == 0, said.err
    assert "run a few cells first" in said.out
    commands = [
        shlex.split(
            re.sub(r"\$?\{+(wildcards\.shard|i)\}+", "@", line)
            .replace("{threads}", "1")
            .replace("${task.cpus}", "1")
        )
        for line in re.findall(r"mocap sweep [^\n]*", _plain(said.out))
    ]
    shard = next(words for words in commands if "--shard" in words)
    join = next(words for words in commands if "--join" in words)
    for i in ("1", "2"):
        assert mocap(*[word.replace("@", i) for word in shard[1:]]).code == 0
    assert mocap(*join[1:]).code == 0
    assert len((out / "table.csv").read_text().splitlines()) == 3
    memory = memory_to_ask_mb(out)
    assert memory is not None
    assert str(memory) in workflow(kind, path, out, 2)


def test_a_nextflow_file_is_whole() -> None:
    """No Java here: brackets and strings are closed, processes have what they need, and the workflow calls them."""
    text = workflow("nextflow", Path("sweep.toml"), Path("a $folder"), 3, options=("--keep",))
    script, blocks = 3 * '"', re.sub(r"//[^\n]*", "", text).split(3 * '"')
    assert script in text
    assert len(blocks) % 2 == 1, "every script is closed"
    depth = 0
    for sign in re.findall(r"[{}()]", "".join(blocks[::2])):
        depth += 1 if sign in "{(" else -1
        assert depth >= 0
    assert depth == 0
    processes = re.findall(r"^process (\w+) \{$", text, re.M)
    assert len(processes) == 2
    called = text.split("workflow {")[1]
    assert all(re.search(rf"\b{name}\(", called) for name in processes)
    for own in text.split("\nprocess ")[1:]:
        assert re.search(r"input:\n\s+val (\w+)", own)
        assert "script:" in own
    # A dollar of a path is none of Groovy's; what is left are the two values that it fills in.
    assert re.findall(r"(?<!\\)\$\{([^}]*)\}", text) == ["i", "task.cpus"]
    assert "\\$folder" in text


@pytest.mark.slow
def test_snakemake_plans_the_shards_and_their_join(tmp_path: Path) -> None:
    """Snakemake's own dry run: it has passed with version 9.27."""
    if importlib.util.find_spec("snakemake") is None:
        pytest.skip("snakemake is not installed")
    file = tmp_path / "Snakefile"
    file.write_text(workflow("snakemake", tmp_path / "sweep.toml", tmp_path / "an out", 2))
    said = subprocess.run(
        [sys.executable, "-m", "snakemake", "-s", str(file), "-n", "-p"],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    told = said.stdout + said.stderr
    for words in ("--shard 1/2", "--shard 2/2", "--join"):
        assert f"-o '{tmp_path / 'an out'}' {words}" in told


def _plain(text: str) -> str:
    """A workflow with its string literals joined, as its own language would."""
    return re.sub(r'"([^"\n]*)" "([^"\n]*)"', r"\1\2", text)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--shard", "1/2", "--join"], "--shard and --join were both given"),
        (["--shards", 3], "--shards is for --emit"),
        (["--emit", "snakemak"], "did you mean 'snakemake'?"),
        (["--join"], "there is no shard to join"),
    ],
)
def test_ways_that_do_not_fit(folder: Path, words: list[object], told: str) -> None:
    said = mocap("sweep", folder / "sweep.toml", "-o", folder / "out", *words)
    assert said.code == 2
    assert told in said.err
    with pytest.raises(MocapError, match="no shard to join"):
        join_shards(read_sweep_spec(folder / "sweep.toml"), folder / "out", cells=[])
