"""The tutorials: their files are written, their commands run, and they print what the page shows."""

import pytest
from doc_pages import FENCE, ROOT, PageRun

pytestmark = [pytest.mark.docs, pytest.mark.slow]

PAGES = [ROOT / "docs" / "tutorials" / f"{name}.md" for name in ("first-rule", "robot-program")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_each_step_does_what_the_page_says(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = PageRun(tmp_path)
    for fence in FENCE.finditer(page.read_text(encoding="utf-8")):
        assert run.result(fence) == fence["text"]
