"""The kinds of values that a declared event has: one table, and what fits which."""

from difflib import get_close_matches
from typing import Any, Dict, FrozenSet, Iterator, NamedTuple, Optional, Tuple

from ...foundation import UsageError
from ...messages import Field, type_name
from ...prolog.terms import (
    CONS,
    DATIME6,
    DATIME7,
    NIL,
    Atom,
    CompoundTerm,
    String,
    Term,
    atom,
    deref,
    from_any,
    functor,
    is_ground,
    list_parts,
)

_LIST = functor("list", 1)
_WORDS_OF_FLOATS = frozenset(("nan", "inf", "infinite"))


_EITHER_WAY = frozenset(("word",))
"""The form of ``nan`` and ``inf``, which are atoms in programs: nobody means a value to be that and nothing else."""


class ValueKind(NamedTuple):
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
    items: "Optional[ValueKind]" = None
    of_message: str = ""

    def excludes(self, other: "ValueKind") -> bool:
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


def _table(*rows: Tuple[str, str, str]) -> Dict[str, ValueKind]:
    return {name: ValueKind(atom(name), what, frozenset(forms.split())) for name, what, forms in rows}


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


def slot_kind(slot: Field) -> Optional[ValueKind]:
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


def read_kind(named: Term) -> ValueKind:
    """Return the kind that a term names.

    Raises:
        UsageError: where there is no such kind.
    """
    term, depth = deref(named), 0
    while isinstance(term, tuple) and term[0] is _LIST and depth < _DEEPEST:
        term, depth = deref(term[1]), depth + 1
    found = _plain_kind(term)
    for _ in range(depth):
        found = ValueKind((_LIST, found.term), "a list", KINDS["list"].forms, found)
    return found


_DEEPEST = 10
"""How often lists may be in lists."""


def _plain_kind(term: Term) -> ValueKind:
    if not isinstance(term, Atom):
        raise UsageError(f"a kind is {_known()}")
    found = KINDS.get(term.name)
    if found is not None:
        return found
    if type_name(term.name) is not None:
        return ValueKind(term, f"a message {term.name}", frozenset(("compound", "atom")), None, term.name)
    near = get_close_matches(term.name, KINDS, 1)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise UsageError(f"there is no kind {term.name}{hint or f': a kind is {_known()}'}")


def _known() -> str:
    return f"{', '.join(KINDS)}, list(Kind) or the name of a message's term"


class ValuePart(NamedTuple):
    """A value of which the kind is known, and by what its place is found: an argument, or an item of a list."""

    value: Term
    kind: ValueKind
    parent: CompoundTerm
    number: int
    is_item: bool = False


def parts_of_value(parent: CompoundTerm, number: int, kind: ValueKind) -> Iterator[ValuePart]:
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
