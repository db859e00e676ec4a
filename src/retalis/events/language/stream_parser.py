"""Parser of windows ``aggregate(K, Q, R, W)``, of rate operators ``P with S``, and of subscription patterns.

A window determines which matches of Q are aggregated together: the last ones by time or count (sliding), adjacent
ones (tumbling), overlapping ones (hopping), those without a pause (session), or the rows of a row pattern. K is a
measure or a list of measures, and R the result or the list of their results.

A rate operator S passes some matches of P only: ``throttle``, ``burst``, ``debounce`` and ``change`` correspond to
throttleFirst, leading-edge debounce, debounce and distinctUntilChanged of ReactiveX. A subscription takes a single
event, optionally with a rate operator.
"""

from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from ...foundation.errors import RuleError, UsageError
from ...foundation.similar_names import did_you_mean
from ...prolog.terms import timestamps
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.timestamps import MAX_TIMESTAMP, SECOND, from_seconds
from ...prolog.terms.types import (
    Atom,
    CompoundTerm,
    Term,
    Var,
    atom,
    deref,
    functor,
    functor_name,
)
from ..streams.aggregates import AGGREGATES, Setting
from ..streams.held_value_windows import HELD_AGGREGATES, MAX_HELD_STEPS
from ..streams.rate_operators import RATE_OPERATORS
from .event_operators import OPERATOR_NAMES
from .likely_mistakes import bracket_advice, operator_name
from .pattern_tree import (
    DURATION,
    AbsencePattern,
    EventPattern,
    NotPrecededPattern,
    Pattern,
    RatePattern,
    WindowPattern,
    WindowSpec,
    bound_by,
)
from .row_pattern_parser import parse_row_pattern, row_pattern_term

if TYPE_CHECKING:
    from .pattern_parser import PatternReader

_ABSENT_FUNCTOR, _AGGREGATE_FUNCTOR = functor("absent", 2), functor("aggregate", 4)
NOT_PRECEDED = functor("not_preceded", 2)
MIN_STEP_NANOSECONDS = 1_000_000
"""Minimum time between two results of a window, in ns."""
MAX_OVERLAPPING_WINDOWS = 10_000
"""Maximum number of windows of ``last(N, every(M))`` that contain one event."""
MAX_WINDOW_ITEMS = 1_000_000
"""Maximum size of a window that contains a number of events."""

CreateError = Callable[..., RuleError]
"""Takes a message, a term, and optionally the position of the argument that is wrong; returns the error."""


_WINDOW_NOTATIONS = (
    "last(Seconds), last(N, events), last(Seconds, every(Seconds)), every(Seconds), every(Seconds, first), "
    "every(N, events), running(every(...)), session(Seconds), session(Seconds, max(Seconds)), held(Window), "
    "held(Window, max(Seconds)), steps([Step, ...]), steps([Step, ...], [Option, ...]), "
    "or timed_out(steps(...), Seconds)"
)


_TIMED_OUT = functor("timed_out", 2)
_WINDOW_NAMES = frozenset(("last", "every", "running", "session", "held", "steps", _TIMED_OUT.name))
_STEP_MEASURE_NAME = "of"
_HELD = "held"
_HELD_NOTATION = "held needs last(Seconds), every(Seconds) or last(Seconds, every(Seconds))"


def is_event(term: CompoundTerm) -> bool:
    """Return whether a term with the name of a stream operator is an event, judged by its arguments.

    Programs older than these operators may contain such events.
    """
    if term[0] is _ABSENT_FUNCTOR:
        return deref(term[2]).__class__ not in (int, float)
    if term[0] is not _AGGREGATE_FUNCTOR:
        return False
    measure_term, window = deref(term[1]), deref(term[4])
    name = functor_name(measure_term)
    is_aggregate = name in AGGREGATES or name == _STEP_MEASURE_NAME or list_items(measure_term) is not None
    # The term is an event only if neither the measure nor the window is known. With a valid window, an unknown
    # measure is reported as a misspelling.
    return not is_aggregate and not (window.__class__ is tuple and window[0].name in _WINDOW_NAMES)


