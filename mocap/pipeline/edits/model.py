"""What may stand in OUT/edits.toml, read with its lines, and written."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError, model_validator

from mocap.data import ALL_LANDMARKS
from mocap.errors import MocapError, did_you_mean
from mocap.files import SETTINGS_LIMIT_BYTES, parse_toml, read_text
from mocap.io._files import atomic_text

EDITS_FILE = "edits.toml"
_FRAMES = re.compile(r"\s*(\d*)\s*:\s*(\d*)\s*")
_HEADER = re.compile(r"^[ \t]*\[\[\s*edit\s*\]\]", re.MULTILINE)
# Numbers of persons are stored in 16 bits; the last one is `renaming.DELETED`, which the stages before need not know.
Person = Annotated[int, Field(ge=1, lt=2**16 - 1)]


class _Edit(BaseModel):
    """line : of the file, 0 = unknown; no part of what decides a result."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    line: int = Field(default=0, exclude=True, repr=False)


class _OverFrames(_Edit):
    frames: str = ":"

    @model_validator(mode="after")
    def _is_range(self) -> _OverFrames:
        if not _FRAMES.fullmatch(self.frames):
            raise ValueError(
                f"frames is {self.frames!r}; write a:b, frames a to b - 1; either may be left out"
            )
        return self


class Merge(_OverFrames):
    """Two persons are one: the second takes the number of the first."""

    do: Literal["merge"]
    persons: tuple[Person, Person]


class Split(_OverFrames):
    """In these frames a person is somebody else, who gets a number of his own."""

    do: Literal["split"]
    person: Person
    new: Person | None = None


class Swap(_OverFrames):
    """Two persons have changed numbers."""

    do: Literal["swap"]
    persons: tuple[Person, Person]


class Delete(_OverFrames):
    """Nobody is to be followed there."""

    do: Literal["delete"]
    person: Person


class ExchangeSides(_OverFrames):
    """Left and right have changed places."""

    do: Literal["exchange"]
    person: Person
    sides: Literal["legs", "arms", "body"] = "body"


class Bad(_OverFrames):
    """The evidence of these frames is not to be believed, of one person or of all."""

    do: Literal["bad"]
    person: Person | None = None
    frames: str


class PinLandmark(_Edit):
    """Where a landmark is in a frame: in the world, or in the pictures of two cameras or more, px, as filmed. Of both
    the place in the world is used."""

    do: Literal["pin"]
    person: Person
    landmark: Literal[ALL_LANDMARKS]  # type: ignore[valid-type]
    frame: int = Field(ge=0)
    place_m: tuple[float, float, float] | None = None
    seen_px: dict[str, tuple[float, float]] | None = None

    @model_validator(mode="after")
    def _is_placed(self) -> PinLandmark:
        if self.place_m is None and self.seen_px is None:
            raise ValueError("a pin has place_m = [x, y, z] or seen_px = {camera = [u, v], ...}")
        if self.seen_px is not None and len(self.seen_px) < 2:
            raise ValueError("seen_px names one camera; a place in space takes two or more")
        return self


Edit = Annotated[Merge | Split | Swap | Delete | ExchangeSides | Bad | PinLandmark, Field(discriminator="do")]
LANDMARKS = ALL_LANDMARKS
KINDS = ("merge", "split", "swap", "delete", "exchange", "bad", "pin")
Kind = TypeVar("Kind", bound=_Edit)


