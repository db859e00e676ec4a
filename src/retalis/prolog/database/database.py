"""Predicate database: the predicates of a program and of the system, by functor.

Several versions of a predicate may exist under one name. A program that defines a predicate of the library gets its
own; the clauses of the library keep calling theirs, which `Library` resolves. Predicates of ISO Prolog (`STANDARD`)
may be redefined in files but not by asserting a clause, which is most likely an accident.

A call of an unknown functor creates an undefined predicate. Programs that construct functors could create them
without limit, so undefined predicates are moved to a weak dictionary from time to time (`move_undefined`) and live
only as long as a frame or a clause refers to them.
"""

from typing import Any, Callable, Dict, Iterable, Optional, Set
from weakref import WeakSet, WeakValueDictionary

from ..compiler.clause_nodes import FIXED
from ..compiler.function_code import FunctionCode
from ..machine.errors import indicator, permission_error
from ..machine.machine import Code, Machine
from ..terms.types import Frame, Functor, Step, Term, deref, functor
from .clause_index import NEVER
from .module_system import Modules
from .predicate import COMPILE_AFTER, Predicate


def _functor_of(text: str) -> Functor:
    name, _, arity = text.rpartition("/")
    return functor(name, int(arity))


_NAMES = (
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

STANDARD = frozenset(map(_functor_of, _NAMES.split()))
"""Predicates of ISO Prolog that a program may redefine in a file but not by asserting a clause."""


_MAX_SPARE_PREDICATES = 1000
"""Predicates beyond twice those in use after which undefined ones are moved to the weak dictionary."""


class Database:
    """Predicates of the system and of the program, by functor.

    Args:
        machine: runs the predicates.
        compile_after: calls of an unchanged predicate after which it is compiled.

    Attributes:
        generation: number of retracted clauses, which the logical update view compares.
        changes: number of changes of clauses.
        is_library: False; `Library` shows the same predicates to the clauses of the library.
        interprets: whether ``compile_after`` is `NEVER`: nothing of the program is compiled, and goals are
            interpreted.
        modules: the modules of the program.
        library: the predicates as the library resolves them.
        interpret: code of frames that run a goal from its term.
        solve: returns the frame that runs a goal from its term, a cut height, and the next frame.
        on_forget: called when compiled code is dropped.
        undefined: returns the frame for a call of an undefined predicate, or raises.
    """

    is_library = False

    def __init__(self, machine: Machine, compile_after: int = COMPILE_AFTER):
        self.machine = machine
        self.generation = 0
        self.changes = 0
        self.compile_after = compile_after
        self.interprets = compile_after >= NEVER
        self.predicates: Dict[Functor, Predicate] = {}
        self._unused: WeakValueDictionary[Functor, Predicate] = WeakValueDictionary()
        """Undefined predicates that live only as long as something refers to them."""
        self._undefined_limit = _MAX_SPARE_PREDICATES
        self.modules = Modules()
        self.modules.is_defined = self._exists
        self.modules.on_change = self.forget
        self.library = Library(self)
        self.goals: WeakSet[Any] = WeakSet()
        """Goals that have been compiled for Python code."""
        self.interpret: Optional[Code] = None
        self.solve: Callable[[Term, int, Frame], Optional[Frame]] = lambda goal, height, continuation: None
        self.on_forget: Callable[[], None] = lambda: None
        self.undefined: Callable[[Predicate, Frame], Optional[Frame]] = lambda predicate, frame: None

    def predicate(self, key: Functor) -> Predicate:
        """Return the predicate of a functor, creating an undefined one if there is none."""
        predicate = self.predicates.get(key)
        if predicate is None:
            if len(self.predicates) >= self._undefined_limit:
                self.move_undefined()
            # A frame may still refer to the predicate that was put aside; a second one of the name would split its
            # calls.
            # Compared with None: a predicate without clauses has the length 0.
            spare = self._unused.get(key)
            predicate = self.predicates[key] = Predicate(self, key) if spare is None else spare
        return predicate

    def _exists(self, key: Functor) -> bool:
        predicate = self.predicates.get(key)
        return predicate is not None and not predicate.is_blank

    def move_undefined(self) -> None:
        """Move undefined predicates to the weak dictionary."""
        for key, predicate in list(self.predicates.items()):
            if predicate.is_blank:
                self._unused[key] = self.predicates.pop(key)
        self._undefined_limit = 2 * len(self.predicates) + _MAX_SPARE_PREDICATES

    def compile_named(self, terms: Iterable[Term]) -> None:
        """Compile the program's predicates that occur in terms, and those that their clauses refer to.

        They would be compiled after enough calls; predicates that events lead to are ready for the first event.
        """
        visited: Set[Functor] = set()
        stack = list(terms)
        while stack:
            term = deref(stack.pop())
            if term.__class__ is not tuple:
                continue
            stack += term[1:]
            predicate = self.predicates.get(term[0])
            if predicate is not None and predicate.is_fixed and term[0] not in visited:
                visited.add(term[0])
                predicate.prepare()
                stack += [clause.body for clause in predicate.active_clauses()]

    def direct(self, key: Functor) -> FunctionCode:
        """Return the functions of a predicate, creating them if there are none."""
        predicate = self.predicate(key)
        if predicate.direct is None:
            predicate.direct = FunctionCode(self, key)
        return predicate.direct

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
        # Compiled clauses contain inline calls of the former definition.
        if predicate.kind != "undefined":
            self.forget()
        predicate.kind = predicate_kind
        predicate.function = function
        predicate.functional = None
        predicate.bound_form = None
        predicate.make_filter = None
        predicate.run = run
        predicate.keeps_choice_points = False
        predicate.library = True
        predicate.clauses = []
        return predicate

    def forget(self) -> None:
        """Drop all compiled code, which may refer to a predicate that is being redefined."""
        for predicate in self.predicates.values():
            predicate.forget()
        for goal in list(self.goals):
            goal.forget()
        self.on_forget()

    def require_writable(self, key: Functor, action: str, asserted: bool = False) -> None:
        """Require that the program may change the clauses of a predicate.

        Args:
            key: functor of the predicate.
            action: the action named in the error, such as "modify".
            asserted: whether a goal changes them, and not a file or a declaration.

        Raises:
            PrologError: a permission error for predicates of the system.
        """
        predicate = self.predicate(key)
        locked = predicate.library and (predicate.locked or (asserted and key in STANDARD))
        if locked or key in FIXED:
            raise permission_error(action, "static_procedure", indicator(key))

    def restore_library(self, predicate: Predicate) -> None:
        """Replace the program's own version of a predicate by the library's."""
        key = predicate.functor
        if self.predicates.get(key) is not predicate:
            self.predicates[key] = predicate
            self.library.kept.pop(key, None)
            self.forget()

    def restore_program(self, program_predicate: Predicate) -> None:
        """Undo `restore_library`: replace the library's version of a predicate by the program's own."""
        key = program_predicate.functor
        current = self.predicates.get(key)
        if current is not None and current.library:
            self.library.kept[key] = current
            self.predicates[key] = program_predicate
            self.forget()

    def writable(self, key: Functor, action: str, asserted: bool = False) -> Predicate:
        """Return a predicate whose clauses the program may change.

        For a predicate of the library a new one is created, which the program uses from then on; the library keeps
        its own. Arguments and errors are those of `require_writable`.
        """
        self.require_writable(key, action, asserted)
        predicate = self.predicate(key)
        if not predicate.library:
            return predicate if predicate.tabled is None else predicate.tabled
        # Code compiled so far calls the library's version, hence the `forget` afterwards.
        self.library.kept[key] = predicate
        program_predicate = self.predicates[key] = Predicate(self, key)
        self.forget()
        return program_predicate


class Library:
    """Predicates as the clauses of the library resolve them, without redefinitions by the program.

    Args:
        database: the predicates.

    Attributes:
        kept: the library's versions of predicates that the program has redefined.
    """

    is_library = True

    def __init__(self, database: Database):
        self._database = database
        self.machine = database.machine
        self.kept: Dict[Functor, Predicate] = {}

    @property
    def modules(self) -> Modules:
        """Modules of the program."""
        return self._database.modules

    @property
    def interpret(self) -> Optional[Code]:
        """Code of frames that run a goal from its term."""
        return self._database.interpret

    @property
    def interprets(self) -> bool:
        """True if nothing of the program is compiled."""
        return self._database.interprets

    def direct(self, key: Functor) -> FunctionCode:
        """Return the functions of a predicate."""
        return self._database.direct(key)

    def predicate(self, key: Functor) -> Predicate:
        """Return the library's version of a predicate, else the program's."""
        # Compared with None: a predicate without clauses, such as one in Python, has length 0 and is false.
        library_predicate = self.kept.get(key)
        return self._database.predicate(key) if library_predicate is None else library_predicate

    def is_inline(self, key: Functor) -> bool:
        """Return whether the library's predicate is a deterministic built-in."""
        return self.predicate(key).kind == "builtin"
