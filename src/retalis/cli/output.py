"""Events, outputs and solutions on standard output: as terms that read back, or as JSON."""

import json
import sys
from typing import IO, Dict, List, Optional

from ..events.knowledge.knowledge_base import OF_MEMORIES
from ..explanation.explain import Explanation, ExplanationLine
from ..prolog.syntax.term_writer import add_full_stop
from ..prolog.syntax.term_writer import canonical_text as text
from ..prolog.terms import timestamps
from ..prolog.terms.types import Term, atom, functor

EVENT = functor("event", 2)
MEMORY_EVENT = functor("memory_event", 2)
OUTPUT = functor("output", 3)
JSON = """\
with --json each line is one object. Terms are strings that read back; T, T1 and T2 are whole nanoseconds since
the epoch, whatever form the stamps have in terms:
"""


class Printer:
    """Prints what happens in a run.

    Args:
        as_json: print one JSON object a line, with stamps in nanoseconds.
        memory_events: print memory events too.
        outputs: takes what subscribers get; nothing does where it is None.
    """

    def __init__(self, as_json: bool, memory_events: bool, outputs: Optional[IO[str]]):
        self._json = as_json
        self._memory_events = memory_events
        self._outputs = outputs

    def event(self, term: Term, start: int, end: int) -> None:
        """Print an event."""
        memory = term.__class__ is tuple and term[0] in OF_MEMORIES
        if memory and not self._memory_events:
            return
        if self._json:
            self.line(
                {"memory_event" if memory else "event": text(term), "start": int(start), "end": int(end)}
            )
        else:
            interval = timestamps.interval_term(start, end)
            print(f"{text((MEMORY_EVENT if memory else EVENT, term, interval))}.", flush=True)

    def output(self, term: Term, topic: str, name: Term, instant: int) -> None:
        """Print what a subscriber gets."""
        if self._outputs is None:
            return
        if self._json:
            told = {"output": text(term), "topic": topic, "id": text(name), "time": int(instant)}
            self.line(told, self._outputs)
        else:
            print(f"{text((OUTPUT, term, atom(topic), name))}.", file=self._outputs, flush=True)

    def solutions(self, goal: Term, found: List[Term]) -> None:
        """Print the solutions of a query, each as the goal with its values."""
        if self._json:
            self.line({"query": text(goal), "solutions": [text(solution) for solution in found]})
            return
        for solution in found:
            print(add_full_stop(text(solution)), flush=True)

    def explanation(self, asked: Term, answer: Explanation) -> None:
        """Print why an event happened, or what was missing."""
        if self._json:
            because = [_as_json(line) for line in answer.lines]
            self.line({"explain": text(asked), "happened": answer.happened, "because": because})
            return
        print(f"% {text(asked)} {'happened' if answer.happened else 'did not happen'}")
        for line in answer.lines:
            for part in line.indented(1):
                print(f"% {part}")

    def line(self, content: Dict[str, object], file: Optional[IO[str]] = None) -> None:
        """Print a line of JSON."""
        print(json.dumps(content, ensure_ascii=False), file=file or sys.stdout, flush=True)


def _as_json(line: ExplanationLine) -> Dict[str, object]:
    return {"text": line.text, "below": [_as_json(one) for one in line.below]}
