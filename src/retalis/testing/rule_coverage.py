"""Coverage of a program: the parts of its rules and clauses that were used, its subscriptions and its memories.

Counts are read from the engine after a run. Conditions, branches of ``or``, and clauses count their uses themselves,
if the engine was created with `Settings.counts_uses`. For patterns, the events of the run are observed, since a rule
that never fired may still have parts that matched.
"""

from functools import partial
from itertools import islice
from pathlib import Path
from typing import Collection, Dict, Iterable, Iterator, List, NamedTuple, Sequence, Tuple
from xml.etree import ElementTree

from ..engine.engine import Engine
from ..events.language.pattern_tree import EventPattern, Pattern, walk
from ..events.language.rule_labels import rule_title
from ..events.network.event_rule import EventRule
from ..foundation.displayed_text import printable, shorten
from ..foundation.output_files import write_xml
from ..foundation.source_places import line_of
from ..prolog.syntax.term_writer import canonical_text
from ..prolog.terms.term_traversal import variables
from ..prolog.terms.types import Term, functor
from ..prolog.terms.unification import may_unify
from .expectation_checks import functor_of

_INPUT_EVENT = functor("input_event", 1)

MAX_LISTED = 100_000
"""Maximum number of rules, memories and subscriptions that are read from an engine."""

MAX_TEXT_CHARACTERS = 100
"""Maximum length of the text of a part."""

RULE, PATTERN, CONDITION, BRANCH, CLAUSE = "rule", "pattern", "condition", "branch", "clause"
SUBSCRIPTION, MEMORY = "subscription", "memory"
"""Types of parts of a program."""

PART_TYPES = (RULE, PATTERN, CONDITION, BRANCH, CLAUSE, SUBSCRIPTION, MEMORY)


class CoveredPart(NamedTuple):
    """A part of a program, and its use.

    Attributes:
        type: a type of `PART_TYPES`.
        place: file and line of the rule or clause, as ``FILE:LINE``; "" for subscriptions and memories.
        text: the part. A condition has two parts, its outcomes true and false; so has a memory: stored and read.
        uses: matches of a rule or branch, 1 for a pattern that has matched, tests of a condition with this outcome,
            calls of a clause, outputs, or stored events or look-ups of a memory.
        rule: name of the rule; "" for parts that are in no rule.
    """

    type: str
    place: str
    text: str
    uses: int
    rule: str = ""


class _RulePattern(NamedTuple):
    """A pattern of an event in a rule: the rule, the term of the pattern, and its text with its number."""

    rule: EventRule
    term: Term
    text: str


def _event_patterns(pattern: Pattern) -> Iterator[EventPattern]:
    for node in walk(pattern, negated=True):
        if isinstance(node, EventPattern):
            yield node


