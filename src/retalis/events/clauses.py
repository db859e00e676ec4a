"""The forms of an event file: what each of its terms is, checked before anything of the file is active."""

from typing import Any, Dict, List, NamedTuple, Optional, Tuple

from ..errors import Errors, Place, RetalisError, RuleError, UsageError
from ..logic import PrologError
from ..logic.logic import split_clause
from ..syntax import ReadTerm
from ..terms import Atom, Term, Var, atom, copy, deref, functor, list_items, variables
from .alarms import duration
from .calls import Call, Unknown
from .occurrences import occurrences
from .pattern import ARROWS, SPELLINGS, Action, Reader, Spot, bound_by
from .rule import Definition

_SYNCHRONIZED = frozenset((functor("syncronized", 3), functor("synchronized", 3)))
_RULE = functor("rule:", 2)
_COLON = functor(":", 2)
_CLAUSE = functor(":-", 2)
_GRAMMAR = functor("-->", 2)
DIRECTIVES = frozenset((functor(":-", 1), functor("?-", 1)))
_PROPERTY = functor("property", 2)
_PROPERTY_FACT = functor("event_rule_property", 3)
_LESS = functor("<", 2)
_MINUS = functor("-", 1)
_ALARM = functor("exceptionAlarm", 2)
_ARITIES = {"exceptionAlarm": 2, "exceptionAlarmAbsoluteDatime": 2, "syncronized": 3, "synchronized": 3}
_RENAMED = {
    functor("print_trigger", 1): functor("external_trigger", 1),
    functor("persistent_rule", 1): functor("persistent_event", 1),
    functor("module", 2): functor("etalis_module", 2),
}
_UNWRAPPED = frozenset(functor(name, 1) for name in ("db", "prolog", "static"))
_USING = {
    functor("use_module", 1): "use",
    functor("use_module", 2): "use",
    functor("ensure_loaded", 1): "ensure",
}
TOO_DEEP = "the pattern is too deep: too many operators stand one in the other"
KNOWN_PROPERTIES = ("event_rule_window", "window", "window_step")


class Property(NamedTuple):
    """A property of a label."""

    label: Term
    name: str
    value: Term


class Step(NamedTuple):
    """Something to do when the file is accepted: ``kind`` is clause, directive, property, use or ensure."""

    kind: str
    term: Term
    place: Optional[Place]


class Checked(NamedTuple):
    """What a file has in it."""

    steps: List[Step]
    rules: List[Definition]
    inner: List[Definition]


