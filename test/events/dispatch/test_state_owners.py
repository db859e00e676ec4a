"""Owners of shared state: few modules assign it."""

import ast
from typing import Any, Iterator

import pytest
from source import NODES

OWNERS = {
    "current": ("events/dispatch/", "events/fused/"),
    "cause": "events/dispatch/",
    "condition_depth": "events/network/goal_evaluation.py",
    "condition_interval": "events/network/goal_evaluation.py",
}


def assigned_attributes(nodes: Any) -> Iterator[Any]:
    """Yield the attributes that a module assigns."""
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, (ast.Store, ast.Del)):
            yield node.attr


@pytest.mark.parametrize("name", OWNERS)
def test_only_owner_assigns_state(name: Any) -> None:
    assigning_modules = {path for path, nodes in NODES.items() if name in assigned_attributes(nodes)}
    assert assigning_modules
    assert all(path.startswith(OWNERS[name]) for path in assigning_modules), assigning_modules
