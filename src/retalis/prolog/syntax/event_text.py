"""Event text: conversion between the text of the String topics and terms, with a cache of compiled builders.

The texts on a topic differ in their numbers and quoted atoms and in little else. The reader splits these out; the
rest, the *skeleton*, is the key of a cache of compiled functions (`Builder`) that build the term from them. A builder
is compiled by parsing the skeleton once with a unique marker in the place of each part, and finding the markers in
the resulting term. If a marker does not occur exactly once, as an argument or list item, the skeleton is not cached,
and its texts are always parsed.

A builder must never give another term than the parser. This holds because

* a number is split out only if it is a whole argument or item: after an opening bracket, comma or bar, and before a
  comma, bar or closing bracket. Its sign belongs to it there, and no other part of the text depends on its value;
* a quoted atom is treated alike (`_WHOLE_QUOTED_ARGUMENT`): as an operand of an operator, its name could matter;
* numbers, quoted atoms and double-quoted atoms leave different skeletons, and a builder checks their counts.

If two successive texts that begin with the same event name have the same skeleton, the next ones are not split. They
are matched as a whole with a regular expression made from the skeleton (`SkeletonRegex`), which extracts the same
parts. A text that does not match, or that contains a number that only JSON accepts, goes through the steps above.
Matching takes time in proportion to the text: between two runs of numbers there is a character that occurs in none.

In the other direction, `to_text` and `event_text` write terms as event text.
"""

import re
from functools import lru_cache
from json import JSONDecoder
from sys import getsizeof
from typing import Any, Callable, Dict, List, Match, NamedTuple, Optional, Pattern, Tuple, Union

from ...foundation import codegen
from ...foundation.bounded_caches import Cache
from ...foundation.errors import SyntaxFault
from ..terms.list_terms import make_list
from ..terms.timestamps import SECOND, datime
from ..terms.types import CONS, NIL, Atom, CompoundTerm, Functor, String, Term, Var, atom, deref, serial
from .literals import atom_text, integer_text, quote, quote_end, unquote
from .operators import Operators
from .term_reader import read_term
from .tokenizer import ReadFlags

MAX_SKELETON_CHARACTERS = 4000
"""Length of the longest skeleton for which a regular expression is worth its memory."""

_RUN_OR_SPAN = re.compile(r"(\0(?:,\0)*|'(?:[^\0'\"]*')*)")
"""Numbers separated only by commas, or quoted atoms without numbers between them."""

_NUMBER_CHARACTERS = "-+.,e0123456789"
_RUN_PATTERN = "([-+.,e0-9]{1,%d})"
_ATOM_PATTERN = "'[^'\\\\\n]*'"

_MEAN_NUMBER_CHARACTERS = 32
"""Longest average length of the numbers in a run; longer runs do not match."""

_MAX_FINITE_NUMBERS = 9
"""Numbers in a run whose average length excludes an infinite value: a float needs 309 digits to be infinite."""

_EXPONENTS = re.compile(r"(?:[^e]*\.[0-9]+e(?:-[0-9]{1,3}|\+?[0-9]{1,2})(?![0-9]))*[^e]*")
exponents_fit = _EXPONENTS.fullmatch
"""Returns whether each exponent follows a decimal point and is in range, as the parser requires."""


class SkeletonRegex(NamedTuple):
    """A regular expression for the texts of a skeleton.

    Attributes:
        pattern: has a group for each run of numbers and each span of quoted atoms.
        number_counts: for each group, the count of numbers in it; 0 for a span.
        atom_counts: for each group, the count of quoted atoms in it.
        may_be_infinite: whether a number may be long enough to be infinite as a float.
    """

    pattern: Pattern[str]
    number_counts: List[int]
    atom_counts: List[int]
    may_be_infinite: bool


