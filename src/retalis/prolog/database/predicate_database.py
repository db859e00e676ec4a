"""Predicate database: the predicates of a program and of the system, by functor.

Two versions of a predicate may exist under one name. If a program defines a predicate of the library, a new predicate
is created for the program; `LibraryView` resolves names for the clauses of the library, which still call the version
of the library. Predicates of ISO Prolog (`ISO_PREDICATES`) may be redefined in files but not by asserting a clause,
which is most likely an accident.

A call of an unknown functor creates an undefined predicate. Programs that construct functors could create them
without limit, so undefined predicates are moved to a weak dictionary from time to time (`demote_unused`), which
drops them when no frame or clause refers to them any more. The same applies to predicates without clauses that only
goals have made dynamic; of these the functors are kept, up to `MAX_EMPTY_DYNAMIC`, because a call has to fail and not
to raise an error.
"""

from typing import Any, Callable, Dict, Iterable, Optional, Set
from weakref import WeakSet, WeakValueDictionary

from ..compiler.clause_nodes import PROTECTED_PREDICATES
from ..compiler.semidet_functions import FunctionCode
from ..machine.errors import indicator, permission_error
from ..machine.machine import Code, Machine
from ..terms.types import CompoundTerm, Frame, Functor, Step, Term, deref, functor
from .goal_interpreter import Control
from .module_system import Modules
from .predicate import NEVER_COMPILE, Predicate


def _functor_of(text: str) -> Functor:
    name, _, arity = text.rpartition("/")
    return functor(name, int(arity))


_ISO_INDICATORS = (
    "abolish/1 acyclic_term/1 arg/3 asserta/1 assertz/1 at_end_of_stream/0 at_end_of_stream/1 "
    "atom_chars/2 atom_codes/2 atom_concat/3 atom_length/2 bagof/3 char_code/2 char_conversion/2 "
    "clause/2 close/1 close/2 compare/3 copy_term/2 current_char_conversion/2 current_input/1 "
    "current_op/3 current_output/1 current_predicate/1 current_prolog_flag/2 discontiguous/1 "
    "dynamic/1 findall/3 flush_output/0 flush_output/1 functor/3 get_byte/1 get_byte/2 get_char/1 "
    "get_char/2 get_code/1 get_code/2 halt/0 halt/1 keysort/2 length/2 multifile/1 nl/0 nl/1 "
    "number_chars/2 number_codes/2 numbervars/3 op/3 open/3 open/4 peek_byte/1 peek_byte/2 "
    "peek_char/1 peek_char/2 peek_code/1 peek_code/2 phrase/2 phrase/3 predicate_property/2 "
    "put_char/1 put_char/2 read/1 read/2 read_term/2 read_term/3 repeat/0 retract/1 retractall/1 "
    "set_input/1 set_output/1 set_prolog_flag/2 setof/3 sort/2 stream_property/2 sub_atom/5 "
    "term_variables/2 true/0 write/1 write/2 write_canonical/1 write_canonical/2 write_term/2 "
    "write_term/3 writeq/1 writeq/2 =../2 "
)

ISO_PREDICATES = frozenset(map(_functor_of, _ISO_INDICATORS.split()))
"""Predicates of ISO Prolog that a program may redefine in a file but not by asserting a clause."""


MAX_EMPTY_DYNAMIC = 10_000
"""Maximum number of functors without clauses that a goal has made dynamic.

The oldest ones beyond it are undefined again."""

_UNUSED_ALLOWANCE = 1000
"""Allowance of unused predicates: they are moved to the weak dictionary when the table has more than twice the
predicates that remained after the last move, plus this number."""


