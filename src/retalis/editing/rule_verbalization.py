"""Readings of event rules in words, for people who are learning the operators.

The words are beside the definitions: those of patterns in the table of event operators, which are also the table of
patterns in the documentation (the row ``P seq Q`` has the words "P ended before Q started"), those of aggregates,
heads and properties of labels in their tables. The row with the longest notation that fits a pattern is used;
operands that are patterns themselves are explained below it.
"""

import os
import re
from functools import lru_cache, partial
from itertools import islice
from math import isfinite
from typing import Any, Dict, Iterable, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple, cast

from ..events.language.event_operators import ARROWS, EVENT_OPERATORS, OPERATOR_NAMES
from ..events.language.row_pattern_parser import SKIP_STRATEGIES
from ..events.language.rule_heads import HEAD_READINGS
from ..events.language.rule_labels import (
    PROPERTY_READINGS,
    ZERO_READINGS,
    is_unlabelled_rule,
    rule_name,
    split_label,
)
from ..events.language.state_parser import StateForm, declares_state, parse_state_declaration
from ..events.language.stream_parser import regroup_rate_operator
from ..events.program.topic_configuration import GOALS, TOPICS, read_text
from ..events.streams.aggregates import AGGREGATES
from ..events.streams.held_value_windows import HELD_AGGREGATES
from ..foundation.displayed_text import format_count, format_duration, shorten
from ..foundation.errors import UsageError
from ..messages.type_definition import type_name
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import read_term
from ..prolog.syntax.term_writer import Portray, write_term
from ..prolog.terms.list_terms import list_items
from ..prolog.terms.term_traversal import variables
from ..prolog.terms.timestamps import to_seconds
from ..prolog.terms.types import COMMA, Atom, Term, Var, atom, deref, functor, functor_name
from .clause_reader import ClauseReader, ParsedClause
from .program_index import ProgramIndexes

_CONSTANT = re.compile(r"\w+\{\w+\}\Z")
"""Name of the atom that `ClauseReader` reads for a constant of a message type."""

_DIRECTIVE = functor(":-", 1)
_SLOT = functor(":", 2)

_MAX_OPERAND_CHARACTERS = 80
"""Maximum length of the text of an operand; the rest is omitted."""
_MAX_READING_LINES = 30
_MAX_NESTED_PATTERNS = 30
"""Maximum depth of a pattern that is described; patterns below it are omitted."""
_NULL_EVENTS = (atom("null"), atom("null_event"))
_LETTER = re.compile(r"`[^`]*`|\b([A-Z][A-Za-z]*)( seconds)?\b")
_PATTERN_LETTERS = ("P", "Q", "R")
"""Letters of operands that are patterns, except R in aggregates."""
_RESULT = "R is K"
_ROW_WORDS = {"t1": "start", "t2": "end", "step": "step name"}
"""Words for the atoms that stand for values of a row in measures of steps."""

_Operands = Dict[str, Term]


class _TableRow(NamedTuple):
    """A row of a table of notations."""

    notation: Term
    letters: Dict[Var, str]
    words: str
    text: str


def _make_rows(readings: Iterable[Tuple[str, str]]) -> List[_TableRow]:
    """Return the rows of notations and their words, those with the longest notation first."""
    rows: Dict[str, _TableRow] = {}
    for notation, words in readings:
        read = read_term(f"x <- {notation}", Operators.prolog())
        term: Any = read.term
        letters = {var: name for name, var in read.names.items()}
        rows.setdefault(notation, _TableRow(deref(term[2]), letters, words, notation))
    return sorted(rows.values(), key=lambda row: -len(row.text))


@lru_cache(maxsize=1)
def _pattern_rows() -> List[_TableRow]:
    readings: List[Tuple[str, str]] = [
        reading for operator in EVENT_OPERATORS for reading in operator.readings
    ]
    for operator in EVENT_OPERATORS:
        for row in operator.table_rows:
            # Without the condition on intervals.
            words = row.matched.partition(": ")[0]
            readings += [(notation, words) for notation in row.notation.split("`")[1::2]]
    return _make_rows(readings)


@lru_cache(maxsize=2)
def _aggregate_rows(is_held: bool) -> List[_TableRow]:
    """Return the rows of aggregates, of held values or of others."""
    functions = HELD_AGGREGATES.values() if is_held else AGGREGATES.values()
    return _make_rows([(function.notation, function.words) for function in functions])


