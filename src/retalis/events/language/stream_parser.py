"""Parser of windows ``aggregate(K, Q, R, W)``, of rate operators ``P with S``, and of subscription patterns.

A window determines which matches of Q are aggregated together: the last ones by time or count (sliding), adjacent
ones (tumbling), overlapping ones (hopping), or the rows of a row pattern. K names the measures, R the results.

A rate operator S passes some matches of P only: ``throttle``, ``burst``, ``debounce`` and ``change`` correspond to
throttleFirst, leading-edge debounce, debounce and distinctUntilChanged of ReactiveX. A subscription takes a single
event, optionally with a rate operator.
"""

from typing import TYPE_CHECKING, Any, Dict, List, NamedTuple, Optional, Protocol, Sequence, Set, Tuple

from ...foundation.errors import RuleError, UsageError
from ...prolog.terms import timestamps
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.timestamps import from_seconds
from ...prolog.terms.types import Atom, CompoundTerm, Term, Var, atom, deref, functor, functor_name
from ..streams.aggregates import AGGREGATES
from .event_operators import SPELLINGS
from .likely_mistakes import bracket_advice, suggestion
from .pattern_tree import EventPattern, Pattern, RatePattern, WindowPattern, WindowSpec, bound_by
from .row_pattern_parser import parse_row_pattern, steps_term

if TYPE_CHECKING:
    from .pattern_parser import PatternReader

_ABSENT_FUNCTOR, _AGGREGATE_FUNCTOR = functor("absent", 2), functor("aggregate", 4)
MIN_STEP_NANOSECONDS = 1_000_000
"""Minimum time between two results of a window, in ns."""
MAX_WINDOWS = 10_000
"""Maximum number of windows of ``last(N, every(M))`` that contain one event."""
MAX_WINDOW_ITEMS = 1_000_000
"""Maximum size of a window of a number of events."""


class OperandReader(Protocol):
    """Reader of patterns: `PatternReader` for rules, `_SingleEvent` for subscriptions."""

    def operand(self, parent: CompoundTerm, number: int, operator: str) -> Pattern:
        """Return the pattern of an operand."""

    def span(self, name: str, term: CompoundTerm) -> int:
        """Return the second argument of a term, a number of seconds, in nanoseconds."""

    def error(self, message: str, term: Term, number: int = 0) -> RuleError:
        """Return an error at a term, or at one of its arguments."""


class RateOperatorNotation(NamedTuple):
    """Notation of a rate operator.

    Attributes:
        form: the forms in words, with and without a key.
        timed: whether the first argument is a number of seconds; if not, it is the value that must change.
    """

    form: str
    timed: bool


RATE_OPERATORS: Dict[str, RateOperatorNotation] = {
    "throttle": RateOperatorNotation("throttle(Seconds) or throttle(Seconds, Key)", True),
    "burst": RateOperatorNotation("burst(Seconds) or burst(Seconds, Key)", True),
    "debounce": RateOperatorNotation("debounce(Seconds) or debounce(Seconds, Key)", True),
    "change": RateOperatorNotation("change(Value) or change(Value, Key)", False),
}
"""Rate operators, by name."""

_WINDOW_NOTATIONS = (
    "last(Seconds), last(N, events), last(Seconds, every(Seconds)), every(Seconds), every(Seconds, first), "
    "every(N, events), running(every(...)), or steps([Step, ...])"
)


_WINDOW_NAMES = frozenset(("last", "every", "running", "steps"))
_STEP_RESTRICTION = "of"


def is_event(term: CompoundTerm) -> bool:
    """Return whether a term with the name of a stream operator is an event, judged by its arguments.

    Programs older than these operators may contain such events.
    """
    if term[0] is _ABSENT_FUNCTOR:
        return deref(term[2]).__class__ not in (int, float)
    if term[0] is not _AGGREGATE_FUNCTOR:
        return False
    function, window = deref(term[1]), deref(term[4])
    name = functor_name(function)
    is_aggregate = name in AGGREGATES or name == _STEP_RESTRICTION or list_items(function) is not None
    # Both the kind and the window must look foreign: a misspelt kind with a proper window is reported as an error,
    # instead of being taken for an event that never occurs.
    return not is_aggregate and not (window.__class__ is tuple and window[0].name in _WINDOW_NAMES)


