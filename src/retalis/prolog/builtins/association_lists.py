"""Association lists: AVL trees of terms ``t(Key, Value, Balance, Left, Right)``, empty: ``t``.

``Balance`` names the deeper side: ``<`` the left one, ``>`` the right one, ``-`` none. Look-up, insertion and
deletion descend the tree by the standard order of the keys; insertion and deletion rebuild the nodes of that path.
The other predicates are in the library (library/assoc.pl).
"""

from typing import Any, Callable, List, Optional, Tuple

from ...foundation.cancellation import BULK, look, watched
from ...foundation.errors import TermTooLarge
from ..machine.errors import instantiation_error, no_matching_rule, type_error
from ..terms.term_traversal import ROUNDS
from ..terms.types import CONS, MINUS, NIL, CompoundTerm, Functor, Term, Var, atom, deref, functor
from ..terms.unification import compare, unify
from .argument_checks import items
from .builtin_registry import Machine, deterministic
from .list_predicates import bounded

_NODE, _EMPTY = functor("t", 5), atom("t")
_LEFT, _EVEN, _RIGHT = atom("<"), atom("-"), atom(">")
_INSERT, _DELETE = functor("insert", 5), functor("delete", 5)
_AFTER_DOUBLE_ROTATION = {_EVEN: (_EVEN, _EVEN), _LEFT: (_EVEN, _RIGHT), _RIGHT: (_LEFT, _EVEN)}
"""Balances of the left and the right node after a double rotation, by the balance of the node that goes up."""


_Path = List[Tuple[CompoundTerm, int]]
"""Nodes from the top of a tree, each with -1 or 1 for the side in which the path goes on."""

_Balance = Callable[[CompoundTerm, Any, int], Optional[Tuple[CompoundTerm, bool]]]


def _order(key: Any, other: Any) -> int:
    """Compare two keys; integers, which most keys are, without a call of `compare`."""
    if key.__class__ is int and other.__class__ is int:
        return (key > other) - (key < other)
    return compare(key, other)


def _is_node(term: Term) -> bool:
    """Tell whether a dereferenced term is a tree with a key."""
    return term.__class__ is tuple and term[0] is _NODE


def _is_balance(term: Term) -> bool:
    """Tell whether a dereferenced term is a balance: no term is hashed, whose depth can be any."""
    return term is _EVEN or term is _LEFT or term is _RIGHT


@deterministic("get_assoc/3", locked=False)
def get_assoc(machine: Machine, key: Term, tree: Term, value: Term) -> bool:
    """Look a key up."""
    key = deref(key)
    node: Any = deref(tree)
    if node.__class__ is Var:
        raise instantiation_error()
    if node is not _EMPTY and (node.__class__ is not tuple or node[0] is not _NODE):
        raise type_error("btree", node)
    for _ in bounded():
        if node.__class__ is not tuple or node[0] is not _NODE:
            return False
        other = node[1]
        # As `_order`, without its call: most keys are integers or atoms.
        if key.__class__ is int and other.__class__ is int:
            order = -1 if key < other else key > other
        else:
            order = 0 if key is other else compare(key, other)
        if not order:
            return unify(value, node[2], machine.trail)
        node = node[4] if order < 0 else node[5]
        if node.__class__ is not tuple:
            node = deref(node)
    return False


@deterministic("put_assoc/4", locked=False)
def put_assoc(machine: Machine, key: Term, tree: Term, value: Term, result: Term) -> bool:
    """Insert a key or replace its value."""
    key = deref(key)
    path, node = _path_to(key, tree, _INSERT, value)
    grown = node is _EMPTY
    node = (_NODE, key, value, _EVEN, _EMPTY, _EMPTY) if grown else (_NODE, key, value, *node[3:])
    made = _put_back(path, node, grown, _deepened)
    return made is not None and unify(result, made, machine.trail)


def _path_to(key: Term, tree: Term, goal: Functor, value: Term) -> Tuple[_Path, Any]:
    """Return the nodes above the place of a key, and the node there; the empty tree if the key is not in the tree.

    Args:
        key: the key, dereferenced.
        tree: the tree.
        goal: the functor of the library's predicate that the error names.
        value: the value that the error names.

    Raises:
        PrologError: where a side on the way is no tree.
    """
    path: _Path = []
    node: Any = deref(tree)
    for _ in bounded():
        if node is _EMPTY:
            break
        if not _is_node(node):
            raise no_matching_rule("assoc", (goal, node, key, value, Var(), Var()))
        order = _order(key, node[1])
        if not order:
            break
        path.append((node, order))
        node = deref(node[4] if order < 0 else node[5])
    return path, node


