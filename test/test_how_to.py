"""Guides of ``how-to``: commands, goals and Python code have the output on the page."""

import re
from pathlib import Path

import pytest
from page_snippet_runner import ROOT, PageRun

pytestmark = [pytest.mark.docs, pytest.mark.slow]

PAGES = sorted((ROOT / "docs" / "how-to").glob("*.md"))
MAX_WORDS, MAX_WORDS_OF_PAGE = 16_950, 700
QUESTIONS = "analyse-results"
"""Page with ten questions, each answered twice; `test_analyse_results_page` runs it."""


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.stem != QUESTIONS], ids=lambda page: page.stem
)
def test_snippets_have_output_of_page(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = PageRun(tmp_path)
    for section in re.split(r"^(?=## )", page.read_text(encoding="utf-8"), flags=re.MULTILINE):
        run.start_section()
        run.check_fences(section)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_page_ends_with_links_and_is_short(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert text.rstrip().splitlines()[-1].startswith("**See also**: ")
    assert page.stem == QUESTIONS or len(text.split()) <= MAX_WORDS_OF_PAGE


def test_index_has_all_pages_and_total_is_limited() -> None:
    index = (ROOT / "docs" / "how-to" / "index.md").read_text(encoding="utf-8")
    assert {page.name for page in PAGES} - {"index.md"} == set(re.findall(r"\]\(([\w-]+\.md)\)", index))
    assert sum(len(page.read_text(encoding="utf-8").split()) for page in PAGES) <= MAX_WORDS
