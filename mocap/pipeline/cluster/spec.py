"""Sweep files: TOML with sessions, presets, settings and seeds, and the cells that they stand for."""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mocap.errors import MocapError
from mocap.files import load_toml
from mocap.pipeline.config import presets

MAX_CELLS = 100_000

_KEYS = ("sessions", "presets", "seeds", "frames", "scores", "sample", "sample_seed", "set", "grid", "zip")


@dataclass(frozen=True)
class SweepSpec:
    """A sweep.  settings : dotted key -> value of all cells.  grid : dotted key -> values, all combinations.
    zipped : groups of dotted keys whose values change together.  frames : (start, stop).  scores : columns of the
    table, empty = all.  sample : so many cells by chance, None = all."""

    sessions: tuple[Path, ...]
    presets: tuple[str, ...] = ("default",)
    seeds: tuple[int, ...] = (0,)
    settings: Mapping[str, Any] = field(default_factory=dict)
    grid: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    zipped: tuple[Mapping[str, tuple[Any, ...]], ...] = ()
    frames: tuple[int | None, int | None] | None = None
    scores: tuple[str, ...] = ()
    sample: int | None = None
    sample_seed: int = 0

    @property
    def varied(self) -> tuple[str, ...]:
        """Dotted keys that differ between cells, in the order of the file."""
        return (*self.grid, *(key for group in self.zipped for key in group))


@dataclass(frozen=True)
class SweepCell:
    """One run.  index : its place among all cells of the spec, sampled or not.  session_name : unique in the sweep.
    varied : the settings that only some cells have.  settings : all of them, as `--set` takes them."""

    index: int
    session: Path
    session_name: str
    preset: str
    seed: int
    varied: Mapping[str, Any]
    settings: tuple[str, ...]


def read_sweep_spec(path: Path | str) -> SweepSpec:
    """Read and check a sweep's TOML file; sessions and preset files are relative to it, `*` stands for any name.

    Keys: sessions = [...] (needed), presets, seeds, frames = "a:b", scores, sample, sample_seed, and the tables [set],
    [grid] and [zip] (or several [[zip]]) of dotted settings.
    Raises MocapError naming the key for anything that is not understood, and for sessions that do not exist.
    """
    path = Path(path)
    document = _document(path)
    spec = SweepSpec(
        sessions=tuple(_sessions(path, _words(path, document, "sessions", needed=True))),
        presets=tuple(_preset(path, name) for name in _words(path, document, "presets", default=["default"])),
        seeds=_seeds(path, document),
        settings=_flat(path, "set", document.get("set", {})),
        grid={
            key: _values(path, key, v, is_grid=True)
            for key, v in _flat(path, "grid", document.get("grid", {})).items()
        },
        zipped=tuple(
            {key: _values(path, key, v, is_grid=False) for key, v in _flat(path, "zip", table).items()}
            for table in _zip_tables(path, document)
        ),
        frames=_frames(path, document.get("frames")),
        scores=tuple(_words(path, document, "scores", default=[])),
        sample=_count(path, document, "sample", None, 1),
        sample_seed=_count(path, document, "sample_seed", 0, 0) or 0,
    )
    _check_settings(path, spec)
    return spec


def _document(path: Path) -> dict[str, Any]:
    """The TOML file with known keys alone."""
    document = load_toml(path, "the sweep", remedy="give a TOML file; see docs/cluster.md")
    for key in document:
        if key not in _KEYS:
            raise _bad(path, key, f"is not known; known keys are {', '.join(_KEYS)}")
    return document


