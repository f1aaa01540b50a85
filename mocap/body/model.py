"""Bodies as data: the schema of a body file, and the body of one person scaled from it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveFloat, ValidationError

from mocap.arrays import Array
from mocap.body._kernels import BodyArrays, Chain, ConeArrays
from mocap.data.motion import ALL_LANDMARKS, FURTHER_LANDMARKS, LANDMARKS, landmark_names
from mocap.data.problem import StateLayout
from mocap.errors import MocapError
from mocap.files import SETTINGS_LIMIT_BYTES, parse_toml, read_text

MAX_PARTS = 24  # the likelihood keeps one bit per part beside each voxel's byte
_AXES = {"x": 0, "y": 1, "z": 2}
_ROOT_COLUMNS = ("root_x", "root_y", "root_z")
_Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Side = Literal["left", "right", "middle"]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class DofSpec(_Strict):
    """One rotation of a joint."""

    name: str
    axis: Literal["x", "y", "z"]
    limits: tuple[float, float]
    """Legal range, rad. Source: CF Table 6.1."""
    speed: float = Field(gt=0)
    """Largest expected angular speed, rad/s; half of it over one frame is the propagation noise (CF 3.2.2)."""
    circular: bool = False
    usual_std: float | None = Field(default=None, gt=0)
    """How far the angle usually is from 0, rad: half a nat at this angle; none = every angle is as usual."""


class JointSpec(_Strict):
    """A joint: where it sits in its parent's frame and how it turns."""

    name: str
    parent: str = ""
    offset: _Vector
    """Fractions of the standing height, in the parent's frame."""
    translation_speed: _Vector | None = None
    """Only at the root: largest expected speed along x, y, z, m/s."""
    standing_pitch: FiniteFloat = 0.0
    """How far the frame is pitched forwards (about y) when the person stands upright, rad: anatomical angles count from
    there."""
    dofs: tuple[DofSpec, ...] = ()


class ConeSpec(_Strict):
    """A truncated cone of flesh; lengths are fractions of the standing height."""

    joint: str
    start: _Vector = Field(alias="from")
    end: _Vector = Field(alias="to")
    radii: tuple[FiniteFloat, FiniteFloat]


class PartSpec(_Strict):
    """A rigid or nearly rigid part: what the likelihood scores."""

    name: str
    parent: str = ""
    side: Side
    variance: tuple[PositiveFloat, PositiveFloat, PositiveFloat, PositiveFloat] = (1.0, 1.0, 1.0, 1.0)
    """Factors on the variances of (out, double occupancy, empty, surface). Source: CF Table 6.2."""
    cones: tuple[ConeSpec, ...]


class LandmarkSpec(_Strict):
    joint: str
    offset: _Vector


class BodyModel(_Strict):
    """A scalable body as its file describes it."""

    name: str
    source: str = ""
    height_m: float | None = Field(default=None, gt=0.05, lt=5.0)
    """Standing height of the person, or of what else the body is; a run that is given one does not look for it."""
    round_ends: bool = False
    exclusive: bool = False
    joint: tuple[JointSpec, ...]
    part: tuple[PartSpec, ...]
    landmarks: dict[str, LandmarkSpec]


@dataclass(frozen=True, eq=False)
class Cones:
    """Flesh in joint frames.  start, end : (K, 3) m; radii : (K, 2) m; joint, part : (K,) indices."""

    start: Array
    end: Array
    radii: Array
    joint: NDArray[np.int64]
    part: NDArray[np.int64]

    @property
    def arrays(self) -> ConeArrays:
        """The cones as kernels take them."""
        return ConeArrays(self.start, self.end, self.radii, self.joint, self.part)


