"""Terms: what programs, events and messages are made of.

A term is one of

* an `Atom` (interned: compare with ``is``),
* an ``int`` or a ``float`` (never a ``bool``),
* a `String`,
* a `Var`,
* a compound term: a plain ``tuple`` whose first item is its interned `Functor`, the rest its arguments,
* a `Lazy` term, which becomes one of the above when something looks at it.

Plain tuples, because nothing else in Python is built and taken apart as fast, and most of an engine's
time goes there. Compound terms are immutable; ground ones are shared and never copied.

Everything here works without recursion: a list of a million elements is as safe as one of three. Unification
does not look for cycles, so a program can make a term that contains itself; walking one raises `TermTooLarge`
after `MOST` steps, instead of going on for ever.
"""

from _weakref import _remove_dead_weakref  # type: ignore[attr-defined]
from itertools import count
from typing import Any, Callable, Dict, Iterable, Iterator, List, Optional, Tuple
from weakref import ref

from .errors import TermTooLarge
from .watching import BULK, look

Term = Any
"""The union above; Python's type system has no cheap name for it."""


MOST = 5_000_000
"""Steps after which walking a term is given up."""

ROUNDS = (None,) * (MOST // len(BULK))
"""Rounds of `BULK` steps in a walk; after each there is a look at the limits of the goal that walks."""


_MASK = len(BULK) - 1


class Atom:
    """A constant; made by `atom`, which gives the same object for the same name.

    ``functor`` is the `Functor` of the name and arity 0, made when it is asked for.
    """

    __slots__ = ("name", "functor", "__weakref__")

    name: str
    functor: "Functor"

    def __getattr__(self, attribute: str) -> "Functor":
        if attribute != "functor":
            raise AttributeError(attribute)
        made = self.functor = functor(self.name, 0)
        return made

    def __repr__(self) -> str:
        return f"atom({self.name!r})"

    def __reduce__(self) -> Tuple[Any, ...]:
        return atom, (self.name,)


class Functor:
    """Name and arity of a compound term; made by `functor`, one object for each pair.

    Call it to build a term: ``functor("point", 2)(1, 2)``.
    """

    __slots__ = ("name", "arity")

    name: str
    arity: int

    def __call__(self, *args: Term) -> Term:
        """Return the compound term with these arguments (as many as the arity says)."""
        return (self, *args)

    def __repr__(self) -> str:
        return f"functor({self.name!r}, {self.arity})"

    def __str__(self) -> str:
        return f"{self.name}/{self.arity}"

    def __reduce__(self) -> Tuple[Any, ...]:
        return functor, (self.name, self.arity)


class String:
    """A Prolog string: text that is no atom. Equal strings are equal terms."""

    __slots__ = ("text",)

    def __init__(self, text: str):
        self.text = text

    def __eq__(self, other: object) -> bool:
        return other.__class__ is String and other.text == self.text  # type: ignore[attr-defined]

    def __hash__(self) -> int:
        return hash((String, self.text))

    def __repr__(self) -> str:
        return f"String({self.text!r})"


class Var:
    """A logic variable: ``ref`` is None while it is unbound, the term it stands for afterwards."""

    __slots__ = ("ref", "serial")

    ref: Term
    serial: int

    def __init__(self) -> None:
        self.ref = None

    def __repr__(self) -> str:
        return f"Var(_G{serial(self)})" if self.ref is None else f"Var({self.ref!r})"


class Lazy:
    """A term that is made when it is looked at, once; its functor is known before.

    Attributes:
        functor: the `Functor` that the term will have; of the empty name and arity 0 where the term will be
            an atom whose name is not known yet.
        make: called with ``source`` to make the term.
    """

    __slots__ = ("functor", "make", "source", "made")

    def __init__(self, functor: Functor, make: Callable[[Any], Term], source: Any):
        self.functor = functor
        self.make = make
        self.source = source
        self.made: Term = None

    def term(self) -> Term:
        """Return the compound term (its arguments may be lazy in turn)."""
        made = self.made
        if made is None:
            made = self.made = self.make(self.source)
            self.source = None
        return made

    def __repr__(self) -> str:
        return f"Lazy({self.functor})"


class _AtomRef(ref):  # type: ignore[type-arg]
    """The table's reference to an atom: it goes when the last term with the atom goes."""

    __slots__ = ("name",)

    name: str


_atoms: Dict[str, _AtomRef] = {}
_functors: Dict[Tuple[str, int], Functor] = {}
_serials = count(1)


def functor(name: str, arity: int) -> Functor:
    """Return the one `Functor` of this name and arity."""
    found = _functors.get((name, arity))
    if found is None:
        made = Functor()
        made.name = name
        made.arity = arity
        found = _functors.setdefault((name, arity), made)
    return found


def atom(name: str) -> Atom:
    """Return the one `Atom` of this name.

    Atoms that no term holds any more are forgotten: texts of messages do not pile up.
    """
    try:
        found: Optional[Atom] = _atoms[name]()
    except KeyError:
        return _new_atom(name)
    return found or _new_atom(name)


def _new_atom(name: str) -> Atom:
    """Put an atom into the table, or return the one that got there first; no lock, each step is one."""
    made = Atom()
    made.name = name
    reference = _AtomRef(made, _forget)
    reference.name = name
    while True:
        known = _atoms.setdefault(name, reference)
        if known is reference:
            return made
        found: Optional[Atom] = known()
        if found is not None:
            return found
        _remove_dead_weakref(_atoms, name)


def _forget(reference: _AtomRef) -> None:
    _remove_dead_weakref(_atoms, reference.name)


def serial(var: Var) -> int:
    """Return the number of a variable: it names it in output and orders it; given out at first need."""
    try:
        return var.serial
    except AttributeError:
        var.serial = next(_serials)
        return var.serial


NIL = atom("[]")
TRUE = atom("true")
FALSE = atom("false")
EMPTY_BLOCK = atom("{}")
CONS = functor("[|]", 2)
COMMA = functor(",", 2)
MINUS = functor("-", 2)
SLASH = functor("/", 2)
COLON = functor(":", 2)


def deref(term: Term) -> Term:
    """Follow bound variables and make a lazy term: the result is neither, or an unbound variable."""
    while True:
        kind = term.__class__
        if kind is Var:
            ref = term.ref
            if ref is None:
                return term
            term = ref
        elif kind is Lazy:
            term = term.term()
        else:
            return term


def make_list(items: Iterable[Term], tail: Term = NIL) -> Term:
    """Return the Prolog list of ``items``."""
    left = list(items)
    while len(left) > len(BULK):
        for item in reversed(left[-len(BULK) :]):
            tail = (CONS, item, tail)
        del left[-len(BULK) :]
        look()
    for item in reversed(left):
        tail = (CONS, item, tail)
    return tail


def list_items(term: Term) -> Optional[List[Term]]:
    """Return the items of a proper list, or None where ``term`` is none (partial lists included)."""
    items, tail = list_parts(term)
    return items if tail is NIL else None


def list_parts(term: Term) -> Tuple[List[Term], Term]:
    """Return the items of a list, proper or partial, and its tail."""
    items: List[Term] = []
    term = deref(term)
    for _ in ROUNDS:
        for _ in BULK:
            if term.__class__ is not tuple or term[0] is not CONS:
                return items, term
            items.append(term[1])
            term = term[2]
            if term.__class__ is not tuple:
                term = deref(term)
        look()
    raise TermTooLarge


def conjuncts(term: Term) -> Iterator[Term]:
    """Yield the goals of a conjunction from left to right."""
    stack = [term]
    for _ in ROUNDS:
        for _ in BULK:
            if not stack:
                return
            goal = deref(stack.pop())
            if goal.__class__ is tuple and goal[0] is COMMA:
                stack += (goal[2], goal[1])
            else:
                yield goal
        look()
    raise TermTooLarge


def conjunction(goals: Iterable[Term]) -> Term:
    """Return the goals as one goal; ``true`` for none."""
    goals = list(goals)
    if not goals:
        return TRUE
    result = goals[-1]
    for goal in reversed(goals[:-1]):
        result = (COMMA, goal, result)
    return result


def variables(term: Term) -> List[Var]:
    """Return the unbound variables of a term, each once, in the order they are met from left to right."""
    seen: Dict[Var, None] = {}
    stack = [term]
    for _ in ROUNDS:
        for _ in BULK:
            if not stack:
                return list(seen)
            item = stack.pop()
            kind = item.__class__
            if kind is Var:
                item = _follow(item)
                kind = item.__class__
                if kind is Var:
                    seen.setdefault(item)
                    continue
            if kind is tuple:
                stack.extend(item[:0:-1])
        look()
    raise TermTooLarge


def is_ground(term: Term) -> bool:
    """Tell whether a term has no unbound variable (a lazy term has none, and is not looked into)."""
    stack = [term]
    for _ in ROUNDS:
        for _ in BULK:
            if not stack:
                return True
            item = stack.pop()
            kind = item.__class__
            if kind is Var:
                item = _follow(item)
                kind = item.__class__
                if kind is Var:
                    return False
            if kind is tuple:
                stack.extend(item[1:])
        look()
    raise TermTooLarge


def is_plain(term: Term) -> bool:
    """Tell whether there is no variable in a term, bound or not: then it is as it is shown."""
    if term.__class__ is not tuple:
        return term.__class__ is not Var
    pending = [term]
    for done, compound in enumerate(pending, 1):
        if not done & _MASK:
            _check_steps(done)
        for item in compound:
            kind = item.__class__
            if kind is tuple:
                pending.append(item)
            elif kind is Var:
                return False
    return True


def rebuild(term: Term, leaf: Callable[[Var], Term]) -> Term:
    """Return ``term`` with bound variables followed and each unbound one replaced by ``leaf`` of it.

    Parts without variables are shared with ``term``, not copied; lazy terms are left as they are
    (a lazy term is ground).
    """
    kind = term.__class__
    if kind is Var:
        term = _follow(term)
        kind = term.__class__
        if kind is Var:
            return leaf(term)
    if kind is not tuple:
        return term
    # One entry for each compound term on the way down: the term, its arguments so far, changed or not.
    stack: List[List[Any]] = [[term, [term[0]], False]]
    steps = 0
    while True:
        entry = stack[-1]
        source, done, changed = entry
        at = len(done)
        size = len(source)
        while at < size:
            item = source[at]
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
                if not steps & _MASK:
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
    if steps > MOST or (steps & (steps - 1) == 0 and len({id(entry[0]) for entry in stack}) < depth):
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


def copy(term: Term, fresh: Optional[Dict[Var, Term]] = None) -> Term:
    """Return ``term`` with new variables for its unbound ones; ``fresh`` maps old to new, and is filled."""
    mapping: Dict[Var, Term] = {} if fresh is None else fresh

    def renamed(var: Var) -> Term:
        new = mapping.get(var)
        if new is None:
            new = mapping[var] = Var()
        return new

    return rebuild(term, renamed)


def unify(left: Term, right: Term, trail: List[Any]) -> bool:
    """Make two terms equal by binding variables; each bound variable is pushed on ``trail``.

    Returns False where they do not unify; then some variables may be bound, and the caller undoes the trail.
    """
    stack: List[Term] = []
    steps = 0
    while True:
        if left is not right:
            kind = left.__class__
            while kind is Var:
                ref = left.ref
                if ref is None:
                    break
                left = ref
                kind = ref.__class__
            other = right.__class__
            while other is Var:
                ref = right.ref
                if ref is None:
                    break
                right = ref
                other = ref.__class__
            if left is right:
                pass
            elif kind is Var:
                left.ref = right  # a lazy term stays lazy
                trail.append(left)
            elif other is Var:
                right.ref = left
                trail.append(right)
            else:
                if kind is Lazy:
                    left = left.term()
                    kind = left.__class__
                if other is Lazy:
                    right = right.term()
                    other = right.__class__
                if kind is not other:
                    return False
                if kind is tuple:
                    if left[0] is not right[0]:
                        return False
                    size = len(left)
                    if size > 1:
                        steps += 1
                        if not steps & _MASK:
                            _check_steps(steps)
                        for at in range(size - 1, 1, -1):
                            stack.append(right[at])
                            stack.append(left[at])
                        left = left[1]
                        right = right[1]
                        continue
                elif left is not right and (kind is Atom or not same_constant(left, right)):
                    return False
        if not stack:
            return True
        left = stack.pop()
        right = stack.pop()


def _check_steps(steps: int) -> None:
    look()
    if steps > MOST:
        raise TermTooLarge


def same_constant(left: Term, right: Term) -> bool:
    """Tell whether two constants of one class are the same term (``nan`` is itself; 0.0 is not -0.0)."""
    if left.__class__ is float:
        return left.hex() == right.hex()
    return bool(left == right)


def undo(trail: List[Any], length: int) -> None:
    """Unbind what was bound since ``trail`` had this length, newest first."""
    while len(trail) > length:
        trail.pop().ref = None


def freeze(term: Term) -> Any:
    """Return a hashable key: equal for two ground terms exactly when they are the same term.

    Raises:
        ValueError: where the term has an unbound variable.
    """
    kind = term.__class__
    if kind is Atom or kind is int or kind is String:
        return term
    flat: List[Any] = []
    stack = [term]
    for _ in ROUNDS:
        for _ in BULK:
            if not stack:
                return flat[0] if len(flat) == 1 else tuple(flat)
            item = stack.pop()
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
    raise TermTooLarge


_RANK = {Var: 0, float: 1, int: 1, String: 3, Atom: 4, tuple: 5}


def compare(left: Term, right: Term) -> int:
    """Compare in the standard order of terms: -1, 0 or 1.

    Variables by age, then numbers by value (a float before an integer of the same value), strings and
    atoms alphabetically, compound terms by arity, name and arguments.
    """
    stack = [right, left]
    for _ in ROUNDS:
        for _ in BULK:
            if not stack:
                return 0
            left = stack.pop()
            right = stack.pop()
            if left is right:
                continue
            left = deref(left)
            right = deref(right)
            if left is right:
                continue
            kind = left.__class__
            rank, other = _RANK[kind], _RANK[right.__class__]
            if rank != other:
                return -1 if rank < other else 1
            if rank == 5:
                if len(left) != len(right):
                    return -1 if len(left) < len(right) else 1
                if left[0] is not right[0]:
                    return -1 if left[0].name < right[0].name else 1
                for at in range(len(left) - 1, 0, -1):
                    stack.append(right[at])
                    stack.append(left[at])
                continue
            result = _compare_constants(left, right)
            if result:
                return result
        look()
    raise TermTooLarge


def _compare_constants(left: Term, right: Term) -> int:
    kind = left.__class__
    if kind is Var:
        return -1 if serial(left) < serial(right) else 1
    if kind is Atom:
        return -1 if left.name < right.name else 1
    if kind is String:
        return (left.text > right.text) - (left.text < right.text)
    if left < right:
        return -1
    if left > right:
        return 1
    if kind is right.__class__:
        return _compare_same_floats(left, right) if kind is float else 0
    if left != left or right != right:  # nan comes before all other numbers
        return -1 if left != left else 1
    return -1 if kind is float else 1


def _compare_same_floats(left: float, right: float) -> int:
    """Order two floats that are neither less nor greater: nan first, then -0.0 before 0.0."""
    one, two = (left == left, left.hex()), (right == right, right.hex())
    if one == two:
        return 0
    if one[0] != two[0]:
        return -1 if not one[0] else 1
    return -1 if one[1] == "-0x0.0p+0" else 1
