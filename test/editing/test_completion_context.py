"""Context of a position in an unfinished clause."""

import pytest

from retalis.editing.completion_context import find_context, find_xml_context
from retalis.editing.symbol_uses import SymbolKind


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("x :- prev(", SymbolKind.MEMORY),
        ("x :- prev(od", SymbolKind.MEMORY),
        ("x :- prev(m, ", None),
        ("a <- b check (access_mem(", SymbolKind.MEMORY),
        (":- subscribe(a(X, Y), [], _, ", SymbolKind.TOPIC),
        ("x :- f(prev(a, b), ", None),
        ("a.\nb :- prev(a).\nc <- ", None),
    ],
)
def test_kind_of_expected_symbols(text: str, kind: SymbolKind) -> None:
    context = find_context(text, len(text), False)
    assert context is not None
    assert context.symbol_kind is kind


@pytest.mark.parametrize(
    ("text", "path", "named"),
    [
        ("a <- pkg__0__T{", ("pkg__0__T",), ()),
        ("a <- pkg__0__T{hea", ("pkg__0__T",), ()),
        ("a <- ev{x: f(1, 2), ", ("ev",), ("x",)),
        ("a <- ev{x: {y: Y, ", ("ev", "x"), ("y",)),
        ("a <- ev{x: [{z: 1}, {", ("ev", "x"), ()),
        ("a <- ev{x: ", (), ("x",)),
        ("a <- ev{x: {y: 1}} seq b(", (), ()),
    ],
)
def test_slots_of_messages(text: str, path: object, named: object) -> None:
    context = find_context(text, len(text), False)
    assert context is not None
    assert (context.message_path, context.named_slots) == (path, named)
    assert context.is_slot_name == bool(path)


@pytest.mark.parametrize(
    "text", ["a. % comm", "% c", "a /* x", "x <- f('abc", 'x <- f("abc', "x <- f(12", "/* open"]
)
def test_no_names_in_comments_quotes_and_numbers(text: str) -> None:
    assert find_context(text, len(text), False) is None


@pytest.mark.parametrize("text", ["", "a. % c\n", "a. /* c */ ", "a.\n"])
def test_names_after_comments(text: str) -> None:
    assert find_context(text, len(text), False) is not None


def test_variables_of_clause() -> None:
    text = "a(Z).\nb(X, _) <- c(Y) seq d(X, "
    context = find_context(text, len(text), False)
    assert context is not None
    assert context.variables == ("X", "Y")


def test_line_of_goal_file_begins_goal() -> None:
    text = "memorize(a, [\nprev("
    context = find_context(text, len(text), True)
    assert context is not None
    assert context.symbol_kind is SymbolKind.MEMORY


def test_goal_continues_on_next_line() -> None:
    text = "memorize(a(_), [], _, m, 3).\nsubscribe(fever(W), [],\n  f(W, X),\n  "
    context = find_context(text, len(text), True)
    assert context is not None
    assert (context.symbol_kind, context.variables) == (SymbolKind.TOPIC, ("W", "X"))


def test_comma_outside_of_message_begins_no_slot() -> None:
    for text, is_slot_name in {"foo(a, ": False, "p__0__T{a: 1, ": True, "p__0__T{a: f(1, ": False}.items():
        context = find_context(text, len(text), False)
        assert context is not None
        assert context.is_slot_name is is_slot_name


def test_element_in_comment_is_no_root() -> None:
    text = "<?xml version='1.0'?>\n<!-- <subscribe_to name='x'/> -->\n<"
    context = find_xml_context(text, len(text))
    assert context is not None
    assert not context.has_root
