"""Association lists: AVL trees of terms ``t(Key, Value, Balance, Left, Right)``, empty: ``t``.

``Balance`` names the deeper subtree: ``<`` for the left one, ``>`` for the right one, ``-`` for neither. Lookup,
insertion and deletion descend the tree by the standard order of keys. Terms are immutable, so insertion and deletion
record the path from the root and rebuild its nodes from the bottom up, with the single and double rotations of
Adelson-Velsky and Landis (1962). The format of the nodes is that of SWI-Prolog's ``library(assoc)``, and a tree may
come from a program, so each node and each balance is checked before it is used. The remaining predicates of the
library are in library/assoc.pl.
"""

from typing import Any, Callable, List, Optional, Tuple

from ...foundation.errors import TermTooLarge
from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits, with_limit_checks
from ..machine.errors import instantiation_error, no_matching_rule, type_error
from ..terms.term_traversal import WALK_ROUNDS
from ..terms.types import CONS, MINUS, NIL, CompoundTerm, Functor, Term, Var, atom, deref, functor
from ..terms.unification import compare, unify
from .argument_checks import bound, items
from .builtin_registry import ProgramMachine, deterministic
from .list_predicates import limited_rounds

_NODE, _EMPTY = functor("t", 5), atom("t")
_LEFT, _EVEN, _RIGHT = atom("<"), atom("-"), atom(">")
_INSERT, _DELETE = functor("insert", 5), functor("delete", 5)
_BALANCES_AFTER_DOUBLE_ROTATION = {_EVEN: (_EVEN, _EVEN), _LEFT: (_EVEN, _RIGHT), _RIGHT: (_LEFT, _EVEN)}
"""Balances of the left and the right node after a double rotation, by the balance of the node that goes up."""


_Path = List[Tuple[CompoundTerm, int]]
"""Nodes from the root down, each with -1 or 1 if the path continues in its left or right subtree."""

_Rebalance = Callable[[CompoundTerm, Any, int], Optional[Tuple[CompoundTerm, bool]]]
"""Function that replaces a subtree of a node: `_rebalance_deepened` or `_rebalance_flattened`."""


def _compare_keys(first: Any, second: Any) -> int:
    """Compare two keys; integers, the most common keys, are compared without a call of `compare`."""
    if first.__class__ is int and second.__class__ is int:
        return (first > second) - (first < second)
    return compare(first, second)


def _is_node(term: Term) -> bool:
    """Return whether a dereferenced term is a node, which an empty tree is not."""
    return term.__class__ is tuple and term[0] is _NODE


def _is_balance(term: Term) -> bool:
    """Return whether a dereferenced term is a balance.

    The term is compared by identity: a look-up in a set would hash it, which recurses into terms of any depth.
    """
    return term is _EVEN or term is _LEFT or term is _RIGHT


@deterministic("get_assoc/3", is_protected=False)
def get_assoc(machine: ProgramMachine, key: Term, tree: Term, value: Term) -> bool:
    """Look up a key."""
    key = deref(key)
    node: Any = bound(tree)
    if node is not _EMPTY and (node.__class__ is not tuple or node[0] is not _NODE):
        raise type_error("btree", node)
    for _ in limited_rounds():
        if node.__class__ is not tuple or node[0] is not _NODE:
            return False
        node_key = node[1]
        # Inlined `_compare_keys`, because most keys are integers or atoms and a call costs more than the comparison.
        if key.__class__ is int and node_key.__class__ is int:
            order = -1 if key < node_key else key > node_key
        else:
            order = 0 if key is node_key else compare(key, node_key)
        if not order:
            return unify(value, node[2], machine.trail)
        node = node[4] if order < 0 else node[5]
        if node.__class__ is not tuple:
            node = deref(node)
    return False