def _zip_tables(path: Path, document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The tables [zip] or [[zip]] that hold anything."""
    tables = document.get("zip", [])
    tables = [tables] if isinstance(tables, dict) else tables
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise _bad(path, "zip", "must be a table [zip], or several as [[zip]]")
    return [table for table in tables if table]


def _check_settings(path: Path, spec: SweepSpec) -> None:
    """MocapError for zipped lists of different lengths, and for keys that are given twice or are no settings."""
    for group in spec.zipped:
        lengths = {key: len(values) for key, values in group.items()}
        if len(set(lengths.values())) > 1:
            raise _bad(path, "zip", f"has lists of different lengths: {lengths}")
    keys = [*spec.settings, *spec.varied]
    for key in keys:
        if keys.count(key) > 1:
            raise _bad(path, key, "is given twice, in [set], [grid] or [zip]")
        if "." not in key and key != "observation":
            raise _bad(path, key, 'is no setting; write "section.key" = ...')


def plan_cells(
    spec: SweepSpec, *, sample: int | None = None, sample_seed: int | None = None
) -> list[SweepCell]:
    """All cells in the order sessions, presets, grid, zip, seeds (the last changes fastest), or a sample of them.

    sample, sample_seed : instead of the spec's own. A larger sample of the same seed contains the smaller one.
    Raises MocapError for more than MAX_CELLS cells.
    """
    axes: list[list[dict[str, Any]]] = [
        [{key: value} for value in values] for key, values in spec.grid.items()
    ]
    for group in spec.zipped:
        axes.append([dict(zip(group, row, strict=True)) for row in zip(*group.values(), strict=True)])
    n = math.prod([len(spec.sessions), len(spec.presets), *map(len, axes), len(spec.seeds)])
    if n > MAX_CELLS:
        raise MocapError(f"the sweep has {n} cells, more than {MAX_CELLS}", remedy="split it into several")
    wanted = sample if sample is not None else spec.sample
    chosen = sample_indices(n, wanted, seed=spec.sample_seed if sample_seed is None else sample_seed)
    names = session_names(spec.sessions)
    keep = set(chosen)
    return [cell for cell in _product(spec, names, axes) if cell.index in keep]


def sample_indices(n: int, sample: int | None, *, seed: int) -> list[int]:
    """`sample` of n numbers by chance, ascending; all when there are no more."""
    if sample is None or sample >= n:
        return list(range(n))
    order = np.random.default_rng([seed, n]).permutation(n)
    return sorted(int(i) for i in order[:sample])


def session_names(sessions: Sequence[Path]) -> list[str]:
    """Folder names, with as many parents in front as it takes to tell them apart."""
    depth = 1
    while True:
        names = ["_".join(path.parts[-depth:]).strip("/") for path in sessions]
        if len(set(names)) == len(set(sessions)) or depth > max(len(path.parts) for path in sessions):
            return names
        depth += 1


def setting_text(key: str, value: Any) -> str:
    """`key=value` as `--set` takes it."""
    if isinstance(value, float):
        return f"{key}={value!r}"
    return f"{key}={json.dumps(value, ensure_ascii=False)}"


def _product(
    spec: SweepSpec, names: Sequence[str], axes: Sequence[Sequence[dict[str, Any]]]
) -> Iterator[SweepCell]:
    sessions = list(zip(spec.sessions, names, strict=True))
    fixed = tuple(setting_text(key, value) for key, value in spec.settings.items())
    combinations = list(itertools.product(*axes))
    for index, (place, preset, rows, seed) in enumerate(
        itertools.product(sessions, spec.presets, combinations, spec.seeds)
    ):
        session, name = place
        varied = {key: value for row in rows for key, value in row.items()}
        settings = (*fixed, *(setting_text(key, value) for key, value in varied.items()))
        yield SweepCell(index, session, name, preset, seed, varied, settings)


def _sessions(path: Path, patterns: Sequence[str]) -> Iterator[Path]:
    found: set[Path] = set()
    for pattern in patterns:
        for match in _matches(path, pattern):
            resolved = match.resolve()
            if resolved not in found:
                found.add(resolved)
                yield resolved


def _matches(path: Path, pattern: str) -> list[Path]:
    """The folders that a pattern of the file at `path` names, at least one."""
    base = Path(pattern) if Path(pattern).is_absolute() else path.parent / pattern
    anchor = Path(base.anchor) if base.is_absolute() else Path()
    try:
        is_pattern = any(c in pattern for c in "*?[")
        found = sorted(anchor.glob(str(base.relative_to(base.anchor)))) if is_pattern else [base]
    except OSError:  # a name that no file system takes
        found = []
    # `os.path` says of such names that nothing is there, `Path` raises.
    matches = [place for place in found if os.path.isdir(place)]
    if not matches:
        raise MocapError(
            f"the sweep names a session that is not there: {pattern}",
            path=path,
            remedy="paths are relative to the TOML file",
        )
    return matches


def _preset(path: Path, name: str) -> str:
    if name in presets():
        return name
    file = path.parent / name
    if not os.path.isfile(file):
        raise MocapError(
            f"the sweep names a preset that is not there: {name}",
            path=path,
            remedy=f"use one of {', '.join(presets())}, or a TOML file relative to the sweep's",
        )
    return str(file.resolve())


def _words(
    path: Path, document: Mapping[str, Any], key: str, default: list[str] | None = None, needed: bool = False
) -> list[str]:
    value = document.get(key, default)
    if value is None and needed:
        raise _bad(path, key, 'is missing; write sessions = ["FOLDER", ...]')
    value = [value] if isinstance(value, str) else value
    if not _is_list_of_words(value):
        raise _bad(path, key, "must be a list of strings")
    if len(set(value)) < len(value):
        raise _bad(path, key, "names something twice")
    if not value and default != []:
        raise _bad(path, key, "must not be empty")
    return value


def _is_list_of_words(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(v, str) and v for v in value)


def _seeds(path: Path, document: Mapping[str, Any]) -> tuple[int, ...]:
    value = document.get("seeds", [0])
    is_list = isinstance(value, list) and len(value) > 0
    if not is_list or not all(isinstance(v, int) and not isinstance(v, bool) and v >= 0 for v in value):
        raise _bad(path, "seeds", "must be a list of whole numbers, 0 or more")
    if len(set(value)) < len(value):
        raise _bad(path, "seeds", "names a seed twice")
    return tuple(value)


def _count(path: Path, document: Mapping[str, Any], key: str, default: int | None, least: int) -> int | None:
    value = document.get(key, default)
    if value is not None and (not isinstance(value, int) or isinstance(value, bool) or value < least):
        raise _bad(path, key, f"must be a whole number, {least} or more")
    return value


def _frames(path: Path, value: Any) -> tuple[int | None, int | None] | None:
    if value is None:
        return None
    try:
        first, last = (int(text) if text.strip() else None for text in value.split(":"))
    except (AttributeError, ValueError) as error:
        raise _bad(path, "frames", 'must be written "a:b", for example "0:100"') from error
    if (first or 0) < 0 or (last is not None and last <= (first or 0)):
        raise _bad(path, "frames", "holds no frame")
    return first, last


def _flat(path: Path, where: str, table: Any) -> dict[str, Any]:
    """Nested tables as dotted keys, because `pose.n_layers = ...` without quotes is a table in a table."""
    if not isinstance(table, dict):
        raise _bad(path, where, f"must be a table [{where}]")
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            flat |= {f"{key}.{name}": v for name, v in _flat(path, where, value).items()}
        else:
            _check_plain(path, key, value)
            flat[key] = value
    return flat


def _check_plain(path: Path, key: str, value: Any) -> None:
    """Dates and tables in lists are no values of settings."""
    if isinstance(value, list):
        for item in value:
            _check_plain(path, key, item)
    elif not isinstance(value, str | int | float | bool):
        raise _bad(path, key, f"holds {value!r}, which is no value of a setting")


def _values(path: Path, key: str, value: Any, *, is_grid: bool) -> tuple[Any, ...]:
    if not isinstance(value, list) or not value:
        raise _bad(path, key, "must be a list of values")
    if is_grid and any(
        value[i] == v and type(value[i]) is type(v) for j, v in enumerate(value) for i in range(j)
    ):
        raise _bad(path, key, "holds a value twice")
    return tuple(value)


def _bad(path: Path, key: str, message: str) -> MocapError:
    return MocapError(
        f"the sweep's key {key!r} {message}", path=path, remedy="correct the file; see docs/cluster.md"
    )
