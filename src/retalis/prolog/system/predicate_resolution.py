"""The library: predicates written in Prolog, in files that are compiled when one of theirs is first called.

The predicates that goals can call: the program's, those in Python, and those of the library.
"""

import re
from functools import lru_cache
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, Iterator, Optional, Tuple, Union

from ...foundation.cancellation import unwatched, watched_by
from ...foundation.codegen import shared_function
from ...foundation.errors import SyntaxFault
from ..builtins.builtin_registry import ENTRIES
from ..builtins.clause_translation import translate_rule
from ..builtins.global_state import default_flags
from ..compiler.clause_nodes import FIXED
from ..database.clause_index import Clause, functional
from ..database.control_constructs import Control, control_predicates, functor_of, split_clause
from ..database.database import STANDARD, Database
from ..database.predicate import COMPILE_AFTER, Predicate
from ..machine.machine import LAST, Code, Machine
from ..syntax.operators import Operators
from ..syntax.term_reader import read_program
from ..terms.types import Frame, Functor, Step, Term, Values, Var, deref, functor

FOLDER = Path(__file__).resolve().parent.parent / "library"

_EXPORTS = re.compile(r"^% defines: (.*)$", re.MULTILINE)


@lru_cache(maxsize=1)
def library_index() -> Dict[Tuple[str, int], str]:
    """Return which file defines a predicate: each names its predicates in lines ``% defines: name/arity ...``."""
    found = {}
    for path in sorted(FOLDER.glob("*.pl")):
        for line in _EXPORTS.findall(path.read_text(encoding="utf-8")):
            for text in line.split():
                name, _, arity = text.rpartition("/")
                found[name, int(arity)] = path.stem
    return found


def load_library(database: Database, part: str) -> None:
    """Load a file of the library; that does not count for the goal that needs it."""
    before = watched_by(unwatched)
    try:
        _load(database, part)
    finally:
        watched_by(before)


def _load(database: Database, part: str) -> None:
    path = FOLDER / f"{part}.pl"
    for read in read_program(path.read_text(encoding="utf-8"), Operators.prolog(), f"library({part})"):
        if isinstance(read, SyntaxFault):
            raise read
        term = deref(read.term)
        if term.__class__ is tuple and term[0].name == "-->":
            term = translate_rule(term)
        head, body = split_clause(term)
        key = functor_of(head)
        predicate = database.library.predicate(key)
        if not predicate.library:
            if predicate.kind == "user" or predicate.dynamic:  # the program has one of this name
                predicate = database.library.kept[key] = Predicate(database, key)
            predicate.library = True
        predicate.add(Clause(predicate, head, body, read.place))


_END = object()


def is_replaceable(key: Functor) -> bool:
    """Tell whether the Prolog has a predicate that is none of the standard's, so that several facts replace it."""
    return (key.name, key.arity) in ENTRIES and key not in STANDARD and key not in FIXED


def _close(entry: Frame) -> None:
    """End the generator of a choice point."""
    close = getattr(entry[1], "close", None)  # it may be another iterator
    if close is not None:
        close()


