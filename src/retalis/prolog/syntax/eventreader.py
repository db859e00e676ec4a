"""Event text to terms, fast for texts of a shape that was seen before.

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
"""

import re
from typing import Dict, List, Match, Optional, Tuple

from ...foundation import Cache, SyntaxFault
from ..terms import Term, atom
from .operators import Operators
from .quoted import closing, unquote
from .reader import read_term
from .shapes import Builder, ReadWhole, ShapeCompiler, Spans, scan
from .tokens import ReadFlags

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
_LONGEST_SHAPE = 50_000
_COST = 32
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
        self._builders: Cache[str, Optional[Builder]] = Cache(_SHAPES, _COST * 256_000, _COST * 60_000)
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
        if len(skeleton) > _LONGEST_SHAPE:
            return None
        return self._builders.keep(skeleton, _builder(skeleton, self._operators), _COST * len(skeleton))


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
    return ShapeCompiler(marks).compile(term)


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
