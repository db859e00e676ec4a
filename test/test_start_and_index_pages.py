"""Documentation site: its start page, and the index pages of its sections."""

import re
from pathlib import Path
from typing import Any, Set

import pytest
from page_snippet_runner import FENCE, ROOT, PageRun

pytestmark = pytest.mark.docs

DOCS = ROOT / "docs"
SECTIONS = ("tutorials", "how-to", "reference", "reference/language", "explanation")
LINK = re.compile(r"\]\(([^)#]+\.md)")


def links(page: Path) -> Set[Any]:
    """Return the Markdown files that a page links to."""
    return {
        (page.parent / target).resolve()
        for target in LINK.findall(page.read_text(encoding="utf-8"))
        if "://" not in target
    }


@pytest.mark.slow
def test_example_of_start_page_has_shown_output(tmp_path: Path) -> None:
    run = PageRun(tmp_path)
    fences = list(FENCE.finditer((DOCS / "index.md").read_text(encoding="utf-8")))
    assert [fence["kind"] for fence in fences] == ["prolog", "text", "console"]
    for fence in fences:
        assert run.result(fence) == fence["text"]


def test_start_page_links_to_all_sections() -> None:
    sections = {DOCS / section / "index.md" for section in SECTIONS if "/" not in section}
    other_pages = {ROOT / "examples" / "cookbook" / "README.md", ROOT / "CONTRIBUTING.md"}
    assert sections | other_pages <= links(DOCS / "index.md")


@pytest.mark.parametrize("section", SECTIONS)
def test_index_of_section_links_to_all_pages(section: str) -> None:
    # Sphinx builds the table of contents from these links.
    folder = DOCS / section
    pages = {*folder.glob("*.md"), *folder.glob("*/index.md")}
    assert len(pages) > 1
    assert pages - {folder / "index.md"} <= links(folder / "index.md")


def test_ci_builds_site() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert '"$1" install.py docs ||' in script
    assert "build_site /usr/bin/python3" in script
