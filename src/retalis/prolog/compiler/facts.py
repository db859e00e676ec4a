"""Code that looks for a matching fact among many: one function for each arity and indexed argument."""

from typing import Callable, Dict, List, Optional

from ...foundation import codegen
from ..machine import Frame


def fact_search(
    arity: int, indexed: Optional[int], namespace: Dict[str, object]
) -> Callable[..., Optional[Frame]]:
    """Return ``search(frame, clauses, at, end, generation, keys)``, which tries ground facts in order.

    It returns the frame to go on with, after pushing a choice point where another fact may match.

    Args:
        arity: of the predicate.
        indexed: the argument (from 0) that the index has compared already: facts agree in its first level.
        namespace: what `search` names: ``Var``, ``Code``, ``unify``, ``undo``, ``trail``, ``push``, ``choose``,
            ``may_match``.
    """
    source = "\n".join(_search(arity, indexed)) + "\n"
    found: Callable[..., Optional[Frame]] = codegen.shared_function(
        source, namespace, f"facts of {arity} arguments"
    )
    return found


def _search(arity: int, indexed: Optional[int]) -> List[str]:
    begin = ["def again(entry):", "    _, frame, clauses, at, end, generation, keys, mark = entry"]
    made = ["def made(frame, clauses, at, end, generation, keys):", "    mark = len(trail)"]
    tries = _tries(arity, indexed)
    return [*begin, *tries, 'retry = Code("facts", again)', *made, *_next("    "), *tries]


def _next(indent: str) -> List[str]:
    """Return the lines that go on to the next fact that is there and may match."""
    lines = [
        "while at < end:",
        "    other = clauses[at]",
        "    if other.died > generation and (keys is None or may_match(keys, other.keys)):",
        "        break",
        "    at += 1",
    ]
    return [indent + line for line in lines]


def _tries(arity: int, indexed: Optional[int]) -> List[str]:
    """Return the lines that try facts, from one on that may match."""
    lines = [
        f"    _, {''.join(f'a{at}, ' for at in range(arity))}after = frame",
        "    while at < end:",
        f"        _, {''.join(f'c{at}, ' for at in range(arity))[:-2]} = clauses[at].head",
        "        at += 1",
        *_next("        "),
    ]
    for at in range(arity):
        lines += _argument(at, at == indexed)
    return [
        *lines,
        "        if at < end:",
        "            choose((retry, frame, clauses, at, end, generation, keys, mark))",
        "        return after",
        "    return None",
    ]


def _argument(at: int, indexed: bool) -> List[str]:
    """Return the lines that unify argument ``at`` with the fact's."""
    lines = [
        f"        b = a{at}",
        f"        if b is not c{at}:",
        "            k = b.__class__",
        "            while k is Var:",
        "                r = b.ref",
        "                if r is None:",
        "                    break",
        "                b = r",
        "                k = r.__class__",
        "            if k is Var:",
        f"                b.ref = c{at}",
        "                push(b)",
        f"            elif b is not c{at} and not unify(b, c{at}, trail):",
        "                undo(trail, mark)",
        "                continue",
    ]
    if indexed:
        return [f"        if c{at}.__class__ is tuple:", *["    " + line for line in lines]]
    return lines
