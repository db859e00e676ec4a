"""Command ``help``: search in situations, pages, programs and predicates."""

import json
from typing import Any, List

import pytest
from parsed_sources import ROOT

from retalis.cli import help_search
from retalis.cli.command_line import main
from retalis.cli.help_search import all_entries, search, stem_word, suggest_words


@pytest.fixture(scope="module")
def entries() -> Any:
    return all_entries()


def pages(matches: Any) -> List[Any]:
    return [match.page.rpartition("/")[2] for match in matches]


def test_best_match_has_operator_example_and_page(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", "missing", "message"]) == 0
    first = capsys.readouterr().out.partition("\n\n")[0]
    assert first.splitlines() == [
        "know that a message is missing for N seconds",
        "  take     P seq absent(Q, N)",
        "  example  lost(R) <- heartbeat(R) seq absent(heartbeat(R), 2).",
        "  page     docs/how-to/missing-message.md",
    ]


@pytest.mark.parametrize(
    ("words", "title"),
    [
        ("battery low", "warn about a low battery, at most once a minute"),
        ("low battery", "warn about a low battery, at most once a minute"),
        ("door open too long", "know that a door is open for too long"),
        ("count in the last hour", "count events in the last minute"),
        ("I want to debounce a button", "debounce a button"),
        ("stuck", "detect that a robot is stuck"),
        (
            "nth_integer_root_and_remainder",
            "nth_integer_root_and_remainder(+Degree, +Integer, ?Root, ?Remainder)",
        ),
    ],
)
def test_best_match_of_words(entries: Any, words: str, title: str) -> None:
    assert search(words, entries)[0].title == title


@pytest.mark.parametrize(
    ("words", "page"),
    [
        ("DEBOUNCING", "debounce.md"),
        ("too many alerts", "limit-alerts.md"),
        ("averages", "average-over-window.md"),
        ("interpolation of tf", "transform-at-time.md"),
        ("last seen object", "last-place.md"),
        ("retries", "count-attempts.md"),
        ("test in ci", "test-in-ci.md"),
        ("memory leak", "limit-memory.md"),
        ("two robots", "two-robots.md"),
        ("crashes", "survive-restart.md"),
        ("cluster", "many-bags.md"),
        ("ontology", "swi-prolog.md"),
        ("hysteresis", "noisy-threshold.md"),
        ("timeout action", "task-timeout.md"),
        ("forall_seq", "seq.md"),
        ("state file format", "state-files.md"),
        ("substring of an atom", "predicates.md"),
    ],
)
def test_words_lead_to_page(entries: Any, words: str, page: str) -> None:
    assert page in pages(search(words, entries))


def test_json_has_matches_in_order_of_text(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", "missing", "message"]) == 0
    titles = [block.partition("\n")[0] for block in capsys.readouterr().out.strip().split("\n\n")]
    assert main(["help", "missing", "message", "--json"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [record["title"] for record in records] == titles
    assert records[0] == {
        "title": "know that a message is missing for N seconds",
        "kind": "situation",
        "excerpt": "P seq absent(Q, N)",
        "example": "lost(R) <- heartbeat(R) seq absent(heartbeat(R), 2).",
        "page": "docs/how-to/missing-message.md",
    }


def test_text_of_section_is_cut_at_80_columns(entries: Any) -> None:
    section = search("state file format", entries)[0]
    title, excerpt, page = section.lines()
    assert (title, page) == (section.title, f"  page     {section.page}")
    assert excerpt.startswith("  text     ")
    assert excerpt.endswith(" ...")
    assert len(excerpt) <= 80


def test_json_without_words_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", "--json"]) == 1
    assert capsys.readouterr() == ("", "retalis: help --json: expected words to search\n")


@pytest.mark.parametrize(
    ("words", "program"),
    [
        ("debounce", "debounce"),
        ("door left open", "door"),
        ("gripper lost", "slip"),
        ("laser scan near", "obstacle"),
        ("emergency stop", "emergency_stop"),
    ],
)
def test_words_lead_to_program_of_cookbook(entries: Any, words: str, program: str) -> None:
    assert f"examples/cookbook/{program}/README.md" in [match.page for match in search(words, entries)]


def test_program_is_printed_with_its_situation(entries: Any) -> None:
    (program,) = [match for match in entries if match.title == "Program door"]
    assert program.lines() == [
        "Program door",
        "  detects  opened, closed, left open, and for how long",
        "  page     examples/cookbook/door/README.md",
    ]


def test_all_programs_of_cookbook_are_searched(entries: Any) -> None:
    programs = [path.parent.name for path in (ROOT / "examples" / "cookbook").glob("*/eventRules.txt")]
    names = [match.title[len("Program ") :] for match in entries if match.kind == "program"]
    assert sorted(names) == sorted(programs)


def test_number_of_matches_is_limited(entries: Any) -> None:
    assert len(search("event", entries)) == help_search.MAX_MATCHES


def test_unknown_words_do_not_hide_matches(entries: Any) -> None:
    assert search("debounce xyzzy", entries)[0].title == "debounce a button"


def test_search_without_words_prints_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help"]) == 0
    assert "retalis help missing message" in capsys.readouterr().out


def test_search_without_matches_suggests_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", "debonce"]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("retalis: help: nothing is found for 'debonce': did you mean debounce")
    assert main(["help", "xyzzy"]) == 1
    assert capsys.readouterr().err.endswith(": see docs/reference/situations.md\n")
    assert "hysteresis" in suggest_words("hysterises")


def test_stop_words_count_only_alone(entries: Any) -> None:
    assert "(P and Q) within N" in [match.excerpt for match in search("and", entries)]
    assert search("", entries) == search("?", entries) == []


def test_missing_documentation_is_an_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(help_search, "docs_folder", lambda: None)
    assert main(["help", "debounce"]) == 1
    assert capsys.readouterr().err.startswith("retalis: help: the documentation is not installed: expected ")


def test_forms_of_a_word_have_one_stem() -> None:
    assert len({stem_word(word) for word in ("cancel", "cancels", "cancelled", "cancelling")}) == 1
    assert stem_word("is") == "is"
    assert stem_word("bus") == "bus"