def compile_skeleton_regex(skeleton: str) -> Optional[SkeletonRegex]:
    """Return the regular expression of a skeleton; None if it is impossible or not worthwhile."""
    if len(skeleton) > MAX_SKELETON_CHARACTERS or "\\" in skeleton or "\n" in skeleton or '"' in skeleton:
        return None
    parts = _RUN_OR_SPAN.split(skeleton)
    number_counts: List[int] = []
    atom_counts: List[int] = []
    source = [re.escape(parts[0])]
    for place, literal in zip(parts[1::2], parts[2::2]):
        count = place.count("\0")
        # The literal after a run must contain a character that no number contains: otherwise the border between two
        # runs would be ambiguous, and matching could take quadratic time.
        if count and not literal.strip(_NUMBER_CHARACTERS):
            return None
        number_counts.append(count)
        atom_counts.append(place.count("'"))
        source.append(_RUN_PATTERN % (_MEAN_NUMBER_CHARACTERS * count) if count else _span(place))
        source.append(re.escape(literal))
    return SkeletonRegex(
        re.compile("".join(source)),
        number_counts,
        atom_counts,
        max(number_counts, default=0) > _MAX_FINITE_NUMBERS,
    )


def _span(place: str) -> str:
    """Return the pattern of a span of quoted atoms and the text between them; each quote denotes an atom."""
    return f"({_ATOM_PATTERN.join(re.escape(literal) for literal in place.split(chr(39)))})"


def split_span(span: str) -> Tuple[str, ...]:
    """Return the texts of the quoted atoms in a span."""
    return tuple(span.split("'")[1::2])


scan_json = JSONDecoder().scan_once  # type: ignore[attr-defined]
"""Parses a JSON value at an offset; used for lists of numbers."""

SpanCache = Cache[str, Tuple[Atom, ...]]
"""Atoms of spans of quoted atoms, which recur in many texts."""

_SCAN_ERRORS = (ValueError, StopIteration, KeyError)
"""Exceptions of `scan_json` for other text; KeyError on Python 3.8, whose decoder imports its error class at that
moment."""

TextReader = Callable[[str], Optional[Term]]
"""Function that builds the term of a text with a known skeleton; returns None for texts that must be split first."""

_SPAN_COPIES = 2
"""Size of a cached span in multiples of its text: the span itself, and the names of its atoms."""


class Builder(NamedTuple):
    """Builds the terms of a skeleton.

    Attributes:
        build: returns the term for lists of numbers, quoted texts and double-quoted texts; raises ValueError if their
            counts are wrong.
        is_ground: whether the terms contain no variables.
        make_text_reader: returns the function that reads whole texts of the skeleton; None if it is not worthwhile.
    """

    build: Callable[[List[float], List[str], List[str]], Term]
    is_ground: bool
    make_text_reader: Callable[[str, SpanCache], Optional[TextReader]]


_MAX_LINES = 3000
"""Lines, one for each compound term, of the longest function that is compiled."""

_MAX_UNROLLED_ITEMS = 16
"""Items of the longest list that is built by a nested expression; longer ones are built by a loop."""

_MAX_LOCALS = 200
"""Numbers that are unpacked into variables; if there are more, they are accessed by index."""


