"""Windows and shapes of streams, read from terms: ``aggregate(K, Q, R, W)`` and ``P with S``.

What a subscription sends: all events of a pattern, or those of them that a shape lets through, ``P with S``.
"""

from typing import Any, Dict, List, NamedTuple, Optional, Protocol, Sequence, Set, Tuple

from ...foundation.errors import RuleError, UsageError
from ...prolog.terms import timestamps
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.timestamps import from_seconds
from ...prolog.terms.types import Atom, CompoundTerm, Term, Var, atom, deref, functor
from ..streams.accumulators import MEASURES
from .likely_mistakes import bracketed, near
from .pattern_operators import SPELLINGS
from .pattern_tree import Occurs, Pattern, Shaped, Windowed, WindowForm, bound_by
from .row_pattern_parser import StepReader, read_steps, steps_term

_ABSENT, _AGGREGATE = functor("absent", 2), functor("aggregate", 4)
SHORTEST = 1_000_000
"""The shortest time between two results of a window, in ns."""
MAX_WINDOWS = 10_000
"""In how many windows of ``last(N, every(M))`` an event may be."""
MAX_WINDOW_ITEMS = 1_000_000
"""How many events a window of a number of events takes at most."""


class FormReader(Protocol):
    """What reads patterns, see `PatternReader`."""

    def operand(self, parent: CompoundTerm, number: int, operator: str) -> Pattern:
        """Return the pattern that an operand is."""

    def span(self, name: str, term: CompoundTerm) -> int:
        """Return the nanoseconds that the second argument of a term says."""

    def error(self, message: str, term: Term, number: int = 0) -> RuleError:
        """Return an error at a term, or at an argument of it."""


class WindowReader(FormReader, StepReader, Protocol):
    """The same, and goals that windows ask."""


class ShapeForm(NamedTuple):
    """How a shape is written.

    Attributes:
        form: with the terms by which matches are looked at together.
        timed: whether its first argument is a number of seconds, else it is what has to change.
    """

    form: str
    timed: bool


SHAPES: Dict[str, ShapeForm] = {
    "throttle": ShapeForm("throttle(Seconds) or throttle(Seconds, Key)", True),
    "burst": ShapeForm("burst(Seconds) or burst(Seconds, Key)", True),
    "debounce": ShapeForm("debounce(Seconds) or debounce(Seconds, Key)", True),
    "change": ShapeForm("change(Value) or change(Value, Key)", False),
}
"""What may stand to the right of ``with``."""

_WINDOWS = (
    "last(Seconds), last(N, events), last(Seconds, every(Seconds)), every(Seconds), every(Seconds, first), "
    "every(N, events), running(every(...)), or steps([Step, ...])"
)


_WINDOW_NAMES = frozenset(("last", "every", "running", "steps"))
_OF_STEP = "of"


def is_event(term: CompoundTerm) -> bool:
    """Tell whether a term is an event that has the name of an operator on streams: by what stands in it.

    There may be such events in programs that were written before these operators.
    """
    if term[0] is _ABSENT:
        return deref(term[2]).__class__ not in (int, float)
    if term[0] is not _AGGREGATE:
        return False
    kind, window = deref(term[1]), deref(term[4])
    name = kind.name if kind.__class__ is Atom else kind[0].name if kind.__class__ is tuple else ""
    measured = name in MEASURES or name == _OF_STEP or list_items(kind) is not None
    return not measured and not (window.__class__ is tuple and window[0].name in _WINDOW_NAMES)


def what_follows(term: CompoundTerm) -> Optional[CompoundTerm]:
    """Return ``(P with S) op Q`` for ``P with (S op Q)``, which is how it is read without brackets; else None.

    A shape is no pattern, so that what stands to the right of it can only be about all of ``P with S``.
    """
    path: List[CompoundTerm] = []
    shape = deref(term[2])
    while shape.__class__ is tuple and shape[0] in SPELLINGS:
        path.append(shape)
        shape = deref(shape[1])
    if not path or shape.__class__ is not tuple or shape[0].name not in SHAPES:
        return None
    made: CompoundTerm = (term[0], term[1], shape)
    for one in reversed(path):
        made = (one[0], made, *one[2:])
    return made


