"""Writing of terms: text that reads back as the same term.

The writer keeps a stack of pieces still to be written (tokens, terms with a priority limit, rests of lists) and does
not recurse, so terms of any depth can be written. Brackets follow from the priorities of operators (ISO 13211-1,
7.10.5): an operator term whose priority exceeds the limit of its position is put in brackets. A space separates two
tokens only if they would be read as one, as in SWI-Prolog 9.

`named_message_portray` returns a `Portray` that writes messages with named slots in the notation of the program.
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

from ...foundation.errors import RetalisError, TermTooLarge
from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits
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
from .named_slots import (
    MessageNotation,
    MessageSlot,
    compound_subterms,
    constructed_parts,
    floats_to_integers,
)
from .operators import Operator, Operators, standard_operators

_CURLY_TERM = functor("{}", 1)
_VAR_FUNCTOR = functor("$VAR", 1)
_CYCLE_CHECK_STEPS = 64 * len(STEPS_PER_ROUND)
"""Steps after which the writer checks whether the term is cyclic."""

_CHECK_MASK = len(STEPS_PER_ROUND) - 1
"""Bit mask of steps at which the goal's limits are checked."""

_MAX_TEXT_CHARACTERS = 1 << 26
"""Length of the longest text that is written."""

_LARGE_TEXT_CHARACTERS = 1 << 18
"""Length from which on the memory limit is checked before the text is assembled."""

_STACKED_ARGUMENTS = 64
"""Arguments or list items that are put on the stack at once."""
_SYMBOLS = frozenset("-+*/\\^<>=~:.?@#&$")


class WriteOptions(NamedTuple):
    """Options of `write_term`; the names are those of ``write_term/2``.

    Attributes:
        quoted: quote atoms and strings where reading them back requires it.
        ignore_ops: write operators in functional notation.
        brace_terms: write ``{}(a)`` as ``{a}``.
        numbervars: write ``'$VAR'(1)`` as ``B``.
        spacing: write a space after the commas of arguments and lists.
        wide: write spaces around the infix operators of rules and conditions.
        variable_names: names of variables; others are written as ``_G1`` and so on.
        priority: a term of a higher priority is put in brackets.
        portray: returns the text of terms with a notation of their own, and None for other terms.
        longest: number of characters after which the text ends with ``...``; None for the whole text.
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


Piece = Union[str, "_OperatorToken", "_Arguments", "_Cells", Tuple[Term, int], Tuple[Term, int, bool]]
"""An entry of the writer's stack; see `_TermWriter.write`."""


