"""Terms as JSON, for those who ask from outside."""

import json
import math
from typing import Dict, List, Union

from ...foundation import BULK, UsageError, look
from ..syntax import writeq
from ..terms import CONS, FALSE, NIL, TRUE, Atom, CompoundTerm, String, Term, Var, deref, list_items

_MASK = len(BULK) - 1


class _ReadyText(str):
    """On the stack of `to_json`: text that is written as it is."""

    __slots__ = ()


def to_json(term: Term, names: Dict[Var, str], most: int) -> str:
    """Return a term as JSON.

    ========================  ==========================================
    term                      JSON
    ========================  ==========================================
    integer, float            number; ``"nan"``, ``"inf"``, ``"-inf"``
    ``true``, ``false``       true, false
    atom, string              string
    list                      array
    compound term             ``{"functor": "f", "args": [...]}``
    variable                  ``{"variable": "_1"}``
    ========================  ==========================================

    Args:
        term: the term.
        names: of variables; those that it lacks are added.
        most: characters that it may have.

    Raises:
        UsageError: where it is longer.
    """
    written: List[str] = []
    stack: List[Union[Term, _ReadyText]] = [term]
    length = steps = 0
    while stack:
        steps += 1
        if not steps & _MASK:
            look()
        top = stack.pop()
        if isinstance(top, _ReadyText):
            text: str = top
        else:
            item = deref(top)
            if item.__class__ is tuple:
                if length + len(stack) > most:
                    raise _too_long(most)
                stack.extend(_parts(item, most))
                continue
            text = _constant(item, names, most)
        length += len(text)
        if length > most:
            raise _too_long(most)
        written.append(text)
    return "".join(written)


def _too_long(most: int) -> UsageError:
    """Return the error of a solution that is too long to be answered."""
    return UsageError(f"a solution has more than {most} characters")


def _parts(item: CompoundTerm, most: int) -> List[Union[Term, _ReadyText]]:
    """Return what is to be written of a list or compound term, the last first."""
    items = list_items(item) if item[0] is CONS else None
    parts = list(item[1:]) if items is None else items
    if len(parts) > most:
        raise _too_long(most)
    found: List[Union[Term, _ReadyText]] = [_ReadyText("]" if items is not None else "]}")]
    for at, part in enumerate(reversed(parts)):
        if at:
            found.append(_ReadyText(", "))
        found.append(part)
    functor = "" if items is not None else f'{{"functor": {json.dumps(item[0].name)}, "args": '
    found.append(_ReadyText(f"{functor}["))
    return found


def _constant(item: Term, names: Dict[Var, str], most: int) -> str:
    if isinstance(item, Var):
        return json.dumps({"variable": names.setdefault(item, f"_{len(names) + 1}")})
    if item is TRUE or item is FALSE:
        return "true" if item is TRUE else "false"
    if item is NIL:
        return "[]"
    if isinstance(item, (Atom, String)):
        text = item.name if isinstance(item, Atom) else item.text
        if len(text) > most:
            raise _too_long(most)
        return json.dumps(text, ensure_ascii=False)
    if isinstance(item, float) and not math.isfinite(item):
        return f'"{item}"'
    if isinstance(item, int) and item.bit_length() > 4 * most:
        raise _too_long(most)
    return writeq(item)
