"""The code that a module can reach by its imports: what can change a stage's result, and nothing else.

Imports are read from the source, those inside functions too, so that there is no list to keep: what the architecture
test allows and a module uses is what counts.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_PACKAGE = ROOT.name
_IMPORT = re.compile(
    rf"^[ \t]*(?:from[ \t]+({_PACKAGE}[\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)|import[ \t]+({_PACKAGE}[^\n]*))",
    re.MULTILINE,
)


@cache
def code_hash() -> str:
    """Hash of all source files of the package: whether two machines run the same program."""
    return _hash_of(sorted(path for path in ROOT.rglob("*") if path.suffix in (".py", ".toml")))


@cache
def code_hash_of(module: str) -> str:
    """Hash of the source files that a module can reach, and of the data files of the rooms that they are in."""
    files = {file_of(name) for name in reached_from(module)}
    rooms = {ROOT / path.relative_to(ROOT).parts[0] for path in files if path}
    data = {path for room in rooms if room.is_dir() for path in room.rglob("*.toml")}
    return _hash_of(sorted({path for path in files if path} | data))


@cache
def reached_from(module: str) -> frozenset[str]:
    """Dotted names of the modules that are imported when a module is, or while it works; with itself."""
    return all_from(module, lambda name: [*imported_by(name), *_parents_of(name)])


def all_from(module: str, next_of: Callable[[str], Iterable[str]]) -> frozenset[str]:
    """A module, those that follow from it, and from these."""
    seen: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            waiting += next_of(name)
    return frozenset(seen)


def _parents_of(module: str) -> Iterator[str]:
    """The packages that are imported before a module; that of everything only hands out names."""
    parts = module.split(".")
    for n in range(2, len(parts)):
        yield ".".join(parts[:n])


@cache
def imported_by(module: str) -> tuple[str, ...]:
    """Dotted names of the modules of the package that the source of a module imports, wherever in it."""
    path = file_of(module)
    text = path.read_text(encoding="utf-8") if path is not None else ""
    found = []
    for base, names, plain in _IMPORT.findall(text):
        if plain:
            found += [part.split(" as ")[0].strip() for part in plain.split("#")[0].split(",")]
            continue
        found.append(base)
        bare = re.sub(r"#[^\n]*", "", names).strip("() \t\n")
        found += [f"{base}.{name.split(' as ')[0].strip()}" for name in bare.split(",") if name.strip()]
    return tuple(name for name in found if name != _PACKAGE and file_of(name) is not None)


@cache
def file_of(module: str) -> Path | None:
    """The file of a module; None for a name that is none."""
    path = ROOT.joinpath(*module.split(".")[1:])
    for file in (path.with_suffix(".py"), path / "__init__.py"):
        if file.is_file():
            return file
    return None


def _hash_of(files: list[Path]) -> str:
    named = "".join(f"{path.relative_to(ROOT).as_posix()} {_file_hash(path)} " for path in files)
    return hashlib.sha256(named.encode()).hexdigest()[:16]


@cache
def _file_hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
