"""Ownership of attributes: objects are complete after construction, and state is set by its owner."""

import ast
from collections import defaultdict
from functools import lru_cache
from typing import Any, Dict, Iterator, Optional, Set, Tuple, Union

import pytest
from parsed_sources import FILES, NODES, TREES

ENGINE = "engine/engine.py"

ENGINE_PARTS = {
    "deployments",
    "dispatcher",
    "event_input",
    "executor",
    "input_topics",
    "knowledge",
    "loader",
    "logic",
    "reports",
    "rules",
    "slots",
    "watchdog",
}
"""Parts of `Engine` that other modules do not access."""

SET_BY_OTHERS = {
    ("Budget", "goal"): "set around each goal: a call would cost more than short goals",
    ("Budget", "running"): "set around each run, see `goal`",
    ("Dispatcher", "current"): "set for each event: a call would cost 5 % of a short event",
    ("Scope", None): "record of the code generator, which its modules share",
    ("Predicate", None): "record of the predicate table, which declarations and loaders fill",
    ("Program", "flags"): "read flags, which the directives of an included file pass on",
    ("MatchStore", "order"): "counter of matches, which buffers advance for each match",
    ("MatchStore", "stored_match_count"): "counter, see `order`",
    ("MatchStore", "dropped_count"): "counter, see `order`",
    ("EventRule", "dropped_alarm_count"): "counter, see `order`",
    ("EventRule", "late_count"): "counter, see `order`",
    ("EventRule", "ahead_count"): "counter, see `order`",
    ("EventRule", "past_alarm_count"): "counter, see `order`",
    ("EventNode", "rank"): "numbered by the compiler that builds the nodes, when all of them exist",
    ("ActionNode", "tests_label_window"): "see `rank`",
    ("FilterNode", "tests_label_window"): "see `rank`",
    ("MatchStore", "blocking_match"): "second result of the last test of a node",
}
"""Attributes that modules other than the owner's set, with the reason; None for all attributes of a class."""


def text_of(node: Any) -> str:
    """Return the dotted name of an expression; calls and other parts are shown as ``()``."""
    if isinstance(node, ast.Attribute):
        return f"{text_of(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else "()"


def attributes_set_by(cls: Any) -> Iterator[str]:
    """Yield the names of the attributes that a class assigns to itself."""
    for node in ast.walk(cls):
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.ctx, ast.Store)
            and text_of(node.value) == "self"
        ):
            yield node.attr


def slots_of(cls: Any) -> Optional[Set[Any]]:
    """Return the names in ``__slots__`` of a class, which is a record that any module may fill; None without."""
    for node in cls.body:
        if isinstance(node, ast.Assign) and text_of(node.targets[0]) == "__slots__":
            return {part.value for part in ast.walk(node.value) if isinstance(part, ast.Constant)}
    return None


@lru_cache(maxsize=1)
def owners_by_attribute() -> Any:
    """Return the classes that have each attribute, as file, name, and whether it is a record."""
    owners = defaultdict(set)
    for path, tree in TREES.items():
        for cls in ast.walk(tree):
            if isinstance(cls, ast.ClassDef):
                slots = slots_of(cls)
                for name in {*attributes_set_by(cls), *(slots or ())}:
                    owners[name].add((path, cls.name, slots is not None))
    return owners


def targets_of(node: Any) -> Iterator[Any]:
    """Yield the targets of an assignment, those in tuples as well."""
    if isinstance(node, ast.Assign):
        pending = list(node.targets)
    elif isinstance(node, (ast.AugAssign, ast.AnnAssign)):
        pending = [node.target]
    else:
        return
    while pending:
        target = pending.pop()
        if isinstance(target, (ast.Tuple, ast.List)):
            pending += target.elts
        else:
            yield target


def created_in(scope: Any) -> Set[Any]:
    """Return the texts of the names and attributes to which a function or class assigns the result of a call."""
    return {
        text_of(target)
        for node in ast.walk(scope)
        if isinstance(getattr(node, "value", None), ast.Call)
        for target in targets_of(node)
    }


