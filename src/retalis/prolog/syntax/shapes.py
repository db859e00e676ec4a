"""Compiles the functions that build all terms of one shape."""

from json import JSONDecoder
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Tuple, Union

from ...foundation import Cache, codegen, text_size
from ..terms import CONS, NIL, Atom, CompoundTerm, Functor, Term, Var, atom, make_list
from .wholetexts import WholeText, exponents_fit, span_texts, whole_text

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


class ShapeCompiler:
    """Writes the Python function for a term with marks in it."""

    def __init__(self, marks: Dict[Term, str]):
        """Take the marks: a constant of the term -> its variable: ``n0``, ... numbers; ``q0``, ``s0``, ... text."""
        self._marks = marks
        self._used: Dict[str, int] = dict.fromkeys(marks.values(), 0)
        self._given = codegen.Names(
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


def _taking_apart(whole: WholeText) -> List[str]:
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
