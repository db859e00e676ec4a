"""The page about clouds, images and maps: its goals answer as is shown."""

import pytest
from doc_pages import ROOT, PageRun

pytestmark = pytest.mark.docs

PAGE = ROOT / "docs" / "reference" / "sensors.md"


def test_page_shows_what_happens(tmp_path):
    pytest.importorskip("numpy")
    PageRun(tmp_path).check_fences(PAGE.read_text(encoding="utf-8"))
