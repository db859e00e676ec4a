"""Windows that select events with a duration by their start."""

from pathlib import Path
from typing import Any, List

import pytest
from asserting_accessors import place_of

from retalis import Definitions, Engine
from retalis.engine.program_check import check_program
from retalis.events.checks.interval_event_window_checks import find_windows_of_long_events
from retalis.events.checks.program_model import ProgramModel
from retalis.events.program.topic_configuration import Topics


def messages_of(rules: str) -> List[Any]:
    """Return the findings in a loaded program."""
    engine = Engine()
    engine.load(rules=rules)
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), Topics())
    return [error.message for error in find_windows_of_long_events(program)]


@pytest.mark.parametrize(
    ("rules", "cause"),
    [
        ("long <- a seq b.", "long/0, emitted by a rule with seq"),
        ("long <- a seq absent(b, 5).", "long/0, emitted by a rule with absent"),
        ("long <- a and b.", "long/0, emitted by a rule with and"),
        ("long <- a ntimes 3.", "long/0, emitted by a rule with seq"),
        ("long <- a seq star(b) seq c.", "long/0, emitted by a rule with seq"),
        ("long <- aggregate(count, a, N, every(5)) where N > 2.", "long/0, emitted by a rule with aggregate"),
        ("exceptionAlarm(long, 5) <- a.", "long/0, emitted by a rule with exceptionAlarm"),
        ("mid <- a seq b. long <- mid where true.", "long/0, emitted for mid/0"),
        (":- state(long, from(a), until(b)).", "long/0, a declared state"),
    ],
)
def test_window_of_event_with_duration_is_reported(rules: str, cause: str) -> None:
    (message,) = messages_of(f"{rules}\nn(N) <- aggregate(count, long, N, last(60)).")
    assert f"({cause})" in message
    assert message.startswith("last(60) selects its elements by their start")
    assert "to select by the end, measure at_end(long);" in message


@pytest.mark.parametrize("pattern", ["(a seq b)", "(a seq absent(b, 5))", "((a or (b and c)) where true)"])
def test_window_of_a_composed_pattern_is_reported(pattern: str) -> None:
    (message,) = messages_of(f"n(N) <- aggregate(count, {pattern}, N, last(60)).")
    assert "write at_end(...) around what is measured" in message


@pytest.mark.parametrize(
    "rules",
    [
        "n(N) <- aggregate(count, a, N, last(60)).",
        "short <- a where true. n(N) <- aggregate(count, short, N, last(60)).",
        "short <- a equals b. n(N) <- aggregate(count, short, N, last(60)).",
        "short <- a cnot b. n(N) <- aggregate(count, short, N, last(60)).",
        "long <- a seq b. n(N) <- aggregate(count, at_end(long), N, last(60)).",
        "n(N) <- aggregate(count, at_start(a seq b), N, last(60)).",
        "long <- a seq b. short <- at_end(long). n(N) <- aggregate(count, short, N, last(60)).",
        "long <- a seq b. n(N) <- aggregate(count, long, N, every(60)).",
        "long <- a seq b. n(N) <- aggregate(count, long, N, last(60, every(5))).",
        "long <- a seq b. n(N) <- aggregate(count, long, N, last(5, events)).",
        "long <- a seq b. null do new_event(end, [E, E]) <- long check t2(E). "
        "n(N) <- aggregate(count, end, N, last(60)).",
    ],
)
def test_other_windows_are_not_reported(rules: str) -> None:
    assert messages_of(rules) == []


def test_comment_suppresses_finding_of_window(tmp_path: Path) -> None:
    path = tmp_path / "rules.txt"
    rule = "n(X, N) <- aggregate(count, a(X), _, last(1)) seq aggregate(count, long(X), N, last(2))."
    path.write_text(f"long(X) <- a(X) seq b(X).\n{rule}\n")
    (finding,) = check_program(path, Definitions())
    assert (finding.severity, finding.problem.code) == ("info", "RT1211")
    assert (place_of(finding.problem).line, place_of(finding.problem).column) == (
        2,
        rule.index("last(2)") + 1,
    )
    assert "to select by the end, measure at_end(long(X));" in finding.problem.message
    path.write_text(f"long(X) <- a(X) seq b(X).\n{rule} % retalis: ignore=RT1211\n")
    assert check_program(path, Definitions()) == []


def test_advised_rule_counts_by_the_end() -> None:
    engine = Engine()
    engine.load(
        rules="""
        long(X) <- a(X) seq b(X).
        null do new_event(long_end(X), [E, E]) <- long(X) check t2(E).
        by_start(N) <- aggregate(count, long(_), N, last(3600)).
        by_end(N) <- aggregate(count, long_end(_), N, last(3600)).
        """
    )
    counts: List[Any] = []
    engine.on_event(lambda term, start, end: counts.append(engine.show(term)))
    for event, instant in (("a(x)", 10), ("b(x)", 20), ("a(y)", 3600), ("b(y)", 3615)):
        engine.event(event, instant)
    # The first event began 3,605 s before the end of the second one, and ended 3,595 s before it.
    by_start, by_end = ([text for text in counts if text.startswith(name)] for name in ("by_start", "by_end"))
    assert (by_start, by_end) == (["by_start(1)", "by_start(1)"], ["by_end(1)", "by_end(2)"])
