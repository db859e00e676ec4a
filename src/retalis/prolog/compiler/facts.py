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
        namespace: what `search` names: ``Var``, ``unify``, ``trail``, ``choose``, ``retry``, ``may_match``.
    """
    source = "\n".join(_search(arity, indexed)) + "\n"
    found: Callable[..., Optional[Frame]] = codegen.shared_function(
        source, namespace, f"facts of {arity} arguments"
    )
    return found


def _search(arity: int, indexed: Optional[int]) -> List[str]:
    args = "".join(f"a{at}, " for at in range(arity))
    lines = [
        "def made(frame, clauses, at, end, generation, keys):",
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
    return [
        *lines,
        "        while at < end:",
        "            other = clauses[at]",
        "            if other.died > generation and (keys is None or may_match(keys, other.keys)):",
        "                choose((retry, made, frame, clauses, at, end, generation, keys, mark))",
        "                break",
        "            at += 1",
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
