"""The page of situations, which `retalis help` searches: its rows, links and examples."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from retalis import Engine
from retalis.cli.command_line import COMMANDS
from retalis.cli.help_search import read_situations, split_words

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE = (DOCS / "reference" / "situations.md").read_text(encoding="utf-8")
SITUATIONS = read_situations()
ROS_COMMANDS = {"source", "roslaunch"}
"""Commands of ROS in examples."""


def test_each_row_of_the_page_is_a_situation() -> None:
    rows = [line for line in PAGE.splitlines() if line.startswith("| ")]
    tables = re.findall(
        r"^\| I want to \.\.\. \| take \| example \|\n\| --- \| --- \| --- \|$", PAGE, re.MULTILINE
    )
    assert len(SITUATIONS) == len(rows) - 2 * len(tables) >= 40
    assert len({situation.need for situation in SITUATIONS}) == len(SITUATIONS)


@pytest.mark.parametrize("situation", SITUATIONS, ids=lambda situation: situation.need)
def test_example_loads_and_page_exists(situation: Any) -> None:
    assert (DOCS.parent / situation.page).is_file()
    example = situation.example
    if example.startswith("?- "):
        assert Engine().query(example[3:].rstrip(".")) or "prev(" in example
    elif example.startswith("$ "):
        first, *arguments = shlex.split(example[2:])
        assert first in ROS_COMMANDS or arguments[0] in COMMANDS
    else:
        Engine().load(rules=example)


def test_each_guide_has_a_situation() -> None:
    guides = {path.name for path in (DOCS / "how-to").glob("*.md")} - {"index.md"}
    assert guides <= {situation.page.rpartition("/")[2] for situation in SITUATIONS}
    operator_pages = {situation.page for situation in SITUATIONS if "/language/" in situation.page}
    assert len(operator_pages) > 10


def test_keywords_are_lower_case() -> None:
    assert all(split_words(situation.keywords) for situation in SITUATIONS)
    assert all(situation.keywords == situation.keywords.lower() for situation in SITUATIONS)