def _put_back(path: _Path, node: Term, changed: bool, balanced: _Balance) -> Optional[Term]:
    """Return the tree whose path leads to a node that takes the place of another; None where a balance is none.

    Args:
        path: the nodes above the place, from the top.
        node: the node that belongs there.
        changed: whether its depth is another one than before.
        balanced: returns a node with a side whose depth has changed, and whether its own has changed: `_deepened` or
            `_flattened`.
    """
    for parent, order in reversed(path):
        if changed:
            made = balanced(parent, node, order)
            if made is None:
                return None
            node, changed = made
        else:
            sides = (node, parent[5]) if order < 0 else (parent[4], node)
            node = (*parent[:4], *sides)
    return node


def _deepened(parent: CompoundTerm, side: CompoundTerm, order: int) -> Optional[Tuple[CompoundTerm, bool]]:
    """Return a node one of whose sides has become deeper by one, and whether the node has.

    The side is the left one where ``order`` is negative. None where the balance is none.
    """
    _, key, value, balance, left, right = parent
    left, right = (side, right) if order < 0 else (left, side)
    deeper, other = (_LEFT, _RIGHT) if order < 0 else (_RIGHT, _LEFT)
    balance = deref(balance)
    if balance is _EVEN:
        return (_NODE, key, value, deeper, left, right), True
    if balance is other:
        return (_NODE, key, value, _EVEN, left, right), False
    if balance is not deeper or side[3] is _EVEN:  # a new leaf makes no side too deep
        return None
    return _rotated(key, value, left, right, order), False


def _rotated(key: Term, value: Term, left: Any, right: Any, order: int) -> CompoundTerm:
    """Return a node one of whose sides has become too deep, balanced: the left side where ``order`` is negative."""
    _, child_key, child_value, balance, inner_left, inner_right = left if order < 0 else right
    if deref(balance) is (_LEFT if order < 0 else _RIGHT):  # a single rotation: the child goes up
        if order < 0:
            return (
                *(_NODE, child_key, child_value, _EVEN, inner_left),
                (_NODE, key, value, _EVEN, inner_right, right),
            )
        return (
            *(_NODE, child_key, child_value, _EVEN),
            *((_NODE, key, value, _EVEN, left, inner_left), inner_right),
        )
    # A double rotation: the child's inner side goes up.
    top: Any = deref(inner_right if order < 0 else inner_left)
    _, top_key, top_value, balance, top_left, top_right = top
    of_top: Any = deref(balance)
    left_balance, right_balance = _AFTER_DOUBLE_ROTATION[of_top]
    if order < 0:
        lower = (_NODE, child_key, child_value, left_balance, inner_left, top_left)
        upper = (_NODE, key, value, right_balance, top_right, right)
    else:
        lower = (_NODE, key, value, left_balance, left, top_left)
        upper = (_NODE, child_key, child_value, right_balance, top_right, inner_right)
    return (_NODE, top_key, top_value, _EVEN, lower, upper)


@deterministic("del_assoc/4", locked=False)
def del_assoc(machine: Machine, key: Term, tree: Term, value: Term, result: Term) -> bool:
    """Remove a key."""
    key = deref(key)
    path, node = _path_to(key, tree, _DELETE, value)
    if node is _EMPTY or not unify(value, node[2], machine.trail):
        return False
    rest = _without_key(node, path)
    if rest is None:
        return False
    made = _put_back(path, rest, True, _flattened)
    return made is not None and unify(result, made, machine.trail)


def _without_key(node: CompoundTerm, path: _Path) -> Optional[Term]:
    """Return what replaces the last node of a path when the key of a node is removed; None if a side is no tree.

    If the node has both sides, the next key of its deeper side takes its place, and the path is extended to that key.

    Args:
        node: the node whose key is removed.
        path: the nodes above it.
    """
    left, right = deref(node[4]), deref(node[5])
    if left is _EMPTY or right is _EMPTY:
        return right if left is _EMPTY else left
    if not (_is_node(left) and _is_node(right)):
        return None
    side = 1 if deref(node[3]) is _RIGHT else -1
    place = len(path)
    path.append((node, side))
    following: Any = right if side > 0 else left
    for _ in bounded():
        inner, outer = (following[4], following[5]) if side > 0 else (following[5], following[4])
        inner = deref(inner)
        if not _is_node(inner):
            break
        path.append((following, -side))
        following = inner
    path[place] = ((_NODE, following[1], following[2], *node[3:]), side)
    return deref(outer)


