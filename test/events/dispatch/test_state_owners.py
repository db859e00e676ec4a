"""Owners of shared state: few modules assign it."""

import ast

import pytest
from source import NODES

OWNERS = {
    "current": ("events/dispatch/", "events/fused/"),
    "cause": "events/dispatch/",
    "condition_depth": "events/network/goal_evaluation.py",
    "condition_interval": "events/network/goal_evaluation.py",
}


def assigned(nodes):
    """Yield the attributes that a module assigns."""
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, (ast.Store, ast.Del)):
            yield node.attr


@pytest.mark.parametrize("name", OWNERS)
def test_only_the_owner_sets_it(name):
    setting = {path for path, nodes in NODES.items() if name in assigned(nodes)}
    assert setting
    assert all(path.startswith(OWNERS[name]) for path in setting), setting
