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
from ...prolog.terms.types import Atom, CompoundTerm, Term, Var, atom, deref, functor
from ..streams.accumulators import MEASURES
from .event_operators import SPELLINGS
from .likely_mistakes import bracket_advice, near
from .pattern_tree import Occurs, Pattern, Shaped, Windowed, WindowForm, bound_by
from .row_pattern_parser import read_steps, steps_term

if TYPE_CHECKING:
    from .pattern_parser import PatternReader

_ABSENT_FUNCTOR, _AGGREGATE_FUNCTOR = functor("absent", 2), functor("aggregate", 4)
MIN_STEP_NANOSECONDS = 1_000_000
"""Minimum time between two results of a window, in ns."""
MAX_WINDOWS = 10_000
"""Maximum number of windows of ``last(N, every(M))`` that contain one event."""
MAX_WINDOW_ITEMS = 1_000_000
"""Maximum size of a window of a number of events."""


class FormReader(Protocol):
    """Reader of patterns: `PatternReader` for rules, `_SingleEvent` for subscriptions."""

    def operand(self, parent: CompoundTerm, number: int, operator: str) -> Pattern:
        """Return the pattern of an operand."""

    def span(self, name: str, term: CompoundTerm) -> int:
        """Return the second argument of a term, a number of seconds, in nanoseconds."""

    def error(self, message: str, term: Term, number: int = 0) -> RuleError:
        """Return an error at a term, or at one of its arguments."""


class ShapeForm(NamedTuple):
    """Notation of a rate operator.

    Attributes:
        form: the forms in words, with and without a key.
        timed: whether the first argument is a number of seconds; if not, it is the value that must change.
    """

    form: str
    timed: bool


SHAPES: Dict[str, ShapeForm] = {
    "throttle": ShapeForm("throttle(Seconds) or throttle(Seconds, Key)", True),
    "burst": ShapeForm("burst(Seconds) or burst(Seconds, Key)", True),
    "debounce": ShapeForm("debounce(Seconds) or debounce(Seconds, Key)", True),
    "change": ShapeForm("change(Value) or change(Value, Key)", False),
}
"""Rate operators, by name."""

_WINDOWS = (
    "last(Seconds), last(N, events), last(Seconds, every(Seconds)), every(Seconds), every(Seconds, first), "
    "every(N, events), running(every(...)), or steps([Step, ...])"
)


_WINDOW_NAMES = frozenset(("last", "every", "running", "steps"))
_OF_STEP = "of"


def is_event(term: CompoundTerm) -> bool:
    """Return whether a term with the name of a stream operator is an event, judged by its arguments.

    Programs older than these operators may contain such events.
    """
    if term[0] is _ABSENT_FUNCTOR:
        return deref(term[2]).__class__ not in (int, float)
    if term[0] is not _AGGREGATE_FUNCTOR:
        return False
    kind, window = deref(term[1]), deref(term[4])
    name = kind.name if kind.__class__ is Atom else kind[0].name if kind.__class__ is tuple else ""
    measured = name in MEASURES or name == _OF_STEP or list_items(kind) is not None
    # Both the kind and the window must look foreign: a misspelt kind with a proper window is reported as an error,
    # instead of being taken for an event that never occurs.
    return not measured and not (window.__class__ is tuple and window[0].name in _WINDOW_NAMES)


def regroup_rate_operator(term: CompoundTerm) -> Optional[CompoundTerm]:
    """Return ``(P with S) op Q`` for ``P with (S op Q)``, the form that is parsed without brackets; otherwise None.

    A rate operator is not a pattern, so an operator to the right of it applies to all of ``P with S``.
    """
    path: List[CompoundTerm] = []
    shape = deref(term[2])
    # ``with`` binds more loosely than the operators that may follow, so they are parsed as part of its right operand.
    while shape.__class__ is tuple and shape[0] in SPELLINGS:
        path.append(shape)
        shape = deref(shape[1])
    if not path or shape.__class__ is not tuple or shape[0].name not in SHAPES:
        return None
    regrouped: CompoundTerm = (term[0], term[1], shape)
    for operation in reversed(path):
        regrouped = (operation[0], regrouped, *operation[2:])
    return regrouped


