"""Declared events and the types of their arguments.

``:- event temperature(motor:atom, value:number).`` declares the arguments of an event by name and type (an event
schema). The module parses such declarations (`parse_declarations`), checks that events in rules and clauses fit them
(`Declarations`), checks events at run time (`DeclaredEvents`), and checks the names that a program may give to the
events of a topic.

The type check works without running the program: each term belongs to one of a few *forms* (see `form_of`), and a
`ValueType` is the set of forms that its values can have. Two types exclude each other if they share no form. A
variable of a rule has the types of all its occurrences (see `VariableTypes`); two occurrences with types that exclude
each other are reported, because no event can satisfy both.
"""

from typing import (
    Any,
    Callable,
    Dict,
    FrozenSet,
    Hashable,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Set,
    Tuple,
)

from ...foundation.displayed_text import format_count
from ...foundation.errors import RuleError, UsageError
from ...foundation.ros_name_checks import name_fault
from ...foundation.similar_names import closest_name, did_you_mean
from ...foundation.source_places import Place
from ...messages.type_definition import Field, type_name
from ...prolog.database.clause_index import Clause
from ...prolog.machine.errors import domain_error
from ...prolog.machine.machine import Machine
from ...prolog.syntax.operators import DECLARE_EVENT
from ...prolog.system.prolog_system import PrologSystem
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
    functor_of,
)
from .called_predicates import Subgoal, calls
from .event_operators import (
    OPERATOR_NAMES,
    PAIR_OPERATORS,
    RESERVED_EVENT_ARITIES,
    OperatorKind,
    names_of_kind,
)
from .pattern_parser import EventTerm, PlaceLookup, no_place
from .rule_heads import ALARMS, SYNCHRONIZED, makes_event
from .state_parser import declares_state

