"""Timelines of the language reference, drawn from the examples on its pages."""

from typing import Any

import pytest
from page_snippet_runner import ROOT
from script_modules import load_script

pytestmark = pytest.mark.docs

MAX_BYTES = 20_000
WITHOUT_PICTURES = {"index", "predicates", "declared-events"}
"""Pages that define no operator and no setting that changes events."""

timelines = load_script(ROOT / "docs" / "timelines.py")
PAGES = sorted(timelines.PAGES.glob("*.md"))
EXAMPLES = [example for page in PAGES for example in timelines.examples(page)]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.path.stem)
def test_picture_shows_events_of_example(example: Any) -> None:
    assert timelines.description(example.path) == example.text, "run docs/timelines.py"
    texts = timelines.texts(example.path)
    lanes = list(timelines.run_example(example.text))
    assert lanes
    for lane in lanes:
        assert lane.name in texts
        assert {label for _, _, label in lane.marks} - {""} <= set(texts)


def test_each_page_of_operator_has_picture() -> None:
    with_pictures = {page.stem for page in PAGES if any(timelines.examples(page))}
    assert {page.stem for page in PAGES} - with_pictures == WITHOUT_PICTURES


def test_pictures_are_small_and_all_used() -> None:
    pictures = set((timelines.PAGES / "pictures").iterdir())
    assert pictures == {example.path for example in EXAMPLES}
    assert len(EXAMPLES) == len(pictures)
    assert all(picture.stat().st_size <= MAX_BYTES for picture in pictures)