def read_shape(reader: FormReader, term: CompoundTerm) -> Shaped:
    """Return the pattern ``P with S``.

    Raises:
        RuleError: if the rate operator is malformed, or uses a variable that P does not bind.
    """
    pattern = reader.operand(term, 1, "with")
    shape: Any = deref(term[2])
    name = shape[0].name if shape.__class__ is tuple else ""
    if name not in SHAPES or len(shape) not in (2, 3):
        forms = "; ".join(key.form for key in SHAPES.values())
        error_at = (shape,) if shape.__class__ is tuple else (term, 2)
        raise reader.error(f"with needs one of {forms}{near(name, SHAPES)}", *error_at)
    span, value = 0, None
    if SHAPES[name].timed:
        span = _seconds(reader, name, shape, 1)
    else:
        value = deref(shape[1])
    by: Tuple[Term, ...] = ()
    if len(shape) == 3:
        items = list_items(shape[2])
        # A key is one term or a list of terms.
        by = tuple(items if items is not None else [deref(shape[2])])
    given = set(bound_by(pattern))
    for number, used_term in ((1, value), *((2, key) for key in by)):
        if used_term is not None and any(var not in given for var in variables(used_term)):
            raise reader.error(f"{name} uses a variable that no event of its pattern binds", shape, number)
    return Shaped(pattern, name, span, value, by)


def read_window(reader: "PatternReader", term: CompoundTerm) -> Windowed:
    """Return the pattern ``aggregate(K, Q, R, W)``.

    Raises:
        RuleError: if a measure or the window is malformed, or a measured variable is not bound by Q.
    """
    kind = deref(term[1])
    # One measure, or a list of measures over the same window.
    several = list_items(kind)
    if several is not None and not several:
        raise reader.error("an aggregate needs at least one kind", term, 1)
    kinds = [kind] if several is None else [deref(measure) for measure in several]
    restricted = [_restricted_measure(measure) for measure in kinds]
    measures = [_measure(reader, measure, term) for _, measure in restricted]
    collected = reader.operand(term, 2, "aggregate")
    given = set(bound_by(collected))
    for (_, measure), (_, _, value) in zip(restricted, measures):
        if value is not None and any(var not in given for var in variables(value)):
            raise reader.error("a measured value has a variable that no event in the window binds", measure)
    # For a list of measures, the result is a list of the same length, or a variable for the whole list.
    items = list_items(term[3]) if several is not None else None
    if items is not None and len(items) != len(kinds):
        raise reader.error(f"{len(kinds)} aggregates have {len(kinds)} results, not {len(items)}", term, 3)
    results = tuple([deref(term[3])] if items is None else [deref(measure) for measure in items])
    window = _window(reader, deref(term[4]), term, given)
    scopes = _scopes(reader, [step for step, _ in restricted], window, term)
    # The rate is computed between the first and the last event of a window.
    if "rate" in [name for name, _, _ in measures] and window.kind == "batch" and window.most == 1:
        raise reader.error("rate needs a window of at least two events", term, 4)
    names, settings, values = zip(*measures)
    listed = several is not None and items is None
    return Windowed(collected, names, settings, values, results, listed, window, scopes)


def _restricted_measure(kind: Any) -> Tuple[Any, Any]:
    """Return the step that a measure is restricted to, or None, and the measure."""
    if kind.__class__ is tuple and kind[0].name == _OF_STEP and len(kind) == 3:
        return deref(kind[1]), deref(kind[2])
    return None, kind