def read_shape(reader: FormReader, term: CompoundTerm) -> Shaped:
    """Return the pattern that ``P with S`` is.

    Raises:
        RuleError: where there is no such shape, or it looks at what P does not give it.
    """
    pattern = reader.operand(term, 1, "with")
    shape: Any = deref(term[2])
    name = shape[0].name if shape.__class__ is tuple else ""
    if name not in SHAPES or len(shape) not in (2, 3):
        forms = "; ".join(one.form for one in SHAPES.values())
        at = (shape,) if shape.__class__ is tuple else (term, 2)
        raise reader.error(f"with needs one of {forms}{near(name, SHAPES)}", *at)
    span, value = 0, None
    if SHAPES[name].timed:
        span = _seconds(reader, name, shape, 1)
    else:
        value = deref(shape[1])
    by: Tuple[Term, ...] = ()
    if len(shape) == 3:
        items = list_items(shape[2])
        by = tuple(items if items is not None else [deref(shape[2])])
    given = set(bound_by(pattern))
    for number, found in ((1, value), *((2, one) for one in by)):
        if found is not None and any(var not in given for var in variables(found)):
            raise reader.error(
                f"{name} looks at a variable that no event of its pattern gives a value", shape, number
            )
    return Shaped(pattern, name, span, value, by)


def read_window(reader: WindowReader, term: CompoundTerm) -> Windowed:
    """Return the pattern that ``aggregate(K, Q, R, W)`` is.

    Raises:
        RuleError: where there is no such aggregate or window, or it measures what Q does not give it.
    """
    kind = deref(term[1])
    several = list_items(kind)
    if several is not None and not several:
        raise reader.error("an aggregate needs one kind at least", term, 1)
    kinds = [kind] if several is None else [deref(one) for one in several]
    parted = [_of_step(one) for one in kinds]
    read = [_measure(reader, one, term) for _, one in parted]
    collected = reader.operand(term, 2, "aggregate")
    given = set(bound_by(collected))
    for (_, one), (_, _, value) in zip(parted, read):
        if value is not None and any(var not in given for var in variables(value)):
            raise reader.error(
                "what is measured has a variable that no event in the window gives a value", one
            )
    items = list_items(term[3]) if several is not None else None
    if items is not None and len(items) != len(kinds):
        raise reader.error(f"{len(kinds)} aggregates have {len(kinds)} results, not {len(items)}", term, 3)
    results = tuple([deref(term[3])] if items is None else [deref(one) for one in items])
    window = _window(reader, deref(term[4]), term, given)
    scopes = _scopes(reader, [step for step, _ in parted], window, term)
    if "rate" in [name for name, _, _ in read] and window.kind == "batch" and window.most == 1:
        raise reader.error("one event has no rate", term, 4)
    names, settings, values = zip(*read)
    listed = several is not None and items is None
    return Windowed(collected, names, settings, values, results, listed, window, scopes)


def _of_step(kind: Any) -> Tuple[Any, Any]:
    """Return the step that a measure is of, or None, and what it measures."""
    if kind.__class__ is tuple and kind[0].name == _OF_STEP and len(kind) == 3:
        return deref(kind[1]), deref(kind[2])
    return None, kind


def _scopes(
    reader: WindowReader, steps: Sequence[Any], window: WindowForm, term: CompoundTerm
) -> Tuple[Optional[int], ...]:
    """Return the number of the step that each measure looks at, or None."""
    known = [atom(one.name) for one in window.steps]
    for step in steps:
        if step is not None and step not in known:
            there = f"; there are {', '.join(one.name for one in known)}" if known else ""
            message = f"of(Step, Kind) needs the name of a step of a window of steps{there}"
            raise reader.error(message, term, 1)
    return tuple([None if step is None else known.index(step) for step in steps])


def _measure(reader: WindowReader, kind: Any, term: CompoundTerm) -> Tuple[str, Any, Optional[Term]]:
    """Return the name of a measure, its setting, and what it is of."""
    name = kind.name if kind.__class__ is Atom else kind[0].name if kind.__class__ is tuple else ""
    args: Sequence[Term] = kind[1:] if kind.__class__ is tuple else ()
    at = (kind,) if kind.__class__ is tuple else (term, 1)
    found = MEASURES.get(name)
    if found is None or len(args) != found.settings + found.takes:
        known = ", ".join(one.form for one in MEASURES.values())
        raise reader.error(
            f"there is no such aggregate; the aggregates are {known}{near(name, MEASURES)}", *at
        )
    settings = [deref(one) for one in args[: found.settings]]
    setting: Any = None
    if name == "quantile":
        setting = settings[0]
        if setting.__class__ not in (int, float) or not 0 <= setting <= 1:
            raise reader.error("quantile needs a number from 0 to 1", *at)
    elif settings:
        setting = tuple(settings)
        if not all(one.__class__ is Atom for one in settings):
            raise reader.error(f"{found.form} needs the names of three predicates", *at)
    return name, setting, deref(args[-1]) if found.takes else None


