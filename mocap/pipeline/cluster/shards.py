"""Shards: a sweep in parts that know nothing of each other, for job arrays, and the workflow files that run them.

OUT/shards/I-of-N/  a sweep of its own over every cell of shard I; joined, the results are those of one sweep
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from mocap.errors import MocapError
from mocap.io._files import writing
from mocap.pipeline.cluster.spec import SweepCell

# Of the largest cell so far: the next one may be larger.
_MEMORY_MARGIN = 1.25
_RETRIES = 2


def parse_shard(text: str) -> tuple[int, int]:
    """(i, n) of `i/n`, i from 1. Raises MocapError for anything else."""
    first, slash, last = text.partition("/")
    try:
        i, n = int(first), int(last)
    except ValueError:
        i, n, slash = 0, 0, ""
    if not slash or not 1 <= i <= n:
        raise MocapError(f"--shard is {text!r}", remedy="write --shard i/n, for example 3/8; i from 1 to n")
    return i, n


def cells_of_shard(cells: Sequence[SweepCell], i: int, n: int) -> list[SweepCell]:
    """The cells of shard i of n, i from 1: neighbours, which have most stages in common."""
    return list(cells[len(cells) * (i - 1) // n : len(cells) * i // n])


def folder_of_shard(out: Path, i: int, n: int) -> Path:
    """Where a shard works."""
    return out / "shards" / f"{i}-of-{n}"


def gather_shards(out: Path) -> int:
    """The results of all shards in `out` put where one sweep has them; how many there were.

    Raises MocapError when there is no shard.
    """
    found = sorted((out / "shards").glob("*-of-*"))
    if not found:
        raise MocapError(
            "there is no shard to join",
            path=out / "shards",
            remedy="run `mocap sweep SPEC -o OUT --shard i/n` first",
        )
    n = 0
    with writing(out):
        (out / "cells").mkdir(parents=True, exist_ok=True)
        for shard in found:
            for result in sorted((shard / "cells").glob("*.json")):
                partial = out / "cells" / f".{result.name}.partial"
                shutil.copyfile(result, partial)
                os.replace(partial, out / "cells" / result.name)
                n += 1
            for run in sorted((shard / "runs").glob("*")):
                if not (out / "runs" / run.name).exists():
                    # Its store links into the shard's stages, which stay.
                    (out / "runs").mkdir(exist_ok=True)
                    (out / "runs" / run.name).symlink_to(os.path.relpath(run, out / "runs"))
    return n


def measured_memory_mb(out: Path) -> float | None:
    """The largest peak memory of the cells that have been run in `out` or its shards, MB; None before the first."""
    peaks = []
    for path in [*out.glob("cells/*.json"), *out.glob("shards/*/cells/*.json")]:
        try:
            peak = json.loads(path.read_text(encoding="utf-8"))["result"]["peak_memory_mb"]
        except (OSError, ValueError, KeyError, TypeError):
            continue
        peaks += [float(peak)] if isinstance(peak, int | float) else []
    return max(peaks, default=None)


def memory_to_ask_mb(out: Path) -> int | None:
    """What a job of one cell at a time should ask for, MB, in hundreds: what was measured, and a margin."""
    peak = measured_memory_mb(out)
    return None if peak is None else -(-round(_MEMORY_MARGIN * peak) // 100) * 100


def workflow(
    kind: str, spec: Path, out: Path, n: int, *, options: Sequence[str] = (), n_threads: int = 1
) -> str:
    """The text of a workflow that runs n shards and joins them.  kind : one of WORKFLOWS.  options : of every shard.

    Paths are absolute: the workflow's own folder does not matter.
    """
    command = ["mocap", "sweep", str(spec.resolve()), "-o", str(out.resolve()), *options]
    return WORKFLOWS[kind].format(
        n=n,
        first=_ESCAPED[kind](shlex.join(command)),
        table=json.dumps(str(out.resolve() / "table.csv")),
        shards=str(out.resolve() / "shards"),
        threads=n_threads,
        retries=_RETRIES,
        memory=_memory_words(kind, memory_to_ask_mb(out)),
    )


def _memory_words(kind: str, memory_mb: int | None) -> str:
    if memory_mb is None:
        mark = "#" if kind == "snakemake" else "//"
        return f"{mark} memory: run a few cells first, then emit this file again; it asks for what they took"
    if kind == "snakemake":
        return f"resources:\n        mem_mb=lambda wildcards, attempt: {memory_mb} * attempt"
    return f"memory {{ {memory_mb}.MB * task.attempt }}"


_SNAKEMAKE = """\
# Made by `mocap sweep --emit snakemake`. Run it with `snakemake -s FILE --cores all`, or on a cluster.
# A shard that is stopped keeps its finished cells: --rerun-incomplete goes on from there.
rule join:
    input:
        expand("{shards}/{{shard}}-of-{n}.done", shard=range(1, {n} + 1))
    output:
        {table}
    shell:
        {first!r} " --join"


rule shard:
    output:
        touch("{shards}/{{shard}}-of-{n}.done")
    threads: {threads}
    retries: {retries}
    {memory}
    shell:
        {first!r} " --shard {{wildcards.shard}}/{n} --workers 0 --threads {{threads}}"
"""

_NEXTFLOW = """\
// Made by `mocap sweep --emit nextflow`. Run it with `nextflow run FILE -resume`.
process RUN_SHARD {{
    cpus {threads}
    errorStrategy 'retry'
    maxRetries {retries}
    {memory}

    input:
    val i

    output:
    val i

    script:
    \"\"\"
    {first} --shard ${{i}}/{n} --workers 0 --threads ${{task.cpus}}
    \"\"\"
}}

process JOIN_SHARDS {{
    input:
    val shards

    script:
    \"\"\"
    {first} --join
    \"\"\"
}}

workflow {{
    JOIN_SHARDS(RUN_SHARD(Channel.of(1..{n})).collect())
}}
"""
WORKFLOWS = {"snakemake": _SNAKEMAKE, "nextflow": _NEXTFLOW}
# Commands stand in texts in which a sign has a meaning of its own.
_ESCAPED: dict[str, Callable[[str], str]] = {
    "snakemake": lambda text: text.replace("{", "{{").replace("}", "}}"),  # no wildcard
    "nextflow": lambda text: text.replace("\\", "\\\\").replace("$", "\\$"),
}
