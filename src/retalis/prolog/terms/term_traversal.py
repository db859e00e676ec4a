"""Traversal of terms: variables, groundness, copies, cycle detection and dictionary keys.

Every walk uses an explicit stack, so the depth of a term is not limited by Python's recursion limit. A walk is
divided into rounds (`STEPS_PER_ROUND`). After each round it calls `check_limits`, which counts the work as
inferences and raises if the goal has exceeded a limit, and `MAX_STEPS` bounds the walk as a whole.

Unification without occurs check can build cyclic terms (``X = f(X)``), on which a plain walk does not end. Checking
every term for cycles would double the cost of all walks, so a walk checks only after `CYCLE_CHECK_STEP` steps, which
few terms need. Unification, comparison and the search for variables then continue with `VisitedPairs`, which visits
each part once, as in the unification of rational trees (Colmerauer 1982). The other walks raise `TermTooLarge`.

Keys: `freeze` and `variant_key` flatten a term in prefix order into a tuple of functors and constants. The arity in
each functor makes the flat form unambiguous, so equal keys mean identical terms, or variants of each other. Keys are
used by shared variables of joins, by tables, and by the detection of duplicate events.
"""

from typing import Any, Callable, Dict, Hashable, List, Optional, Sequence, Set, Tuple, overload

from ...foundation.errors import TermTooLarge
from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits
from .types import Atom, CompoundTerm, Lazy, String, Term, Var, deref

MAX_STEPS = 5_000_000
"""Steps after which a walk over a term raises `TermTooLarge`."""

