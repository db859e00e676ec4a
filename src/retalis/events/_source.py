"""Python made at run time: matchers and joins are compiled from source that a traceback can show."""

import linecache
from itertools import count
from typing import Any, Dict

_numbers = count(1)


def compile_function(source: str, names: Dict[str, Any], title: str) -> Any:
    """Return the function that ``source`` defines as ``made``.

    Args:
        source: the text of one function definition.
        names: what the source may refer to.
        title: what the code is for; a traceback shows it as the file name.
    """
    filename = f"<{title} #{next(_numbers)}>"
    linecache.cache[filename] = (len(source), None, source.splitlines(True), filename)
    space = dict(names)
    exec(compile(source, filename, "exec"), space)
    return space["made"]
