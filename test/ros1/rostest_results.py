"""Failed test cases in the JUnit XML files that rostest writes."""

from pathlib import Path
from typing import Any, List
from xml.etree import ElementTree

MAX_MESSAGE_LINES = 30
"""Maximum number of lines shown of the message of a test case: the last ones, which name the error."""


def failed_cases(folder: Path) -> List[Any]:
    """Return the failed test cases of all XML files in a folder and below it, each as a text with its message."""
    return [text for path in sorted(folder.rglob("*.xml")) for text in _failures_in(path)]


def _failures_in(path: Any) -> List[str]:
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        # A process that was killed leaves an incomplete file.
        return [f"{path.name}: malformed XML: {error}"]
    return [
        f"{case.get('classname', '')}.{case.get('name', '')}: {_shortened(outcome)}"
        for case in root.iter("testcase")
        for outcome in case
        if outcome.tag in ("failure", "error")
    ]


def _shortened(outcome: Any) -> str:
    """Return the last lines of the message of a failure or error."""
    lines = (outcome.text or outcome.get("message") or outcome.get("type") or "").strip().splitlines()
    # The last line names the exception; pytest shows the first line of an assertion in its summary.
    return "\n    ".join([lines[-1], *lines[-MAX_MESSAGE_LINES:-1]]) if lines else "no message"


def failure_report(folder: Any, log: Any) -> str:
    """Return the message of a failed rostest: the failed test cases, then the log."""
    cases = failed_cases(folder) or ["no test case has failed: see the end of the log"]
    return "\n".join([*cases, "", "---- log of rostest ----", log])
