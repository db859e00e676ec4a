"""Page about clouds, images and maps: its goals have the answers on the page."""

from pathlib import Path

import pytest
from page_snippet_runner import ROOT, PageRun

pytestmark = pytest.mark.docs

PAGE = ROOT / "docs" / "reference" / "sensors.md"


def test_goals_have_answers_of_page(tmp_path: Path) -> None:
    pytest.importorskip("numpy")
    PageRun(tmp_path).check_fences(PAGE.read_text(encoding="utf-8"))