def regroup_rate_operator(term: CompoundTerm) -> Optional[CompoundTerm]:
    """Return ``(P with S) op Q`` for ``P with (S op Q)``, the form that is parsed without brackets; otherwise None.

    A rate operator is not a pattern, so an operator to the right of it applies to all of ``P with S``.
    """
    outer_operations: List[CompoundTerm] = []
    operator = deref(term[2])
    # ``with`` binds more loosely than the operators that may follow, so they are parsed as part of its right operand.
    while operator.__class__ is tuple and operator[0] in SPELLINGS:
        outer_operations.append(operator)
        operator = deref(operator[1])
    if not outer_operations or operator.__class__ is not tuple or operator[0].name not in RATE_OPERATORS:
        return None
    regrouped: CompoundTerm = (term[0], term[1], operator)
    for operation in reversed(outer_operations):
        regrouped = (operation[0], regrouped, *operation[2:])
    return regrouped


def parse_rate_operator(reader: OperandReader, term: CompoundTerm) -> RatePattern:
    """Return the pattern ``P with S``.

    Raises:
        RuleError: if the rate operator is malformed, or uses a variable that P does not bind.
    """
    pattern = reader.operand(term, 1, "with")
    operator: Any = deref(term[2])
    name = operator[0].name if operator.__class__ is tuple else ""
    if name not in RATE_OPERATORS or len(operator) not in (2, 3):
        notations = "; ".join(part.form for part in RATE_OPERATORS.values())
        error_position = (operator,) if operator.__class__ is tuple else (term, 2)
        raise reader.error(
            f"with needs one of {notations}{suggestion(name, RATE_OPERATORS)}", *error_position
        )
    span, value = 0, None
    if RATE_OPERATORS[name].timed:
        span = _parse_seconds(reader, name, operator, 1)
    else:
        value = deref(operator[1])
    keys: Tuple[Term, ...] = ()
    if len(operator) == 3:
        items = list_items(operator[2])
        # A key is one term or a list of terms.
        keys = tuple(items if items is not None else [deref(operator[2])])
    pattern_variables = set(bound_by(pattern))
    for number, used in ((1, value), *((2, part) for part in keys)):
        if used is not None and any(var not in pattern_variables for var in variables(used)):
            raise reader.error(f"{name} uses a variable that no event of its pattern binds", operator, number)
    return RatePattern(pattern, name, span, value, keys)


def parse_window(reader: "PatternReader", term: CompoundTerm) -> WindowPattern:
    """Return the pattern ``aggregate(K, Q, R, W)``.

    Raises:
        RuleError: if a measure or the window is malformed, or a measured variable is not bound by Q.
    """
    functions = deref(term[1])
    # One measure, or a list of measures over the same window.
    function_list = list_items(functions)
    if function_list is not None and not function_list:
        raise reader.error("an aggregate needs at least one kind", term, 1)
    function_terms = [functions] if function_list is None else [deref(measure) for measure in function_list]
    restricted_measures = [_split_step_restriction(measure) for measure in function_terms]
    measures = [_parse_measure(reader, measure, term) for _, measure in restricted_measures]
    collected = reader.operand(term, 2, "aggregate")
    pattern_variables = set(bound_by(collected))
    for (_, measure), (_, _, value) in zip(restricted_measures, measures):
        if value is not None and any(var not in pattern_variables for var in variables(value)):
            raise reader.error("a measured value has a variable that no event in the window binds", measure)
    # For a list of measures, the result is a list of the same length, or a variable for the whole list.
    result_terms = list_items(term[3]) if function_list is not None else None
    if result_terms is not None and len(result_terms) != len(function_terms):
        raise reader.error(
            f"{len(function_terms)} aggregates have {len(function_terms)} results, not {len(result_terms)}",
            term,
            3,
        )
    results = tuple(
        [deref(term[3])] if result_terms is None else [deref(measure) for measure in result_terms]
    )
    window = _parse_window_term(reader, deref(term[4]), term, pattern_variables)
    scopes = _step_numbers(reader, [step for step, _ in restricted_measures], window, term)
    # The rate is computed between the first and the last event of a window.
    if "rate" in [name for name, _, _ in measures] and window.kind == "batch" and window.max_count == 1:
        raise reader.error("rate needs a window of at least two events", term, 4)
    names, settings, values = zip(*measures)
    is_listed = function_list is not None and result_terms is None
    return WindowPattern(collected, names, settings, values, results, is_listed, window, scopes)


