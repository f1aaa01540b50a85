"""Sweeps: every cell of a spec is a run and its scores; products that cells have in common are made once.

OUT/stages/STAGE-KEY/  products of the stages before the pose, shared by the cells whose key they have
OUT/cells/KEY.json     what a cell gave; the key is the pose stage's and the truth's, so that results are found again
                       whatever the session's place, the spec's order or the number of workers
OUT/runs/KEY/          the output of a cell while it runs, and afterwards if asked for
"""

from __future__ import annotations

import hashlib
import math
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mocap.errors import MocapError
from mocap.io._files import writing
from mocap.io.session import Session, open_session
from mocap.io.store import StageStore
from mocap.pipeline.chains import CHAINS, observation_kind
from mocap.pipeline.cluster.engine import Engine, Job, Outcome, Progress, read_outcome, run_jobs
from mocap.pipeline.cluster.shards import gather_shards
from mocap.pipeline.cluster.spec import SweepCell, SweepSpec, plan_cells, session_names
from mocap.pipeline.cluster.tables import Row, write_tables
from mocap.pipeline.config import Config, config_hash, load_config
from mocap.pipeline.keys import stage_keys
from mocap.pipeline.outside import check_outside
from mocap.pipeline.reach import code_hash
from mocap.pipeline.run import run_session

_TRUTH_FILES = ("landmarks.csv", "tracks.csv", "voxels.npz")


@dataclass(frozen=True)
class SweepResult:
    """rows : one per cell, in the order of the spec.  files : the tables that were written."""

    rows: tuple[Row, ...]
    files: tuple[Path, ...]

    @property
    def n_failed(self) -> int:
        return sum(not row.outcome.is_done for row in self.rows)


@dataclass
class _Sessions:
    """Sessions opened once, however many cells they have."""

    frames: tuple[int | None, int | None] | None
    _opened: dict[Path, Session | MocapError] = field(default_factory=dict)
    _truth: dict[Path, str] = field(default_factory=dict)
    _keys: dict[tuple[Path, str, int], tuple[str, dict[str, str]]] = field(default_factory=dict)

    def keys(self, path: Path, config: Config, seed: int) -> tuple[str, dict[str, str]]:
        """Kind of observation and stage keys, that of `score` last. Raises the session's MocapError."""
        if path not in self._opened:
            try:
                session = open_session(path, frames=self.frames)
                self._opened[path], self._truth[path] = session, truth_hash(session)
            except MocapError as error:
                self._opened[path] = error
        session_or_error = self._opened[path]
        if isinstance(session_or_error, MocapError):
            raise session_or_error
        about = (path, config_hash(config), seed)
        if about not in self._keys:
            kind = observation_kind(session_or_error, config)
            keys = stage_keys(session_or_error, config, seed, kind)
            keys["score"] = config_hash(keys["pose"], self._truth[path])
            self._keys[about] = (kind, keys)
        return self._keys[about]


def run_sweep(
    spec: SweepSpec,
    out: Path,
    *,
    engine: Engine,
    cells: Sequence[SweepCell] | None = None,
    n_threads: int = 1,
    keep_runs: bool = False,
    retries: int = 0,
    progress: Progress | None = None,
) -> SweepResult:
    """Run the cells of a spec that have no result in `out` yet, and write the tables of all.

    cells : from `plan_cells`, None = all of the spec.  n_threads : of each cell.  keep_runs : keep the tables and the
    store of every cell in OUT/runs/KEY; else only its scores are kept.
    retries : how often cells that fail are tried again, each time after all others.
    A cell that fails is a row with its error. Raises MocapError for settings that no cell could have, before
    anything is run, and as `run_jobs` does.
    """
    check_outside(out, *spec.sessions)
    cells = plan_cells(spec) if cells is None else cells
    planned = list(plan_jobs(spec, cells, out, n_threads=n_threads, keep_runs=keep_runs))
    jobs: dict[str, Job] = {}
    for _, chain in planned:
        if isinstance(chain, list):
            jobs.update({job.key: job for job in chain})
    _forget_lost_runs(jobs, out)
    for _ in range(1 + retries):
        outcomes = run_jobs(
            list(jobs.values()), out / "cells", engine=engine, code=code_hash(), progress=progress
        )
        if all(outcome.is_done for outcome in outcomes.values()):
            break
    return _tables(spec, out, planned, outcomes)


