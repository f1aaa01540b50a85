"""Reading Acclaim files: a skeleton (ASF) and its motion (AMC)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.errors import MocapError
from mocap.files import read_bytes
from mocap.synth.capture.recording import Recording, euler_matrix

Array = NDArray[np.float64]

_TURNS = {"rx": "x", "ry": "y", "rz": "z"}
_MOVES = {"tx": 0, "ty": 1, "tz": 2}


@dataclass
class _Bone:
    """name, unit direction (3,) and length of a bone; its axes (3, 3) at rest; its degrees of freedom."""

    name: str
    direction: Array = field(default_factory=lambda: np.zeros(3))
    length: float = 0.0
    axes: Array = field(default_factory=lambda: np.eye(3))
    freedoms: tuple[str, ...] = ()


class _Reader:
    """Lines of a file with their numbers, without comments."""

    def __init__(self, path: Path) -> None:
        self.path = path
        content = read_bytes(path, "the capture", remedy="give an AMC file beside its ASF file")
        text = content.decode("utf-8", errors="replace")
        self.lines = [
            (number, line.split())
            for number, line in enumerate(text.splitlines(), start=1)
            if line.split() and not line.lstrip().startswith("#")
        ]

    def error(self, number: int, what: str) -> MocapError:
        return MocapError(f"line {number}: {what}", path=self.path, remedy="correct the file")

    def numbers(self, number: int, words: list[str], n: int) -> list[float]:
        try:
            values = [float(w) for w in words]
        except ValueError as error:
            raise self.error(number, f"{' '.join(words)[:60]!r} are no numbers") from error
        if len(values) != n or not np.isfinite(values).all():
            raise self.error(number, f"{n} finite numbers are expected, {' '.join(words)[:60]!r} is there")
        return values


def read_amc(path: Path | str, skeleton: Path | str | None = None) -> Recording:
    """The joints and frames of an AMC file with its ASF file, in the file's units and axes; rest is all angles zero.

    skeleton : the ASF file; not given: in the same folder the one of the same name, or of its part before "_".
    A joint has the name of the bone that begins there; the root's is "root".
    Raises MocapError with file and line for files that cannot be read or understood.
    Source: the Acclaim format as described by J. Lander, Working with motion capture file formats, 1998.
    """
    path = Path(path)
    skeleton = _skeleton_of(path) if skeleton is None else Path(skeleton)
    root, bones, parent_of = _read_asf(skeleton)
    by_name = {b.name: b for b in [root, *bones]}
    values = _values_of_bones(path, by_name)
    names = ["root", *(b.name for b in bones)]
    parents = np.array([-1, *(names.index(parent_of[b.name]) for b in bones)], dtype=np.int64)
    offsets = np.zeros((len(names), 3))
    for j, bone in enumerate(bones, start=1):
        above = by_name[parent_of[bone.name]]
        offsets[j] = above.direction * above.length
    rotations = np.stack([_turned(bone, values[bone.name]) for bone in [root, *bones]], axis=1)
    places = np.tile(offsets, (len(rotations), 1, 1))
    for i, freedom in enumerate(root.freedoms):
        if freedom in _MOVES:
            places[:, 0, _MOVES[freedom]] = values["root"][:, i]
    return Recording(tuple(names), parents, offsets, places, rotations, None)


def _values_of_bones(path: Path, by_name: dict[str, _Bone]) -> dict[str, Array]:
    """Name -> values (T, F) of the bone's degrees of freedom over the frames of an AMC file."""
    frames = _read_frames(path, by_name)
    for bone in by_name.values():
        missing = next((i for i, f in enumerate(frames) if bone.freedoms and bone.name not in f), None)
        if missing is not None:
            raise MocapError(
                f"frame {missing}: {bone.name} is missing", path=path, frame=missing, remedy="correct it"
            )
    return {name: np.array([f.get(name, []) for f in frames]).reshape(len(frames), -1) for name in by_name}


def _read_frames(path: Path, by_name: dict[str, _Bone]) -> list[dict[str, list[float]]]:
    """Per frame of an AMC file the values of the bones that it names."""
    reader = _Reader(path)
    frames: list[dict[str, list[float]]] = []
    for number, words in reader.lines:
        if words[0].startswith(":"):
            if words[0].upper() == ":RADIANS":
                raise reader.error(number, "angles in radians are not supported, degrees are")
        elif len(words) == 1 and words[0].isdigit():
            frames.append({})
        elif not frames:
            raise reader.error(number, "values come before the first frame number")
        elif words[0] not in by_name:
            raise reader.error(number, f"the skeleton has no bone {words[0]!r}")
        else:
            frames[-1][words[0]] = reader.numbers(number, words[1:], len(by_name[words[0]].freedoms))
    if not frames:
        raise MocapError("the file has no frames", path=path, remedy="give an AMC file")
    return frames