class _TermWriter:
    """Writer of one term, with an explicit stack instead of recursion.

    Attributes:
        check_mask: bit mask of the steps at which the limits and the length are checked.
        tokens: the written text.
        last_character: last character of the text, which decides whether the next token needs a space before it.
        pending_operator: the prefix or infix operator that was written last, if no token has followed yet.
        measured_count: number of tokens whose lengths are added up in ``size``.
        size: number of characters of these tokens.
    """

    check_mask = _CHECK_MASK

    def __init__(self, operators: Operators, options: WriteOptions):
        self.operators = operators
        self.options = options
        self.tokens: List[str] = []
        self.last_character = ""
        self.pending_operator: Optional[_OperatorToken] = None
        self.variable_names = options.variable_names or {}
        self.atom: Callable[[str], str] = atom_text if options.quoted else str
        self.comma = ", " if options.spacing else ","
        self.portray = options.portray
        self.stack: List[Piece] = []
        self.measured_count = 0
        self.size = 0

    def write(self, term: Term) -> str:
        """Return the text of ``term``.

        An entry of the stack is a token (``str``), an operator, the rest of a list or of many arguments, or a
        tuple of a term and its highest priority, with a third item if it is the argument of an operator.
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
            entry_class = entry.__class__
            if entry_class is str:
                self._append_token(entry)
            elif entry_class is _OperatorToken:
                entry.has_space_before = self._append_token(entry.text)
                self.pending_operator = entry
            elif entry_class is _Cells or entry_class is _Arguments:
                entry.push_next(stack)
            else:
                self._write_any(deref(entry[0]), entry[1], len(entry) == 3)
        return "".join(self.tokens)

    def _is_full(self, term: Term, steps: int) -> bool:
        """Check the limits; return whether no more needs to be written."""
        check_limits()
        # A cyclic term would be written until the text is too long; most terms are finished before this check.
        if steps == _CYCLE_CHECK_STEPS:
            resolve(term)  # raises for a cyclic term
        self._check_size(0)
        return False

    def _check_size(self, following: int) -> None:
        """Add up the characters so far; raise an error if ``following`` more characters would be too many."""
        self.size += sum(map(len, self.tokens[self.measured_count :]))
        self.measured_count = len(self.tokens)
        if self.size + following > _MAX_TEXT_CHARACTERS:
            raise TermTooLarge
        if self.size + following > _LARGE_TEXT_CHARACTERS:
            check_limits(size=self.size + following)

    def _append_token(self, token: str) -> bool:
        """Append a token, after a space if it would merge with the previous one; return whether there is a space."""
        if not token:
            return False
        last, first = self.last_character, token[0]
        is_separated = bool(last) and (
            _would_merge(last, first)
            or (self.pending_operator is not None and self.pending_operator.needs_space(first))
        )
        if is_separated:
            self.tokens.append(" ")
        self.pending_operator = None
        self.tokens.append(token)
        self.last_character = token[-1]
        return is_separated

    def _write_any(self, term: Term, limit: int, is_operand: bool) -> None:
        """Write a constant or variable, or push the pieces of a compound term.

        Args:
            term: the dereferenced term.
            limit: highest priority without brackets.
            is_operand: whether it is the argument of an operator.
        """
        if self.portray is not None and term.__class__ is not Var:
            text = self.portray(term)
            if text is not None:
                self._append_token(text)
                return
        if term.__class__ is tuple:
            self._write_compound(term, limit)
        elif term.__class__ is Atom:
            self._write_atom(term.name, is_operand)
        elif term.__class__ is int:
            self._append_token(integer_text(term))
        elif term.__class__ is float:
            self._append_token(float_text(term))
        elif term.__class__ is String:
            if len(term.text) > _LARGE_TEXT_CHARACTERS:
                self._check_size(len(term.text))
            self._append_token(quote(term.text, '"') if self.options.quoted else term.text)
        elif term.__class__ is Var:
            self._append_token(self.variable_names.get(term) or f"_G{serial(term)}")

    def _write_atom(self, name: str, is_operand: bool) -> None:
        if len(name) > _LARGE_TEXT_CHARACTERS:
            self._check_size(len(name))
        # An operator as an operand is put in brackets: `- = x` would be read differently with other operators.
        if is_operand and (name in self.operators or name == "."):
            self._append_token("(")
            self._append_token(self.atom(name))
            self._append_token(")")
        else:
            self._append_token(self.atom(name))

    def _write_compound(self, term: CompoundTerm, limit: int) -> None:
        key: Functor = term[0]
        if key is CONS:
            self._push_list(term)
            return
        options = self.options
        # ISO 13211-1, 7.10.5: '$VAR'(N), curly terms and operators have their own notation; all else is canonical.
        if key is _VAR_FUNCTOR and options.numbervars and self._write_numbered_variable(deref(term[1])):
            return
        if key is _CURLY_TERM and options.brace_terms:
            self.stack += ("}", (term[1], 1200), "{")
            return
        if options.ignore_ops or key.arity > 2 or not self._push_operator(term, key, limit):
            self._push_canonical(term, key)

    def _write_numbered_variable(self, number: Term) -> bool:
        """Write ``'$VAR'(number)`` as a letter with a number; return false if ``number`` is no natural number."""
        if number.__class__ is not int or number < 0:
            return False
        letter = chr(ord("A") + number % 26)
        self._append_token(letter + (str(number // 26) if number >= 26 else ""))
        return True

    def _push_canonical(self, term: CompoundTerm, key: Functor) -> None:
        """Write the functor of a term in functional notation, and push its arguments."""
        stack = self.stack
        stack.append(")")
        if len(term) > _STACKED_ARGUMENTS:
            stack.append(_Arguments(term, self.comma))
        else:
            for argument in term[:1:-1]:
                stack.append((argument, 999))
                stack.append(self.comma)
        if key.arity:
            stack.append((term[1], 999))
        self._append_token(self.atom(key.name))
        self._append_token("(")

    def _push_list(self, term: CompoundTerm) -> None:
        """Write the bracket of a list, and push its items."""
        stack = self.stack
        stack.append(_Cells(term[2], self.comma))
        stack.append((term[1], 999))
        self._append_token("[")

    def _push_operator(self, term: CompoundTerm, key: Functor, limit: int) -> bool:
        """Push the pieces of a term in operator notation; return false if its functor is no operator."""
        name = key.name
        if key.arity == 2:
            infix = self.operators.infix.get(name)
            if infix is None:
                return False
            entries = self._infix_pieces(term, infix, name)
            priority = infix.priority
        else:
            prefix = self.operators.prefix.get(name)
            postfix = self.operators.postfix.get(name)
            if prefix is not None:
                entries = [
                    _OperatorToken(self.atom(name), True),
                    (term[1], self._right_limit(prefix, term[1]), True),
                ]
                priority = prefix.priority
            elif postfix is not None:
                entries = [(term[1], postfix.left, True), self.atom(name)]
                priority = postfix.priority
            else:
                return False
        # The opening bracket is a token, so `- (1)` gets its space from `_OperatorToken.needs_space`.
        if priority > limit:
            entries = ["(", *entries, ")"]
        entries.reverse()  # the first piece must be on top of the stack
        self.stack += entries
        return True

    def _infix_pieces(self, term: CompoundTerm, infix: Operator, name: str) -> List[Piece]:
        """Return left argument, operator and right argument of a term with an infix operator."""
        text: Union[str, _OperatorToken]
        if name == ",":
            text = self.comma
        elif name == "|":
            text = "|"
        elif self.options.wide and infix.priority >= _MIN_WIDE_PRIORITY:
            text = f" {self.atom(name)} "
        else:
            text = _OperatorToken(self.atom(name), False)
        # `(a : b) <- c` without brackets would be read as a rule with the label `a`.
        left = 0 if name in _AFTER_A_LABEL and _is_labelled(term[1]) else infix.left
        return [(term[1], left, True), text, (term[2], self._right_limit(infix, term[2]), True)]

    def _right_limit(self, operator: Operator, argument: Term) -> int:
        """Return the highest priority that the right argument may have."""
        # `a xfy (b yfx c)`, both of the same priority: without brackets, the inner operator would take the outer
        # one as its left argument when the text is read.
        argument = deref(argument)
        if operator.right != operator.priority or argument.__class__ is not tuple:
            return operator.right
        name, arity = argument[0].name, argument[0].arity
        if arity == 2:
            inner = self.operators.infix.get(name)
        elif arity == 1 and name not in self.operators.prefix:
            inner = self.operators.postfix.get(name)
        else:
            return operator.right
        if inner is not None and inner.priority == inner.left == operator.priority:
            return operator.right - 1
        return operator.right


class _Arguments:
    """The arguments of a compound term from the second one on, which would take much memory on the stack."""

    __slots__ = ("rest", "comma")

    def __init__(self, term: CompoundTerm, comma: str):
        self.rest = iter(term[2:])
        self.comma = comma

    def push_next(self, stack: List[Piece]) -> None:
        """Push the next argument, with itself below it."""
        for argument in self.rest:
            stack += (self, (argument, 999), self.comma)
            return


class _Cells:
    """The rest of a list."""

    __slots__ = ("rest", "comma")

    def __init__(self, rest: Term, comma: str):
        self.rest = rest
        self.comma = comma

    def push_next(self, stack: List[Piece]) -> None:
        """Push the next items, or the end of the list."""
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
    """Writer of the beginning of a term, whose time does not depend on the omitted parts."""

    check_mask = 0  # the length is checked at each step

    def write(self, term: Term) -> str:
        text = super().write(term)
        longest = self.options.longest
        return text if longest is None or len(text) <= longest else f"{text[:longest]}..."

    def _is_full(self, term: Term, steps: int) -> bool:
        self._check_size(0)
        return self.size > (self.options.longest or 0)

    def _write_any(self, term: Term, limit: int, is_operand: bool) -> None:
        # A single constant can be longer than the text. It is shortened first, as quoting or converting it takes
        # time.
        longest = self.options.longest or 0
        if term.__class__ is Atom and len(term.name) > longest:
            term = atom(term.name[: longest + 1])
        elif term.__class__ is String and len(term.text) > longest:
            term = String(term.text[: longest + 1])
        elif term.__class__ is int and term.bit_length() > 4 * longest:
            self._append_token(f"an integer of {term.bit_length()} bits")
            return
        super()._write_any(term, limit, is_operand)


_MIN_WIDE_PRIORITY = 700
"""Priority from which on option ``wide`` writes spaces around operators."""

_AFTER_A_LABEL = frozenset(("do", "<-"))
"""Operators whose left argument may be read as the label of a rule."""


def _is_labelled(term: Term) -> bool:
    """Return whether a term before ``do`` or ``<-`` would be read as the label of a rule."""
    term = deref(term)
    return term.__class__ is tuple and term[0].arity == 2 and term[0].name == ":"


class _OperatorToken:
    """An operator on the writer's stack; the text after it determines whether a space is needed."""

    __slots__ = ("text", "is_prefix", "has_space_before")

    def __init__(self, text: str, is_prefix: bool):
        self.text = text
        self.is_prefix = is_prefix
        self.has_space_before = False

    def needs_space(self, following: str) -> bool:
        """Return whether a space must separate the operator from a token that begins with ``following``."""
        # An infix operator has a space after it if there is one before it: `a- -1`, but `a rem b`.
        if not self.is_prefix:
            return self.has_space_before
        # `-(1)` would be a compound term in functional notation, and `-1` a number.
        if following == "(" or (self.text == "-" and following.isdigit()):
            return True
        return following in _SYMBOLS and _is_word(self.text[-1])


