"""The pages of the paths: what they tell people to type runs, in the order in which they tell it."""

from __future__ import annotations

import importlib.util
import re
import shlex
import shutil
from pathlib import Path

import pytest
from small_session import SETTINGS, mocap, set_options, small_session

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = [DOCS / "start.md", *sorted((DOCS / "paths").glob("*.md"))]
# Left out of the runs of the tests: pictures of a report that nobody looks at.
QUICK = (*SETTINGS, 'output.formats=["bvh", "trc", "glb", "mot"]')
# ```bash is run here.  ```console needs footage of a board or a longer walk: tests/calibrate and tests/cli have that.
NEEDS_FOOTAGE = {"calibrate", "sync", "board"}


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)


def commands(page: Path) -> list[list[str]]:
    """Every command of the page that is run, as words."""
    lines = "".join(blocks(page, "bash")).splitlines()
    return [shlex.split(line, comments=True) for line in lines if line.strip()]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_a_page_has_commands_and_what_is_not_run_is_known(page: Path) -> None:
    assert len(commands(page)) >= 2
    assert all(words[0] == "mocap" for words in commands(page))
    for line in "".join(blocks(page, "console")).splitlines():
        words = shlex.split(line)
        assert words[:2] == ["make", "demo"] or words[1] in NEEDS_FOOTAGE, line


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_the_commands_of_a_page_run(
    page: Path, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(small_session(tmp_path_factory.getbasetemp()), tmp_path / "session")
    shutil.copytree(DOCS / "notebooks", tmp_path / "docs" / "notebooks")
    monkeypatch.chdir(tmp_path)
    for words in commands(page):
        if words[1] == "synth":  # the session is there
            assert (ROOT / words[words.index("--scene") + 1]).is_file()
            continue
        more = set_options(QUICK) if words[1] == "run" and "--list-filters" not in words else ()
        said = mocap(*words[1:], *more)
        assert said.code == 0, f"{shlex.join(words)}\n{said.err}"
    for example in blocks(page, "python"):
        needed = set(re.findall(r"^(?:import|from) (\w+)", example, re.M)) - {"numpy", "mocap"}
        if all(importlib.util.find_spec(name) for name in needed):
            exec(compile(example, page.name, "exec"), {"__name__": "page"})


def test_scenes_of_the_pages_are_scenes() -> None:
    from mocap.synth.scene import load_scene

    for page in PAGES:
        for words in commands(page):
            if words[1] == "synth":
                assert load_scene(ROOT / words[words.index("--scene") + 1]).n_frames == 20


NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
MAX_NOTEBOOK_BYTES = 200_000


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_is_small_and_named_on_its_page(notebook: Path) -> None:
    assert notebook.stat().st_size < MAX_NOTEBOOK_BYTES
    assert f"notebooks/{notebook.name}" in (DOCS / "notebooks.md").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_runs(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("nbclient", "ipykernel"):
        pytest.importorskip(name, reason=f"{name}: the extra `docs`")
    import nbformat
    from nbclient import NotebookClient

    shutil.copytree(notebook.parent, tmp_path / "notebooks")
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    told = nbformat.read(notebook, as_version=4)
    client = NotebookClient(
        told,
        timeout=300,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path / "notebooks")}},
    )
    client.execute()
    text = "".join(
        output.get("text", "")
        for cell in told.cells
        if cell.cell_type == "code"
        for output in cell.outputs
        if output.output_type == "stream"
    )
    number = float(re.findall(NUMBERS[notebook.stem][0], text)[0])
    assert number < NUMBERS[notebook.stem][1], text


# What every notebook finds, and how large it may be: errors in mm, and in deviations of the exact posterior.
NUMBERS = {
    "first-run": (r"mean error ([\d.]+) mm", 60.0),
    "stages": (r"joints are off by ([\d.]+) mm", 60.0),
    "filters": (r"^sbps\s+[\d.]+\s+[\d.]+\s+([\d.]+)".replace("^", r"(?m)^"), 0.6),
}
