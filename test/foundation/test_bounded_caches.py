"""Bounds of caches, and the list of all caches of the package with their bounds."""

import ast
from functools import lru_cache
from typing import Any, Dict, Iterator, List, Union

import pytest
from parsed_sources import NODES, TREES

from retalis.foundation.bounded_caches import ENTRY_BYTES, Cache, TextCache

CACHED_FUNCTIONS = {
    ("editing/language_features.py", "_window_parts"): "one entry",
    ("editing/rule_verbalization.py", "_pattern_rows"): "one entry",
    ("editing/rule_verbalization.py", "_aggregate_rows"): "two entries, for held and other values",
    ("editing/rule_verbalization.py", "_head_rows"): "one entry",
    ("explanation/why_not_matched.py", "_compile_interval_join"): "one entry for each operator",
    (
        "events/matches/interval_index.py",
        "interval_bounds",
    ): "1000 entries of an operator's name and two numbers",
    ("prolog/builtins/listing_and_messages.py", "_layout_operators"): "one entry",
    ("prolog/system/predicate_resolution.py", "library_index"): "one entry",
    ("prolog/swi/libswipl.py", "find_library"): "one entry",
    ("messages/idl_definitions.py", "_make_parser"): "one entry",
    ("prolog/swi/swi_session.py", "_start_runtime"): "one entry",
    ("prolog/syntax/event_text.py", "_second_text"): "64 seconds, of the years 1 to 9999",
    ("prolog/syntax/operators.py", "standard_operators"): "one entry",
    ("prolog/terms/timestamps.py", "first_reaching"): "64 floats",
    ("serialization/codec.py", "_make_extension"): "1024 extension types of at most 4 bytes",
    ("prolog/terms/timestamps.py", "_day_fields"): "64 numbers",
    ("prolog/terms/timestamps.py", "_day_number"): "64 dates",
}
"""Functions with a cache that counts entries, with the reason why that bounds its bytes."""

CACHES = {
    ("editing/program_index.py", "self._files"): (200, 8 << 20),
    ("ros2/rclpy_transport.py", "self._resolved"): (1000, 1 << 20),
    ("ros1/rospy_transport.py", "self._receivers"): (1000, 16 << 20),
    ("engine/runtime/clock_skew.py", "frames"): (5000, 4 << 20),  # for each topic
    ("node/output_forwarding.py", "self._decisions"): (1000, 1 << 20),
    ("node/published_topics.py", "self._checked"): (1000, 1 << 20),
    ("ros1/text_topics.py", "self._full_names"): (1000, 1 << 20),
    ("events/rules/event_input_predicates.py", "self._seconds"): (64, 64 << 10),
    ("events/dispatch/dispatcher.py", "self._plans"): (10_000, 16 << 20),
    ("prolog/system/undefined_procedure_hints.py", "self._hints"): (1000, 1 << 20),
    ("prolog/syntax/event_text.py", "self._builders"): (512, 8_192_000),
    ("prolog/syntax/event_text.py", "self._readers_by_skeleton"): (512, 8 << 20),
    ("prolog/syntax/event_text.py", "self._reader_by_name"): (256, 1 << 18),
    ("prolog/syntax/event_text.py", "self._last_skeleton_by_name"): (256, 1 << 20),
    ("prolog/syntax/event_text.py", "self._spans"): (2048, 1 << 20),
    ("prolog/syntax/literals.py", "atom_text"): (8192, 4 << 20),
    ("foundation/codegen.py", "_factories"): (1000, 16 << 20),
    ("prolog/swi/swi_terms.py", "self._atom_handles"): (4096, 1 << 20),
    ("prolog/swi/swi_terms.py", "self._functor_handles"): (4096, 1 << 20),
    ("prolog/swi/swi_terms.py", "self._atoms_by_handle"): (4096, 1 << 20),
    ("prolog/swi/swi_terms.py", "self._functors_by_handle"): (4096, 1 << 20),
    ("messages/type_registry.py", "self._by_text"): (1000, 32 << 20),
    ("messages/type_registry.py", "self._decoders"): (1000, 32 << 20),
    ("messages/type_registry.py", "self._encoders"): (1000, 32 << 20),
    ("messages/message_slots.py", "self.notations"): (1000, 1 << 20),
    ("messages/encoder.py", "_packed_texts"): (2048, 1 << 20),
    ("messages/encoder.py", "_packed_plain_texts"): (2048, 1 << 20),
    ("messages/cdr_encoder.py", "_packed_texts"): (2048, 1 << 20),
    ("messages/cdr_encoder.py", "_packed_plain_texts"): (2048, 1 << 20),
    ("messages/decoder.py", "cache"): (
        2048,
        2 << 20,
    ),  # of strings with other values, in place of the next one
    ("messages/decoder.py", "create_text_cache"): (2048, 1 << 20),  # one for all types, and one for each type
}
"""Bounds of the caches by file and name: entries and bytes."""


def caches_results(decorator: ast.expr) -> bool:
    """Return whether a decorator caches results for arguments; ``cached_property`` keeps one for each object."""
    text = ast.dump(decorator)
    return "cache" in text and "cached_property" not in text


