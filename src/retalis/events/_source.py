"""Python made at run time: matchers and joins are compiled from source that a traceback can show."""

import linecache
from functools import lru_cache
from itertools import count
from typing import Any, Callable, Dict, Tuple

_numbers = count(1)


def compile_function(source: str, names: Dict[str, Any], title: str) -> Any:
    """Return the function that ``source`` defines as ``made``.

    Functions of one source share their code: rules that are alike but for their constants do not each wait for
    the interpreter to get used to theirs, nor push each other's out of the processor's caches.

    Args:
        source: the text of one function definition.
        names: what the source may refer to.
        title: what kind of code it is; a traceback shows it as the file name.
    """
    return _maker(source, tuple(names), title)(*names.values())


@lru_cache(maxsize=1000)
def _maker(source: str, names: Tuple[str, ...], title: str) -> Callable[..., Any]:
    """Return a function that makes the function of a source for the values of names."""
    filename = f"<{title} #{next(_numbers)}>"
    lines = ["    " + line for line in source.splitlines(True)]
    text = "".join([f"def maker({', '.join(names)}):\n", *lines, "\n    return made\n"])
    linecache.cache[filename] = (len(text), None, text.splitlines(True), filename)
    space: Dict[str, Any] = {}
    exec(compile(text, filename, "exec"), space)
    maker: Callable[..., Any] = space["maker"]
    return maker
