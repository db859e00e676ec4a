"""Language features for editors: problems, completion, hover, definitions, references and renaming.

The functions take the text of a file and an offset in it, and return plain data; they know no protocol.
"""

import os
import re
from functools import lru_cache
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from ..engine.engine_settings import Settings
from ..engine.program_check import check_program
from ..events.checks.check_runner import Finding
from ..events.language.event_operators import EVENT_OPERATORS, EVENT_OPERATORS_BY_NAME, OperatorKind
from ..events.program.topic_configuration import (
    ATTRIBUTE_VALUES,
    ATTRIBUTES,
    GOALS,
    ROOT_ATTRIBUTES,
    ROOT_ELEMENT,
    TOPICS,
)
from ..foundation.displayed_text import printable
from ..foundation.errors import MessageError, UsageError
from ..foundation.source_places import Place
from ..foundation.unsaved_files import unsaved_files
from ..messages.message_templates import format_with_names
from ..messages.type_definition import Constant, Definition, type_name
from ..messages.type_registry import Definitions
from ..prolog.syntax.literals import atom_text
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import read_term
from ..prolog.syntax.term_writer import write_term
from ..prolog.terms.types import Var, deref, functor_name
from .clause_reader import ClauseReader, ParsedClause
from .completion_context import CompletionContext, WindowPath, find_context, find_xml_context
from .formatter import format_goals, format_rules
from .program_index import ProgramIndex
from .rule_verbalization import describe_rule
from .symbol_uses import ANY_ARITY, ProgramSymbol, SymbolKind

_WORD = re.compile(r"\w+|[-+*/\\^<>=~:.?@#&$]+")
_MAX_SHOWN_DEFINITIONS = 3


class Problem(NamedTuple):
    """An error or a likely mistake in a file.

    Attributes:
        line: line from 0.
        column: column from 0, in characters.
        end_column: column after the text that it is about.
        severity: ``error``, ``warning`` or ``info``.
        code: its code, such as ``RT1201``.
        message: its text.
    """

    line: int
    column: int
    end_column: int
    severity: str
    code: str
    message: str


def find_problems(
    folder: str, unsaved_texts: Mapping[str, str], definitions: Definitions, settings: Settings
) -> Dict[str, List[Problem]]:
    """Check a program; return its problems by the real paths of its files.

    Problems without a place are those of the folder.

    Args:
        folder: folder of the program, or its only file.
        unsaved_texts: texts that replace those of the disk, by real paths.
        definitions: known message types.
        settings: settings of the engine that loads the program.
    """
    with unsaved_files(unsaved_texts):
        findings = check_program(Path(folder), definitions, settings=settings)
    problems: Dict[str, List[Problem]] = {}
    for finding in findings:
        place = finding.problem.place
        path = folder if place is None else os.path.realpath(place.source)
        problems.setdefault(path, []).append(_problem_of(finding, place))
    return problems


def _problem_of(finding: Finding, place: Optional[Place]) -> Problem:
    line = column = end_column = 0
    if place is not None:
        line, column = place.line - 1, place.column - 1
        word = _WORD.match(place.text, column - place.before)
        end_column = column + (len(word[0]) if word is not None else 1)
    message = printable(finding.problem.message)
    return Problem(line, column, end_column, finding.severity, finding.problem.code, message)


# Documentation of names


class PredicateHelp(NamedTuple):
    """A built-in predicate: its call with modes, its meaning, and the page that documents it."""

    call: str
    meaning: str
    page: str


class Hover(NamedTuple):
    """A text in Markdown about a part of a file."""

    text: str
    start: int
    end: int


def hover(
    path: str,
    offset: int,
    index: ProgramIndex,
    definitions: Definitions,
    predicates: Mapping[str, Sequence[PredicateHelp]],
) -> Optional[Hover]:
    """Return what an editor shows about the name at an offset of a file, or None.

    Args:
        path: real path of the file.
        offset: the offset.
        index: the program of the file.
        definitions: known message types.
        predicates: built-in predicates by their names.
    """
    use = index.use_at(path, offset)
    if use is not None:
        text = _describe_symbol(use.symbol, index, definitions, predicates)
        return Hover(text, use.start, use.end) if text else None
    source = index.files[path].text if path in index.files else ""
    for word in _WORD.finditer(source, max(0, source.rfind("\n", 0, offset))):
        if word.start() > offset:
            break
        if offset <= word.end():
            text = (
                _constant_at(path, source, word, index, definitions)
                or _describe_operator(word[0])
                or _reading_at(path, source, word.start(), word[0])
            )
            return Hover(text, word.start(), word.end()) if text else None
    return None