def _is_word(char: str) -> bool:
    return char.isalnum() or char == "_"


def _would_merge(last: str, first: str) -> bool:
    """Return whether two tokens would be read as one, from the last and first character."""
    if first in _SYMBOLS:
        return last in _SYMBOLS
    # A quote after a quote is a doubled quote, and one after a digit begins a number such as 0'c or 16'FF.
    if first == "'":
        return last == "'" or last.isdigit()
    if _is_word(first):
        return _is_word(last)
    return first == last and first in '"`'


def write_term(term: Term, operators: Optional[Operators] = None, **options: Any) -> str:
    """Return the text of a term.

    Args:
        term: any term; bound variables are followed, lazy terms are built.
        operators: the operator table; Prolog's by default.
        **options: see `WriteOptions`.
    """
    write_options = WriteOptions(**options)
    writer = _TermWriter if write_options.longest is None else _BeginningWriter
    return writer(operators or standard_operators(), write_options).write(term)


def writeq(term: Term, operators: Optional[Operators] = None) -> str:
    """Return the text of a term as ``writeq/1`` writes it: quoted, with operators and ``'$VAR'``."""
    return _TermWriter(operators or standard_operators(), _QUOTED).write(term)


def canonical_text(term: Term) -> str:
    """Return quoted text in functional notation, which reads back with any operators; variables are A, B, ..."""
    # Variable names of the program are ignored: the text must not depend on where the term was read.
    names = {
        var: f"{chr(65 + number % 26)}{number // 26 or ''}" for number, var in enumerate(variables(term))
    }
    # Most events have no variables.
    options = _CANONICAL._replace(variable_names=names) if names else _CANONICAL
    return _TermWriter(standard_operators(), options).write(term)


