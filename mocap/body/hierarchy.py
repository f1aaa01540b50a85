"""Scalable models of a body as data files: hierarchies of levels, and limbs that may be absent."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from mocap.data.hierarchy import Hierarchy, Level, Limb
from mocap.errors import MocapError
from mocap.files import SETTINGS_LIMIT_BYTES, parse_toml, read_text


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _LevelSpec(_Strict):
    name: str
    columns: tuple[str, ...] = Field(min_length=1)
    parts: tuple[str, ...] = Field(min_length=1)


class _HierarchySpec(_Strict):
    name: str
    source: str = ""
    pinned: dict[str, FiniteFloat] = {}
    level: tuple[_LevelSpec, ...] = Field(min_length=1)


class _LimbSpec(_Strict):
    name: str
    units: tuple[tuple[str, ...], ...] = Field(min_length=1)


class _LimbsSpec(_Strict):
    name: str
    source: str = ""
    limb: tuple[_LimbSpec, ...] = Field(min_length=1)


_Spec = TypeVar("_Spec", _HierarchySpec, _LimbsSpec)
_FOLDER = "scalable"


def hierarchy_presets() -> tuple[str, ...]:
    """Names of the hierarchies that come with the package."""
    return _presets("[[level]]")


def limb_presets() -> tuple[str, ...]:
    """Names of the limb models that come with the package."""
    return _presets("[[limb]]")


def load_hierarchy(name_or_path: str | Path) -> Hierarchy:
    """A hierarchy by its preset's name (`model1`, `model2`, `model1_printed`, `model2_printed`) or a TOML file.

    Raises MocapError with the dotted path of the first offending key. Names of columns and parts are checked where
    the hierarchy meets a body: `mocap.data.hierarchy.levels_on`.
    Source: CF Eq. 7.15-7.19, subdivided as in reading guide 14.
    """
    spec = _read(name_or_path, hierarchy_presets(), _HierarchySpec)
    levels = tuple(Level(level.name, level.columns, level.parts) for level in spec.level)
    return Hierarchy(spec.name, levels, dict(spec.pinned))


def load_limbs(name_or_path: str | Path) -> tuple[Limb, ...]:
    """Limbs that may be absent, by a preset's name (`limbs`, `whole_limbs`) or from a TOML file.

    Raises MocapError with the dotted path of the first offending key.
    Source: CF 7.4.1, Figure 7.11.
    """
    spec = _read(name_or_path, limb_presets(), _LimbsSpec)
    return tuple(Limb(limb.name, limb.units) for limb in spec.limb)


def _presets(table: str) -> tuple[str, ...]:
    folder = resources.files("mocap.body") / _FOLDER
    files = [p for p in folder.iterdir() if p.name.endswith(".toml")]
    return tuple(sorted(p.name.removesuffix(".toml") for p in files if table in p.read_text("utf-8")))


def _read(name_or_path: str | Path, presets: tuple[str, ...], spec: type[_Spec]) -> _Spec:
    is_preset = str(name_or_path) in presets
    path = Path(f"{name_or_path}.toml") if is_preset else Path(name_or_path)
    remedy = f"give a TOML file or one of {', '.join(presets)}; docs/filters.md has the schema"
    try:
        if is_preset:
            text = (resources.files("mocap.body") / _FOLDER / path.name).read_text("utf-8")
        else:
            text = read_text(path, "the file of a scalable body", limit=SETTINGS_LIMIT_BYTES, remedy=remedy)
        return spec.model_validate(parse_toml(text))
    except ValidationError as error:
        first = error.errors()[0]
        dotted = ".".join(str(p) for p in first["loc"])
        raise MocapError(f"scalable body: {dotted}: {first['msg']}", path=path, remedy=remedy) from error
    except ValueError as error:
        raise MocapError(f"not a TOML file: {error}", path=path, remedy=remedy) from error
