"""The documentation site: every page has a place, the strict build has no warnings, nothing comes from elsewhere."""

from __future__ import annotations

import html
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
NAVIGATION = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:")[1]


def test_every_page_is_in_the_navigation() -> None:
    pages = {p.relative_to(DOCS).as_posix() for p in DOCS.rglob("*.md")}
    listed = set(re.findall(r"[\w./-]+\.md", NAVIGATION.split("not_in_nav")[0]))
    decisions = {p for p in pages if p.startswith("decisions/0")}  # their table lists them
    assert pages - decisions - listed == set()
    assert listed - pages == {"CHANGELOG.md", "CONTRIBUTING.md"}


def test_the_reference_has_every_public_name() -> None:
    import mocap

    text = (DOCS / "api.md").read_text(encoding="utf-8")
    shown = {line.rsplit(".", 1)[1] for line in re.findall(r"^::: (\S+)$", text, re.M)}
    assert set(mocap.__all__) - shown - {"LANDMARKS"} == set()


def test_readme_is_short_and_users_read_of_versions() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) < 90
    for page in (ROOT / "README.md", *DOCS.glob("*.md"), *DOCS.glob("paths/*.md")):
        text = page.read_text(encoding="utf-8").lower()
        for words in ("session of work", "this session", "in this round", "last round", "next round"):
            assert words not in text, f"{page.name}: {words}"


def missing() -> list[str]:
    return [name for name in ("mkdocs", "material", "mkdocstrings") if importlib.util.find_spec(name) is None]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if missing():
        pytest.skip(f"{', '.join(missing())}: the extra `docs`, which `make docs` installs")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return folder


@pytest.mark.slow
def test_links_of_the_built_pages_lead_somewhere(site: Path) -> None:
    """Also those that templates and docstrings make, which the strict build does not look at."""
    pages = {p: p.read_text(encoding="utf-8") for p in site.rglob("*.html")}
    assert len(pages) > 80
    anchors = {p.resolve(): set(re.findall(r'\bid="([^"]+)"', text)) for p, text in pages.items()}
    broken = []
    for page, text in pages.items():
        if page.name == "404.html":
            continue
        for target in re.findall(r'(?:href|src)="([^"]*)"', text):
            if re.match(r"[a-z]+:|//|#__", target) or target in ("", "#"):
                continue
            path, _, anchor = html.unescape(target).partition("#")
            file = (page.parent / path).resolve() if path else page.resolve()
            file = file / "index.html" if file.is_dir() else file
            if not file.is_file() or (anchor and file.suffix == ".html" and anchor not in anchors[file]):
                broken.append(f"{page.relative_to(site)}: {target}")
    assert broken == []


@pytest.mark.slow
def test_nothing_is_fetched_from_elsewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r'<(?:script|img|iframe|source)[^>]+src="(https?:[^"]+|//[^"]+)"', text)
        loaded += [
            target
            for tag in re.findall(r"<link[^>]+>", text)
            if "stylesheet" in tag or "preload" in tag or "icon" in tag
            for target in re.findall(r'href="(https?:[^"]+|//[^"]+)"', tag)
        ]
        assert loaded == [], page.name
    for sheet in site.rglob("*.css"):
        assert (
            re.findall(r"url\((?:https?:|//)[^)]+\)|@import[^;]*https?:[^;]*", sheet.read_text("utf-8")) == []
        )


@pytest.mark.slow
def test_pages_show_what_they_are_about(site: Path) -> None:
    reference = (site / "api.html").read_text(encoding="utf-8")
    assert 'id="mocap.volume.carve.Carver"' in reference
    assert "voxels" in reference
    assert (site / "pictures" / "demo.webp").is_file()
    assert "<table>" in (site / "outputs.html").read_text(encoding="utf-8")