def _constant_at(
    path: str, text: str, word: "re.Match[str]", index: ProgramIndex, definitions: Definitions
) -> str:
    """Return the type, name and value of a constant in curly brackets, or ""."""
    if text[word.start() - 1 : word.start()] != "{":
        return ""
    context = find_context(text, word.start(), os.path.basename(path) == GOALS)
    if context is None or not context.message_path:
        return ""
    definition, _ = _enclosing_type(context, index, definitions)
    constants = () if definition is None else definition.constants
    return "\n".join(f"`{_describe_constant(item)}`" for item in constants if item.name == word[0])


def _describe_operator(name: str) -> str:
    for operator in EVENT_OPERATORS:
        if name in operator.spellings and operator.table_rows:
            return "\n\n".join(f"{row.notation}: {row.matched}" for row in operator.table_rows)
    return ""


def _reading_at(path: str, text: str, offset: int, word: str) -> str:
    """Return the reading of the rule whose arrow is at an offset."""
    return describe_rule_at(path, text, offset) if word in ("<-", "iff") else ""


def describe_rule_at(path: str, text: str, offset: int) -> str:
    """Return the reading of the rule that contains an offset, or ""."""
    for clause in ClauseReader(text, path):
        if isinstance(clause, ParsedClause) and clause.tokens[0][2] <= offset < clause.tokens[-1][3]:
            return describe_rule(clause)
    return ""


def _describe_symbol(
    symbol: ProgramSymbol,
    index: ProgramIndex,
    definitions: Definitions,
    predicates: Mapping[str, Sequence[PredicateHelp]],
) -> str:
    sections = []
    if symbol.kind is SymbolKind.FUNCTOR:
        definition = message_type(symbol.name, index, definitions)
        if definition is not None:
            sections.append(f"```prolog\n{format_with_names(definition)}```")
    uses = index.definitions_of(symbol)
    for file, use in uses[:_MAX_SHOWN_DEFINITIONS]:
        line = file.text.count("\n", 0, use.start) + 1
        reading = describe_rule_at(file.path, file.text, use.start) if _has_rules(file.path) else ""
        text = file.text[use.clause_start : use.clause_end]
        language = "xml" if text.startswith("<") else "prolog"
        sections.append(f"{os.path.basename(file.path)}, line {line}\n```{language}\n{text}\n```\n{reading}")
    if len(uses) > _MAX_SHOWN_DEFINITIONS:
        sections.append(f"and {len(uses) - _MAX_SHOWN_DEFINITIONS} more")
    if symbol.kind is SymbolKind.FUNCTOR and not uses:
        sections += [
            f"`{entry.call}`\n\n{entry.meaning}\n\n{entry.page}" for entry in predicates.get(symbol.name, ())
        ]
    return "\n\n".join(section.strip() for section in sections)


def _has_rules(path: str) -> bool:
    return os.path.basename(path) not in (GOALS, TOPICS)


def message_type(name: str, index: ProgramIndex, definitions: Definitions) -> Optional[Definition]:
    """Return the message type of the events with a name, or None."""
    message_type_name = index.event_types().get(name) or type_name(name)
    if message_type_name is None:
        return None
    try:
        return definitions.find(message_type_name)
    except MessageError:
        return None


# Completion


class Completion(NamedTuple):
    """A name that can be inserted at a position.

    Attributes:
        kind: ``slot``, ``constant``, ``event``, ``message``, ``predicate``, ``operator``, ``memory``, ``topic`` or
            ``variable``; in ``pub_sub.xml`` ``element``, ``attribute`` or ``value``.
        detail: its arguments or type.
        documentation: its meaning.
    """

    name: str
    kind: str
    detail: str
    documentation: str
    text: str


def complete(
    path: str,
    text: str,
    offset: int,
    index: ProgramIndex,
    definitions: Definitions,
    predicates: Mapping[str, Sequence[PredicateHelp]],
) -> List[Completion]:
    """Return the names that fit at an offset; the editor selects those that begin with the word before it.

    Args:
        path: real path of the file.
        text: its text.
        offset: the offset.
        index: the program of the file.
        definitions: known message types.
        predicates: built-in predicates by their names.
    """
    if os.path.basename(path) == TOPICS:
        return list(_complete_topics(text, offset))
    is_goal_file = os.path.basename(path) == GOALS
    context = find_context(text, offset, is_goal_file)
    if context is None:
        return []
    if context.message_path:
        return list(_slots(context, index, definitions)) if context.is_slot_name else []
    if context.symbol_kind is not None:
        kind = context.symbol_kind.name.lower()
        symbols = index.symbols(context.symbol_kind)
        return [
            Completion(symbol.name, kind, context.symbol_kind.value, "", atom_text(symbol.name))
            for symbol in symbols
        ]
    if context.window_path in _window_parts():
        return _window_parts()[context.window_path]
    return list(_names(context, is_goal_file, index, predicates))


