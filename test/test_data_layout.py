"""Layout of literals: data has one entry a line, and is not shaped to fill lines."""

import ast

from parsed_sources import FILES, TREES

RECORD_TYPES = {"compact_record_of", "record_of", "rows_of"}
"""Functions that declare the fields of a record."""


def test_no_literal_is_excluded_from_formatting() -> None:
    assert [path for path, module in FILES.items() if "# fmt:" in module.path.read_text("utf-8")] == []


def test_no_literal_spreads_another() -> None:
    places = [
        f"{path}:{node.lineno}"
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Starred) and isinstance(node.value, (ast.Tuple, ast.List, ast.Set))
    ]
    assert places == []


def test_stored_records_have_one_field_a_line() -> None:
    declarations = {
        f"{path}:{node.lineno}": [keyword.value.lineno for keyword in node.keywords]
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in RECORD_TYPES
    }
    assert declarations
    assert [place for place, lines in declarations.items() if len(set(lines)) < len(lines)] == []
