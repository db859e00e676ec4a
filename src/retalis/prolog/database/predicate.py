"""Predicates and their clauses.

A predicate starts out interpreted: its clauses are found through indexes and unified by the general routine,
which costs nothing to set up and suits facts and predicates that change all the time. One that is called
again and again without changing is compiled.
"""

from typing import Any, Callable, Dict, Hashable, Iterator, List, Optional, Protocol, Tuple

from ...foundation.cancellation import look
from ..compiler.clause_nodes import KnownDatabase
from ..compiler.function_code import FunctionCode
from ..compiler.predicate_code import ClauseParts, PredicateGenerator, fact_search
from ..machine.errors import PrologError
from ..machine.machine import Code, Machine
from ..terms.term_traversal import copy
from ..terms.types import Frame, Functor, Step, Term, Trail, Values, Var
from ..terms.unification import undo, unify
from .clause_index import NEVER, Clause, FunctionalModes, Indexes, by_key, keys_of, match_head, may_match

COMPILE_AFTER = 12
"""Calls without a change after which a predicate is compiled."""

_MAX_COMPILED_CLAUSES = 24
"""Predicates with more clauses keep their indexes; their clauses are compiled one by one."""

_MAX_COMPILED_FACTS = 8
"""The same for predicates that are facts only."""

_SLOW_SEARCH_CLAUSES = 1000
"""Clauses from which on a search among them may take as long as many inferences."""


class OwnDatabase(KnownDatabase, Protocol):
    """The `Database` that predicates belong to, as they know it."""

    generation: int
    changes: int
    compile_after: int

    @property
    def library(self) -> KnownDatabase:
        """The predicates as the library sees them."""

    @property
    def solve(self) -> Callable[[Term, int, Frame], Optional[Frame]]:
        """Runs a goal from its term."""

    @property
    def undefined(self) -> "Callable[[Predicate, Frame], Optional[Frame]]":
        """Takes a call of a predicate that nobody has defined."""


