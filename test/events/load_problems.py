"""Errors and warnings of loaded rules, each as line, column and message."""

from typing import Any, List, Tuple

import pytest
from events.program_runner import ProgramRunner

from retalis import ProgramErrors


def errors_of(rules: str) -> List[Any]:
    """Return the errors for which a text is refused; none of its rules is active."""
    program = ProgramRunner()
    with pytest.raises(ProgramErrors) as caught:
        program.engine.load(rules=rules)
    assert program.engine.rules.rules == []
    return [_shown(error) for error in caught.value.errors]


def assert_refused(rule: Any, column: Any, part: Any) -> None:
    """Check that a rule in the second line is refused for one error, at this column and with this text."""
    ((line, actual_column, message),) = errors_of(f"% first\n{rule}")
    assert line == 2
    assert part.lower() in message.lower()
    assert actual_column == column


def warnings_of(rules: Any) -> List[Any]:
    """Return the warnings for a text that is accepted."""
    return [_shown(warning) for warning in ProgramRunner(rules).warnings]


def _shown(problem: Any) -> Tuple[Any, ...]:
    return problem.place.line, problem.place.column, problem.message
