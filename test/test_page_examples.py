"""Tutorials and explanations: commands, goals and rules have the output on the page.

A test with a master runs the tutorial about a live robot: ``test/ros1/test_live_robot_tutorial.py``.
"""

from pathlib import Path

import pytest
from page_snippet_runner import ROOT, PageRun

pytestmark = [pytest.mark.docs, pytest.mark.slow]

PAGES = [
    *(
        ROOT / "docs" / "tutorials" / f"{name}.md"
        for name in ("first-rule", "new-program", "robot-program", "nao")
    ),
    *(
        ROOT / "docs" / "explanation" / f"{name}.md"
        for name in ("how-it-works", "policies", "prolog-for-python")
    ),
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_snippets_have_output_of_page(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    PageRun(tmp_path).check_fences(page.read_text(encoding="utf-8"))
