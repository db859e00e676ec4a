"""Foreign predicates: Python functions that a program calls as predicates.

    from retalis import Engine, foreign

    @foreign
    def distance(x1: float, y1: float, x2: float, y2: float) -> float:
        return math.hypot(x1 - x2, y1 - y2)      # distance(X1,Y1,X2,Y2,D)

    @foreign
    def near(name: str) -> Iterator[str]:        # near(Name,Other), a solution for each value
        yield from NEIGHBOURS[name]

    engine.add_foreign(distance, near)

The parameters are the first arguments of the predicate; the result is unified with the last one.

``use_foreign/1`` lets a program load a Python module and defines its marked functions. Loading Python is as powerful
as any code of the process, so only the program's own files may do it, while they are loaded, and only if the setting
``allow_foreign`` is on.
"""

import importlib
import importlib.util
from contextlib import closing
from types import ModuleType
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Generator,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    TypeVar,
    Union,
    get_type_hints,
    overload,
)

from ...foundation.displayed_text import format_count
from ...foundation.errors import RetalisError, UsageError
from ..machine.errors import PrologError, indicator, instantiation_or_type_error, permission_error
from ..machine.machine import Machine
from ..machine.resource_limits import EntryExecutor
from ..terms.types import Atom, Functor, String, Term, Var, atom, deref, functor
from .prolog_system import PrologSystem
from .value_conversion import argument_converter, to_term

if TYPE_CHECKING:
    from inspect import Parameter

    from ..files.source_files import SourceFiles

_ERROR = functor("error", 2)
_PYTHON_ERROR = functor("python_error", 2)
_SPEC_ATTRIBUTE = "__retalis_foreign__"

Function = TypeVar("Function", bound=Callable[..., object])


class _ForeignSpec(NamedTuple):
    """Properties of the predicate of a function, stored with the function.

    Attributes:
        output_count: number of output arguments.
        converters: for each parameter, the conversion of a term to its argument.
        is_generator: whether the function is a generator.
    """

    name: str
    output_count: int
    converters: List[Callable[[Term], object]]
    is_generator: bool

    @property
    def arity(self) -> int:
        return len(self.converters) + self.output_count


@overload
def foreign(function: Function) -> Function: ...


@overload
def foreign(
    function: None = None, *, name: Optional[str] = None, outputs: Optional[int] = None
) -> Callable[[Function], Function]: ...


def foreign(
    function: Optional[Function] = None,
    *,
    name: Optional[str] = None,
    outputs: Optional[int] = None,
) -> Union[Function, Callable[[Function], Function]]:
    """Mark a function as a predicate; `Engine.add_foreign` or ``use_foreign/1`` defines it in a program.

    A parameter annotated with int, float, str, bool or list accepts only such values (float accepts integers as
    well). One annotated with ``numpy.ndarray`` receives the numbers of an array, a list or a byte array as a
    read-only array. One annotated with `Term` receives the term itself, which may be unbound; any other receives the
    term's Python value (see `to_python`). The result becomes a term (see `to_term`); None means failure, except for a
    function without outputs. A generator yields one solution with each value. An exception becomes the error
    ``python_error(Kind, Message)``, unless it is a `PrologError`.

    >>> @foreign
    ... def near(room: str) -> Iterator[str]:
    ...     yield from {"kitchen": ["hall", "cellar"]}.get(room, [])
    >>> engine = Engine()
    >>> print(*engine.add_foreign(near))
    near/2
    >>> [engine.show(found["Room"]) for found in engine.query("near(kitchen, Room)")]
    ['hall', 'cellar']

    Args:
        function: the function, if the decorator is used without arguments.
        name: name of the predicate; by default that of the function.
        outputs: number of arguments after the parameters. With more than 1 the function returns a tuple, with 0
            whether it succeeds. The default is 0 if the function's return annotation is bool or None, else 1.
    """

    def mark(function: Function) -> Function:
        from inspect import isgeneratorfunction  # noqa: PLC0415 - imports much, and few programs have functions

        hints = get_type_hints(function)
        count = outputs
        if count is None:
            count = 0 if hints.get("return", 1) in (bool, type(None)) else 1
        converters = [argument_converter(hints.get(parameter.name)) for parameter in _parameters(function)]
        spec = _ForeignSpec(name or function.__name__, count, converters, isgeneratorfunction(function))
        setattr(function, _SPEC_ATTRIBUTE, spec)
        return function

    return mark if function is None else mark(function)


