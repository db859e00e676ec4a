"""Results of cases and coverage of programs as one HTML page, which loads nothing from elsewhere.

The page has a table of the cases and, for each file of the program, its source. A rule or clause is covered, partly
covered, or not covered. Besides its colour, its first line has a sign, and the parts that were not used are listed
below it.
"""

from html import escape
from pathlib import Path
from typing import Dict, Iterable, Iterator, List, NamedTuple, Sequence, Tuple

from ..editing.clause_reader import ClauseReader, ParsedClause
from ..foundation.displayed_text import format_count, printable
from ..foundation.output_files import write_text
from .rule_coverage import CLAUSE, PART_TYPES, RULE, CoveredPart, covered_percentage, group_by_line

MAX_SOURCE_LINES = 20_000
"""Maximum number of lines of a file that are shown."""

_MAX_CLAUSE_LINES = 500
"""Maximum number of lines that are searched for the end of a rule or clause."""

_SIGNS = {"covered": "\u2713", "partly": "~", "uncovered": "\u2717"}
_MEANINGS = {"covered": "covered", "partly": "partly covered", "uncovered": "not covered"}

_STYLE = """\
:root { color-scheme: light dark; --ground: #fff; --ink: #1c2430; --dim: #5b6675; --line: #d5dae1;
  --covered: #e2f3e5; --partly: #fdf0cf; --uncovered: #fbdfdc; }
@media (prefers-color-scheme: dark) { :root { --ground: #14181d; --ink: #e6eaf0; --dim: #98a4b3; --line: #313a45;
  --covered: #16351f; --partly: #43340f; --uncovered: #4a1d1a; } }
body { margin: 0 auto; max-width: 75rem; padding: 1rem; background: var(--ground); color: var(--ink);
  font: 14px/1.5 system-ui, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.4rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
h3 { font: bold .95rem ui-monospace, monospace; }
table { border-collapse: collapse; } .wide { width: 100%; }
th, td { text-align: left; vertical-align: top; padding: .1rem .6rem; }
h1, h3, p, .list td:not(.figure) { overflow-wrap: anywhere; }
.list { margin: .6rem 0; } .list th, .list td { border-bottom: 1px solid var(--line); }
.list td:first-child { white-space: nowrap; } td.figure, th.figure { text-align: right; }
pre, .source td { font: 13px/1.45 ui-monospace, "DejaVu Sans Mono", monospace; }
pre { margin: 0; white-space: pre-wrap; overflow-wrap: anywhere; }
.source { border: 1px solid var(--line); } .source td { padding: 0 .5rem; }
.source td.text { white-space: pre-wrap; overflow-wrap: anywhere; width: 100%; }
.source td.number, .source td.uses { color: var(--dim); text-align: right; user-select: none; }
.source td.sign { font-weight: bold; text-align: center; }
.missing td.text { font-style: italic; } .missing td.text::before { content: "\\21b3  "; }
.covered { background: var(--covered); } .partly { background: var(--partly); }
.uncovered { background: var(--uncovered); } .legend span { padding: 0 .5rem; margin-right: .6rem; }
.failed { font-weight: bold; }
"""


class ReportedCase(NamedTuple):
    """A case in the page, or a test file with an error.

    Attributes:
        place: file and line, or the file.
        name: name of the case; "" for a file.
        seconds: duration.
        failures: texts about what has failed; empty if the case has passed.
    """

    place: str
    name: str
    seconds: float
    failures: Tuple[str, ...]


class _SourceItem(NamedTuple):
    """The rules and clauses that begin in a line, and the last line of the first one; lines count from 1 on."""

    first_line: int
    last_line: int
    parts: List[CoveredPart]

    @property
    def status(self) -> str:
        """The CSS class of the lines."""
        used_count = sum(1 for part in self.parts if part.uses)
        if used_count == len(self.parts):
            return "covered"
        return "partly" if used_count else "uncovered"


def write_html_report(
    path: Path,
    title: str,
    cases: Sequence[ReportedCase] = (),
    parts: Sequence[CoveredPart] = (),
) -> None:
    """Write a page, in place of an existing file.

    Args:
        path: the file.
        title: title of the page.
        cases: the cases; without any, the page has no section for them.
        parts: the parts of the programs with their uses; without any, the page has no coverage.

    Raises:
        UsageError: if the file cannot be written.
    """
    write_text(path, "\n".join(_format_page(title, cases, parts)) + "\n")


def _text(text: str) -> str:
    """Return a text as HTML, also in attributes."""
    return escape(printable(text))


def _format_page(title: str, cases: Sequence[ReportedCase], parts: Sequence[CoveredPart]) -> Iterator[str]:
    yield '<!DOCTYPE html>\n<html lang="en">\n<meta charset="utf-8">'
    # Nothing is loaded, and no script runs, even if a text were not escaped.
    policy = "default-src 'none'; style-src 'unsafe-inline'"
    yield f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<title>{_text(title)}</title>\n<style>\n{_STYLE}</style>\n<h1>{_text(title)}</h1>"
    if cases:
        yield from _format_cases(cases)
    if parts:
        yield from _format_coverage(parts)
    yield "</html>"


def _format_cases(cases: Sequence[ReportedCase]) -> Iterator[str]:
    failed_count = sum(1 for case in cases if case.failures and case.name)
    error_count = sum(1 for case in cases if case.failures and not case.name)
    errors = f", {format_count(error_count, 'file error')}" if error_count else ""
    passed_count = len(cases) - failed_count - error_count
    yield f"<h2>Cases</h2>\n<p>{passed_count} passed, {failed_count} failed{errors}</p>"
    yield '<table class="list wide">\n<tr><th>result<th>case<th>place<th class="figure">seconds'
    for case in cases:
        fault = "failed" if case.name else "file error"
        result = f'<td class="failed uncovered">\u2717 {fault}' if case.failures else "<td>\u2713 passed"
        yield f'<tr>{result}<td>{_text(case.name)}<td>{_text(case.place)}<td class="figure">{case.seconds:.2f}'
        if case.failures:
            yield f'<tr><td><td colspan="3"><pre>{_text_lines(case.failures)}</pre>'
    yield "</table>"


