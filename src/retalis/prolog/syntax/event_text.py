"""The pattern of all texts of a shape: one match takes the numbers and quoted atoms out of a text.

A text that it matches has the skeleton of the shape, with the same parts in its places as `EventReader` splits out;
what may be otherwise (a number that only JSON takes for one) is left to the reader. A match takes time in proportion
to the text: between two runs of numbers there is a character that stands in none.

Compiles the functions that build all terms of one shape.

Event text to terms, fast for texts of a shape that was seen before.

The texts on a topic differ in their numbers and quoted atoms and in little else. These are split out; what
is left, the skeleton, is the key of a cache of functions that build the term from them. Such a function is
made by reading the skeleton once with the full reader, with a marker in the place of each part, and finding
the markers in the term: where one is not found exactly once as an argument or list item, the shape is not
cached. So a text is read either as the full reader would, or by it.

What makes that safe:

* a number is split out only where it is a whole argument or item: between an opening bracket, comma or
  bar and the next comma, bar or closing bracket; its sign belongs to it there, and nothing else in the
  text can depend on which number it is;
* a quoted atom likewise (`_ALONE`): as an operand of an operator its name could matter;
* a number, a quoted atom and a double-quoted one leave different skeletons, and a function takes exactly
  as many of each as its skeleton has places.

Where events of one name come in the same shape one after the other, a text is not even split: it is matched as a
whole with the pattern of that shape (``wholetexts.py``), which takes the same parts out of it.

Terms to event text, as the String topics carry it.
"""

import re
from functools import lru_cache
from json import JSONDecoder
from typing import Any, Callable, Dict, List, Match, NamedTuple, Optional, Pattern, Tuple, Union

from ...foundation import codegen
from ...foundation.bounded_caches import Cache
from ...foundation.errors import SyntaxFault
from ...foundation.python_interpreter import text_size
from ..terms.list_terms import make_list
from ..terms.timestamps import SECOND, datime
from ..terms.types import CONS, NIL, Atom, CompoundTerm, Functor, String, Term, Var, atom, deref, serial
from .literals import atom_text, integer_text, quote
from .operators import Operators
from .quoted_text import closing, unquote
from .term_reader import read_term
from .tokenizer import ReadFlags

MAX_SKELETON_CHARACTERS = 4000
"""Characters of a skeleton from which on the pattern is not worth its memory."""

_PLACES = re.compile(r"(\0(?:,\0)*|'(?:[^\0'\"]*')*)")
"""Numbers with nothing but commas between them, and quoted atoms with no numbers between them."""

_IN_NUMBERS = "-+.,e0123456789"
_RUN = "([-+.,e0-9]{1,%d})"
_SPAN = "'[^'\\\\\n]*'"
_WIDTH = 32
"""Characters of a number, on average: as many numbers as `_SHORT` are too short then to be infinite."""

_SHORT = 9

_EXPONENTS = re.compile(r"(?:[^e]*\.[0-9]+e(?:-[0-9]{1,3}|\+?[0-9]{1,2})(?![0-9]))*[^e]*")
exponents_fit = _EXPONENTS.fullmatch
"""Whether all that stands before an exponent has a point, and no exponent is out of range, as the reader wants it."""


class TextTemplate(NamedTuple):
    """How the texts of a shape are matched.

    Attributes:
        pattern: has a group for each run of numbers and each span of quoted atoms.
        groups: for each group how many numbers there are in it, 0 for a span.
        atoms: for each group how many quoted atoms there are in it.
        infinite: whether a number may be so long that it is infinite as a float.
    """

    pattern: Pattern[str]
    groups: List[int]
    atoms: List[int]
    infinite: bool