def _scopes(
    reader: "PatternReader", steps: Sequence[Any], window: WindowForm, term: CompoundTerm
) -> Tuple[Optional[int], ...]:
    """Return for each measure the number of the step that it is restricted to, or None."""
    step_names = [atom(step_name.name) for step_name in window.steps]
    for step in steps:
        if step is not None and step not in step_names:
            hint = (
                f"; there are {', '.join(step_name.name for step_name in step_names)}" if step_names else ""
            )
            message = f"of(Step, Kind) needs the name of a step of a window of steps{hint}"
            raise reader.error(message, term, 1)
    return tuple([None if step is None else step_names.index(step) for step in steps])


def _measure(reader: "PatternReader", kind: Any, term: CompoundTerm) -> Tuple[str, Any, Optional[Term]]:
    """Return the name of a measure, its setting, and the measured term."""
    name = kind.name if kind.__class__ is Atom else kind[0].name if kind.__class__ is tuple else ""
    args: Sequence[Term] = kind[1:] if kind.__class__ is tuple else ()
    error_at = (kind,) if kind.__class__ is tuple else (term, 1)
    measure = MEASURES.get(name)
    if measure is None or len(args) != measure.settings + measure.takes:
        forms = ", ".join(arg.form for arg in MEASURES.values())
        raise reader.error(
            f"there is no such aggregate; the aggregates are {forms}{near(name, MEASURES)}", *error_at
        )
    settings = [deref(arg) for arg in args[: measure.settings]]
    setting: Any = None
    if name == "quantile":
        setting = settings[0]
        if setting.__class__ not in (int, float) or not 0 <= setting <= 1:
            raise reader.error("quantile needs a number from 0 to 1", *error_at)
    elif settings:
        setting = tuple(settings)
        if not all(arg.__class__ is Atom for arg in settings):
            raise reader.error(f"{measure.form} needs the names of three predicates", *error_at)
    return name, setting, deref(args[-1]) if measure.takes else None


def _window(reader: "PatternReader", form: Any, term: CompoundTerm, given: Set[Var]) -> WindowForm:
    """Return the window that a term denotes; ``given`` are the variables that the pattern binds."""
    name = form[0].name if form.__class__ is tuple else ""
    if name == "steps" and len(form) == 2:
        steps, looked_at = read_steps(reader, form, given)
        return WindowForm("steps", steps=steps, looked_at=looked_at)
    if name == "running" and len(form) == 2:
        inner = _window(reader, deref(form[1]), term, given)
        # Sliding windows and row patterns emit at each match in any case, and hopping windows overlap.
        if inner.kind not in ("every", "first", "batch") or inner.span != inner.step:
            raise reader.error(
                "running needs every(Seconds), every(Seconds, first) or every(N, events)", form
            )
        return inner._replace(running=True)
    second: Any = deref(form[2]) if form.__class__ is tuple and len(form) == 3 else None
    word = second.name if second.__class__ is Atom else ""
    if name not in ("last", "every") or len(form) not in (2, 3):
        word = "wrong"
    elif word == "events":
        most = deref(form[1])
        if most.__class__ is not int or not 1 <= most <= MAX_WINDOW_ITEMS:
            raise reader.error(f"{name} needs a number of events from 1 to {MAX_WINDOW_ITEMS}", form, 1)
        return WindowForm("newest" if name == "last" else "batch", most=most)
    elif len(form) == 2:
        span = _seconds(reader, name, form, 1)
        return WindowForm(name, span, span) if name == "last" else _hopping(reader, form, span, span)
    elif name == "every" and word == "first":
        span = _seconds(reader, name, form, 1)
        return WindowForm("first", span, span)
    elif name == "last" and second.__class__ is tuple and second[0].name == "every" and len(second) == 2:
        return _hopping(reader, form, _seconds(reader, name, form, 1), _seconds(reader, "every", second, 1))
    raise reader.error(f"a window is {_WINDOWS}", *((form,) if form.__class__ is tuple else (term, 4)))


