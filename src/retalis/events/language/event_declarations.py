"""What a program may call the events of a topic.

The kinds of values that a declared event has: one table, and what fits which.

Declared events: ``:- event temperature(motor:atom, value:number).``, and what does not fit them.
"""

from difflib import get_close_matches
from typing import (
    Any,
    Callable,
    Dict,
    FrozenSet,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Set,
    Tuple,
)

from ...foundation.errors import Place, RuleError, UsageError, counted
from ...foundation.ros_names import plain_fault
from ...messages.type_definition import Field, type_name
from ...prolog.syntax.event_operators import OperatorKind
from ...prolog.terms.list_terms import list_parts
from ...prolog.terms.term_traversal import is_ground
from ...prolog.terms.timestamps import DATIME6, DATIME7, from_any
from ...prolog.terms.types import (
    COLON,
    COMMA,
    CONS,
    NIL,
    Atom,
    CompoundTerm,
    Functor,
    String,
    Term,
    Var,
    atom,
    deref,
    functor,
)
from .goal_analysis import Subgoal, calls
from .pattern_operators import NO_EVENTS, OPERATORS, SPELLINGS, names_of_kind
from .pattern_parser import EventTerm, Spot
from .rule_parser import ALARMS, SYNCHRONIZED, makes_event
from .state_parser import declares_state

_TAKEN = frozenset(
    (
        *OPERATORS,
        *NO_EVENTS,
        "event",
        "false",
        "new_event",
        "null_event",
        "query_given_up",
        "rev",
        "synchronized",
        "syncronized",
        "true",
    )
)
"""Names of which events mean something else, or which events do not have."""


def means_other(name: str) -> bool:
    """Tell whether a name means something else in rules."""
    return name in _TAKEN


def event_fault(name: str) -> Optional[str]:
    """Return why the events of a topic cannot have a name, or None."""
    fault = plain_fault(name)
    if fault is not None:
        return fault
    if not name[0].islower():
        return f"the name of an event begins with a small letter, found {name}"
    if "__0__" in name:
        return f"{name} is what the events of a message type are called: choose a name without __0__"
    if name in _TAKEN:
        return f"{name} means something else in rules: choose another name for the events"
    return None


_LIST = functor("list", 1)
_WORDS_OF_FLOATS = frozenset(("nan", "inf", "infinite"))


_EITHER_WAY = frozenset(("word",))
"""The form of ``nan`` and ``inf``, which are atoms in programs: nobody means a value to be that and nothing else."""


class ValueType(NamedTuple):
    """A kind of values.

    Attributes:
        term: how it is written.
        what: what one of them is called.
        forms: of the terms that may be one, see `form_of`; a ``stamp`` is the list [Sec,NSec] of a message.
        items: the kind of the items, where the kind is of lists and says so.
        of_message: the name of the terms, where they are messages.
    """

    term: Term
    what: str
    forms: FrozenSet[str]
    items: "Optional[ValueType]" = None
    of_message: str = ""

    def excludes(self, other: "ValueType") -> bool:
        """Tell whether no value is of both kinds."""
        if self.of_message and other.of_message:
            return self.of_message != other.of_message
        return not (self.forms & other.forms) - _EITHER_WAY

    def takes(self, value: Any) -> bool:
        """Tell whether a value that is no variable is of the kind; what stands inside lists is not looked at."""
        if form_of(value) not in self.forms:
            return False
        if self.of_message:
            found: str = value[0].name if value.__class__ is tuple else value.name
            return found == self.of_message
        return self.term is not _TIME or _may_be_instant(value)


def _table(*rows: Tuple[str, str, str]) -> Dict[str, ValueType]:
    return {name: ValueType(atom(name), what, frozenset(forms.split())) for name, what, forms in rows}


KINDS = _table(
    ("any", "anything", "atom quoted word nil text integer float cons stamp compound"),
    ("atom", "an atom", "atom quoted word"),
    ("number", "a number", "integer float word"),
    ("integer", "an integer", "integer"),
    ("float", "a float", "float word"),
    ("string", "a string", "text quoted"),
    ("list", "a list", "nil cons stamp"),
    ("time", "an instant", "integer float cons stamp compound"),
    ("event", "an event", "atom quoted word compound"),
)
"""The kinds of arguments of declared events, all but those of messages and of lists of a kind."""

