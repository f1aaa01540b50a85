"""What the site needs beyond `docs/`: pages and results of the checkout's root, and links that lead to them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("CHANGELOG.md", "CONTRIBUTING.md")
_RESULT = re.compile(r"\]\((?:\.\./)+(eval/results/[\w.-]+)")


def on_files(files: Any, config: Any, **_: Any) -> Any:
    """Adds the pages of the root, and every result that a page shows or links to."""
    from mkdocs.structure.files import File

    wanted = {
        name for page in (ROOT / "docs").rglob("*.md") for name in _RESULT.findall(page.read_text("utf-8"))
    }
    for name in (*PAGES, *sorted(wanted)):
        files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links out of `docs/`, as a code host has them, into links of the site."""
    if page.file.src_uri in PAGES:
        return re.sub(r"\]\(docs/", "](", markdown).replace("](README.md)", "](index.md)")
    up = "../" * page.file.src_uri.count("/")
    markdown = _RESULT.sub(lambda m: f"]({up}{m[1]}", markdown)
    for name in PAGES:
        markdown = re.sub(rf"\]\((?:\.\./)+{name}", f"]({up}{name}", markdown)
    return re.sub(r"\]\((?:\.\./)+README\.md\)", f"]({up}index.md)", markdown)