def whole_text(skeleton: str) -> Optional[TextTemplate]:
    """Return how texts of a skeleton are matched; None where that is not possible or not worth while."""
    if len(skeleton) > MAX_SKELETON_CHARACTERS or "\\" in skeleton or "\n" in skeleton or '"' in skeleton:
        return None
    parts = _PLACES.split(skeleton)
    groups: List[int] = []
    atoms: List[int] = []
    source = [re.escape(parts[0])]
    for place, literal in zip(parts[1::2], parts[2::2]):
        number = place.count("\0")
        if number and not literal.strip(_IN_NUMBERS):
            return None
        groups.append(number)
        atoms.append(place.count("'"))
        source.append(_RUN % (_WIDTH * number) if number else _span(place))
        source.append(re.escape(literal))
    return TextTemplate(re.compile("".join(source)), groups, atoms, max(groups, default=0) > _SHORT)


def _span(place: str) -> str:
    """Return the pattern of quoted atoms and what stands between them; in a skeleton, a quote is an atom."""
    return f"({_SPAN.join(re.escape(literal) for literal in place.split(chr(39)))})"


def span_texts(span: str) -> Tuple[str, ...]:
    """Return the texts of the quoted atoms of a span."""
    return tuple(span.split("'")[1::2])


scan = JSONDecoder().scan_once  # type: ignore[attr-defined]
"""Reads numbers in brackets at a place of a text."""

Spans = Cache[str, Tuple[Atom, ...]]
"""The atoms of spans of quoted atoms, which come again and again."""

_UNREAD = (ValueError, StopIteration, KeyError)
"""What it raises for others; the last one on Python 3.8, which imports its error where nothing may be imported."""

ReadWhole = Callable[[str], Optional[Term]]
"""Makes the term of a text of one shape; None for a text that has to be read otherwise."""

_SPAN_COPIES = 2
"""Texts of the length of a span that are held for it: the span, and the names of its atoms."""


class Builder(NamedTuple):
    """Builds the terms of a shape.

    Attributes:
        build: makes one from its numbers, its quoted and its double-quoted texts; raises ValueError where they are
            not as many.
        ground: whether there is no variable in them.
        whole: returns what makes one from a text of a skeleton, which is the shape's; None where that is not worth
            while.
    """

    build: Callable[[List[float], List[str], List[str]], Term]
    ground: bool
    whole: Callable[[str, Spans], Optional[ReadWhole]]


_LINES = 3000
"""A shape of more compound terms is not worth a function."""

_NESTED = 16
"""A list of more items is made by a loop."""

_LOCALS = 200
"""More numbers are taken by index from their list, not unpacked into variables."""