def truncated_text(term: Term, longest: int) -> str:
    """Return the result of `writeq`, or its first characters and ``...``, as errors can contain terms of any size."""
    return _BeginningWriter(standard_operators(), _QUOTED._replace(longest=longest)).write(term)


def add_full_stop(text: str) -> str:
    """Return the text of a term with a full stop, after a space if the text ends with a symbol character."""
    # In `:- @.` the full stop would be a part of the symbol atom.
    return f"{text} ." if text[-1:] in _SYMBOLS else f"{text}."


_QUOTED = WriteOptions(numbervars=True)
_CANONICAL = WriteOptions(ignore_ops=True)

Portray = Callable[[Term], Optional[str]]
"""Returns the text of a term with a notation of its own, and None for other terms."""


MAX_NAMED_DEPTH = 50
"""Largest nesting depth of messages that are shown with named slots; message types cannot be nested deeper."""


def named_message_portray(
    term: Term,
    operators: Operators,
    named_variables: Collection[Var] = (),
    is_constructed: bool = False,
    **options: Any,
) -> Optional[Portray]:
    """Return a `Portray` for the messages in a term that were written with named slots; None if there are none.

    Args:
        term: the term to show.
        operators: its operator table.
        named_variables: variables that have names; slots with these variables were named.
        is_constructed: whether the whole term is constructed, such as the head of a rule.
        **options: options for the values; see `WriteOptions`.
    """
    if operators.message_types is None or not operators.message_types.notations:
        return None
    writer = _NamedMessageWriter(term, operators, named_variables, is_constructed, options)
    return writer.write_message if writer.notations else None


