"""The list of situations: its page, and its examples."""

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
ALL = [situation for section in SITUATIONS.values() for situation in section]
page_text = load_script("situations").page_text
ELSEWHERE = {"source", "roslaunch"}
"""Commands of ROS in examples."""


def test_the_page_has_the_list():
    page = DOCS / "reference" / "situations.md"
    assert page.read_text(encoding="utf-8") == page_text(), "run docs/situations.py"
    assert len(ALL) >= 40 and len({situation.need for situation in ALL}) == len(ALL)


@pytest.mark.parametrize("situation", ALL, ids=lambda situation: situation.need)
def test_examples_load_and_pages_exist(situation):
    assert (DOCS / situation.page).is_file()
    example = situation.example
    if example.startswith("?- "):
        assert Engine().query(example[3:].rstrip(".")) or "prev(" in example
    elif example.startswith("$ "):
        first, *arguments = shlex.split(example[2:])
        assert first in ELSEWHERE or arguments[0] in COMMANDS
    else:
        Engine().load(rules=example)
    assert "\n" not in example and "|" not in f"{example}{situation.solution}"


def test_every_guide_has_a_situation():
    guides = {path.name for path in (DOCS / "how-to").glob("*.md")} - {"index.md"}
    assert guides <= {situation.page.rpartition("/")[2] for situation in ALL}
    operators = re.findall(r"\]\((language/[\w-]+\.md)", page_text())
    assert len(set(operators)) > 10


def test_vocabulary_is_lower_case():
    assert all(split_words(situation.keywords) for situation in ALL)
    assert all(situation.keywords == situation.keywords.lower() for situation in ALL)