@deterministic("put_assoc/4", is_protected=False)
def put_assoc(machine: ProgramMachine, key: Term, tree: Term, value: Term, result: Term) -> bool:
    """Insert a key or replace its value."""
    key = deref(key)
    path, node = _find_path(key, tree, _INSERT, value)
    is_new = node is _EMPTY
    node = (_NODE, key, value, _EVEN, _EMPTY, _EMPTY) if is_new else (_NODE, key, value, *node[3:])
    rebuilt = _rebuild_path(path, node, is_new, _rebalance_deepened)
    return rebuilt is not None and unify(result, rebuilt, machine.trail)


def _find_path(key: Term, tree: Term, goal: Functor, value: Term) -> Tuple[_Path, Any]:
    """Return the path to a key, and its node, or the empty tree if the key is not in the tree.

    Args:
        key: the key, dereferenced.
        tree: the tree.
        goal: the functor of the library predicate, for the error term.
        value: the value of the key, for the error term.

    Raises:
        PrologError: if a subtree on the path is not a tree.
    """
    path: _Path = []
    node: Any = deref(tree)
    for _ in limited_rounds():
        if node is _EMPTY:
            break
        if not _is_node(node):
            raise no_matching_rule("assoc", (goal, node, key, value, Var(), Var()))
        order = _compare_keys(key, node[1])
        if not order:
            break
        path.append((node, order))
        node = deref(node[4] if order < 0 else node[5])
    return path, node


def _rebuild_path(path: _Path, node: Term, has_other_depth: bool, rebalance: _Rebalance) -> Optional[Term]:
    """Return the tree with a new node at the end of a path, or None if a balance is invalid.

    Args:
        path: the nodes above the new node, from the root down.
        node: the new node.
        has_other_depth: whether its depth differs from that of the node that it replaces.
        rebalance: returns a node with one subtree of a different depth, and whether the node's own depth differs:
            `_rebalance_deepened` or `_rebalance_flattened`.
    """
    # As soon as one node has kept its depth, the balances above it are valid, and nodes are only copied.
    for parent, order in reversed(path):
        if has_other_depth:
            balanced_node = rebalance(parent, node, order)
            if balanced_node is None:
                return None
            node, has_other_depth = balanced_node
        else:
            subtrees = (node, parent[5]) if order < 0 else (parent[4], node)
            node = (*parent[:4], *subtrees)
    return node


def _rebalance_deepened(
    parent: CompoundTerm, subtree: CompoundTerm, order: int
) -> Optional[Tuple[CompoundTerm, bool]]:
    """Return a node one of whose subtrees has become deeper by one, and whether the node has become deeper.

    ``order`` is negative for the left subtree. Returns None if a balance is invalid.
    """
    _, key, value, balance, left, right = parent
    left, right = (subtree, right) if order < 0 else (left, subtree)
    deeper, flatter = (_LEFT, _RIGHT) if order < 0 else (_RIGHT, _LEFT)
    balance = deref(balance)
    if balance is _EVEN:
        return (_NODE, key, value, deeper, left, right), True
    if balance is flatter:
        return (_NODE, key, value, _EVEN, left, right), False
    # A subtree that has become too deep has a deeper subtree itself, unless the tree was not a valid AVL tree.
    if balance is not deeper or subtree[3] is _EVEN:
        return None
    return _rotate(key, value, left, right, order), False


