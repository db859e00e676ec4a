"""The recorded programs of ``test/data/scenarios`` through the command line, as its help says."""

import json

import pytest
from events.stream_programs import term_text
from events.test_scenarios import BASE, SCENARIOS, short, wanted_of

from retalis import Operators, SyntaxFault, deref, list_items
from retalis.cli.command_line import main
from retalis.prolog.syntax.term_reader import read_program
from retalis.prolog.terms.timestamps import from_term

CLOCK = "datime(2001,1,1,1,0,0)"
STAMPED = ("event1_same_second",)
"""Where the clock, which is another here, gave the stamps."""


class Run:
    """One scenario; what was printed, as terms."""

    def __init__(self, data, capsys):
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
        arguments += written("goals", [f"{goal}." for goal in data["goals"]])
        for number, text in enumerate(rules):
            arguments += written(f"rules{number}", [text] if text else [])
        arguments += written("stream", stream)
        arguments += written("queries", [f"{goal}." for goal in data.get("queries") or ()])
        self.status = main(arguments)
        self.events, self.memory_events, self.printed = [], [], []
        shown = capsys.readouterr()
        self.error = shown.err
        for term in terms(shown.out):
            self._sort(term)
        with open("outputs.out", encoding="utf-8") as file:
            self.outputs = [term_text(term) for term in terms(file.read())]

    def _sort(self, term):
        kind = term[0].name if term.__class__ is tuple else ""
        if kind not in ("event", "memory_event"):
            self.printed.append(term_text(term))
            return
        start, end = (from_term(stamp) for stamp in list_items(term[2]))
        into = self.events if kind == "event" else self.memory_events
        into.append((term_text(deref(term[1])), start, end))


def written(name, lines):
    """Write a file; return the option for it, nothing where there is nothing to write."""
    if not lines:
        return []
    with open(f"{name}.in", "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")
    return [f"--{name.rstrip('0123456789')}", f"{name}.in"]


def terms(text):
    """Return the terms that were printed; other lines (what a program writes) are none."""
    found = []
    for line in text.splitlines():
        for read_back in read_program(line, Operators.prolog(), "printed"):
            if not isinstance(read_back, SyntaxFault):
                found.append(deref(read_back.term))
    return found


def agree(events, wanted):
    """Tell whether events are those wanted; the stamps that the clock gave may be later."""
    if len(events) != len(wanted):
        return False
    return all(
        one == other
        or (one[0] == other[0] and BASE <= other[1] <= min(BASE + 2, one[1]) and other[2] <= one[2])
        for one, other in zip(events, wanted)
    )


@pytest.mark.slow
@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_scenario(path, tmp_path, monkeypatch, capsys):
    data = json.loads(path.read_text(encoding="utf-8"))
    monkeypatch.chdir(tmp_path)
    for name, text in (data.get("files") or {}).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    run = Run(data, capsys)
    wanted = wanted_of(path.stem, data)
    if wanted.short is None or path.stem in STAMPED:
        assert agree(run.events, wanted.events)
    else:
        assert short(run.events) == wanted.short
    assert run.outputs == wanted.outputs
    assert [term for term, _, _ in run.memory_events] == [term for term, _, _ in wanted.memory_events]
    answers = [term for found in wanted.answers if found != "an error" for term in found]
    assert not answers or run.printed[-len(answers) :] == answers
    assert bool(run.error.count("error: ")) == (wanted.errors or "an error" in wanted.answers)
    assert run.status == bool(run.error.count("error: "))