class TemplateCompiler:
    """Writes the Python function for a term with marks in it."""

    def __init__(self, marks: Dict[Term, str]):
        """Take the marks: a constant of the term -> its variable: ``n0``, ... numbers; ``q0``, ``s0``, ... text."""
        self._marks = marks
        self._used: Dict[str, int] = dict.fromkeys(marks.values(), 0)
        self._given = codegen.BoundNames(
            {
                "atom": atom,
                "make_list": make_list,
                "Var": Var,
                "C": CONS,
                "N": NIL,
            }
        )
        self._variables: Dict[Var, str] = {}
        self._lines: List[str] = []

    def compile(self, term: Term) -> Optional[Builder]:
        """Return what builds it; None where a mark is missing, stands twice, or the term is too large."""
        result = self._expression(term)
        if result is None or any(count != 1 for count in self._used.values()):
            return None
        self._lines[:0] = [f"{name} = Var()" for name in self._variables.values()]
        self._lines.append(f"return {result}")
        lines = ["def build(n, q, s):", *(" " + line for line in (*self._unpacking(), *self._lines))]
        function = codegen.function(lines, self._given.values, "event text", "build")
        return Builder(function, not self._variables, self._whole)

    def _whole(self, skeleton: str, spans: Spans) -> Optional[ReadWhole]:
        """Return what reads whole texts; see `Builder`."""
        whole = whole_text(skeleton) if len(self._marks) <= _LOCALS else None
        if whole is None:
            return None

        def learn(span: str) -> Tuple[Atom, ...]:
            return spans.keep(span, tuple(map(atom, span_texts(span))), _SPAN_COPIES * text_size(span))

        given: Dict[str, Any] = {
            **self._given.values,
            "match": whole.pattern.fullmatch,
            "known": spans.get,
            "learn": learn,
            "scan": scan,
            "fits": exponents_fit,
            "most": float("inf"),
            "Unread": _UNREAD,
        }
        body = [*_taking_apart(whole), *self._lines]
        lines = ["def read(text):", *(" " + line for line in body)]
        found: ReadWhole = codegen.function(lines, given, "event text", "read")
        return found

    def _unpacking(self) -> List[str]:
        lines = []
        for kind in "nqs":
            names = [name for name in self._marks.values() if name[0] == kind]
            if names and not (kind == "n" and len(names) > _LOCALS):
                lines.append(f"{', '.join(names)}, = {kind}")
            else:
                lines.append(f"if len({kind}) != {len(names)}: raise ValueError")
            if kind == "q":
                lines += [f"{name} = atom({name})" for name in names]
            elif kind == "s":
                lines += [f"{name} = atom(f'\"{{{name}}}\"')" for name in names]
        return lines

    def _expression(self, term: Term) -> Optional[str]:
        """Write the lines that build the parts of a term; return the expression of the term."""
        # An entry is a term to do, or a compound term whose arguments are on top of the results.
        stack: List[Tuple[Term, int]] = [(term, -1)]
        results: List[str] = []
        while stack:
            part, count = stack.pop()
            if part.__class__ is not tuple:
                results.append(self._leaf(part))
            elif count < 0:
                items = _items(part)
                stack.append((part, len(items)))
                stack.extend((item, -1) for item in reversed(items))
            else:
                arguments = results[len(results) - count :]
                del results[len(results) - count :]
                results.append(self._compound(part, arguments))
                if len(self._lines) > _LINES:
                    return None
        return results[0]

    def _leaf(self, term: Term) -> str:
        if term.__class__ is Var:
            return self._variables.setdefault(term, f"v{len(self._variables)}")
        mark = self._marks.get(term) if term.__class__ is int or term.__class__ is Atom else None
        if mark is None:
            return self._constant(term)
        self._used[mark] += 1
        return f"n[{mark[1:]}]" if mark[0] == "n" and len(self._marks) > _LOCALS else mark

    def _constant(self, value: Union[Term, Functor]) -> str:
        key = (value.__class__, value.hex() if isinstance(value, float) else value)
        return self._given.constant(value, key)

    def _compound(self, term: CompoundTerm, arguments: List[str]) -> str:
        found: Functor = term[0]
        if found is not CONS:
            return self._temporary(f"({self._constant(found)}, {', '.join(arguments)})")
        *items, tail = arguments
        if len(items) > _NESTED:
            first = items[0]
            run = [f"n[{at}]" for at in range(_index(first), _index(first) + len(items))]
            several = (
                f"n[{run[0][2:-1]}:{int(run[-1][2:-1]) + 1}]" if run == items else f"({', '.join(items)})"
            )
            return self._temporary(f"make_list({several}, {tail})")
        for item in reversed(items):
            tail = f"(C, {item}, {tail})"
        return self._temporary(tail)

    def _temporary(self, expression: str) -> str:
        self._lines.append(f"t{len(self._lines)} = {expression}")
        return f"t{len(self._lines) - 1}"


