"""The examples in the documentation run, and what they name exists."""

from __future__ import annotations

import ast
import importlib.util
import re
from pathlib import Path

import pytest
from small_session import small_session

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
DEMO = "out/demo/session"


def blocks(page: Path, language: str) -> list[str]:
    """The fenced code blocks of a page in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)


def test_the_example_of_the_library_runs(
    tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    session = small_session(tmp_path_factory.getbasetemp())
    example = blocks(ROOT / "docs" / "library.md", "python")[0]
    assert DEMO in example
    # Fewer candidates for the first pose: the example stays the same, the test stays short.
    example = example.replace('"pose.n_start_frames=1"', '"pose.n_start_frames=1", "pose.n_first_poses=1"')
    exec(compile(example.replace(DEMO, str(session)), "library.md", "exec"), {"__name__": "library"})
    said = capsys.readouterr().out
    height = re.match(r"(\d\.\d\d) m tall, head at", said)
    assert height is not None
    assert 1.4 < float(height.group(1)) < 2.1


@pytest.mark.parametrize("name", ["bodies.md", "conventions.md"])
def test_short_examples_run(name: str) -> None:
    for example in blocks(ROOT / "docs" / name, "python"):
        exec(compile(example, name, "exec"), {"__name__": "docs"})


# Programs of others that pages show how to hand files to; their examples are run where they are installed.
PROGRAMS = {"bpy", "opensim", "movement", "xarray", "pandas"}


def is_of_a_missing_program(node: ast.Import | ast.ImportFrom) -> bool:
    name = (node.names[0].name if isinstance(node, ast.Import) else node.module or "").split(".")[0]
    return name in PROGRAMS and importlib.util.find_spec(name) is None


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_python_block_is_python_and_imports_what_exists(page: Path) -> None:
    for example in blocks(page, "python"):
        tree = ast.parse(example)
        imports = [
            node
            for node in tree.body
            if isinstance(node, ast.Import | ast.ImportFrom) and not is_of_a_missing_program(node)
        ]
        exec(compile(ast.Module(imports, []), page.name, "exec"), {})


def test_the_scene_of_the_page_is_a_scene() -> None:
    import tomllib

    from mocap.synth.scene import scene_from_dict

    (example,) = blocks(ROOT / "docs" / "synthetic.md", "toml")
    scene = scene_from_dict({"name": "page", **tomllib.loads(example)})
    assert len(scene.persons) == 1


def test_the_page_names_every_scene() -> None:
    from mocap.synth import list_scenes

    text = (ROOT / "docs" / "synthetic.md").read_text(encoding="utf-8")
    assert [name for name in list_scenes() if f"`{name}`" not in text] == []


def test_the_session_file_of_the_page_is_read_and_complete(tmp_path: Path) -> None:
    import tomllib

    from mocap.io.session import SessionSettings, read_session_settings

    (example,) = blocks(ROOT / "docs" / "session.md", "toml")
    path = tmp_path / "session.toml"
    path.write_text(example, encoding="utf-8")
    settings = read_session_settings(path)
    assert settings.camera_map == {"GOPR0042": "cam_0"}
    assert set(tomllib.loads(example)) == set(SessionSettings.__dataclass_fields__)


def test_every_command_and_option_on_the_pages_exists() -> None:
    from typer.main import get_command

    from mocap.cli import app

    commands = get_command(app).commands  # type: ignore[attr-defined]
    seen = set()
    for page in PAGES:
        for line in re.findall(r"\bmocap ([a-z-]+)((?: [^`|\n;]*)?)", page.read_text(encoding="utf-8")):
            name, rest = line
            if name not in commands:
                continue
            seen.add(name)
            known = {o for p in commands[name].params for o in p.opts}
            options = re.findall(r"(?<!\S)(--?[a-z][a-z-]*)", rest)
            assert [o for o in options if o not in known] == [], f"{page.name}: mocap {name}{rest}"
    assert {"demo", "check", "run", "eval", "synth", "convert-calibration"} <= seen


def test_the_page_of_commands_lists_every_one() -> None:
    from typer.main import get_command

    from mocap.cli import app

    table = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    commands = get_command(app).commands  # type: ignore[attr-defined]
    assert [name for name in commands if not re.search(rf"`(mocap )?{name}\b", table)] == []


def test_settings_named_on_the_pages_exist() -> None:
    from mocap.pipeline.config import Config

    for page in PAGES:
        for key in re.findall(r"(?:--set |`)([a-z]+\.[a-z_0-9]+)(?==)", page.read_text(encoding="utf-8")):
            section, name = key.split(".")
            assert section in Config.model_fields, f"{page.name}: {key}"
            model = Config.model_fields[section].annotation
            assert name in model.model_fields, f"{page.name}: {key}"  # type: ignore[union-attr]