class BuilderCompiler:
    """Compiles a Python function that builds a term from its marked parts."""

    def __init__(self, marks: Dict[Term, str], has_plain_strings: bool):
        """Store the marks.

        Args:
            marks: a constant in the term -> the variable for it: ``n0``, ... for numbers; ``q0``, ``s0``, ... for
                text.
            has_plain_strings: whether double-quoted text is an atom without the quotes.
        """
        self._marks = marks
        self._has_plain_strings = has_plain_strings
        self._mark_counts: Dict[str, int] = dict.fromkeys(marks.values(), 0)
        self._bound_names = codegen.BoundNames(
            {
                "atom": atom,
                "make_list": make_list,
                "Var": Var,
                "CONS": CONS,
                "NIL": NIL,
            }
        )
        self._variables: Dict[Var, str] = {}
        self._lines: List[str] = []

    def compile(self, term: Term) -> Optional[Builder]:
        """Return the builder of a term; None if a mark does not occur exactly once, or if the term is too large."""
        result = self._build_expression(term)
        if result is None or any(count != 1 for count in self._mark_counts.values()):
            return None
        # Every call creates new variables, so they are the first lines of the function.
        self._lines[:0] = [f"{name} = Var()" for name in self._variables.values()]
        self._lines.append(f"return {result}")
        lines = ["def build(n, q, s):", *(" " + line for line in (*self._unpacking_lines(), *self._lines))]
        function = codegen.function(lines, self._bound_names.values, "event text", "build")
        return Builder(function, not self._variables, self._make_text_reader)

    def _make_text_reader(self, skeleton: str, spans: SpanCache) -> Optional[TextReader]:
        """Return the function that reads whole texts; see `Builder`."""
        regex = compile_skeleton_regex(skeleton) if len(self._marks) <= _MAX_LOCALS else None
        if regex is None:
            return None

        def store_span(span: str) -> Tuple[Atom, ...]:
            return spans.store(span, tuple(map(atom, split_span(span))), _SPAN_COPIES * getsizeof(span))

        names: Dict[str, Any] = {
            **self._bound_names.values,
            "match": regex.pattern.fullmatch,
            "find_span": spans.get,
            "store_span": store_span,
            "scan_json": scan_json,
            "exponents_fit": exponents_fit,
            "INFINITY": float("inf"),
            "SCAN_ERRORS": _SCAN_ERRORS,
        }
        body = [*_extraction_lines(regex), *self._lines]
        lines = ["def read(text):", *(" " + line for line in body)]
        read: TextReader = codegen.function(lines, names, "event text", "read")
        return read

    def _unpacking_lines(self) -> List[str]:
        """Return the lines that check the counts of numbers and texts, and assign them to variables."""
        lines = []
        for list_name in "nqs":
            names = [name for name in self._marks.values() if name[0] == list_name]
            if names and not (list_name == "n" and len(names) > _MAX_LOCALS):
                lines.append(f"{', '.join(names)}, = {list_name}")
            else:
                lines.append(f"if len({list_name}) != {len(names)}: raise ValueError")
            if list_name == "q" or self._has_plain_strings and list_name == "s":
                lines += [f"{name} = atom({name})" for name in names]
            elif list_name == "s":
                lines += [f"{name} = atom(f'\"{{{name}}}\"')" for name in names]
        return lines

    def _build_expression(self, term: Term) -> Optional[str]:
        """Generate the lines that build the subterms of a term; return the expression for the term itself."""
        # An entry is a term (count -1), or a compound term whose arguments are the last `count` results.
        stack: List[Tuple[Term, int]] = [(term, -1)]
        results: List[str] = []
        while stack:
            part, count = stack.pop()
            if part.__class__ is not tuple:
                results.append(self._leaf_expression(part))
            elif count < 0:
                items = _arguments_or_items(part)
                stack.append((part, len(items)))
                stack.extend((item, -1) for item in reversed(items))
            else:
                arguments = results[len(results) - count :]
                del results[len(results) - count :]
                results.append(self._compound_expression(part, arguments))
                if len(self._lines) > _MAX_LINES:
                    return None
        return results[0]

    def _leaf_expression(self, term: Term) -> str:
        """Return the expression for a variable, a mark or a constant."""
        if term.__class__ is Var:
            return self._variables.setdefault(term, f"v{len(self._variables)}")
        mark = self._marks.get(term) if term.__class__ is int or term.__class__ is Atom else None
        if mark is None:
            return self._constant(term)
        self._mark_counts[mark] += 1
        return f"n[{mark[1:]}]" if mark[0] == "n" and len(self._marks) > _MAX_LOCALS else mark

    def _constant(self, value: Union[Term, Functor]) -> str:
        # 1, 1.0 and True are one key of a dictionary, as are 0.0 and -0.0; as terms they differ.
        key = (value.__class__, value.hex() if isinstance(value, float) else value)
        return self._bound_names.constant(value, key)

    def _compound_expression(self, term: CompoundTerm, arguments: List[str]) -> str:
        """Return the local that holds a compound term, after writing its assignment."""
        key: Functor = term[0]
        if key is not CONS:
            return self._assign_temporary(f"({self._constant(key)}, {', '.join(arguments)})")
        *items, tail = arguments
        # The parser of Python limits the nesting of expressions. A long list of consecutive numbers is a slice of the
        # list of numbers, which needs no expression for each item.
        if len(items) > _MAX_UNROLLED_ITEMS:
            first = items[0]
            run = [f"n[{index}]" for index in range(_number_index(first), _number_index(first) + len(items))]
            values = (
                f"n[{run[0][2:-1]}:{int(run[-1][2:-1]) + 1}]" if run == items else f"({', '.join(items)})"
            )
            return self._assign_temporary(f"make_list({values}, {tail})")
        for item in reversed(items):
            tail = f"(CONS, {item}, {tail})"
        return self._assign_temporary(tail)

    def _assign_temporary(self, expression: str) -> str:
        """Write the assignment of an expression to a new local, and return the local."""
        self._lines.append(f"t{len(self._lines)} = {expression}")
        return f"t{len(self._lines) - 1}"


