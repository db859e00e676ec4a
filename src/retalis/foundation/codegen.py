"""Python made at run time: the one place where text becomes code.

The names in generated source are made by the code that writes it: ``a1``, ``k7``. Whatever comes from outside (names
of types and predicates, atoms, texts) is bound to such a name as a value and never stands in the source. Should
something slip in all the same, the code sees only what it was given and the few functions of `_BUILTINS`: no imports,
no files, no evaluation of texts.
"""

import builtins
import re
from itertools import count
from typing import Any, Callable, Dict, Hashable, Iterable, Mapping, NamedTuple, Sequence, Tuple, Union

from .bounded_caches import Cache
from .errors import shortened
from .python_interpreter import confine

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
"""What generated code may use without having been given it."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,30}\Z")
_COST = 20
"""Bytes that a function takes for each character of its source."""

MAX_TERM_ARGUMENTS = 1500
"""Arguments in all the compounds of a term for which code is made; for larger ones the general routines are used.

What a message or a rule of a person has stays far below. Python's compiler takes time that grows faster than long
functions do.
"""

_serials = count(1)

_Key = Tuple[str, Tuple[str, ...], str]
_makers: Cache[_Key, Callable[..., Any]] = Cache(1000, 16 << 20, _COST * 8000)
"""Longer sources are not kept: those of two rules are hardly ever alike."""


class _GeneratedSource:
    """Shows generated source in tracebacks: `linecache` asks for it, and it lives as long as the code does."""

    __slots__ = ("_text",)

    def __init__(self, text: str):
        self._text = text

    def get_source(self, name: str) -> str:
        return self._text


class BoundNames:
    """The names in a source that is being written: of values that it is given, and of its own variables.

    Args:
        given: what has a name already; the names that are added stand there, too.

    Attributes:
        values: the values by their names, as `function` takes them.
    """

    __slots__ = ("values", "_serial", "_constants")

    def __init__(self, given: Dict[str, Any]):
        self.values = given
        self._serial = 0
        self._constants: Dict[Hashable, str] = {}

    def name(self, prefix: str, value: Any = None) -> str:
        """Return a new name, for a variable, or of a value that is not None."""
        self._serial += 1
        name = f"{prefix}{self._serial}"
        if value is not None:
            self.values[name] = value
        return name

    def constant(self, value: Any, key: Hashable) -> str:
        """Return the name of a value, the same for all that have one key."""
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
        header: its first line, as ``if a:``.
        body: the statements in it; without any it is left out.
    """

    header: str
    body: "Sequence[Statement]"


Statement = Union[str, Block]
"""A statement of generated source: a line, or a block."""


def source_of(statements: Iterable[Statement], depth: int = 0) -> str:
    """Return the source of statements, indented by so many steps."""
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
    """Add the functions of a source to the names that they may use, and return these.

    Args:
        source: function definitions, ASCII.
        names: what the functions may name; it is their globals from now on.
        title: what they are, for tracebacks; any text.

    Raises:
        ValueError: where a name is none of ours, or the source holds what no source of ours does.
    """
    if not source.isascii():
        raise ValueError("generated source must be ASCII")
    for name in names:
        if not _NAME.match(name):
            raise ValueError(f"{shortened(name)} is not a name for generated source")
    file = f"retalis, {_clean(title)} #{next(_serials)}"
    names["__name__"] = file
    names["__loader__"] = _GeneratedSource(source)
    code = compile(source, file, "exec", dont_inherit=True)
    confine(code, names, _BUILTINS)
    exec(code, names)
    return names


def function(lines: Iterable[str], names: Mapping[str, object], title: str, name: str = "made") -> Any:
    """Return the function that ``lines`` define under a name, which they do not use; see `define`.

    It is not among its own globals: nothing of it stays until the collector of cycles comes, which it does seldom.
    """
    return define("\n".join(lines) + "\n", dict(names), title).pop(name)


def shared_function(source: str, names: Mapping[str, object], title: str) -> Any:
    """Return the function that ``source`` defines as ``made``; functions of one source share their code.

    Rules that are alike but for their constants do not each wait for the interpreter to get used to theirs, nor push
    each other's out of the processor's caches.
    """
    key = source, tuple(names), title
    maker = _makers.get(key) or _makers.keep(key, _maker(*key), _COST * len(source))
    return maker(*names.values())


def _maker(source: str, names: Tuple[str, ...], title: str) -> Callable[..., Any]:
    """Return a function that makes the function of a source for the values of names."""
    for name in names:
        if not _NAME.match(name):
            raise ValueError(f"{shortened(name)} is not a name for generated source")
    lines = ["    " + line for line in source.splitlines(True)]
    text = "".join([f"def maker({', '.join(names)}):\n", *lines, "\n    return made\n"])
    maker: Callable[..., Any] = define(text, {}, title).pop("maker")
    return maker


def _clean(title: str) -> str:
    """Return a title as it may stand in a file's name: no NUL, no surrogates, one line."""
    return shortened(title).strip("'\"") if not (title.isascii() and title.isprintable()) else title[:200]