def _turned(bone: _Bone, values: Array) -> Array:
    """Rotations (T, 3, 3) of a bone against its parent, from the values (T, F) of its degrees of freedom."""
    turns = [i for i, d in enumerate(bone.freedoms) if d in _TURNS]
    # Angles are about fixed axes, the first listed one first: the last one stands left in the product.
    order = "".join(_TURNS[bone.freedoms[i]] for i in reversed(turns))
    return bone.axes @ euler_matrix(order, values[:, turns[::-1]]) @ bone.axes.T


def _skeleton_of(path: Path) -> Path:
    tried = [path.with_suffix(".asf"), path.with_name(path.stem.split("_")[0] + ".asf")]
    found = next((p for p in tried if p.is_file()), None)
    if found is None:
        names = " or ".join(dict.fromkeys(p.name for p in tried))
        raise MocapError("an AMC file needs its skeleton", path=path, remedy=f"put {names} beside it")
    return found


_Lines = list[tuple[int, list[str]]]


def _read_asf(path: Path) -> tuple[_Bone, list[_Bone], dict[str, str]]:
    """Root, bones with parents before children, and the name of each bone's parent."""
    reader = _Reader(path)
    sections: dict[str, _Lines] = {}
    current: _Lines = []
    for number, words in reader.lines:
        if words[0].startswith(":"):
            current = sections.setdefault(words[0].lower(), [])
        else:
            current.append((number, words))
    for needed in (":root", ":bonedata", ":hierarchy"):
        if needed not in sections:
            raise MocapError(f"the skeleton has no section {needed}", path=path, remedy="give an ASF file")
    for number, words in sections.get(":units", []):
        if words[0] == "angle" and words[1:] != ["deg"]:
            raise reader.error(number, "angles in radians are not supported, degrees are")
    root = _root(reader, sections[":root"])
    bones = _bones(reader, sections[":bonedata"])
    order, parent_of = _hierarchy(reader, sections[":hierarchy"], bones)
    return root, order, parent_of


def _root(reader: _Reader, lines: _Lines) -> _Bone:
    root = _Bone("root", freedoms=("tx", "ty", "tz", "rx", "ry", "rz"))
    for number, words in lines:
        if words[0] == "order":
            root.freedoms = tuple(w.lower() for w in words[1:])
            if not set(root.freedoms) <= {*_TURNS, *_MOVES} or len(set(root.freedoms)) < len(root.freedoms):
                raise reader.error(number, f"the order {' '.join(words[1:])} is not understood")
    return root


def _bones(reader: _Reader, lines: _Lines) -> dict[str, _Bone]:
    """The bones of the section :bonedata, by name."""
    bones: dict[str, _Bone] = {}
    bone: _Bone | None = None
    for number, words in lines:
        if words == ["begin"]:
            bone = _Bone("")
        elif bone is None:
            raise reader.error(number, f"{words[0]!r} is not expected here")
        elif words == ["end"]:
            bones[bone.name] = bone
            bone = None
        else:
            _describe(reader, bone, number, words)
    return bones


def _describe(reader: _Reader, bone: _Bone, number: int, words: list[str]) -> None:
    """Take one line about a bone; id, limits and other things that do not move it are passed over."""
    match words:
        case ["name", name]:
            bone.name = name
        case ["direction", *values]:
            bone.direction = np.array(reader.numbers(number, values, 3))
        case ["length", *values]:
            bone.length = reader.numbers(number, values, 1)[0]
        case ["axis", *values, order] if len(values) == 3:
            if sorted(order.lower()) != ["x", "y", "z"]:
                raise reader.error(number, f"the order {order!r} of the axes is not understood")
            degrees = np.array(reader.numbers(number, values, 3))
            bone.axes = euler_matrix(order.lower()[::-1], degrees[None, ::-1])[0]
        case ["dof", *freedoms]:
            bone.freedoms = tuple(f.lower() for f in freedoms)
            if not set(bone.freedoms) <= set(_TURNS) or len(set(freedoms)) < len(freedoms):
                raise reader.error(number, f"the degrees of freedom {' '.join(freedoms)} are not understood")


def _hierarchy(reader: _Reader, lines: _Lines, bones: dict[str, _Bone]) -> tuple[list[_Bone], dict[str, str]]:
    """Bones with parents before children, and the name of each bone's parent."""
    parent_of: dict[str, str] = {}
    order: list[_Bone] = []
    for number, words in lines:
        if words in (["begin"], ["end"]):
            continue
        if words[0] != "root" and words[0] not in parent_of:
            raise reader.error(number, f"{words[0]!r} has no parent above it")
        for child in words[1:]:
            if child not in bones:
                raise reader.error(number, f"{child!r} is not in the bone data")
            parent_of[child] = words[0]
            order.append(bones[child])
    return order, parent_of