def foreign_assignments(path: Any, node: Any, created: Any) -> Iterator[str]:
    """Yield line and target of each assignment to an attribute of an object that was created elsewhere."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.ClassDef, ast.FunctionDef)):
            yield from foreign_assignments(path, child, created | created_in(child))
            continue
        for target in targets_of(child):
            if not isinstance(target, ast.Attribute) or isinstance(target.value, ast.Call):
                continue
            owner = text_of(target.value)
            classes = owners_by_attribute().get(target.attr, ())
            is_own = (
                owner in ("self", "cls") or owner in created or any(file == path for file, _, _ in classes)
            )
            if is_own or any(is_a_record for _, _, is_a_record in classes):
                continue
            names = {name for _, name, _ in classes}
            if names and not any(
                (name, field) in SET_BY_OTHERS for name in names for field in (None, target.attr)
            ):
                yield f"{path}:{target.lineno}: {text_of(target)}"
        yield from foreign_assignments(path, child, created)


@pytest.mark.parametrize("path", TREES)
def test_attributes_are_set_by_their_owner(path: Any) -> None:
    assert list(foreign_assignments(path, TREES[path], frozenset())) == []


def test_exceptions_are_needed() -> None:
    """Each entry of the list names a class, and an attribute that another module sets."""
    set_elsewhere = {
        (name, target.attr)
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        for target in targets_of(node)
        if isinstance(target, ast.Attribute)
        for file, name, _ in owners_by_attribute().get(target.attr, ())
        if file != path
    }
    unused = [
        (name, field)
        for name, field in SET_BY_OTHERS
        if not any(other == name and field in (None, attribute) for other, attribute in set_elsewhere)
    ]
    assert unused == []


def test_constructors_assign_no_placeholder_functions() -> None:
    """A function that is replaced later is passed to the constructor, or added to a `CallbackList`."""
    set_elsewhere = {
        target.attr
        for tree in TREES.values()
        for node in ast.walk(tree)
        for target in targets_of(node)
        if isinstance(target, ast.Attribute) and text_of(target.value) not in ("self", "cls")
    }
    placeholders = [
        f"{path}:{target.lineno}: {text_of(target)}"
        for path, tree in TREES.items()
        for constructor in ast.walk(tree)
        if isinstance(constructor, ast.FunctionDef) and constructor.name == "__init__"
        for node in ast.walk(constructor)
        if isinstance(getattr(node, "value", None), ast.Lambda)
        for target in targets_of(node)
        if isinstance(target, ast.Attribute)
        and text_of(target.value) == "self"
        and target.attr in set_elsewhere
    ]
    assert placeholders == []


def test_parts_of_engine_are_accessed_by_its_module_only() -> None:
    accesses = [
        f"{path}:{node.lineno}: {text_of(node)}"
        for path, module in FILES.items()
        if path != ENGINE
        for node in module.nodes
        if isinstance(node, ast.Attribute) and node.attr in ENGINE_PARTS
        if text_of(node.value).rpartition(".")[2].endswith("engine")
    ]
    assert accesses == []


MODULES_OF_STATE: Dict[str, Union[str, Tuple[str, ...]]] = {
    "current": ("events/dispatch/", "events/fused/"),
    "cause": "events/dispatch/",
    "condition_depth": "events/network/goal_evaluation.py",
    "condition_interval": "events/network/goal_evaluation.py",
}
"""Modules that assign an attribute of shared state."""


def assigned_attributes(nodes: Any) -> Iterator[str]:
    """Yield the attributes that a module assigns."""
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, (ast.Store, ast.Del)):
            yield node.attr


@pytest.mark.parametrize("name", MODULES_OF_STATE)
def test_only_owner_assigns_state(name: str) -> None:
    assigning_modules = {path for path, nodes in NODES.items() if name in assigned_attributes(nodes)}
    assert assigning_modules
    assert all(path.startswith(MODULES_OF_STATE[name]) for path in assigning_modules), assigning_modules
