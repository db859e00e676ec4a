"""Runner of programs over short streams; ``a@1 b(2)@3-5`` denotes a stream, and the derived events."""

from typing import Any, List

from recording_reports import RecordingReports

from retalis import Engine, Settings, StreamClock, functor
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.terms.term_traversal import copy, variables
from retalis.prolog.terms.timestamps import SECOND

FUTURE = 1_000_000 * SECOND


def term_text(term: Any) -> str:
    term = copy(term)
    for number, var in enumerate(variables(term)):
        var.ref = (functor("$VAR", 1), number)
    return write_term(term, None, quoted=True, ignore_ops=True, numbervars=True)


def seconds(text: Any) -> Any:
    return float(text) if "." in text else int(text)


class ProgramRunner:
    """An engine with a program; ``feed`` returns the events derived from a stream, without the stream itself."""

    def __init__(
        self, rules: str = "", flags: Any = (), policy: Any = None, clock: Any = None, folder: Any = None
    ) -> None:
        settings = Settings() if folder is None else Settings(folders=(str(folder),))
        self.reports = RecordingReports()
        self.engine = Engine(clock or StreamClock(FUTURE), settings, self.reports)
        self.events: List[Any] = []
        self.engine.on_event(lambda *event: self.events.append(event))
        if policy:
            self.set("event_consumption_policy", policy)
        for flag in flags:
            self.set(*flag) if isinstance(flag, tuple) else self.set(flag, "on")
        if rules:
            self.engine.load(rules=rules)

    @property
    def errors(self) -> List[Any]:
        return self.reports.recorded_errors

    @property
    def warnings(self) -> List[Any]:
        return self.reports.recorded_warnings

    def set(self, flag: str, value: str) -> None:
        assert self.engine.call(f"set_etalis_flag({flag},{value})")

    def feed(self, stream: str) -> str:
        derived: List[Any] = []
        for item in stream.split():
            term, stamp = item.rsplit("@", 1)
            start, _, end = stamp.partition("-")
            del self.events[:]
            self.engine.event(term, seconds(start), seconds(end or start))
            derived += self.events[1:]
        return format_events(derived)


def format_events(events: Any) -> str:
    return " ".join(
        f"{term_text(term)}@{start / SECOND:.12g}-{end / SECOND:.12g}" for term, start, end in events
    )


def outputs_of(rules: Any, stream: Any, policy: Any = None, flags: Any = ()) -> Any:
    """Return the events that a program derives from a stream."""
    return ProgramRunner(rules, flags, policy).feed(stream)
