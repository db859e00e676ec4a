"""Page about time and memories: the goals of each section have the answers on the page."""

import re
from pathlib import Path
from typing import Any

import pytest
from page_snippet_runner import FENCE, PageRun

from retalis import Engine
from retalis.prolog.system.prolog_system import PrologSystem

pytestmark = pytest.mark.docs

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "memories.md"
TEXT = PAGE.read_text(encoding="utf-8")
SECTIONS = re.split(r"^## ", TEXT, flags=re.MULTILINE)[1:]


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.split("\n", 1)[0])
def test_goals_have_answers_of_page(section: Any, tmp_path: Path) -> None:
    run = PageRun(tmp_path)
    fences = list(FENCE.finditer(section))
    assert fences
    for fence in fences:
        assert fence["kind"] in ("goals", "prolog", "stream", "outputs", "console")
        assert run.result(fence) == fence["text"]


def test_each_predicate_of_engine_is_on_a_page() -> None:
    """The predicates of Prolog are tested with their own page."""
    added = {str(key) for key in Engine().logic.names()} - {str(key) for key in PrologSystem().names()}
    pages = " ".join(
        page.read_text(encoding="utf-8")
        for folder in ("reference", "how-to")
        for page in (PAGE.parents[1] / folder).rglob("*.md")
        if page != PAGE.parent / "predicates.md"
    )
    missing = {
        key
        for key in added
        if key[0] not in "$[" and not re.search(rf"\b{re.escape(key.rpartition('/')[0])}\b", pages)
    }
    assert len(added) > 50
    assert missing == set()
