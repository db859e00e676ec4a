"""Caches hold no more than they may, and all caches of the package are known here, with what bounds them."""

import ast

from source import TREES

from retalis.foundation import Cache, Texts
from retalis.foundation.caches import ENTRY

DECORATED = {
    ("messages/arrays.py", "array_maker"): "one entry for each of the 13 number types",
    ("engine/explaining/shortfall.py", "_spans"): "one entry for each operator",
    ("events/matches/reach.py", "reach_of"): "1000 entries of an operator's name and two numbers",
    ("prolog/logic/library.py", "library_index"): "one entry",
    ("prolog/syntax/eventtext.py", "_second_text"): "64 seconds, of the years 1 to 9999",
    ("prolog/syntax/operators.py", "_standard"): "one entry",
    ("prolog/terms/timestamps.py", "first_reaching"): "64 floats",
    ("prolog/terms/timestamps.py", "_day_fields"): "64 numbers",
    ("prolog/terms/timestamps.py", "_day_number"): "64 dates",
}
"""Functions with a cache of their own, which counts entries and not bytes: why that is a bound of bytes."""


def test_entries_are_bounded():
    cache = Cache(10, 1 << 20)
    for number in range(100):
        assert cache.keep(number, -number, 8) == -number
        assert cache[number] == -number
        assert len(cache) <= 10


def test_bytes_are_bounded():
    cache = Cache(1000, 100_000, 50_000)
    for number in range(1000):
        cache.keep(number, "", 9000)
        assert cache.held <= 100_000
        assert cache.held == len(cache) * (9000 + ENTRY)
    cache.clear()
    assert (len(cache), cache.held) == (0, 0)


def test_what_is_too_large_is_not_kept_and_takes_nobodys_place():
    cache = Cache(10, 10_000, 1000)
    cache.keep("small", 1, 10)
    assert cache.keep("large", 2, 1000) == 2
    assert list(cache) == ["small"]


def test_texts_are_made_once_where_they_are_short():
    made = []

    def make(text):
        made.append(text)
        return text * 2

    texts = Texts(make, 10, 1 << 20, 1000)
    for text in ("a", "a", "b" * 1000, "b" * 1000):
        assert texts[text] == text * 2
    assert made == ["a", "b" * 1000, "b" * 1000]


def test_each_cache_of_a_function_is_known_and_bounded():
    found = {
        (path, node.name)
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and any("cache" in ast.dump(one) for one in node.decorator_list)
    }
    assert found == set(DECORATED)