def _extraction_lines(regex: SkeletonRegex) -> List[str]:
    """Return the lines that extract numbers and atoms from a text, and return None if it does not match."""
    groups = [f"g{index}" for index in range(len(regex.number_counts))]
    lines = ["whole = match(text)", "if whole is None: return None"]
    if groups:
        lines.append(f"{', '.join(groups)}, = whole.groups()")
    runs: List[List[str]] = []
    numbers: List[str] = []
    atoms = 0
    for group, count, span in zip(groups, regex.number_counts, regex.atom_counts):
        if count:
            runs.append([f"n{len(numbers) + index}" for index in range(count)])
            numbers += runs[-1]
        else:
            names = [f"q{atoms + index}" for index in range(span)]
            atoms += span
            lines.append(f"{', '.join(names)}, = find_span({group}) or store_span({group})")
    if numbers:
        texts = [f"[{{{group}}}]" for group, count in zip(groups, regex.number_counts) if count]
        places = "".join(f"({', '.join(run)},), " for run in runs)
        lines += [
            f'numbers = f"[{",".join(texts)}]"',
            'if "e" in numbers and not exponents_fit(numbers): return None',
            "try:",
            f" {places} = scan_json(numbers, 0)[0]",
            "except SCAN_ERRORS: return None",
        ]
    # JSON reads 1e999 or a number of 400 digits as infinity, which event text writes as `inf`.
    if regex.may_be_infinite:
        values = ", ".join(numbers)
        lines.append(f"if INFINITY in ({values},) or -INFINITY in ({values},): return None")
    return lines


def _arguments_or_items(term: CompoundTerm) -> List[Term]:
    """Return the arguments of a compound term; for a list, its items and its tail."""
    if term[0] is not CONS:
        return list(term[1:])
    items = []
    rest: Term = term
    while rest.__class__ is tuple and rest[0] is CONS:
        items.append(rest[1])
        rest = rest[2]
    items.append(rest)
    return items


def _number_index(name: str) -> int:
    """Return the index in an expression such as ``n[3]``; -1 for other expressions."""
    return int(name[2:-1]) if name[:2] == "n[" else -1


SplitText = Tuple[str, List[str], List[str], List[str]]
"""Skeleton, numbers, quoted atoms, and double-quoted atoms of a text."""

EVENT_TEXT = ReadFlags(event_text=True)
_PLAIN_EVENT_TEXT = ReadFlags(event_text=True, double_quotes="atom")

