"""Declared events: ``:- event temperature(motor:atom, value:number).``, and what does not fit them."""

from difflib import get_close_matches
from typing import Any, Callable, Dict, Iterable, Iterator, List, Mapping, NamedTuple, Optional, Set, Tuple

from ...foundation import Place, RuleError, UsageError, counted
from ...messages import type_name
from ...prolog.syntax import OperatorKind
from ...prolog.terms import COLON, COMMA, Atom, CompoundTerm, Functor, Term, Var, atom, deref, functor
from .alarms import ALARMS
from .calls import Subgoal, calls
from .eventnames import means_other
from .heads import SYNCHRONIZED
from .made import makes_event
from .operators import SPELLINGS, names_of_kind
from .reading import EventTerm, Spot
from .stateforms import declares_state
from .valuekinds import KINDS, ValueKind, ValuePart, parts_of_value, read_kind

UNDECLARED = atom("undeclared_events")
STRICTLY = atom("error")
"""The flag that has every event be declared, and its value then."""

_EXAMPLE = "temperature(motor:atom, value:number)"
_BRANCHES = frozenset(
    functor(name, 2) for name in (";", "->", "*->", *names_of_kind(OperatorKind.ALTERNATIVES))
)
_EVENT2 = functor("event", 2)
_REV = functor("rev", 1)
_EVENT = KINDS["event"]


class Argument(NamedTuple):
    """The name of an argument of an event, and the kind of its values."""

    name: str
    kind: ValueKind


_RETRACTED = Argument("the event", _EVENT)


class Declaration(NamedTuple):
    """What a program says of the events of a name."""

    name: str
    arguments: Tuple[Argument, ...]

    @property
    def key(self) -> Functor:
        """The functor of these events."""
        return functor(self.name, len(self.arguments))

    @property
    def term(self) -> Term:
        """The declaration as it is written."""
        if not self.arguments:
            return atom(self.name)
        return (self.key, *((COLON, atom(one.name), one.kind.term) for one in self.arguments))


def declared_in(parent: CompoundTerm, spot: Spot) -> Iterator[Tuple[Declaration, Optional[Place]]]:
    """Yield what the first argument of a term declares, one event or several with commas, and where.

    Raises:
        RuleError: what is wrong, and where.
    """
    stack = [(parent, 1)]
    while stack:
        around, number = stack.pop()
        term = deref(around[number])
        if isinstance(term, tuple) and term[0] is COMMA:
            stack += [(term, 2), (term, 1)]
        else:
            place = spot(term) if isinstance(term, tuple) else spot(around, number)
            yield _declaration(term, place, spot), place


def _declaration(term: Term, place: Optional[Place], spot: Spot) -> Declaration:
    key = _functor(term)
    if key is None:
        raise RuleError(f"a declaration names an event and its arguments, as in {_EXAMPLE}", place)
    name = key.name
    if type_name(name) is not None:
        raise RuleError(f"{name} declares itself: the slots of its messages and their types are known", place)
    if means_other(name):
        raise RuleError(f"{name} means something else in rules: choose another name for the event", place)
    found: Dict[str, Argument] = {}
    for number, part in enumerate(term[1:] if isinstance(term, tuple) else (), 1):
        at = spot(term, number)
        pair = deref(part)
        called = deref(pair[1]) if isinstance(pair, tuple) and pair[0] is COLON else None
        if not isinstance(pair, tuple) or not isinstance(called, Atom):
            raise RuleError(f"an argument is declared by its name and kind, as in {_EXAMPLE}", at)
        if called.name in found:
            raise RuleError(f"two arguments of {name} are called {called.name}", at)
        try:
            found[called.name] = Argument(called.name, read_kind(pair[2]))
        except UsageError as error:
            raise RuleError(error.message, at) from error
    return Declaration(name, tuple(found.values()))