@lru_cache(maxsize=1)
def _head_rows() -> List[_TableRow]:
    return _make_rows(HEAD_READINGS)


def describe_rule(clause: ParsedClause) -> str:
    """Return the reading of an event rule in Markdown, or "" for another clause."""
    label, rule = _split_rule(clause)
    if rule is None:
        return ""
    writer = _ReadingWriter(clause)
    lines = list(islice(writer.describe_rule(label, rule), _MAX_READING_LINES + 1))
    if len(lines) > _MAX_READING_LINES:
        lines[-1] = "- ..."
    return "\n".join(lines)


def _split_rule(clause: ParsedClause) -> Tuple[Optional[Term], Any]:
    """Return the label, if any, and the rule of a clause; (None, None) for another clause."""
    term = deref(clause.term)
    if term.__class__ is not tuple:
        return None, None
    label, rule = split_label(term)
    return (label, rule) if is_unlabelled_rule(rule) else (None, None)


class RuleReading(NamedTuple):
    """The reading of a rule or declared state of a program.

    Attributes:
        path: path of its file.
        line: its first line, from 1.
        name: name of the rule, or the state.
        text: its reading in Markdown.
    """

    path: str
    line: int
    name: str
    text: str


def read_program(path: str) -> Iterator[RuleReading]:
    """Yield the readings of the rules and states of a program, in the order of its files; faulty clauses have none.

    Args:
        path: folder of the program, whose files are those that its goals load by a constant name, or a rule file.
    """
    real_path = os.path.realpath(path)
    paths = [path]
    if os.path.isdir(path):
        index = ProgramIndexes().find(os.path.join(real_path, GOALS), {})
        paths = [os.path.join(path, os.path.relpath(file, real_path)) for file in index.files]
    for file in paths:
        if os.path.basename(file) not in (GOALS, TOPICS):
            yield from _read_file(file)


def _make_portray(names: Dict[Var, str], spacing: bool = False) -> Portray:
    """Return the function that writes constants and named slots of messages as in the program.

    `ClauseReader` reads a message as a term whose arguments are pairs ``Slot:Value``.
    """

    def portray(term: Term) -> Optional[str]:
        if term.__class__ is Atom:
            return term.name if _CONSTANT.match(term.name) else None
        if term.__class__ is not tuple or not (term[0].name == "{}" or type_name(term[0].name) is not None):
            return None
        slots: List[Any] = [deref(argument) for argument in term[1:]]
        if any(slot.__class__ is not tuple or slot[0] is not _SLOT for slot in slots):
            return None
        values = [f"{write(slot[1])}: {write(slot[2])}" for slot in slots]
        name = "" if term[0].name == "{}" else write_term(atom(term[0].name))
        return f"{name}{{{', '.join(values)}}}"

    def write(term: Term) -> str:
        return write_term(
            term, quoted=True, spacing=spacing, variable_names=names, portray=portray, priority=999
        )

    return portray


def _names_of_variables(clause: ParsedClause) -> Dict[Var, str]:
    """Return the names of the variables of a clause; ``_`` for those without a name."""
    names = {var: name for name, var in clause.names.items()}
    return {var: names.get(var, "_") for var in variables(clause.term)}


