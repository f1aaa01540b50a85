"""Markers on a body: a set as data, and where its markers sit on one person."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from mocap.arrays import Array
from mocap.body.kinematics import joint_transforms
from mocap.body.model import Body
from mocap.errors import MocapError
from mocap.files import SETTINGS_LIMIT_BYTES, parse_toml, read_text

_FOLDER = "marker_sets"


class MarkerSpec(BaseModel):
    """One marker: the joint that carries it, the part it belongs to, and where it sits."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    joint: str
    part: str
    offset: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    """In the joint's frame at rest, fractions of the standing height."""
    slack_m: float = Field(default=0.01, ge=0, le=0.2)
    """How far the marker moves against its part: skin, and joints that the body does not have."""


class MarkerSet(BaseModel):
    """A marker set as its file describes it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    source: str = ""
    marker: tuple[MarkerSpec, ...]


@dataclass(frozen=True, eq=False)
class Markers:
    """The markers of one person.

    names : M names.  joint, part : (M,) indices into the body's joints and parts.  offset : (M, 3) m in the joint's
    frame.  slack_m : (M,) standard deviation of a marker's movement against its part.
    """

    names: tuple[str, ...]
    joint: NDArray[np.int64]
    part: NDArray[np.int64]
    offset: Array
    slack_m: Array

    def __post_init__(self) -> None:
        M = len(self.names)
        for name, shape in (("joint", (M,)), ("part", (M,)), ("offset", (M, 3)), ("slack_m", (M,))):
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, expected {shape}")

    def __len__(self) -> int:
        return len(self.names)


def marker_sets() -> tuple[str, ...]:
    """Names of the marker sets that come with the package."""
    folder = resources.files("mocap.body") / _FOLDER
    return tuple(sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml")))


def load_marker_set(name_or_path: str | Path) -> MarkerSet:
    """Read a marker set: a preset's name or a path to a TOML file.

    Raises MocapError with the dotted path of the first offending key, for doubled names and for an empty set.
    """
    if str(name_or_path) in marker_sets():
        path = Path(f"{name_or_path}.toml")
        text = (resources.files("mocap.body") / _FOLDER / path.name).read_text("utf-8")
    else:
        path = Path(name_or_path)
        text = read_text(
            path,
            "the marker set",
            limit=SETTINGS_LIMIT_BYTES,
            remedy=f"give a TOML file or one of the sets {', '.join(marker_sets())}",
        )
    remedy = "see docs/markers.md for the schema"
    try:
        found = MarkerSet.model_validate(parse_toml(text))
    except ValidationError as error:
        first = error.errors()[0]
        dotted = ".".join(str(p) for p in first["loc"])
        raise MocapError(f"marker set: {dotted}: {first['msg']}", path=path, remedy=remedy) from error
    except ValueError as error:
        raise MocapError(f"not a TOML file: {error}", path=path, remedy="correct the syntax") from error
    names = [m.name for m in found.marker]
    if not names:
        raise MocapError("marker set: there is no marker", path=path, remedy=remedy)
    if doubled := sorted({n for n in names if names.count(n) > 1}):
        raise MocapError(f"marker set: marker {doubled[0]} is defined twice", path=path, remedy=remedy)
    return found


def place_markers(marker_set: MarkerSet, body: Body) -> Markers:
    """The markers of a set on a body: offsets grow with the standing height.

    Raises MocapError when a marker names a joint or part that the body lacks.
    """
    joints = {name: i for i, name in enumerate(body.joints)}
    parts = {name: i for i, name in enumerate(body.layout.parts)}
    for marker in marker_set.marker:
        for kind, name, known in (("joint", marker.joint, joints), ("part", marker.part, parts)):
            if name not in known:
                raise MocapError(
                    f"marker {marker.name} of the set {marker_set.name} sits on {kind} {name!r}, which the body "
                    f"{body.name} does not have",
                    remedy=f"use one of {', '.join(known)}",
                )
    return Markers(
        names=tuple(m.name for m in marker_set.marker),
        joint=np.array([joints[m.joint] for m in marker_set.marker], dtype=np.int64),
        part=np.array([parts[m.part] for m in marker_set.marker], dtype=np.int64),
        offset=np.array([m.offset for m in marker_set.marker], dtype=np.float64) * body.height_m,
        slack_m=np.array([m.slack_m for m in marker_set.marker], dtype=np.float64),
    )


def marker_positions(body: Body, markers: Markers, states: Array) -> Array:
    """Markers of states (N, D) in the world, (N, M, 3) m."""
    R, t = joint_transforms(body, states)
    return np.einsum("nmrc,mc->nmr", R[:, markers.joint], markers.offset) + t[:, markers.joint]