_RESERVED_NAMES = frozenset(
    (
        *PAIR_OPERATORS,
        *RESERVED_EVENT_ARITIES,
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
"""Names with a fixed meaning in rules, which events of a topic or declared events cannot have."""


def event_name_error(name: str) -> Optional[str]:
    """Return the reason why the events of a topic cannot have a name, or None."""
    error = name_fault(name)
    if error is not None:
        return error
    if not name[0].islower():
        return f"the name of an event begins with a small letter, found {name}"
    if "__0__" in name:
        return f"{name} is reserved for the events of message types: choose a name without __0__"
    if name in _RESERVED_NAMES:
        return f"{name} has a fixed meaning in rules: choose another name for the events"
    return None


_LIST = functor("list", 1)
_FLOAT_NAMES = frozenset(("nan", "inf", "infinite"))


_AMBIGUOUS_FORMS = frozenset(("word",))
"""Form of ``nan`` and ``inf``, which are both atoms and floats: a common form ``word`` alone proves nothing."""


class ValueType(NamedTuple):
    """Type of argument values.

    Attributes:
        term: the type as it is written.
        description: a value of the type in words, with its article.
        forms: forms of terms with this type, see `form_of`; ``stamp`` is the list [Sec,NSec] of a message.
        items: type of the items, for a list whose item type is declared.
        message_name: name of the terms, for messages.
    """

    term: Term
    description: str
    forms: FrozenSet[str]
    items: "Optional[ValueType]" = None
    message_name: str = ""

    @property
    def name(self) -> str:
        """Name of the type; ``list`` also for a list whose item type is declared."""
        term: Any = self.term
        return str(term[0].name if term.__class__ is tuple else term.name)

    def excludes(self, other: "ValueType") -> bool:
        """Return whether no value has both types."""
        # Two messages of different types never unify, although both are compound terms.
        if self.message_name and other.message_name:
            return self.message_name != other.message_name
        # ``nan`` and ``inf`` are atoms and numbers, so a shared form ``word`` alone does not make two types
        # compatible.
        return not (self.forms & other.forms) - _AMBIGUOUS_FORMS

    def accepts(self, value: Any) -> bool:
        """Return whether a bound value has the type, without checking the items of lists."""
        if form_of(value) not in self.forms:
            return False
        if self.message_name:
            name: str = value[0].name if value.__class__ is tuple else value.name
            return name == self.message_name
        return self.term is not _TIME or _may_be_instant(value)


def _create_value_types(*table: Tuple[str, str, str]) -> Dict[str, ValueType]:
    return {
        name: ValueType(atom(name), description, frozenset(forms.split()))
        for name, description, forms in table
    }


VALUE_TYPES = _create_value_types(
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
"""Types that a declaration can name, except messages and ``list(Type)``."""

SLOT_TYPES = _create_value_types(
    ("list", "a list", "nil cons"),
    ("text", "a text", "quoted"),
    ("plain_text", "a plain text", "atom word"),
    ("stamp", "a stamp [Sec,NSec]", "stamp"),
    ("bool", "true or false", "atom"),
    ("number", "a number", "integer float word"),
)
"""Types of message slots that are not messages themselves."""

_TIME = VALUE_TYPES["time"].term


def slot_value_type(slot: Field) -> Optional[ValueType]:
    """Return the type of the values of a slot, or None if they are messages."""
    if slot.length is not None and not slot.is_bytes:
        return SLOT_TYPES["list"]
    if slot.type == "string" or slot.is_bytes:
        return SLOT_TYPES["plain_text" if slot.is_plain else "text"]
    if slot.definition is not None:
        return None
    if slot.type in ("time", "duration"):
        return SLOT_TYPES["stamp"]
    return SLOT_TYPES["bool" if slot.type == "bool" else "number"]


def form_of(value: Term) -> str:
    """Return the form of a term, which decides the types it can have; "" for a variable."""
    if isinstance(value, Atom):
        if value is NIL:
            return "nil"
        # A string of a message, which is an atom that includes the quotes.
        if value.name.startswith('"'):
            return "quoted"
        return "word" if value.name in _FLOAT_NAMES else "atom"
    if isinstance(value, tuple):
        return "cons" if value[0] is CONS else "compound"
    return _FORMS.get(value.__class__, "")


_FORMS: Dict[type, str] = {String: "text", int: "integer", float: "float"}


def parse_value_type(type_term: Term) -> ValueType:
    """Return the type that a term names.

    Raises:
        UsageError: if no such type exists.
    """
    term, depth = deref(type_term), 0
    # The depth is limited, so that a cyclic or generated term cannot loop here.
    while isinstance(term, tuple) and term[0] is _LIST and depth < _MAX_LIST_DEPTH:
        term, depth = deref(term[1]), depth + 1
    value_type = _parse_simple_type(term)
    for _ in range(depth):
        value_type = ValueType((_LIST, value_type.term), "a list", VALUE_TYPES["list"].forms, value_type)
    return value_type


_MAX_LIST_DEPTH = 10
"""Levels of ``list(list(...))`` that a type may have."""


def _parse_simple_type(term: Term) -> ValueType:
    if not isinstance(term, Atom):
        raise UsageError(f"a type is {_list_type_notations()}")
    value_type = VALUE_TYPES.get(term.name)
    if value_type is not None:
        return value_type
    if type_name(term.name) is not None:
        return ValueType(term, f"a message {term.name}", frozenset(("compound", "atom")), None, term.name)
    hint = did_you_mean(term.name, VALUE_TYPES)
    raise UsageError(f"there is no type {term.name}{hint or f': a type is {_list_type_notations()}'}")


def _list_type_notations() -> str:
    return f"{', '.join(VALUE_TYPES)}, list(Type) or the name of a message's term"


class ValuePart(NamedTuple):
    """Value with a declared type, and its position: argument ``position`` of ``parent``, or an item of a list."""

    value: Term
    value_type: ValueType
    parent: CompoundTerm
    position: int
    is_item: bool = False


def parts_of_value(parent: CompoundTerm, position: int, value_type: ValueType) -> Iterator[ValuePart]:
    """Yield argument ``position`` of a term, which has a declared type, and all items of lists in it."""
    stack = [ValuePart(deref(parent[position]), value_type, parent, position)]
    while stack:
        part = stack.pop()
        yield part
        value = part.value
        if part.value_type.items is not None and isinstance(value, tuple) and value[0] is CONS:
            items, _ = list_parts(value)
            # An item has no place of its own in the term: the list and the number of the item identify it.
            for position in range(len(items), 0, -1):
                stack.append(
                    ValuePart(deref(items[position - 1]), part.value_type.items, value, position, True)
                )


def _may_be_instant(value: Term) -> bool:
    """Return whether a term with the form of an instant is one, or can become one when it is bound."""
    if is_ground(value):
        try:
            from_any(value)
        except UsageError:
            return False
        return True
    return isinstance(value, tuple) and value[0] in (CONS, DATIME6, DATIME7)


UNDECLARED = atom("undeclared_events")
"""Name of the flag for events without a declaration."""

STRICTLY = atom("error")
"""Value of the flag `UNDECLARED` that requires a declaration for every event."""

_EXAMPLE = "temperature(motor:atom, value:number)"
_ALTERNATIVES = frozenset(
    functor(name, 2) for name in (";", "->", "*->", *names_of_kind(OperatorKind.ALTERNATIVES))
)
_EVENT2 = functor("event", 2)
_REV = functor("rev", 1)
_EVENT = VALUE_TYPES["event"]


class Argument(NamedTuple):
    """Declared argument of an event: name and type."""

    name: str
    value_type: ValueType


_RETRACTED_EVENT = Argument("the event", _EVENT)


class Declaration(NamedTuple):
    """Declaration of the events of one name."""

    name: str
    arguments: Tuple[Argument, ...]

    @property
    def key(self) -> Functor:
        """The functor of the declared events."""
        return functor(self.name, len(self.arguments))

    @property
    def term(self) -> Term:
        """The declaration as it is written."""
        if not self.arguments:
            return atom(self.name)
        return (
            self.key,
            *((COLON, atom(argument.name), argument.value_type.term) for argument in self.arguments),
        )


def parse_declarations(
    parent: CompoundTerm, place_of: PlaceLookup
) -> Iterator[Tuple[Declaration, Optional[Place]]]:
    """Yield the declarations in the first argument of a term, several if they are separated by commas, with places.

    Raises:
        RuleError: if a declaration is malformed.
    """
    stack = [(parent, 1)]
    while stack:
        container, position = stack.pop()
        term = deref(container[position])
        if isinstance(term, tuple) and term[0] is COMMA:
            stack += [(term, 2), (term, 1)]
        else:
            place = place_of(term) if isinstance(term, tuple) else place_of(container, position)
            yield _parse_declaration(term, place, place_of), place


def _parse_declaration(term: Term, place: Optional[Place], place_of: PlaceLookup) -> Declaration:
    key = functor_of(term)
    if key is None:
        raise RuleError(f"a declaration names an event and its arguments, as in {_EXAMPLE}", place)
    name = key.name
    if type_name(name) is not None:
        raise RuleError(
            f"{name} needs no declaration: the slots of its messages and their types are known", place
        )
    if name in _RESERVED_NAMES:
        raise RuleError(f"{name} has a fixed meaning in rules: choose another name for the event", place)
    arguments: Dict[str, Argument] = {}
    for position, part in enumerate(term[1:] if isinstance(term, tuple) else (), 1):
        argument_place = place_of(term, position)
        pair = deref(part)
        argument_name = deref(pair[1]) if isinstance(pair, tuple) and pair[0] is COLON else None
        if not isinstance(pair, tuple) or not isinstance(argument_name, Atom):
            raise RuleError(f"an argument is declared by its name and type, as in {_EXAMPLE}", argument_place)
        if argument_name.name in arguments:
            raise RuleError(f"two arguments of {name} are called {argument_name.name}", argument_place)
        try:
            arguments[argument_name.name] = Argument(argument_name.name, parse_value_type(pair[2]))
        except UsageError as error:
            raise RuleError(error.message, argument_place) from error
    return Declaration(name, tuple(arguments.values()))


class Declarations:
    """Declarations in force, and checks of events against them.

    Args:
        show: returns the text of a term.
        declarations: the initial declarations.
        strict: whether every event must be declared.
        is_exempt: returns whether an undeclared event with a given functor needs no declaration.
    """

    def __init__(
        self,
        show: Callable[[Term], str],
        declarations: Iterable[Declaration] = (),
        strict: bool = False,
        is_exempt: Callable[[Functor], bool] = lambda key: False,
    ):
        self._term_text = show
        self._declarations: Dict[str, Declaration] = {}
        self.update(declarations)
        self.strict = strict
        self._is_exempt = is_exempt

    def set_strict(self, strict: bool) -> None:
        """Set whether every event must be declared."""
        self.strict = strict

    def __bool__(self) -> bool:
        return self.strict or bool(self._declarations)

    def get(self, name: str) -> Optional[Declaration]:
        """Return the declaration for events of a name, or None."""
        return self._declarations.get(name)

    def update(self, declarations: Iterable[Declaration]) -> None:
        """Add declarations, which replace those of the same names."""
        self._declarations.update((declaration.name, declaration) for declaration in declarations)

    def add(self, declaration: Declaration) -> None:
        """Add a declaration.

        Raises:
            UsageError: if the name has a different declaration.
        """
        self.update(self.find_new([declaration]))

    def find_new(self, declarations: Iterable[Declaration]) -> List[Declaration]:
        """Return those of some declarations that are not in force yet, each once.

        Raises:
            UsageError: if a name has a different declaration.
        """
        new: Dict[str, Declaration] = {}
        for declaration in declarations:
            # A file may be loaded again, and several files may share a declaration: repeating it is not an error.
            existing = self._declarations.get(declaration.name) or new.setdefault(
                declaration.name, declaration
            )
            if existing.term != declaration.term:
                raise UsageError(
                    f"{declaration.name} is declared already, as {self._term_text(existing.term)}"
                )
        return list(new.values())

    def functor_error(self, key: Functor) -> str:
        """Return the error for events with a functor, or "" if the functor is as declared."""
        declaration = self._declarations.get(key.name)
        if declaration is not None:
            if len(declaration.arguments) == key.arity:
                return ""
            argument_count = format_count(len(declaration.arguments), "argument")
            return f"{key} does not match its declaration: {self._term_text(declaration.term)} has {argument_count}"
        if not self.strict or self._is_exempt(key):
            return ""
        # In strict mode, a misspelt name is more likely than a forgotten declaration.
        closest = closest_name(key.name, self._declarations)
        advice = (
            f"did you mean {self._term_text(self._declarations[closest].term)}?"
            if closest
            else f"write :- event {_declaration_template(key)}."
        )
        return f"{key} is not declared; {advice}"

    def find_errors(
        self, events: Iterable[EventTerm], place_of: PlaceLookup, variable_types: "VariableTypes"
    ) -> Iterator[RuleError]:
        """Yield an error for each misfit between events of one rule or clause and their declarations."""
        reported: Set[Tuple[str, Optional[Place]]] = set()
        for event in events:
            stack = [event]
            while stack:
                current = stack.pop()
                for error in self._find_event_errors(current, place_of, variable_types, stack):
                    if (error.message, error.place) not in reported:
                        reported.add((error.message, error.place))
                        yield error

    def _find_event_errors(
        self,
        event: EventTerm,
        place_of: PlaceLookup,
        variable_types: "VariableTypes",
        inner_events: List[EventTerm],
    ) -> Iterator[RuleError]:
        """Yield the errors of one event, and append events that it contains to ``inner_events``."""
        term: Any = deref(event.term)
        key = functor_of(term)
        if key is None:
            return
        # ``rev(E)`` retracts an event: its argument is checked as an event, not as an argument of an event.
        error_text = "" if key is _REV else self.functor_error(key)
        if error_text:
            place = place_of(term) if term.__class__ is tuple else place_of(event.parent, event.position)
            yield RuleError(error_text, place)
            return
        declaration = self._declarations.get(key.name)
        arguments = (
            (_RETRACTED_EVENT,) if key is _REV else () if declaration is None else declaration.arguments
        )
        for position, argument in enumerate(arguments, 1):
            for part in parts_of_value(term, position, argument.value_type):
                subject = f"{argument.name} of {key}"
                is_var = part.value.__class__ is Var
                text = (
                    variable_types.add_occurrence(part.value, part.value_type, subject)
                    if is_var
                    else self._explain_type_error(part, subject, declaration)
                )
                if text:
                    yield RuleError(text, place_of(part.parent, part.position) or place_of(term, position))
                elif part.value_type is _EVENT and not is_var:
                    inner_events.append(EventTerm(part.value, part.parent, part.position))

    def _explain_type_error(self, part: ValuePart, subject: str, declaration: Optional[Declaration]) -> str:
        """Return the error for a value that does not have its type, or ""."""
        if part.value_type.accepts(part.value):
            return ""
        prefix = "an item of " if part.is_item else ""
        declared_form = "" if declaration is None else f"; declared as {self._term_text(declaration.term)}"
        found = self._term_text(part.value)
        return f"{prefix}{subject} is {part.value_type.description}, found {found}{declared_form}"

    def refusal(self, term: Term) -> str:
        """Return the reason why an incoming event does not fit its declaration, or ""."""
        parent = (_EVENT_WRAPPER, term)
        # Values of one event are bound, so no variable can occur in two places: clashes need no report.
        for error in self.find_errors(
            [EventTerm(deref(term), parent, 1)], no_place, VariableTypes({}, False)
        ):
            return error.message
        return ""


_EVENT_WRAPPER = functor("$event", 1)


class VariableTypes:
    """Types of the variables of one rule or clause, collected from all their occurrences.

    Args:
        names: names of the variables, for error messages.
        reports_clashes: whether types that exclude each other are an error; False if the occurrences can lie in
            different branches.
    """

    def __init__(self, names: Mapping[Var, str], reports_clashes: bool = True):
        self._names = names
        self._reports_clashes = reports_clashes
        self._occurrences: Dict[Term, Dict[Hashable, Tuple[ValueType, str]]] = {}
        """For each variable its different types, each with the subject of the first occurrence."""

    def add_occurrence(self, var: Term, value_type: ValueType, subject: str) -> str:
        """Record a type of a variable, and return an error if another occurrence excludes it, else ""."""
        occurrences = self._occurrences.setdefault(var, {})
        # All types are compared, not only the narrowest one: a time can be a number or a list, so a variable that is
        # a time, a number and a list has no value, although the time excludes neither of the others.
        clashes = [
            occurrence
            for occurrence in occurrences.values()
            if self._reports_clashes and occurrence[0].excludes(value_type)
        ]
        occurrences.setdefault((value_type.forms, value_type.message_name), (value_type, subject))
        if not clashes:
            return ""
        # The narrowest type says most about the variable.
        previous_type, previous_subject = min(clashes, key=lambda occurrence: len(occurrence[0].forms))
        name = self._names[var] if isinstance(var, Var) and var in self._names else "this variable"
        previous_text = f"{previous_type.description} ({previous_subject})"
        return f"{name} is {previous_text} and, here, {value_type.description} ({subject}): these are never equal"


def head_event(rule: CompoundTerm) -> EventTerm:
    """Return the event in the head of a rule: the head itself, or the event inside an alarm, query or ``do``."""
    parent, position = rule, 1
    term = deref(parent[position])
    while isinstance(term, tuple) and (
        term[0] in ALARMS or term[0] in SYNCHRONIZED or OPERATOR_NAMES.get(term[0]) == "do"
    ):
        parent, position, term = term, 1, deref(term[1])
    return EventTerm(term, parent, position)


def calls_in_query(head: Term) -> List[Subgoal]:
    """Return the calls in the query of a rule head, if the head has one."""
    head = deref(head)
    return list(calls(head, 2)) if head.__class__ is tuple and head[0] in SYNCHRONIZED else []


def has_alternatives(root: Term) -> bool:
    """Return whether a term contains alternatives that exclude each other."""
    stack = [root]
    while stack:
        term = deref(stack.pop())
        if isinstance(term, tuple):
            if term[0] in _ALTERNATIVES:
                return True
            stack += term[1:]
    return False


def events_raised_by_goals(goals: Iterable[Subgoal]) -> Iterator[EventTerm]:
    """Yield the events that goals raise, and the events that start and end declared states."""
    for call in goals:
        term = call.term
        if isinstance(term, tuple) and declares_state(term):
            yield EventTerm(deref(term[1]), term, 1)
            for part in map(deref, term[2:4]):
                if isinstance(part, tuple) and len(part) == 2:
                    yield EventTerm(deref(part[1]), part, 1)
        if term.__class__ is tuple and makes_event(term):
            event = deref(term[1])
            # ``new_event(event(E, Interval))`` wraps the event once more.
            if event.__class__ is tuple and event[0] is _EVENT2 and len(term) == 2:
                term, event = event, deref(event[1])
            yield EventTerm(event, term, 1)


def _declaration_template(key: Functor) -> str:
    arguments = ", ".join(["name:type"] * key.arity)
    return f"{key.name}({arguments})" if arguments else key.name


_DECLARED = functor("$declared_event", 1)
"""Hidden predicate whose clauses are the declarations."""

_ALWAYS_DECLARED = frozenset(functor(name, arity) for name, arity in (("null", 0), ("null_event", 0)))
_NO_CLAUSES: List[Clause] = []


class DeclaredEvents:
    """The declarations of a program, and the check of events at run time.

    Declarations are stored as clauses of a hidden predicate. So they are removed, reloaded and saved like the other
    clauses of a program, without code of their own. The parsed form is cached per clause.

    Args:
        logic: stores the declarations, and defines ``declare_event/1``.
        is_strict: returns whether each event must be declared, as flag ``undeclared_events`` determines.
        is_external_event: returns whether events of a functor need no declaration, because they are messages or
            events of the package itself.

    Attributes:
        checks_events: whether events are checked: something was declared, or the flag requires declarations.
    """

    def __init__(
        self, logic: PrologSystem, is_strict: Callable[[], bool], is_external_event: Callable[[Functor], bool]
    ):
        self._logic = logic
        self._is_strict = is_strict
        self._clauses: List[Clause] = _NO_CLAUSES
        self._clause_count = self._retracted_count = 0
        self._parsed_clauses: Dict[Clause, List[Declaration]] = {}
        self._strict = False
        self._current_declarations = Declarations(logic.brief)
        self.checks_events = False
        self._is_external_event = is_external_event
        logic.define(DECLARE_EVENT.name, 1, self._declare)

    def check_all(self) -> None:
        """Check events even if nothing is declared."""
        self.checks_events = True

    def current_declarations(self) -> Declarations:
        """Return a copy of the present declarations; additions to it have no effect on others."""
        return Declarations(
            self._logic.brief,
            self._parse_clauses(),
            self._is_strict(),
            self._needs_no_declaration,
        )

    def _parse_clauses(self) -> Iterable[Declaration]:
        predicate = self._logic.database.predicates.get(_DECLARED)
        # The dictionary is created again, so that it contains only clauses that still exist.
        previous, self._parsed_clauses = self._parsed_clauses, {}
        for clause in () if predicate is None else predicate.active_clauses():
            if clause in previous:
                self._parsed_clauses[clause] = previous[clause]
            yield from self._declarations_of(clause)

    def _declarations_of(self, clause: Clause) -> List[Declaration]:
        declarations = self._parsed_clauses.get(clause)
        if declarations is None:
            declarations = self._parsed_clauses[clause] = _parse_clause(clause)
        return declarations

    def _needs_no_declaration(self, key: Functor) -> bool:
        return key in _ALWAYS_DECLARED or type_name(key.name) is not None or self._is_external_event(key)

    def _declare(self, machine: Machine, declared: Term) -> bool:
        goal = (DECLARE_EVENT, deref(declared))
        try:
            # All declarations of the goal are checked before the first one is added.
            declarations = [declaration for declaration, _ in parse_declarations(goal, no_place)]
            new_declarations = self._declarations_in_force().find_new(declarations)
        except (RuleError, UsageError) as error:
            raise domain_error("event_declaration", declared, error.message) from None
        self.checks_events = True
        for declaration in new_declarations:
            self._logic.add_clause((_DECLARED, declaration.term))
        return True

    def clear(self) -> None:
        """Remove all declarations."""
        predicate = self._logic.database.predicates.get(_DECLARED)
        if predicate is not None:
            predicate.clear()

    def refusal(self, term: Term) -> str:
        """Return the reason why an event does not match its declaration, or "" if it matches."""
        return self._declarations_in_force().refusal(term)

    def _declarations_in_force(self) -> Declarations:
        """Return the present declarations; clauses are parsed if they are new."""
        predicate = self._logic.database.predicates.get(_DECLARED)
        clauses, retracted_count = (
            (_NO_CLAUSES, 0) if predicate is None else (predicate.clauses, predicate.retracted_count)
        )
        strict = self._is_strict()
        clause_count = len(clauses)
        # A list of clauses only grows, or is replaced by another list. So its identity and length, the number of dead
        # clauses and the flag identify its contents.
        if clauses is not self._clauses or retracted_count != self._retracted_count or strict != self._strict:
            self._current_declarations = self.current_declarations()
        elif clause_count != self._clause_count:
            # Only further clauses: a program of many declarations is loaded in linear time.
            for clause in clauses[self._clause_count :]:
                self._current_declarations.update(self._declarations_of(clause))
        self._clauses, self._retracted_count, self._strict = clauses, retracted_count, strict
        self._clause_count = clause_count
        return self._current_declarations

    def require_declared(self, pattern: Term) -> None:
        """Check a pattern or event in a goal.

        Raises:
            PrologError: if it does not match its declaration.
        """
        reason = self.refusal(pattern) if self.checks_events else ""
        if reason:
            raise domain_error("declared_event", pattern, reason)


def _parse_clause(clause: Clause) -> List[Declaration]:
    assert isinstance(clause.head, tuple)
    try:
        return [declaration for declaration, _ in parse_declarations(clause.head, no_place)]
    except RuleError:
        # The program itself has asserted a clause under the hidden name.
        return []