_NUMBER = re.compile(
    r"([(,\[|] *)"
    r"(-?(?:[0-9]{1,200}(?:\.[0-9]{1,200}(?:[eE](?:-[0-9]{1,3}|\+?[0-9]{1,2}))?)?|inf|nan))"
    r"(?=[,)\]|])"
)
"""A number that is a whole argument or item."""
_QUOTE = re.compile("['\"]")
_WHOLE_QUOTED_ARGUMENT = re.compile(r"(?:^|[(\[{,|])\s*(?:'|\"\")\s*(?=$|[)\]},|])")
"""A quoted atom that is a whole argument, item or text."""
_PLACEHOLDER = re.compile('[\0\']|""')
"""Placeholder in a skeleton for a number, a quoted atom, or a double-quoted atom."""
_ADJACENT_NUMBERS = re.compile("\0([(,\\[|] *)\0")
"""Adjacent numbers in a skeleton, which `_NUMBER` has split one by one."""

_MAX_SKELETONS = 512
"""Skeletons with a cached builder."""

_MAX_BUILDER_CHARACTERS = 50_000
"""Length of the longest skeleton with a builder."""

_BUILDER_BYTES_PER_CHARACTER = 32
"""Memory of a builder in bytes for each character of its skeleton, as measured."""

_FIRST_NUMBER_MARK = 10**40
"""The first integer that marks the place of a number: too large to occur in a message."""

_EVENT_PREFIX = "event("

_READER_BYTES, _READER_BYTES_PER_CHARACTER = 4000, 32
"""Memory of a text reader in bytes, and in addition for each character of its skeleton, as measured."""

_MAX_EVENT_NAMES = 256
"""Event names whose texts are read as a whole."""


