"""``retalis help WORD`` and the page of situations, which have one source."""

import re
import shlex
from pathlib import Path

import pytest
from doc_pages import load_script

from retalis import Engine
from retalis.cli import situation_guide
from retalis.cli.command_line import COMMANDS, main
from retalis.cli.situation_guide import SITUATIONS, find_situations, stem_word, suggest_words

DOCS = Path(__file__).resolve().parents[2] / "docs"
ALL = [situation for section in SITUATIONS.values() for situation in section]
page_text = load_script("situations").page_text
ELSEWHERE = {"source", "roslaunch"}
"""Commands of ROS in examples."""


def test_a_word_finds_situations_with_operator_example_and_page(capsys):
    assert main(["help", "missing"]) == 0
    first = capsys.readouterr().out.partition("\n\n")[0]
    assert first.splitlines() == [
        "know that a message is missing for N seconds",
        "  take     P seq absent(Q, N)",
        "  example  lost(R) <- heartbeat(R) seq absent(heartbeat(R), 2).",
        "  page     docs/how-to/missing-message.md",
    ]


@pytest.mark.parametrize(
    "words, page",
    [
        ("missing message", "missing-message.md"),
        ("DEBOUNCING", "debounce.md"),
        ("too many alerts", "limit-alerts.md"),
        ("averages", "average-over-window.md"),
        ("interpolation of tf", "transform-at-time.md"),
        ("last seen object", "last-place.md"),
        ("retries", "count-attempts.md"),
        ("test", "test-in-ci.md"),
        ("debugging", "why-no-match.md"),
        ("memory leak", "limit-memory.md"),
        ("robots", "two-robots.md"),
        ("crashes", "survive-restart.md"),
        ("cluster", "many-bags.md"),
        ("ontology", "swi-prolog.md"),
        ("hysteresis", "noisy-threshold.md"),
        ("throttle", "limit-alerts.md"),
        ("timeout action", "task-timeout.md"),
        ("forall_seq", "seq.md"),
    ],
)
def test_words_of_users_lead_to_the_page(words, page):
    assert page in {situation.page.rpartition("/")[2] for situation in find_situations(words)}


def test_words_of_the_wish_come_before_keywords():
    first, *others = find_situations("debounce")
    assert first.need == "debounce a button"
    assert find_situations("stuck")[0].need == "detect that a robot is stuck"


def test_without_words_it_says_how_to_use_it(capsys):
    assert main(["help"]) == 0
    assert "retalis help missing" in capsys.readouterr().out


def test_near_words_are_suggested(capsys):
    assert main(["help", "debonce"]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("retalis help: no situation has all words of 'debonce': did you mean debounce")
    assert main(["help", "xyzzy"]) == 1
    assert capsys.readouterr().err.endswith(": see docs/reference/situations.md\n")
    assert suggest_words("missing hysteresis") == ["missing", "hysteresis"]


def test_words_of_a_question_are_ignored_unless_they_are_all():
    assert find_situations("I want to debounce a button") == find_situations("debounce button")
    assert "(P and Q) within N" in {situation.solution for situation in find_situations("and")}
    assert find_situations("") == find_situations("?") == []


def test_many_matches_are_cut(capsys, monkeypatch):
    monkeypatch.setattr("retalis.cli.situation_guide.MAX_MATCHES", 1)
    assert main(["help", "window"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith(" more: add a word")


def test_forms_of_a_word_have_one_stem():
    assert len({stem_word(word) for word in ("cancel", "cancels", "cancelled", "cancelling")}) == 1
    assert stem_word("is") == "is" and stem_word("bus") == "bus"


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
    assert all(situation_guide.split_words(situation.keywords) for situation in ALL)
    assert all(situation.keywords == situation.keywords.lower() for situation in ALL)
