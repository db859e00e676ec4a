"""Recorded programs of the original engine (``test/data/scenarios``, whose README lists the compared results).

`contradicted_recordings` lists the scenarios that contradict the language reference.
"""

import json
from pathlib import Path
from typing import Any, List, NamedTuple, Tuple

import pytest
from asserting_accessors import number
from events.contradicted_recordings import CONTRADICTED, Contradiction
from events.program_runner import term_text
from parsing import parse_term
from recording_reports import RecordingReports

from retalis import Engine, Operators, RetalisError, Settings, StreamClock, atom, functor
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.terms.timestamps import SECOND, from_term, to_term

FOLDER = Path(__file__).parent.parent / "data" / "scenarios"
SCENARIOS = sorted(FOLDER.glob("*.json"))
OUTPUT = functor("output", 3)
MEMORY_EVENTS = ("memory_created", "memory_updated", "memory_deleted")
BASE = from_term(read_term("datime(2001,1,1,0,0,0)", Operators.prolog()).term)
NOW = from_term(read_term("datime(2001,1,1,1,0,0)", Operators.prolog()).term)


class ScenarioRun:
    """A scenario executed by the engine; with ``counts_uses``, as for the coverage by tests."""

    def __init__(self, data: Any, folder: Any, counts_uses: bool = False) -> None:
        now = NOW if "Absolute" in str(data["rules"]) else BASE
        self.clock = StreamClock(now)
        self.reports = RecordingReports()
        self.engine = Engine(
            self.clock, Settings(write_folders=(str(folder),), counts_uses=counts_uses), self.reports
        )
        self.events: List[Any] = []
        self.memory_events: List[Any] = []
        self.outputs: List[Any] = []
        self.has_failed = False
        self.engine.on_event(self._event)
        self.engine.on_output(
            lambda term, topic, name: self.outputs.append(term_text((OUTPUT, term, atom(topic), name)))
        )
        self.engine.logic.define("sleep", 1, self._sleep)
        self.engine.logic.define("current_datime", 1, lambda machine, term: machine.unify(term, to_term(NOW)))
        self._run(data, folder)

    def _sleep(self, machine: Any, seconds: Any) -> bool:
        self.clock.move_to(self.clock.now() + int(number(seconds) * SECOND))
        return True

    def _event(self, term: Any, start: Any, end: Any) -> None:
        name = term[0].name if term.__class__ is tuple else term.name
        events_of_kind = self.memory_events if name in MEMORY_EVENTS else self.events
        events_of_kind.append((term_text(term), start, end))

    def _run(self, data: Any, folder: Any) -> None:
        for goal in data["goals"]:
            self.attempt(lambda goal=goal: self.engine.call(goal))
        rules = data["rules"]
        for text in rules if isinstance(rules, list) else [rules]:
            if text:
                self.attempt(lambda text=text: self.engine.load(rules=text, folder=folder))
        for goal in data.get("goals_after_compile", ()):
            self.attempt(lambda goal=goal: self.engine.call(goal))
        for item in data["stream"]:
            if isinstance(item, dict):
                self.attempt(lambda item=item: self.engine.call(item["goal"]))
            else:
                term, (start, end) = item
                self.clock.move_to(from_term(parse_term(end)))
                self.attempt(
                    lambda t=term, s=start, e=end: self.engine.event(t, parse_term(s), parse_term(e))
                )
            self.engine.advance()
        self.answers = [self._solutions(goal) for goal in data.get("queries", ())]

    def _solutions(self, goal: Any) -> Any:
        try:
            term = read_term(goal, self.engine.operators).term
            return [term_text(term) for _ in self.engine.logic.solutions(term)]
        except RetalisError as error:
            return f"error: {error}"

    def attempt(self, work: Any) -> None:
        try:
            if work() is False:
                self.has_failed = True
        except RetalisError:
            self.has_failed = True


def expected_events(data: Any, name: str) -> List[Tuple[Any, ...]]:
    rows = data.get(name + "_sane", data[name])
    return [
        (term_text(parse_term(term)), from_term(parse_term(start)), from_term(parse_term(end)))
        for term, start, end in rows
    ]


def event_table(events: Any) -> List[Tuple[Any, ...]]:
    """Return events with their timestamps as terms, which preserves the form of the timestamps."""
    return [(term, write_term(to_term(start)), write_term(to_term(end))) for term, start, end in events]


def short(events: Any) -> str:
    """Return events as ``term@start-end``, in seconds of the first minute (or of the epoch)."""

    def seconds(instant: int) -> str:
        return f"{(instant - BASE if instant >= BASE else instant) / SECOND:g}"

    return " ".join(f"{term}@{seconds(int(start))}-{seconds(int(end))}" for term, start, end in events)


@pytest.mark.slow
@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_scenario_has_recorded_results(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = json.loads(path.read_text())
    for name, text in (data.get("files") or {}).items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    run = ScenarioRun(data, tmp_path)
    expected = expected_results(path.stem, data)
    if expected.short is not None:
        assert short(run.events) == expected.short
    else:
        assert event_table(run.events) == event_table(expected.events)
    assert run.outputs == expected.outputs
    assert [term for term, _, _ in run.memory_events] == [term for term, _, _ in expected.memory_events]
    assert [("an error" if answer.__class__ is str else answer) for answer in run.answers] == expected.answers
    assert (run.has_failed or bool(run.reports.recorded_errors)) == expected.errors


@pytest.mark.slow
@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_counting_changes_no_result(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = json.loads(path.read_text())
    results = []
    for counts_uses in (False, True):
        folder = tmp_path / str(counts_uses)
        folder.mkdir()
        for name, text in (data.get("files") or {}).items():
            (folder / name).write_text(text)
        monkeypatch.chdir(folder)
        run = ScenarioRun(data, folder, counts_uses)
        answers = [str(answer).replace(str(folder), "") for answer in run.answers]
        results.append((run.events, run.outputs, run.memory_events, answers, run.has_failed))
    assert results[0] == results[1]


class ExpectedResults(NamedTuple):
    """Expected results of a scenario: those of the recording, unless it contradicts the reference.

    Attributes:
        short: the events that the reference requires against the recording, or None.
        events: events with their timestamps, if ``short`` is None.
        answers: the solutions of each query, or "an error".
    """

    short: Any
    events: Any
    memory_events: Any
    outputs: Any
    answers: Any
    errors: bool


def expected_results(name: Any, data: Any) -> ExpectedResults:
    contradiction = CONTRADICTED.get(name, Contradiction(""))
    outputs = [
        f"output({term},{topic},{identifier})"
        for term, topic, identifier in data.get("outputs_sane", data["outputs"])
    ]
    sane = data.get("queries_sane")
    answers: List[Any] = []
    for index, result in enumerate(data.get("query_results") or ()):
        solutions = contradiction.answers.get(index, result["solutions"] if sane is None else sane[index])
        failed = solutions and solutions[0].startswith("error: ")
        answers.append("an error" if failed else [term_text(parse_term(text)) for text in solutions])
    return ExpectedResults(
        contradiction.events,
        expected_events(data, "expected"),
        expected_events(data, "memory_events"),
        [
            term_text(parse_term(text))
            for text in (outputs if contradiction.outputs is None else contradiction.outputs)
        ],
        answers,
        bool(data.get("errors")) if contradiction.errors is None else contradiction.errors,
    )


def test_contradictions_are_scenarios() -> None:
    assert set(CONTRADICTED) <= {path.stem for path in SCENARIOS}
