"""Driver of an engine in tests: events at times, and the results as texts, which pytest compares well."""

from pathlib import Path
from typing import List, Optional, Union

from ..engine.engine import Engine
from ..events.clock.clock import StreamClock
from ..events.knowledge.knowledge_base import MEMORY_EVENTS
from ..playback.playback import Playback
from ..prolog.syntax.term_writer import canonical_text
from ..prolog.terms import timestamps
from ..prolog.terms.types import Term
from .case_run import ProblemLog
from .expectation_checks import functor_of


class EngineDriver:
    """An engine whose clock is that of its events, and what it has produced.

    >>> driver = EngineDriver()
    >>> driver.load("alarm(X) <- smoke(X) seq absent(heat(X), 10).")
    >>> driver.event("smoke(kitchen)", 1)
    >>> driver.advance(20)
    >>> driver.events
    ['smoke(kitchen)', 'alarm(kitchen)']

    Args:
        program: folder of a program to load; None for an engine without program.

    Attributes:
        events: events since the last `clear`, as texts.
        outputs: outputs since the last `clear`, as texts ``TOPIC: TERM``.
        problems: errors and warnings; the log of the package while `ProblemLog.attached` is active.
    """

    def __init__(self, program: Union[None, str, Path] = None):
        self.events: List[str] = []
        self.outputs: List[str] = []
        self.problems = ProblemLog(str)
        if program is None:
            self._clock = StreamClock()
            self.engine = Engine(self._clock)
        else:
            playback = Playback(program, self.problems.add_error)
            self._clock, self.engine = playback.clock, playback.engine
        self.engine.on_event(self._add_event)
        self.engine.on_output(self._add_output)

    def load(self, rules: str = "", goals: str = "") -> None:
        """Load rules and goals from texts; see `Engine.load`."""
        self.engine.load(rules, goals)

    def event(self, term: Union[str, Term], at: float, start: Optional[float] = None) -> None:
        """Process an event at a time in seconds, after the alarms that are due.

        Args:
            term: the event.
            at: its end, to which the clock advances.
            start: its start; by default ``at``.
        """
        self.advance(at)
        self.engine.event(term, at if start is None else start, at)

    def advance(self, to: float) -> None:
        """Advance the clock to a time in seconds; each alarm that is due fires at its own time."""
        limit = timestamps.from_seconds(to)
        self._clock.fire_alarms(limit, self.engine.advance)
        self._clock.move_to(limit)
        self.engine.advance()

    def clear(self) -> None:
        """Forget all events and outputs."""
        self.events.clear()
        self.outputs.clear()

    def _add_event(self, term: Term, start: int, end: int) -> None:
        if functor_of(term) not in MEMORY_EVENTS:
            self.events.append(canonical_text(term))

    def _add_output(self, term: Term, topic: str, name: Term) -> None:
        self.outputs.append(f"{topic}: {canonical_text(term)}")
