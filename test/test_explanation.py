"""The pages that explain: goals, rules, events and Python give what the page shows."""

import pytest
from doc_pages import FENCE, ROOT, PageRun

pytestmark = [pytest.mark.docs, pytest.mark.slow]

PAGES = [
    ROOT / "docs" / "explanation" / f"{name}.md" for name in ("how-it-works", "policies", "prolog-for-python")
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_page_shows_what_happens(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = PageRun(tmp_path)
    for fence in FENCE.finditer(page.read_text(encoding="utf-8")):
        assert run.result(fence) == fence["text"]
