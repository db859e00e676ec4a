"""Programs of several operators, policies, memories and queries over short streams, with all results in order."""

import re
from pathlib import Path
from typing import Any, Dict, Iterator

import pytest
from events.program_runner import FUTURE, format_events, term_text

from retalis import Engine, StreamClock
from retalis.prolog.terms.timestamps import SECOND, to_term

FILE = Path(__file__).parent.parent / "data" / "programs.txt"
START = 978_307_200  # 2001
MEMORY_EVENTS = ("memory_created(", "memory_updated(", "memory_deleted(")


def programs() -> Iterator[Any]:
    for block in FILE.read_text(encoding="utf-8").split("\n## ")[1:]:
        name, *lines = block.strip().split("\n")
        parts: Dict[Any, Any] = {"goal": [], "rule": [], "stream": [], "events": [], "output": []}
        for line in lines:
            part, _, text = line.partition(" ")
            parts[part].append(text.strip())
        yield pytest.param(parts, id=name)


def timestamp(text: Any) -> Any:
    return to_term(START * SECOND + round(float(text) * SECOND))


@pytest.mark.slow
@pytest.mark.parametrize("parts", list(programs()))
def test_program_has_expected_events_and_outputs(parts: Any) -> None:
    engine = Engine(clock=StreamClock(FUTURE))
    events, outputs = [], []
    engine.on_event(
        lambda term, start, end: events.append((term, start - START * SECOND, end - START * SECOND))
    )
    engine.on_output(
        lambda term, topic, name: outputs.append(f"output({term_text(term)},{topic},{term_text(name)})")
    )
    engine.load(goals="\n".join(parts["goal"]))
    engine.load(rules="\n".join(parts["rule"]))
    for item in re.split(r"\s*;\s*", " ".join(parts["stream"])):
        if item.startswith("?"):
            assert engine.call(item[1:])
            continue
        term, _, interval = item.rpartition("@")
        first, _, last = interval.partition("-")
        engine.event(term, timestamp(first), timestamp(last or first))
    derived = [event for event in events if not term_text(event[0]).startswith(MEMORY_EVENTS)]
    assert format_events(derived) == " ".join(parts["events"])
    assert outputs == parts["output"]
