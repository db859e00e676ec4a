"""Printing of events, outputs, solutions and explanations as Prolog terms or as JSON."""

import sys
from typing import IO, Any, Dict, Iterable, List, Mapping, Optional, cast

from ..engine.run_records import OpenRecord, OpenStateRecord, OutputRecord
from ..events.knowledge.knowledge_base import MEMORY_EVENTS
from ..explanation.explanation_lines import Explanation, ExplanationLine
from ..foundation.displayed_text import format_count
from ..foundation.output_files import print_json
from ..prolog.syntax.term_writer import add_full_stop, canonical_text
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms import timestamps
from ..prolog.terms.list_terms import make_list
from ..prolog.terms.types import Term, atom, functor

EVENT_FUNCTOR = functor("event", 2)
MEMORY_EVENT_FUNCTOR = functor("memory_event", 2)
"""Functors of printed events: term and interval."""

OUTPUT_FUNCTOR = functor("output", 3)
"""Functor of printed outputs: term, topic and id of the subscription."""

JSON_HELP = """\
with --json each line is one object. Terms are texts that can be parsed as terms; T, T1 and T2 are whole nanoseconds
since the epoch, or since the start with --times=relative, for every form of stamps in terms:
"""


def redirect_goal_output(logic: PrologSystem) -> None:
    """Print the text that goals write to standard output on standard error, so that each line of output is JSON."""

    def write(text: str) -> None:
        sys.stderr.write(text)

    logic.print_to(write, write)


class TimeOrigin:
    """Start of a run, to which printed times are relative; an earlier stamp counts as the start.

    Args:
        start: nanoseconds since the epoch; None for the first time that is printed.
    """

    def __init__(self, start: Optional[int] = None):
        self.start = start

    def relative(self, instant: int) -> int:
        """Return the nanoseconds from the start to an instant, or 0 before the start."""
        if self.start is None:
            self.start = int(instant)
        return max(0, int(instant) - self.start)

    def relative_seconds(self, instant: int) -> float:
        """Return the seconds from the start to an instant, rounded once, so that 13 ms are printed as 0.013."""
        return self.relative(instant) / timestamps.SECOND

    def relative_record(self, record: Mapping[str, Any]) -> Dict[str, Any]:
        """Return a record of a run with relative times."""
        return {
            name: self.relative(value) if name in _TIME_FIELDS and isinstance(value, int) else value
            for name, value in record.items()
        }


_TIME_FIELDS = ("start", "end", "time")
"""Fields of the records of a run that are instants in nanoseconds."""


class Printer:
    """Printer of the events, outputs, solutions and explanations of a run.

    Args:
        as_json: whether to print one JSON object per line, with stamps in nanoseconds.
        memory_events: whether to print memory events, too.
        outputs: file for the outputs to subscribers; None to discard them.
        origin: start of the run for relative times; None for absolute times.
    """

    def __init__(
        self,
        as_json: bool,
        memory_events: bool,
        outputs: Optional[IO[str]],
        origin: Optional[TimeOrigin] = None,
    ):
        self._as_json = as_json
        self._prints_memory_events = memory_events
        self._output_file = outputs
        self._origin = origin
        self._clock_form = timestamps.ClockForm()

    def print_event(self, term: Term, start: int, end: int) -> None:
        """Print an event."""
        is_memory_event = term.__class__ is tuple and term[0] in MEMORY_EVENTS
        if is_memory_event and not self._prints_memory_events:
            return
        if self._as_json:
            self.print_json(
                {
                    "memory_event" if is_memory_event else "event": canonical_text(term),
                    "start": int(start),
                    "end": int(end),
                }
            )
        else:
            interval = timestamps.interval_term(
                self._clock_form.convert(start), self._clock_form.convert(end)
            )
            if self._origin is not None:
                interval = make_list(list(map(self._origin.relative_seconds, (start, end))))
            print(
                f"{canonical_text((MEMORY_EVENT_FUNCTOR if is_memory_event else EVENT_FUNCTOR, term, interval))}.",
                flush=True,
            )

    def print_output(self, term: Term, topic: str, name: Term, instant: int) -> None:
        """Print an output to a subscriber."""
        if self._output_file is None:
            return
        if self._as_json:
            content = OutputRecord(
                output=canonical_text(term), topic=topic, id=canonical_text(name), time=int(instant)
            )
            self.print_json(content, self._output_file)
        else:
            print(
                f"{canonical_text((OUTPUT_FUNCTOR, term, atom(topic), name))}.",
                file=self._output_file,
                flush=True,
            )

    def print_solutions(self, goal: Term, goal_instances: List[Term]) -> None:
        """Print the solutions of a query, each as an instance of the goal."""
        if self._as_json:
            self.print_json(
                {
                    "query": canonical_text(goal),
                    "solutions": [canonical_text(solution) for solution in goal_instances],
                }
            )
            return
        for solution in goal_instances:
            print(add_full_stop(canonical_text(solution)), flush=True)

    def print_open(self, records: Iterable[OpenRecord]) -> None:
        """Print the states and windows that are open."""
        for record in records:
            if self._as_json:
                self.print_json(record)
                continue
            start = record["start"]
            # Not converted to an int, which would lose the form in which the event states its time.
            instant: Term = timestamps.lazy_term(self._clock_form.convert(start))
            if self._origin is not None:
                instant = self._origin.relative_seconds(start)
            details = ""
            # The first field tells the types apart, as in lines of JSON.
            if "open" in record:
                subject = cast("OpenStateRecord", record)["open"]
            else:
                window = record
                key = ", ".join(f"{name} = {value}" for name, value in window["key"].items())
                subject = f"window {window['open_window']} of {window['name']}{key and f' for {key}'}"
                details = f", with {format_count(window['elements'], 'element')}"
            print(f"% {subject} is open since {canonical_text(instant)}{details}", flush=True)

    def print_explanation(self, term: Term, answer: Explanation) -> None:
        """Print the explanation of an event that happened or did not happen."""
        if self._as_json:
            because = [_line_to_json(line) for line in answer.lines]
            self.print_json(
                {"explain": canonical_text(term), "happened": answer.happened, "because": because}
            )
            return
        print(f"% {canonical_text(term)} {'happened' if answer.happened else 'did not happen'}")
        for line in answer.lines:
            for part in line.indented(1):
                print(f"% {part}")

    def print_json(self, content: Mapping[str, object], file: Optional[IO[str]] = None) -> None:
        """Print a line of JSON."""
        if self._origin is not None:
            content = self._origin.relative_record(content)
        print_json(content, file)


def _line_to_json(line: ExplanationLine) -> Dict[str, object]:
    return {"text": line.text, "below": [_line_to_json(part) for part in line.below]}