def _hopping(reader: "PatternReader", form: CompoundTerm, span: int, step: int) -> WindowForm:
    """Return windows that the clock closes, at regular times."""
    # One event that arrives late can close all windows that it is too new for, so their number must be bounded.
    if step < MIN_STEP_NANOSECONDS or span > MAX_WINDOWS * step:
        message = f"every needs 0.001 seconds at least, and last no more than {MAX_WINDOWS} times those of its every"
        raise reader.error(message, form)
    return WindowForm("every", span, step)


def _seconds(reader: FormReader, name: str, term: CompoundTerm, number: int) -> int:
    span = deref(term[number])
    if span.__class__ not in (int, float) or not span > 0 or span == float("inf") or not from_seconds(span):
        raise reader.error(
            f"{name} needs a positive number of seconds{bracket_advice(name, span)}", term, number
        )
    return from_seconds(span)


def shape_term(part: Shaped) -> Term:
    """Return the term of a rate operator."""
    first = timestamps.to_seconds(part.span) if part.value is None else part.value
    if not part.by:
        return functor(part.shape, 1)(first)
    by = part.by[0] if len(part.by) == 1 else make_list(part.by)
    return functor(part.shape, 2)(first, by)


def window_term(form: WindowForm) -> Term:
    """Return the term of a window."""
    if form.kind == "steps":
        return steps_term(form.steps)
    every_one, every_two = functor("every", 1), functor("every", 2)
    span = timestamps.to_seconds(form.span)
    if form.kind == "last":
        return functor("last", 1)(span)
    if form.kind == "newest":
        return functor("last", 2)(form.most, atom("events"))
    if form.kind == "batch":
        term = every_two(form.most, atom("events"))
    elif form.kind == "first":
        term = every_two(span, atom("first"))
    elif form.span == form.step:
        term = every_one(span)
    else:
        term = functor("last", 2)(span, every_one(timestamps.to_seconds(form.step)))
    return functor("running", 1)(term) if form.running else term


_NOT_SINGLE_ERROR = "a subscription takes single events: write a rule that raises an event for the pattern"
_TRAILING_OPERATOR_ERROR = "a subscription takes P with S without further operators"


def subscribed_event(term: Term) -> Term:
    """Return the event pattern of a subscription: P of ``P with S``, otherwise the whole term."""
    pattern: Any = deref(term)
    return deref(pattern[1]) if _operator(pattern) == "with" else pattern


def subscribed_shape(term: Term) -> Optional[Shaped]:
    """Return the rate operator of a subscription, or None.

    Raises:
        UsageError: if the operator is malformed, or other operators follow it.
    """
    pattern: Any = deref(term)
    try:
        if _operator(pattern) == "with":
            if regroup_rate_operator(pattern) is not None:
                raise UsageError(_TRAILING_OPERATOR_ERROR)
            return read_shape(_SingleEvent(), pattern)
    except RuleError as error:
        raise UsageError(error.message) from None
    operand = pattern
    # The operator that follows a rate operator is the outermost one: it is found by descending to the left.
    while _operator(operand):
        operand = deref(operand[1])
        if _operator(operand) == "with":
            raise UsageError(_TRAILING_OPERATOR_ERROR)
    return None


def _operator(term: Any) -> str:
    return SPELLINGS.get(term[0], "") if term.__class__ is tuple else ""


class _SingleEvent:
    """Reader for the pattern of a subscription, which is a single event; see `FormReader`."""

    def operand(self, parent: CompoundTerm, number: int, operator: str) -> Pattern:
        event = deref(parent[number])
        if event.__class__ not in (tuple, Atom, Var) or _operator(event):
            raise self.error(_NOT_SINGLE_ERROR, event)
        return Occurs(event)

    def span(self, name: str, term: CompoundTerm) -> int:
        # Only patterns of several events have a duration.
        raise self.error(_NOT_SINGLE_ERROR, term)

    def error(self, message: str, term: Term, number: int = 0) -> RuleError:
        return RuleError(message)