def _tables(
    spec: SweepSpec,
    out: Path,
    planned: Sequence[tuple[SweepCell, list[Job] | Outcome]],
    outcomes: Mapping[str, Outcome],
) -> SweepResult:
    """The tables of some cells.  outcomes : by key of their last jobs."""
    files_of_presets = sorted({Path(cell.preset) for cell, _ in planned if "/" in cell.preset})
    preset_names = dict(zip(map(str, files_of_presets), session_names(files_of_presets), strict=True))
    rows = [
        Row(_columns(cell, preset_names), chain if isinstance(chain, Outcome) else outcomes[chain[-1].key])
        for cell, chain in planned
    ]
    files = write_tables(
        out, rows, groups=("preset", *spec.varied), over=("session", "seed"), scores=spec.scores
    )
    return SweepResult(tuple(rows), tuple(files))


def join_shards(
    spec: SweepSpec, out: Path, *, cells: Sequence[SweepCell], keep_runs: bool = False
) -> SweepResult:
    """The results of all shards in one place, and the tables of the whole sweep; nothing is run.

    Raises MocapError when cells have not been run by any shard.
    """
    gather_shards(out)
    planned = list(plan_jobs(spec, cells, out, n_threads=1, keep_runs=keep_runs))
    keys = {cell.index: chain[-1].key for cell, chain in planned if not isinstance(chain, Outcome)}
    found = {key: read_outcome(out / "cells", key) for key in keys.values()}
    missing = [index for index, key in keys.items() if found[key] is None]
    if missing:
        names = ", ".join(map(str, missing[:10])) + (" ..." if len(missing) > 10 else "")
        raise MocapError(
            f"{len(missing)} of {len(cells)} cells have not been run by any shard: {names}",
            path=out / "shards",
            remedy="run the shards that are missing or were stopped, with the same options, and join again",
        )
    return _tables(
        spec, out, planned, {key: outcome for key, outcome in found.items() if outcome is not None}
    )


def plan_jobs(
    spec: SweepSpec, cells: Sequence[SweepCell], out: Path, *, n_threads: int, keep_runs: bool
) -> Iterator[tuple[SweepCell, list[Job] | Outcome]]:
    """Every cell with its chain of jobs, stages first, or with its failure when its session cannot be opened."""
    sessions = _Sessions(spec.frames)
    for cell in cells:
        config = load_config(cell.preset, cell.settings)
        try:
            kind, keys = sessions.keys(cell.session, config, cell.seed)
        except MocapError as error:
            yield cell, Outcome(None, str(error))
            continue
        common = {
            "session": str(cell.session),
            "preset": cell.preset,
            "settings": list(cell.settings),
            "seed": cell.seed,
            "frames": list(spec.frames) if spec.frames else None,
            "n_threads": n_threads,
            "out": str(out.resolve()),
        }
        chain: list[Job] = []
        products: list[list[str]] = []
        for stage in CHAINS[kind][:-1]:  # what is before the pose may be shared
            products.append([stage.name, keys[stage.name]])
            chain.append(
                Job(
                    f"{stage.name}-{keys[stage.name]}",
                    make_product,
                    {**common, "products": list(products), "until": stage.until},
                    needs=tuple(job.key for job in chain[-1:]),
                    is_kept=False,
                )
            )
        key = f"cell-{config_hash(keys['score'], keep_runs)}"
        parameters = {**common, "products": products, "key": key, "keep": keep_runs}
        chain.append(Job(key, run_cell, parameters, needs=(chain[-1].key,)))
        yield cell, chain


