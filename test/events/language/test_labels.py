"""Labels that are none, and properties without a value."""

import pytest
from events.refusals import errors_of, warnings_of

FORMS = "a label is an atom, or Label([property(Name, Value), ...])"


@pytest.mark.parametrize(
    ("rule", "column", "part"),
    [
        ("L : a <- b.", 1, f"{FORMS}, not a variable"),
        ("3 : a <- b.", 1, FORMS),
        ('"l" : a do f <- b.', 1, FORMS),
        ("l(window, 3) : a <- b.", 1, FORMS),
        ("l([property(window, 3)|_]) : a <- b.", 1, FORMS),
        ("l([window(3)]) : a <- b.", 4, "expected property(window, 3)"),
        ("l([property(window, 3), window = 3]) : a <- b.", 32, "expected property(window, 3)"),
        ("l([property(X, 3)]) : a <- b.", 4, "expected property(Name, Value)"),
        ("l([x]) : a <- b.", 1, "expected property(Name, Value)"),
        ("'rule:'(X, (a <- b)).", 9, FORMS),
        ("l([property(window, 1.0Inf)]) : a <- b.", 21, "needs a number of seconds"),
        ("l([property(window, -1)]) : a <- b.", 21, "needs a number of seconds"),
        ("event_rule_property(l, window, 1.0Inf).", 32, "needs a number of seconds"),
        ("event_rule_property(l, window, X).", 32, "needs a number of seconds"),
    ],
)
def test_refused(rule, column, part):
    ((line, at, message),) = errors_of(f"% first\n{rule}")
    assert line == 2
    assert part in message
    assert at == column


def test_an_unknown_property_is_warned_of_at_its_name():
    assert warnings_of("l([property(colour, red)]) : a <- b.")[0][:2] == (1, 13)
    assert warnings_of("event_rule_property(l, colour, red).")[0][:2] == (1, 24)