class Predicate:
    """A predicate: code that is run by frames ``(predicate, argument..., next)``.

    Attributes:
        run: the function that does a call; exchanged as the predicate changes.
        steady: whether that leaves the stack of choice points alone, see `Code.steady`.
        kind: "user", "builtin" (deterministic Python), "control" (anything else in Python), or "undefined".
        function: the Python function of a built-in that compiled clauses call in line.
        direct: its functions, where something calls it as a function.
        gate: what tells calls apart that have nothing to do, see `Logic.define_control`.
        functional: what it computes, where it is a function of some of its arguments.
        known: the deterministic built-in that it is where its first argument is known, if there is one.
        dynamic: clauses may be asserted and retracted by the program.
        library: belongs to the system; programs may redefine it unless it is ``locked``.
        missed: whether it was warned of a call of it, where nobody has defined it.
        incremental: tables that depend on it are evaluated anew after it has changed: on its clauses, see `observe`;
            on its answers, where it is tabled itself.
        system: a program that looks its clauses up, or changes them one by one, gets an error.
    """

    def __init__(self, database: OwnDatabase, functor: Functor):
        self.database = database
        self.functor = functor
        self.kind = "undefined"
        self.function: Optional[Callable[..., Any]] = None
        self.gate: Optional[Callable[[Functor, Tuple[int, ...]], object]] = None
        self.functional: Optional[FunctionalModes] = None
        self.known: Optional[Functor] = None
        self.dynamic = False
        self.discontiguous = False
        self.multifile = False
        self.locked = False
        self.system = False
        self.library = False
        self.missed = False
        self.compiled = False
        self.tabled: Optional[Predicate] = None
        self.incremental = False
        self._on_read: Optional[Callable[[Predicate], None]] = None
        self._revision = 0
        self.direct: Optional[FunctionCode] = None
        self.ground = False
        self._searches: Dict[Optional[int], Callable[..., Optional[Frame]]] = {}
        self.clauses: List[Clause] = []
        self.dead = 0
        self.calls = 0
        self.compile_after = database.compile_after
        self.indexes = Indexes(functor.arity)
        self.run: Step = self._call
        self.steady = False
        self._retry = Code(str(functor), self._next)
        self._retry.functor = functor

    def __repr__(self) -> str:
        return f"<{self.functor}>"

    @property
    def defined(self) -> bool:
        """Tell whether calling it is not an existence error."""
        return self.kind != "undefined" or self.dynamic

    @property
    def is_blank(self) -> bool:
        """Tell whether nobody has said anything of it but its name."""
        return not (self.defined or self.clauses or self.discontiguous or self.multifile or self.library)

    @property
    def is_fixed(self) -> bool:
        """Tell whether it is the program's and made of clauses that no goal may change."""
        return self.kind == "user" and not self.dynamic and not self.library

    @property
    def with_clauses(self) -> "Predicate":
        """The predicate that has its clauses: for a tabled one the hidden one that its tables call."""
        return self if self.tabled is None else self.tabled

    def live(self) -> Iterator[Clause]:
        """Yield the clauses that are there, in order."""
        return (clause for clause in list(self.clauses) if clause.died == NEVER)

    def __len__(self) -> int:
        return len(self.clauses) - self.dead

    # Changes

    def add(self, clause: Clause, first: bool = False) -> None:
        """Add a clause as the last or the first one."""
        self.ground = clause.ground and self.functor.arity > 0 and (self.ground or not self.clauses)
        self.changed()
        if first:
            self.clauses = [clause, *[old for old in self.clauses if old.died == NEVER]]
            self.kind = "user"
            self.dead = 0
            self.indexes.clear()
            return
        self.clauses.append(clause)
        self.kind = "user"
        self.indexes.add(clause)

    def remove(self, clause: Clause) -> bool:
        """Remove a clause; calls that are under way still see it. Return whether it was there."""
        if clause.died != NEVER:
            return False
        self.changed()
        self.database.generation += 1
        clause.died = self.database.generation
        self.dead += 1
        if self.dead == len(self.clauses) or (self.dead > 16 and self.dead * 2 > len(self.clauses)):
            self._sweep()
            self.indexes.clear()
        return True

    def _sweep(self) -> None:
        """Drop the clauses that were removed; the indexes have them still."""
        self.clauses = list(self.live())
        self.dead = 0

    def clear(self) -> None:
        """Remove all clauses."""
        for clause in list(self.live()):
            self.remove(clause)

    def abolish(self) -> None:
        """Remove all clauses and what was declared: calling it is an error from now on."""
        self.clear()
        self.changed()  # also where it had no clauses: a call that failed is an error now
        self.dynamic = self.discontiguous = self.multifile = False
        if self.kind == "user":
            self.kind = "undefined"

    def changed(self) -> None:
        """Go back to interpretation: the clauses are not what was compiled."""
        self.database.changes += 1
        self._revision += 1
        if self.compiled:
            self.compiled = self.steady = False
            self._run_by(self._call)
            self.compile_after *= 2
        self.calls = 0
        if self.direct is not None:
            self.direct.reset(self)

    def mend(self) -> None:
        """Make all anew that follows from the clauses, which an interrupt may have left half made."""
        if self.library or not (self.kind == "user" or self.clauses):
            return
        self.kind = "user"
        self._sweep()
        self.ground = self.functor.arity > 0 and all(clause.ground for clause in self.clauses)
        self.indexes.clear()
        self.forget()

    def table(self, hidden: "Predicate", run: Step) -> None:
        """Let tables answer the calls; clauses belong to the ``hidden`` predicate from now on."""
        self.tabled = hidden
        self.kind = "control"
        self.clauses = []
        self.indexes.clear()
        self.run = run
        self.steady = False

    def forget(self) -> None:
        """Drop compiled code whose references to other predicates are out of date."""
        if self.direct is not None:
            self.direct.reset(None)
        if self.kind == "user":
            self.compiled = self.steady = False
            self._run_by(self._call)
            self.calls = 0
            for clause in self.clauses:
                clause.code = None

    # Reads by incremental tables

    def observe(self, on_read: "Callable[[Predicate], None]") -> None:
        """Call ``on_read`` from now on before each call of it and each access to its clauses.

        Not for functions of compiled goals (see `FunctionCode`): these evaluate no tables.
        """
        if self._on_read is not None:
            return
        self.incremental = True
        self._on_read = on_read
        self.database.changes += 1
        self._run_by(self.run)

    def note_read(self) -> None:
        """Report an access to its clauses."""
        if self._on_read is not None:
            self._on_read(self)

    def version(self, part: Hashable = None) -> int:
        """Return a number that is another one after each change of its clauses."""
        return self._revision

    def _run_by(self, step: Step) -> None:
        """Have calls done by a function, and reported first where it is observed."""
        on_read = self._on_read
        if on_read is None:
            self.run = step
            return

        def run(frame: Frame) -> Optional[Frame]:
            on_read(self)
            return step(frame)

        self.run = run

    # Calls of interpreted clauses

    def _call(self, frame: Frame) -> Optional[Frame]:
        if self.kind == "undefined":
            return self.database.undefined(self, frame)
        self.calls += 1
        if (self.calls > self.compile_after or self.library) and not self.compiled and self._compile():
            return self.run(frame)
        clauses, position = self.indexes.select(self.clauses, frame)
        if len(clauses) > _SLOW_SEARCH_CLAUSES:
            look(0)  # to find a clause among these may take long
        generation = self.database.generation
        if self.ground:
            # The keys tell whether another fact may match, which there is none of.
            keys = keys_of(frame, position) if len(clauses) > 1 else None
            search = self._searches.get(position) or self._search(position)
            return search(frame, clauses, 0, len(clauses), generation, keys)
        keys = keys_of(frame, position)
        return self._advance(frame, clauses, 0, len(clauses), generation, keys)

    def fact_finder(self, once: bool) -> Callable[..., Optional[bool]]:
        """Return a function of the arguments that looks a ground fact up; see `FunctionCode`."""
        choices = self.database.machine.choices

        def find(*args: Term) -> Optional[bool]:
            if not self.ground:
                return None
            frame = (self, *args, True)
            clauses, position = self.indexes.select(self.clauses, frame)
            search = self._searches.get(position) or self._search(position)
            height = len(choices)
            keys = keys_of(frame, position)
            if search(frame, clauses, 0, len(clauses), self.database.generation, keys) is None:
                return False
            if len(choices) > height:
                del choices[height:]
                return True if once else None
            return True

        return find

    def _search(self, position: Optional[int]) -> Callable[..., Optional[Frame]]:
        names = fact_names(self.database.machine)
        search = self._searches[position] = fact_search(self.functor.arity, position, names)
        return search

    def select(self, frame: Frame) -> Tuple[List[Clause], Optional[int]]:
        """Return a list that holds all clauses that a call may match, and the argument that it is indexed by."""
        return self.indexes.select(self.clauses, frame)

    def _next(self, entry: Frame) -> Optional[Frame]:
        return self._advance(*entry[1:7])

    def _advance(  # noqa: C901 -- the loop of all interpreted calls: another call for each clause would slow it
        self,
        frame: Frame,
        clauses: List[Clause],
        at: int,
        end: int,
        generation: int,
        keys: Optional[List[object]],
    ) -> Optional[Frame]:
        """Try the clauses from ``at`` on; push a choice point where another one may match."""
        machine = self.database.machine
        trail = machine.trail
        while at < end:
            clause = clauses[at]
            at += 1
            if clause.died <= generation or keys is not None and not may_match(keys, clause.keys):
                continue
            while at < end:  # look for the next clause that may match, to leave no choice point for nothing
                other = clauses[at]
                if other.died > generation and (keys is None or may_match(keys, other.keys)):
                    break
                at += 1
            height = len(machine.choices)
            mark = len(trail)
            # What is surely the last one to try goes the way of rules, which has it compiled.
            if clause.fact and (at < end or clause.ground or self.dynamic):
                if match_head(frame, clause, {}, trail):
                    if at < end:
                        machine.choices.append((self._retry, frame, clauses, at, end, generation, keys, mark))
                    return frame[-1]  # type: ignore[no-any-return]
                undo(trail, mark)
                continue
            if at < end:
                machine.choices.append((self._retry, frame, clauses, at, end, generation, keys, mark))
            code = clause.code
            if code is None:
                clause.uses += 1
                if clause.uses <= self.database.compile_after and not self.library:
                    return self._interpret(frame, clause, height, trail)
                code = self._compile_clause(clause)
                if code is None:
                    return self._interpret(frame, clause, height, trail)
            return code((*frame, height))
        return None

    def _interpret(self, frame: Frame, clause: Clause, height: int, trail: Trail) -> Optional[Frame]:
        fresh: Dict[Var, Term] = {}
        if not match_head(frame, clause, fresh, trail):
            return None
        return self.database.solve(copy(clause.body, fresh), height, frame[-1])

    # Compilation

    def prepare(self) -> None:
        """Compile it before it is called, unless it has been compiled and has changed since."""
        if self.compiled or self.compile_after != self.database.compile_after or self.database.interprets:
            return
        try:
            self._compile()
        except (PrologError, RecursionError):  # who calls it gets the error
            self.compiled = False

    def _compile(self) -> bool:
        """Compile all clauses as one function if that suits the predicate."""
        self.calls = 0
        clauses = list(self.live())
        size = len(clauses)
        facts = all(clause.fact for clause in clauses)
        too_many = size > (_MAX_COMPILED_FACTS if facts else _MAX_COMPILED_CLAUSES)
        if not size or any(clause.is_large for clause in clauses):
            self.compile_after = NEVER
            return False
        if too_many:
            return self._go_by_keys()
        rules = [ClauseParts(_args(clause.head), clause.body, clause.place) for clause in clauses]
        generator = PredicateGenerator(self._view(), self.functor, rules, self)
        self._run_by(generator.main())
        self.steady = generator.steady
        self.compiled = True
        return True

    def _go_by_keys(self) -> bool:
        """Have calls go by the indexes that calls have asked for by now, if those leave no clause out."""
        if self.dead:
            self._sweep()
            self.indexes.make_anew(self.clauses)
        choices = self.database.machine.choices
        run: Step = self._call
        for position, index in reversed(self.indexes.complete()):
            run = by_key(position, index.own, choices, self._search(position), run)
        if run == self._call:
            self.compile_after *= 2
            return False
        self._run_by(run)
        self.compiled = True
        return True

    def _compile_clause(self, clause: Clause) -> Optional[Step]:
        if clause.is_large:
            clause.uses = -NEVER
            return None
        rule = ClauseParts(_args(clause.head), clause.body, clause.place)
        clause.code = PredicateGenerator(self._view(), self.functor, [rule], self).single(0)
        return clause.code

    def _view(self) -> KnownDatabase:
        return self.database.library if self.library else self.database


def fact_names(machine: Machine) -> Dict[str, object]:
    """Return what the code for facts names."""
    return {
        "Var": Var,
        "unify": unify,
        "undo": undo,
        "trail": machine.trail,
        "push": machine.trail.append,
        "choose": machine.choices.append,
        "Code": Code,
        "may_match": may_match,
    }


def _args(head: Term) -> Values:
    return head[1:] if head.__class__ is tuple else ()