def make_product(parameters: dict[str, Any]) -> dict[str, Any]:
    """The last of `products`, out of those before it; at once when it is there."""
    *before, (stage, key) = parameters["products"]
    out = Path(parameters["out"])
    folder = out / "stages" / f"{stage}-{key}"
    if not StageStore(folder / "store.zarr").is_complete(stage, key):
        _link_products(out, folder, before)
        _run(parameters, folder, until=parameters["until"])
    return {}


def run_cell(parameters: dict[str, Any]) -> dict[str, Any]:
    """Poses and scores of a cell out of shared stage products."""
    out = Path(parameters["out"])
    folder = out / "runs" / parameters["key"]
    shutil.rmtree(folder, ignore_errors=True)  # of a worker that was killed
    _link_products(out, folder, parameters["products"])
    try:
        result = _run(parameters, folder, until="pose")
    finally:
        if not parameters["keep"]:
            shutil.rmtree(folder, ignore_errors=True)
    return {**result, "run": f"runs/{folder.name}" if parameters["keep"] else None}


def _forget_lost_runs(jobs: Mapping[str, Job], out: Path) -> None:
    """A result whose run was to be kept, and was removed by somebody, has to be made again."""
    for key, job in jobs.items():
        if job.parameters.get("keep") and not (out / "runs" / key / "run.json").is_file():
            (out / "cells" / f"{key}.json").unlink(missing_ok=True)


def _run(parameters: dict[str, Any], folder: Path, *, until: str) -> dict[str, Any]:
    frames = parameters["frames"]
    result = run_session(
        parameters["session"],
        folder,
        config=load_config(parameters["preset"], tuple(parameters["settings"])),
        seed=parameters["seed"],
        until=until,
        resume=True,
        frames=None if frames is None else (frames[0], frames[1]),
        n_threads=parameters["n_threads"],
        command="mocap sweep",
    )
    return summary_of(result)


def summary_of(result: Any) -> dict[str, Any]:
    """What a table says of a run, plain JSON."""
    return {
        "n_frames": len(result.session.frames),
        "n_persons": len(result.poses),
        "n_warnings": len(result.warnings),
        "scores": plain(result.scores or {}),
        "peak_memory_mb": result.record.peak_memory_mb,
        "timings_s": {stage: round(seconds, 3) for stage, seconds in result.timings_s.items()},
    }


def plain(value: Any) -> Any:
    """Plain JSON of nested values; what is not finite becomes None."""
    import numpy as np

    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def _link_products(out: Path, folder: Path, products: Sequence[Sequence[str]]) -> None:
    """Shared products as links in a folder's own store, relative, so that OUT may be moved.

    A stage may have written more than one product; whatever is no link in its store is its own.
    """
    store = folder / "store.zarr"
    with writing(folder):
        store.mkdir(parents=True, exist_ok=True)
        for stage, key in products:
            shared = out / "stages" / f"{stage}-{key}" / "store.zarr"
            for target in sorted(shared.iterdir()):
                if target.is_symlink() or not target.is_dir() or target.name.startswith("."):
                    continue
                link = store / target.name
                if link.is_symlink():
                    link.unlink()
                link.symlink_to(os.path.relpath(target, store), target_is_directory=True)


def truth_hash(session: Session) -> str:
    """Hash of the files that a run is scored against."""
    digest = hashlib.sha256()
    for name in _TRUTH_FILES:
        path = session.truth_dir / name if session.truth_dir is not None else None
        if path is not None and path.is_file():
            digest.update(f"{name} {path.stat().st_size} ".encode())
            with path.open("rb") as stream:
                digest.update(hashlib.file_digest(stream, "sha256").digest())
    return digest.hexdigest()[:16]


def _columns(cell: SweepCell, preset_names: Mapping[str, str]) -> dict[str, Any]:
    return {
        "cell": cell.index,
        "session": cell.session_name,
        "preset": preset_names.get(cell.preset, cell.preset).removesuffix(".toml"),
        "seed": cell.seed,
        **cell.varied,
    }