class Database:
    """Predicates of the system and of the program, by functor.

    Args:
        machine: runs the predicates.
        compile_after: calls of an unchanged predicate after which it is compiled.
        call_undefined: returns the frame for a call of an undefined predicate, or raises an error.
        is_system_predicate: returns whether a functor is that of a predicate of the system.
        on_module: called with the name of each module that a file declares.
        warn: called with the text of a warning.

    Attributes:
        machine: runs the predicates.
        call_undefined: see above.
        control: interpreter of goal terms.
        interpret: code of frames that run a goal from its term.
        generation: number of clauses that have been retracted. `Clause.retracted_at` is compared with the generation
            at the beginning of a call (logical update view).
        change_count: number of changes of clauses.
        compile_after: calls of an unchanged predicate after which it is compiled.
        is_library: False. `LibraryView`, which resolves names for library clauses, has True.
        is_interpreter_only: whether ``compile_after`` is `NEVER_COMPILE`, so that all goals of the program are
            interpreted.
        predicates: the predicates by functor.
        empty_dynamic: functors that goals have made dynamic and whose predicates have been demoted, oldest first.
        library: the predicates as the clauses of the library resolve them.
        compiled_goals: the compiled goals that Python code holds. Their code is discarded together with that of the
            predicates.
    """

    is_library = False

    def __init__(
        self,
        machine: Machine,
        compile_after: int,
        call_undefined: Callable[[Predicate, Frame], Optional[Frame]],
        is_system_predicate: Callable[[Functor], bool],
        on_module: Callable[[str], None],
        warn: Callable[[str], None],
    ):
        self.machine = machine
        self.call_undefined = call_undefined
        self.generation = 0
        self.change_count = 0
        self.compile_after = compile_after
        self.is_interpreter_only = compile_after >= NEVER_COMPILE
        self.predicates: Dict[Functor, Predicate] = {}
        self._demoted: WeakValueDictionary[Functor, Predicate] = WeakValueDictionary()
        self.empty_dynamic: Dict[Functor, None] = {}
        self._demotion_limit = _UNUSED_ALLOWANCE
        self.modules = Modules(
            self._is_defined, is_system_predicate, on_module, self.discard_compiled_code, warn
        )
        self.library = LibraryView(self)
        self.compiled_goals: WeakSet[Any] = WeakSet()
        self.control = Control(self)
        self.interpret: Code = self.control.code

    def predicate(self, key: Functor) -> Predicate:
        """Return the predicate of a functor, creating an undefined one if there is none."""
        predicate = self.predicates.get(key)
        if predicate is None:
            if len(self.predicates) >= self._demotion_limit:
                self.demote_unused()
            # A frame or compiled clause may still refer to the predicate in the weak dictionary. Clauses that are
            # added to a second predicate with the same functor would be invisible to it. Compared with None, because
            # a predicate without clauses has the length 0 and is false.
            demoted_predicate = self._demoted.get(key)
            predicate = self.predicates[key] = (
                Predicate(self, key) if demoted_predicate is None else demoted_predicate
            )
            if key in self.empty_dynamic:
                del self.empty_dynamic[key]
                predicate.make_dynamic(by_goal=True)
        return predicate

    def _is_defined(self, key: Functor) -> bool:
        """Return whether the program or the system defines or declares a predicate."""
        predicate = self.predicates.get(key)
        return key in self.empty_dynamic or (predicate is not None and not predicate.is_undeclared)

    def demote_unused(self) -> None:
        """Move undefined predicates, and empty ones that goals have made dynamic, to the weak dictionary."""
        for key, predicate in list(self.predicates.items()):
            if predicate.is_forgettable:
                self.empty_dynamic[key] = None
            elif not predicate.is_undeclared:
                continue
            self._demoted[key] = self.predicates.pop(key)
        for key in list(self.empty_dynamic)[: max(0, len(self.empty_dynamic) - MAX_EMPTY_DYNAMIC)]:
            del self.empty_dynamic[key]
            # Clauses and frames may still refer to the predicate, and must see that it is undefined.
            if key in self._demoted:
                self._demoted[key].abolish()
        self._demotion_limit = 2 * len(self.predicates) + _UNUSED_ALLOWANCE

    def compile_reachable(self, terms: Iterable[Term]) -> None:
        """Compile the program's predicates that occur in terms, and those that their clauses call.

        Predicates are normally compiled after ``compile_after`` calls. Those that event rules call are compiled when
        the program is loaded, so that the first event is not slow.
        """
        visited: Set[Functor] = set()
        stack = list(terms)
        while stack:
            term = deref(stack.pop())
            if term.__class__ is not tuple:
                continue
            stack += term[1:]
            predicate = self.predicates.get(term[0])
            if predicate is not None and predicate.is_static_user_predicate and term[0] not in visited:
                visited.add(term[0])
                predicate.precompile()
                stack += [clause.body for clause in predicate.active_clauses()]

    def count_change(self) -> None:
        """Count a change of clauses or declarations."""
        self.change_count += 1

    def count_retraction(self) -> None:
        """Count a retracted clause."""
        self.generation += 1

    def function_code(self, key: Functor) -> FunctionCode:
        """Return the function form of a predicate, creating it if there is none."""
        predicate = self.predicate(key)
        if predicate.function_code is None:
            predicate.function_code = FunctionCode(self, key)
        return predicate.function_code

    def is_inline(self, key: Functor) -> bool:
        """Return whether a predicate is a deterministic built-in, which compiled clauses call inline."""
        predicate = self.predicates.get(key)
        return predicate is not None and predicate.kind == "builtin"

    def define(
        self, key: Functor, function: Optional[Callable[..., Any]], run: Step, predicate_kind: str
    ) -> Predicate:
        """Define a predicate in Python, replacing any earlier definition.

        Args:
            key: functor of the predicate.
            function: Python function that compiled clauses call inline, or None.
            run: step that runs a call.
            predicate_kind: "builtin" (deterministic) or "control".
        """
        predicate = self.predicate(key)
        # Compiled clauses may contain inline calls of the previous definition.
        if predicate.kind != "undefined":
            self.discard_compiled_code()
        predicate.kind = predicate_kind
        predicate.function = function
        predicate.functional_modes = None
        predicate.bound_argument_builtin = None
        predicate.make_pushdown_filter = None
        predicate.run = run
        predicate.keeps_choice_points = False
        predicate.is_library_predicate = True
        predicate.clauses = []
        return predicate

    def discard_compiled_code(self) -> None:
        """Discard all compiled code, because it may refer to a predicate that is being redefined."""
        for predicate in self.predicates.values():
            predicate.discard_compiled_code()
        for goal in list(self.compiled_goals):
            goal.invalidate()
        self.control.bodies.clear()

    def require_writable(self, key: Functor, asserted: bool = False) -> None:
        """Require that the program may change the clauses of a predicate.

        Args:
            key: functor of the predicate.
            asserted: whether the change is made by a goal and not by a file or a declaration.

        Raises:
            PrologError: a permission error for predicates of the system.
        """
        predicate = self.predicate(key)
        is_locked = predicate.is_library_predicate and (
            predicate.is_locked or (asserted and key in ISO_PREDICATES)
        )
        if is_locked or key in PROTECTED_PREDICATES:
            raise permission_error("modify", "static_procedure", indicator(key))

    def restore_library(self, predicate: Predicate) -> None:
        """Replace the program's version of a predicate by the library's."""
        key = predicate.functor
        # If the program has not redefined the predicate, the table contains the library's version already.
        if self.predicates.get(key) is not predicate:
            self.predicates[key] = predicate
            self.library.shadowed_predicates.pop(key, None)
            self.discard_compiled_code()

    def restore_program(self, program_predicate: Predicate) -> None:
        """Undo `restore_library`: replace the library's version of a predicate by the program's."""
        key = program_predicate.functor
        current = self.predicates.get(key)
        if current is not None and current.is_library_predicate:
            self.library.shadowed_predicates[key] = current
            self.predicates[key] = program_predicate
            self.discard_compiled_code()

    def writable(self, key: Functor, asserted: bool = False) -> Predicate:
        """Return a predicate whose clauses the program may change.

        For a predicate of the library, a new predicate is created, which shadows it for the program. Arguments and
        errors are those of `require_writable`.
        """
        self.require_writable(key, asserted)
        predicate = self.predicate(key)
        if not predicate.is_library_predicate:
            return predicate if predicate.hidden_predicate is None else predicate.hidden_predicate
        # Code that has been compiled so far calls the library's version.
        self.library.shadowed_predicates[key] = predicate
        program_predicate = self.predicates[key] = Predicate(self, key)
        self.discard_compiled_code()
        return program_predicate

    def resolve_qualified_goal(self, goal: CompoundTerm) -> Term:
        """Return the goal that ``Module:Goal`` calls."""
        return self.modules.resolve_qualified_goal(goal)