def _text_lines(texts: Iterable[str]) -> str:
    # `printable` would also replace the ends of lines.
    return "\n".join(_text(line) for text in texts for line in text.splitlines())


def _format_coverage(parts: Sequence[CoveredPart]) -> Iterator[str]:
    yield f"<h2>Coverage</h2>\n<p>{covered_percentage(parts):.0f} % of the parts were used.</p>"
    yield '<table class="list">\n<tr><th>part<th class="figure">used<th class="figure">all'
    for part_type in PART_TYPES:
        uses = [part.uses for part in parts if part.type == part_type]
        if uses:
            used_count = sum(1 for count in uses if count)
            yield f'<tr><td>{part_type}<td class="figure">{used_count}<td class="figure">{len(uses)}'
    yield "</table>"
    others = [part for part in parts if not part.place]
    if others:
        yield '<table class="list">\n<tr><th><th>part<th class="figure">uses'
        for part in others:
            status = "covered" if part.uses else "uncovered"
            sign = f'<td title="{_MEANINGS[status]}">{_SIGNS[status]}'
            yield (
                f'<tr class="{status}">{sign}<td>{part.type} {_text(part.text)}<td class="figure">{part.uses}'
            )
        yield "</table>"
    legend = "".join(
        f'<span class="{status}">{_SIGNS[status]} {meaning}</span>' for status, meaning in _MEANINGS.items()
    )
    yield f'<p class="legend">{legend}</p>'
    for file_name, parts_by_line in group_by_line(parts).items():
        yield from _format_file(file_name, parts_by_line)


def _format_file(file_name: str, parts_by_line: Dict[int, List[CoveredPart]]) -> Iterator[str]:
    file_parts = [part for line_parts in parts_by_line.values() for part in line_parts]
    yield f"<h3>{_text(file_name)}, {covered_percentage(file_parts):.0f} %</h3>"
    try:
        lines = Path(file_name).read_text(encoding="utf-8", errors="replace").split("\n")
    except OSError as error:
        yield f"<p>The file cannot be read: {_text(str(error.strerror))}.</p>"
        lines = []
    items = {item.first_line: item for item in _find_items(lines, parts_by_line)}
    yield '<table class="source wide">'
    number = 0
    while number < min(len(lines), MAX_SOURCE_LINES):
        number += 1
        item = items.get(number)
        if item is None:
            yield _format_line("", "", "", number, lines[number - 1])
            continue
        yield from _format_item(item, lines)
        number = item.last_line
    for item in items.values():
        if item.first_line > min(len(lines), MAX_SOURCE_LINES):
            yield from _format_item(item, [])
    yield "</table>"


def _find_items(lines: Sequence[str], parts_by_line: Dict[int, List[CoveredPart]]) -> Iterator[_SourceItem]:
    """Yield the lines in which rules and clauses begin, with the ends of these."""
    starts = sorted(parts_by_line)
    for start, next_start in zip(starts, [*starts[1:], len(lines) + 1]):
        end = min(next_start, start + _MAX_CLAUSE_LINES)
        text = "\n".join(lines[start - 1 : end - 1])
        yield _SourceItem(start, start + _count_line_ends(text), parts_by_line[start])


def _count_line_ends(text: str) -> int:
    """Return the number of ends of lines in the first clause of a text; 0 if it cannot be read."""
    for clause in ClauseReader(text, ""):
        # Operators that another part of the file defines are unknown here.
        return text.count("\n", 0, clause.tokens[-1][3]) if isinstance(clause, ParsedClause) else 0
    return 0


def _format_item(item: _SourceItem, lines: Sequence[str]) -> Iterator[str]:
    """Yield the lines of a rule or clause, and the parts of it that were not used."""
    status = item.status
    missing = [f"not used: {_describe_part(part)}" for part in item.parts if not part.uses]
    uses = sum(part.uses for part in item.parts if part.type in (RULE, CLAUSE))
    tooltip = "\n".join([_MEANINGS[status], *missing])
    for number in range(item.first_line, item.last_line + 1):
        text = lines[number - 1] if number <= len(lines) else item.parts[0].text
        is_first = number == item.first_line
        sign = _SIGNS[status] if is_first else ""
        yield _format_line(status, tooltip, sign, number, text, str(uses) if is_first else "")
    for text in missing:
        yield (
            f'<tr class="{status} missing"><td class="sign"><td class="number"><td class="uses">'
            f'<td class="text">{_text(text)}</td></tr>'
        )


def _describe_part(part: CoveredPart) -> str:
    """Return the text of a part, with the name of its rule; that of a rule begins with its head."""
    name = f"{part.rule}: " if part.rule and part.type != RULE else ""
    return f"{name}{part.type} {part.text}"


def _format_line(status: str, tooltip: str, sign: str, number: int, text: str, uses: str = "") -> str:
    attributes = f' class="{status}" title="{escape(tooltip)}"' if status else ""
    label = f' aria-label="{_MEANINGS[status]}"' if sign else ""
    return (
        f'<tr{attributes}><td class="sign"{label}>{sign}<td class="number">{number}<td class="uses">{uses}'
        f'<td class="text">{_text(text)}</td></tr>'
    )