def _taking_apart(whole: TextTemplate) -> List[str]:
    """Return the lines that take the numbers and atoms out of a text, or return None for one that is otherwise."""
    groups = [f"g{at}" for at in range(len(whole.groups))]
    lines = ["found = match(text)", "if found is None: return None"]
    if groups:
        lines.append(f"{', '.join(groups)}, = found.groups()")
    runs: List[List[str]] = []
    numbers: List[str] = []
    atoms = 0
    for group, number, span in zip(groups, whole.groups, whole.atoms):
        if number:
            runs.append([f"n{len(numbers) + at}" for at in range(number)])
            numbers += runs[-1]
        else:
            names = [f"q{atoms + at}" for at in range(span)]
            atoms += span
            lines.append(f"{', '.join(names)}, = known({group}) or learn({group})")
    if numbers:
        texts = [f"[{{{group}}}]" for group, number in zip(groups, whole.groups) if number]
        places = "".join(f"({', '.join(run)},), " for run in runs)
        lines += [
            f'numbers = f"[{",".join(texts)}]"',
            'if "e" in numbers and not fits(numbers): return None',
            "try:",
            f" {places} = scan(numbers, 0)[0]",
            "except Unread: return None",
        ]
    if whole.infinite:
        values = ", ".join(numbers)
        lines.append(f"if most in ({values},) or -most in ({values},): return None")
    return lines


def _items(term: CompoundTerm) -> List[Term]:
    """Return the arguments of a compound term; of a list, its items and its tail."""
    if term[0] is not CONS:
        return list(term[1:])
    items = []
    rest: Term = term
    while rest.__class__ is tuple and rest[0] is CONS:
        items.append(rest[1])
        rest = rest[2]
    items.append(rest)
    return items


def _index(name: str) -> int:
    return int(name[2:-1]) if name[:2] == "n[" else -1


Parts = Tuple[str, List[str], List[str], List[str]]
"""Skeleton, numbers, quoted atoms, double-quoted atoms."""

EVENT_TEXT = ReadFlags(event_text=True)

_NUMBER = re.compile(
    r"([(,\[|] *)"
    r"(-?(?:[0-9]{1,200}(?:\.[0-9]{1,200}(?:[eE](?:-[0-9]{1,3}|\+?[0-9]{1,2}))?)?|inf|nan))"
    r"(?=[,)\]|])"
)
_QUOTE = re.compile("['\"]")
_ALONE = re.compile(r"(?:^|[(\[{,|])\s*(?:'|\"\")\s*(?=$|[)\]},|])")
_PLACE = re.compile('[\0\']|""')
_JOINTS = re.compile("\0([(,\\[|] *)\0")

_SHAPES = 512
_MAX_SHAPE_CHARACTERS = 50_000
_TEMPLATE_COST = 32
"""Bytes of a function for each character of its skeleton, as measured."""
_MARK = 10**40

_EVENT = "event("

_WHOLE, _WHOLE_COST = 4000, 32
"""Bytes of what reads whole texts: of each, and for each character of their skeleton, as measured."""

_HEADS = 256
"""Names of events whose texts are read as a whole, at most."""