def _window(reader: WindowReader, form: Any, term: CompoundTerm, given: Set[Var]) -> WindowForm:
    """Return the window that a term says, over a pattern that gives values to some variables."""
    name = form[0].name if form.__class__ is tuple else ""
    if name == "steps" and len(form) == 2:
        steps, looked_at = read_steps(reader, form, given)
        return WindowForm("steps", steps=steps, looked_at=looked_at)
    if name == "running" and len(form) == 2:
        inner = _window(reader, deref(form[1]), term, given)
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


def _hopping(reader: WindowReader, form: CompoundTerm, span: int, step: int) -> WindowForm:
    """Return windows that the clock ends, one after the other; one event can make it end so many of them."""
    if step < SHORTEST or span > MAX_WINDOWS * step:
        message = f"every needs 0.001 seconds at least, and last no more than {MAX_WINDOWS} times those of its every"
        raise reader.error(message, form)
    return WindowForm("every", span, step)


def _seconds(reader: FormReader, name: str, term: CompoundTerm, number: int) -> int:
    span = deref(term[number])
    if span.__class__ not in (int, float) or not span > 0 or span == float("inf") or not from_seconds(span):
        raise reader.error(f"{name} needs a positive number of seconds{bracketed(name, span)}", term, number)
    return from_seconds(span)


def shape_term(part: Shaped) -> Term:
    """Return the term that says a shape."""
    first = timestamps.to_seconds(part.span) if part.value is None else part.value
    if not part.by:
        return functor(part.shape, 1)(first)
    by = part.by[0] if len(part.by) == 1 else make_list(part.by)
    return functor(part.shape, 2)(first, by)


def window_term(form: WindowForm) -> Term:
    """Return the term that says a window."""
    if form.kind == "steps":
        return steps_term(form.steps)
    one, two = functor("every", 1), functor("every", 2)
    span = timestamps.to_seconds(form.span)
    if form.kind == "last":
        return functor("last", 1)(span)
    if form.kind == "newest":
        return functor("last", 2)(form.most, atom("events"))
    if form.kind == "batch":
        made = two(form.most, atom("events"))
    elif form.kind == "first":
        made = two(span, atom("first"))
    elif form.span == form.step:
        made = one(span)
    else:
        made = functor("last", 2)(span, one(timestamps.to_seconds(form.step)))
    return functor("running", 1)(made) if form.running else made


_SINGLE = "a subscription takes single events: a rule may make one of a pattern"
_NOTHING_AFTER = "a subscription takes P with S, and nothing after it"


def subscribed_event(term: Term) -> Term:
    """Return the pattern of the events that a subscription takes: P of ``P with S``, else all of it."""
    found: Any = deref(term)
    return deref(found[1]) if _operator(found) == "with" else found


def subscribed_shape(term: Term) -> Optional[Shaped]:
    """Return which of them are sent; None where all are.

    Raises:
        UsageError: what was expected.
    """
    found: Any = deref(term)
    try:
        if _operator(found) == "with":
            if what_follows(found) is not None:
                raise UsageError(_NOTHING_AFTER)
            return read_shape(_SingleEvent(), found)
    except RuleError as error:
        raise UsageError(error.message) from None
    left = found
    while _operator(left):  # what is to the right of a shape
        left = deref(left[1])
        if _operator(left) == "with":
            raise UsageError(_NOTHING_AFTER)
    return None


def _operator(term: Any) -> str:
    return SPELLINGS.get(term[0], "") if term.__class__ is tuple else ""


class _SingleEvent:
    """Reads a pattern that is a single event; see `FormReader`."""

    def operand(self, parent: CompoundTerm, number: int, operator: str) -> Pattern:
        event = deref(parent[number])
        if event.__class__ not in (tuple, Atom, Var) or _operator(event):
            raise self.error(_SINGLE, event)
        return Occurs(event)

    def span(self, name: str, term: CompoundTerm) -> int:
        raise self.error(_SINGLE, term)  # for patterns that may take some time

    def error(self, message: str, term: Term, number: int = 0) -> RuleError:
        return RuleError(message)
