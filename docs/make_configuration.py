"""Write docs/configuration.md from the configuration models, so that the page cannot fall behind the code.

python -m docs.make_configuration            # write the page
python -m docs.make_configuration --check    # exit with 1 when the page is out of step
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import sys
import textwrap
import tomllib
import types
from copy import copy
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import annotated_types
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mocap.pipeline.config import Config, presets

PAGE = Path(__file__).with_name("configuration.md")

_HEAD = """# Configuration

<!-- Written by docs/make_configuration.py from the configuration and the pose settings; do not edit by hand. -->

Everything that decides a result besides the input and the seed. A preset is a TOML file that names only what differs
from the defaults below. `--preset` takes the name of a preset or the path of your own file; without it the preset is
`default`, so the values in its row come first. `--set` changes one key and may be repeated:

    mocap run SESSION -o OUT --preset reference --set pose.n_particles=1000 --set volume.voxel_size_m=0.03

The value is TOML: numbers, `true` or `false`, `"text"` or a bare word, `["a", "b"]`, `[[-2, -2, 0], [2, 2, 2.2]]`.
Unknown keys and values out of range are refused with the dotted path of the key, before any work is done. The whole
configuration of a run stands in its `run.json`.

The equations cited are those of CF ([sources](sources.md)).
"""

_WORDS = {
    "volume.voxel_size_m": "Side of a voxel, m. Time and memory grow with its inverse cube.",
    "body": "The body model; see [bodies.md](bodies.md).",
    "likelihood.variance_out": "Variance of the share of flesh outside the room (CF Table 6.2).",
    "likelihood.variance_double": "Variance of the share of flesh in voxels of another part (CF Table 6.2).",
    "likelihood.variance_empty": "Variance of the share of flesh in empty voxels (CF Table 6.2).",
    "likelihood.variance_surface": "Variance of the distance of skin from the hull's surface (CF Table 6.2).",
    "pose.resampling": "Scheme that draws particles by their weights.",
    "output.report_cameras": "Cameras shown as pictures in the report, spread over the rig.",
    "output.formats": "Exports and views to write; [outputs.md](outputs.md) says what each is.",
}


def type_words(annotation: Any) -> str:
    """A type as a person writes it."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        limits = [range_words(m) for m in arguments[1:] if isinstance(m, FieldInfo)]
        return type_words(arguments[0]) + "".join(limits)
    if origin is Literal:
        return ", ".join(f"`{a}`" for a in arguments)
    if origin in (Union, types.UnionType):
        return " or ".join(type_words(a) for a in arguments)
    if origin is tuple:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            return f"list of {type_words(arguments[0])}"
        return f"[{', '.join(type_words(a) for a in arguments)}]"
    names = {float: "number", int: "whole number", bool: "true, false", str: "text", type(None): "none"}
    return names.get(annotation, str(annotation))


def range_words(field: FieldInfo) -> str:
    """The limits of a field, or nothing."""
    signs: tuple[tuple[type, str, str], ...] = (
        (annotated_types.Ge, "ge", ">="),
        (annotated_types.Gt, "gt", ">"),
        (annotated_types.Le, "le", "<="),
        (annotated_types.Lt, "lt", "<"),
    )
    found = [
        f"{sign} {getattr(limit, name):g}"
        for limit in field.metadata
        for kind, name, sign in signs
        if isinstance(limit, kind)
    ]
    return ", " + ", ".join(found) if found else ""


