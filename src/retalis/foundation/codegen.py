"""Compilation of generated Python source: the only module that turns text into code.

Identifiers in generated source are created by the generator (``a1``, ``k7``). Anything from outside (names of types
and predicates, atoms, strings) is bound to such an identifier as a value and never becomes part of the source. As a
second line of defence, generated code sees only the globals that it is given and the few functions of `_BUILTINS`: no
imports, no files, no ``eval``.
"""

import builtins
import re
from itertools import count
from typing import Any, Callable, Dict, Hashable, Iterable, Mapping, NamedTuple, Sequence, Tuple, Union

from .bounded_caches import Cache
from .displayed_text import quote_shortened

_BUILTINS: Dict[str, object] = {
    name: getattr(builtins, name)
    for name in (
        "BaseException",
        "Exception",
        "RecursionError",
        "TypeError",
        "ValueError",
        "bool",
        "float",
        "int",
        "len",
        "list",
        "max",
        "min",
        "range",
        "reversed",
        "str",
        "tuple",
    )
}
"""Built-in functions that generated code may use."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,30}\Z")
_BYTES_PER_CHARACTER = 20
"""Estimated memory of a compiled function, in bytes per character of its source."""

MAX_TERM_ARGUMENTS = 1500
"""Maximum number of arguments in a term, nested ones included, for which code is generated.

Larger terms use the general routines: the time of Python's compiler grows faster than linearly with the length of a
function. Messages and rules that people write stay far below.
"""

_serials = count(1)

_Key = Tuple[str, Tuple[str, ...], str]
_factories: Cache[_Key, Callable[..., Any]] = Cache(1000, 16 << 20, _BYTES_PER_CHARACTER * 8000)
"""Functions of `shared_function` by source. Longer sources are not cached, because they are rarely equal."""


class _GeneratedSource:
    """Loader that `linecache` asks for the source of generated code in tracebacks; it lives as long as the code."""

    __slots__ = ("_text",)

    def __init__(self, text: str):
        self._text = text

    def get_source(self, name: str) -> str:
        return self._text


class BoundNames:
    """Allocator of identifiers in generated source, for variables and for values.

    Args:
        existing_names: names that exist already; new names of values are added to this dictionary.

    Attributes:
        values: values by name, as `function` expects them.
    """

    __slots__ = ("values", "_serial", "_constants")

    def __init__(self, existing_names: Dict[str, Any]):
        self.values = existing_names
        self._serial = 0
        self._constants: Dict[Hashable, str] = {}

    def name(self, prefix: str, value: Any = None) -> str:
        """Return a new identifier; it is bound to ``value`` unless that is None."""
        self._serial += 1
        name = f"{prefix}{self._serial}"
        if value is not None:
            self.values[name] = value
        return name

    def constant(self, value: Any, key: Hashable) -> str:
        """Return the identifier of a value, which is the same for all values with the same key."""
        name = self._constants.get(key)
        if name is None:
            name = self._constants[key] = self.name("k")
            self.values[name] = value
        return name


class Block(NamedTuple):
    """A compound statement.

    >>> print(source_of([Block("if a:", ["b = 1", Block("while b:", ["b = c()"])])]))
    if a:
        b = 1
        while b:
            b = c()

    Attributes:
        header: its first line, for example ``if a:``.
        body: its statements. A block without statements is omitted.
    """

    header: str
    body: "Sequence[Statement]"


Statement = Union[str, Block]
"""A statement of generated source: a line, or a block."""


def source_of(statements: Iterable[Statement], depth: int = 0) -> str:
    """Return the source of statements, indented by ``depth`` levels."""
    lines = []
    for statement in statements:
        if isinstance(statement, str):
            lines.append("    " * depth + statement)
        elif statement.body:
            lines += ["    " * depth + statement.header, source_of(statement.body, depth + 1)]
    return "\n".join(lines)


def tuple_source(items: Iterable[str]) -> str:
    """Return the source of a tuple of expressions."""
    return f"({''.join(f'{item}, ' for item in items)})"


def define(source: str, names: Dict[str, Any], title: str) -> Dict[str, Any]:
    """Execute function definitions in the given globals, and return these.

    Args:
        source: function definitions, ASCII.
        names: globals of the functions; the functions are added.
        title: description for tracebacks; any text.

    Raises:
        ValueError: if a name is not an identifier of generated source, or the source is not ASCII.
    """
    # All identifiers are generated and all texts are bound values, so another character means a defect of a
    # generator.
    if not source.isascii():
        raise ValueError("generated source must be ASCII")
    for name in names:
        if not _NAME.match(name):
            raise ValueError(f"{quote_shortened(name)} is not a name for generated source")
    # `linecache` identifies sources by file name, so the name must be unique. Tracebacks then show the source.
    file = f"retalis, {_printable_title(title)} #{next(_serials)}"
    names["__name__"] = file
    # Read by `linecache` through the frame's globals; nothing is registered globally, so nothing has to be removed.
    names["__loader__"] = _GeneratedSource(source)
    code = compile(source, file, "exec", dont_inherit=True)
    # Without this, Python would add all built-in functions to the globals when the code is executed.
    names["__builtins__"] = _BUILTINS
    exec(code, names)
    return names


def function(lines: Iterable[str], names: Mapping[str, object], title: str, name: str = "generated") -> Any:
    """Return the function that ``lines`` define under ``name``; see `define`.

    The function is removed from its own globals. Otherwise the two would form a reference cycle, and memory would be
    freed only by the cyclic garbage collector, which runs rarely here. Functions can therefore not call themselves.
    """
    return define("\n".join(lines) + "\n", dict(names), title).pop(name)


def shared_function(source: str, names: Mapping[str, object], title: str) -> Any:
    """Return the function that ``source`` defines as ``generated``; functions with the same source share their code
    object.

    Rules that differ in constants only then share what CPython's adaptive interpreter has specialized, and occupy
    the processor's caches once.
    """
    # The values are not part of the key: rules that differ in them share the code.
    key = source, tuple(names), title
    factory = _factories.get(key) or _factories.store(
        key, _make_factory(*key), _BYTES_PER_CHARACTER * len(source)
    )
    return factory(*names.values())


def _make_factory(source: str, names: Tuple[str, ...], title: str) -> Callable[..., Any]:
    """Return a factory that binds values to ``names`` and returns the function of a source."""
    for name in names:
        if not _NAME.match(name):
            raise ValueError(f"{quote_shortened(name)} is not a name for generated source")
    lines = ["    " + line for line in source.splitlines(True)]
    text = "".join([f"def maker({', '.join(names)}):\n", *lines, "\n    return generated\n"])
    factory: Callable[..., Any] = define(text, {}, title).pop("maker")
    return factory


def _printable_title(title: str) -> str:
    """Return a title in a form that is valid in a file name: no NUL, no surrogates, one line."""
    return (
        quote_shortened(title).strip("'\"") if not (title.isascii() and title.isprintable()) else title[:200]
    )