class Declarations:
    """The declarations that hold, and what does not fit them.

    Args:
        show: gives the text of a term.
        found: what has been declared.
        strict: whether every event is to be declared.
        others: of the functor of an event that is not declared, whether it needs no declaration.
    """

    def __init__(
        self,
        show: Callable[[Term], str],
        found: Iterable[Declaration] = (),
        strict: bool = False,
        others: Callable[[Functor], bool] = lambda key: False,
    ):
        self._show = show
        self._found = {one.name: one for one in found}
        self.strict = strict
        self._others = others

    def __bool__(self) -> bool:
        return self.strict or bool(self._found)

    def get(self, name: str) -> Optional[Declaration]:
        """Return what is declared of the events of a name."""
        return self._found.get(name)

    def add(self, one: Declaration) -> bool:
        """Have a declaration hold; tell whether it is new.

        Raises:
            UsageError: where the name is declared otherwise.
        """
        before = self._found.setdefault(one.name, one)
        if before.term != one.term:
            raise UsageError(f"{one.name} is declared already, as {self._show(before.term)}")
        return before is one

    def wrong_functor(self, key: Functor) -> str:
        """Return what is wrong with events of a functor, "" where nothing is."""
        one = self._found.get(key.name)
        if one is not None:
            if len(one.arguments) == key.arity:
                return ""
            number = counted(len(one.arguments), "argument")
            return f"{key} is not as it is declared: {self._show(one.term)} has {number}"
        if not self.strict or self._others(key):
            return ""
        near = get_close_matches(key.name, self._found, 1)
        meant = (
            f"did you mean {self._show(self._found[near[0]].term)}?"
            if near
            else f"write :- event {_form(key)}."
        )
        return f"{key} is not declared; {meant}"

    def misfits(self, events: Iterable[EventTerm], spot: Spot, kinds: "VariableKinds") -> Iterator[RuleError]:
        """Yield where events that stand together, in a rule or clause, do not fit their declarations."""
        said: Set[Tuple[str, Optional[Place]]] = set()
        for event in events:
            stack = [event]
            while stack:
                one = stack.pop()
                for error in self._misfits(one, spot, kinds, stack):
                    if (error.message, error.place) not in said:
                        said.add((error.message, error.place))
                        yield error

    def _misfits(
        self, event: EventTerm, spot: Spot, kinds: "VariableKinds", inner: List[EventTerm]
    ) -> Iterator[RuleError]:
        """Yield where one event does not fit, and note the events in it."""
        term: Any = deref(event.term)
        key = _functor(term)
        if key is None:
            return
        wrong = "" if key is _REV else self.wrong_functor(key)
        if wrong:
            place = spot(term) if term.__class__ is tuple else spot(event.parent, event.number)
            yield RuleError(wrong, place)
            return
        declared = self._found.get(key.name)
        arguments = (_RETRACTED,) if key is _REV else () if declared is None else declared.arguments
        for at, argument in enumerate(arguments, 1):
            for part in parts_of_value(term, at, argument.kind):
                where = f"{argument.name} of {key}"
                is_var = part.value.__class__ is Var
                text = (
                    kinds.clash(part.value, part.kind, where) if is_var else self._no(part, where, declared)
                )
                if text:
                    yield RuleError(text, spot(part.parent, part.number) or spot(term, at))
                elif part.kind is _EVENT and not is_var:
                    inner.append(EventTerm(part.value, part.parent, part.number))

    def _no(self, part: ValuePart, where: str, one: Optional[Declaration]) -> str:
        """Return why a value is not of its kind, "" where it is."""
        if part.kind.takes(part.value):
            return ""
        inside = "an item of " if part.is_item else ""
        form = "" if one is None else f"; declared as {self._show(one.term)}"
        return f"{inside}{where} is {part.kind.what}, found {self._show(part.value)}{form}"

    def refusal(self, term: Term) -> str:
        """Return why an event that has come does not fit its declaration, "" where it does."""
        parent = (_HOLDER, term)
        for error in self.misfits([EventTerm(deref(term), parent, 1)], _nowhere, VariableKinds({}, False)):
            return error.message
        return ""


_HOLDER = functor("$event", 1)


class VariableKinds:
    """The variables of one rule or clause, and the kinds that they are found to be of.

    Args:
        names: of the variables.
        told: whether kinds that exclude each other are: not where the variables may stand in different branches.
    """

    def __init__(self, names: Mapping[Var, str], told: bool = True):
        self._names = names
        self._told = told
        self._known: Dict[Term, Tuple[ValueKind, str]] = {}

    def clash(self, var: Term, kind: ValueKind, where: str) -> str:
        """Note the kind of a variable; return that it has another one elsewhere, "" where it may be both."""
        known, other = self._known.setdefault(var, (kind, where))
        if kind.forms < known.forms:
            self._known[var] = (kind, where)
        if not self._told or not known.excludes(kind):
            return ""
        name = self._names[var] if isinstance(var, Var) and var in self._names else "this variable"
        return f"{name} is {known.what} ({other}) and, here, {kind.what} ({where}): these are never the same"


def head_event(parent: CompoundTerm, number: int) -> EventTerm:
    """Return the event that a rule fires, now or later, whose head is an argument of a term."""
    term = deref(parent[number])
    while isinstance(term, tuple) and (
        term[0] in ALARMS or term[0] in SYNCHRONIZED or SPELLINGS.get(term[0]) == "do"
    ):
        parent, number, term = term, 1, deref(term[1])
    return EventTerm(term, parent, number)


def query_goals(head: Term) -> List[Subgoal]:
    """Return what the query of a rule's head calls, where it has one."""
    head = deref(head)
    return list(calls(head, 2)) if head.__class__ is tuple and head[0] in SYNCHRONIZED else []


def has_branches(whole: Term) -> bool:
    """Tell whether alternatives stand in a term, of which one only holds at a time."""
    stack = [whole]
    while stack:
        term = deref(stack.pop())
        if isinstance(term, tuple):
            if term[0] in _BRANCHES:
                return True
            stack += term[1:]
    return False


def made_by_goals(goals: Iterable[Subgoal]) -> Iterator[EventTerm]:
    """Yield the events that goals make, and those that begin and end states."""
    for call in goals:
        term = call.term
        if isinstance(term, tuple) and declares_state(term):
            yield EventTerm(deref(term[1]), term, 1)
            for part in map(deref, term[2:4]):
                if isinstance(part, tuple) and len(part) == 2:
                    yield EventTerm(deref(part[1]), part, 1)
        if term.__class__ is tuple and makes_event(term):
            made = deref(term[1])
            if made.__class__ is tuple and made[0] is _EVENT2 and len(term) == 2:
                term, made = made, deref(made[1])
            yield EventTerm(made, term, 1)


def _functor(term: Term) -> Optional[Functor]:
    """Return the functor of an event; None for what is none, or not known yet."""
    if isinstance(term, tuple):
        found: Functor = term[0]
        return found
    return term.functor if isinstance(term, Atom) else None


def _form(key: Functor) -> str:
    arguments = ", ".join(["name:kind"] * key.arity)
    return f"{key.name}({arguments})" if arguments else key.name


def _nowhere(part: Term, number: int = 0) -> Optional[Place]:
    return None
