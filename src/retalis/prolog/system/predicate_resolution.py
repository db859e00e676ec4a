"""Predicate resolution: predicates of the program, built-ins in Python, and the library in Prolog.

`PredicateTable` sets up a machine with its built-ins and offers four ways to define predicates in Python:
deterministic functions, functions from inputs to outputs, generators, and control predicates that return frames.

The library consists of Prolog files that list their predicates in comments ``% defines: name/arity ...``. A file is
loaded when one of its predicates is first called.
"""

import re
from functools import lru_cache
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, Iterator, Optional, Tuple, Union

from ...foundation.codegen import shared_function
from ...foundation.errors import SyntaxFault
from ...foundation.limit_checks import accept_all_work, set_limit_check

# Imported for the predicates that they register in `ENTRIES`.
from ..builtins import (  # noqa: F401
    all_solutions,
    array_predicates,
    association_lists,
    atoms_and_strings,
    clause_predicates,
    file_names,
    flags_operators_modules,
    format_strings,
    grammar_and_ssu_rules,
    list_predicates,
    listing_and_messages,
    meta_call_predicates,
    output_predicates,
    pose_predicates,
    sensor_predicates,
    stream_predicates,
    tabling,
    term_construction,
    term_tests_and_arithmetic,
    text_arguments,
    text_streams,
    time_predicates,
    tracer,
)
from ..builtins.builtin_registry import ENTRIES, ProgramMachine
from ..builtins.flags_operators_modules import default_flags
from ..builtins.grammar_and_ssu_rules import translate_rule
from ..compiler.clause_nodes import PROTECTED_PREDICATES, functional
from ..database.clause_index import Clause
from ..database.goal_interpreter import control_predicates
from ..database.goal_terms import functor_of, split_clause
from ..database.predicate import Predicate
from ..database.predicate_database import ISO_PREDICATES, Database
from ..machine.machine import LAST, Code, Machine
from ..syntax.operators import Operators
from ..syntax.term_reader import read_program
from ..terms.types import Frame, Functor, Step, Term, Values, Var, deref, functor
from .undefined_procedure_hints import UndefinedProcedures

LIBRARY_FOLDER = Path(__file__).resolve().parent.parent / "library"

_DEFINES_LINE = re.compile(r"^% defines: (.*)$", re.MULTILINE)


@lru_cache(maxsize=1)
def library_index() -> Dict[Tuple[str, int], str]:
    """Return the library file of each predicate, as declared in lines ``% defines: name/arity ...``."""
    index = {}
    for path in sorted(LIBRARY_FOLDER.glob("*.pl")):
        for line in _DEFINES_LINE.findall(path.read_text(encoding="utf-8")):
            for text in line.split():
                name, _, arity = text.rpartition("/")
                index[name, int(arity)] = path.stem
    return index


def load_library(database: Database, file_name: str) -> None:
    """Load a file of the library. The goal that needs it is not charged for the loading."""
    outer_watch = set_limit_check(accept_all_work)
    try:
        _load(database, file_name)
    finally:
        set_limit_check(outer_watch)


def _load(database: Database, file_name: str) -> None:
    path = LIBRARY_FOLDER / f"{file_name}.pl"
    for clause_read in read_program(
        path.read_text(encoding="utf-8"), Operators.prolog(), f"library({file_name})"
    ):
        if isinstance(clause_read, SyntaxFault):
            raise clause_read
        term = deref(clause_read.term)
        if term.__class__ is tuple and term[0].name == "-->":
            term = translate_rule(term)
        head, body = split_clause(term)
        key = functor_of(head)
        predicate = database.library.predicate(key)
        if not predicate.is_library_predicate:
            # If the program has defined a predicate of this name before the library was loaded, the library gets its
            # own.
            if predicate.kind == "user" or predicate.dynamic:
                predicate = database.library.shadowed_predicates[key] = Predicate(database, key)
            predicate.is_library_predicate = True
        predicate.add(Clause(predicate, head, body, clause_read.place))


_NO_SOLUTION = object()
"""Default of ``next`` after the last solution of a generator."""


def is_replaceable(key: Functor) -> bool:
    """Return whether facts of a program replace a predicate: an unprotected built-in outside of ISO Prolog."""
    return (key.name, key.arity) in ENTRIES and key not in ISO_PREDICATES and key not in PROTECTED_PREDICATES