def _rotate(key: Term, value: Term, left: Any, right: Any, order: int) -> CompoundTerm:
    """Return a rebalanced node whose left subtree, or right one if ``order`` is positive, is too deep by one."""
    _, child_key, child_value, balance, inner_left, inner_right = left if order < 0 else right
    if deref(balance) is (_LEFT if order < 0 else _RIGHT):
        # Single rotation: the child becomes the root of this subtree.
        if order < 0:
            left_node, right_node = inner_left, (_NODE, key, value, _EVEN, inner_right, right)
        else:
            left_node, right_node = (_NODE, key, value, _EVEN, left, inner_left), inner_right
        return (_NODE, child_key, child_value, _EVEN, left_node, right_node)
    # Double rotation: the child's inner subtree becomes the root of this subtree.
    top: Any = deref(inner_right if order < 0 else inner_left)
    _, top_key, top_value, balance, top_left, top_right = top
    top_balance: Any = deref(balance)
    left_balance, right_balance = _BALANCES_AFTER_DOUBLE_ROTATION[top_balance]
    if order < 0:
        left_node = (_NODE, child_key, child_value, left_balance, inner_left, top_left)
        right_node = (_NODE, key, value, right_balance, top_right, right)
    else:
        left_node = (_NODE, key, value, left_balance, left, top_left)
        right_node = (_NODE, child_key, child_value, right_balance, top_right, inner_right)
    return (_NODE, top_key, top_value, _EVEN, left_node, right_node)


@deterministic("del_assoc/4", is_protected=False)
def del_assoc(machine: ProgramMachine, key: Term, tree: Term, value: Term, result: Term) -> bool:
    """Remove a key."""
    key = deref(key)
    path, node = _find_path(key, tree, _DELETE, value)
    if node is _EMPTY or not unify(value, node[2], machine.trail):
        return False
    replacement = _remove_node(node, path)
    if replacement is None:
        return False
    rebuilt = _rebuild_path(path, replacement, True, _rebalance_flattened)
    return rebuilt is not None and unify(result, rebuilt, machine.trail)


def _remove_node(node: CompoundTerm, path: _Path) -> Optional[Term]:
    """Return the subtree that replaces a removed node; None if a subtree of it is not a tree.

    If the node has two subtrees, the adjacent key of the deeper one replaces its key, and the path is extended to the
    node of that key.

    Args:
        node: the node whose key is removed.
        path: the nodes above it.
    """
    left, right = deref(node[4]), deref(node[5])
    if left is _EMPTY or right is _EMPTY:
        return right if left is _EMPTY else left
    if not (_is_node(left) and _is_node(right)):
        return None
    # Taking the key from the deeper subtree never makes the node unbalanced, so it needs fewer rotations.
    order = 1 if deref(node[3]) is _RIGHT else -1
    node_position = len(path)
    path.append((node, order))
    adjacent_node: Any = right if order > 0 else left
    for _ in limited_rounds():
        inner_subtree, outer_subtree = (
            (adjacent_node[4], adjacent_node[5]) if order > 0 else (adjacent_node[5], adjacent_node[4])
        )
        inner_subtree = deref(inner_subtree)
        if not _is_node(inner_subtree):
            break
        path.append((adjacent_node, -order))
        adjacent_node = inner_subtree
    path[node_position] = ((_NODE, adjacent_node[1], adjacent_node[2], *node[3:]), order)
    return deref(outer_subtree)


def _rebalance_flattened(
    parent: CompoundTerm, subtree: Any, order: int
) -> Optional[Tuple[CompoundTerm, bool]]:
    """Return a node one of whose subtrees has become flatter by one, and whether the node has become flatter.

    ``order`` is negative for the left subtree. Returns None if a balance is invalid.
    """
    _, key, value, balance, left, right = parent
    left, right = (subtree, right) if order < 0 else (left, subtree)
    flatter, deeper = (_LEFT, _RIGHT) if order < 0 else (_RIGHT, _LEFT)
    balance = deref(balance)
    if balance is flatter:
        return (_NODE, key, value, _EVEN, left, right), True
    if balance is _EVEN:
        return (_NODE, key, value, deeper, left, right), False
    if balance is not deeper:
        return None
    sibling: Any = deref(right if order < 0 else left)
    if not _is_node(sibling):
        return None
    sibling_balance = deref(sibling[3])
    if sibling_balance is flatter:
        inner_subtree: Any = deref(sibling[4] if order < 0 else sibling[5])
        if not _is_node(inner_subtree) or not _is_balance(deref(inner_subtree[3])):
            return None
    elif not _is_balance(sibling_balance):
        return None
    if sibling_balance is not _EVEN:
        return _rotate(key, value, left, right, -order), True
    # Single rotation around an even sibling: the subtree keeps its depth, and both of its upper nodes become uneven.
    _, top_key, top_value, _, inner_left, inner_right = sibling
    if order < 0:
        lower = (_NODE, key, value, _RIGHT, left, inner_left)
        return (_NODE, top_key, top_value, _LEFT, lower, inner_right), False
    lower = (_NODE, key, value, _LEFT, inner_right, right)
    return (_NODE, top_key, top_value, _RIGHT, inner_left, lower), False


