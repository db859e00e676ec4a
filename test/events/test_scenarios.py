"""Recorded programs of the original engine (``test/data/scenarios``, see its README for what counts).

`contradictions` names those that the language reference is not to follow.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from events.contradictions import CONTRADICTED, Contradiction
from events.stream_programs import term_text
from parsing import parse_term

from retalis import Engine, Operators, RetalisError, Settings, StreamClock, atom, deref, functor
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.terms.timestamps import SECOND, from_term, to_term

FOLDER = Path(__file__).parent.parent / "data" / "scenarios"
SCENARIOS = sorted(FOLDER.glob("*.json"))
OUTPUT = functor("output", 3)
MEMORY_EVENTS = ("memory_created", "memory_updated", "memory_deleted")
BASE = from_term(read_term("datime(2001,1,1,0,0,0)", Operators.prolog()).term)
NOW = from_term(read_term("datime(2001,1,1,1,0,0)", Operators.prolog()).term)


class Run:
    """One scenario run by the engine."""

    def __init__(self, data, folder):
        now = NOW if "Absolute" in str(data["rules"]) else BASE
        self.clock = StreamClock(now)
        self.engine = Engine(self.clock, Settings(write_folders=(str(folder),)))
        self.events, self.memory_events, self.outputs, self.errors = [], [], [], []
        self.engine.on_event(self._event)
        self.engine.on_output(
            lambda term, topic, name: self.outputs.append(term_text((OUTPUT, term, atom(topic), name)))
        )
        self.engine.rules.on_error = lambda error: self.errors.append(str(error))
        self.engine.logic.define("sleep", 1, self._sleep)
        self.engine.logic.define("current_datime", 1, lambda machine, term: machine.unify(term, to_term(NOW)))
        self._run(data, folder)

    def _sleep(self, machine, seconds):
        self.clock.move_to(self.clock.now() + int(deref(seconds) * SECOND))
        return True

    def _event(self, term, start, end):
        name = term[0].name if term.__class__ is tuple else term.name
        into = self.memory_events if name in MEMORY_EVENTS else self.events
        into.append((term_text(term), start, end))

    def _run(self, data, folder):
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

    def _solutions(self, goal):
        try:
            term = read_term(goal, self.engine.operators).term
            return [term_text(term) for _ in self.engine.logic.solutions(term)]
        except RetalisError as error:
            return f"error: {error}"

    def attempt(self, work):
        try:
            if work() is False:
                self.errors.append("fails")
        except RetalisError as error:
            self.errors.append(str(error))


def wanted_events(data, name):
    found = data.get(name + "_sane", data[name])
    return [
        (term_text(parse_term(term)), from_term(parse_term(start)), from_term(parse_term(end)))
        for term, start, end in found
    ]


def event_table(events):
    """Return events with their stamps as terms: they keep the form that they came in."""
    return [(term, write_term(to_term(start)), write_term(to_term(end))) for term, start, end in events]


def short(events):
    """Return events as ``term@start-end``, in seconds of the first minute (or of the epoch)."""

    def seconds(instant):
        return f"{(instant - BASE if instant >= BASE else instant) / SECOND:g}"

    return " ".join(f"{term}@{seconds(int(start))}-{seconds(int(end))}" for term, start, end in events)


@pytest.mark.slow
@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_scenario(path, tmp_path, monkeypatch):
    data = json.loads(path.read_text())
    for name, text in (data.get("files") or {}).items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    run = Run(data, tmp_path)
    wanted = wanted_of(path.stem, data)
    if wanted.short is not None:
        assert short(run.events) == wanted.short
    else:
        assert event_table(run.events) == event_table(wanted.events)
    assert run.outputs == wanted.outputs
    assert [term for term, _, _ in run.memory_events] == [term for term, _, _ in wanted.memory_events]
    assert [("an error" if answer.__class__ is str else answer) for answer in run.answers] == wanted.answers
    assert bool(run.errors) == wanted.errors


class Wanted(NamedTuple):
    """What a scenario is to give: as it was recorded, but where that is wrong.

    Attributes:
        short: the events that the language reference asks for against the recording, or None.
        events: events with their stamps, where there is no ``short``.
        answers: the solutions of each query, or "an error".
    """

    short: Any
    events: Any
    memory_events: Any
    outputs: Any
    answers: Any
    errors: bool


def wanted_of(name, data):
    other = CONTRADICTED.get(name, Contradiction(""))
    outputs = [
        f"output({one},{topic},{given})" for one, topic, given in data.get("outputs_sane", data["outputs"])
    ]
    sane = data.get("queries_sane")
    answers = []
    for at, result in enumerate(data.get("query_results") or ()):
        found = other.answers.get(at, result["solutions"] if sane is None else sane[at])
        failed = found and found[0].startswith("error: ")
        answers.append("an error" if failed else [term_text(parse_term(text)) for text in found])
    return Wanted(
        other.events,
        wanted_events(data, "expected"),
        wanted_events(data, "memory_events"),
        [term_text(parse_term(text)) for text in (outputs if other.outputs is None else other.outputs)],
        answers,
        bool(data.get("errors")) if other.errors is None else other.errors,
    )


def test_contradictions_are_known():
    assert set(CONTRADICTED) <= {path.stem for path in SCENARIOS}