class PredicateTable:
    """Machine with its predicates, operators and flags.

    Args:
        machine: runs frames.
        operators: operator table of the program.
        compile_after: calls of an unchanged predicate after which it is compiled.
        on_module: called with the name of each module that a file declares.
        warn: called with the text of a warning.

    Attributes:
        machine: see above.
        database: predicates by functor.
        control: interpreter of goal terms.
        operators: operator table, changed by ``op/3``.
        flags: Prolog flags by name, as terms.
        undefined_procedures: handles calls of undefined procedures.
    """

    def __init__(
        self,
        machine: ProgramMachine,
        operators: Operators,
        compile_after: int,
        on_module: Callable[[str], None],
        warn: Callable[[str], None],
    ):
        self.machine = machine
        self.operators = operators
        self._library = library_index()
        self.database = Database(
            self.machine, compile_after, self._call_undefined, self.is_system_predicate, on_module, warn
        )
        self.control = self.database.control
        self.undefined_procedures = UndefinedProcedures(self, warn)
        self.flags: Dict[str, Term] = default_flags()
        for (name, arity), function in control_predicates(self.control, self.flags).items():
            self._mark_as_system(self.define_control(name, arity, function))
        definers: Dict[str, Callable[..., Predicate]] = {
            "deterministic": self.define,
            "function": self.define_function,
            "nondeterministic": self.define_nondeterministic,
            "control": self.define_control,
        }
        for (name, arity), entry in ENTRIES.items():
            predicate = definers[entry.kind](name, arity, entry.function)
            if entry.is_protected:
                self._mark_as_system(predicate)

    @staticmethod
    def _mark_as_system(predicate: Predicate) -> None:
        predicate.is_protected = True
        predicate.is_locked = predicate.functor in PROTECTED_PREDICATES

    def define(self, name: str, arity: int, function: Callable[..., bool]) -> Predicate:
        """Define a deterministic predicate by ``function(machine, *args)``, which returns whether it succeeds.

        Arguments may be bound variables or lazy terms (use `deref`); results are unified by ``machine.unify``.
        Bindings of a failed call are undone.
        """
        # Unpacking the frame by position is faster than passing a slice of it.
        args = "".join(f", a{position}" for position in range(arity))
        source = f"def generated(frame):\n    _{args}, after = frame\n"
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
        converters: Tuple[Optional[Callable[..., Term]], ...] = (),
    ) -> Predicate:
        """Define a deterministic predicate by a function of its input arguments; see `FunctionalModes`.

        Args:
            name: name of the predicate.
            arity: arity of the predicate.
            function: takes the inputs; returns the outputs, or None if the predicate fails.
            outputs: positions of the output arguments, whose values are returned as a tuple. By default the last
                argument is the only output, and its value is returned without a tuple.
            converters: for each output, the conversion of its value to a term; None if the value is a term.
        """
        modes = functional(function, arity, outputs, converters)
        predicate = self.define(name, arity, modes.predicate())
        predicate.functional_modes = modes
        return predicate

    def define_nondeterministic(
        self,
        name: str,
        arity: int,
        function: Callable[..., Union[bool, Iterable[object]]],
        evaluate: Optional[Callable[..., Optional[Term]]] = None,
    ) -> Predicate:
        """Define a predicate by a generator ``function(machine, *args)`` that yields at each solution.

        The generator unifies before each yield; the bindings are undone before it resumes. Bindings of a solution
        that fails halfway it has to undo itself, as `Machine.unify_all` does. Yielding `LAST` declares the last
        solution. If the arguments leave at most one solution, a function that is not a generator may return a bool
        instead, as a deterministic predicate does; that costs a fraction of a generator.

        Args:
            name: name of the predicate.
            arity: arity of the predicate.
            function: the generator.
            evaluate: for a predicate that is a function of its other arguments if the first one is bound: returns
                the last argument, or None if it fails. Then ``function`` is called only with an unbound first
                argument.
        """
        machine = self.machine
        choices, trail = machine.choices, machine.trail
        key = functor(name, arity)

        def resume(entry: Frame) -> Optional[Frame]:
            continuation: Frame
            _, solutions, continuation, _ = entry
            # Taken before the generator binds anything, so that backtracking undoes its bindings.
            mark = len(trail)
            yielded = next(solutions, _NO_SOLUTION)
            if yielded is _NO_SOLUTION:
                return None
            # After LAST no choice point is pushed: the call ends deterministically, and its generator is released.
            if yielded is not LAST:
                choices.append((retry, solutions, continuation, mark))
            return continuation

        retry = Code(str(key), resume)
        retry.functor = key

        def call(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
            solutions: Any = function(machine, *args)
            # A bool needs neither a generator nor a choice point.
            if solutions is True:
                return continuation
            return resume((retry, iter(solutions), continuation, 0)) if solutions else None

        def run(frame: Frame) -> Optional[Frame]:
            return call(machine, frame[1:-1], frame[-1])

        if evaluate is None:
            return self.database.define(key, call, run, "control")
        function_predicate = self.define_function(f"${name}", arity, evaluate)

        def run_known(frame: Frame) -> Optional[Frame]:
            return (
                run(frame)
                if deref(frame[1]).__class__ is Var
                else function_predicate.run((function_predicate, *frame[1:]))
            )

        predicate = self.database.define(key, None, run_known, "control")
        predicate.bound_argument_builtin = function_predicate.functor
        return predicate

    def define_control(
        self,
        name: str,
        arity: int,
        function: Callable[..., Optional[Frame]],
        finishes_at_once: bool = False,
        make_filter: Optional[Callable[[Functor, Tuple[int, ...]], object]] = None,
    ) -> Predicate:
        """Define a control predicate by ``function(machine, args, next)``, which returns the frame to run.

        Args:
            name: name of the predicate.
            arity: arity of the predicate.
            function: runs a call.
            finishes_at_once: whether a call most often finishes within the function, which then returns ``next``.
                Compiled clauses call such predicates inline.
            make_filter: creates a pushdown filter, for a predicate whose calls often have no effect. Takes the
                functor of the first argument and positions in it, and returns an object whose ``passes`` takes the
                other arguments and the values at the positions, and returns False if a call would have no effect.
                Compiled clauses omit such calls, and pass ``function`` one more argument: whether the first one is
                certainly ground.
        """
        machine = self.machine

        def run(frame: Frame) -> Optional[Frame]:
            return function(machine, frame[1:-1], frame[-1])

        predicate = self.database.define(
            functor(name, arity), function if finishes_at_once else None, run, "control"
        )
        predicate.make_pushdown_filter = make_filter
        return predicate

    def lookup(self, key: Functor) -> Optional[Predicate]:
        """Return the predicate of a functor, after loading the library file that defines it; None if undefined."""
        predicate = self.database.predicates.get(key)
        if (predicate is None or predicate.kind == "undefined") and (key.name, key.arity) in self._library:
            self._load_library(self._library[key.name, key.arity])
            predicate = self.database.predicates.get(key)
        if key in self.database.empty_dynamic:
            predicate = self.database.predicate(key)
        return predicate if predicate is not None and predicate.is_defined else None

    def defines(self, key: Functor) -> bool:
        """Return whether a predicate is defined."""
        predicate = self.database.predicates.get(key)
        return (
            (predicate is not None and predicate.is_defined)
            or key in self.database.empty_dynamic
            or (key.name, key.arity) in self._library
        )

    def is_system_predicate(self, key: Functor) -> bool:
        """Return whether a predicate belongs to the system and the program has not redefined it."""
        predicate = self.database.predicates.get(key)
        if predicate is not None and predicate.is_defined:
            return bool(predicate.is_library_predicate)
        return (key.name, key.arity) in self._library

    def is_added(self, key: Functor) -> bool:
        """Return whether a predicate belongs to the system but not to Prolog, such as those of the event language."""
        name_and_arity = (key.name, key.arity)
        return (
            self.is_system_predicate(key)
            and name_and_arity not in ENTRIES
            and name_and_arity not in self._library
        )

    def names(self) -> Iterator[Functor]:
        """Yield the functors of all defined predicates, each once."""
        keys = {key: None for key, predicate in self.database.predicates.items() if predicate.is_defined}
        # Those of the library that have been loaded are among the predicates of the database, too.
        keys.update((functor(name, arity), None) for name, arity in self._library)
        yield from keys

    def _load_library(self, file_name: str) -> None:
        load_library(self.database, file_name)

    def _call_undefined(self, predicate: Predicate, frame: Frame) -> Optional[Frame]:
        """Run a call of an undefined predicate: through the plain name, the library, or the existence error."""
        key = predicate.functor
        if predicate.dynamic:
            return None
        plain_key = self.database.modules.plain_functor(key)
        plain_predicate = None if plain_key is None else self.lookup(plain_key)
        if plain_predicate is not None:
            return plain_predicate.run((plain_predicate, *frame[1:]))
        library_file = self._library.get((key.name, key.arity))
        if library_file is not None:
            self._load_library(library_file)
            return self.database.predicate(key).run(frame)
        return self.undefined_procedures.handle_call(predicate, frame)
