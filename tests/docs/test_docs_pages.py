"""The pages hang together: links and pictures exist, the configuration page is in step, tables name every key."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
MAX_PICTURE_BYTES, MAX_PICTURES_BYTES = 150_000, 3_000_000


def load(name: str) -> ModuleType:
    """A script of the docs folder as a module."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, as code hosts make them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    headings = re.findall(r"^#+ (.+)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", h.strip().lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_and_pictures_exist(page: Path) -> None:
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if not file.exists() or (anchor and file.suffix == ".md" and anchor not in anchors(file)):
            broken.append(target)
    assert broken == []


def test_pictures_are_small_and_used() -> None:
    pictures = sorted((DOCS / "pictures").iterdir())
    sizes = {p.name: p.stat().st_size for p in pictures}
    assert max(sizes.values()) < MAX_PICTURE_BYTES
    assert sum(sizes.values()) < MAX_PICTURES_BYTES
    text = "".join(p.read_text(encoding="utf-8") for p in PAGES)
    assert [name for name in sizes if f"pictures/{name}" not in text] == []


def test_configuration_page_is_in_step() -> None:
    script = load("make_configuration")
    found = (DOCS / "configuration.md").read_text(encoding="utf-8")
    assert found == script.page(), "run: python -m docs.make_configuration"


def test_body_page_names_every_key() -> None:
    from mocap.body.model import BodyModel, ConeSpec, DofSpec, JointSpec, LandmarkSpec, PartSpec

    text = (DOCS / "bodies.md").read_text(encoding="utf-8")
    keys = {"[[joint]]", "[[part]]", "[landmarks]"}
    for model in (BodyModel, JointSpec, DofSpec, PartSpec, ConeSpec, LandmarkSpec):
        for name, field in model.model_fields.items():
            if name not in ("joint", "part", "landmarks"):
                keys.add(f"`{field.alias or name}`")
    assert sorted(k for k in keys if k not in text) == []


def test_outputs_page_names_every_column_and_score() -> None:
    from mocap.compare import evaluate
    from mocap.io.tables import LANDMARK_COLUMNS, TRACK_COLUMNS, UNCERTAINTY_COLUMNS
    from mocap.pipeline.report_data import OUTPUT_WORDS

    text = (DOCS / "outputs.md").read_text(encoding="utf-8")
    words = {
        *LANDMARK_COLUMNS,
        *TRACK_COLUMNS,
        *UNCERTAINTY_COLUMNS,
        *evaluate([], [], None, None),
        *OUTPUT_WORDS,
    }
    assert sorted(w for w in words if w not in text) == []


def test_bodies_have_the_columns_that_the_pages_say() -> None:
    from mocap.body import load_body_model, scale_body

    columns = {
        name: scale_body(load_body_model(name), 1.7).layout.names
        for name in ("girdle", "anthropometric", "whole")
    }
    page = (DOCS / "outputs.md").read_text(encoding="utf-8").replace("\n", " ")
    told = page.split("In `girdle`: ")[1].split("`anthropometric` has the same")[0]
    assert tuple(name.strip(" .") for name in told.split(",")) == columns["girdle"]
    assert set(columns["girdle"]) - set(columns["anthropometric"]) == {
        f"{side}_clavicle_{axis}" for side in ("left", "right") for axis in "xz"
    }
    further = {
        "forearm_y": "elbow_z",
        "wrist_x": "forearm_y",
        "wrist_z": "wrist_x",
        "ankle_y": "knee_y",
        "ankle_x": "ankle_y",
        "mtp_y": "ankle_x",
    }
    chest = [f"thorax_{axis}" for axis in "xyz"]
    first = columns["whole"].index("waist_z") + 1
    assert list(columns["whole"][first : first + 3]) == chest
    assert "thorax_x, thorax_y and thorax_z after the waist" in page
    for column in set(columns["whole"]) - set(columns["girdle"]) - set(chest):
        side, _, name = column.partition("_")
        before = columns["whole"][columns["whole"].index(column) - 1]
        assert f"SIDE_{name}" in page
        assert before == f"{side}_{further[name]}"
    assert all(f"(D = {len(own)})" in page for own in columns.values())
    readme = (DOCS.parent / "README.md").read_text(encoding="utf-8").replace("\n", " ")
    assert f"feet and hands ({len(columns['whole'])} degrees of freedom)" in readme


def test_decisions_are_listed_and_numbered() -> None:
    notes = sorted(p.name for p in (DOCS / "decisions").glob("0*.md"))
    # A note has its number when it is begun: others that are begun at the same time may come later, and leave gaps.
    assert len({n[:4] for n in notes}) == len(notes)
    index = (DOCS / "decisions" / "README.md").read_text(encoding="utf-8")
    assert [n for n in notes if f"({n})" not in index] == []
    for note in notes:
        text = (DOCS / "decisions" / note).read_text(encoding="utf-8")
        assert text.startswith(f"# {int(note[:4])}. ")
        assert all(f"**{word}.**" in text for word in ("Context", "Decision", "Consequence")), note


def test_the_picture_script_says_when_there_is_no_demo(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script = load("make_pictures")
    assert script.main(["--demo", str(tmp_path), "--out", str(tmp_path / "p")]) == 2
    assert "mocap demo" in capsys.readouterr().err