class EventReader:
    """Reads event text; keeps what it learns of the shapes of texts, in bounded memory.

    Event text is Prolog text with `ReadFlags.event_text`: ``nan``, ``inf`` and ``-inf`` are floats, and
    ``"text"`` is the atom ``'"text"'``. Not for use by two threads at once.
    """

    def __init__(self, operators: Optional[Operators] = None):
        """Take the operators that hold in the texts; Prolog's by default. They must not change later."""
        self._operators = Operators.prolog() if operators is None else operators
        self._builders: Cache[str, Optional[Builder]] = Cache(
            _SHAPES, _TEMPLATE_COST * 256_000, _TEMPLATE_COST * 60_000
        )
        self._wholes: Cache[str, Optional[ReadWhole]] = Cache(_SHAPES, 8 << 20)
        """What reads whole texts, by their skeleton."""
        self._whole: Cache[str, Optional[ReadWhole]] = Cache(_HEADS, 1 << 18)
        """What reads the texts of an event's name that have the shape of the last ones; None where that failed."""
        self._last: Cache[str, str] = Cache(_HEADS, 1 << 20)
        """The skeleton of the last text of an event's name."""
        self._spans: Spans = Cache(2048, 1 << 20, 4096)
        self.ground: Optional[bool] = None
        """Whether the term that was read last has no variables; None where that is not known."""

    def read(self, text: str) -> Term:
        """Return the term of a text.

        Raises:
            SyntaxFault: where the text is not exactly one term.
        """
        self.ground = None
        head = text[: text.find("(", len(_EVENT))] if text.startswith(_EVENT) else ""
        whole = self._whole.get(head)
        if whole is not None:
            term = whole(text)
            if term is not None:
                self.ground = True
                return term
            self._whole[head] = None
        if "\\" in text or "''" in text or "\n" in text:
            parts = _split_escaped(text)
        else:
            parts = _split(text)
        if parts is None:
            return self._read_fully(text)
        skeleton, numbers, quoted, strings = parts
        try:
            builder = self._builders[skeleton]
        except KeyError:
            builder = self._learn(skeleton)
        if builder is None:
            return self._read_fully(text)
        try:
            values, _ = scan("[" + ",".join(numbers) + "]", 0)
        except (ValueError, StopIteration):  # nan, inf or leading zeros
            values = [_number(number) for number in numbers]
        try:
            term = builder.build(values, quoted, strings)
        except ValueError:  # the text has a character that marks places in skeletons
            return self._read_fully(text)
        self.ground = builder.ground
        if head and builder.ground:
            self._note(head, skeleton, builder)
        return term

    def _note(self, head: str, skeleton: str, builder: Builder) -> None:
        """Note the shape of a text; where the last one had it too, have the next ones read as a whole."""
        if self._last.get(head) != skeleton:
            self._last.keep(head, skeleton, len(head) + len(skeleton))
            return
        try:
            whole = self._wholes[skeleton]
        except KeyError:
            made = builder.whole(_plain(skeleton), self._spans)
            whole = self._wholes.keep(skeleton, made, _WHOLE + _WHOLE_COST * len(skeleton))
        if self._whole.get(head) is not whole:
            self._whole.keep(head, whole, len(head))

    def _read_fully(self, text: str) -> Term:
        return read_term(text, self._operators, "event text", EVENT_TEXT, positions=False).term

    def _learn(self, skeleton: str) -> Optional[Builder]:
        """Return the function that builds the terms of a skeleton, or None where there can be none."""
        if len(skeleton) > _MAX_SHAPE_CHARACTERS:
            return None
        return self._builders.keep(
            skeleton, _builder(skeleton, self._operators), _TEMPLATE_COST * len(skeleton)
        )


def _split(text: str) -> Optional[Parts]:
    """Split a text in which every quote opens or closes a quoted atom, so that they can be counted off."""
    pieces = text.split("'")
    quoted = pieces[1::2]
    rest = "'".join(pieces[::2])
    strings: List[str] = []
    if '"' in rest:
        pieces = rest.split('"')
        strings = pieces[1::2]
        rest = '""'.join(pieces[::2])
        if len(pieces) % 2 == 0 or "'" in "".join(strings):
            return None
    pieces = _NUMBER.split(rest)
    numbers = pieces[2::3]
    del pieces[2::3]
    return "\0".join(pieces), numbers, quoted, strings


def _split_escaped(text: str) -> Optional[Parts]:
    """Split a text that has escapes, doubled quotes or several lines."""
    quoted: List[str] = []
    strings: List[str] = []
    rest: List[str] = []
    end = 0
    found = _QUOTE.search(text)
    while found is not None:
        start = found.start()
        rest.append(text[end:start])
        closed = closing(text, start)
        if closed is None:
            return None
        end = closed
        quote = text[start]
        try:
            body = unquote(text[start + 1 : end - 1], quote)
        except ValueError:
            return None
        if quote == "'":
            rest.append("'")
            quoted.append(body)
        else:
            rest.append('""')
            strings.append(body)
        found = _QUOTE.search(text, end)
    rest.append(text[end:])
    pieces = _NUMBER.split("".join(rest))
    numbers = pieces[2::3]
    del pieces[2::3]
    return "\0".join(pieces), numbers, quoted, strings