class EventReader:
    """Reads event text; caches builders in bounded memory.

    Event text is Prolog text with `ReadFlags.event_text`: ``nan``, ``inf`` and ``-inf`` are floats, and ``"text"`` is
    the atom ``'"text"'``, or the atom ``text`` in programs with plain strings. Not thread-safe.
    """

    def __init__(self, operators: Optional[Operators] = None, has_plain_strings: bool = False):
        """Create a reader.

        Args:
            operators: the operators in the texts, Prolog's by default. They must not change later.
            has_plain_strings: whether ``"text"`` is the atom without double quotes.
        """
        self._flags = _PLAIN_EVENT_TEXT if has_plain_strings else EVENT_TEXT
        self._operators = Operators.prolog() if operators is None else operators
        self._builders: Cache[str, Optional[Builder]] = Cache(
            _MAX_SKELETONS, _BUILDER_BYTES_PER_CHARACTER * 256_000, _BUILDER_BYTES_PER_CHARACTER * 60_000
        )
        self._readers_by_skeleton: Cache[str, Optional[TextReader]] = Cache(_MAX_SKELETONS, 8 << 20)
        self._reader_by_name: Cache[str, Optional[TextReader]] = Cache(_MAX_EVENT_NAMES, 1 << 18)
        """Text readers by event name; None if the last text did not match."""
        self._last_skeleton_by_name: Cache[str, str] = Cache(_MAX_EVENT_NAMES, 1 << 20)
        """Skeleton of the last text, by event name."""
        self._spans: SpanCache = Cache(2048, 1 << 20, 4096)
        self.ground: Optional[bool] = None
        """True if the term that was read last has no variables; None if unknown."""

    def read(self, text: str) -> Term:
        """Return the term of a text.

        Raises:
            SyntaxFault: if the text is not exactly one term.
        """
        self.ground = None
        # The text up to the event's bracket identifies the event name; other texts have no such prefix and are split.
        event_prefix = text[: text.find("(", len(_EVENT_PREFIX))] if text.startswith(_EVENT_PREFIX) else ""
        read_whole = self._reader_by_name.get(event_prefix)
        if read_whole is not None:
            term = read_whole(text)
            if term is not None:
                self.ground = True
                return term
            self._reader_by_name[event_prefix] = None
        # Without escapes and doubled quotes, every quote opens or closes an atom, and splitting at quotes is enough.
        if "\\" in text or "''" in text or "\n" in text:
            parts = _split_escaped(text)
        else:
            parts = _split_at_quotes(text)
        if parts is None:
            return self._read_fully(text)
        skeleton, numbers, quoted, strings = parts
        try:
            builder = self._builders[skeleton]
        except KeyError:
            builder = self._compile_builder(skeleton)
        if builder is None:
            return self._read_fully(text)
        # The JSON decoder converts all numbers in one call in C.
        try:
            values, _ = scan_json("[" + ",".join(numbers) + "]", 0)
        except (ValueError, StopIteration):  # nan, inf or leading zeros
            values = [_parse_number(number) for number in numbers]
        try:
            term = builder.build(values, quoted, strings)
        except ValueError:  # the text itself contains the character that marks numbers in skeletons
            return self._read_fully(text)
        self.ground = builder.is_ground
        if event_prefix and builder.is_ground:
            self._record_skeleton(event_prefix, skeleton, builder)
        return term

    def _record_skeleton(self, event_prefix: str, skeleton: str, builder: Builder) -> None:
        """Record the skeleton of a text; if the last text had the same one, read the next ones as a whole."""
        if self._last_skeleton_by_name.get(event_prefix) != skeleton:
            self._last_skeleton_by_name.store(event_prefix, skeleton, len(event_prefix) + len(skeleton))
            return
        try:
            read_whole = self._readers_by_skeleton[skeleton]
        except KeyError:
            function = builder.make_text_reader(_join_marks(skeleton), self._spans)
            read_whole = self._readers_by_skeleton.store(
                skeleton, function, _READER_BYTES + _READER_BYTES_PER_CHARACTER * len(skeleton)
            )
        if self._reader_by_name.get(event_prefix) is not read_whole:
            self._reader_by_name.store(event_prefix, read_whole, len(event_prefix))

    def _read_fully(self, text: str) -> Term:
        return read_term(text, self._operators, "event text", self._flags, positions=False).term

    def _compile_builder(self, skeleton: str) -> Optional[Builder]:
        """Return a new builder for a skeleton; None if there cannot be one."""
        if len(skeleton) > _MAX_BUILDER_CHARACTERS:
            return None
        return self._builders.store(
            skeleton,
            _new_builder(skeleton, self._operators, self._flags),
            _BUILDER_BYTES_PER_CHARACTER * len(skeleton),
        )


def _split_at_quotes(text: str) -> Optional[SplitText]:
    """Split a text in which every quote opens or closes a quoted atom."""
    # Odd pieces are inside of quotes. In an unbalanced text they are wrong, and the skeleton does not parse.
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


def _split_escaped(text: str) -> Optional[SplitText]:
    """Split a text with escapes, doubled quotes or several lines."""
    quoted: List[str] = []
    strings: List[str] = []
    rest: List[str] = []
    end = 0
    quote_match = _QUOTE.search(text)
    while quote_match is not None:
        start = quote_match.start()
        rest.append(text[end:start])
        end_of_quote = quote_end(text, start)
        if end_of_quote is None:
            return None
        end = end_of_quote
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
        quote_match = _QUOTE.search(text, end)
    rest.append(text[end:])
    pieces = _NUMBER.split("".join(rest))
    numbers = pieces[2::3]
    del pieces[2::3]
    return "\0".join(pieces), numbers, quoted, strings


def _parse_number(text: str) -> float:
    """Return a number that JSON does not accept: ``nan``, ``inf``, or one with leading zeros."""
    return int(text) if text.lstrip("-").isdigit() else float(text)


def _join_marks(skeleton: str) -> str:
    """Return a skeleton without the separate marks that adjacent numbers have."""
    return _ADJACENT_NUMBERS.sub(r"\1\0", skeleton)


