"""Paths of matches through the shared buffer of a row pattern, as they are read from state files."""

from typing import List, Tuple

import pytest

from retalis.events.streams.row_pattern_states import StoredNode, are_paths

NODES = [StoredNode(1, 0, None), StoredNode(2, 0, 0), StoredNode(3, 1, 1), StoredNode(3, 0, 0)]
"""Two matches that share the node of the first element; only one of them has the second element."""


@pytest.mark.parametrize("match", [(0, 1), (2, 1), (2, 2), (2, 3), (3, 1), (3, 3)])
def test_path_may_begin_at_each_of_its_elements(match: Tuple[int, int]) -> None:
    assert are_paths(NODES, [match])


@pytest.mark.parametrize(
    ("nodes", "match"),
    [
        (NODES, (3, 2)),  # an element of another path
        (NODES, (0, 2)),  # an element after the last one
        (NODES, (4, 1)),  # no such node
        ([StoredNode(1, 0, 0)], (0, 1)),
        ([StoredNode(2, 0, None), StoredNode(1, 0, 0)], (1, 1)),
    ],
)
def test_invalid_path_is_recognized(nodes: List[StoredNode], match: Tuple[int, int]) -> None:
    assert not are_paths(nodes, [(0, nodes[0].element), match])