def _number(text: str) -> float:
    return int(text) if text.lstrip("-").isdigit() else float(text)


def _plain(skeleton: str) -> str:
    """Return a skeleton with one mark for each number."""
    return _JOINTS.sub(r"\1\0", skeleton)


def _builder(skeleton: str, operators: Operators) -> Optional[Builder]:
    """Compile the function that builds the terms of a skeleton; None where a part is not a plain argument."""
    skeleton = _plain(skeleton)
    if len(_ALONE.findall(skeleton)) != skeleton.count("'") + skeleton.count('""'):
        return None
    text, marks = _marked(skeleton)
    try:
        term = read_term(text, operators, "event text", EVENT_TEXT, positions=False).term
    except SyntaxFault:
        return None
    return TemplateCompiler(marks).compile(term)


def _marked(skeleton: str) -> Tuple[str, Dict[Term, str]]:
    """Return the skeleton with a mark in each place, and the variable that stands for each mark."""
    marks: Dict[Term, str] = {}
    counts = {"\0": 0, "'": 0, '""': 0}

    def mark(found: "Match[str]") -> str:
        place = found.group()
        number = counts[place]
        counts[place] = number + 1
        if place == "\0":
            marks[_MARK + number] = f"n{number}"
            return str(_MARK + number)
        variable = f"q{number}" if place == "'" else f"s{number}"
        name = f"\1{variable}"
        marks[atom(name if place == "'" else f'"{name}"')] = variable
        return f"'{name}'" if place == "'" else f'"{name}"'

    return _PLACE.sub(mark, skeleton), marks


def to_text(  # noqa: C901 -- the loop of all events that go out: a call for each part would cost as much
    term: Term,
) -> str:
    """Return a term as event text: quoted, without operators and blanks.

    Floats are written as Python's shortest text that reads back; ``nan``, ``inf`` and ``-inf`` bare (the
    atoms of these names are quoted).
    """
    out: List[str] = []
    put = out.append
    stack: List[Union[Term, str]] = [term]
    pop = stack.pop
    while stack:
        item: Any = pop()
        kind = item.__class__
        if kind is str:
            put(item)
        elif kind is float:
            put(float_text(item))
        elif kind is int:
            put(integer_text(item))
        elif kind is tuple:
            if item[0] is CONS:
                _list(item, stack)
            else:
                put(atom_text(item[0].name) + "(")
                stack.append(")")
                for argument in item[:1:-1]:
                    stack += (argument, ",")
                stack.append(item[1])
        elif kind is Atom:
            put(_name(item.name))
        elif kind is String:
            put(quote(item.text, '"'))
        elif kind is Var and item.ref is None:
            put(f"_G{serial(item)}")
        else:
            stack.append(deref(item))
    return "".join(out)


def event_text(event: str, instant: int) -> str:
    """Return the goal that makes an event, from the event's text and its instant.

    Raises:
        UsageError: where the instant lies outside the years 1 to 9999.
    """
    seconds, nanoseconds = divmod(instant, SECOND)
    stamp = f"{_second_text(seconds)}{nanoseconds})"
    return f"event({event},[{stamp},{stamp}])"


@lru_cache(maxsize=64)
def _second_text(seconds: int) -> str:
    """Return the text of a datime up to its nanoseconds; many events fall into one second."""
    return to_text(datime(seconds * SECOND))[:-2]


def _list(term: Term, stack: List[Union[Term, str]]) -> None:
    entries: List[Union[Term, str]] = ["["]
    while term.__class__ is tuple and term[0] is CONS:
        entries += (term[1], ",")
        term = deref(term[2])
    entries.pop()
    if term is not NIL:
        entries += ("|", term)
    entries.append("]")
    entries.reverse()
    stack += entries


def _name(name: str) -> str:
    return f"'{name}'" if name == "nan" or name == "inf" else atom_text(name)


def float_text(value: float) -> str:
    """Return a float as event text has it."""
    text = repr(value)
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return text