@lru_cache(maxsize=1)
def _window_parts() -> Dict[WindowPath, List[Completion]]:
    """Return the names that may begin a window, or an argument in a window, from the table of windows."""
    notations: Dict[WindowPath, Dict[str, List[str]]] = {}
    for reading in EVENT_OPERATORS_BY_NAME["aggregate_over"].readings:
        read = read_term(reading.notation, Operators.prolog())
        aggregate: Any = read.term
        variable_names = {var: name for name, var in read.names.items()}
        window_path = (("aggregate", 4),)
        stack: List[Tuple[WindowPath, Any]] = [(window_path, aggregate[4])]
        while stack:
            path, term = stack.pop()
            part: Any = deref(term)
            if part.__class__ is Var:
                continue
            line = f"`{write_term(part, variable_names=variable_names)}`"
            if path == window_path:
                line = f"{line}: {reading.words}"
            notations.setdefault(path, {}).setdefault(functor_name(part), []).append(line)
            if part.__class__ is tuple:
                stack += [((*path, (part[0].name, number)), part[number]) for number in range(1, len(part))]
    return {
        path: [
            Completion(name, "operator", "window", "\n\n".join(dict.fromkeys(lines)), name)
            for name, lines in lines_by_name.items()
        ]
        for path, lines_by_name in notations.items()
    }


def _complete_topics(text: str, offset: int) -> Iterator[Completion]:
    """Yield the elements, attributes and values that fit at an offset of a ``pub_sub.xml``."""
    context = find_xml_context(text, offset)
    if context is None:
        return
    if context.attribute:
        values: Sequence[str]
        if context.element == ROOT_ELEMENT:
            values = ROOT_ATTRIBUTES.get(context.attribute, ())
        else:
            has_attribute = context.attribute in ATTRIBUTES.get(context.element, ())
            values = ATTRIBUTE_VALUES.get(context.attribute, ()) if has_attribute else ()
        for value in values:
            yield Completion(value, "value", context.attribute, "", value)
    elif context.element:
        is_root = context.element == ROOT_ELEMENT
        names: Sequence[str] = tuple(ROOT_ATTRIBUTES) if is_root else ATTRIBUTES.get(context.element, ())
        for position, name in enumerate(names):
            if name not in context.given_attributes:
                detail = "optional" if is_root or position > 1 else "required"
                yield Completion(name, "attribute", detail, "", f"{name}=")
    elif not context.has_root:
        yield Completion(ROOT_ELEMENT, "element", "root element", "", ROOT_ELEMENT)
    else:
        for name, attributes in ATTRIBUTES.items():
            yield Completion(name, "element", ", ".join(attributes), "", name)


def _slots(context: CompletionContext, index: ProgramIndex, definitions: Definitions) -> Iterator[Completion]:
    """Yield the slots of the message around a position, and after its bracket the constants."""
    definition, is_message = _enclosing_type(context, index, definitions)
    if definition is None:
        return
    for field in definition.fields if is_message else ():
        if field.name not in context.named_slots:
            yield Completion(field.name, "slot", field.describe(), "", f"{field.name}: ")
    for constant in () if context.named_slots else definition.constants:
        yield Completion(constant.name, "constant", _describe_constant(constant), "", constant.name)


def _enclosing_type(
    context: CompletionContext, index: ProgramIndex, definitions: Definitions
) -> Tuple[Optional[Definition], bool]:
    """Return the type of the message around a position, and whether the innermost bracket is that of a message.

    A bracket in a slot that has no message contains a constant of the enclosing message.
    """
    name, *slots = context.message_path
    definition = message_type(name, index, definitions)
    is_message = True
    for slot in slots:
        fields = () if definition is None else definition.fields
        field = next((field for field in fields if field.name == slot), None)
        is_message = field is None or field.definition is not None
        if is_message:
            definition = None if field is None else field.definition
    return definition, is_message


def _describe_constant(constant: Constant) -> str:
    return f"{constant.type} {constant.name}={constant.text}"