def _parameters(function: Callable[..., object]) -> "List[Parameter]":
    from inspect import signature  # noqa: PLC0415 - see `foreign`

    parameters = list(signature(function).parameters.values())
    for parameter in parameters:
        if parameter.kind not in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD):
            raise UsageError(
                f"{function.__name__} takes *args or **kwargs; a predicate has a fixed number of arguments"
            )
    return parameters


def define_foreign(logic: PrologSystem, executor: EntryExecutor, *sources: object) -> List[Functor]:
    """Define marked functions in a program, and return the functors of their predicates.

    Args:
        logic: Prolog system of the program.
        executor: executor whose ``running_callback`` names the function that runs.
        sources: functions, and modules with marked functions.

    Raises:
        UsageError: if a function is not marked, or a module has no marked function.
        PrologError: if a predicate of the system has that name and arity.
    """
    keys = []
    for source in sources:
        functions = (
            [source]
            if callable(source)
            else [value for value in getattr(source, "__dict__", {}).values() if _is_marked(value)]
        )
        if not functions or not all(_is_marked(value) for value in functions):
            name = getattr(source, "__name__", source)
            raise UsageError(f"'{name}' has no function decorated with @foreign")
        for function in functions:
            keys.append(_define(logic, executor, function, getattr(function, _SPEC_ATTRIBUTE)))
    return keys


def _is_marked(value: object) -> bool:
    return isinstance(getattr(value, _SPEC_ATTRIBUTE, None), _ForeignSpec)


def _define(
    logic: PrologSystem, executor: EntryExecutor, function: Callable[..., Any], spec: _ForeignSpec
) -> Functor:
    key = functor(spec.name, spec.arity)
    existing = logic.database.predicates.get(key)
    if existing is not None and (
        existing.is_locked or existing.is_library_predicate and existing.is_protected
    ):
        raise permission_error("modify", "static_procedure", indicator(key))
    if spec.is_generator:
        logic.define_nondeterministic(
            spec.name, spec.arity, _generator_function(executor, function, spec, key)
        )
    else:
        logic.define(spec.name, spec.arity, _deterministic_function(executor, function, spec, key))
    return key


def _deterministic_function(
    executor: EntryExecutor, function: Callable[..., object], spec: _ForeignSpec, key: Functor
) -> Callable[..., bool]:
    input_count = len(spec.converters)
    description = f"the foreign predicate {key}"

    def run(machine: Machine, *arguments: Term) -> bool:
        values = [convert(term) for convert, term in zip(spec.converters, arguments)]
        outer_callback = executor.begin_callback(description)
        try:
            result = function(*values)
            if not spec.output_count:
                return result is not False
            return result is not None and _unify_outputs(machine, arguments[input_count:], result)
        except BaseException as error:
            raise _goal_error(machine, error, key) from error
        finally:
            executor.end_callback(outer_callback)

    return run


def _generator_function(
    executor: EntryExecutor,
    function: Callable[..., Generator[object, None, None]],
    spec: _ForeignSpec,
    key: Functor,
) -> Callable[..., Iterator[None]]:
    input_count = len(spec.converters)
    description = f"the foreign predicate {key}"

    def run(machine: Machine, *arguments: Term) -> Iterator[None]:
        values = [convert(term) for convert, term in zip(spec.converters, arguments)]
        # A cut drops the generator of solutions; closing it then runs the function's finally blocks.
        with closing(function(*values)) as solutions:
            while True:
                outer_callback = executor.begin_callback(description)
                try:
                    result = next(solutions)
                    is_solution = not spec.output_count or _unify_outputs(
                        machine, arguments[input_count:], result
                    )
                except StopIteration:
                    return
                except BaseException as error:
                    raise _goal_error(machine, error, key) from error
                finally:
                    executor.end_callback(outer_callback)
                if is_solution:
                    yield None

    return run


