"""Situation guide: its page and its examples."""

import re
import shlex
from pathlib import Path

import pytest
from doc_pages import load_script

from retalis import Engine
from retalis.cli.command_line import COMMANDS
from retalis.cli.help_search import split_words
from retalis.cli.situation_guide import SITUATIONS

DOCS = Path(__file__).resolve().parents[2] / "docs"
ALL_SITUATIONS = [situation for section in SITUATIONS.values() for situation in section]
page_text = load_script("situations").page_text
ROS_COMMANDS = {"source", "roslaunch"}
"""Commands of ROS in examples."""


def test_page_has_all_situations():
    page = DOCS / "reference" / "situations.md"
    assert page.read_text(encoding="utf-8") == page_text(), "run docs/situations.py"
    assert len(ALL_SITUATIONS) >= 40
    assert len({situation.need for situation in ALL_SITUATIONS}) == len(ALL_SITUATIONS)


@pytest.mark.parametrize("situation", ALL_SITUATIONS, ids=lambda situation: situation.need)
def test_example_is_valid_and_page_exists(situation):
    assert (DOCS / situation.page).is_file()
    example = situation.example
    if example.startswith("?- "):
        assert Engine().query(example[3:].rstrip(".")) or "prev(" in example
    elif example.startswith("$ "):
        command, *arguments = shlex.split(example[2:])
        assert command in ROS_COMMANDS or arguments[0] in COMMANDS
    else:
        Engine().load(rules=example)
    assert "\n" not in example
    assert "|" not in f"{example}{situation.solution}"


def test_each_guide_has_situation():
    guides = {path.name for path in (DOCS / "how-to").glob("*.md")} - {"index.md"}
    assert guides <= {situation.page.rpartition("/")[2] for situation in ALL_SITUATIONS}
    operators = re.findall(r"\]\((language/[\w-]+\.md)", page_text())
    assert len(set(operators)) > 10


def test_vocabulary_is_lower_case():
    assert all(split_words(situation.keywords) for situation in ALL_SITUATIONS)
    assert all(situation.keywords == situation.keywords.lower() for situation in ALL_SITUATIONS)