def _names(
    context: CompletionContext,
    is_goal_file: bool,
    index: ProgramIndex,
    predicates: Mapping[str, Sequence[PredicateHelp]],
) -> Iterator[Completion]:
    """Yield the names of events, predicates, operators and variables."""
    for variable in context.variables:
        yield Completion(variable, "variable", "", "", variable)
    for operator in () if is_goal_file else EVENT_OPERATORS:
        if operator.kind is not OperatorKind.UNSUPPORTED and operator.name.isidentifier():
            rows = "\n".join(f"{row.notation}: {row.matched}" for row in operator.table_rows)
            yield Completion(operator.name, "operator", operator.kind.value, rows, operator.name)
    for symbol in index.symbols(SymbolKind.FUNCTOR):
        kind = "message" if symbol.arity == ANY_ARITY else "event"
        yield Completion(symbol.name, kind, str(symbol), "", atom_text(symbol.name))
    for name, entries in predicates.items():
        calls = "\n".join(f"{entry.call}: {entry.meaning}" for entry in entries)
        yield Completion(name, "predicate", entries[0].call, calls, atom_text(name))


# Renaming


class Edit(NamedTuple):
    """A replacement of a part of a text."""

    start: int
    end: int
    text: str


def rename(
    symbol: ProgramSymbol,
    new_name: str,
    index: ProgramIndex,
    predicates: Mapping[str, Sequence[PredicateHelp]],
) -> Dict[str, List[Edit]]:
    """Return the changes that give a symbol another name, by the paths of the files.

    Raises:
        UsageError: if the symbol cannot be renamed, or the program has a symbol of the new name.
    """
    check_renamable(symbol, index, predicates)
    edits: Dict[str, List[Edit]] = {}
    for old, new in _renamed_symbols(symbol, new_name, index):
        if any(True for _ in index.uses_of(new)):
            raise UsageError(f"cannot rename {symbol}: the program has {new} already")
        for file, use in index.uses_of(old):
            is_xml = os.path.basename(file.path) == TOPICS
            name = new.name[: len(new.name) - len(use.suffix)]
            if is_xml and not name.replace("/", "").replace("~", "").isidentifier():
                raise UsageError(f"cannot rename {symbol}: '{name}' is not a name of ROS")
            edit = Edit(use.start, use.end, name if is_xml else atom_text(name))
            file_edits = edits.setdefault(file.path, [])
            # The names of an action's events are one text in `pub_sub.xml`.
            if edit not in file_edits[-1:]:
                file_edits.append(edit)
    return edits


def _renamed_symbols(
    symbol: ProgramSymbol, new_name: str, index: ProgramIndex
) -> List[Tuple[ProgramSymbol, ProgramSymbol]]:
    """Return the symbols that get other names with a symbol, each with the new one: all events of an action."""
    if not new_name.strip() or "\n" in new_name:
        raise UsageError(f"cannot rename {symbol}: expected a name")
    definition = next((entry for entry in index.definitions_of(symbol) if entry.use.suffix), None)
    if definition is None:
        return [(symbol, symbol._replace(name=new_name))]
    suffix = definition.use.suffix
    if not new_name.endswith(suffix):
        raise UsageError(
            f"cannot rename {symbol}: {TOPICS} defines it: expected a name that ends with '{suffix}'"
        )
    base = new_name[: -len(suffix)]
    uses = index.uses_at(definition.file.path, definition.use.start)
    return [(use.symbol, use.symbol._replace(name=f"{base}{use.suffix}")) for use in uses]


def check_renamable(
    symbol: ProgramSymbol, index: ProgramIndex, predicates: Mapping[str, Sequence[PredicateHelp]]
) -> None:
    """Check that a symbol belongs to the program.

    Raises:
        UsageError: if it is a message type, or is built in.
    """
    if symbol.kind is not SymbolKind.FUNCTOR:
        return
    if type_name(symbol.name) is not None:
        raise UsageError(f"cannot rename {symbol}: it is a message type")
    if symbol.name in predicates and not index.definitions_of(symbol):
        raise UsageError(f"cannot rename {symbol}: it is built in")


def format_file(path: str, text: str) -> str:
    """Return the text of a file in the uniform layout; that of ``pub_sub.xml`` as it is.

    Raises:
        ProgramErrors: all syntax errors.
    """
    name = os.path.basename(path)
    if name == TOPICS:
        return text
    return format_goals(text, path) if name == GOALS else format_rules(text, path)