def _unify_outputs(machine: Machine, outputs: Sequence[Term], result: Any) -> bool:
    if len(outputs) == 1:
        return machine.unify(outputs[0], to_term(result))
    if len(result) != len(outputs):
        raise UsageError(
            f"a foreign predicate returned {format_count(len(result), 'value')} for {len(outputs)} outputs"
        )
    return machine.unify_all(*[(output, to_term(value)) for output, value in zip(outputs, result)])


def _goal_error(machine: Machine, error: BaseException, key: Functor) -> RetalisError:
    """Return the error of a goal whose function has raised an exception."""
    if isinstance(error, RetalisError):
        return error
    # An interrupt ends the whole entry. Any other exception of a user's function must not end the program.
    if not isinstance(error, Exception):
        return machine.budget.end_entry(error)
    context = (functor("context", 2), indicator(key), Var())
    formal = (_PYTHON_ERROR, atom(type(error).__name__), String(str(error)))
    return PrologError((_ERROR, formal, context))


def define_use_foreign(
    logic: PrologSystem, executor: EntryExecutor, files: "SourceFiles", is_allowed: bool
) -> None:
    """Define ``use_foreign(Module)``, which loads a Python module and defines its predicates.

    Args:
        logic: Prolog system in which the predicates are defined.
        executor: executor of the engine; see `define_foreign`.
        files: files of the program.
        is_allowed: whether the program's own files may load modules while they are loaded. Goals that run later
            never may.
    """

    def use_foreign(machine: Machine, module: Term) -> bool:
        module = deref(module)
        if not isinstance(module, (Atom, String)):
            raise instantiation_or_type_error("atom", module)
        reason = "" if is_allowed else "the setting allow_foreign is off"
        if not files.sandbox.is_loading:
            reason = "Python may be loaded only by the program's own files, while they are being loaded"
        if reason:
            raise permission_error("load", "foreign_module", module, reason)
        name = module.name if isinstance(module, Atom) else module.text
        define_foreign(logic, executor, load_module(name, files))
        path = files.resolve(name if name.endswith(".py") else f"{name}.py")
        # Absolute: a program that is loaded from a relative path is restored from another folder.
        logic.foreign_modules[str(path.absolute()) if files.is_file(path) else name] = None
        return True

    logic.define("use_foreign", 1, use_foreign).is_locked = True


def load_module(name: str, files: "SourceFiles") -> ModuleType:
    """Return the module with a name or with the path of its file.

    Args:
        name: ``package.module``, ``file.py`` or ``folder/file.py``. A name without a dot is first searched as a file
            beside the file that names it.
        files: files of the program, which resolve relative paths.

    Raises:
        UsageError: if there is no such module, or importing it fails.
    """
    path = files.resolve(name if name.endswith(".py") else f"{name}.py")
    is_file = files.is_file(path)
    try:
        if name.endswith(".py") and not is_file:
            raise UsageError("there is no such file")
        if is_file and (name.endswith(".py") or "." not in name):
            spec = importlib.util.spec_from_file_location(f"retalis_foreign_{path.stem}", str(path))
            module = importlib.util.module_from_spec(spec)  # type: ignore[arg-type]
            spec.loader.exec_module(module)  # type: ignore[union-attr]
            return module
        return importlib.import_module(name)
    except Exception as error:
        # A module may raise any exception while it is imported.
        raise UsageError(f"cannot load '{name}': {type(error).__name__}: {error}") from error
