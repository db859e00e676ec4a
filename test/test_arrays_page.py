"""Page about arrays: its programs load, and its goals and scripts have the output on the page."""

from pathlib import Path

import pytest
from page_snippet_runner import FENCE, PageRun

pytestmark = pytest.mark.docs

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "arrays.md"
FENCES = list(FENCE.finditer(PAGE.read_text(encoding="utf-8")))


def test_examples_have_output_of_page(tmp_path: Path) -> None:
    run = PageRun(tmp_path)
    assert FENCES
    for fence in FENCES:
        assert fence["kind"] in ("prolog", "console", "python", "text")
        assert run.result(fence) == fence["text"]