def caches() -> Iterator[Any]:
    """Yield file, name and bounds of each cache that the package creates."""
    for path, tree in TREES.items():
        values = constants(tree)
        for node in NODES[path]:
            for part in ast.iter_child_nodes(node):
                created = [call for call in ast.walk(part) if isinstance(call, ast.Call) and is_cache(call)]
                if created and isinstance(part, (ast.Assign, ast.AnnAssign, ast.Return)):
                    bounds = bounds_by_class()[class_of(created[0])] or [
                        bound(call, values) for call in arguments(created[0])
                    ]
                    yield path, name_of(part, node), bounds


def constants(tree: Any) -> Any:
    """Return the numeric constants of a module by name."""
    values: Dict[Any, Any] = {}
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant):
            values.update(
                (target.id, node.value.value) for target in node.targets if isinstance(target, ast.Name)
            )
    return values


def own_bounds(kind: Any, tree: Any) -> Any:
    """Return the bounds that a class of caches sets for all of its objects; None if they are arguments."""
    for node in ast.walk(kind):
        if isinstance(node, ast.Call) and ast.dump(node.func).startswith(
            "Attribute(value=Call(func=Name(id='super'"
        ):
            bounds = [bound(argument, constants(tree)) for argument in node.args]
            return bounds if bounds and None not in bounds else None
    return None


def class_of(call: ast.Call) -> str:
    """Return the name of the called class or function; "" if it is not a plain name."""
    return call.func.id if isinstance(call.func, ast.Name) else ""


def is_cache(call: ast.Call) -> bool:
    return class_of(call) in bounds_by_class()


def arguments(call: Any) -> List[Any]:
    """Return the positional and keyword arguments of a call."""
    return [*call.args, *(keyword.value for keyword in call.keywords)]


def name_of(statement: Union[ast.Assign, ast.AnnAssign, ast.Return], function: Any) -> str:
    """Return the name to which a cache is assigned, or of the function that returns it."""
    if isinstance(statement, ast.Return):
        return function.name
    target = statement.target if isinstance(statement, ast.AnnAssign) else statement.targets[0]
    if isinstance(target, ast.Name):
        return target.id
    assert isinstance(target, ast.Attribute)
    return f"self.{target.attr}"


def bound(argument: Any, values: Any) -> Any:
    """Return the number that an argument denotes, given the constants of its module; None if it is not a number."""
    if isinstance(argument, ast.BinOp):
        left, right = bound(argument.left, values), bound(argument.right, values)
        if left is None or right is None:
            return None
        return left << right if isinstance(argument.op, ast.LShift) else left * right
    return argument.value if isinstance(argument, ast.Constant) else values.get(argument.id)


@lru_cache(maxsize=1)
def bounds_by_class() -> Dict[str, Any]:
    """Return the bounds of classes of caches; None for classes whose bounds are arguments."""
    bounds: Dict[str, Any] = {"Cache": None}
    for path, tree in TREES.items():
        for node in NODES[path]:
            if isinstance(node, ast.ClassDef) and any("Cache" in ast.dump(base) for base in node.bases):
                bounds[node.name] = own_bounds(node, tree)
    return bounds


def test_number_of_entries_is_bounded() -> None:
    cache: Cache[int, int] = Cache(10, 1 << 20)
    for number in range(100):
        assert cache.store(number, -number, 8) == -number
        assert cache[number] == -number
        assert len(cache) <= 10


def test_bytes_of_entries_are_bounded() -> None:
    cache: Cache[int, str] = Cache(1000, 100_000, 50_000)
    for number in range(1000):
        cache.store(number, "", 9000)
        assert cache.total_bytes <= 100_000
        assert cache.total_bytes == len(cache) * (9000 + ENTRY_BYTES)
    cache.clear()
    assert (len(cache), cache.total_bytes) == (0, 0)


def test_too_large_value_is_not_stored() -> None:
    cache: Cache[str, int] = Cache(10, 10_000, 1000)
    cache.store("small", 1, 10)
    assert cache.store("large", 2, 1000) == 2
    assert list(cache) == ["small"]


def test_short_texts_are_computed_once() -> None:
    computed: List[Any] = []

    def double(text: Any) -> Any:
        computed.append(text)
        return text * 2

    texts = TextCache(double, 10, 1 << 20, 1000)
    for text in ("a", "a", "b" * 1000, "b" * 1000):
        assert texts[text] == text * 2
    assert computed == ["a", "b" * 1000, "b" * 1000]


@pytest.mark.slow
def test_cached_functions_are_listed_with_bound() -> None:
    functions = {
        (path, node.name)
        for path, nodes in NODES.items()
        for node in nodes
        if isinstance(node, ast.FunctionDef)
        and any(caches_results(decorator) for decorator in node.decorator_list)
    }
    assert functions == set(CACHED_FUNCTIONS)


@pytest.mark.slow
def test_caches_are_listed_with_bounds() -> None:
    caches_with_bounds = {
        (path, name): tuple(limit for limit in bounds if limit is not None)[:2]
        for path, name, bounds in caches()
    }
    assert caches_with_bounds == CACHES
    count = sum(isinstance(node, ast.Call) and is_cache(node) for nodes in NODES.values() for node in nodes)
    assert count == len(CACHES)
