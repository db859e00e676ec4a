"""Labels and names of rules, and errors in labels and properties."""

import pytest
from events.load_problems import assert_refused, warnings_of

from retalis import Engine
from retalis.events.language.rule_labels import MAX_NAME_CHARACTERS, WORD_PROPERTIES, rule_title
from retalis.events.matches.match_policies import AfterMatchSkipStrategy, ConsumptionPolicy
from retalis.foundation.source_places import line_of

LABEL_ADVICE = "a label is an atom, or Label([property(Name, Value), ...])"


@pytest.mark.parametrize(
    ("rule", "column", "part"),
    [
        ("L : a <- b.", 1, f"{LABEL_ADVICE}, not a variable"),
        ("3 : a <- b.", 1, LABEL_ADVICE),
        ('"l" : a do f <- b.', 1, LABEL_ADVICE),
        ("l(window, 3) : a <- b.", 1, LABEL_ADVICE),
        ("l([property(window, 3)|_]) : a <- b.", 1, LABEL_ADVICE),
        ("l([window(3)]) : a <- b.", 4, "expected property(window, 3)"),
        ("l([property(window, 3), window = 3]) : a <- b.", 32, "expected property(window, 3)"),
        ("l([property(X, 3)]) : a <- b.", 4, "expected property(Name, Value)"),
        ("l([x]) : a <- b.", 1, "expected property(Name, Value)"),
        ("'rule:'(X, (a <- b)).", 9, LABEL_ADVICE),
        ("l([property(window, 1.0Inf)]) : a <- b.", 21, "needs a number of seconds"),
        ("l([property(window, -1)]) : a <- b.", 21, "needs a number of seconds"),
        ("event_rule_property(l, window, 1.0Inf).", 32, "needs a number of seconds"),
        ("event_rule_property(l, window, X).", 32, "needs a number of seconds"),
        ("l([policy(recent)]) : a <- b.", 4, "expected property(policy, recent)"),
        ("l([policy = recent]) : a <- b.", 11, "expected property(policy, recent)"),
        ("l([property(policy, recent_3)]) : a <- b.", 21, "or unrestricted; did you mean recent_2?"),
        ("l([property(policy, 3)]) : a <- b.", 21, "chronological_2 or unrestricted"),
        ("l([property(policy, X)]) : a <- b.", 21, "chronological_2 or unrestricted"),
        ("l([property(after_match, skip)]) : a <- b.", 26, "is keep, skip_past_last or skip_to_next"),
        ("event_rule_property(l, out_of_order, yes).", 38, "property out_of_order is off or on"),
    ],
)
def test_invalid_label_is_refused(rule: str, column: int, part: str) -> None:
    assert_refused(rule, column, part)


def test_property_has_more_seconds_than_a_float() -> None:
    engine = Engine()
    engine.load(rules=f"l([property(window, 1{'0' * 400})]) : a <- b seq c.")
    engine.event("b", 1)
    assert Engine.restore(engine.snapshot()).rules.rules[0].title == engine.rules.rules[0].title


def test_unknown_property_is_reported_at_name() -> None:
    assert warnings_of("l([property(colour, red)]) : a <- b.")[0][:2] == (1, 13)
    assert warnings_of("event_rule_property(l, colour, red).")[0][:2] == (1, 24)


def test_misspelt_property_has_suggestion() -> None:
    message = warnings_of("l([property(polici, recent)]) : a <- b.")[0][2]
    assert "did you mean policy?" in message
    assert "did you mean" not in warnings_of("l([property(colour, red)]) : a <- b.")[0][2]


def test_property_values_are_those_of_the_network() -> None:
    assert WORD_PROPERTIES["policy"] == tuple(policy.value for policy in ConsumptionPolicy)
    assert WORD_PROPERTIES["after_match"] == tuple(strategy.value for strategy in AfterMatchSkipStrategy)


@pytest.mark.parametrize(
    ("rule", "name"),
    [
        ("hot : a(X) <- b(X).", "hot"),
        ("'Too hot'([property(window, 3)]) : a(X) <- b(X).", "'Too hot'"),
        ("a(X, _) <- b(X).", "a(X,_)"),
        ("exceptionAlarm(late(X), 3) <- b(X).", "late(X)"),
        ("synchronized(seen(X), true, []) <- b(X).", "seen(X)"),
        ("null do writeln(X) <- b(X).", "do writeln(X)"),
        ("b(X) do writeln(X).", "do writeln(X)"),
        ("a(X) do writeln(X) <- b(X).", "a(X)"),
        ("X <- b(X).", "any event"),
        (f"{'a' * 100} <- b.", "a" * MAX_NAME_CHARACTERS + "..."),
    ],
)
def test_name_is_label_or_head(rule: str, name: str) -> None:
    engine = Engine()
    engine.load(rules=rule)
    assert engine.status().rules[0].name == name


def test_title_has_name_and_line() -> None:
    engine = Engine()
    engine.load(rules="\na <- b.\na <- c.", source="rules.txt")
    assert engine.call("ins_event_rule((a <- d))")
    titles = [rule_title(rule.name, line_of(rule.place)) for rule in engine.status().rules]
    assert titles == ["a (rules.txt:2)", "a (rules.txt:3)", "a (added at run time)"]
    assert [rule.title for rule in engine.program.rules.rules] == titles


def test_restored_rule_has_its_name() -> None:
    engine = Engine()
    engine.load(rules="hot : a(X) <- b(X).\na(X) <- c(X).")
    assert [rule.name for rule in Engine.restore(engine.snapshot()).status().rules] == ["hot", "a(X)"]
