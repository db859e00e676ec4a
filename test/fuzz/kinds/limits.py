"""Single built-ins with adversarial arguments; exceeding the limits of time and memory is a finding.

The first inputs are systematic: each predicate with each kind of value at each argument, the others bound to
something small, and with the same value at all arguments. They are shuffled in a fixed order, so that the first ones
are a sample. Random inputs follow.
"""

import os
import random
import re
from typing import Any, Dict, List, Optional

from retalis import Engine, Limits, Settings, String, Var, atom, functor, make_list
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.terms.types import MINUS, NIL

from ..mutate import to_bytes, to_text
from .base import LOGGED, Kind, create_silent_engine
from .goals import PAGE

SETTINGS = Settings(limits=Limits(seconds=0.2, megabytes=50), limit_start=False, folders=())

SLACK = float(os.environ.get("FUZZ_SLACK", "1"))
"""Factor on the limits of an input, for machines that are busy with other work."""

PROGRAM = """
wide(0, T, T) :- !.
wide(N, A, T) :- M is N - 1, wide(M, f(A, A), T).
sum(0, T, T) :- !.
sum(N, A, T) :- M is N - 1, sum(M, A + A, T).
p(X) :- q(X). p(1). q(2). yes(_). yes(_, _). yes(_, _, _). loop :- loop. grow(X) :- grow(f(X)).
"""

ITEM_COUNT = 900_000
DEPTH = 1_000_000


def _nested(depth: Any, item: Any) -> Any:
    wrap = functor("f", 1)
    for _ in range(depth):
        item = (wrap, item)
    return item


def _assoc(low: int, high: int) -> Any:
    if low > high:
        return atom("t")
    middle = (low + high) // 2
    sides = (_assoc(low, middle - 1), _assoc(middle + 1, high))
    return (functor("t", 5), middle, middle, atom("<"), *sides)


