"""Pages of the documentation site in a browser: cookbook, captions, widths, the start page, and repository links."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from built_site import COOKBOOK, DOCS, NEEDS_SITE, SITE
from page_snippet_runner import FENCE, ROOT
from script_modules import load_script

pytestmark = NEEDS_SITE

PROGRAMS = sorted(path.parent.name for path in COOKBOOK.glob("*/eventRules.txt"))
PAGES_WITH_FILES = sorted(
    page
    for page in DOCS.rglob("*.md")
    if DOCS / "_build" not in page.parents
    and any(fence["name"] for fence in FENCE.finditer(page.read_text(encoding="utf-8")))
)
CAPTIONED_BLOCKS = """
    [...document.querySelectorAll("article .literal-block-wrapper")].map(block => [
      block.querySelector(".code-block-caption .caption-text").innerText, block.querySelector("pre").textContent
    ])
"""
LAYOUT = """({
    column: document.querySelector("article").getBoundingClientRect().width,
    page: document.documentElement.scrollWidth,
    cut: [...document.querySelectorAll("article pre, article .table-wrapper")]
        .filter(block => block.scrollWidth > block.clientWidth + 1).map(block => block.innerText.slice(0, 100)),
})"""
WIDE_PAGES = (
    "index",
    "reference/predicates",
    "reference/commands",
    "reference/errors",
    "explanation/architecture",
    "cookbook/README",
    "cookbook/task_timeout/README",
)
SOURCE_LINKS = (
    """[...document.querySelectorAll(".view-this-page a, .edit-this-page a")].map(link => link.href)"""
)


def open_page(browser: Any, page: str) -> None:
    """Open a page of the site by its name."""
    browser.open(f"{SITE.as_uri()}/{page}.html")


@pytest.mark.parametrize("program", PROGRAMS)
def test_page_of_program_has_all_files(browser: Any, program: Any) -> None:
    open_page(browser, f"cookbook/{program}/README")
    files = {
        path.relative_to(COOKBOOK / program).as_posix(): path.read_text(encoding="utf-8")
        for path in (COOKBOOK / program).rglob("*")
        if path.suffix in (".txt", ".xml", ".py", ".yaml")
    }
    assert len(files) == 6
    captioned_blocks = dict(browser.ask(CAPTIONED_BLOCKS))
    assert {name: text.strip() for name, text in captioned_blocks.items()} == {
        name: text.strip() for name, text in files.items()
    }


def test_index_of_cookbook_has_all_programs(browser: Any) -> None:
    open_page(browser, "cookbook/README")
    rows = browser.ask(
        """[...document.querySelectorAll("article tbody tr")].map(row => [
             row.querySelector("a").getAttribute("href"), row.cells[1].innerText
           ])"""
    )
    assert sorted(link for link, _ in rows) == sorted(f"{program}/README.html" for program in PROGRAMS)
    assert all(situation for _, situation in rows)


def test_links_to_programs_are_within_site(browser: Any) -> None:
    open_page(browser, "how-to/debounce")
    links = browser.ask("[...document.querySelectorAll('article a')].map(link => link.getAttribute('href'))")
    assert {"../cookbook/debounce/README.html", "../cookbook/door/README.html"} <= set(links)


def test_contributing_page_has_links(browser: Any) -> None:
    open_page(browser, "contributing")
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    headings = browser.ask("[...document.querySelectorAll('h1, h2, h3')].map(heading => heading.textContent)")
    expected = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    assert [heading.rstrip("#¶") for heading in headings] == [
        heading.replace("`", "") for heading in expected
    ]
    links = browser.ask("[...document.querySelectorAll('article a')].map(link => link.getAttribute('href'))")
    assert {"explanation/architecture.html", "reference/glossary.html"} <= set(links)
    open_page(browser, "explanation/architecture")
    assert browser.ask("document.querySelector('article a[href=\"../contributing.html\"]') !== null")


@pytest.mark.parametrize("page", PAGES_WITH_FILES, ids=lambda page: page.stem)
def test_captions_name_files_of_code_blocks(browser: Any, page: Path) -> None:
    open_page(browser, page.relative_to(DOCS).with_suffix("").as_posix())
    fences = [fence for fence in FENCE.finditer(page.read_text(encoding="utf-8")) if fence["name"]]
    captioned_blocks = [(name, text.strip("\n")) for name, text in browser.ask(CAPTIONED_BLOCKS)]
    assert captioned_blocks == [(fence["name"], fence["text"].strip("\n")) for fence in fences]


@pytest.mark.parametrize(("width", "column"), [(1920, 1100), (1400, 800)])
@pytest.mark.parametrize("page", WIDE_PAGES)
def test_wide_screen_cuts_no_table_or_code(browser: Any, page: str, width: int, column: int) -> None:
    browser.resize(width, 900)
    open_page(browser, page)
    layout = browser.ask(LAYOUT)
    assert layout["column"] >= column
    assert layout["page"] <= width
    assert layout["cut"] == []


@pytest.mark.parametrize("page", WIDE_PAGES)
def test_narrow_screen_does_not_scroll_sideways(browser: Any, page: str) -> None:
    browser.resize(400, 900)
    open_page(browser, page)
    layout = browser.ask(LAYOUT)
    assert layout["page"] <= 400
    assert 350 <= layout["column"] <= 400


def test_sentences_are_narrower_than_tables(browser: Any) -> None:
    browser.resize(1920, 900)
    open_page(browser, "reference/commands")
    widths = "[...document.querySelectorAll('{}')].map(box => box.getBoundingClientRect().width)"
    sentences = browser.ask(widths.format("article section > p"))
    assert max(sentences) < max(browser.ask(widths.format("article table")))


def test_start_page_has_picture_and_example(browser: Any) -> None:
    open_page(browser, "index")
    parts = browser.ask(
        "[...document.querySelectorAll('article :is(h1, h2, img, pre)')].map(part => part.tagName)"
    )
    assert parts[:5] == ["H1", "IMG", "H2", "PRE", "PRE"]
    picture = browser.ask(
        "(() => { const {alt, naturalWidth} = document.querySelector('article img'); return [alt, naturalWidth]; })()"
    )
    assert len(picture[0]) > 20
    assert picture[1] > 400
    paragraphs = browser.ask("[...document.querySelectorAll('article h1 ~ p')].map(part => part.innerText)")
    introduction = " ".join(paragraphs).strip()
    assert len(re.findall(r"\.(?:\s|$)", introduction)) == 2
    headings = browser.ask("[...document.querySelectorAll('article h2')].map(heading => heading.textContent)")
    assert [heading.rstrip("#¶") for heading in headings][:2] == ["Two commands", "An example"]


def test_site_without_repository_has_no_source_links(browser: Any) -> None:
    assert "repository" not in (ROOT / "package.xml").read_text(encoding="utf-8")
    open_page(browser, "how-to/debounce")
    assert browser.ask(SOURCE_LINKS) == []
    assert "Repository" not in browser.ask("document.querySelector('.sidebar-tree').innerText")


def build_copy_with_repository(folder: Path, address: Any) -> Any:
    """Copy the sources, set the repository in package.xml, build the site of the copy, and return the site."""
    ignored = shutil.ignore_patterns(".*", "_build", "__pycache__")
    shutil.copytree(ROOT, folder, ignore=ignored, symlinks=True)
    manifest = folder / "package.xml"
    text = manifest.read_text(encoding="utf-8")
    url = f'<url type="repository">{address}</url>'
    manifest.write_text(text.replace("<author>", f"{url}\n  <author>"), encoding="utf-8")
    installer = load_script(ROOT / "install.py", "site_installer")
    # The workspace of these sources has the virtual environment that has built their site.
    workspace = str(installer.default_workspace(ROOT, os.environ))
    build = subprocess.run(
        [sys.executable, "install.py", "--workspace", workspace, "docs"],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=600,
    )
    assert build.returncode == 0, build.stdout
    return folder / "docs" / "_build" / "html"


def test_site_with_repository_has_source_links(browser: Any, tmp_path: Path) -> None:
    address = "https://github.com/example/retalis"
    site = build_copy_with_repository(tmp_path / "retalis", address)
    for page, source in (
        ("how-to/debounce", "docs/how-to/debounce.md"),
        ("contributing", "CONTRIBUTING.md"),
        ("cookbook/door/README", "examples/cookbook/door/README.md"),
    ):
        browser.open(f"{site.as_uri()}/{page}.html")
        assert browser.ask(SOURCE_LINKS) == [
            f"{address}/blob/main/{source}",
            f"{address}/edit/main/{source}",
        ]
        assert browser.ask("document.querySelector('.sidebar-tree a.external').href") == address
    browser.open(f"{site.as_uri()}/search.html")
    assert browser.ask(SOURCE_LINKS) == []