def _listing_predicate(position: Optional[int]) -> Callable[[ProgramMachine, Term, Term], bool]:
    """Return a predicate that lists an argument of all nodes, or ``Key-Value`` pairs if ``position`` is None."""

    def run(machine: ProgramMachine, tree: Term, result: Term) -> bool:
        """Unify the result with the items of a tree in the order of keys; fail if the term is not a tree."""
        path: List[CompoundTerm] = []
        node: Any = tree
        invalid_subtree: Optional[Term] = None
        # Visits the nodes from the last to the first, so that the list is built from its end without an intermediate
        # list.
        items_so_far: Term = NIL
        for _ in WALK_ROUNDS:
            for _ in STEPS_PER_ROUND:
                if node.__class__ is tuple and node[0] is _NODE:
                    if node[5] is not _EMPTY:
                        path.append(node)
                        node = node[5]
                        continue
                elif node is _EMPTY:
                    if not path:
                        if invalid_subtree.__class__ is Var:
                            raise instantiation_error()
                        return invalid_subtree is None and unify(result, items_so_far, machine.trail)
                    node = path.pop()
                else:
                    unbound, node = node, deref(node)
                    # Not a tree. The traversal continues, because the error depends on the invalid subtree that is
                    # first in the order of keys, which is visited last.
                    if node is unbound:
                        invalid_subtree, node = node, _EMPTY
                    continue
                item = (MINUS, node[1], node[2]) if position is None else node[position]
                items_so_far = (CONS, item, items_so_far)
                node = node[4]
            check_limits()
        raise TermTooLarge

    return run


deterministic("assoc_to_list/2", is_protected=False)(_listing_predicate(None))
deterministic("assoc_to_keys/2", is_protected=False)(_listing_predicate(1))
deterministic("assoc_to_values/2", is_protected=False)(_listing_predicate(2))


@deterministic("$pairs_to_assoc/2")
def pairs_to_assoc(machine: ProgramMachine, pairs: Term, result: Term) -> bool:
    """Build a balanced tree from pairs; fail unless their keys strictly increase."""
    pair_terms: List[Any] = [deref(pair) for pair in with_limit_checks(items(pairs))]
    keys: List[Any] = []
    for pair in with_limit_checks(pair_terms):
        if pair.__class__ is not tuple or pair[0] is not MINUS:
            return False
        key = deref(pair[1])
        if keys and _compare_keys(keys[-1], key) >= 0:
            return False
        keys.append(key)
    values = [pair[2] for pair in pair_terms]
    return unify(result, _balanced_tree(keys, values, 0, len(keys))[0], machine.trail)


def _balanced_tree(keys: List[Term], values: List[Term], start: int, end: int) -> Tuple[Term, int]:
    """Return a tree of the pairs from ``start`` to ``end``, and its depth.

    The left subtree has as many nodes as the right one, or one more.
    """
    if start == end:
        return _EMPTY, 0
    if not start & 1023:
        check_limits()
    middle = start + (end - start) // 2
    left, depth = _balanced_tree(keys, values, start, middle)
    right, right_depth = _balanced_tree(keys, values, middle + 1, end)
    balance = _EVEN if depth == right_depth else _LEFT
    return (_NODE, keys[middle], values[middle], balance, left, right), depth + 1