def _split_step_restriction(measure: Any) -> Tuple[Any, Any]:
    """Return the step that a measure is restricted to, or None, and the measure."""
    if measure.__class__ is tuple and measure[0].name == _STEP_RESTRICTION and len(measure) == 3:
        return deref(measure[1]), deref(measure[2])
    return None, measure


def _step_numbers(
    reader: "PatternReader", steps: Sequence[Any], window: WindowSpec, term: CompoundTerm
) -> Tuple[Optional[int], ...]:
    """Return for each measure the number of the step that it is restricted to, or None."""
    names = [atom(window_step.name) for window_step in window.steps]
    for step in steps:
        if step is not None and step not in names:
            hint = f"; there are {', '.join(window_step.name for window_step in names)}" if names else ""
            message = f"of(Step, Kind) needs the name of a step of a window of steps{hint}"
            raise reader.error(message, term, 1)
    return tuple([None if step is None else names.index(step) for step in steps])


def _parse_measure(
    reader: "PatternReader", function: Any, term: CompoundTerm
) -> Tuple[str, Any, Optional[Term]]:
    """Return the name of a measure, its setting, and the measured term."""
    name = functor_name(function)
    arguments: Sequence[Term] = function[1:] if function.__class__ is tuple else ()
    error_position = (function,) if function.__class__ is tuple else (term, 1)
    measure = AGGREGATES.get(name)
    if measure is None or len(arguments) != measure.arity:
        notations = ", ".join(aggregate.notation for aggregate in AGGREGATES.values())
        raise reader.error(
            f"there is no such aggregate; the aggregates are {notations}{suggestion(name, AGGREGATES)}",
            *error_position,
        )
    settings = [deref(argument) for argument in arguments[: measure.setting_count]]
    setting: Any = None
    if name == "quantile":
        setting = settings[0]
        if setting.__class__ not in (int, float) or not 0 <= setting <= 1:
            raise reader.error("quantile needs a number from 0 to 1", *error_position)
    elif settings:
        setting = tuple(settings)
        if not all(argument.__class__ is Atom for argument in settings):
            raise reader.error(f"{measure.notation} needs the names of three predicates", *error_position)
    return name, setting, deref(arguments[-1]) if measure.has_value else None


def _parse_window_term(
    reader: "PatternReader", window: Any, term: CompoundTerm, pattern_variables: Set[Var]
) -> WindowSpec:
    """Return the window that a term denotes; ``pattern_variables`` are the variables that the pattern binds."""
    name = window[0].name if window.__class__ is tuple else ""
    if name == "steps" and len(window) == 2:
        steps, navigated_vars = parse_row_pattern(reader, window, pattern_variables)
        return WindowSpec("steps", steps=steps, navigated_vars=navigated_vars)
    if name == "running" and len(window) == 2:
        tumbling = _parse_window_term(reader, deref(window[1]), term, pattern_variables)
        # Sliding windows and row patterns emit at each match in any case, and hopping windows overlap.
        if tumbling.kind not in ("every", "first", "batch") or tumbling.span != tumbling.step:
            raise reader.error(
                "running needs every(Seconds), every(Seconds, first) or every(N, events)", window
            )
        return tumbling._replace(running=True)
    second: Any = deref(window[2]) if window.__class__ is tuple and len(window) == 3 else None
    option = second.name if second.__class__ is Atom else ""
    if name not in ("last", "every") or len(window) not in (2, 3):
        option = "wrong"
    elif option == "events":
        size = deref(window[1])
        if size.__class__ is not int or not 1 <= size <= MAX_WINDOW_ITEMS:
            raise reader.error(f"{name} needs a number of events from 1 to {MAX_WINDOW_ITEMS}", window, 1)
        return WindowSpec("newest" if name == "last" else "batch", max_count=size)
    elif len(window) == 2:
        span = _parse_seconds(reader, name, window, 1)
        return WindowSpec(name, span, span) if name == "last" else _hopping_window(reader, window, span, span)
    elif name == "every" and option == "first":
        span = _parse_seconds(reader, name, window, 1)
        return WindowSpec("first", span, span)
    elif name == "last" and second.__class__ is tuple and second[0].name == "every" and len(second) == 2:
        return _hopping_window(
            reader,
            window,
            _parse_seconds(reader, name, window, 1),
            _parse_seconds(reader, "every", second, 1),
        )
    raise reader.error(
        f"a window is {_WINDOW_NOTATIONS}", *((window,) if window.__class__ is tuple else (term, 4))
    )