def is_computed_timeout(term: CompoundTerm) -> bool:
    """Return whether the right operand of a sequence is an ``absent`` whose time is a variable.

    Elsewhere such a term is an event.
    """
    return term[0] is _ABSENT_FUNCTOR and deref(term[2]).__class__ is Var


def regroup_rate_operator(term: CompoundTerm) -> Optional[CompoundTerm]:
    """Return ``(P with S) op Q`` for ``P with (S op Q)``, the form that is parsed without brackets; otherwise None.

    A rate operator is not a pattern, so an operator to the right of it applies to all of ``P with S``.
    """
    outer_operations: List[CompoundTerm] = []
    operator = deref(term[2])
    # ``with`` binds more loosely than the operators that may follow, so they are parsed as part of its right operand.
    while operator.__class__ is tuple and operator[0] in OPERATOR_NAMES:
        outer_operations.append(operator)
        operator = deref(operator[1])
    if not outer_operations or operator.__class__ is not tuple:
        return None
    if operator[0].name not in RATE_OPERATORS and operator[0] is not NOT_PRECEDED:
        return None
    regrouped: CompoundTerm = (term[0], term[1], operator)
    for operation in reversed(outer_operations):
        regrouped = (operation[0], regrouped, *operation[2:])
    return regrouped


def parse_not_preceded(reader: "PatternReader", term: CompoundTerm) -> Optional[NotPrecededPattern]:
    """Return the pattern ``P with not_preceded(Q, N)``; None for another operator.

    Raises:
        RuleError: if N is not a positive number.
    """
    operator: Any = deref(term[2])
    if operator.__class__ is not tuple or operator[0] is not NOT_PRECEDED:
        return None
    pattern = reader.read_operand(term, 1, "with")
    negated = reader.read_operand(operator, 1, NOT_PRECEDED.name)
    span = parse_seconds(NOT_PRECEDED.name, operator, 2, reader.create_error)
    return NotPrecededPattern(pattern, negated, span)


def parse_rate_operator(
    term: CompoundTerm, pattern: Pattern, create_error: CreateError, further_notations: Sequence[str] = ()
) -> RatePattern:
    """Return the pattern ``P with S``.

    Args:
        term: the term ``P with S``.
        pattern: the parsed pattern P.
        create_error: creates the error that is raised.
        further_notations: notations of other operators that may follow ``with``.

    Raises:
        RuleError: if the rate operator is malformed, or uses a variable that P does not bind.
    """
    operator: Any = deref(term[2])
    name = operator[0].name if operator.__class__ is tuple else ""
    if name not in RATE_OPERATORS or len(operator) not in (2, 3):
        rate_notations = [rate_operator.notation for rate_operator in RATE_OPERATORS.values()]
        notations = "; ".join([*rate_notations, *further_notations])
        names = [*RATE_OPERATORS, *(notation.partition("(")[0] for notation in further_notations)]
        error_position = (operator,) if operator.__class__ is tuple else (term, 2)
        raise create_error(f"with needs one of {notations}{did_you_mean(name, names)}", *error_position)
    span, value = 0, None
    if RATE_OPERATORS[name].takes_seconds:
        span = parse_seconds(name, operator, 1, create_error)
    else:
        value = deref(operator[1])
    keys: Tuple[Term, ...] = ()
    if len(operator) == 3:
        items = list_items(operator[2])
        # A key is one term or a list of terms.
        keys = tuple(items if items is not None else [deref(operator[2])])
    pattern_variables = set(bound_by(pattern))
    for argument_number, used_term in ((1, value), *((2, key) for key in keys)):
        if used_term is not None and any(var not in pattern_variables for var in variables(used_term)):
            message = f"{name} uses a variable that no event of its pattern binds"
            raise create_error(message, operator, argument_number)
    return RatePattern(pattern, name, span, value, keys)