def _new_builder(skeleton: str, operators: Operators, flags: ReadFlags) -> Optional[Builder]:
    """Compile the builder of a skeleton; None if a part is not a whole argument."""
    skeleton = _join_marks(skeleton)
    if len(_WHOLE_QUOTED_ARGUMENT.findall(skeleton)) != skeleton.count("'") + skeleton.count('""'):
        return None
    has_plain_strings = flags is _PLAIN_EVENT_TEXT
    text, marks = _insert_marks(skeleton, has_plain_strings)
    try:
        term = read_term(text, operators, "event text", flags, positions=False).term
    except SyntaxFault:
        return None
    return BuilderCompiler(marks, has_plain_strings).compile(term)


def _insert_marks(skeleton: str, has_plain_strings: bool) -> Tuple[str, Dict[Term, str]]:
    """Return the skeleton with a unique constant in each place, and the variable for each constant."""
    marks: Dict[Term, str] = {}
    counts = {"\0": 0, "'": 0, '""': 0}

    def mark(place_match: "Match[str]") -> str:
        place = place_match.group()
        number = counts[place]
        counts[place] = number + 1
        if place == "\0":
            marks[_FIRST_NUMBER_MARK + number] = f"n{number}"
            return str(_FIRST_NUMBER_MARK + number)
        variable = f"q{number}" if place == "'" else f"s{number}"
        name = f"\1{variable}"
        marks[atom(name if place == "'" or has_plain_strings else f'"{name}"')] = variable
        return f"'{name}'" if place == "'" else f'"{name}"'

    return _PLACEHOLDER.sub(mark, skeleton), marks


def to_text(  # noqa: C901 -- the loop of all events that go out: a call for each part would cost as much
    term: Term,
) -> str:
    """Return a term as event text: quoted, in functional notation, without spaces.

    Floats are written as the shortest text that reads back; ``nan``, ``inf`` and ``-inf`` are written bare, and the
    atoms of these names are quoted.
    """
    out: List[str] = []
    put = out.append
    stack: List[Union[Term, str]] = [term]
    pop = stack.pop
    while stack:
        item: Any = pop()
        item_class = item.__class__
        if item_class is str:
            put(item)
        elif item_class is float:
            put(float_text(item))
        elif item_class is int:
            put(integer_text(item))
        elif item_class is tuple:
            if item[0] is CONS:
                _push_list(item, stack)
            else:
                put(atom_text(item[0].name) + "(")
                stack.append(")")
                for argument in item[:1:-1]:
                    stack += (argument, ",")
                stack.append(item[1])
        elif item_class is Atom:
            put(_name_text(item.name))
        elif item_class is String:
            put(quote(item.text, '"'))
        elif item_class is Var and item.ref is None:
            put(f"_G{serial(item)}")
        else:
            stack.append(deref(item))
    return "".join(out)


def event_text(event: str, instant: int) -> str:
    """Return the goal that creates an event, from the event's text and its instant (ns).

    Raises:
        UsageError: if the instant is outside the years 1 to 9999.
    """
    seconds, nanoseconds = divmod(instant, SECOND)
    stamp = f"{_second_text(seconds)}{nanoseconds})"
    return f"event({event},[{stamp},{stamp}])"


@lru_cache(maxsize=64)
def _second_text(seconds: int) -> str:
    """Return the text of a datime up to its nanoseconds; cached, because many events occur in one second."""
    return to_text(datime(seconds * SECOND))[:-2]


def _push_list(term: Term, stack: List[Union[Term, str]]) -> None:
    """Push the items of a list and the texts between them onto the stack of `to_text`."""
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


def _name_text(name: str) -> str:
    """Return an atom as event text, in which ``nan`` and ``inf`` without quotes are floats."""
    return f"'{name}'" if name == "nan" or name == "inf" else atom_text(name)


def float_text(value: float) -> str:
    """Return a float as event text."""
    text = repr(value)
    # The parser requires a decimal point before an exponent, which `repr` omits for 1e+20.
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return text