def _hopping_window(reader: "PatternReader", window: CompoundTerm, span: int, step: int) -> WindowSpec:
    """Return windows that the clock closes, at regular times."""
    # One event that arrives late can close all windows that it is too new for, so their number must be bounded.
    if step < MIN_STEP_NANOSECONDS or span > MAX_WINDOWS * step:
        message = f"every needs 0.001 seconds at least, and last no more than {MAX_WINDOWS} times those of its every"
        raise reader.error(message, window)
    return WindowSpec("every", span, step)


def _parse_seconds(reader: OperandReader, name: str, term: CompoundTerm, number: int) -> int:
    seconds = deref(term[number])
    if (
        seconds.__class__ not in (int, float)
        or not seconds > 0
        or seconds == float("inf")
        or not from_seconds(seconds)
    ):
        raise reader.error(
            f"{name} needs a positive number of seconds{bracket_advice(name, seconds)}", term, number
        )
    return from_seconds(seconds)


def rate_operator_term(shaped: RatePattern) -> Term:
    """Return the term of a rate operator."""
    first = timestamps.to_seconds(shaped.span) if shaped.value is None else shaped.value
    if not shaped.by:
        return functor(shaped.shape, 1)(first)
    keys = shaped.by[0] if len(shaped.by) == 1 else make_list(shaped.by)
    return functor(shaped.shape, 2)(first, keys)


def window_term(window: WindowSpec) -> Term:
    """Return the term of a window."""
    if window.kind == "steps":
        return steps_term(window.steps)
    every, every_with_option = functor("every", 1), functor("every", 2)
    span = timestamps.to_seconds(window.span)
    if window.kind == "last":
        return functor("last", 1)(span)
    if window.kind == "newest":
        return functor("last", 2)(window.max_count, atom("events"))
    if window.kind == "batch":
        term = every_with_option(window.max_count, atom("events"))
    elif window.kind == "first":
        term = every_with_option(span, atom("first"))
    elif window.span == window.step:
        term = every(span)
    else:
        term = functor("last", 2)(span, every(timestamps.to_seconds(window.step)))
    return functor("running", 1)(term) if window.running else term


_SINGLE_EVENT_ERROR = "a subscription takes single events: write a rule that raises an event for the pattern"
_TRAILING_OPERATOR_ERROR = "a subscription takes P with S without further operators"


def subscription_event(term: Term) -> Term:
    """Return the event pattern of a subscription: P of ``P with S``, otherwise the whole term."""
    pattern: Any = deref(term)
    return deref(pattern[1]) if _operator_name(pattern) == "with" else pattern


def subscription_rate_operator(term: Term) -> Optional[RatePattern]:
    """Return the rate operator of a subscription, or None.

    Raises:
        UsageError: if the operator is malformed, or other operators follow it.
    """
    pattern: Any = deref(term)
    try:
        if _operator_name(pattern) == "with":
            if regroup_rate_operator(pattern) is not None:
                raise UsageError(_TRAILING_OPERATOR_ERROR)
            return parse_rate_operator(_SingleEvent(), pattern)
    except RuleError as error:
        raise UsageError(error.message) from None
    operand = pattern
    # The operator that follows a rate operator is the outermost one: it is found by descending to the left.
    while _operator_name(operand):
        operand = deref(operand[1])
        if _operator_name(operand) == "with":
            raise UsageError(_TRAILING_OPERATOR_ERROR)
    return None


def _operator_name(term: Any) -> str:
    return SPELLINGS.get(term[0], "") if term.__class__ is tuple else ""


class _SingleEvent:
    """Reader for the pattern of a subscription, which is a single event; see `OperandReader`."""

    def operand(self, parent: CompoundTerm, number: int, operator: str) -> Pattern:
        event = deref(parent[number])
        if event.__class__ not in (tuple, Atom, Var) or _operator_name(event):
            raise self.error(_SINGLE_EVENT_ERROR, event)
        return EventPattern(event)

    def span(self, name: str, term: CompoundTerm) -> int:
        # Only patterns of several events have a duration.
        raise self.error(_SINGLE_EVENT_ERROR, term)

    def error(self, message: str, term: Term, number: int = 0) -> RuleError:
        return RuleError(message)