class Checker:
    """Sorts the terms of a file and collects all of their errors and warnings."""

    def __init__(self) -> None:
        self.errors = Errors()
        self.warnings = Errors()
        self.steps: List[Step] = []
        self.rules: List[Definition] = []
        self.inner: List[Definition] = []
        self.calls: List[Unknown] = []
        self._names: Dict[Var, str] = {}

    def read(self, read: ReadTerm) -> None:
        """Check a term that was read from a text."""
        self._names = {var: name for name, var in read.names.items()}
        self.term(read.term, read.place_of, read.place)
        self._names = {}

    def term(self, term: Term, spot: Spot, place: Optional[Place]) -> None:
        """Check a term; ``spot`` gives the place of a part of it, ``place`` is where it begins."""
        term = deref(term)
        try:
            self._sort(term, spot, place)
        except RetalisError as error:
            self.errors.append(error if error.place else RuleError(error.message, place))
        except RecursionError:
            self.errors.append(RuleError(TOO_DEEP, place))

    def _sort(self, term: Term, spot: Spot, place: Optional[Place]) -> None:
        head = term[0] if term.__class__ is tuple else None
        if is_rule(term):
            self._rule(term, spot, place)
        elif head in DIRECTIVES:
            goal = deref(term[1])
            kind = _USING.get(goal[0]) if goal.__class__ is tuple else None
            named = Step("directive", goal, place) if kind is None else Step(kind, deref(goal[1]), place)
            self.steps.append(named)
        elif head in _USING:
            self.steps.append(Step(_USING[head], deref(term[1]), place))
        elif head is _PROPERTY_FACT:
            self._property(Property(deref(term[1]), _name(term[2]), deref(term[3])), place)
            self.steps.append(Step("clause", term, place))
        else:
            if head in _RENAMED:
                self.steps.append(Step("clause", (_RENAMED[head], *term[1:]), place))
            elif head in _UNWRAPPED:
                self.steps.append(Step("clause", deref(term[1]), place))
            if head is _RULE or (head is _COLON and _looks_like_rule(term)):
                self.warnings.append(RuleError("this is no labelled rule, so it is kept as a fact", place))
            self.steps.append(Step("clause", term, place))

    def _property(self, one: Property, place: Optional[Place]) -> None:
        if one.name not in KNOWN_PROPERTIES:
            known = ", ".join(KNOWN_PROPERTIES)
            self.warnings.append(RuleError(f"there is no property {one.name}; there are {known}", place))
        elif one.value.__class__ not in (int, float) or not one.value >= 0:
            raise RuleError(f"property {one.name} needs a number of seconds", place)
        else:
            self.steps.append(Step("property", one, place))

    def _rule(self, term: Term, spot: Spot, place: Optional[Place]) -> None:
        label, rule = _labelled(term)
        if label is not None and label.__class__ is tuple:
            name = label[0].name
            for item in list_items(label[1]) or ():
                part = deref(item)
                self._property(Property(atom(name), _name(part[1]), deref(part[2])), spot(part) or place)
            label = atom(name)
        self.rules.append(self.definition(rule, label, spot, place))

    def definition(self, rule: Term, label: Optional[Term], spot: Spot, place: Optional[Place]) -> Definition:
        """Return what a rule says; rules inside its pattern go to `inner`.

        Raises:
            RuleError: where it cannot fire.
        """
        reader = Reader(lambda part, number=0: spot(part, number) or place, self.warnings.append)
        if rule[0] not in ARROWS:  # P do G
            pattern = reader.read((_RULE, rule), 1)
            definition = Definition(rule, None, pattern, label, place, self._names)
        else:
            head, goal = deref(rule[1]), None
            if head.__class__ is tuple and SPELLINGS.get(head[0]) == "do":
                goal = reader.goal(head, 2, "do")
                head = deref(head[1])
            at = spot(head) if head.__class__ is tuple else spot(rule, 1)
            self._head(head, spot, at or place)
            pattern = reader.read(rule, 2)
            if goal is not None:
                pattern = Action(pattern, goal, False)
            definition = Definition(rule, head, pattern, label, place, self._names)
            self._unbound(head, pattern, at or place)
        self._goals(reader.goals, pattern, spot, place)
        for one in reader.inner:
            self.inner.append(self.definition(one, None, spot, spot(one) or place))
        return definition

    def _head(self, head: Term, spot: Spot, place: Optional[Place]) -> None:
        if head.__class__ not in (tuple, Atom, Var):
            raise RuleError("the head of a rule is an event: an atom or a compound term", place)
        if head.__class__ is not tuple:
            return
        if head[0] is _ALARM and deref(head[2]).__class__ is not Var:
            try:
                duration(head[2])
            except UsageError as error:
                raise RuleError(error.message, spot(head, 2) or place) from None
        takes = _ARITIES.get(head[0].name)
        if takes is not None and takes != len(head) - 1:
            name = head[0].name
            self.warnings.append(
                RuleError(f"this is an ordinary event; {name} takes {takes} arguments", place)
            )
        if head[0] is _COLON:
            self.warnings.append(
                RuleError("this is an event with a colon in it: a rule has one label", place)
            )

    def _goals(self, goals: List[Call], pattern: Any, spot: Spot, place: Optional[Place]) -> None:
        """Check what the goals of a rule call, and note it: what is not there may come with the rest of the file."""
        counts = occurrences([], pattern)
        for call in goals:
            term = call.term
            if term.__class__ is Var and counts[term] == sum(one.term is term for one in goals):
                name = self._names.get(term, "this variable")
                raise RuleError(
                    f"nothing gives {name} a goal to call", spot(call.parent, call.number) or place
                )
            if term.__class__ is tuple:
                self.calls.append(Unknown(term[0], spot(term) or place))
            elif term.__class__ is Atom:
                self.calls.append(Unknown(term.functor, spot(call.parent, call.number) or place))

    def _unbound(self, head: Term, pattern: Any, place: Optional[Place]) -> None:
        bound = {*bound_by(pattern), *_bound_later(head)}
        free = [var for var in variables(head) if var not in bound]
        if head.__class__ is Var and free:
            raise RuleError("nothing in the pattern gives the head a value", place)
        if free:
            names = [self._names[var] for var in free if var in self._names]
            which = f"{' and '.join(names)} of the head" if names else f"{len(free)} variable(s) of the head"
            self.warnings.append(RuleError(f"nothing in the pattern can bind {which}", place))