class PredicateTable:
    """A machine with predicates.

    Args:
        operators: the operator table of the program; Prolog's by default.
        compile_after: calls of an unchanged predicate after which it is compiled.

    Attributes:
        machine: runs frames.
        database: predicates by functor.
        operators: operator table, changed by ``op/3``.
        flags: Prolog flags by name, as terms.
        message: called with kind (error, warning, informational, ...) and text of ``print_message/2``.
    """

    message: Callable[[str, str], None]

    def __init__(self, operators: Optional[Operators] = None, compile_after: int = COMPILE_AFTER):
        self.machine = Machine()
        self.machine.logic = self
        self.operators = Operators.prolog() if operators is None else operators
        self.database = Database(self.machine, compile_after)
        self.control = Control(self.database)
        self.flags: Dict[str, Term] = default_flags()
        for (name, arity), function in control_predicates(self.control).items():
            self._of_system(self.define_control(name, arity, function))
        ways: Dict[str, Callable[..., Predicate]] = {
            "deterministic": self.define,
            "function": self.define_function,
            "nondeterministic": self.define_nondeterministic,
            "control": self.define_control,
        }
        for (name, arity), entry in ENTRIES.items():
            predicate = ways[entry.kind](name, arity, entry.function)
            if entry.locked:
                self._of_system(predicate)
        self._library = library_index()
        self.database.modules.is_of_system = self.is_of_system

    @staticmethod
    def _of_system(predicate: Predicate) -> None:
        predicate.system = True
        predicate.locked = predicate.functor in FIXED

    def define(self, name: str, arity: int, function: Callable[..., bool]) -> Predicate:
        """Define a deterministic predicate: ``function(machine, *args)`` says whether it succeeds.

        Arguments may be bound variables or lazy (`deref` them); results are unified by ``machine.unify``.
        Bindings of a call that fails are undone.
        """
        # Taking the frame apart by position is faster than passing a slice of it on.
        args = "".join(f", a{at}" for at in range(arity))
        source = f"def made(frame):\n    _{args}, after = frame\n"
        source += f"    return after if function(machine{args}) else None\n"
        names = {"machine": self.machine, "function": function}
        run: Step = shared_function(source, names, f"built-in predicate of arity {arity}")
        return self.database.define(functor(name, arity), function, run, "builtin")

    def define_function(
        self,
        name: str,
        arity: int,
        function: Callable[..., Any],
        outputs: Tuple[int, ...] = (),
        shows: Tuple[Optional[Callable[..., Term]], ...] = (),
    ) -> Predicate:
        """Define a deterministic predicate by a function of its input arguments; see `Functional`.

        Args:
            name: of the predicate.
            arity: of the predicate.
            function: takes the inputs; returns the outputs, or None where it fails.
            outputs: positions of the output arguments, whose values are returned as a tuple; without them
                the last argument is the only output, and its value is what is returned.
            shows: for each output what makes its term, where the function returns something else.
        """
        form = functional(function, arity, outputs, shows)
        predicate = self.define(name, arity, form.predicate())
        predicate.functional = form
        return predicate

    def define_nondeterministic(
        self,
        name: str,
        arity: int,
        function: Callable[..., Union[bool, Iterable[object]]],
        known: Optional[Callable[..., Optional[Term]]] = None,
    ) -> Predicate:
        """Define a predicate by a generator ``function(machine, *args)`` that yields at each solution.

        It unifies before each yield; the bindings are undone before it goes on. What it binds for a
        solution that does not work out it has to undo itself: `Machine.unify_all` does. Yielding `LAST`
        says that there are no more solutions. A function that is not a generator may return a bool instead of
        one, as a deterministic predicate does, where the arguments leave at most one solution: that costs a
        fraction of a generator.

        Args:
            name: of the predicate.
            arity: of the predicate.
            function: the generator.
            known: for a predicate that is a function of its other arguments where the first is known: gives
                the last one, or None where it fails. Then ``function`` is called for a variable only.
        """
        machine = self.machine
        choices, trail = machine.choices, machine.trail
        key = functor(name, arity)

        def resume(entry: Frame) -> Optional[Frame]:
            after: Frame
            _, solutions, after, _ = entry
            mark = len(trail)
            value = next(solutions, _END)
            if value is _END:
                return None
            if value is not LAST:
                choices.append((retry, solutions, after, mark))
            return after

        retry = Code(str(key), resume)
        retry.functor = key
        retry.dropped = _close

        def call(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
            found: Any = function(machine, *args)
            if found is True:
                return after
            return resume((retry, iter(found), after, 0)) if found else None

        def run(frame: Frame) -> Optional[Frame]:
            return call(machine, frame[1:-1], frame[-1])

        if known is None:
            return self.database.define(key, call, run, "control")
        alone = self.define_function(f"${name}", arity, known)

        def run_known(frame: Frame) -> Optional[Frame]:
            return run(frame) if deref(frame[1]).__class__ is Var else alone.run((alone, *frame[1:]))

        predicate = self.database.define(key, None, run_known, "control")
        predicate.known = alone.functor
        return predicate

    def define_control(
        self,
        name: str,
        arity: int,
        function: Callable[..., Optional[Frame]],
        at_once: bool = False,
        gate: Optional[Callable[[Functor, Tuple[int, ...]], object]] = None,
    ) -> Predicate:
        """Define a predicate that decides what runs next: ``function(machine, args, next)`` returns a frame.

        One that most often does all ``at_once`` and returns ``next`` is called in line by compiled clauses.

        Args:
            name: of the predicate.
            arity: of the predicate.
            function: does a call.
            at_once: whether it most often does all at once.
            gate: for a predicate that often has nothing to do: takes the functor of a first argument and positions
                in that; returns an object whose ``passes``, called with the other arguments and those at
                the positions, is false where a call would do nothing, so that compiled clauses make none. Then
                ``function`` is called with whether the first argument has surely no variables as well.
        """
        machine = self.machine

        def run(frame: Frame) -> Optional[Frame]:
            return function(machine, frame[1:-1], frame[-1])

        predicate = self.database.define(functor(name, arity), function if at_once else None, run, "control")
        predicate.gate = gate
        return predicate

    def lookup(self, key: Functor) -> Optional[Predicate]:
        """Return the predicate of a functor if it is defined, loading the library where it defines it."""
        predicate = self.database.predicates.get(key)
        if (predicate is None or predicate.kind == "undefined") and (key.name, key.arity) in self._library:
            self._load_library(self._library[key.name, key.arity])
            predicate = self.database.predicates.get(key)
        return predicate if predicate is not None and predicate.defined else None

    def defines(self, key: Functor) -> bool:
        """Tell whether there is such a predicate."""
        predicate = self.database.predicates.get(key)
        return (predicate is not None and predicate.defined) or (key.name, key.arity) in self._library

    def is_of_system(self, key: Functor) -> bool:
        """Tell whether a predicate is the system's, not one that a program has put in its place."""
        predicate = self.database.predicates.get(key)
        if predicate is not None and predicate.defined:
            return bool(predicate.library)
        return (key.name, key.arity) in self._library

    def is_added(self, key: Functor) -> bool:
        """Tell whether a predicate is the system's and none of Prolog's: those above have defined it."""
        known = (key.name, key.arity)
        return self.is_of_system(key) and known not in ENTRIES and known not in self._library

    def names(self) -> Iterator[Functor]:
        """Yield the functors of all defined predicates."""
        for key, predicate in list(self.database.predicates.items()):
            if predicate.defined:
                yield key
        for name, arity in self._library:
            yield functor(name, arity)

    def _load_library(self, part: str) -> None:
        """Load the part of the library that defines a predicate."""
        load_library(self.database, part)