class Edits(BaseModel):
    """What was edited by hand; see edits.md."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    edit: tuple[Edit, ...] = ()
    """In the order in which they are made."""
    # No part of what decides a result.
    _file: str = PrivateAttr(default=EDITS_FILE)

    @property
    def file(self) -> str:
        """Where they were read from, for messages."""
        return self._file

    def __bool__(self) -> bool:
        return bool(self.edit)

    def is_same(self, other: Edits) -> bool:
        """Whether both say the same, wherever they stand; places that were found from pictures say nothing new."""
        return [_said(edit) for edit in self.edit] == [_said(edit) for edit in other.edit]

    def of(self, kind: type[Kind]) -> list[Kind]:
        """The edits of one kind, in order."""
        return [edit for edit in self.edit if isinstance(edit, kind)]

    def wrong(self, edit: _Edit, message: str, remedy: str) -> MocapError:
        """The error to raise for one of them."""
        where = f"line {edit.line}: " if edit.line else ""
        return MocapError(f"{where}{message}", path=self.file, remedy=remedy)


def _said(edit: _Edit) -> dict[str, Any]:
    values = edit.model_dump(exclude_none=True)
    if "seen_px" in values:
        values.pop("place_m", None)
    return values


def read_edits(path: Path) -> Edits:
    """The edits in a file. Raises MocapError that names the line."""
    text = read_text(path, "the edits", limit=SETTINGS_LIMIT_BYTES)
    return parse_edits(text, path)


def parse_edits(text: str, path: Path) -> Edits:
    """The edits in a text; see `read_edits`."""
    try:
        values = parse_toml(text)
    except ValueError as error:
        raise MocapError(f"not a TOML file: {error}", path=path, remedy="correct the syntax") from error
    lines = [text.count("\n", 0, match.start()) + 1 for match in _HEADER.finditer(text)]
    tables = values.get("edit", [])
    if not isinstance(tables, list) or len(tables) != len(lines):
        raise MocapError("edits are not written one by one", path=path, remedy="begin each with [[edit]]")
    for table, line in zip(tables, lines, strict=True):
        if isinstance(table, dict):
            table["line"] = line
    try:
        edits = Edits.model_validate(values)
    except ValidationError as error:
        raise _invalid(error, path, tables, lines) from error
    edits._file = str(path)
    return edits


def _invalid(error: ValidationError, path: Path, tables: Sequence[Any], lines: Sequence[int]) -> MocapError:
    """The first mistake, by line."""
    first = error.errors()[0]
    loc = first["loc"]
    if len(loc) < 2 or loc[0] != "edit" or not isinstance(loc[1], int):
        key = str(loc[0]) if loc else ""
        return MocapError(
            f"{key!r} is no part of the edits", path=path, remedy="write [[edit]] tables, nothing else"
        )
    table, where = tables[loc[1]], f"line {lines[loc[1]]}: "
    if first["type"] in ("union_tag_invalid", "union_tag_not_found"):
        word = str(table.get("do", ""))
        message = f"there is no edit {word!r}{did_you_mean(word, KINDS)}"
        return MocapError(where + message, path=path, remedy=f"do is one of {', '.join(KINDS)}")
    key = ".".join(str(part) for part in loc[3:])
    message = str(first["msg"]).removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        message = "is unknown" + did_you_mean(key, [k for k in _keys_of(str(loc[2])) if k != "line"])
    elif first["type"] == "literal_error":
        known = ALL_LANDMARKS if key == "landmark" else str(first["ctx"]["expected"]).split("'")[1::2]
        message = f"is {first['input']!r}{did_you_mean(str(first['input']), known)}"
        return MocapError(f"{where}{key} {message}", path=path, remedy=f"give one of {', '.join(known)}")
    remedy = "see docs/edits.md for what it may be"
    return MocapError(f"{where}{loc[2]}: {key} {message}".replace(":  ", ": "), path=path, remedy=remedy)


def _keys_of(kind: str) -> list[str]:
    for model in (Merge, Split, Swap, Delete, ExchangeSides, Bad, PinLandmark):
        if model.model_fields["do"].annotation == Literal[kind]:  # type: ignore[valid-type]
            return list(model.model_fields)
    return []


def frames_of(edit: _OverFrames, clip: range, edits: Edits) -> range:
    """The frames of an edit. Raises MocapError when they are none of the clip's."""
    match = _FRAMES.fullmatch(edit.frames)
    assert match is not None
    first, stop = (int(text) if text else None for text in match.groups())
    found = range(clip.start if first is None else first, clip.stop if stop is None else stop)
    if not found or found.start < clip.start or found.stop > clip.stop:
        raise edits.wrong(
            edit,
            f"frames {edit.frames} are not in the clip, which has frames {clip.start} to {clip.stop - 1}",
            "write a:b, frames a to b - 1, within the clip",
        )
    return found


_ABOUT = "# Edits of this result; docs/edits.md says what may stand here. They are applied whenever it is run again.\n"


def with_edit(text: str, values: Mapping[str, Any]) -> str:
    """The text of a file with one more edit."""
    lines = [f"{key} = {_toml(value)}" for key, value in values.items() if value is not None]
    return (
        (text.rstrip("\n") + "\n\n" if text.strip() else _ABOUT + "\n")
        + "\n".join(["[[edit]]", *lines])
        + "\n"
    )


def without_last(text: str) -> tuple[str, str]:
    """The text of a file without its last edit, and that edit; raises ValueError when there is none."""
    starts = [match.start() for match in _HEADER.finditer(text)]
    if not starts:
        raise ValueError("there is no edit")
    return text[: starts[-1]].rstrip("\n") + "\n", text[starts[-1] :].strip()


def edits_text(out: Path) -> str:
    """The text of the edits of a result, empty without."""
    path = out / EDITS_FILE
    return read_text(path, "the edits", limit=SETTINGS_LIMIT_BYTES) if path.exists() else ""


def write_edits(out: Path, text: str) -> None:
    """Put a text in the place of the edits of a result."""
    atomic_text(out / EDITS_FILE, text)


def edits_in(out: Path) -> Edits | None:
    """The edits that lie beside a result, None without a file of them."""
    return read_edits(out / EDITS_FILE) if (out / EDITS_FILE).exists() else None


def described(edit: _Edit) -> str:
    """An edit in one line of words."""
    values = edit.model_dump(exclude_none=True)
    words = [str(values.pop("do"))]
    return " ".join([*words, *(f"{key}={_toml(value)}" for key, value in values.items())])


def lines_of(edits: Edits) -> Iterator[str]:
    """Every edit with its line."""
    for edit in edits.edit:
        yield f"line {edit.line}: {described(edit)}"


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_toml(str(key))} = {_toml(v)}" for key, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    return str(value)
