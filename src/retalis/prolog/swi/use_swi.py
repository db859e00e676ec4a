"""What a program has of SWI-Prolog: an engine of it for each thread.

``use_swi/1,2``: files for SWI-Prolog, whose predicates a program calls as its own.
"""

from contextlib import closing
from pathlib import Path
from threading import local
from typing import TYPE_CHECKING, Any, Callable, Iterator, List, NamedTuple, Optional, Protocol, Tuple, Union

from ...foundation.errors import UsageError
from ..machine.errors import existence_error, indicator, instantiation_error, permission_error, type_error
from ..machine.machine import Machine
from ..machine.resource_limits import MEGABYTE
from ..system.prolog_system import PrologSystem
from ..system.value_conversion import to_python
from ..terms.list_terms import list_items
from ..terms.term_traversal import copy
from ..terms.types import COLON, NIL, SLASH, Atom, Functor, Term, Var, atom, deref, functor
from .libswipl import FAILED
from .swi_session import SwiEngine
from .swi_startup import BRIDGE, Started

if TYPE_CHECKING:
    pass  # import gone


class SwiProgram:
    """What a program has of SWI-Prolog: an engine for each thread that runs its goals.

    SWI-Prolog notes with an engine where the stack of its thread lies, and ends the process where that is elsewhere
    later. So an engine goes with its thread.

    Args:
        logic: of the program.
        started: SWI-Prolog.
    """

    def __init__(self, logic: PrologSystem, started: Started):
        self._logic = logic
        self._started = started
        self._threads = local()

    def predicate(self, module: str, name: str, arity: int) -> Callable[..., Union[bool, Iterator[object]]]:
        """Return what calls a predicate of a module, for `PrologSystem.define_nondeterministic`."""
        threads, budget = self._threads, self._logic.machine.budget
        handle = self.engine().handle(module, name, arity)
        key = functor(name, arity)
        where = atom(module)

        def call(machine: Machine, *arguments: Term) -> Union[bool, Iterator[object]]:
            try:
                engine: SwiEngine = threads.engine
            except AttributeError:
                engine = self.engine()
            left = budget.left()
            if left is not None and left.inferences is not None:
                goal = (COLON, where, (key, *arguments) if arguments else atom(name))
                return engine.call(machine, engine.limited, (goal, max(left.inferences, 0)), left)
            return engine.call(machine, handle, arguments, left)

        return call

    def engine(self) -> SwiEngine:
        """Return the engine of this thread."""
        found: Optional[SwiEngine] = getattr(self._threads, "engine", None)
        if found is None:
            found = self._threads.engine = SwiEngine(self._logic, self._started)
            megabytes = self._logic.limits.megabytes
            if megabytes is not None:
                self.ask("limit_stacks", int(megabytes * MEGABYTE))
        return found

    def ask(self, name: str, *arguments: Term) -> bool:
        """Call a predicate of the bridge once; its bindings stay."""
        found = self.predicate(BRIDGE, name, len(arguments))(self._logic.machine, *arguments)
        if isinstance(found, bool):
            return found
        with closing(found) as solutions:  # type: ignore[type-var]
            return next(solutions, FAILED) is not FAILED


_AS = functor("as", 2)
_LIBRARY = functor("library", 1)
_STATE = "swi"
"""Where a logic has its `SwiProgram`."""


class Loading(Protocol):
    """What knows whether the program's own files are being loaded, a `Door`."""

    is_loading: bool


class FoundFiles(Protocol):
    """The files that a program names, see `Files`."""

    @property
    def door(self) -> Loading:
        """What opens them."""

    def find(self, name: Term) -> Path:
        """Return the path of a file that a program names."""


class SwiFile(NamedTuple):
    """What SWI-Prolog is to load.

    Attributes:
        name: the whole path, or how a library is called.
        source: the same as a term.
        wanted: the list of predicates; the empty one stands for those that it exports.
    """

    name: str
    source: Term
    wanted: Term

    @property
    def is_path(self) -> bool:
        """Whether it is a file that the program names, and no library."""
        return isinstance(self.source, Atom)


class Wanted(NamedTuple):
    """A predicate that a program asks for, and what it calls it."""

    name: str
    arity: int
    key: Functor