class CoverageRecorder:
    """Observer of an engine with a loaded program.

    Args:
        engine: the engine, created with `Settings.counts_uses`, before its first event.
        is_restored: whether the engine has been restored from a snapshot. Uses before the snapshot are not counted.
    """

    def __init__(self, engine: Engine, is_restored: bool = False):
        self._engine = engine
        self._rules = engine.program.rules.rules[:MAX_LISTED]
        self._patterns = [pattern for rule in self._rules for pattern in self._read_patterns(rule)]
        self._matched = [False] * len(self._patterns)
        self._unmatched_by_functor: Dict[object, List[int]] = {}
        for number, pattern in enumerate(self._patterns):
            self._unmatched_by_functor.setdefault(functor_of(pattern.term), []).append(number)
        self._uses_before = {_key(part): part.uses for part in self._read_parts()} if is_restored else {}
        engine.on_event(self._observe)

    def _observe(self, term: Term, start: int, end: int) -> None:
        # A variable as pattern has the key None, and matches each event.
        for key in (functor_of(term), None):
            numbers = self._unmatched_by_functor.get(key)
            if not numbers:
                continue
            remaining = [number for number in numbers if not may_unify(self._patterns[number].term, term)]
            for number in set(numbers).difference(remaining):
                self._matched[number] = True
            # Patterns that have matched are not tested again, so that the cost of an event is that of the others.
            self._unmatched_by_functor[key] = remaining

    def parts(self) -> Iterator[CoveredPart]:
        """Yield the parts of the program with their uses."""
        for part in self._read_parts():
            yield part._replace(uses=part.uses - self._uses_before.get(_key(part), 0))

    def _read_parts(self) -> Iterator[CoveredPart]:
        for rule in self._rules:
            text = _shorten(self._show(rule, rule.definition.term))
            yield CoveredPart(RULE, line_of(rule.place), text, rule.metrics.firing_count, rule.name)
        for pattern, is_matched in zip(self._patterns, self._matched):
            rule = pattern.rule
            yield CoveredPart(PATTERN, line_of(rule.place), pattern.text, int(is_matched), rule.name)
        for rule in self._rules:
            yield from self._read_rule(rule)
        for clause in self._engine.program.logic.counted_clauses or ():
            # A declaration for the checks, which no goal calls.
            if functor_of(clause.head) is _INPUT_EVENT:
                continue
            text = _shorten(canonical_text(clause.head))
            yield CoveredPart(CLAUSE, line_of(clause.place), text, clause.use_count)
        status = self._engine.status(MAX_LISTED)
        for subscription in status.subscriptions:
            text = f"{subscription.id} of topic {subscription.topic}"
            yield CoveredPart(SUBSCRIPTION, "", _shorten(text), subscription.sent)
        memories = self._engine.program.knowledge.memories
        for instance in islice(memories, MAX_LISTED):
            name = self._engine.program.logic.brief(instance.id)
            yield CoveredPart(MEMORY, "", _shorten(f"{name}, stored"), instance.memory.added_count)
            yield CoveredPart(MEMORY, "", _shorten(f"{name}, read"), memories.lookup_count(instance.id))

    def _read_patterns(self, rule: EventRule) -> Iterator[_RulePattern]:
        """Yield the different patterns of events in a rule."""
        terms = {self._show(rule, node.term): node.term for node in _event_patterns(rule.definition.pattern)}
        for number, (text, term) in enumerate(terms.items(), 1):
            yield _RulePattern(rule, term, f"{number}, {_shorten(text)}")

    def _read_rule(self, rule: EventRule) -> Iterator[CoveredPart]:
        """Yield the outcomes of the conditions of a rule, and the branches of its ``or`` patterns."""
        if rule.use_counts is None:
            return
        place = line_of(rule.place)
        # Repetitions by ``ntimes`` have the same texts, and are one part.
        outcomes: Dict[str, List[int]] = {}
        for condition, counts in rule.use_counts.outcomes:
            _add_counts(outcomes, self._show(rule, condition.goal), counts)
        for number, (text, (false_count, true_count)) in enumerate(outcomes.items(), 1):
            yield CoveredPart(CONDITION, place, f"{number} true, {_shorten(text)}", true_count, rule.name)
            yield CoveredPart(CONDITION, place, f"{number} false, {_shorten(text)}", false_count, rule.name)
        matches: Dict[str, List[int]] = {}
        for alternatives, counts in rule.use_counts.branch_matches:
            _add_counts(
                matches, "\n".join(map(partial(self._show_events, rule), alternatives.branches)), counts
            )
        branches = [
            (text, count) for key, counts in matches.items() for text, count in zip(key.split("\n"), counts)
        ]
        for number, (text, count) in enumerate(branches, 1):
            yield CoveredPart(BRANCH, place, f"{number}, {_shorten(text)}", count, rule.name)

    def _show_events(self, rule: EventRule, pattern: Pattern) -> str:
        """Return the patterns of events in a branch, in one line."""
        return " ".join(", ".join(self._show(rule, node.term) for node in _event_patterns(pattern)).split())

    def _show(self, rule: EventRule, term: Term) -> str:
        """Return the text of a part of a rule, with the names of its variables."""
        # Variables without names would have other numbers in each run.
        names = {**dict.fromkeys(variables(term), "_"), **rule.definition.names}
        return self._engine.program.logic.brief(term, names)


def _add_counts(sums: Dict[str, List[int]], key: str, counts: Sequence[int]) -> None:
    """Add counts to those of a key."""
    sums[key] = [sum(pair) for pair in zip(sums.get(key, [0] * len(counts)), counts)]


def _key(part: CoveredPart) -> Tuple[str, str, str, str]:
    """Return what identifies a part in several runs."""
    return part.type, part.place, part.text, part.rule


def _shorten(text: str) -> str:
    return shorten(" ".join(text.split()), MAX_TEXT_CHARACTERS)


def merge_parts(runs: Iterable[Iterable[CoveredPart]]) -> List[CoveredPart]:
    """Return the parts of several runs with the sums of their uses, by type and place."""
    merged: Dict[Tuple[str, str, str, str], CoveredPart] = {}
    for parts in runs:
        for part in parts:
            former = merged.get(_key(part))
            merged[_key(part)] = part if former is None else part._replace(uses=former.uses + part.uses)
    return sorted(merged.values(), key=lambda part: PART_TYPES.index(part.type))


def covered_percentage(parts: Sequence[CoveredPart]) -> float:
    """Return the percentage of the parts that were used; 100 if there are none."""
    return 100.0 * sum(1 for part in parts if part.uses) / len(parts) if parts else 100.0


