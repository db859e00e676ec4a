"""``use_swi/1,2``: load a file into SWI-Prolog and define its exported predicates in a program.

Each such predicate is defined as a nondeterministic built-in that calls SWI-Prolog. A program has one engine of
SWI-Prolog for each of its threads.
"""

from typing import TYPE_CHECKING, Any, Callable, List, NamedTuple, Optional, Tuple

from ...foundation.errors import UsageError
from ..builtins.argument_checks import bound
from ..machine.errors import existence_error, indicator, permission_error, type_error
from ..machine.machine import Machine
from ..system.prolog_system import PrologSystem
from ..system.value_conversion import to_python
from ..terms.list_terms import list_items
from ..terms.term_traversal import copy
from ..terms.types import NIL, SLASH, Atom, Functor, Term, Var, atom, deref, functor

if TYPE_CHECKING:
    from ..files.source_files import SourceFiles
    from .swi_session import SwiProgram


_AS = functor("as", 2)
_LIBRARY = functor("library", 1)
_STATE_KEY = "swi"
"""Key of the `SwiProgram` in `PrologSystem.state`."""


class SwiFile(NamedTuple):
    """A file or library to load into SWI-Prolog.

    Attributes:
        name: absolute path, or the text of the library term.
        source: the same as a term.
        imports: list of predicate indicators; an empty list means all exported predicates.
    """

    name: str
    source: Term
    imports: Term

    @property
    def is_path(self) -> bool:
        """True for a file of the program, False for a library of SWI-Prolog."""
        return isinstance(self.source, Atom)


class ImportedPredicate(NamedTuple):
    """A predicate of SWI-Prolog.

    Attributes:
        key: the functor by which the program calls it.
    """

    name: str
    arity: int
    key: Functor


def define_use_swi(
    logic: PrologSystem, files: "SourceFiles", is_allowed: bool, warn: Callable[[object], None]
) -> None:
    """Define ``use_swi(File)`` and ``use_swi(File, Predicates)``.

    Args:
        logic: program in which they are defined.
        files: files of the program.
        is_allowed: whether files of the program may use them while they are loaded; goals that run later never may.
        warn: called with each warning of SWI-Prolog about a file.
    """

    def import_all(machine: Machine, spec: Term) -> bool:
        return import_selected(machine, spec, NIL)

    def import_selected(machine: Machine, spec: Term, imports: Term) -> bool:
        reason = "" if is_allowed else "the setting allow_swi is off"
        # A goal of a service could otherwise run arbitrary code of SWI-Prolog, which has no sandbox.
        if not files.sandbox.is_loading:
            reason = "SWI-Prolog loads only what the program's own files ask for, while they are being loaded"
        if reason:
            raise permission_error("load", "swi_file", deref(spec), reason)
        source = _resolve_source(spec, files)
        name = source.name if isinstance(source, Atom) else logic.show(source)
        use_swi(logic, SwiFile(name, source, copy(imports)), warn)
        return True

    logic.define("use_swi", 1, import_all).is_locked = True
    logic.define("use_swi", 2, import_selected).is_locked = True


def use_swi(logic: PrologSystem, file: SwiFile, warn: Callable[[object], None]) -> None:
    """Load a file into SWI-Prolog and define its predicates.

    Args:
        logic: program in which they are defined.
        file: the file or library.
        warn: called with each warning of SWI-Prolog about it.

    Raises:
        UsageError: if SWI-Prolog is not installed, or the file has errors or exports nothing.
        PrologError: if a predicate does not exist, or has the name of a built-in predicate.
    """
    predicates = _parse_imports(file.imports)
    program = _get_program(logic)
    module, exported = _load(program, file, warn)
    predicates = predicates or exported
    if not predicates:
        raise UsageError(f"{file.name} exports nothing: name its predicates, as in use_swi(File, [near/2])")
    # All predicates are checked before the first one is defined, so that an error leaves the program unchanged.
    for predicate in predicates:
        _check_import(logic, program, module, predicate)
    for predicate in predicates:
        function = program.predicate_caller(module, predicate.name, predicate.arity)
        logic.define_nondeterministic(predicate.key.name, predicate.key.arity, function)
    logic.swi_files[file.name] = file


def _get_program(logic: PrologSystem) -> "SwiProgram":
    """Return the `SwiProgram` of a program, and start SWI-Prolog if necessary."""
    # Imported here, so that programs without `use_swi` load neither SWI-Prolog nor its interface.
    from .swi_session import SwiProgram, start  # noqa: PLC0415

    program: Optional[SwiProgram] = logic.state.get(_STATE_KEY)
    if program is None:
        program = logic.state[_STATE_KEY] = SwiProgram(logic, start())
    return program


def _resolve_source(spec: Term, files: "SourceFiles") -> Term:
    """Return the term to load: a library term unchanged, or the absolute path of a file.

    Raises:
        PrologError: if the file does not exist.
    """
    spec = bound(spec)
    # Libraries are searched by SWI-Prolog in its own folders.
    if spec.__class__ is tuple and spec[0] is _LIBRARY:
        return spec
    path = files.find(spec).absolute()
    if not path.is_file():
        raise existence_error("source_sink", atom(str(path)))
    return atom(str(path))


def _parse_imports(term: Term) -> List[ImportedPredicate]:
    items = list_items(deref(term))
    if items is None:
        raise type_error("list", deref(term))
    return [_parse_import(item) for item in items]


def _parse_import(term: Term) -> ImportedPredicate:
    """Return the predicate of an indicator, or of ``Indicator as Name``."""
    item: Any = deref(term)
    local_name: Optional[Term] = None
    if item.__class__ is tuple and item[0] is _AS:
        item, local_name = deref(item[1]), deref(item[2])
    parts: List[Any] = list(map(deref, item[1:])) if item.__class__ is tuple and item[0] is SLASH else []
    if not parts or not isinstance(parts[0], Atom) or not isinstance(parts[1], int) or parts[1] < 0:
        raise type_error("predicate_indicator", item)
    if local_name is not None and not isinstance(local_name, Atom):
        raise type_error("atom", local_name)
    name, arity = parts[0].name, parts[1]
    return ImportedPredicate(name, arity, functor(name if local_name is None else local_name.name, arity))


def _load(
    program: "SwiProgram", file: SwiFile, warn: Callable[[object], None]
) -> Tuple[str, List[ImportedPredicate]]:
    """Load a file; return its module and the exported predicates.

    Raises:
        UsageError: with all errors in the file; warnings are passed to ``warn``.
    """
    module, exports, problems = Var(), Var(), Var()
    if not program.call_bridge("load", file.source, module, exports, problems):
        raise UsageError(f"SWI-Prolog cannot load {file.name}")
    errors: List[str] = []
    for problem in to_python(problems):
        severity, text = problem.args
        if severity == "error":
            errors.append(text)
        else:
            warn(text)
    if errors:
        raise UsageError(f"SWI-Prolog cannot load {file.name}: {'; '.join(errors)}")
    return to_python(module), [_parse_import(item) for item in list_items(exports) or []]


def _check_import(
    logic: PrologSystem, program: "SwiProgram", module: str, predicate: ImportedPredicate
) -> None:
    """Raise an error for a predicate that does not exist in SWI-Prolog or has the name of a built-in predicate."""
    existing_predicate = logic.database.predicates.get(predicate.key)
    if existing_predicate is not None and existing_predicate.is_locked:
        raise permission_error("modify", "static_procedure", indicator(predicate.key))
    if not program.call_bridge("defined", atom(module), atom(predicate.name), predicate.arity):
        raise existence_error("procedure", (SLASH, atom(predicate.name), predicate.arity))