def define_use_swi(
    logic: PrologSystem, files: FoundFiles, allowed: bool, warn: Callable[[object], None]
) -> None:
    """Define ``use_swi(File)`` and ``use_swi(File, Predicates)``.

    Args:
        logic: where they are defined.
        files: of the program.
        allowed: whether its own files may do that, while they are loaded; goals that run later never may.
        warn: called with what is doubtful in a file.
    """

    def use_all(machine: Machine, spec: Term) -> bool:
        return use(machine, spec, NIL)

    def use(machine: Machine, spec: Term, wanted: Term) -> bool:
        reason = "" if allowed else "the setting allow_swi is off"
        if not files.door.is_loading:
            reason = "SWI-Prolog loads only what the program's own files ask for, while they are being loaded"
        if reason:
            raise permission_error("load", "swi_file", deref(spec), reason)
        source = _source(spec, files)
        name = source.name if isinstance(source, Atom) else logic.show(source)
        use_swi(logic, SwiFile(name, source, copy(wanted)), warn)
        return True

    logic.define("use_swi", 1, use_all).locked = True
    logic.define("use_swi", 2, use).locked = True


def use_swi(logic: PrologSystem, file: SwiFile, warn: Callable[[object], None]) -> None:
    """Load a file into SWI-Prolog and define its predicates.

    Args:
        logic: where they are defined.
        file: what to load.
        warn: called with what is doubtful in it.

    Raises:
        UsageError: where SWI-Prolog is not installed, or the file has errors.
        PrologError: where there is no such predicate, or one of the system has its name.
    """
    names = _wanted(file.wanted)
    program = _program(logic)
    module, exported = _load(program, file, warn)
    names = names or exported
    if not names:
        raise UsageError(f"{file.name} exports nothing: name its predicates, as in use_swi(File, [near/2])")
    for one in names:
        _check(logic, program, module, one)
    for one in names:
        function = program.predicate(module, one.name, one.arity)
        logic.define_nondeterministic(one.key.name, one.key.arity, function)
    logic.swi_files[file.name] = file


def _program(logic: PrologSystem) -> "SwiProgram":
    """Return what a program has of SWI-Prolog; only those that ask for it have SWI-Prolog loaded, and ctypes."""
    from .swi_startup import start  # noqa: PLC0415

    found: Optional[SwiProgram] = logic.state.get(_STATE)
    if found is None:
        found = logic.state[_STATE] = SwiProgram(logic, start())
    return found


def _source(spec: Term, files: FoundFiles) -> Term:
    """Return what SWI-Prolog is to load: a library of its own as it is, a file by its path."""
    spec = deref(spec)
    if spec.__class__ is Var:
        raise instantiation_error()
    if spec.__class__ is tuple and spec[0] is _LIBRARY:
        return spec
    path = files.find(spec).absolute()
    if not path.is_file():
        raise existence_error("source_sink", atom(str(path)))
    return atom(str(path))


def _wanted(term: Term) -> List[Wanted]:
    """Return the predicates of a list."""
    items = list_items(deref(term))
    if items is None:
        raise type_error("list", deref(term))
    return [_one(item) for item in items]


def _one(indicator_of: Term) -> Wanted:
    item: Any = deref(indicator_of)
    new: Optional[Term] = None
    if item.__class__ is tuple and item[0] is _AS:
        item, new = deref(item[1]), deref(item[2])
    parts: List[Any] = list(map(deref, item[1:])) if item.__class__ is tuple and item[0] is SLASH else []
    if not parts or not isinstance(parts[0], Atom) or not isinstance(parts[1], int) or parts[1] < 0:
        raise type_error("predicate_indicator", item)
    if new is not None and not isinstance(new, Atom):
        raise type_error("atom", new)
    name, arity = parts[0].name, parts[1]
    return Wanted(name, arity, functor(name if new is None else new.name, arity))


def _load(program: "SwiProgram", file: SwiFile, warn: Callable[[object], None]) -> Tuple[str, List[Wanted]]:
    """Load a file; return its module and what that exports.

    Raises:
        UsageError: for what is wrong in it; what is doubtful is a warning.
    """
    module, exports, problems = Var(), Var(), Var()
    if not program.ask("load", file.source, module, exports, problems):
        raise UsageError(f"SWI-Prolog cannot load {file.name}")
    errors: List[str] = []
    for problem in to_python(problems):
        kind, text = problem.args
        if kind == "error":
            errors.append(text)
        else:
            warn(text)
    if errors:
        raise UsageError(f"SWI-Prolog cannot load {file.name}: {'; '.join(errors)}")
    return to_python(module), [_one(item) for item in list_items(exports) or []]


def _check(logic: PrologSystem, program: "SwiProgram", module: str, one: Wanted) -> None:
    """Refuse a predicate that is not there, or whose name the system has."""
    known = logic.database.predicates.get(one.key)
    if known is not None and known.locked:
        raise permission_error("modify", "static_procedure", indicator(one.key))
    if not program.ask("defined", atom(module), atom(one.name), one.arity):
        raise existence_error("procedure", (SLASH, atom(one.name), one.arity))
