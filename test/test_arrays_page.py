"""The page about arrays: its programs are loaded, and its goals and scripts answer as is shown."""

from pathlib import Path

import pytest
from doc_pages import FENCE, PageRun

pytestmark = pytest.mark.docs

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "arrays.md"
FENCES = list(FENCE.finditer(PAGE.read_text(encoding="utf-8")))


def test_examples_answer_as_shown(tmp_path):
    run = PageRun(tmp_path)
    for fence in FENCES:
        assert fence["kind"] in ("prolog", "console", "python", "text")
        assert run.result(fence) == fence["text"]
