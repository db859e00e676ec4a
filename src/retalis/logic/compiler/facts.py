"""Code that looks for a matching fact among many: one function for each arity and indexed argument."""

from functools import lru_cache
from types import CodeType
from typing import Any, Callable, Dict, List, Optional


def fact_search(arity: int, indexed: Optional[int], namespace: Dict[str, Any]) -> Callable[..., Any]:
    """Return ``search(frame, clauses, at, end, generation, keys)``, which tries ground facts in order.

    It returns the frame to go on with, after pushing a choice point where another fact may match.

    Args:
        arity: of the predicate.
        indexed: the argument (from 0) that the index has compared already: facts agree in its first level.
        namespace: what `search` names: ``Var``, ``unify``, ``trail``, ``choose``, ``retry``, ``may_match``.
    """
    names = dict(namespace)
    exec(_code(arity, indexed), names)
    search: Callable[..., Any] = names["search"]
    return search


@lru_cache(maxsize=64)
def _code(arity: int, indexed: Optional[int]) -> CodeType:
    args = "".join(f"a{at}, " for at in range(arity))
    lines = [
        "def search(frame, clauses, at, end, generation, keys):",
        f"    _, {args}after = frame",
        "    mark = len(trail)",
        "    while at < end:",
        "        clause = clauses[at]",
        "        at += 1",
        "        if clause.died <= generation or keys is not None and not may_match(keys, clause.keys):",
        "            continue",
        f"        _, {''.join(f'c{at}, ' for at in range(arity))[:-2]} = clause.head",
    ]
    for at in range(arity):
        lines += _argument(at, at == indexed)
    lines += [
        "        while at < end:",
        "            other = clauses[at]",
        "            if other.died > generation and (keys is None or may_match(keys, other.keys)):",
        "                choose((retry, search, frame, clauses, at, end, generation, keys, mark))",
        "                break",
        "            at += 1",
        "        return after",
        "    return None",
    ]
    return compile("\n".join(lines), f"<facts of {arity} arguments>", "exec")


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