WALK_ROUNDS = range(MAX_STEPS // len(STEPS_PER_ROUND))
"""Rounds of a walk, each of ``len(STEPS_PER_ROUND)`` steps. After each round, the walk checks the limits of the goal
that runs it."""

STEP_MASK = len(STEPS_PER_ROUND) - 1
"""Bit mask of step counts: a round ends at each step whose masked count is zero."""


def check_steps(steps: int) -> None:
    """Check the limits of the running goal.

    Raises:
        TermTooLarge: if the walk has taken more than `MAX_STEPS` steps.
    """
    check_limits()
    if steps > MAX_STEPS:
        raise TermTooLarge


CYCLE_CHECK_STEP = 1 << 16
"""Steps after which a walk checks whether the term is cyclic, and the number of parts that the check visits at
most."""

CYCLE_CHECK_ROUND = CYCLE_CHECK_STEP // (STEP_MASK + 1) - 1
"""The round in which a walk reaches `CYCLE_CHECK_STEP` steps."""


def contains_itself(term: Term) -> bool:
    """Return whether a term is cyclic. Only the first `CYCLE_CHECK_STEP` parts of a large term are checked."""
    path: Set[int] = set()
    visited_ids: Set[int] = set()
    stack: List[Any] = [term]
    while stack:
        part = stack.pop()
        # An int on the stack is the identity of a term whose parts have all been visited: the depth-first search
        # leaves it. `path` holds the ancestors of the current part only; `visited_ids` alone would report
        # shared subterms.
        if part.__class__ is int:
            path.discard(part)
            continue
        while part.__class__ is Var and part.ref is not None:
            part = part.ref
        if part.__class__ is not tuple:
            continue
        key = id(part)
        if key in path:
            return True
        if key in visited_ids:
            continue
        if len(visited_ids) + len(part) > CYCLE_CHECK_STEP:
            return False
        visited_ids.add(key)
        path.add(key)
        stack.append(key)
        for argument in part:
            if argument.__class__ is tuple or argument.__class__ is Var:
                stack.append(argument)
    return False


def require_acyclic(term: Term) -> None:
    """Raise an error for a cyclic term, on which a walk would not end.

    Raises:
        TermTooLarge: if the term contains itself.
    """
    if contains_itself(term):
        raise TermTooLarge


class VisitedPairs:
    """Pairs of compound terms that a walk over two cyclic terms has visited; a pair is not compared twice."""

    __slots__ = ("_visited", "_steps")

    def __init__(self) -> None:
        # Keys are object identities. The values keep the terms alive: the identity of a deleted term may be reused
        # by another one, which would then count as visited.
        self._visited: Dict[Tuple[int, int], Tuple[Term, Term]] = {}
        self._steps = 0

    def is_new(self, left: Term, right: Term) -> bool:
        """Return whether a pair has not been visited yet; always true if `CYCLE_CHECK_STEP` pairs are recorded."""
        self._steps += 1
        if not self._steps & STEP_MASK:
            check_steps(self._steps)
        key = (id(left), id(right))
        if key in self._visited:
            return False
        if len(self._visited) < CYCLE_CHECK_STEP:
            self._visited[key] = (left, right)
        return True


def variables(term: Term) -> List[Var]:
    """Return the unbound variables of a term, each once, from left to right."""
    seen: Dict[Var, None] = {}
    stack: List[Term] = []
    item: Any = term
    for round_number in WALK_ROUNDS:
        for _ in STEPS_PER_ROUND:
            item_class = item.__class__
            if item_class is Var:
                item = _follow(item)
                item_class = item.__class__
                if item_class is Var:
                    seen.setdefault(item)
            if item_class is tuple and len(item) > 1:
                stack.extend(item[:1:-1])
                item = item[1]
                continue
            if not stack:
                return list(seen)
            item = stack.pop()
        check_limits()
        if round_number == CYCLE_CHECK_ROUND and contains_itself(term):
            return _variables_of_cyclic_term([*stack, item], seen)
    raise TermTooLarge


def _variables_of_cyclic_term(stack: List[Term], seen: Dict[Var, None]) -> List[Var]:
    """Continue the search for variables in a cyclic term: visit each part once."""
    visited = VisitedPairs()
    while stack:
        item = _follow(stack.pop())
        if item.__class__ is Var:
            seen.setdefault(item)
        elif item.__class__ is tuple and visited.is_new(item, item):
            stack.extend(item[:0:-1])
    return list(seen)


def positions(sequence: Sequence[Var]) -> Dict[Var, int]:
    """Return the position of each variable in a sequence."""
    return {var: position for position, var in enumerate(sequence)}


def is_larger(term: Term, limit: int) -> bool:
    """Return whether the compound terms within a term have more than ``limit`` arguments in total."""
    size = 0
    stack = [term]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is tuple:
            size += len(item) - 1
            if size > limit:
                return True
            stack.extend(item[1:])
    return False


def is_ground(term: Term) -> bool:
    """Return whether a term has no unbound variable. A lazy term is ground by definition and is not built.

    Bound variables are followed; see `has_no_variables` for a test that rejects them.
    """
    stack = [term]
    for round_number in WALK_ROUNDS:
        for _ in STEPS_PER_ROUND:
            if not stack:
                return True
            item: Any = stack.pop()
            item_class = item.__class__
            if item_class is Var:
                item = _follow(item)
                item_class = item.__class__
                if item_class is Var:
                    return False
            if item_class is tuple:
                # One step may push a whole argument list: a wide term counts by its arguments, not as one step.
                if len(item) > STEP_MASK:
                    check_limits(len(item))
                stack.extend(item[1:])
        check_limits()
        if round_number == CYCLE_CHECK_ROUND and contains_itself(term):
            return not _variables_of_cyclic_term(stack, {})
    raise TermTooLarge


ATOMIC = frozenset((Atom, int, float, String))
"""Classes of constants: they have no parts and no variables."""


def are_ground(values: Sequence[Term]) -> bool:
    """Return whether terms have no variables; a bound variable at the top of a term counts as one."""
    for value in values:
        value_class = value.__class__
        if value_class not in ATOMIC and (
            value_class is Var or (value_class is tuple and not is_ground(value))
        ):
            return False
    return True


def has_no_variables(term: Term) -> bool:
    """Return whether a term has no variable at all, bound or unbound, so that it need not be resolved."""
    if term.__class__ is not tuple:
        return term.__class__ is not Var
    pending = [term]
    for count, compound in enumerate(pending, 1):
        if not count & STEP_MASK:
            check_steps(count)
            if count == CYCLE_CHECK_STEP:
                require_acyclic(term)
        for item in compound:
            item_class = item.__class__
            if item_class is tuple:
                pending.append(item)
            elif item_class is Var:
                return False
    return True


def rebuild(  # noqa: C901 -- the loop of copying: a call for each argument would double its time
    term: Term, replace_variable: Callable[[Var], Term]
) -> Term:
    """Return ``term`` with bound variables replaced by their values and each unbound one by
    ``replace_variable(variable)``.

    Parts without variables are shared with ``term``, not copied. Lazy terms are kept unbuilt, because they are
    ground.
    """
    if term.__class__ is Var:
        term = _follow(term)
        if term.__class__ is Var:
            return replace_variable(term)
    if term.__class__ is not tuple:
        return term
    # One entry for each compound term on the path from the root: the term, the arguments that are finished, and
    # whether any of them differs from the original. Only changed terms are allocated anew. Entries are lists and not
    # objects, because copying is the most frequent walk.
    stack: List[List[Any]] = [[term, [term[0]], False]]
    steps = 0
    while True:
        entry = stack[-1]
        source, arguments, changed = entry
        position = len(arguments)
        size = len(source)
        if size > STEP_MASK and position == 1:
            check_limits(size)
        while position < size:
            item: Any = source[position]
            item_class = item.__class__
            if item_class is Var:
                changed = True
                item = _follow(item)
                item_class = item.__class__
                if item_class is Var:
                    item = replace_variable(item)
                    item_class = None
            if item_class is tuple:
                entry[2] = changed
                stack.append([item, [item[0]], False])
                steps += 1
                if not steps & STEP_MASK:
                    _check_path(stack, steps)
                break
            arguments.append(item)
            position += 1
        else:
            result = tuple(arguments) if changed else source
            stack.pop()
            if not stack:
                return result
            parent = stack[-1]
            if result is not parent[0][len(parent[1])]:
                parent[2] = True
            parent[1].append(result)


def _check_path(stack: List[List[Any]], steps: int) -> None:
    """Raise an error if a term on the path from the root contains itself, or if the walk is too long."""
    check_limits()
    depth = len(stack)
    # The path is compared at powers of two only, so that a deep term costs linear time in total. A cycle makes the
    # path grow for ever and is found at the next power of two.
    if steps > MAX_STEPS or (steps & (steps - 1) == 0 and len({id(entry[0]) for entry in stack}) < depth):
        raise TermTooLarge


def _follow(term: Term) -> Term:
    """Return the value of a bound variable; unlike `deref`, without building a lazy term."""
    while term.__class__ is Var and term.ref is not None:
        term = term.ref
    return term


def resolve(term: Term) -> Term:
    """Return ``term`` with all bound variables replaced by their values."""
    return term if has_no_variables(term) else rebuild(term, _keep_variable)


def _keep_variable(var: Var) -> Term:
    return var


_MAX_SMALL_ITEMS, _MAX_SMALL_DEPTH = 8, 3
"""Limits of `_small_copy`: items of a compound term, functor included, and nesting depth."""


def _small_copy(  # noqa: C901 -- runs for each solution: a call to follow a variable would cost a tenth
    term: CompoundTerm, fresh: Dict[Var, Term], depth: int = _MAX_SMALL_DEPTH
) -> Optional[CompoundTerm]:
    """Return a copy of a small term, or None if it exceeds the limits; see `copy`.

    Most solutions are small terms, for which `rebuild` takes three times as long.
    """
    # Recursion is safe here only because the depth is bounded. None makes the caller use `rebuild` for the whole
    # term; `fresh` then contains some variables already, which is why both use the same mapping.
    if len(term) > _MAX_SMALL_ITEMS or not depth:
        return None
    items: Any = None
    position = -1
    for item in term:
        position += 1
        item_class = item.__class__
        if item_class is Var:
            while item_class is Var:
                ref = item.ref
                if ref is None:
                    new = fresh.get(item)
                    item = fresh.setdefault(item, Var()) if new is None else new
                    break
                item = ref
                item_class = item.__class__
            if item_class is tuple:
                item = _small_copy(item, fresh, depth - 1)
                if item is None:
                    return None
        elif item_class is tuple:
            copied = _small_copy(item, fresh, depth - 1)
            if copied is item:
                continue
            if copied is None:
                return None
            item = copied
        else:
            continue
        if items is None:
            items = list(term)
        items[position] = item
    return term if items is None else tuple(items)


@overload
def copy(term: CompoundTerm, fresh: Optional[Dict[Var, Term]] = None) -> CompoundTerm: ...


@overload
def copy(term: Term, fresh: Optional[Dict[Var, Term]] = None) -> Term: ...


def copy(term: Term, fresh: Optional[Dict[Var, Term]] = None) -> Term:
    """Return ``term`` with new variables for its unbound ones; ``fresh`` maps old to new ones, and is extended."""
    term_class = term.__class__
    while term_class is Var:
        ref: Any = term.ref  # type: ignore[union-attr]
        if ref is None:
            break
        term = ref
        term_class = ref.__class__
    if term_class is not tuple and term_class is not Var:
        return term
    mapping: Dict[Var, Term] = {} if fresh is None else fresh
    if term_class is tuple:
        small = _small_copy(term, mapping)  # type: ignore[arg-type]
        if small is not None:
            return small
    return _large_copy(term, mapping)


def _large_copy(term: Term, fresh: Dict[Var, Term]) -> Term:
    """Return a copy of a term of any size; see `copy`."""

    def rename(var: Var) -> Term:
        new = fresh.get(var)
        if new is None:
            new = fresh[var] = Var()
        return new

    return rebuild(term, rename)


def freeze(term: Term) -> Hashable:
    """Return a hashable key of a ground term. Two keys are equal if and only if the terms are identical.

    Raises:
        ValueError: if the term has an unbound variable.
    """
    term_class = term.__class__
    if term_class is Atom or term_class is int or term_class is String:
        return term
    flat: List[Hashable] = []
    stack = [term]
    for round_number in WALK_ROUNDS:
        for _ in STEPS_PER_ROUND:
            if not stack:
                return flat[0] if len(flat) == 1 else tuple(flat)
            item: Any = stack.pop()
            term_class = item.__class__
            # A lazy term is built here: its key must equal that of the same term built elsewhere.
            if term_class is Var or term_class is Lazy:
                item = deref(item)
                term_class = item.__class__
            if term_class is tuple:
                flat.append(item[0])
                stack.extend(item[:0:-1])
            elif term_class is float:
                # In Python 1 == 1.0, 0.0 == -0.0, and nan differs from itself; as terms it is the reverse.
                flat.append((float, item.hex()))
            elif term_class is Var:
                raise ValueError("a key of a term with variables")
            else:
                flat.append(item)
        check_limits()
        if round_number == CYCLE_CHECK_ROUND:
            require_acyclic(term)
    raise TermTooLarge


SELF_KEYED = frozenset((Atom, int, String))
"""Classes of terms that are their own keys."""


def term_key(term: Term) -> Hashable:
    """Return a hashable key of any term. Two keys are equal if and only if the terms are variants of each other."""
    if term.__class__ in SELF_KEYED:
        return term
    if term.__class__ is tuple:
        for item in term[1:]:
            if item.__class__ not in SELF_KEYED:
                if item.__class__ is Var and item.ref is None:
                    return variant_key(term)
                break
        else:
            return term  # a tuple of atoms, integers and strings is its own key; most messages' fields are like that
    try:
        return freeze(term)
    except ValueError:
        return variant_key(term)


def variant_key(term: Term) -> Hashable:
    """Return the key of a term with variables, which are numbered in the order of their first occurrence."""
    # The class `Var` at the front separates these keys from those of ground terms, which begin with a functor.
    flat: List[Hashable] = [Var]
    numbers: Dict[Var, int] = {}
    stack = [term]
    for round_number in WALK_ROUNDS:
        for _ in STEPS_PER_ROUND:
            if not stack:
                return tuple(flat)
            item: Any = deref(stack.pop())
            item_class = item.__class__
            if item_class is tuple:
                flat.append(item[0])
                stack.extend(item[:0:-1])
            elif item_class is float:
                flat.append((float, item.hex()))
            elif item_class is Var:
                flat.append((Var, numbers.setdefault(item, len(numbers))))
            else:
                flat.append(item)
        check_limits()
        if round_number == CYCLE_CHECK_ROUND:
            require_acyclic(term)
    raise TermTooLarge