SLOT_KINDS = _table(
    ("list", "a list", "nil cons"),
    ("text", "a text", "quoted"),
    ("stamp", "a stamp [Sec,NSec]", "stamp"),
    ("bool", "true or false", "atom"),
    ("number", "a number", "integer float word"),
)
"""The kinds of slots in messages that are no messages."""

_TIME = KINDS["time"].term


def slot_kind(slot: Field) -> Optional[ValueType]:
    """Return the kind of the values of a slot; None where they are messages."""
    if slot.length is not None and not slot.is_bytes:
        return SLOT_KINDS["list"]
    if slot.type == "string" or slot.is_bytes:
        return SLOT_KINDS["text"]
    if slot.definition is not None:
        return None
    if slot.type in ("time", "duration"):
        return SLOT_KINDS["stamp"]
    return SLOT_KINDS["bool" if slot.type == "bool" else "number"]


def form_of(value: Term) -> str:
    """Return the form of a term, by which kinds are told; that of a variable is ""."""
    if isinstance(value, Atom):
        if value is NIL:
            return "nil"
        if value.name.startswith('"'):  # a text as messages have it
            return "quoted"
        return "word" if value.name in _WORDS_OF_FLOATS else "atom"
    if isinstance(value, tuple):
        return "cons" if value[0] is CONS else "compound"
    return _FORMS.get(value.__class__, "")


_FORMS: Dict[type, str] = {String: "text", int: "integer", float: "float"}


def read_kind(named: Term) -> ValueType:
    """Return the kind that a term names.

    Raises:
        UsageError: where there is no such kind.
    """
    term, depth = deref(named), 0
    while isinstance(term, tuple) and term[0] is _LIST and depth < _MAX_LIST_DEPTH:
        term, depth = deref(term[1]), depth + 1
    found = _plain_kind(term)
    for _ in range(depth):
        found = ValueType((_LIST, found.term), "a list", KINDS["list"].forms, found)
    return found


_MAX_LIST_DEPTH = 10
"""How often lists may be in lists."""


def _plain_kind(term: Term) -> ValueType:
    if not isinstance(term, Atom):
        raise UsageError(f"a kind is {_known()}")
    found = KINDS.get(term.name)
    if found is not None:
        return found
    if type_name(term.name) is not None:
        return ValueType(term, f"a message {term.name}", frozenset(("compound", "atom")), None, term.name)
    near = get_close_matches(term.name, KINDS, 1)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise UsageError(f"there is no kind {term.name}{hint or f': a kind is {_known()}'}")


def _known() -> str:
    return f"{', '.join(KINDS)}, list(Kind) or the name of a message's term"


class ValuePart(NamedTuple):
    """A value of which the kind is known, and by what its place is found: an argument, or an item of a list."""

    value: Term
    kind: ValueType
    parent: CompoundTerm
    number: int
    is_item: bool = False


def parts_of_value(parent: CompoundTerm, number: int, kind: ValueType) -> Iterator[ValuePart]:
    """Yield an argument of a term, which is to be of a kind, and the items of lists in it."""
    stack = [ValuePart(deref(parent[number]), kind, parent, number)]
    while stack:
        part = stack.pop()
        yield part
        value = part.value
        if part.kind.items is not None and isinstance(value, tuple) and value[0] is CONS:
            items, _ = list_parts(value)
            for at in range(len(items), 0, -1):
                stack.append(ValuePart(deref(items[at - 1]), part.kind.items, value, at, True))


def _may_be_instant(value: Term) -> bool:
    """Tell whether a term of the form of an instant is one, or may become one."""
    if is_ground(value):
        try:
            from_any(value)
        except UsageError:
            return False
        return True
    return isinstance(value, tuple) and value[0] in (CONS, DATIME6, DATIME7)


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
    kind: ValueType


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
        self._known: Dict[Term, Tuple[ValueType, str]] = {}

    def clash(self, var: Term, kind: ValueType, where: str) -> str:
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
