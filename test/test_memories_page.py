"""The page about time and memories: the program of each section is run, and its goals answer as is shown."""

import re
from pathlib import Path

import pytest

from retalis import Engine, PrologError
from retalis.cli.toplevel_io import bindings
from retalis.prolog.syntax.term_reader import read_program, read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.system.prolog_system import PrologSystem

pytestmark = pytest.mark.docs

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "memories.md"
TEXT = PAGE.read_text(encoding="utf-8")
SECTIONS = re.split(r"^## ", TEXT, flags=re.MULTILINE)[1:]
SNIPPET = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)


def answered(engine, text):
    """Return the answers to a goal as the page shows them."""
    logic, found = engine.logic, []
    read = read_term(text, engine.operators)
    try:
        for _ in logic.solutions(read.term):
            found.append(bindings(read.names, engine.operators).replace(",\n", ", ") or "true")
    except PrologError as error:
        return write_term(error.term[1], engine.operators, quoted=True, spacing=True)
    return (" ;\n".join(found) or "false") + "."


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.split("\n", 1)[0])
def test_goals_answer_as_shown(section):
    engine, outputs, events = Engine(), [], []
    engine.on_output(lambda term, topic, name: outputs.append(f"{engine.show(term)} to {topic}"))
    engine.on_event(lambda term, start, end: events.append(term))
    for kind, text in SNIPPET.findall(section):
        if kind == "goals":
            engine.load(goals=text)
        elif kind == "prolog":
            engine.load(rules=text)
        elif kind == "stream":
            for read in read_program(text, engine.operators):
                engine.call(read.term)
        elif kind == "outputs":
            assert "\n".join(outputs) == text.strip()
        else:
            assert kind == "console"
            for shown in text.strip().split("\n\n"):
                goal, _, answer = shown.partition("\n")
                assert goal.startswith("?- ")
                assert (goal, answered(engine, goal[3:])) == (goal, answer)


def test_every_predicate_of_an_engine_is_on_a_page():
    """Those of the logic have a page of their own, with a test of its own."""
    added = {str(key) for key in Engine().logic.names()} - {str(key) for key in PrologSystem().names()}
    pages = " ".join(
        page.read_text(encoding="utf-8")
        for folder in ("reference", "how-to")
        for page in (PAGE.parents[1] / folder).rglob("*.md")
        if page != PAGE.parent / "predicates.md"
    )
    missing = {
        key
        for key in added
        if key[0] not in "$[" and not re.search(rf"\b{re.escape(key.rpartition('/')[0])}\b", pages)
    }
    assert missing == set()
