"""Programs of ``test/data/scenarios`` in the command ``events``."""

import json
from pathlib import Path
from typing import Any, List

import pytest
from checked_access import items
from events.program_runner import term_text
from events.test_scenarios import BASE, SCENARIOS, expected_results, short

from retalis import Operators, SyntaxFault, deref
from retalis.cli.command_line import main
from retalis.prolog.syntax.term_reader import read_program
from retalis.prolog.terms.timestamps import from_term

CLOCK = "datime(2001,1,1,1,0,0)"
STAMPED = ("event1_same_second",)
"""Scenarios with stamps of the clock, which differs from that of the command."""


class Run:
    """A scenario and its printed terms."""

    def __init__(self, data: Any, capsys: pytest.CaptureFixture[str]) -> None:
        rules = data["rules"] if isinstance(data["rules"], list) else [data["rules"]]
        stream = [f"{goal}." for goal in data.get("goals_after_compile") or ()]
        for item in data["stream"]:
            if isinstance(item, dict):
                stream.append(f"{item['goal']}.")
            else:
                stream.append(f"event({item[0]},[{item[1][0]},{item[1][1]}]).")
        arguments = [
            "events",
            "--memory-events",
            "--clock",
            CLOCK,
            "--outputs",
            "outputs.out",
            "--write-folder",
            ".",
        ]
        arguments += write_option("goals", [f"{goal}." for goal in data["goals"]])
        for number, text in enumerate(rules):
            arguments += write_option(f"rules{number}", [text] if text else [])
        arguments += write_option("stream", stream)
        arguments += write_option("queries", [f"{goal}." for goal in data.get("queries") or ()])
        self.status = main(arguments)
        self.events: List[Any] = []
        self.memory_events: List[Any] = []
        self.printed: List[Any] = []
        captured = capsys.readouterr()
        self.error = captured.err
        for term in read_printed_terms(captured.out):
            self._add_term(term)
        with open("outputs.out", encoding="utf-8") as file:
            self.outputs = [term_text(term) for term in read_printed_terms(file.read())]

    def _add_term(self, term: Any) -> None:
        functor_name = term[0].name if term.__class__ is tuple else ""
        if functor_name not in ("event", "memory_event"):
            self.printed.append(term_text(term))
            return
        start, end = (from_term(stamp) for stamp in items(term[2]))
        events = self.events if functor_name == "event" else self.memory_events
        events.append((term_text(deref(term[1])), start, end))


def write_option(name: str, lines: Any) -> Any:
    """Write a file and return its option; return no option without lines."""
    if not lines:
        return []
    with open(f"{name}.in", "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")
    return [f"--{name.rstrip('0123456789')}", f"{name}.in"]


def read_printed_terms(text: str) -> Any:
    """Return the printed terms, without other lines that a program prints."""
    printed_terms: List[Any] = []
    for line in text.splitlines():
        for read_term in read_program(line, Operators.prolog(), "printed"):
            if not isinstance(read_term, SyntaxFault):
                printed_terms.append(deref(read_term.term))
    return printed_terms


def events_agree(events: Any, expected_events: Any) -> bool:
    """Return whether events are the expected ones, where stamps of the clock may be later."""
    if len(events) != len(expected_events):
        return False
    return all(
        event == expected
        or (
            event[0] == expected[0]
            and BASE <= expected[1] <= min(BASE + 2, event[1])
            and expected[2] <= event[2]
        )
        for event, expected in zip(events, expected_events)
    )


@pytest.mark.slow
@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_recorded_scenario_is_reproduced(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    data = json.loads(path.read_text(encoding="utf-8"))
    monkeypatch.chdir(tmp_path)
    for name, text in (data.get("files") or {}).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    run = Run(data, capsys)
    expected = expected_results(path.stem, data)
    if expected.short is None or path.stem in STAMPED:
        assert events_agree(run.events, expected.events)
    else:
        assert short(run.events) == expected.short
    assert run.outputs == expected.outputs
    assert [term for term, _, _ in run.memory_events] == [term for term, _, _ in expected.memory_events]
    answers = [term for solutions in expected.answers if solutions != "an error" for term in solutions]
    assert not answers or run.printed[-len(answers) :] == answers
    assert bool(run.error.count("error: ")) == (expected.errors or "an error" in expected.answers)
    assert run.status == bool(run.error.count("error: "))
