"""Terms to text that reads back as the same term.

Works without recursion: a stack holds what is still to be written. Two tokens that would run together are
parted by a blank, and nothing else is, as SWI-Prolog 9 does it.

Messages shown with slots by name, where a program has written them like that.
"""

from typing import (
    Any,
    Callable,
    Collection,
    Dict,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

from ...foundation.cancellation import BULK, look
from ...foundation.errors import RetalisError, TermTooLarge
from ..terms.term_traversal import is_ground, resolve, term_key, variables
from ..terms.types import (
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
    serial,
)
from .literals import atom_text, float_text, integer_text, quote
from .message_fields import MessageSlot, NamedForm, as_integers, made_in, parts_in
from .operators import Operator, Operators

_CURLY = functor("{}", 1)
_NUMBERED = functor("$VAR", 1)
_LONG = 64 * len(BULK)
_MASK = len(BULK) - 1
_MAX_TEXT_CHARACTERS = 1 << 26
"""Characters of the longest text that is written."""
_BULKY = 1 << 18
"""Characters from which on there is a check for room before the text of a term is put together."""
_STACKED_ARGUMENTS = 64
"""Arguments or items of a list that lie on the stack together."""
_SYMBOLS = frozenset("-+*/\\^<>=~:.?@#&$")


class WriteOptions(NamedTuple):
    """How a term is written; the names are those of ``write_term/2``.

    Attributes:
        quoted: atoms and strings are quoted where they have to be.
        ignore_ops: operators are written as functor and arguments.
        brace_terms: ``{}(a)`` is written ``{a}``.
        numbervars: ``'$VAR'(1)`` is written ``B``.
        spacing: a blank after the commas of arguments and lists.
        wide: a blank on either side of the infix operators that bind least: of rules and conditions.
        variable_names: variable -> name; others are ``_G1`` and so on.
        priority: a term of a higher priority is put in brackets.
        portray: gives the text of a term that is written in a way of its own, and None for others.
        longest: characters after which the text ends with ``...``; None for the whole text.
    """

    quoted: bool = True
    ignore_ops: bool = False
    brace_terms: bool = True
    numbervars: bool = False
    spacing: bool = False
    wide: bool = False
    variable_names: Optional[Mapping[Var, str]] = None
    priority: int = 1200
    portray: Optional[Callable[[Term], Optional[str]]] = None
    longest: Optional[int] = None


Piece = Union[str, "_PrefixOperator", "_Arguments", "_Cells", Tuple[Term, int], Tuple[Term, int, bool]]
"""What is to be written, see `_TermWriter.write`."""


class _TermWriter:
    check_mask = _MASK

    def __init__(self, operators: Operators, options: WriteOptions):
        self.operators = operators
        self.options = options
        self.out: List[str] = []
        self.last = ""
        self.after: Optional[_PrefixOperator] = None
        self.names = options.variable_names or {}
        self.atom: Callable[[str], str] = atom_text if options.quoted else str
        self.comma = ", " if options.spacing else ","
        self.portray = options.portray
        self.stack: List[Piece] = []
        self.counted = 0
        self.size = 0

    def write(self, term: Term) -> str:
        """Return the text of ``term``.

        An entry of the stack is a token (a str), a prefix operator, the items that remain of a list or of many
        arguments, or a term and the priority that it may have, with a third item where it is the argument of an
        operator.
        """
        stack = self.stack
        stack.append((term, self.options.priority))
        steps = 0
        mask = self.check_mask
        while stack:
            steps += 1
            if not steps & mask and self._is_full(term, steps):
                break
            entry: Any = stack.pop()
            kind = entry.__class__
            if kind is str:
                self._put(entry)
            elif kind is _PrefixOperator:
                entry.parted = self._put(entry.text)
                self.after = entry
            elif kind is _Cells or kind is _Arguments:
                entry.put_next(stack)
            else:
                self._term(deref(entry[0]), entry[1], len(entry) == 3)
        return "".join(self.out)

    def _is_full(self, term: Term, steps: int) -> bool:
        """Look at the limits; tell whether no more is to be written."""
        look()
        if steps == _LONG:
            resolve(term)  # raises for a term that contains itself
        self._measure(0)
        return False

    def _measure(self, following: int) -> None:
        """Count the characters so far, and check that there is room for them and those that follow in one text."""
        self.size += sum(map(len, self.out[self.counted :]))
        self.counted = len(self.out)
        if self.size + following > _MAX_TEXT_CHARACTERS:
            raise TermTooLarge
        if self.size + following > _BULKY:
            look(size=self.size + following)

    def _put(self, token: str) -> bool:
        """Add a token, with a blank before it where it would run into the one before; tell whether so."""
        if not token:
            return False
        last, first = self.last, token[0]
        parted = bool(last) and (
            _run_together(last, first) or (self.after is not None and self.after.needs_blank(first))
        )
        if parted:
            self.out.append(" ")
        self.after = None
        self.out.append(token)
        self.last = token[-1]
        return parted

    def _term(self, term: Term, limit: int, is_operand: bool) -> None:
        if self.portray is not None and term.__class__ is not Var:
            text = self.portray(term)
            if text is not None:
                self._put(text)
                return
        if term.__class__ is tuple:
            self._compound(term, limit)
        elif term.__class__ is Atom:
            self._atom_term(term.name, is_operand)
        elif term.__class__ is int:
            self._put(integer_text(term))
        elif term.__class__ is float:
            self._put(float_text(term))
        elif term.__class__ is String:
            if len(term.text) > _BULKY:
                self._measure(len(term.text))
            self._put(quote(term.text, '"') if self.options.quoted else term.text)
        elif term.__class__ is Var:
            self._put(self.names.get(term) or f"_G{serial(term)}")

    def _atom_term(self, name: str, is_operand: bool) -> None:
        if len(name) > _BULKY:
            self._measure(len(name))
        if is_operand and (name in self.operators or name == "."):
            self._put("(")
            self._put(self.atom(name))
            self._put(")")
        else:
            self._put(self.atom(name))

    def _compound(self, term: CompoundTerm, limit: int) -> None:
        found: Functor = term[0]
        if found is CONS:
            self._list(term)
            return
        options = self.options
        if found is _NUMBERED and options.numbervars and self._numbered(deref(term[1])):
            return
        if found is _CURLY and options.brace_terms:
            self.stack += ("}", (term[1], 1200), "{")
            return
        if options.ignore_ops or found.arity > 2 or not self._operator(term, found, limit):
            self._canonical(term, found)

    def _numbered(self, number: Term) -> bool:
        if number.__class__ is not int or number < 0:
            return False
        letter = chr(ord("A") + number % 26)
        self._put(letter + (str(number // 26) if number >= 26 else ""))
        return True

    def _canonical(self, term: CompoundTerm, found: Functor) -> None:
        stack = self.stack
        stack.append(")")
        if len(term) > _STACKED_ARGUMENTS:
            stack.append(_Arguments(term, self.comma))
        else:
            for argument in term[:1:-1]:
                stack.append((argument, 999))
                stack.append(self.comma)
        if found.arity:
            stack.append((term[1], 999))
        self._put(self.atom(found.name))
        self._put("(")

    def _list(self, term: CompoundTerm) -> None:
        stack = self.stack
        stack.append(_Cells(term[2], self.comma))
        stack.append((term[1], 999))
        self._put("[")

    def _operator(self, term: CompoundTerm, found: Functor, limit: int) -> bool:
        """Write a term with its operator; False where its functor is none."""
        name = found.name
        if found.arity == 2:
            infix = self.operators.infix.get(name)
            if infix is None:
                return False
            entries = self._infix(term, infix, name)
            priority = infix.priority
        else:
            prefix = self.operators.prefix.get(name)
            postfix = self.operators.postfix.get(name)
            if prefix is not None:
                entries = [
                    _PrefixOperator(self.atom(name), True),
                    (term[1], self._right(prefix, term[1]), True),
                ]
                priority = prefix.priority
            elif postfix is not None:
                entries = [(term[1], postfix.left, True), self.atom(name)]
                priority = postfix.priority
            else:
                return False
        if priority > limit:
            entries = ["(", *entries, ")"]
        entries.reverse()
        self.stack += entries
        return True

    def _infix(self, term: CompoundTerm, infix: Operator, name: str) -> List[Piece]:
        text: Union[str, _PrefixOperator]
        if name == ",":
            text = self.comma
        elif name == "|":
            text = "|"
        elif self.options.wide and infix.priority >= _WIDE:
            text = f" {self.atom(name)} "
        else:
            text = _PrefixOperator(self.atom(name), False)
        left = 0 if name in _AFTER_A_LABEL and _is_labelled(term[1]) else infix.left
        return [(term[1], left, True), text, (term[2], self._right(infix, term[2]), True)]

    def _right(self, found: Operator, argument: Term) -> int:
        """Return the priority that the right argument may have.

        Where it is an operator of the same priority that would take the operator before it as its left
        argument, it needs brackets, as ``a xfy (b yfx c)``.
        """
        argument = deref(argument)
        if found.right != found.priority or argument.__class__ is not tuple:
            return found.right
        name, arity = argument[0].name, argument[0].arity
        if arity == 2:
            inner = self.operators.infix.get(name)
        elif arity == 1 and name not in self.operators.prefix:
            inner = self.operators.postfix.get(name)
        else:
            return found.right
        if inner is not None and inner.priority == inner.left == found.priority:
            return found.right - 1
        return found.right


class _Arguments:
    """The arguments of a compound term from the second one on; all of them on the stack would take much memory."""

    __slots__ = ("rest", "comma")

    def __init__(self, term: CompoundTerm, comma: str):
        self.rest = iter(term[2:])
        self.comma = comma

    def put_next(self, stack: List[Piece]) -> None:
        """Put the next argument on the stack."""
        for argument in self.rest:
            stack += (self, (argument, 999), self.comma)
            return


class _Cells:
    """The rest of a list."""

    __slots__ = ("rest", "comma")

    def __init__(self, rest: Term, comma: str):
        self.rest = rest
        self.comma = comma

    def put_next(self, stack: List[Piece]) -> None:
        """Put the next items on the stack, or the end of the list."""
        rest: Any = deref(self.rest)
        entries: List[Piece] = []
        while rest.__class__ is tuple and rest[0] is CONS and len(entries) < _STACKED_ARGUMENTS:
            entries += (self.comma, (rest[1], 999))
            rest = deref(rest[2])
        if rest.__class__ is tuple and rest[0] is CONS:
            self.rest = rest
            entries.append(self)
        elif rest is NIL:
            entries.append("]")
        else:
            entries += ("|", (rest, 999), "]")
        entries.reverse()
        stack += entries


class _BeginningWriter(_TermWriter):
    """Writes the beginning of a term; what is left out takes no time."""

    check_mask = 0

    def write(self, term: Term) -> str:
        text = super().write(term)
        longest = self.options.longest
        return text if longest is None or len(text) <= longest else f"{text[:longest]}..."

    def _is_full(self, term: Term, steps: int) -> bool:
        self._measure(0)
        return self.size > (self.options.longest or 0)

    def _term(self, term: Term, limit: int, is_operand: bool) -> None:
        longest = self.options.longest or 0
        if term.__class__ is Atom and len(term.name) > longest:
            term = atom(term.name[: longest + 1])
        elif term.__class__ is String and len(term.text) > longest:
            term = String(term.text[: longest + 1])
        elif term.__class__ is int and term.bit_length() > 4 * longest:
            self._put(f"an integer of {term.bit_length()} bits")
            return
        super()._term(term, limit, is_operand)


_WIDE = 700
_AFTER_A_LABEL = frozenset(("do", "<-"))


def _is_labelled(term: Term) -> bool:
    """Tell whether a term would read as the label of a rule where it stands before ``do`` or ``<-``."""
    term = deref(term)
    return term.__class__ is tuple and term[0].arity == 2 and term[0].name == ":"


class _PrefixOperator:
    """An operator before its argument, waiting on the writer's stack."""

    __slots__ = ("text", "is_prefix", "parted")

    def __init__(self, text: str, is_prefix: bool):
        self.text = text
        self.is_prefix = is_prefix
        self.parted = False

    def needs_blank(self, following: str) -> bool:
        """Tell whether a blank must part the operator from a token that begins with this character."""
        if not self.is_prefix:
            return self.parted
        if following == "(" or (self.text == "-" and following.isdigit()):
            return True
        return following in _SYMBOLS and _is_word(self.text[-1])


def _is_word(char: str) -> bool:
    return char.isalnum() or char == "_"


def _run_together(last: str, first: str) -> bool:
    """Tell whether two tokens would read as one, by the last character of one and the first of the other."""
    if first in _SYMBOLS:
        return last in _SYMBOLS
    if first == "'":
        return last == "'" or last.isdigit()
    if _is_word(first):
        return _is_word(last)
    return first == last and first in '"`'


def write_term(term: Term, operators: Optional[Operators] = None, **options: Any) -> str:
    """Return the text of a term.

    Args:
        term: any term; bound variables are followed, lazy terms are looked at.
        operators: the table to write with; Prolog's by default.
        **options: see `WriteOptions`.
    """
    found = WriteOptions(**options)
    writer = _TermWriter if found.longest is None else _BeginningWriter
    return writer(operators or _usual(), found).write(term)


def writeq(term: Term, operators: Optional[Operators] = None) -> str:
    """Return the text of a term as ``writeq/1`` writes it: quoted, with operators and ``'$VAR'``."""
    return _TermWriter(operators or _usual(), _QUOTED).write(term)


def canonical_text(term: Term) -> str:
    """Return the text of a term that reads back everywhere: quoted, without operators, variables as A, B, ..."""
    names = {
        var: f"{chr(65 + number % 26)}{number // 26 or ''}" for number, var in enumerate(variables(term))
    }
    return write_term(term, quoted=True, ignore_ops=True, variable_names=names)


def beginning_of(term: Term, longest: int) -> str:
    """Return what `writeq` returns, or its first characters and ``...``: an error may be about a term of any size."""
    return _BeginningWriter(_usual(), _QUOTED._replace(longest=longest)).write(term)


def add_full_stop(text: str) -> str:
    """Return the text of a term with the full stop that ends a clause.

    A blank parts it from a symbol character, which would make one token with it: ``:- @ .``
    """
    return f"{text} ." if text[-1:] in _SYMBOLS else f"{text}."


_QUOTED = WriteOptions(numbervars=True)
_tables: List[Operators] = []


def _usual() -> Operators:
    if not _tables:
        _tables.append(Operators.prolog())
    return _tables[0]


Portray = Callable[[Term], Optional[str]]


MAX_NAMED_DEPTH = 50
"""How deep messages that are shown by name may lie in each other: as deep as types."""


def by_name(
    term: Term, operators: Operators, named: Collection[Var] = (), made: bool = False, **options: Any
) -> Optional[Portray]:
    """Return what gives the text of messages in a term as they were written; None where none was by name.

    Args:
        term: what is shown.
        operators: by which it is shown.
        named: variables that have names of their own: what they stand for was named.
        made: whether all of it is made, as the head of a rule.
        **options: how values are shown; see `WriteOptions`.
    """
    if operators.slots is None or not operators.slots.forms:
        return None
    shower = _NamedShower(term, operators, named, made, options)
    return shower.text if shower.forms else None


class _NamedShower:
    def __init__(
        self, term: Term, operators: Operators, named: Collection[Var], made: bool, options: Dict[str, Any]
    ):
        self.depth = 0
        self.operators = operators
        self.options = options
        self.forms: Dict[Functor, List[NamedForm]] = {}
        assert operators.slots is not None
        self.find = operators.slots.find
        known: Dict[Functor, List[NamedForm]] = {}
        for form in list(operators.slots.forms):
            known.setdefault(form.functor, []).append(form)
        for part in parts_in(term):
            if part[0] in known:
                self.forms[part[0]] = known[part[0]]
        if self.forms:
            self.open = _alone(term, named)
            whole = [term] if made else made_in(term)
            self.made: Set[int] = {id(part) for one in whole for part in parts_in(one)}

    def text(self, term: Term) -> Optional[str]:
        """Return the text of a message that was written by name; None for anything else."""
        if term.__class__ is not tuple or term[0] not in self.forms or self.depth > MAX_NAMED_DEPTH:
            return None
        slots = self.slots(term[0])
        fitting = [one for one in self.forms[term[0]] if slots and self.fits(term, one, slots)]
        if slots is None or not fitting:
            return None
        form = min(fitting, key=lambda one: (self.in_vain(term, one), len(one.named), -len(one.whole)))
        self.depth += 1
        values = [self.slot(slots[at - 1], term[at], at in form.whole) for at in form.named]
        self.depth -= 1
        return f"{atom_text(term[0].name)}{{{', '.join(values)}}}"

    def slots(self, key: Functor) -> Optional[Sequence[MessageSlot]]:
        try:
            slots = self.find(key.name)
        except RetalisError:  # no longer known: it is shown with all slots
            return None
        return slots if slots is not None and len(slots) == key.arity else None

    def in_vain(self, term: CompoundTerm, form: NamedForm) -> int:
        """Return how many slots a form names without need."""
        return sum(deref(term[at]) in self.open for at in form.named)

    def fits(self, term: CompoundTerm, form: NamedForm, slots: Sequence[MessageSlot]) -> bool:
        """Tell whether a message reads back from a form."""
        if form.made is not (id(term) in self.made):
            return False
        others = [at for at in range(1, len(term)) if at not in form.named]
        if not form.made:
            return all(deref(term[at]) in self.open for at in others)
        return all(
            is_ground(term[at]) and term_key(term[at]) == term_key(slots[at - 1].zero) for at in others
        )

    def slot(self, slot: MessageSlot, value: Term, whole: bool) -> str:
        value = as_integers(deref(value), slot.array) if whole else deref(value)
        text = self.text(value) if slot.message and not slot.array else None
        if text is None:
            text = write_term(value, self.operators, portray=self.text, priority=999, **self.options)
        elif value[0].name == slot.message:  # type: ignore[index]
            text = text[text.index("{") :]
        return f"{slot.name}: {text}"


def _alone(term: Term, named: Collection[Var]) -> Set[Var]:
    """Return the variables that stand in a term once and have no name."""
    once: Set[Var] = set()
    again: Set[Var] = set(named)
    stack: List[Any] = [term]
    while stack:
        part = deref(stack.pop())
        if part.__class__ is tuple:
            stack += part[1:]
        elif part.__class__ is Var:
            (again if part in once else once).add(part)
    return once - again