class _ReadingWriter:
    """Writer of the reading of a rule."""

    def __init__(self, clause: ParsedClause):
        self._names = _names_of_variables(clause)
        self._portray = _make_portray(self._names, spacing=True)

    def quote(self, term: Term) -> str:
        """Return a term as code."""
        text = write_term(term, quoted=True, spacing=True, variable_names=self._names, portray=self._portray)
        if len(text) > _MAX_OPERAND_CHARACTERS:
            text = f"{text[:_MAX_OPERAND_CHARACTERS]}..."
        return f"`{text}`"

    def describe_rule(self, label: Optional[Term], rule: Any) -> Iterator[str]:
        """Yield the lines about a rule: its head, its pattern, and the properties of its label."""
        if rule[0] in ARROWS:
            yield self._describe_head(deref(rule[1]))
            pattern = rule[2]
        else:
            yield f"goal {self.quote(rule[2])} is called when"
            pattern = rule[1]
        yield from self.describe(pattern, 0)
        if label.__class__ is tuple:
            name = label[0].name
            for item in list_items(label[1]) or ():
                property_term: Any = deref(item)
                name_of_property = functor_name(property_term[1])
                readings = ZERO_READINGS if deref(property_term[2]) in (0, 0.0) else {}
                words = readings.get(name_of_property) or PROPERTY_READINGS.get(name_of_property)
                if words is not None:
                    text = self._fill(words, {"V": property_term[2]})
                    yield f"- label `{name}`: {text}"

    def describe_state(self, state: StateForm) -> Iterator[str]:
        """Yield the lines about a declared state."""
        yield f"{self.quote(state.state)} holds, and is emitted when it ends,"
        yield f"- from the end of {self.quote(state.begin_event)}"
        limit = (
            ""
            if state.max_duration is None
            else f", at most {format_duration(to_seconds(state.max_duration))}"
        )
        yield f"- until {self.quote(state.end_event)}{limit}"

    def _describe_head(self, head: Any) -> str:
        if head.__class__ is tuple and OPERATOR_NAMES.get(head[0]) == "do":
            goal = self.quote(head[2])
            event = deref(head[1])
            if event in _NULL_EVENTS:
                return f"goal {goal} is called when"
            return f"goal {goal} is called, and if it succeeds, {self._describe_head(event)}"
        match = _find_row(_head_rows(), head)
        return self._fill(match[0].words, match[1]) if match else f"{self.quote(head)} is emitted when"

    def _fill(
        self, words: str, operands: Mapping[str, Term], texts: Optional[Mapping[str, str]] = None
    ) -> str:
        """Return words with operands instead of their letters.

        Args:
            words: the words of a notation.
            operands: the operands by their letters.
            texts: texts of operands, for those that are not quoted.
        """

        def replace(letter: "re.Match[str]") -> str:
            name, unit = letter[1], letter[2] or ""
            if texts is not None and name in texts:
                return texts[name] + unit
            if name not in operands:
                return letter[0]
            value: Any = deref(operands[name])
            if unit and value.__class__ in (int, float) and isfinite(value):
                return format_duration(value)
            # A word, such as `auto`, is no number of seconds.
            return self.quote(value) + ("" if value.__class__ is Atom else unit)

        return _LETTER.sub(replace, words)

    def describe(self, pattern: Term, level: int, depth: int = 0) -> Iterator[str]:
        """Yield the lines about a pattern.

        Args:
            pattern: the pattern.
            level: level of its indentation.
            depth: number of patterns around it.
        """
        indent = "  " * level
        match = _find_pattern_row(pattern)
        if match is None:
            yield f"{indent}- {self.quote(pattern)} happened"
            return
        if depth > _MAX_NESTED_PATTERNS:
            yield f"{indent}- ..."
            return
        words, operands = match[0].words, match[1]
        rest = "" if "Q" in operands or "R" in operands else _words_after_event(words)
        if rest and "P" in operands and _is_composed(operands["P"]):
            # A condition on a pattern follows the lines of the pattern.
            yield from self.describe(operands["P"], level, depth + 1)
            yield f"{indent}- {self._fill(rest, operands, {'P': 'P'})}"
            return
        has_result = _RESULT in words
        nested = {
            letter: operands[letter]
            for letter in _PATTERN_LETTERS
            if letter in operands and _is_composed(operands[letter]) and not (has_result and letter == "R")
        }
        texts = {letter: f"**{letter}**" for letter in nested}
        if has_result:
            words = self._describe_result(match[0], operands, texts)
        yield f"{indent}- {self._fill(words, operands, texts)}"
        if "S" in operands:
            yield from self._describe_parts(list_items(operands["S"]) or (), level + 1)
        for option in list_items(operands["O"]) or () if "O" in operands else ():
            yield f"{indent}  - {self._describe_step_option(deref(option))}"
        for name, operand in nested.items():
            yield f"{indent}  - **{name}**:"
            yield from self.describe(operand, level + 2, depth + 1)

    def _describe_result(self, row: _TableRow, operands: _Operands, texts: Dict[str, str]) -> str:
        """Return the words of an aggregate with its measures, whose texts are added to ``texts``."""
        kind, result = operands["K"], operands["R"]
        if result.__class__ is Var and self._names.get(result) == "_":
            return row.words.partition(";")[0]
        kinds, results = list_items(kind), list_items(result)
        if kinds is None:
            kinds, results = [kind], [result]
        measures = [self._describe_measure(item, row, operands, texts) for item in kinds]
        if results is None or len(results) != len(measures):
            described = f"{self.quote(result)} is a list with {_join_with_and(measures)}"
        else:
            described = _join_with_and(
                [
                    f"{self.quote(value)} is {measure}"
                    if deref(value).__class__ is Var
                    else f"{measure} is {self.quote(value)}"
                    for value, measure in zip(results, measures)
                ]
            )
        # A letter, because the words of the measures may contain letters of the notation.
        texts["Result"] = described
        return row.words.replace(_RESULT, "Result")

    def _describe_measure(
        self, kind: Term, row: _TableRow, operands: _Operands, texts: Dict[str, str]
    ) -> str:
        kind_term: Any = deref(kind)
        if kind_term.__class__ is tuple and functor_name(kind_term) == "of" and len(kind_term) == 3:
            measure = self._describe_measure(kind_term[2], row, operands, texts)
            return f"{measure} of step {self.quote(kind_term[1])}"
        match = _find_row(_aggregate_rows("held(" in row.text), kind_term)
        if match is None:
            return self.quote(kind)
        # The stamps and the step of a row have names of their own in the measures of steps only.
        measured: Any = deref(match[1].get("X", kind_term))
        if "S" in operands and measured.__class__ is Atom and measured.name in _ROW_WORDS:
            is_plural = match[0].words.endswith(("all X", "different X"))
            texts = {**texts, "X": _ROW_WORDS[measured.name] + ("s" if is_plural else "")}
        return self._fill(match[0].words, {"Q": operands["Q"], **match[1]}, texts)

    def _describe_parts(self, parts: Sequence[Term], level: int) -> Iterator[str]:
        """Yield the lines about the steps of a row pattern and their groups."""
        indent = "  " * level
        for part in map(deref, parts):
            name = functor_name(part)
            inner_parts, words = list_items(part), "these steps"
            if part.__class__ is tuple and name == "or" and len(part) == 3:
                inner_parts, words = (
                    list(part[1:]),
                    "one of these steps; the first one that fits is preferred",
                )
            elif part.__class__ is tuple and name == "permute" and len(part) == 2:
                inner_parts, words = list_items(part[1]), "these steps in any order"
            elif part.__class__ is tuple and name == "group" and list_items(part[1]) is not None:
                inner_parts, words = list_items(part[1]), f"these steps, {_describe_counts(part[2:])}"
            if inner_parts is None or level > _MAX_NESTED_PATTERNS:
                yield f"{indent}- {self._describe_step(part)}"
                continue
            yield f"{indent}- {words}:"
            yield from self._describe_parts(inner_parts, level + 1)

    def _describe_step_option(self, option: Any) -> str:
        """Return a line about an option of a row pattern."""
        strategy: Any = deref(option[1]) if option.__class__ is tuple else option
        known_strategy = SKIP_STRATEGIES.get(functor_name(strategy))
        if known_strategy is None:
            return self.quote(option)
        operands = {"S": strategy[1]} if strategy.__class__ is tuple else {}
        return f"the next match begins {self._fill(known_strategy.words, operands)}"

    def _describe_step(self, step: Any) -> str:
        """Return a line about a step of a row pattern."""
        texts = []
        begin = "after any others, " if functor_name(step) == "later" else ""
        while step.__class__ is tuple and functor_name(step) in ("where", "later") and len(step) <= 3:
            if functor_name(step) == "where" and len(step) == 3:
                texts.append(f"where goal {self.quote(step[2])} has a solution")
            elif len(step) == 2:
                begin = "after any others, "
            step = deref(step[1])
        arguments: List[Any] = [deref(argument) for argument in step[1:]] if step.__class__ is tuple else []
        for argument in arguments:
            if argument.__class__ is tuple and functor_name(argument) == "until":
                texts.append(f"until goal {self.quote(argument[1])} has a solution")
        return f"`{functor_name(step)}`: {begin}{', '.join([_describe_counts(arguments), *texts])}"


