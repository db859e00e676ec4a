"""Programs of ``test/data/scenarios`` in the command ``events``."""

import json
from pathlib import Path
from typing import Any, List, NamedTuple

import pytest
from asserting_accessors import items
from events.program_runner import term_text
from events.test_scenarios import BASE, SCENARIOS, expected_results, short

from retalis import Operators, SyntaxFault, deref
from retalis.cli.command_line import main
from retalis.prolog.syntax.term_reader import read_program
from retalis.prolog.terms.timestamps import from_term

CLOCK = "datime(2001,1,1,1,0,0)"
STAMPED = ("event1_same_second",)
"""Scenarios with stamps of the clock, which differs from that of the command."""


class Run(NamedTuple):
    """Results of a scenario, as the command prints them.

    Attributes:
        status: exit status.
        error: text of standard error.
        events: texts of the events with their start and end in ns.
        memory_events: the same of the events about memories.
        printed: texts of all other printed terms.
        outputs: texts of the outputs.
    """

    status: int
    error: str
    events: List[Any]
    memory_events: List[Any]
    printed: List[Any]
    outputs: List[Any]


def run_scenario(data: Any, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command in the working folder."""
    status = main(write_inputs(data))
    captured = capsys.readouterr()
    run = Run(status, captured.err, [], [], [], [])
    for term in read_printed_terms(captured.out):
        functor_name = term[0].name if term.__class__ is tuple else ""
        if functor_name in ("event", "memory_event"):
            start, end = (from_term(stamp) for stamp in items(term[2]))
            events = run.events if functor_name == "event" else run.memory_events
            events.append((term_text(deref(term[1])), start, end))
        else:
            run.printed.append(term_text(term))
    run.outputs.extend(map(term_text, read_printed_terms(Path("outputs.out").read_text(encoding="utf-8"))))
    return run


def write_inputs(data: Any) -> List[str]:
    """Write the files of a scenario to the working folder; return the arguments of the command."""
    rules = data["rules"] if isinstance(data["rules"], list) else [data["rules"]]
    stream = [f"{goal}." for goal in data.get("goals_after_compile") or ()]
    for item in data["stream"]:
        if isinstance(item, dict):
            stream.append(f"{item['goal']}.")
        else:
            stream.append(f"event({item[0]},[{item[1][0]},{item[1][1]}]).")
    return [
        *("events", "--memory-events", "--clock", CLOCK),
        *("--outputs", "outputs.out", "--write-folder", "."),
        *write_option("goals", [f"{goal}." for goal in data["goals"]]),
        *(
            word
            for number, text in enumerate(rules)
            for word in write_option(f"rules{number}", text and [text])
        ),
        *write_option("stream", stream),
        *write_option("queries", [f"{goal}." for goal in data.get("queries") or ()]),
    ]


def write_option(name: str, lines: Any) -> Any:
    """Write a file and return its option; return no option without lines."""
    if not lines:
        return []
    with open(f"{name}.in", "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")
    return [f"--{name.rstrip('0123456789')}", f"{name}.in"]


def read_printed_terms(text: str) -> List[Any]:
    """Return the terms of a printed text."""
    read_terms = list(read_program(text, Operators.prolog(), "printed"))
    assert [read_term for read_term in read_terms if isinstance(read_term, SyntaxFault)] == []
    return [deref(read_term.term) for read_term in read_terms if not isinstance(read_term, SyntaxFault)]


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
    run = run_scenario(data, capsys)
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
