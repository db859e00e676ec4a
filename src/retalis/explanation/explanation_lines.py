"""Lines of explanations, and the texts of events, rules and times in them."""

from itertools import islice
from typing import Callable, Collection, Dict, Iterable, Iterator, List, Mapping, NamedTuple, Optional

from ..events.language.pattern_tree import occurrences as count_variables
from ..events.language.rule_labels import rule_title
from ..events.network.event_rule import EventRule
from ..events.network.lineage_graph import Occurrence
from ..foundation.source_places import line_of
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_writer import named_message_portray, write_term
from ..prolog.terms import timestamps
from ..prolog.terms.term_traversal import variables
from ..prolog.terms.types import Term, Var, deref

MAX_LINES_OF_A_KIND = 10
"""Maximum number of events, or of states, that are listed below a line."""


class ExplanationLine(NamedTuple):
    """A line of an explanation, and the lines below it.

    >>> ExplanationLine("the alarm", [ExplanationLine("the smoke", [])]).below[0].text
    'the smoke'
    """

    text: str
    below: List["ExplanationLine"]

    def indented(self, depth: int = 0) -> Iterator[str]:
        """Yield the line and all lines below it as text, indented by two spaces per level.

        >>> for line in ExplanationLine("the alarm", [ExplanationLine("the smoke", [])]).indented():
        ...     print(line)
        the alarm
          the smoke
        """
        yield "  " * depth + self.text
        for line in self.below:
            yield from line.indented(depth + 1)


class Explanation(NamedTuple):
    """Result of `explain`.

    >>> engine = Engine()
    >>> record_origins(engine)
    >>> engine.load(rules="alarm(X) <- smoke(X) seq heat(X).", source="mine")
    >>> engine.event("smoke(kitchen)", 1)
    >>> isinstance(explain(engine, "alarm(kitchen)"), Explanation)
    True

    Attributes:
        happened: whether the event happened.
        lines: if it happened, a tree for each occurrence; otherwise a tree for each rule that could have fired it,
            and hints such as retracted events.
    """

    happened: bool
    lines: List[ExplanationLine]


_MAX_EVENTS_FOR_FORM = 10
"""Number of events that are searched for a stamp: timers may be the first ones."""


class TimeFormat:
    """Text of intervals: ``at T`` for a point in time, ``[T1,T2]`` for others.

    Args:
        reference_time: nanoseconds since the epoch; times are shown in seconds relative to it. None for absolute
            times.
        occurrences: the recorded events, whose first stamps determine the form of absolute times of the clock.
    """

    def __init__(
        self, show: Callable[[Term], str], reference_time: Optional[int], occurrences: Iterable[Occurrence]
    ):
        self._show = show
        self._reference_time = reference_time
        self._clock_form = timestamps.ClockForm()
        for occurrence in islice(occurrences, _MAX_EVENTS_FOR_FORM):
            self._clock_form.convert(occurrence.start)

    def format_interval(self, start: int, end: int) -> str:
        """Return the text of an interval."""
        if start == end:
            return f"at {self.format_instant(start)}"
        return f"[{self._format_number(start)},{self._format_number(end)}]{self._unit_suffix}"

    def format_instant(self, instant: int) -> str:
        """Return the text of an instant."""
        return f"{self._format_number(instant)}{self._unit_suffix}"

    @property
    def _unit_suffix(self) -> str:
        return "" if self._reference_time is None else " s"

    def _format_number(self, instant: int) -> str:
        if self._reference_time is None:
            return self._show(timestamps.lazy_term(self._clock_form.convert(instant)))
        # A stamp before the start of the run counts as the start, as in the output of the commands.
        whole, remainder = divmod(max(0, int(instant) - self._reference_time), 10**9)
        fraction = f".{remainder:09d}".rstrip("0") if remainder else ""
        return f"{whole}{fraction}"


class ExplanationTexts:
    """Texts of the events and rules of a program.

    Args:
        operators: operators of the program's terms.
        reference_time: see `TimeFormat`.
        occurrences: the recorded events.
    """

    def __init__(
        self, operators: Operators, reference_time: Optional[int], occurrences: Iterable[Occurrence]
    ):
        self._operators = operators
        self._times = TimeFormat(self.format_term, reference_time, occurrences)

    def format_term(self, term: Term) -> str:
        """Return the text of a term."""
        return show_term(term, self._operators, {})

    def format_instant(self, instant: int) -> str:
        """Return the text of an instant."""
        return self._times.format_instant(instant)

    def format_event(self, occurrence: Occurrence) -> str:
        """Return the text of an event with its interval."""
        interval = self._times.format_interval(occurrence.start, occurrence.end)
        return f"{self.format_term(occurrence.term)} {interval}"

    def format_rule(self, rule: EventRule) -> str:
        """Return the text of a rule with its label and place, and with the present values of its variables."""
        label = "" if rule.label is None else f"{self.format_term(rule.label)}: "
        names = rule.definition.names
        text = show_term(rule.definition.term, self._operators, names_of_bound_variables(names), names)
        return f"rule {rule_title(f'{label}{text}', line_of(rule.place))}"


def show_term(
    term: Term, operators: Operators, names: Mapping[Var, str], field_named_variables: Collection[Var] = ()
) -> str:
    """Return the text of a term.

    Args:
        term: the term.
        operators: operators of the term's syntax.
        names: names of variables. Other variables are written as ``_`` if they occur once, otherwise as A, B, and so
            on.
        field_named_variables: variables of a rule that was written with named message slots.
    """
    counts = count_variables([term], None)
    used_names = set(names.values())
    letters = (name for name in map(chr, range(ord("A"), ord("Z") + 1)) if name not in used_names)
    shown_names = {}
    for var in variables(term):
        shown_names[var] = names.get(var) or ("_" if counts[var] == 1 else next(letters, "_"))
    portray = named_message_portray(
        term, operators, field_named_variables, quoted=True, variable_names=shown_names
    )
    return write_term(term, operators, quoted=True, wide=True, variable_names=shown_names, portray=portray)


def names_of_bound_variables(names: Mapping[Var, str]) -> Dict[Var, str]:
    """Return the names of a rule's variables, by the variables that they are bound to now.

    A variable of the head may be bound to an unbound variable of the event that is explained.
    """
    names_by_target: Dict[Var, str] = {}
    for var, name in names.items():
        target = deref(var)
        if isinstance(target, Var):
            names_by_target.setdefault(target, name)
    return names_by_target
