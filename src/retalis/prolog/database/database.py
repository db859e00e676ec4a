"""The standard's own predicates, as far as programs may define them anew: in files, not by asserting a clause.

All predicates of a program and of the system.
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


def _key(text: str) -> Functor:
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

STANDARD = frozenset(map(_key, _NAMES.split()))
"""What a clause that a goal asserts does not replace: that would be an accident."""


_SPARE = 1000
"""Predicates from which on, and then at twice as many, it is looked which of them are none."""


class Database:
    """All predicates, by functor; the system's and the program's.

    Attributes:
        machine: runs them.
        generation: counts retracted clauses, for the logical update view.
        changes: counts clauses that came or went.
        compile_after: calls of an unchanged predicate after which it is compiled.
        is_library: whether these are the predicates as the library sees them.
        interprets: whether that is `NEVER`: nothing of the program is compiled, and goals are run from their terms.
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
        """Predicates that nobody has defined: they stay as long as something refers to them."""
        self._many = _SPARE
        self.modules = Modules()
        self.modules.is_there = self._is_there
        self.modules.on_change = self.forget
        self.library = Library(self)
        self.goals: WeakSet[Any] = WeakSet()
        """The goals that have been compiled for Python code, see `CompiledGoal`."""
        self.interpret: Optional[Code] = None
        self.solve: Callable[[Term, int, Frame], Optional[Frame]] = lambda goal, height, after: None
        self.on_forget: Callable[[], None] = lambda: None
        self.undefined: Callable[[Predicate, Frame], Optional[Frame]] = lambda predicate, frame: None

    def predicate(self, key: Functor) -> Predicate:
        """Return the predicate of a functor; one that nobody defined yet is undefined."""
        found = self.predicates.get(key)
        if found is None:
            if len(self.predicates) >= self._many:
                self.put_aside()
            found = self.predicates[key] = self._unused.get(key) or Predicate(self, key)
        return found

    def _is_there(self, key: Functor) -> bool:
        found = self.predicates.get(key)
        return found is not None and not found.is_blank

    def put_aside(self) -> None:
        """Keep predicates that nobody has defined no longer than something refers to them."""
        for key, predicate in list(self.predicates.items()):
            if predicate.is_blank:
                self._unused[key] = self.predicates.pop(key)
        self._many = 2 * len(self.predicates) + _SPARE

    def compile_named(self, terms: Iterable[Term]) -> None:
        """Compile the program's predicates that are named in terms, and those that their clauses name.

        Any of them would be compiled when it has been called often enough; those that events lead to are
        so from the first event on.
        """
        seen: Set[Functor] = set()
        stack = list(terms)
        while stack:
            term = deref(stack.pop())
            if term.__class__ is not tuple:
                continue
            stack += term[1:]
            predicate = self.predicates.get(term[0])
            if predicate is not None and predicate.is_fixed and term[0] not in seen:
                seen.add(term[0])
                predicate.prepare()
                stack += [clause.body for clause in predicate.live()]

    def direct(self, key: Functor) -> FunctionCode:
        """Return the functions of a predicate."""
        predicate = self.predicate(key)
        if predicate.direct is None:
            predicate.direct = FunctionCode(self, key)
        return predicate.direct

    def is_inline(self, key: Functor) -> bool:
        """Tell whether a predicate is a deterministic built-in, which compiled clauses call in line."""
        found = self.predicates.get(key)
        return found is not None and found.kind == "builtin"

    def define(self, key: Functor, function: Optional[Callable[..., Any]], run: Step, kind: str) -> Predicate:
        """Define a predicate in Python."""
        predicate = self.predicate(key)
        if predicate.kind != "undefined":
            self.forget()
        predicate.kind = kind
        predicate.function = function
        predicate.functional = None
        predicate.known = None
        predicate.gate = None
        predicate.run = run
        predicate.steady = False
        predicate.library = True
        predicate.clauses = []
        return predicate

    def forget(self) -> None:
        """Drop compiled code that may refer to a predicate that is being redefined."""
        for predicate in self.predicates.values():
            predicate.forget()
        for goal in list(self.goals):
            goal.forget()
        self.on_forget()

    def require_writable(self, key: Functor, action: str, asserted: bool = False) -> None:
        """Check that the program may change the clauses of a predicate.

        Args:
            key: of the predicate.
            action: what is done, for the error.
            asserted: whether a goal does it, not a file or a declaration.

        Raises:
            PrologError: a permission error for the system's predicates.
        """
        predicate = self.predicate(key)
        locked = predicate.library and (predicate.locked or (asserted and key in STANDARD))
        if locked or key in FIXED:
            raise permission_error(action, "static_procedure", indicator(key))

    def give_back(self, predicate: Predicate) -> None:
        """Have the library's predicate be the program's again, in place of one of the program's own."""
        key = predicate.functor
        if self.predicates.get(key) is not predicate:
            self.predicates[key] = predicate
            self.library.kept.pop(key, None)
            self.forget()

    def take_back(self, own: Predicate) -> None:
        """Have one of the program's own take the place of the library's again, where that was given back."""
        key = own.functor
        other = self.predicates.get(key)
        if other is not None and other.library:
            self.library.kept[key] = other
            self.predicates[key] = own
            self.forget()

    def writable(self, key: Functor, action: str, asserted: bool = False) -> Predicate:
        """Return a predicate whose clauses the program may change.

        A program that defines a predicate of the library gets one of its own; the library keeps using its.
        Arguments and errors are those of `require_writable`.
        """
        self.require_writable(key, action, asserted)
        predicate = self.predicate(key)
        if not predicate.library:
            return predicate if predicate.tabled is None else predicate.tabled
        self.library.kept[key] = predicate
        own = self.predicates[key] = Predicate(self, key)
        self.forget()
        return own


class Library:
    """The predicates as the library's own clauses see them: redefinitions by the program do not count."""

    is_library = True

    def __init__(self, database: Database):
        self._database = database
        self.machine = database.machine
        self.kept: Dict[Functor, Predicate] = {}

    @property
    def modules(self) -> Modules:
        """The modules of the program."""
        return self._database.modules

    @property
    def interpret(self) -> Optional[Code]:
        """The code that runs a goal from its term."""
        return self._database.interpret

    @property
    def interprets(self) -> bool:
        """Whether nothing of the program is compiled."""
        return self._database.interprets

    def direct(self, key: Functor) -> FunctionCode:
        """Return the functions of a predicate of the program."""
        return self._database.direct(key)

    def predicate(self, key: Functor) -> Predicate:
        """Return the library's predicate, else the program's."""
        found = self.kept.get(key)  # one without clauses, as of Python, counts as false
        return self._database.predicate(key) if found is None else found

    def is_inline(self, key: Functor) -> bool:
        """Tell whether the library's predicate is a deterministic built-in."""
        return self.predicate(key).kind == "builtin"