def _bound_later(head: Term) -> List[Var]:
    """Return the variables of a synchronized event that its query will bind."""
    synchronized = head.__class__ is tuple and head[0] in _SYNCHRONIZED
    return variables(head[2]) if synchronized else []


def nowhere(part: Term, number: int = 0) -> Optional[Place]:
    """Give no place: that of a term which was not read from a text."""
    return None


def is_rule(term: Term) -> bool:
    """Tell whether a term is an event rule, labelled or not."""
    if term.__class__ is not tuple:
        return False
    if term[0] is _RULE or term[0] is _COLON:
        label, rule = _labelled(term)
        return label is not None and _is_plain_rule(rule)
    return _is_plain_rule(term)


def _is_plain_rule(term: Term) -> bool:
    return term.__class__ is tuple and (term[0] in ARROWS or SPELLINGS.get(term[0]) == "do")


def _looks_like_rule(term: Term) -> bool:
    inner = deref(term[2])
    return inner.__class__ is tuple and (_is_plain_rule(inner) or inner[0] in (_RULE, _COLON))


def _labelled(term: Term) -> Tuple[Optional[Term], Term]:
    """Return label and rule; the label is None where there is none or it is malformed."""
    if term[0] is not _RULE and term[0] is not _COLON:
        return None, term
    label = deref(term[1])
    if label.__class__ is tuple:
        items = list_items(label[1]) if len(label) == 2 else None
        if items is None or not all(_is_property(deref(item)) for item in items):
            return None, term
    elif label.__class__ is not Atom:
        return None, term
    return label, deref(term[2])


def _is_property(term: Term) -> bool:
    return term.__class__ is tuple and term[0] is _PROPERTY and deref(term[1]).__class__ is Atom


def _name(term: Term) -> str:
    term = deref(term)
    return term.name if term.__class__ is Atom else "(not an atom)"


def _is_negative(term: Term) -> bool:
    return term.__class__ is tuple and term[0] is _MINUS


_NEARLY_ARROWS = frozenset((functor("->", 2), functor("=", 2)))


def clause_error(logic: Any, term: Term) -> Optional[str]:
    """Return why a term cannot be added as a clause, or None."""
    try:
        if term.__class__ is tuple and term[0] is _GRAMMAR:
            return None
        head, _ = split_clause(copy(term))
        if head.__class__ is tuple and head[0] is _LESS and _is_negative(deref(head[2])):
            return "this compares two terms; the arrow of an event rule is <-, without a blank"
        logic.database.require_writable(head.functor if head.__class__ is Atom else head[0], "modify")
    except PrologError as error:
        is_near = term.__class__ is tuple and term[0] in _NEARLY_ARROWS
        return error.message + ("; a rule's arrow is written <-, a clause's :-" if is_near else "")
    return None