def _flattened(parent: CompoundTerm, side: Any, order: int) -> Optional[Tuple[CompoundTerm, bool]]:
    """Return a node one of whose sides has lost a level, and whether the node has.

    The side is the left one where ``order`` is negative. None where the balance is none.
    """
    _, key, value, balance, left, right = parent
    left, right = (side, right) if order < 0 else (left, side)
    flatter, other = (_LEFT, _RIGHT) if order < 0 else (_RIGHT, _LEFT)
    balance = deref(balance)
    if balance is flatter:
        return (_NODE, key, value, _EVEN, left, right), True
    if balance is _EVEN:
        return (_NODE, key, value, other, left, right), False
    if balance is not other:
        return None
    sibling: Any = deref(right if order < 0 else left)
    if not _is_node(sibling):
        return None
    lean = deref(sibling[3])
    if lean is flatter:
        inner: Any = deref(sibling[4] if order < 0 else sibling[5])
        if not _is_node(inner) or not _is_balance(deref(inner[3])):
            return None
    elif not _is_balance(lean):
        return None
    if lean is not _EVEN:
        return _rotated(key, value, left, right, -order), True
    # A single rotation; the node keeps its depth, and both levels lean.
    _, top_key, top_value, _, inner_left, inner_right = sibling
    if order < 0:
        lower = (_NODE, key, value, _RIGHT, left, inner_left)
        return (_NODE, top_key, top_value, _LEFT, lower, inner_right), False
    lower = (_NODE, key, value, _LEFT, inner_right, right)
    return (_NODE, top_key, top_value, _RIGHT, inner_left, lower), False


def _listing(position: Optional[int]) -> Callable[[Machine, Term, Term], bool]:
    """Return a predicate that lists an argument of the nodes of a tree, or without a position their pairs."""

    def run(machine: Machine, tree: Term, result: Term) -> bool:
        """Unify the result with the items of a tree in the order of keys; fail for a term that is no tree."""
        path: List[CompoundTerm] = []
        node: Any = tree
        wrong: Optional[Term] = None
        # From the last node to the first, so that the list is made without another one of its items.
        found: Term = NIL
        for _ in ROUNDS:
            for _ in BULK:
                if node.__class__ is tuple and node[0] is _NODE:
                    if node[5] is not _EMPTY:
                        path.append(node)
                        node = node[5]
                        continue
                elif node is _EMPTY:
                    if not path:
                        if wrong.__class__ is Var:
                            raise instantiation_error()
                        return wrong is None and unify(result, found, machine.trail)
                    node = path.pop()
                else:
                    same, node = node, deref(node)
                    if node is same:  # the last one of these is the first in the order of keys
                        wrong, node = node, _EMPTY
                    continue
                item = (MINUS, node[1], node[2]) if position is None else node[position]
                found = (CONS, item, found)
                node = node[4]
            look()
        raise TermTooLarge

    return run


deterministic("assoc_to_list/2", locked=False)(_listing(None))
deterministic("assoc_to_keys/2", locked=False)(_listing(1))
deterministic("assoc_to_values/2", locked=False)(_listing(2))


@deterministic("$pairs_to_assoc/2")
def pairs_to_assoc(machine: Machine, pairs: Term, result: Term) -> bool:
    """Make a balanced tree of pairs; fail unless their keys increase."""
    found: List[Any] = [deref(pair) for pair in watched(items(pairs))]
    keys: List[Any] = []
    for pair in watched(found):
        if pair.__class__ is not tuple or pair[0] is not MINUS:
            return False
        key = deref(pair[1])
        if keys and _order(keys[-1], key) >= 0:
            return False
        keys.append(key)
    values = [pair[2] for pair in found]
    return unify(result, _balanced(keys, values, 0, len(keys))[0], machine.trail)


def _balanced(keys: List[Term], values: List[Term], start: int, end: int) -> Tuple[Term, int]:
    """Return a tree of some of the pairs and its depth; its left side is as large as the right one, or one larger."""
    if start == end:
        return _EMPTY, 0
    if not start & 1023:
        look()
    middle = start + (end - start) // 2
    left, depth = _balanced(keys, values, start, middle)
    right, right_depth = _balanced(keys, values, middle + 1, end)
    balance = _EVEN if depth == right_depth else _LEFT
    return (_NODE, keys[middle], values[middle], balance, left, right), depth + 1
