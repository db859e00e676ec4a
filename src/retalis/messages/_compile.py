"""Turns generated Python source into a function that shows its source in tracebacks."""

import linecache
from itertools import count
from typing import Any, Callable, Dict, List

_serials = count(1)


def compile_function(name: str, title: str, lines: List[str], names: Dict[str, Any]) -> Callable[..., Any]:
    """Return the function ``name`` that ``lines`` define; ``names`` are its globals."""
    source = "\n".join(lines) + "\n"
    file = f"<{title} {next(_serials)}>"
    linecache.cache[file] = (len(source), None, source.splitlines(True), file)
    space = dict(names)
    exec(compile(source, file, "exec"), space)
    function: Callable[..., Any] = space[name]
    return function