def _describe_counts(terms: Sequence[Term]) -> str:
    """Return how often a step or a group matches, given its arguments."""
    arguments: List[Any] = [deref(argument) for argument in terms]
    counts = [argument for argument in arguments if argument.__class__ is int] or [1]
    names = [argument.name for argument in arguments if argument.__class__ is Atom]
    times = "once" if counts[0] == 1 else format_count(counts[0], "time")
    if len(counts) == 2:
        times = "at most once" if counts == [0, 1] else f"{counts[0]} to {format_count(counts[1], 'time')}"
    elif "many" in names:
        times = f"{times} or more" if counts[0] else "any number of times"
    return f"{times}, as few as possible" if "reluctant" in names else times


def _join_with_and(texts: Sequence[str]) -> str:
    """Return texts as a list in words: ``a``, ``a and b``, ``a, b and c``."""
    *others, last = texts
    return f"{', '.join(others)} and {last}" if others else last


def _read_file(path: str) -> Iterator[RuleReading]:
    try:
        text = read_text(path)
    except UsageError:
        # The check reports files that cannot be read.
        return
    line, position = 1, 0
    for clause in ClauseReader(text, path):
        if isinstance(clause, ParsedClause):
            start = clause.tokens[0][2]
            line, position = line + text.count("\n", position, start), start
            label, rule = _split_rule(clause)
            if rule is not None:
                names = _names_of_variables(clause)
                show = partial(write_term, quoted=True, variable_names=names, portray=_make_portray(names))
                name = rule_name(label, _head_event(rule), rule, show)
                yield RuleReading(path, line, name, describe_rule(clause))
            for state in _declared_states(clause):
                writer = _ReadingWriter(clause)
                name = shorten(write_term(state.state, variable_names=_names_of_variables(clause)))
                yield RuleReading(path, line, name, "\n".join(writer.describe_state(state)))