def parse_window(reader: "PatternReader", term: CompoundTerm) -> WindowPattern:
    """Return the pattern ``aggregate(K, Q, R, W)``.

    Raises:
        RuleError: if a measure or the window is malformed, or a measured variable is not bound by Q.
    """
    measures_term = deref(term[1])
    # One measure, or a list of measures over the same window.
    listed_measures = list_items(measures_term)
    if listed_measures is not None and not listed_measures:
        raise reader.create_error("an aggregate needs at least one kind", term, 1)
    measure_terms = [measures_term] if listed_measures is None else [deref(item) for item in listed_measures]
    restricted_measures = [_split_step_restriction(measure_term) for measure_term in measure_terms]
    has_held_values = functor_name(term[4]) == _HELD
    measures = [
        parse_measure(reader, measure_term, term, has_held_values) for _, measure_term in restricted_measures
    ]
    collected = reader.read_operand(term, 2, "aggregate")
    pattern_variables = set(bound_by(collected))
    for (_, measure_term), measure in zip(restricted_measures, measures):
        # A goal may have variables of its own.
        if (
            measure.value is not None
            and measure.name != DURATION
            and any(var not in pattern_variables for var in variables(measure.value))
        ):
            raise reader.create_error(
                "a measured value has a variable that no event in the window binds", measure_term
            )
    # For a list of measures, the result is a list of the same length, or a variable for the whole list.
    result_terms = list_items(term[3]) if listed_measures is not None else None
    if result_terms is not None and len(result_terms) != len(measure_terms):
        raise reader.create_error(
            f"{len(measure_terms)} aggregates have {len(measure_terms)} results, not {len(result_terms)}",
            term,
            3,
        )
    results = tuple([deref(term[3])] if result_terms is None else [deref(result) for result in result_terms])
    window = _parse_window_term(reader, deref(term[4]), term, pattern_variables)
    scopes = _find_step_numbers(reader, [step for step, _ in restricted_measures], window, term)
    # The rate is computed between the first and the last event of a window.
    if "rate" in [measure.name for measure in measures] and window.kind == "batch" and window.max_count == 1:
        raise reader.create_error("rate needs a window of at least two events", term, 4)
    names, settings, values = zip(*measures)
    is_listed = listed_measures is not None and result_terms is None
    return WindowPattern(
        collected=collected,
        kinds=names,
        settings=settings,
        values=values,
        results=results,
        is_listed=is_listed,
        window=window,
        scopes=scopes,
    )


def _split_step_restriction(measure: Any) -> Tuple[Any, Any]:
    """Return the step that a measure is restricted to, or None, and the measure."""
    if measure.__class__ is tuple and measure[0].name == _STEP_MEASURE_NAME and len(measure) == 3:
        return deref(measure[1]), deref(measure[2])
    return None, measure


def _find_step_numbers(
    reader: "PatternReader", steps: Sequence[Any], window: WindowSpec, term: CompoundTerm
) -> Tuple[Optional[int], ...]:
    """Return for each measure the number of the step that it is restricted to, or None."""
    names = [atom(window_step.name) for window_step in window.steps]
    for step in steps:
        if step is not None and step not in names:
            hint = f"; there are {', '.join(name.name for name in names)}" if names else ""
            message = f"of(Step, Kind) needs the name of a step of a window of steps{hint}"
            raise reader.create_error(message, term, 1)
    return tuple([None if step is None else names.index(step) for step in steps])


class AggregateMeasure(NamedTuple):
    """Measure of an aggregate: name of the aggregate function, its setting (see `Setting`), and the measured term."""

    name: str
    setting: Setting
    value: Optional[Term]