@dataclass(frozen=True, eq=False)
class Body:
    """The body of one person: a kinematic tree in metres with flesh.

    joints : J names.  parent : (J,).  offset : (J, 3) m in the parent's frame.
    dof_joint, dof_axis, dof_column : one row per rotation, in the order of application.
    layout : columns of the state; 0..2 are the root's position, m; the rest are rad.
    max_speed : (D,) largest expected speed per column, m/s or rad/s.
    usual_std : (D,) how far a column usually is from 0, rad; inf = nothing is known.
    standing_pitch : (J,) how far a joint's frame is pitched forwards when the person stands upright, rad.
    landmark_joint : (M,), landmark_offset : (M, 3) m in the joint's frame; M is 15, or 21 with feet and hands.
    variance : (P, 4) factors of CF Table 6.2.
    Source: CF Eq. 6.2.
    """

    name: str
    height_m: float
    joints: tuple[str, ...]
    parent: NDArray[np.int64]
    offset: Array
    dof_joint: NDArray[np.int64]
    dof_axis: NDArray[np.int64]
    dof_column: NDArray[np.int64]
    layout: StateLayout
    max_speed: Array
    usual_std: Array
    standing_pitch: Array
    landmark_joint: NDArray[np.int64]
    landmark_offset: Array
    cones: Cones
    variance: Array
    part_sides: tuple[Side, ...]
    round_ends: bool
    exclusive: bool

    @property
    def chain(self) -> Chain:
        """The tree of joints as kernels take it."""
        return Chain(self.parent, self.offset, self.dof_joint, self.dof_axis, self.dof_column)

    @cached_property
    def arrays(self) -> BodyArrays:
        """The whole body as kernels take it."""
        return BodyArrays(self.chain, self.moves, self.cones.arrays)

    @cached_property
    def is_position(self) -> NDArray[np.bool_]:
        """Columns of the state that are the root's place, m, (D,); all others are angles, rad."""
        return np.arange(self.layout.n_columns) < len(_ROOT_COLUMNS)

    @cached_property
    def is_fine(self) -> NDArray[np.bool_]:
        """Columns that turn a piece of a part and no part as a whole, (D,): those of feet and hands.

        So little flesh hangs on them that a search of whole poses is the poorer for every one; a refinement sets them.
        """
        fine = np.zeros(self.layout.n_columns, dtype=np.bool_)
        for d, column in enumerate(self.dof_column):
            is_moved = self.moves[self.cones.joint, d]
            fine[column] = not set(self.cones.part[is_moved]) - set(self.cones.part[~is_moved])
        return fine

    @cached_property
    def yaw_column(self) -> int | None:
        """Column that turns the whole body about the vertical: the first circular one; None where nothing turns."""
        columns = np.flatnonzero(self.layout.is_circular)
        return int(columns[0]) if len(columns) else None

    @cached_property
    def moves(self) -> NDArray[np.bool_]:
        """Which rotations move which joint frame, (J, n_dofs)."""
        moves = np.zeros((len(self.joints), len(self.dof_joint)), dtype=np.bool_)
        for j in range(len(self.joints)):
            ancestor = j
            while ancestor >= 0:
                moves[j] |= self.dof_joint == ancestor
                ancestor = int(self.parent[ancestor])
        return moves

    @cached_property
    def part_of_joint(self) -> NDArray[np.int64]:
        """The last part with flesh on every joint, (J,); the root part for a joint without flesh."""
        found = dict(zip(self.cones.joint.tolist(), self.cones.part.tolist(), strict=True))
        return np.array([found.get(j, 0) for j in range(len(self.joints))], dtype=np.int64)

    @property
    def landmark_parts(self) -> NDArray[np.int64]:
        """The part that carries every landmark, (M,)."""
        return self.part_of_joint[self.landmark_joint]

    @property
    def landmarks(self) -> tuple[str, ...]:
        """Names of the landmarks, (M,)."""
        return landmark_names(len(self.landmark_joint))