def _declared_states(clause: ParsedClause) -> Iterator[StateForm]:
    """Yield the states that a directive declares."""
    term: Any = deref(clause.term)
    goal: Any = deref(term[1]) if term.__class__ is tuple and term[0] is _DIRECTIVE else None
    goals = [] if goal is None else [goal]
    while goals:
        goal = goals.pop()
        if goal.__class__ is tuple and goal[0] is COMMA:
            goals += [deref(goal[2]), deref(goal[1])]
        elif declares_state(goal):
            try:
                yield parse_state_declaration(goal)
            except UsageError:
                # The check reports malformed declarations.
                continue


def _head_event(rule: Any) -> Optional[Term]:
    """Return the head of a rule without its goal; None if it has none."""
    if rule[0] not in ARROWS:
        return None
    head: Any = deref(rule[1])
    while head.__class__ is tuple and OPERATOR_NAMES.get(head[0]) == "do":
        head = deref(head[1])
    return cast("Term", head)


def _words_after_event(words: str) -> str:
    """Return what the words of a row say about one pattern P beyond that it happened, or ""."""
    beginning = "P happened"
    return words[len(beginning) :].lstrip(",; ") if words.startswith(beginning) else ""


def _is_composed(pattern: Term) -> bool:
    return _find_pattern_row(pattern) is not None


def _find_pattern_row(pattern: Term) -> Optional[Tuple[_TableRow, _Operands]]:
    """Return the row that fits a pattern, with the operands by their letters; None for an event."""
    term: Any = deref(pattern)
    if term.__class__ is tuple and OPERATOR_NAMES.get(term[0]) == "with":
        term = regroup_rate_operator(term) or term
    return _find_row(_pattern_rows(), term)


def _find_row(rows: List[_TableRow], term: Term) -> Optional[Tuple[_TableRow, _Operands]]:
    """Return the row with the longest notation that fits a term, with the operands by their letters."""
    if term.__class__ not in (tuple, Atom):
        return None
    for row in rows:
        operands: _Operands = {}
        if _fits(row.notation, term, row.letters, operands):
            return row, operands
    return None


def _fits(notation: Term, term: Term, letters: Dict[Var, str], operands: _Operands) -> bool:
    """Return whether a term has the form of a notation, and add what its letters stand for."""
    stack = [(deref(notation), deref(term))]
    while stack:
        left, right = stack.pop()
        if left.__class__ is Var:
            letter = letters.get(left, "_")
            # A computed time is no time: ``absent(Q, T * 2)`` is an event.
            if letter == "N" and right.__class__ is tuple:
                return False
            operands[letter] = right
        elif left.__class__ is tuple and right.__class__ is tuple:
            is_same = OPERATOR_NAMES.get(left[0], left[0]) == OPERATOR_NAMES.get(right[0], right[0])
            if not is_same or len(left) != len(right):
                return False
            stack += [(deref(one), deref(other)) for one, other in zip(left[1:], right[1:])]
        elif left != right:
            return False
    return True