def parse_measure(
    reader: "PatternReader", measure_term: Any, term: CompoundTerm, of_held_values: bool = False
) -> AggregateMeasure:
    """Return the measure that a term denotes.

    Args:
        reader: reports errors with their places.
        measure_term: the term.
        term: the aggregate, whose first argument it is.
        of_held_values: whether it measures the time for which values last.

    Raises:
        RuleError: if there is no such aggregate function, or its setting is malformed.
    """
    name = functor_name(measure_term)
    arguments: Sequence[Term] = measure_term[1:] if measure_term.__class__ is tuple else ()
    error_position = (measure_term,) if measure_term.__class__ is tuple else (term, 1)
    if of_held_values:
        if name not in HELD_AGGREGATES or len(arguments) != 1:
            notations = ", ".join(held_aggregate.notation for held_aggregate in HELD_AGGREGATES.values())
            raise reader.create_error(
                f"the aggregates of held values are {notations}{did_you_mean(name, HELD_AGGREGATES)}",
                *error_position,
            )
        value = reader.read_goal(measure_term, 1, DURATION) if name == DURATION else deref(arguments[0])
        # The value of a variable might be a number, which is no goal.
        if name == DURATION and value.__class__ is Var:
            raise reader.create_error("duration needs a goal", measure_term, 1)
        return AggregateMeasure(name, None, value)
    aggregate = AGGREGATES.get(name)
    if name == DURATION:
        raise reader.create_error(
            "duration(Goal) needs a window of held values, as held(every(10)); the length of another window is "
            "E - S in check (t1(S), t2(E), ...) after the aggregate",
            *error_position,
        )
    if aggregate is None or len(arguments) != aggregate.arity:
        notations = ", ".join(aggregate.notation for aggregate in AGGREGATES.values())
        raise reader.create_error(
            f"there is no such aggregate; the aggregates are {notations}{did_you_mean(name, AGGREGATES)}",
            *error_position,
        )
    settings = [deref(argument) for argument in arguments[: aggregate.setting_count]]
    setting: Any = None
    if name == "quantile":
        setting = settings[0]
        if setting.__class__ not in (int, float) or not 0 <= setting <= 1:
            raise reader.create_error("quantile needs a number from 0 to 1", *error_position)
    elif settings:
        setting = tuple(settings)
        if not all(argument.__class__ is Atom for argument in settings):
            raise reader.create_error(
                f"{aggregate.notation} needs the names of three predicates", *error_position
            )
    return AggregateMeasure(name, setting, deref(arguments[-1]) if aggregate.has_value else None)


def _parse_window_term(
    reader: "PatternReader", window: Any, term: CompoundTerm, pattern_variables: Set[Var]
) -> WindowSpec:
    """Return the window that a term denotes.

    Args:
        reader: reports errors with their places.
        window: the term of the window.
        term: the aggregate, for errors.
        pattern_variables: the variables that the pattern binds.
    """
    name = window[0].name if window.__class__ is tuple else ""
    if name == "steps" and len(window) in (2, 3):
        return parse_row_pattern(reader, window, pattern_variables)
    if name == _TIMED_OUT.name and len(window) == 3:
        steps: Any = deref(window[1])
        if steps.__class__ is not tuple or steps[0].name != "steps":
            raise reader.create_error("timed_out needs steps(...) and a number of seconds", window, 1)
        row_pattern = _parse_window_term(reader, steps, term, pattern_variables)
        return row_pattern._replace(span=parse_seconds(name, window, 2, reader.create_error))
    if name == "running" and len(window) == 2:
        tumbling = _parse_window_term(reader, deref(window[1]), term, pattern_variables)
        # Sliding windows and row patterns emit at each match in any case, and hopping windows overlap.
        if tumbling.kind not in ("every", "first", "batch") or tumbling.span != tumbling.step:
            raise reader.create_error(
                "running needs every(Seconds), every(Seconds, first) or every(N, events)", window
            )
        return tumbling._replace(running=True)
    if name == "session":
        return _parse_session_window(reader, window)
    if name == _HELD:
        return _parse_held_window(reader, window, term)
    return _parse_last_or_every(reader, window, term)


def _parse_last_or_every(reader: "PatternReader", window: Any, term: CompoundTerm) -> WindowSpec:
    """Return the window ``last(...)`` or ``every(...)``; see `_parse_window_term`."""
    name = window[0].name if window.__class__ is tuple else ""
    syntax_error = reader.create_error(
        f"a window is {_WINDOW_NOTATIONS}{did_you_mean(name, _WINDOW_NAMES - {name})}",
        *((window,) if window.__class__ is tuple else (term, 4)),
    )
    if name not in ("last", "every") or len(window) not in (2, 3):
        raise syntax_error
    argument: Any = deref(window[2]) if len(window) == 3 else None
    option = argument.name if argument.__class__ is Atom else ""
    if option == "events":
        size = deref(window[1])
        if size.__class__ is not int or not 1 <= size <= MAX_WINDOW_ITEMS:
            raise reader.create_error(
                f"{name} needs a number of events from 1 to {MAX_WINDOW_ITEMS}", window, 1
            )
        return WindowSpec("newest" if name == "last" else "batch", max_count=size)
    if len(window) == 2:
        span = parse_seconds(name, window, 1, reader.create_error)
        return (
            WindowSpec(name, span, span)
            if name == "last"
            else _create_hopping_window(reader, window, span, span)
        )
    if name == "every" and option == "first":
        span = parse_seconds(name, window, 1, reader.create_error)
        return WindowSpec("first", span, span)
    if name == "last" and argument.__class__ is tuple and argument[0].name == "every" and len(argument) == 2:
        return _create_hopping_window(
            reader,
            window,
            parse_seconds(name, window, 1, reader.create_error),
            parse_seconds("every", argument, 1, reader.create_error),
        )
    raise syntax_error