def large_values() -> Dict[str, Any]:
    """Return the large terms by the names of their global variables; they are created once."""
    rng = random.Random(1)
    numbers = list(range(ITEM_COUNT))
    shuffled = rng.sample(numbers, ITEM_COUNT)
    sample = shuffled[: ITEM_COUNT // 3]
    names = [atom(f"item{number % 5000}") for number in shuffled]
    return {
        "long": make_list(numbers),
        "mixed": make_list([names[number] if number % 2 else number for number in sample]),
        "pairs": make_list([(MINUS, number, number) for number in sample]),
        "atoms": make_list(names),
        "open": make_list(names[: ITEM_COUNT // 3], Var()),
        "vars": make_list([Var() for _ in sample]),
        "codes": make_list([55] * ITEM_COUNT),
        "lists": make_list([(functor("[|]", 2), number, NIL) for number in sample]),
        "text": atom("ab c," * (1 << 20)),
        "string": String("7é" * (1 << 21)),
        "digits": atom("9" * 1_000_000),
        "deep": _nested(DEPTH, atom("x")),
        "deep_open": _nested(DEPTH, Var()),
        "flat": (functor("f", ITEM_COUNT), *numbers),
        "assoc": _assoc(1, 100_000),
        "huge": (1 << 1_040_000) // 7,
    }


# A value is a goal that binds V, so that a short text denotes a large term.
LISTS = (
    "nb_getval(long, V)",
    "nb_getval(mixed, V)",
    "nb_getval(pairs, V)",
    "nb_getval(atoms, V)",
    "nb_getval(open, V)",
    "nb_getval(vars, V)",
    "nb_getval(codes, V)",
    "nb_getval(lists, V)",
    "V = [a|V]",
    "(V = [X1, X2], wide(60, X1, X2))",
    "(length(V, 3), wide(60, a, X3), maplist(=(X3), V))",
)
NUMBERS = (
    "V = 1000000000",
    "V = 16777216",
    "nb_getval(huge, V)",
    "(sum(60, 1, X4), V = X4)",
    "V = 3 ** 2600000",
)
TEXTS = (
    "nb_getval(text, V)",
    "nb_getval(string, V)",
    "nb_getval(digits, V)",
    "V = '~q~w~p~a~s~e~t~16777216|~100000000c'",
)
TERMS = (
    "wide(60, _, V)",
    "wide(60, a, V)",
    "nb_getval(deep, V)",
    "nb_getval(deep_open, V)",
    "V = f(V)",
    "nb_getval(assoc, V)",
    "nb_getval(flat, V)",
)
GOALS = ("V = loop", "V = grow(a)", "V = between(1, 1000000000)")
SMALL = ("V = _", "V = [a, b|_]", "V = [1-a, 2-b]", "V = []", "V = ''", "V = 0", "V = 3", "V = a", "V = yes")
SORTS = {
    "List Set Pairs Rest Graph Keys Values Lists Items Sorted Arguments Options Numbers Vertices Codes": (
        *LISTS,
        "V = [a, b|_]",
        "V = []",
    ),
    "Number Count Length Low High Index Expression X Y Size Arity Code Priority Seconds": (*NUMBERS, "V = 3"),
    "Text Atom String Name Format Whole Part Separator Character": (*TEXTS, "nb_getval(codes, V)", "V = a"),
    "Goal Condition Predicate Head Closure": (*GOALS, "V = yes", "V = p(_)"),
    "Assoc Tree Heap": ("nb_getval(assoc, V)", "V = t", "V = t(V, V)", "V = heap(V, 3)"),
}
BY_NAME = {name: values for names, values in SORTS.items() for name in names.split()}
LARGE = LISTS + NUMBERS + TEXTS + TERMS + GOALS
ALL = LARGE + SMALL
USUAL = {
    "List": "V = [b, a]",
    "Pairs": "V = [2-b, 1-a]",
    "Number": "V = 3",
    "Text": "V = ab",
    "Goal": "V = yes",
    "Assoc": "V = t",
}
"""A small value for arguments whose names are in a line of `SORTS`, by the first of them."""

SMALL_BY_NAME = {name: USUAL.get(names.split()[0], "V = _") for names in SORTS for name in names.split()}
SIGNATURE = re.compile(r"([a-z]\w*)\(([^()]*)\)")
EXCLUDED = frozenset(("halt", "sleep", "nb_getval", "nb_setval"))


def signatures() -> Any:
    """Return the names of the arguments on the page of predicates, by name and arity."""
    signatures: Dict[Any, Any] = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("| ``"):
            for name, arguments in SIGNATURE.findall(line.split("|")[2]):
                names = [argument.strip(" +-?:@[]") for argument in arguments.split(",")]
                signatures[name, len(names)] = names
    return signatures


class Inputs(Kind):
    """An input is the name of a built-in and its arity, then a goal that calls it."""

    is_isolated = True
    may_warm_up = False
    seconds = 0.4 * SLACK
    max_growth = int(SLACK * (100 << 20))

    def setup(self) -> None:
        self.engine: Optional[Engine] = None
        keys = create_silent_engine().logic.names()
        self.keys = sorted((key.name, key.arity) for key in keys if key.arity and key.name not in EXCLUDED)
        self.quoted = {name: write_term(atom(name), None, quoted=True) for name, _ in self.keys}
        self.signatures = signatures()
        self.values = large_values()
        self.corpus += self.systematic()

    def reset(self) -> None:
        if self.engine is not None:  # an input changes only its own process
            return
        self.engine = create_silent_engine(SETTINGS)
        self.engine.load(PROGRAM)
        self.engine.logic.globals.update(self.values)

    def systematic(self) -> Any:
        """Return the inputs of all predicates with all kinds of values."""
        inputs: List[Any] = []
        for name, arity in self.keys:
            names = self.signatures.get((name, arity), [""] * arity)
            small = [SMALL_BY_NAME.get(kind, "V = _") for kind in names]
            for value in LARGE:
                for position in range(arity):
                    inputs.append(self.goal(name, [*small[:position], value, *small[position + 1 :]]))
                if arity > 1:
                    inputs.append(self.goal(name, [value], [0] * arity))
        random.Random(2).shuffle(inputs)
        return inputs

    def goal(self, name: Any, values: Any, places: Any = None, head: str = "") -> bytes:
        """Return the input that calls a predicate with some values, or with those at some places."""
        places = range(len(values)) if places is None else places
        parts = [
            re.sub(r"\b([VWX]\d?)\b", rf"\g<1>_{position}", value) for position, value in enumerate(values)
        ]
        goal = f"{self.quoted[name]}({', '.join(f'V_{place}' for place in places)})"
        text = ", ".join((*parts, goal))
        if head:
            return to_bytes(f"{head}{name}/{len(places)}\n{text}")
        # Without copying the values into the answer.
        return to_bytes(f"{name}/{len(places)}\n\\+ \\+ ({text})")

    def generate(self, rng: Any) -> Any:
        name, arity = rng.choice(self.keys)
        names = self.signatures.get((name, arity), [""] * arity)
        values: List[Any] = []
        places: List[Any] = []
        for kind in names:
            if places and rng.random() < 0.15:  # the same term twice
                places.append(rng.choice(places))
                continue
            choice = BY_NAME.get(kind, ALL) if rng.random() < 0.75 else ALL
            if kind and rng.random() < 0.15:
                choice = ("V = _",)
            places.append(len(values))
            values.append(rng.choice(choice))
        return self.goal(name, values, places, "answer of " if rng.random() < 0.05 else "")

    def subject(self, data: Any) -> str:
        return to_text(data).partition("\n")[0][:60]

    def run(self, data: Any) -> None:
        # One answer without its text: only the time of the built-in counts.
        assert self.engine is not None
        self.attempt(self.engine.query, to_text(data).partition("\n")[2], 1)
        LOGGED.check()
