"""Functions that record their calls."""

from typing import Any, Callable, List


def recording(calls: List[Any], function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that appends its first argument to a list, and then calls another function."""

    def record(*arguments: Any, **options: Any) -> Any:
        calls.append(arguments[0])
        return function(*arguments, **options)

    return record


def preceded_by(check: Callable[[Any], None], function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that passes its first argument to a check, and then calls another function."""

    def checked(*arguments: Any, **options: Any) -> Any:
        check(arguments[0])
        return function(*arguments, **options)

    return checked