def body_presets() -> tuple[str, ...]:
    """Names of the bodies that come with the package."""
    folder = resources.files("mocap.body") / "presets"
    return tuple(sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml")))


def load_body_model(name_or_path: str | Path) -> BodyModel:
    """Read a body file: a preset's name (`anthropometric`, `girdle`, `thesis`, `whole`) or a path to a TOML file.

    Raises MocapError with the dotted path of the first offending key.
    """
    if str(name_or_path) in body_presets():
        text = (resources.files("mocap.body") / "presets" / f"{name_or_path}.toml").read_text("utf-8")
        path = Path(f"{name_or_path}.toml")
    else:
        path = Path(name_or_path)
        remedy = f"give a TOML file or one of the presets {', '.join(body_presets())}"
        text = read_text(path, "the body file", limit=SETTINGS_LIMIT_BYTES, remedy=remedy)
    return parse_body_model(text, path)


def parse_body_model(text: str, path: Path) -> BodyModel:
    """The content of a body file; `path` names it in errors, which are those of `load_body_model`."""
    try:
        model = BodyModel.model_validate(parse_toml(text))
    except ValidationError as error:
        first = error.errors()[0]
        dotted = ".".join(str(p) for p in first["loc"])
        raise MocapError(
            f"body file: {dotted}: {first['msg']}", path=path, remedy="see docs/bodies.md for the schema"
        ) from error
    except ValueError as error:
        raise MocapError(f"not a TOML file: {error}", path=path, remedy="correct the syntax") from error
    _check_tree(model, path)
    return model


def _check_tree(model: BodyModel, path: Path) -> None:
    """MocapError for the first mistake in how joints, parts and landmarks hang together."""
    mistake = next(_mistakes(model), None)
    if mistake is not None:
        raise MocapError(f"body file: {mistake}", path=path, remedy="see docs/bodies.md for the schema")


def _mistakes(model: BodyModel) -> Iterator[str]:
    joints = [j.name for j in model.joint]
    for i, joint in enumerate(model.joint):
        yield from _mistakes_of_joint(joint, joints[:i])
    if not joints:
        yield "there is no joint"
    columns = [*_ROOT_COLUMNS, *(d.name for j in model.joint for d in j.dofs)]
    if len(set(columns)) != len(columns):
        yield "names of dofs are not unique"
    parts = [p.name for p in model.part]
    for i, part in enumerate(model.part):
        yield from _mistakes_of_part(part, parts[:i], joints)
    if not 1 <= len(parts) <= MAX_PARTS:
        yield f"{len(parts)} parts; 1 to {MAX_PARTS} are supported"
    yield from _mistakes_of_landmarks(model, joints)


def _mistakes_of_landmarks(model: BodyModel, joints: Sequence[str]) -> Iterator[str]:
    for name, landmark in model.landmarks.items():
        if landmark.joint not in joints:
            yield f"landmark {name}: unknown joint {landmark.joint}"
    missing = [n for n in LANDMARKS if n not in model.landmarks]
    if missing:
        yield f"landmarks missing: {', '.join(missing)}"
    further = [n for n in FURTHER_LANDMARKS if n in model.landmarks]
    if further and len(further) < len(FURTHER_LANDMARKS):
        missing = [n for n in FURTHER_LANDMARKS if n not in further]
        yield f"landmarks of feet and hands come all or none; missing: {', '.join(missing)}"


def _mistakes_of_joint(joint: JointSpec, before: Sequence[str]) -> Iterator[str]:
    """before : names of the joints that are defined before it."""
    is_first = not before
    if joint.name in before:
        yield f"joint {joint.name} is defined twice"
    if is_first != (joint.parent == ""):
        yield f"joint {joint.name}: exactly the first joint has no parent"
    if joint.parent and joint.parent not in before:
        yield f"joint {joint.name}: parent {joint.parent} must be defined before it"
    if (joint.translation_speed is not None) != is_first:
        yield f"joint {joint.name}: exactly the first joint has translation_speed"
    for dof in joint.dofs:
        if not dof.limits[0] <= dof.limits[1]:
            yield f"dof {dof.name}: limits {list(dof.limits)} are not in ascending order"


def _mistakes_of_part(part: PartSpec, before: Sequence[str], joints: Sequence[str]) -> Iterator[str]:
    """before : names of the parts that are defined before it."""
    is_first = not before
    if is_first != (part.parent == "") or (part.parent and part.parent not in before):
        yield f"part {part.name}: parents come first, and only the first part has none"
    if part.name in before:
        yield f"part {part.name} is defined twice"
    if not part.cones:
        yield f"part {part.name} has no cones"
    for cone in part.cones:
        if cone.joint not in joints:
            yield f"part {part.name}: cone on unknown joint {cone.joint}"
        if min(cone.radii) <= 0:
            yield f"part {part.name}: radii must be positive"


def scale_body(model: BodyModel, height_m: float) -> Body:
    """The body of a person of the given standing height: every length is proportional to it.

    Raises ValueError for a height that is not positive and finite.
    Source: CF 6.3.4, Table 6.1.
    """
    if not (math.isfinite(height_m) and height_m > 0):
        raise ValueError(f"height_m must be positive, got {height_m}")
    index = {joint.name: i for i, joint in enumerate(model.joint)}
    parent = np.array([index.get(j.parent, -1) for j in model.joint], dtype=np.int64)
    # The columns after the root's position are the degrees of freedom, joint by joint.
    dofs = [(j, dof) for j, joint in enumerate(model.joint) for dof in joint.dofs]
    landmark_joint, landmark_offset = _landmarks(model, index)
    max_speed, usual_std = _usual_motion(model, dofs)
    return Body(
        name=model.name,
        height_m=float(height_m),
        joints=tuple(index),
        parent=parent,
        offset=np.array([j.offset for j in model.joint]) * height_m,
        dof_joint=np.array([j for j, _ in dofs], dtype=np.int64),
        dof_axis=np.array([_AXES[dof.axis] for _, dof in dofs], dtype=np.int64),
        dof_column=np.arange(3, 3 + len(dofs), dtype=np.int64),
        layout=_layout(model, dofs, _part_of_column(model, dofs, parent, index)),
        max_speed=max_speed,
        usual_std=usual_std,
        standing_pitch=np.array([j.standing_pitch for j in model.joint]),
        landmark_joint=landmark_joint,
        landmark_offset=landmark_offset * height_m,
        cones=_cones(model, index, height_m),
        variance=np.array([p.variance for p in model.part]),
        part_sides=tuple(p.side for p in model.part),
        round_ends=model.round_ends,
        exclusive=model.exclusive,
    )


def _landmarks(model: BodyModel, index: dict[str, int]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Joint (M,) of each landmark and its offset (M, 3) there, fractions of the standing height."""
    specs = [model.landmarks[name] for name in ALL_LANDMARKS if name in model.landmarks]
    joint = np.array([index[spec.joint] for spec in specs], dtype=np.int64)
    return joint, np.array([spec.offset for spec in specs])


def _usual_motion(
    model: BodyModel, dofs: Sequence[tuple[int, DofSpec]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Largest expected speed of each column (D,), m/s and rad/s, and how far it usually is from 0 (D,)."""
    root = model.joint[0].translation_speed or (1.0, 1.0, 1.0)
    speed = np.array([*root, *(dof.speed for _, dof in dofs)])
    return speed, np.array([math.inf] * 3 + [dof.usual_std or math.inf for _, dof in dofs])


def _layout(model: BodyModel, dofs: Sequence[tuple[int, DofSpec]], part_of_column: list[int]) -> StateLayout:
    """The columns of a state: the root's position, then the degrees of freedom."""
    parts = [p.name for p in model.part]
    limits = [(-math.inf, math.inf) if dof.circular else dof.limits for _, dof in dofs]
    return StateLayout(
        names=(*_ROOT_COLUMNS, *(dof.name for _, dof in dofs)),
        lower=np.array([-math.inf] * 3 + [lower for lower, _ in limits]),
        upper=np.array([math.inf] * 3 + [upper for _, upper in limits]),
        is_circular=np.array([False] * 3 + [dof.circular for _, dof in dofs]),
        parts=tuple(parts),
        part_of_column=np.array(part_of_column, dtype=np.int64),
        parent_of_part=np.array(
            [parts.index(p.parent) if p.parent else -1 for p in model.part], dtype=np.int64
        ),
    )


def _part_of_column(
    model: BodyModel,
    dofs: Sequence[tuple[int, DofSpec]],
    parent: NDArray[np.int64],
    index: dict[str, int],
) -> list[int]:
    """Part that each column belongs to: the first one whose flesh it moves."""
    out = []
    for j in [0, 0, 0, *(j for j, _ in dofs)]:
        moved = [
            k
            for k, part in enumerate(model.part)
            if any(_is_ancestor(parent, j, index[cone.joint]) for cone in part.cones)
        ]
        out.append(min(moved, default=0))
    return out


def _cones(model: BodyModel, index: dict[str, int], height_m: float) -> Cones:
    """The flesh of all parts.  index : joint's name -> its number."""
    cones = [(cone, k) for k, part in enumerate(model.part) for cone in part.cones]
    return Cones(
        start=np.array([c.start for c, _ in cones]) * height_m,
        end=np.array([c.end for c, _ in cones]) * height_m,
        radii=np.array([c.radii for c, _ in cones]) * height_m,
        joint=np.array([index[c.joint] for c, _ in cones], dtype=np.int64),
        part=np.array([k for _, k in cones], dtype=np.int64),
    )


def _is_ancestor(parent: NDArray[np.int64], ancestor: int, joint: int) -> bool:
    while joint >= 0:
        if joint == ancestor:
            return True
        joint = int(parent[joint])
    return False