class LibraryView:
    """View of the predicates for the clauses of the library, without redefinitions by the program.

    Attributes:
        is_library: True.
        machine: runs the predicates.
        shadowed_predicates: the library's versions of predicates that the program has redefined.
    """

    is_library = True

    def __init__(self, database: Database):
        self._database = database
        self.machine = database.machine
        self.shadowed_predicates: Dict[Functor, Predicate] = {}

    def resolve_qualified_goal(self, goal: CompoundTerm) -> Term:
        """Return the goal that ``Module:Goal`` calls."""
        return self._database.resolve_qualified_goal(goal)

    @property
    def interpret(self) -> Code:
        """Code of frames that run a goal from its term."""
        return self._database.interpret

    @property
    def is_interpreter_only(self) -> bool:
        """True if nothing of the program is compiled."""
        return self._database.is_interpreter_only

    def function_code(self, key: Functor) -> FunctionCode:
        """Return the function form of a predicate."""
        return self._database.function_code(key)

    def predicate(self, key: Functor) -> Predicate:
        """Return the library's version of a predicate, or the program's if the library has none."""
        # Compared with None: a predicate without clauses, such as one in Python, has length 0 and is false.
        library_predicate = self.shadowed_predicates.get(key)
        return self._database.predicate(key) if library_predicate is None else library_predicate

    def is_inline(self, key: Functor) -> bool:
        """Return whether the library's predicate is a deterministic built-in."""
        return self.predicate(key).kind == "builtin"