def value_words(value: Any) -> str:
    """A value as TOML has it."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple):
        return "`[" + ", ".join(f'"{v}"' if isinstance(v, str) else str(v) for v in value) + "]`"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def words_of(section: type) -> dict[str, str]:
    """The strings under the keys of a section, out of its source.

    pydantic can read them too, but every run would wait a fifth of a second for what only this page shows.
    """
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(section))).body
    assert isinstance(body, ast.ClassDef)
    return {
        key.target.id: words.value.value
        for key, words in pairwise(body.body)
        if isinstance(key, ast.AnnAssign) and isinstance(key.target, ast.Name)
        if isinstance(words, ast.Expr) and isinstance(words.value, ast.Constant)
        if isinstance(words.value.value, str)
    }


def fields_of(section: type) -> dict[str, FieldInfo]:
    """The keys of a section, which is a pydantic model or a plain dataclass, with their words as description."""
    words = words_of(section)
    if issubclass(section, BaseModel):
        fields = {name: copy(field) for name, field in section.model_fields.items()}
    else:
        hints, plain = get_type_hints(section), section()
        fields = {
            f.name: FieldInfo(annotation=hints[f.name], default=getattr(plain, f.name))
            for f in dataclasses.fields(section)
        }
    for name, field in fields.items():
        field.description = words.get(name)
    return fields


def section_text(name: str, section: type) -> str:
    """The table of one section, or of the sections inside it."""
    intro = _WORDS.get(name) or " ".join((section.__doc__ or "").split())
    own = {f"{name}.{key}": f for key, f in fields_of(section).items()}
    inner = {path: f.annotation for path, f in own.items() if dataclasses.is_dataclass(f.annotation)}
    if inner:
        head = f"## [{name}]\n\n{intro}\n"
        return "\n".join([head, *(section_text(path, kind) for path, kind in inner.items())])  # type: ignore[arg-type]
    return table_text(f"[{name}]", intro, own)


def table_text(heading: str, intro: str, fields: dict[str, FieldInfo]) -> str:
    """Heading, words and table of some keys, given by their dotted paths."""
    lines = [f"## {heading}", "", intro, "", "| key | default | values | meaning |", "|---|---|---|---|"]
    for path, field in fields.items():
        key = path.rpartition(".")[2]
        words = _WORDS.get(path) or " ".join((field.description or "").split())
        if not words:
            raise ValueError(f"{path} has no description: write one in config.py or in _WORDS")
        values = type_words(field.annotation) + range_words(field)
        cells = (f"`{key}`", value_words(field.default), values, words)
        lines.append("| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |")
    return "\n".join(lines) + "\n"


def preset_text() -> str:
    """What each preset changes, and its comment."""
    lines = ["## Presets", "", "| preset | what it changes | why |", "|---|---|---|"]
    for name in presets():
        text = (resources.files("mocap") / "presets" / f"{name}.toml").read_text("utf-8")
        comment = " ".join(line.lstrip("# ") for line in text.splitlines() if line.startswith("#"))
        changes = [
            f"`{path} = {str(value).lower() if isinstance(value, bool) else value}`"
            for section, table in tomllib.loads(text).items()
            for path, value in (
                {f"{section}.{key}": v for key, v in table.items()}
                if isinstance(table, dict)
                else {section: table}
            ).items()
        ]
        lines.append(f"| `{name}` | {'<br>'.join(changes) or 'nothing'} | {comment} |")
    return "\n".join(lines) + "\n"


def page() -> str:
    """The whole page."""
    sections, plain = [], {}
    for name, field in fields_of(Config).items():
        if name == "edits":
            sections.append(
                "## [edits]\n\nWhat was corrected by hand, out of OUT/edits.toml: [edits.md](edits.md).\n"
            )
        elif isinstance(field.annotation, type):
            sections.append(section_text(name, field.annotation))
        else:
            plain[name] = field
    top = table_text("Outside the sections", "`--set` takes these without a section.", plain)
    return "\n".join([_HEAD, preset_text(), top, *sections])


def main(argv: list[str]) -> int:
    """Write the page, or compare it."""
    if "--check" in argv:
        is_same = PAGE.exists() and PAGE.read_text(encoding="utf-8") == page()
        if not is_same:
            print(f"{PAGE.name} is out of step; run: python -m docs.make_configuration", file=sys.stderr)
        return 0 if is_same else 1
    PAGE.write_text(page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