def _parse_session_window(reader: "PatternReader", window: CompoundTerm) -> WindowSpec:
    """Return the window ``session(Seconds)`` or ``session(Seconds, max(Seconds))``."""
    gap = parse_seconds("session", window, 1, reader.create_error)
    if len(window) == 2:
        return WindowSpec("session", gap=gap)
    option: Any = deref(window[2])
    if len(window) > 3 or option.__class__ is not tuple or option[0].name != "max" or len(option) != 2:
        raise reader.create_error("session takes seconds and max(Seconds)", window, 2)
    max_length = parse_seconds("max", option, 1, reader.create_error)
    # A shorter maximum would end each window before its gap.
    if max_length <= gap:
        raise reader.create_error("max needs more seconds than its session", option, 1)
    return WindowSpec("session", gap=gap, max_length=max_length)


def _parse_held_window(reader: "PatternReader", window: CompoundTerm, term: CompoundTerm) -> WindowSpec:
    """Return the window ``held(Window)`` or ``held(Window, max(Seconds))``."""
    option: Any = deref(window[2]) if len(window) == 3 else None
    is_bounded = option.__class__ is tuple and option[0].name == "max" and len(option) == 2
    if len(window) != 2 and not is_bounded:
        raise reader.create_error(
            "held takes a window and max(Seconds)", window, 2 if len(window) == 3 else 0
        )
    inner = deref(window[1])
    if functor_name(inner) not in ("last", "every"):
        raise reader.create_error(_HELD_NOTATION, window, 1)
    measured = _parse_last_or_every(reader, inner, term)
    if measured.kind not in ("last", "every"):
        raise reader.create_error(_HELD_NOTATION, window, 1)
    step = measured.step if measured.kind == "every" else 0
    max_length = parse_seconds("max", option, 1, reader.create_error) if is_bounded else None
    # Each result in this time is an event, also if the clock jumps.
    if max_length is not None and step and max_length > MAX_HELD_STEPS * step:
        raise reader.create_error(
            f"max needs no more than {MAX_HELD_STEPS} times the seconds of its every", option, 1
        )
    return WindowSpec("held", measured.span, step, max_length=max_length)


def _create_hopping_window(reader: "PatternReader", window: CompoundTerm, span: int, step: int) -> WindowSpec:
    """Return windows that the clock closes, at regular times."""
    # An event with a later timestamp closes all windows that end before it, so their number must be bounded.
    if step < MIN_STEP_NANOSECONDS or span > MAX_OVERLAPPING_WINDOWS * step:
        message = (
            f"every needs 0.001 seconds at least, and last no more than {MAX_OVERLAPPING_WINDOWS} times those of its "
            "every"
        )
        raise reader.create_error(message, window)
    return WindowSpec("every", span, step)


def parse_seconds(name: str, term: CompoundTerm, position: int, create_error: CreateError) -> int:
    """Return the nanoseconds of an argument, a positive number of seconds."""
    seconds = deref(term[position])
    nanoseconds = positive_nanoseconds(seconds)
    if nanoseconds is None:
        raise create_error(
            f"{name} needs a positive number of seconds{bracket_advice(name, seconds)}", term, position
        )
    # Instants after a timestamp and a longer time could not be stored in states.
    if nanoseconds > MAX_TIMESTAMP:
        raise create_error(f"{name} needs at most {MAX_TIMESTAMP // SECOND:.1e} seconds", term, position)
    return nanoseconds


