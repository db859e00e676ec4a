"""Single built-ins with adversarial arguments: far beyond the limits of time and memory is a finding."""

import re

from retalis.engine import Settings, parts_of
from retalis.prolog.machine import Limits
from retalis.prolog.syntax import write_term
from retalis.prolog.terms import atom

from ..mutate import to_bytes, to_text
from .base import LOGGED, Kind, silent_engine
from .goals import PAGE

SETTINGS = Settings(limits=Limits(seconds=0.2, megabytes=50), limit_start=False, folders=())

VALUES = r"""
numlist(1, 100000, L), nb_setval(long, L).
numlist(1, 20000, L), pairs_keys_values(P, L, L), reverse(P, R), nb_setval(pairs, R).
numlist(1, 10000, L), atomic_list_concat(L, ' ', T), atomic_list_concat(A, ' ', T), nb_setval(atoms, A).
format(atom(T), "~*c", [100000, 0'7]), atom_codes(T, L), nb_setval(codes, L).
findall([I], between(1, 5000, I), L), nb_setval(lists, L).
format(atom(T), "~*c", [100000, 0'a]), nb_setval(text, T).
format(string(T), "~*c", [100000, 0'7]), nb_setval(string, T).
format(atom(T), "~*c", [1000000, 0'9]), nb_setval(digits, T).
deep(20000, x, T), nb_setval(deep, T).
numlist(1, 2000, L), pairs_keys_values(P, L, L), list_to_assoc(P, T), nb_setval(assoc, T).
"""

PROGRAM = """
deep(0, T, T) :- !.
deep(N, A, T) :- M is N - 1, deep(M, f(A), T).
wide(0, T, T) :- !.
wide(N, A, T) :- M is N - 1, wide(M, f(A, A), T).
sum(0, T, T) :- !.
sum(N, A, T) :- M is N - 1, sum(M, A + A, T).
p(X) :- q(X). p(1). q(2). yes(_). yes(_, _). yes(_, _, _). loop :- loop. grow(X) :- grow(f(X)).
"""

# A value is a goal that binds V, so that a text of few characters stands for a large term.
LISTS = (
    "nb_getval(long, V)",
    "nb_getval(pairs, V)",
    "nb_getval(atoms, V)",
    "nb_getval(codes, V)",
    "nb_getval(lists, V)",
    "V = [a|V]",
    "V = [a, b|_]",
    "(nb_getval(long, W), append(W, _, V))",
    "(V = [X1, X2], wide(40, X1, X2))",
    "(length(V, 3), wide(60, a, X3), maplist(=(X3), V))",
    "length(V, 30000)",
    "V = []",
)
NUMBERS = (
    "V = 1000000000",
    "V = -1",
    "V is 7 ** 5000",
    "V is 1 << 100000",
    "V = 16777216",
    "V = 1.0e308",
    "V = 0",
    "V = 100000",
    "(sum(60, 1, X4), V = X4)",
    "V = 10 ** 1000000",
    "V = 1 << (1 << 40)",
)
TEXTS = (
    "nb_getval(text, V)",
    "nb_getval(string, V)",
    "nb_getval(digits, V)",
    "nb_getval(codes, V)",
    "V = ''",
)
TEXTS += ("V = '~q~w~p'", "V = '~16777216|~t~w'", "V = '~100000000c'", "V = '%s'", "V = a")
TERMS = (
    "wide(60, _, V)",
    "wide(60, a, V)",
    "nb_getval(deep, V)",
    "V = f(V)",
    "nb_getval(assoc, V)",
    "V = f(_, g(_))",
    "(functor(V, f, 1000))",
    "V = _",
    "V = X0",
)
GOALS = (
    "V = loop",
    "V = grow(a)",
    "V = yes",
    "V = between(1, 1000000000)",
    "V = repeat",
    "V = p(_)",
    "V = succ_or",
)
SORTS = {
    "List Set Pairs Rest Graph Keys Values Lists Items Sorted Arguments Options Numbers Vertices Codes": LISTS,
    "Number Count Length Low High Index Expression X Y Size Arity Code Priority Seconds": NUMBERS,
    "Text Atom String Name Format Whole Part Separator Character": TEXTS,
    "Goal Condition Predicate Head Closure": GOALS,
    "Assoc Tree Heap": ("nb_getval(assoc, V)", "V = t", "V = t(V, V)", "V = heap(V, 3)"),
}
BY_NAME = {name: values for names, values in SORTS.items() for name in names.split()}
ALL = LISTS + NUMBERS + TEXTS + TERMS + GOALS
SIGNATURE = re.compile(r"([a-z]\w*)\(([^()]*)\)")
LEFT_OUT = frozenset(("halt", "sleep", "nb_getval", "nb_setval"))


def signatures():
    """Return the names of the arguments on the page of predicates, by name and arity."""
    found = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("| ``"):
            for name, arguments in SIGNATURE.findall(line.split("|")[2]):
                names = [argument.strip(" +-?:") for argument in arguments.split(",")]
                found[name, len(names)] = names
    return found


class Inputs(Kind):
    """An input is the name of a built-in and its arity, then a goal that calls it."""

    block = 50
    seconds = 2.0
    growth = 200 << 20

    def setup(self):
        keys = parts_of(silent_engine()).logic.names()
        self.keys = sorted((key.name, key.arity) for key in keys if key.arity and key.name not in LEFT_OUT)
        self.quoted = {name: write_term(atom(name), None, quoted=True) for name, _ in self.keys}
        self.signatures = signatures()

    def begin(self):
        self.engine = silent_engine(SETTINGS)
        self.engine.load(PROGRAM)
        self.engine.load(goals=VALUES.replace(").\n", ")\n"))

    def make(self, chance):
        name, arity = chance.choice(self.keys)
        names = self.signatures.get((name, arity), [""] * arity)
        parts, arguments = [], []
        for at, kind in enumerate(names):
            if arguments and chance.random() < 0.15:  # one term twice: the walk meets itself
                arguments.append(chance.choice(arguments))
                continue
            values = BY_NAME.get(kind, ALL) if chance.random() < 0.75 else ALL
            if kind and chance.random() < 0.15:
                values = ("V = _",)
            parts.append(re.sub(r"\b([VWX]\d?)\b", rf"\g<1>_{at}", chance.choice(values)))
            arguments.append(f"V_{at}")
        goal = f"{self.quoted[name]}({', '.join(arguments)})"
        text = ", ".join((*parts, goal))
        if chance.random() < 0.05:
            return to_bytes(f"answer of {name}/{arity}\n{text}")
        return to_bytes(f"{name}/{arity}\n\\+ \\+ ({text})")  # without copying the values into the answer

    def subject(self, data):
        return to_text(data).partition("\n")[0][:60]

    def run(self, data):
        # One answer, and no text of it: the time counts that the built-in takes.
        self.attempt(self.engine.query, to_text(data).partition("\n")[2], 1)
        LOGGED.check()
