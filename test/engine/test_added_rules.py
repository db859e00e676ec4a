"""Event rules that clients add and delete."""

import pytest

from retalis import Engine, ProgramErrors, RetalisError, SyntaxFault, UsageError
from retalis.engine.client_requests import add_rule, delete_rule


@pytest.fixture
def engine():
    engine = Engine()
    engine.seen = []
    engine.on_event(lambda term, start, end: engine.seen.append(engine.show(term)))
    return engine


def test_added_rule_fires_until_deleted(engine):
    assert add_rule(engine, "b(X) <- a(X).", "mine") == "mine"
    engine.event("a(1)", 1)
    delete_rule(engine, "mine")
    engine.event("a(2)", 2)
    assert engine.seen == ["a(1)", "b(1)", "a(2)"]


@pytest.mark.parametrize(
    "rule, given, label",
    [
        ("own : b <- a", "", "own"),
        ("own : b <- a", "own", "own"),
        ("own([property(window, 3)]) : b <- a", "", "own"),
        ("b <- a % why", "", "added_1"),
        ("b do true <- a", "it", "it"),
        ("b <- a", "'two words'", "'two words'"),
    ],
)
def test_rule_is_added_under_its_label(engine, rule, given, label):
    assert add_rule(engine, rule, given) == label
    engine.event("a", 1)
    assert engine.seen == ["a", "b"]
    delete_rule(engine, label)
    engine.event("a", 2)
    assert engine.seen == ["a", "b", "a"]


def test_new_labels_are_unique(engine):
    assert [add_rule(engine, "b <- a") for _ in range(3)] == ["added_1", "added_2", "added_3"]
    delete_rule(engine, "added_2")
    assert add_rule(engine, "b <- a") == "added_2"


@pytest.mark.parametrize(
    "rule, label, message",
    [
        ("b :- a", "", "expected one event rule"),
        (":- halt", "", "expected one event rule"),
        ("b <- c", "there", "a rule there already exists"),
        ("there : b <- c", "", "a rule there already exists"),
        ("own : b <- c", "other", "the rule has the label own already"),
        ("b <- c", "f(x)", "label: expected an atom"),
    ],
)
def test_invalid_rule_or_label_is_refused(engine, rule, label, message):
    engine.load(rules="there : b <- a.")
    with pytest.raises(UsageError, match=message):
        add_rule(engine, rule, label)


def test_errors_have_line_and_caret(engine):
    with pytest.raises(SyntaxFault) as fault:
        add_rule(engine, "b <- a seq\n  (c where X > )")
    assert str(fault.value).splitlines()[0].startswith("rule:2:16: ") and "^" in str(fault.value)
    with pytest.raises(ProgramErrors) as errors:
        add_rule(engine, "b <-\n   a ntimes x")
    assert str(errors.value).startswith(
        "rule:2:13: ntimes needs a positive integer\n   a ntimes x\n            ^"
    )
    engine.event("a", 1)
    assert engine.seen == ["a"]


def test_deleting_unknown_label_is_an_error(engine):
    for label in ("none", "", "f(x)", "a b"):
        with pytest.raises(RetalisError):
            delete_rule(engine, label)


def test_added_rule_cannot_load_files(engine, tmp_path):
    (tmp_path / "secret.txt").write_text("secret.")
    add_rule(engine, f"b do (catch(compile_event_file('{tmp_path}/secret.txt'), E, assertz(kept(E)))) <- a")
    engine.event("a", 1)
    assert engine.query("kept(error(permission_error(_, _, _), _))")