def positive_nanoseconds(seconds: Term) -> Optional[int]:
    """Return a number of seconds in nanoseconds; None if the term is not a positive number of at least 1 ns."""
    number: Any = deref(seconds)
    if number.__class__ not in (int, float) or not 0 < number < float("inf"):
        return None
    return from_seconds(number) or None


def rate_operator_term(rate_pattern: RatePattern) -> Term:
    """Return the term of a rate operator."""
    first = timestamps.to_seconds(rate_pattern.span) if rate_pattern.value is None else rate_pattern.value
    if not rate_pattern.keys:
        return functor(rate_pattern.operator, 1)(first)
    keys = rate_pattern.keys[0] if len(rate_pattern.keys) == 1 else make_list(rate_pattern.keys)
    return functor(rate_pattern.operator, 2)(first, keys)


def timeout_term(pattern: AbsencePattern) -> Term:
    """Return the time of ``absent``: a number of seconds, or a variable."""
    return pattern.span if isinstance(pattern.span, Var) else timestamps.to_seconds(pattern.span)


def window_term(window: WindowSpec, to_seconds: Callable[[int], float] = timestamps.to_seconds) -> Term:
    """Return the term of a window; ``to_seconds`` converts ns to the numbers in it."""
    if window.kind == "steps":
        row_pattern = row_pattern_term(window)
        return _TIMED_OUT(row_pattern, to_seconds(window.span)) if window.span else row_pattern
    every, every_with_option = functor("every", 1), functor("every", 2)
    span = to_seconds(window.span)
    if window.kind == "last":
        return functor("last", 1)(span)
    if window.kind == "session":
        bound = () if window.max_length is None else (functor("max", 1)(to_seconds(window.max_length)),)
        return functor("session", 1 + len(bound))(to_seconds(window.gap), *bound)
    if window.kind == "held":
        inner = window._replace(kind="every" if window.step else "last", max_length=None)
        bound = () if window.max_length is None else (functor("max", 1)(to_seconds(window.max_length)),)
        return functor("held", 1 + len(bound))(window_term(inner, to_seconds), *bound)
    if window.kind == "newest":
        return functor("last", 2)(window.max_count, atom("events"))
    if window.kind == "batch":
        term = every_with_option(window.max_count, atom("events"))
    elif window.kind == "first":
        term = every_with_option(span, atom("first"))
    elif window.span == window.step:
        term = every(span)
    else:
        term = functor("last", 2)(span, every(to_seconds(window.step)))
    return functor("running", 1)(term) if window.running else term


_SINGLE_EVENT_ERROR = "a subscription takes single events: write a rule that raises an event for the pattern"
_TRAILING_OPERATOR_ERROR = "a subscription takes P with S without further operators"


def subscription_event(term: Term) -> Term:
    """Return the event pattern of a subscription: P of ``P with S``, otherwise the whole term."""
    pattern: Any = deref(term)
    return deref(pattern[1]) if operator_name(pattern) == "with" else pattern


def subscription_rate_operator(term: Term) -> Optional[RatePattern]:
    """Return the rate operator of a subscription, or None.

    Raises:
        UsageError: if the operator is malformed, or other operators follow it.
    """
    pattern: Any = deref(term)
    try:
        if operator_name(pattern) == "with":
            if regroup_rate_operator(pattern) is not None:
                raise UsageError(_TRAILING_OPERATOR_ERROR)
            return parse_rate_operator(pattern, _parse_single_event(pattern[1]), _create_error)
    except RuleError as error:
        raise UsageError(error.message) from None
    operand = pattern
    # The operator that follows a rate operator is the outermost one: it is found by descending to the left.
    while operator_name(operand):
        operand = deref(operand[1])
        if operator_name(operand) == "with":
            raise UsageError(_TRAILING_OPERATOR_ERROR)
    return None


def _parse_single_event(term: Term) -> EventPattern:
    event = deref(term)
    if event.__class__ not in (tuple, Atom, Var) or operator_name(event):
        raise RuleError(_SINGLE_EVENT_ERROR)
    return EventPattern(event)


def _create_error(message: str, term: Term, position: int = 0) -> RuleError:
    """Return an error without a place, because the terms of a goal ``subscribe/5`` have no places."""
    return RuleError(message)