class _NamedMessageWriter:
    """Writes messages with named slots, in the notations that the program has used for their types."""

    def __init__(
        self,
        term: Term,
        operators: Operators,
        named_variables: Collection[Var],
        is_constructed: bool,
        options: Dict[str, Any],
    ):
        self.depth = 0
        self.operators = operators
        self.options = options
        self.notations: Dict[Functor, List[MessageNotation]] = {}
        assert operators.message_types is not None
        self.find_message = operators.message_types.find
        notations_by_functor: Dict[Functor, List[MessageNotation]] = {}
        for notation in list(operators.message_types.notations):
            notations_by_functor.setdefault(notation.functor, []).append(notation)
        for part in compound_subterms(term):
            if part[0] in notations_by_functor:
                self.notations[part[0]] = notations_by_functor[part[0]]
        if self.notations:
            self.singleton_variables = _singleton_variables(term, named_variables)
            roots = [term] if is_constructed else constructed_parts(term)
            self.constructed_ids: Set[int] = {
                id(part) for constructed in roots for part in compound_subterms(constructed)
            }

    def write_message(self, term: Term) -> Optional[str]:
        """Return the text of a message that was written with named slots; None for any other term."""
        if term.__class__ is not tuple or term[0] not in self.notations or self.depth > MAX_NAMED_DEPTH:
            return None
        slots = self.find_slots(term[0])
        # If several notations fit this message, the one with the fewest needless slots is probably the original one.
        fitting = [
            notation
            for notation in self.notations[term[0]]
            if slots and self.reads_back(term, notation, slots)
        ]
        if slots is None or not fitting:
            return None
        notation = min(
            fitting,
            key=lambda notation: (
                self.count_needless_slots(term, notation),
                len(notation.named_slots),
                -len(notation.constants),
                -len(notation.integer_slots),
            ),
        )
        self.depth += 1
        constants = {number: text for number, text, _ in notation.constants}
        values = [
            f"{slots[number - 1].name}: {constants[number]}"
            if number in constants
            else self.write_slot(slots[number - 1], term[number], number in notation.integer_slots)
            for number in notation.named_slots
        ]
        self.depth -= 1
        return f"{atom_text(term[0].name)}{{{', '.join(values)}}}"

    def find_slots(self, key: Functor) -> Optional[Sequence[MessageSlot]]:
        """Return the slots of a message type; None if it is unknown or its number of slots has changed."""
        try:
            slots = self.find_message(key.name)
        except RetalisError:  # the definition cannot be read any more: the message is shown in full
            return None
        return slots if slots is not None and len(slots) == key.arity else None

    def count_needless_slots(self, term: CompoundTerm, notation: MessageNotation) -> int:
        """Return the number of slots that a notation names although their values are anonymous variables."""
        return sum(deref(term[number]) in self.singleton_variables for number in notation.named_slots)

    def reads_back(self, term: CompoundTerm, notation: MessageNotation, slots: Sequence[MessageSlot]) -> bool:
        """Return whether a message that is written in a notation is read back as the same message."""
        if notation.is_constructed is not (id(term) in self.constructed_ids):
            return False
        if any(not _is_same_constant(term[number], value) for number, _, value in notation.constants):
            return False
        unnamed_slots = [number for number in range(1, len(term)) if number not in notation.named_slots]
        if not notation.is_constructed:
            return all(deref(term[number]) in self.singleton_variables for number in unnamed_slots)
        return all(
            is_ground(term[number]) and term_key(term[number]) == term_key(slots[number - 1].default)
            for number in unnamed_slots
        )

    def write_slot(self, slot: MessageSlot, value: Term, is_integer: bool) -> str:
        """Return the text of a named slot; ``is_integer`` writes an integral float as an integer."""
        value = floats_to_integers(deref(value), slot.is_array) if is_integer else deref(value)
        text = self.write_message(value) if slot.message_functor and not slot.is_array else None
        if text is None:
            text = write_term(value, self.operators, portray=self.write_message, priority=999, **self.options)
        elif value[0].name == slot.message_functor:  # type: ignore[index]
            text = text[text.index("{") :]
        return f"{slot.name}: {text}"


def _is_same_constant(value: Term, constant: Term) -> bool:
    value = deref(value)
    return value.__class__ is constant.__class__ and bool(value == constant)


def _singleton_variables(term: Term, named_variables: Collection[Var]) -> Set[Var]:
    """Return the variables that occur once in a term and have no name."""
    occurring: Set[Var] = set()
    excluded: Set[Var] = set(named_variables)
    stack: List[Any] = [term]
    while stack:
        subterm = deref(stack.pop())
        if subterm.__class__ is tuple:
            stack += subterm[1:]
        elif subterm.__class__ is Var:
            (excluded if subterm in occurring else occurring).add(subterm)
    return occurring - excluded