def format_coverage(parts: Sequence[CoveredPart]) -> Iterator[str]:
    """Yield the lines of a table: used and all parts of each type, and the parts that were not used."""
    if not parts:
        yield "coverage: the program has no rules, clauses, subscriptions or memories"
        return
    yield f"{'coverage':<14}{'used':>6}{'all':>6}"
    for part_type in PART_TYPES:
        parts_of_type = [part for part in parts if part.type == part_type]
        if not parts_of_type:
            continue
        used_count = sum(1 for part in parts_of_type if part.uses)
        yield f"{part_type:<14}{used_count:>6}{len(parts_of_type):>6}"
    for part in parts:
        if not part.uses:
            subject = rule_title(part.rule, part.place) if part.rule else part.place
            yield printable(f"not used: {subject and f'{subject}: '}{part.type} {part.text}")
    yield f"{covered_percentage(parts):.0f} % covered"


def group_by_line(parts: Iterable[CoveredPart]) -> Dict[str, Dict[int, List[CoveredPart]]]:
    """Return the parts by file and line."""
    files: Dict[str, Dict[int, List[CoveredPart]]] = {}
    for part in parts:
        file_name, _, line = part.place.rpartition(":")
        if file_name and line.isdecimal():
            files.setdefault(file_name, {}).setdefault(int(line), []).append(part)
    return files


def write_cobertura_report(path: Path, parts: Sequence[CoveredPart]) -> None:
    """Write the coverage of rules and clauses as Cobertura XML.

    The branches of a line are the patterns, outcomes of conditions, and branches of ``or`` of its rules. The rules
    of a file are methods, so that reports have their names.

    Raises:
        UsageError: if the file cannot be written.
    """
    lines = group_by_line(parts)
    rates = _compute_rates(
        [line_parts for file_lines in lines.values() for line_parts in file_lines.values()]
    )
    root = ElementTree.Element("coverage", {**rates, "version": "1", "timestamp": "0"})
    classes = ElementTree.SubElement(
        ElementTree.SubElement(
            ElementTree.SubElement(root, "packages"), "package", {"name": "rules", **rates}
        ),
        "classes",
    )
    for file_name, parts_by_line in lines.items():
        attributes = {
            "name": Path(file_name).stem,
            "filename": file_name,
            **_compute_rates(parts_by_line.values()),
        }
        element = ElementTree.SubElement(classes, "class", attributes)
        methods = ElementTree.SubElement(element, "methods")
        for number, line_parts in sorted(parts_by_line.items()):
            _add_methods(methods, number, line_parts)
        line_elements = ElementTree.SubElement(element, "lines")
        for number, line_parts in sorted(parts_by_line.items()):
            ElementTree.SubElement(line_elements, "line", _describe_line(number, line_parts))
    write_xml(path, root)


def _add_methods(methods: ElementTree.Element, number: int, parts: Sequence[CoveredPart]) -> None:
    """Add the rules of a line as methods."""
    parts_by_rule: Dict[str, List[CoveredPart]] = {}
    for part in parts:
        if part.rule:
            parts_by_rule.setdefault(part.rule, []).append(part)
    for name, rule_parts in parts_by_rule.items():
        attributes = {"name": printable(name), "signature": "", **_compute_rates([rule_parts])}
        method = ElementTree.SubElement(methods, "method", attributes)
        lines = ElementTree.SubElement(method, "lines")
        ElementTree.SubElement(lines, "line", _describe_line(number, rule_parts))


def _compute_rates(lines: Collection[Sequence[CoveredPart]]) -> Dict[str, str]:
    """Return the fractions of covered lines and of covered branches."""
    covered_count = sum(1 for parts in lines if _count_hits(parts))
    branches = [part for parts in lines for part in _list_branches(parts)]
    branch_rate = covered_percentage(branches) / 100
    line_rate = covered_count / len(lines) if lines else 1.0
    return {"line-rate": f"{line_rate:.4f}", "branch-rate": f"{branch_rate:.4f}"}


def _count_hits(parts: Sequence[CoveredPart]) -> int:
    return sum(part.uses for part in parts if part.type in (RULE, CLAUSE))


def _list_branches(parts: Sequence[CoveredPart]) -> List[CoveredPart]:
    return [part for part in parts if part.type not in (RULE, CLAUSE)]


def _describe_line(number: int, parts: Sequence[CoveredPart]) -> Dict[str, str]:
    """Return the attributes of the line of rules or clauses."""
    hits = _count_hits(parts)
    branches = _list_branches(parts)
    attributes = {"number": str(number), "hits": str(hits), "branch": "true" if branches else "false"}
    if branches:
        used_count = sum(1 for part in branches if part.uses)
        percentage = covered_percentage(branches)
        attributes["condition-coverage"] = f"{percentage:.0f}% ({used_count}/{len(branches)})"
    return attributes
