"""Golden files: the outputs of a case as JSON lines, which a person has accepted.

Each line has the fields ``time`` (seconds since the start of the case), ``topic``, ``id`` and ``output`` (the term).
"""

import json
from pathlib import Path
from typing import Any, Iterable, Iterator, Sequence

from ..foundation.errors import UsageError
from ..foundation.output_files import write_text
from ..foundation.source_places import Place, place_at_column
from ..prolog.syntax.term_writer import canonical_text
from ..prolog.terms import timestamps
from .case_definition import DEFAULT_WITHIN, ExpectedItem, TermText, Tolerance
from .expectation_checks import RunItem
from .yaml_documents import CaseFileError

_FIELDS = {"time": (int, float), "topic": (str,), "output": (str,)}


def read_golden_file(path: Path) -> Iterator[ExpectedItem]:
    """Yield the expected outputs of a golden file.

    Raises:
        CaseFileError: if the file cannot be read, or a line is wrong.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise CaseFileError(f"there is no golden file {path}: retalis test --update writes it") from None
    except (OSError, UnicodeDecodeError) as error:
        raise CaseFileError(f"cannot read {path}: {error}") from None
    for number, line in enumerate(lines, 1):
        if line.strip():
            yield _parse_line(line, place_at_column(str(path), number, 1, line))


def _parse_line(line: str, place: Place) -> ExpectedItem:
    try:
        record: Any = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise CaseFileError(f"not a line of JSON: {error}", place) from None
    if not isinstance(record, dict):
        raise CaseFileError("expected an object with the fields time, topic, id and output", place)
    for name, classes in _FIELDS.items():
        if not isinstance(record.get(name), classes) or isinstance(record.get(name), bool):
            raise CaseFileError(f"field '{name}': expected a {classes[-1].__name__}", place)
    subscription_id = record.get("id")
    if not (subscription_id is None or isinstance(subscription_id, str)):
        raise CaseFileError("field 'id': expected a str or null", place)
    return ExpectedItem(
        term=TermText(record["output"], place),
        message=None,
        topic=record["topic"],
        id=None if subscription_id is None else TermText(subscription_id, place),
        time=timestamps.from_seconds(record["time"]),
        start=None,
        within=DEFAULT_WITHIN,
        tolerance=Tolerance(),
        slot_tolerances={},
        occurrences=None,
        place=place,
    )


def format_golden_lines(outputs: Iterable[RunItem]) -> Iterator[str]:
    """Yield the lines of a golden file for the outputs of a run."""
    for output in outputs:
        record = {
            "time": timestamps.to_shortest_seconds(output.time),
            "topic": output.topic,
            "id": None if output.id is None else canonical_text(output.id),
            "output": canonical_text(output.term),
        }
        yield json.dumps(record)


def write_golden_file(path: Path, lines: Sequence[str]) -> None:
    """Write a golden file, in place of an existing one.

    Raises:
        CaseFileError: if it cannot be written.
    """
    try:
        write_text(path, "".join(f"{line}\n" for line in lines))
    except UsageError as error:
        raise CaseFileError(error.message) from error
