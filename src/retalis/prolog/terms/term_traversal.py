"""How far walks over terms go.

Terms that contain themselves: found after many steps of a walk, so that others cost nothing more.

Walks over terms: variables, copies, keys.

Dictionary keys of terms: for shared variables, and for telling identical events.
"""

from typing import Any, Callable, Dict, Hashable, List, Optional, Sequence, Set, Tuple, overload

from ...foundation.cancellation import BULK, look
from ...foundation.errors import TermTooLarge
from .types import Atom, CompoundTerm, Lazy, String, Term, Var, deref

MAX_STEPS = 5_000_000
"""Steps after which walking a term is given up."""

ROUNDS = range(MAX_STEPS // len(BULK))
"""Rounds of `BULK` steps in a walk; after each there is a look at the limits of the goal that walks."""

MASK = len(BULK) - 1
"""Steps at which this is zero end a round."""


def check_steps(steps: int) -> None:
    """Look at the limits of the goal that walks; give up a walk of too many steps."""
    look()
    if steps > MAX_STEPS:
        raise TermTooLarge


LATE = 1 << 16
"""Steps of a walk after which it looks whether the term contains itself; as many parts are looked at, at most."""

LATE_ROUND = LATE // (MASK + 1) - 1
"""The round of a walk in which these steps are done."""


def contains_itself(term: Term) -> bool:
    """Tell whether a term contains itself; of a term with many parts only the first are looked at."""
    path: Set[int] = set()
    seen: Set[int] = set()
    stack: List[Any] = [term]
    while stack:
        item = stack.pop()
        if item.__class__ is int:  # all parts of the term of this identity are done
            path.discard(item)
            continue
        while item.__class__ is Var and item.ref is not None:
            item = item.ref
        if item.__class__ is not tuple:
            continue
        key = id(item)
        if key in path:
            return True
        if key in seen:
            continue
        if len(seen) + len(item) > LATE:
            return False
        seen.add(key)
        path.add(key)
        stack.append(key)
        for part in item:
            if part.__class__ is tuple or part.__class__ is Var:
                stack.append(part)
    return False


def refuse_cycles(term: Term) -> None:
    """Give up a walk over a term that contains itself, which would go on for ever.

    Raises:
        TermTooLarge: where it does.
    """
    if contains_itself(term):
        raise TermTooLarge


class MetPairs:
    """Pairs of compound terms that a walk over two terms has met: what holds for all others holds for them."""

    __slots__ = ("_met", "_steps")

    def __init__(self) -> None:
        self._met: Dict[Tuple[int, int], Tuple[Term, Term]] = {}
        """The terms are kept, because the identity of one that is gone may be that of another."""
        self._steps = 0

    def is_new(self, left: Term, right: Term) -> bool:
        """Tell whether a pair is met for the first time; of too many pairs this is no more known."""
        self._steps += 1
        if not self._steps & MASK:
            check_steps(self._steps)
        key = (id(left), id(right))
        if key in self._met:
            return False
        if len(self._met) < LATE:
            self._met[key] = (left, right)
        return True


def variables(term: Term) -> List[Var]:
    """Return the unbound variables of a term, each once, in the order they are met from left to right."""
    seen: Dict[Var, None] = {}
    stack: List[Term] = []
    item: Any = term
    for done in ROUNDS:
        for _ in BULK:
            kind = item.__class__
            if kind is Var:
                item = _follow(item)
                kind = item.__class__
                if kind is Var:
                    seen.setdefault(item)
            if kind is tuple and len(item) > 1:
                stack.extend(item[:1:-1])
                item = item[1]
                continue
            if not stack:
                return list(seen)
            item = stack.pop()
        look()
        if done == LATE_ROUND and contains_itself(term):
            return _variables_met([*stack, item], seen)
    raise TermTooLarge


def _variables_met(stack: List[Term], seen: Dict[Var, None]) -> List[Var]:
    """Go on with what is left of a term that contains itself: each part once."""
    met = MetPairs()
    while stack:
        item = _follow(stack.pop())
        if item.__class__ is Var:
            seen.setdefault(item)
        elif item.__class__ is tuple and met.is_new(item, item):
            stack.extend(item[:0:-1])
    return list(seen)


def positions(names: Sequence[Var]) -> Dict[Var, int]:
    """Return where each variable stands among others."""
    return {var: at for at, var in enumerate(names)}


def is_larger(term: Term, most: int) -> bool:
    """Tell whether the compounds of a term have more arguments than ``most``, all together."""
    size = 0
    stack = [term]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is tuple:
            size += len(item) - 1
            if size > most:
                return True
            stack.extend(item[1:])
    return False


def is_ground(term: Term) -> bool:
    """Tell whether a term has no unbound variable (a lazy term has none, and is not looked into)."""
    stack = [term]
    for done in ROUNDS:
        for _ in BULK:
            if not stack:
                return True
            item: Any = stack.pop()
            kind = item.__class__
            if kind is Var:
                item = _follow(item)
                kind = item.__class__
                if kind is Var:
                    return False
            if kind is tuple:
                if len(item) > MASK:
                    look(len(item))
                stack.extend(item[1:])
        look()
        if done == LATE_ROUND and contains_itself(term):
            return not _variables_met(stack, {})
    raise TermTooLarge


ATOMIC = frozenset((Atom, int, float, String))
"""Classes of terms that are constants, with nothing inside and no variable."""


def are_ground(values: Sequence[Term]) -> bool:
    """Tell whether terms have no variables, not even bound ones at their tops."""
    for value in values:
        kind = value.__class__
        if kind not in ATOMIC and (kind is Var or (kind is tuple and not is_ground(value))):
            return False
    return True


def is_plain(term: Term) -> bool:
    """Tell whether there is no variable in a term, bound or not: then it is as it is shown."""
    if term.__class__ is not tuple:
        return term.__class__ is not Var
    pending = [term]
    for done, compound in enumerate(pending, 1):
        if not done & MASK:
            check_steps(done)
            if done == LATE:
                refuse_cycles(term)
        for item in compound:
            kind = item.__class__
            if kind is tuple:
                pending.append(item)
            elif kind is Var:
                return False
    return True


def rebuild(  # noqa: C901 -- the loop of copying: a call for each argument would double its time
    term: Term, leaf: Callable[[Var], Term]
) -> Term:
    """Return ``term`` with bound variables followed and each unbound one replaced by ``leaf`` of it.

    Parts without variables are shared with ``term``, not copied; lazy terms are left as they are
    (a lazy term is ground).
    """
    if term.__class__ is Var:
        term = _follow(term)
        if term.__class__ is Var:
            return leaf(term)
    if term.__class__ is not tuple:
        return term
    # One entry for each compound term on the way down: the term, its arguments so far, changed or not.
    stack: List[List[Any]] = [[term, [term[0]], False]]
    steps = 0
    while True:
        entry = stack[-1]
        source, done, changed = entry
        at = len(done)
        size = len(source)
        if size > MASK and at == 1:
            look(size)
        while at < size:
            item: Any = source[at]
            kind = item.__class__
            if kind is Var:
                changed = True
                item = _follow(item)
                kind = item.__class__
                if kind is Var:
                    item = leaf(item)
                    kind = None
            if kind is tuple:
                entry[2] = changed
                stack.append([item, [item[0]], False])
                steps += 1
                if not steps & MASK:
                    _check_path(stack, steps)
                break
            done.append(item)
            at += 1
        else:
            result = tuple(done) if changed else source
            stack.pop()
            if not stack:
                return result
            parent = stack[-1]
            if result is not parent[0][len(parent[1])]:
                parent[2] = True
            parent[1].append(result)


def _check_path(stack: List[List[Any]], steps: int) -> None:
    """Raise an error where a term on the way down stands in itself, or there have been too many steps."""
    look()
    depth = len(stack)
    if steps > MAX_STEPS or (steps & (steps - 1) == 0 and len({id(entry[0]) for entry in stack}) < depth):
        raise TermTooLarge


def _follow(term: Term) -> Term:
    while term.__class__ is Var and term.ref is not None:
        term = term.ref
    return term


def resolve(term: Term) -> Term:
    """Return ``term`` with all bound variables replaced by what they stand for."""
    return term if is_plain(term) else rebuild(term, _same)


def _same(var: Var) -> Term:
    return var


_SMALL, _SHALLOW = 8, 3
"""Items of the largest compound term that is copied by `_small_copy`, and its depth."""


def _small_copy(  # noqa: C901 -- runs for each solution: a call to follow a variable would cost a tenth
    term: CompoundTerm, fresh: Dict[Var, Term], depth: int = _SHALLOW
) -> Optional[CompoundTerm]:
    """Return a copy of a small term, None where it is not small; see `copy`.

    Solutions are such terms mostly. `rebuild` copies all others, and takes three times as long for these.
    """
    if len(term) > _SMALL or not depth:
        return None
    items: Any = None
    at = -1
    for item in term:
        at += 1
        kind = item.__class__
        if kind is Var:
            while kind is Var:
                ref = item.ref
                if ref is None:
                    new = fresh.get(item)
                    item = fresh.setdefault(item, Var()) if new is None else new
                    break
                item = ref
                kind = item.__class__
            if kind is tuple:
                item = _small_copy(item, fresh, depth - 1)
                if item is None:
                    return None
        elif kind is tuple:
            part = _small_copy(item, fresh, depth - 1)
            if part is item:
                continue
            if part is None:
                return None
            item = part
        else:
            continue
        if items is None:
            items = list(term)
        items[at] = item
    return term if items is None else tuple(items)


@overload
def copy(term: CompoundTerm, fresh: Optional[Dict[Var, Term]] = None) -> CompoundTerm: ...


@overload
def copy(term: Term, fresh: Optional[Dict[Var, Term]] = None) -> Term: ...


def copy(term: Term, fresh: Optional[Dict[Var, Term]] = None) -> Term:
    """Return ``term`` with new variables for its unbound ones; ``fresh`` maps old to new, and is filled."""
    kind = term.__class__
    while kind is Var:
        ref: Any = term.ref  # type: ignore[union-attr]
        if ref is None:
            break
        term = ref
        kind = ref.__class__
    if kind is not tuple and kind is not Var:
        return term
    mapping: Dict[Var, Term] = {} if fresh is None else fresh
    if kind is tuple:
        small = _small_copy(term, mapping)  # type: ignore[arg-type]
        if small is not None:
            return small
    return _large_copy(term, mapping)


def _large_copy(term: Term, fresh: Dict[Var, Term]) -> Term:
    """Return a copy of a term of any size; see `copy`."""

    def renamed(var: Var) -> Term:
        new = fresh.get(var)
        if new is None:
            new = fresh[var] = Var()
        return new

    return rebuild(term, renamed)


def freeze(term: Term) -> Hashable:
    """Return a hashable key: equal for two ground terms exactly when they are the same term.

    Raises:
        ValueError: where the term has an unbound variable.
    """
    kind = term.__class__
    if kind is Atom or kind is int or kind is String:
        return term
    flat: List[Hashable] = []
    stack = [term]
    for done in ROUNDS:
        for _ in BULK:
            if not stack:
                return flat[0] if len(flat) == 1 else tuple(flat)
            item: Any = stack.pop()
            kind = item.__class__
            if kind is Var or kind is Lazy:
                item = deref(item)
                kind = item.__class__
            if kind is tuple:
                flat.append(item[0])
                stack.extend(item[:0:-1])
            elif kind is float:
                flat.append((float, item.hex()))
            elif kind is Var:
                raise ValueError("a key of a term with variables")
            else:
                flat.append(item)
        look()
        if done == LATE_ROUND:
            refuse_cycles(term)
    raise TermTooLarge


PLAIN = frozenset((Atom, int, String))
"""The classes of terms that are their own keys."""


def term_key(term: Term) -> Hashable:
    """Return a hashable key: equal for two terms exactly when they are variants of each other."""
    if term.__class__ in PLAIN:
        return term
    if term.__class__ is tuple:
        for item in term[1:]:
            if item.__class__ not in PLAIN:
                if item.__class__ is Var and item.ref is None:
                    return variant_key(term)
                break
        else:
            return term
    try:
        return freeze(term)
    except ValueError:
        return variant_key(term)


def variant_key(term: Term) -> Hashable:
    """Return the key of a term with variables: they count by the order in which they are met."""
    flat: List[Hashable] = [Var]
    numbers: Dict[Var, int] = {}
    stack = [term]
    for done in ROUNDS:
        for _ in BULK:
            if not stack:
                return tuple(flat)
            item: Any = deref(stack.pop())
            kind = item.__class__
            if kind is tuple:
                flat.append(item[0])
                stack.extend(item[:0:-1])
            elif kind is float:
                flat.append((float, item.hex()))
            elif kind is Var:
                flat.append((Var, numbers.setdefault(item, len(numbers))))
            else:
                flat.append(item)
        look()
        if done == LATE_ROUND:
            refuse_cycles(term)
    raise TermTooLarge
