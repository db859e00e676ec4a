"""Why a rule did not fire in which operators on streams stand."""

import pytest

from retalis.engine import Engine
from retalis.engine.explaining import explain, record_origins

STREAM = (("in(1)", 1), ("in(2)", 2), ("no", 3), ("tick", 4))
NOT_FIRED = {
    "w(9) <- aggregate(count, in(_), N, last(5)).": None,
    "w(N) <- aggregate(count, in(_), N, last(5)).": "but with other results",
    "w(X) <- aggregate(count, never, X, every(5)).": "aggregate over every(5.0): nothing was measured",
    "w(X) <- never(X) with throttle(5).": "with throttle(5.0): nothing to let through",
    "w(X) <- (in(_) with debounce(5)) seq in(X).": "debounce(5.0): the 5 seconds after the last one are not over",
    "w(9) <- (in(X) with change(X)) where X > 2.": "where A > 2: false for all",
    "w(9) <- (in(2) with throttle(1)) where false.": "where false: false for all",
    "w(9) <- in(2) seq absent(no, 5).": "absent 5: the time after it is not over",
    "w(9) <- in(2) seq absent(no, 1.5).": "absent 1.5: ruled out by what must not happen",
    "w(9) <- never seq absent(no, 1.5).": "absent 1.5: nothing to rule out",
    "w(9) <- in(_) with throttle(5) do fail.": "throttle did not let it through after others",
}


@pytest.mark.parametrize("rule", NOT_FIRED)
def test_what_kept_it_from_firing(rule):
    engine = Engine()
    record_origins(engine)
    engine.load(rules=rule)
    for event, end in STREAM:
        engine.event(event, end)
    wanted = NOT_FIRED[rule]
    text = str(explain(engine, "w(9)"))
    assert wanted is None or wanted in text, text
