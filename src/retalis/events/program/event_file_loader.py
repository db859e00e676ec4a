"""Loader of event files: read, check, then act, with rollback of a load that fails.

1. Read: terms are read and expanded; included files take the place of their directives. Operators are declared in a
   copy of the operator table.
2. Check: `EventFileParser` and the logic check all terms, and rules are compiled. Files that are used are read and
   checked at this point, too, so an error anywhere rejects the whole program. Nothing has changed yet.
3. Act: clauses are added, directives run, rules are activated.

A directive can raise an error in step 3. `LoadRollback` then restores clauses, rules, properties and operators. Side
effects of goals outside of the program are not undone. A load inside a load (a directive that consults a file) has
its own rollback. Warnings about unknown predicates wait until the outermost load has ended.

A file counts as an event file if it contains an event rule, or a directive that calls a predicate of the event
language (`is_event_file`); all others are Prolog programs, which `PrologFileLoader` loads. A regular expression
excludes most Prolog files. Of the others, the terms are read, with the operators and flags that their directives set,
and included files are followed. No directive is executed for this.
"""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

from ...foundation.errors import Errors, ProgramErrors, RetalisError, RuleError, SyntaxFault, UsageError
from ...foundation.source_places import Place
from ...prolog.files.library_names import LIBRARY, check_library
from ...prolog.machine.errors import PrologError
from ...prolog.syntax.operators import Operators
from ...prolog.syntax.term_reader import OF_FILES, Program, ReadTerm, read_program
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.list_terms import conjuncts, list_items
from ...prolog.terms.term_traversal import copy
from ...prolog.terms.types import Atom, Term, deref, functor
from ..language.called_predicates import PredicateCall, calls_in_goals, undefined_call_warnings
from ..language.pattern_parser import no_place
from ..language.pattern_tree import RuleDefinition
from ..language.rule_labels import RULE, Property, is_rule
from ..network.event_rule import EventRule
from ..rules.rule_base import RuleBase
from .conditional_compilation_and_expansion import ConditionalCompilation, TermExpansion
from .event_file_parser import (
    DIRECTIVES,
    PROPERTY_FACT,
    TOO_DEEP,
    EntryKind,
    EventFileParser,
    FileEntry,
    clause_error,
    fact_error,
    included_file_name,
    predicates_defined_in,
)
from .file_directives import Directives
from .prolog_file_loader import PrologFileLoader, PrologSource

if TYPE_CHECKING:
    from os import PathLike

    from ...prolog.files.source_files import SourceFiles

_OP = functor("op", 3)
_SET_FLAG = functor("set_prolog_flag", 2)


class LoadSavepoint:
    """Part of the state before a load that costs little time; it suffices if only rules and properties were added."""

    def __init__(self, rules: RuleBase, loaded: Set[Path]):
        self._rules = rules
        self._loaded = loaded
        self._serial = rules.serial
        self._properties = rules.all_properties()

    def restore(self) -> None:
        """Remove what was added after the savepoint."""
        rules = self._rules
        for rule in list(rules.rules):
            if rule.serial > self._serial:
                rules.remove(rule)
        rules.restore_properties(self._properties)
        rules.files.set_loaded(self._loaded)


class LoadRollback:
    """State of the program before a load: clauses, rules, properties and operators."""

    def __init__(self, rules: RuleBase):
        self._rules = rules
        self._active = set(rules.rules)
        predicates = list(rules.logic.database.predicates.values())
        self._library = [predicate for predicate in predicates if predicate.is_library_predicate]
        self._clauses = {
            predicate: set(predicate.active_clauses()) for predicate in predicates if predicate.kind == "user"
        }
        self._properties = rules.all_properties()
        self._operators = rules.logic.operators.copy()

    def restore(self) -> None:
        """Restore the state."""
        rules = self._rules
        rules.logic.operators.become(self._operators)
        for rule in list(rules.rules):
            if rule not in self._active:
                rules.remove(rule)
        # Library predicates that the file has redefined become visible again.
        for predicate in self._library:
            rules.logic.database.restore_library(predicate)
        for predicate in list(rules.logic.database.predicates.values()):
            if predicate.kind == "user":
                previous_clauses = self._clauses.get(predicate, ())
                for clause in list(predicate.active_clauses()):
                    if clause not in previous_clauses:
                        predicate.remove(clause)
                # A predicate that the load has created and that has no clauses left is unknown again, so calls raise
                # an error.
                if not predicate.clauses and predicate not in self._clauses and not predicate.dynamic:
                    predicate.kind = "undefined"
        rules.restore_properties(self._properties)


class CheckedProgram(NamedTuple):
    """A checked file.

    Attributes:
        entries: its entries, in order; a used file is an entry, too.
        rules: the compiled rules.
        calls: the calls in goals of the rules.
        folder: its folder; None for the outermost file, whose folder is the current one already.
        path: its path; None for the outermost file.
    """

    entries: "List[Union[FileEntry, PrologSource, CheckedProgram]]"
    rules: List[EventRule]
    calls: List[PredicateCall]
    folder: Optional[Path] = None
    path: Optional[Path] = None

    @property
    def can_fail_partially(self) -> bool:
        """True if an error can occur after a part has taken effect.

        Rules, properties and a single clause are checked completely before they take effect.
        """
        kinds = [entry.kind if isinstance(entry, FileEntry) else None for entry in self.entries]
        return kinds != [EntryKind.CLAUSE] and any(
            entry_kind is not EntryKind.PROPERTY for entry_kind in kinds
        )


class _ReadingState(NamedTuple):
    """State of the reading of a file and its included files."""

    parser: EventFileParser
    operators: Operators
    errors: Errors
    conditions: ConditionalCompilation


class EventFileLoader:
    """Loads event files into a `RuleBase`."""

    def __init__(self, rules: RuleBase):
        self._rules = rules
        self._files: SourceFiles = rules.files
        self._directives = Directives(rules.logic)
        self._prolog_loader = PrologFileLoader(
            rules, self._directives, self.use_file, self._warn_of_singletons
        )
        self._expansion = TermExpansion(rules.logic)
        self._active_files: List[CheckedProgram] = []
        """Files that are taking effect, outermost first."""
        self._rollbacks: List[Union[LoadSavepoint, LoadRollback]] = []
        """Rollbacks of the load in progress; entries after the first two belong to nested loads."""
        self._deferred_calls: Optional[List[PredicateCall]] = None
        self._modules = rules.logic.database.modules
        self._warns_of_singletons = False

    def warn_of_singletons(self) -> None:
        """Warn of variables that occur only once in a clause that is loaded from now on."""
        self._warns_of_singletons = True

    def warn_unknown_calls(self, conditions: Term, caller: str) -> None:
        """Warn of unknown predicates in conditions, at the end of the load in progress or now."""
        calls = calls_in_goals(conditions, caller)
        if self._active_files:
            self._active_files[0].calls.extend(calls)
        else:
            self._warn_of_undefined_predicates(calls)

    def defer_warnings(self) -> None:
        """Defer warnings about unknown predicates, because several loads belong together."""
        if self._deferred_calls is None:
            self._deferred_calls = []

    def log_deferred_warnings(self) -> None:
        """Log the deferred warnings about predicates that are still unknown."""
        calls, self._deferred_calls = self._deferred_calls, None
        self._warn_of_undefined_predicates(calls or [])

    def load_text(self, text: str, source: str, folder: Optional[Path]) -> None:
        """Load the text of an event file; relative names of files start in ``folder``.

        Raises:
            ProgramErrors: all errors; nothing of the text is active.
        """
        if folder is None:
            self._load(text, source)
            return
        with self._files.loading_file(folder / Path(source).name), self._files.relative_to(folder):
            self._load(text, source)

    def load_file(self, path: Union[str, "PathLike[str]"]) -> None:
        """Load an event file.

        Raises:
            ProgramErrors: all errors; nothing of the file is active.
            PrologError: if the file does not exist or the name is invalid.
            UsageError: if the file cannot be read.
        """
        self._load_file(self._files.resolve(path))

    def use_file(self, name: Term, once: bool) -> None:
        """Load the file that a term names, as ``use_module`` does; do nothing for a built-in library.

        Args:
            name: name of the file, or ``library(Name)``.
            once: do nothing if the file has been loaded before.

        Raises:
            ProgramErrors: all errors; nothing of the file is active.
            PrologError: for an unknown library or an invalid file name.
            UsageError: if the file cannot be read.
        """
        name = deref(name)
        if name.__class__ is tuple and name[0] is LIBRARY:
            check_library(name)
            return
        path = self._files.find(name)
        # A module is loaded once, as in SWI-Prolog; another import of it only makes its predicates visible.
        if not self._files.has_loaded(path) or not (once or self._files.module(path)):
            self._load_file(path)
        self._modules.import_exports(self._files.module(path))

    def load_terms(self, terms: Sequence[Tuple[Term, Optional[Place]]]) -> None:
        """Load terms like the contents of an event file.

        Raises:
            ProgramErrors: all errors; nothing is active.
        """
        logic = self._rules.logic
        state = self._start_reading(
            EventFileParser(logic.brief, self._rules.declared_events.current_declarations()), Errors()
        )
        for term, place in terms:
            name = included_file_name(term)
            if name is None:
                state.parser.parse_term(copy(term), no_place, place)
            else:
                self._include(name, place, state)
        self._check_and_activate(lambda errors: self._check_contents(state.parser, errors), state.errors)

    def load_read_term(self, read_term: ReadTerm) -> None:
        """Load a parsed term like an event file of one term.

        Raises:
            ProgramErrors: all errors; nothing is active.
        """
        rules = self._rules
        parser = EventFileParser(declarations=rules.declared_events.current_declarations())
        parser.parse_read_term(read_term)
        # `precompiling_goals` compiles goals and predicates now, so that the first events do not wait for it.
        with rules.logic.precompiling_goals(lambda: [rule.definition.term for rule in rules.rules]):
            self._check_and_activate(lambda errors: self._check_contents(parser, errors), Errors())

    def _load_file(self, path: Path) -> None:
        text = self._files.text(path)
        with self._files.loading_file(path), self._files.relative_to(path.parent):
            self._load(text, str(path))

    def _load(self, text: str, source: str) -> None:
        rules = self._rules
        with rules.logic.precompiling_goals(lambda: [rule.definition.term for rule in rules.rules]):
            self._check_and_activate(lambda errors: self._parse_and_check(text, source, errors), Errors())

    def _parse_and_check(self, text: str, source: str, errors: Errors) -> CheckedProgram:
        if not is_event_file(text, self._rules.logic, self._open_included):
            return CheckedProgram([PrologSource(text, source)], [], [])
        state = self._start_reading(
            EventFileParser(declarations=self._rules.declared_events.current_declarations()), errors
        )
        self._read(read_program(text, state.operators, source, OF_FILES), state)
        errors.extend(state.conditions.unclosed_errors())
        return self._check_contents(state.parser, errors)

    def _open_included(self, name: Term) -> Tuple[str, str]:
        path = self._files.find(name)
        return self._files.text(path), str(path)

    def _start_reading(self, parser: EventFileParser, errors: Errors) -> _ReadingState:
        def condition_holds(goal: Term, place: Optional[Place]) -> bool:
            try:
                return self._rules.logic.once(goal)
            except PrologError as error:
                raise RuleError(f"this condition raises an error: {error.message}", place) from error

        return _ReadingState(
            parser, self._rules.logic.operators.copy(), errors, ConditionalCompilation(condition_holds)
        )

    def _read(self, program: Program, state: _ReadingState) -> None:
        """Read the terms of a text; the terms of included files take the place of the ``include`` directive."""
        for read_term in program:
            self._rules.logic.machine.budget.check_interrupt()
            if isinstance(read_term, SyntaxFault):
                if not state.conditions.is_skipping:
                    state.errors.append(read_term)
                continue
            try:
                self._read_term(read_term, program, state)
            except RetalisError as error:
                state.errors.append(error if error.place else RuleError(error.message, read_term.place))

    def _read_term(self, read_term: ReadTerm, program: Program, state: _ReadingState) -> None:
        term = deref(read_term.term)
        directive = term[1] if term.__class__ is tuple and term[0] in DIRECTIVES else None
        if directive is not None and state.conditions.process(directive, read_term.place_of(term, 1)):
            return
        if state.conditions.is_skipping:
            return
        name = included_file_name(term)
        if name is not None:
            self._include(name, read_term.place_of(term, 1), state, program)
            return
        # Terms that the program has generated have no positions of their own; errors point to the original term.
        expansion = self._expansion.expand_term(term)
        if expansion is not None:
            for expanded_term in expansion:
                state.parser.parse_term(
                    self._expansion.expand_goals(expanded_term), no_place, read_term.place
                )
            return
        expanded = self._expansion.expand_goals(term)
        if expanded is term:
            state.parser.parse_read_term(read_term)
        else:
            state.parser.parse_term(expanded, no_place, read_term.place)
        self._warn_of_singletons(read_term)
        # The directive runs after the checks, but the rest of the file is read with its operators and flags.
        if directive is not None:
            apply_reader_settings(directive, program)

    def _warn_of_singletons(self, read_term: ReadTerm) -> None:
        if read_term.singletons and self._warns_of_singletons:
            names = ", ".join(read_term.singletons)
            self._rules.network.on_warning(RuleError(f"singleton variables: {names}", read_term.place))

    def _include(
        self,
        name: Term,
        place: Optional[Place],
        state: _ReadingState,
        outer_program: Optional[Program] = None,
    ) -> None:
        try:
            path = self._files.find(name)
            text = self._files.text(path)
            with self._files.loading_file(path), self._files.relative_to(path.parent):
                program = read_program(text, state.operators, str(path), OF_FILES)
                if outer_program is not None:
                    program.flags = outer_program.flags
                self._read(program, state)
                if outer_program is not None:
                    outer_program.flags = program.flags
        except (UsageError, PrologError) as error:
            state.errors.append(RuleError(error.message, place))

    def _check_contents(self, parser: EventFileParser, errors: Errors) -> CheckedProgram:
        """Complete the check of a file: check clauses and used files, and compile the rules."""
        errors.extend(parser.errors)
        logic = self._rules.logic
        entries: List[Union[FileEntry, PrologSource, CheckedProgram]] = []
        defined_predicates = predicates_defined_in(parser.entries)
        for entry in parser.entries:
            logic.machine.budget.check_interrupt()
            if entry.kind is EntryKind.CLAUSE:
                problem = clause_error(logic, entry.term) or fact_error(logic, entry.term, defined_predicates)
                if problem is not None:
                    errors.append(RuleError(problem, entry.place))
            if entry.kind in (EntryKind.LOAD, EntryKind.LOAD_ONCE):
                checked_file = self._check_used_file(entry, errors)
                if checked_file is not None:
                    entries.append(checked_file)
            else:
                entries.append(entry)
        # A predicate ``t1/1`` or ``t2/1`` of the program itself may be called in every goal.
        for call in parser.interval_calls:
            if call.key not in defined_predicates and logic.is_system_predicate(call.key):
                message = (
                    f"{call.key} is defined only in the goals of check: "
                    "write check instead of where, do or another operator"
                )
                errors.append(RuleError(message, call.place))
        rules = self._compile_rules([*parser.rules, *parser.nested_rules], errors)
        for warning in parser.warnings.with_omitted_count():
            self._rules.network.on_warning(warning)
        return CheckedProgram(entries, rules, parser.calls)

    def _compile_rules(self, definitions: List[RuleDefinition], errors: Errors) -> List[EventRule]:
        rules = []
        for definition in definitions:
            self._rules.logic.machine.budget.check_interrupt()
            try:
                rules.append(self._rules.compile(definition))
            except RetalisError as error:
                errors.append(error if error.place else RuleError(error.message, definition.place))
            except RecursionError:
                errors.append(RuleError(TOO_DEEP, definition.place))
        return rules

    def _check_used_file(self, entry: FileEntry, errors: Errors) -> Optional[CheckedProgram]:
        """Return the checked contents of a file that is used; None for a library or a file that is already loaded."""
        name = deref(entry.term)
        try:
            if name.__class__ is tuple and name[0] is LIBRARY:
                check_library(name)
                return None
            path = self._files.find(name)
            if self._files.module(path) or (
                entry.kind is EntryKind.LOAD_ONCE and self._files.has_loaded(path)
            ):
                return None
            text = self._files.text(path)
            with self._files.loading_file(path), self._files.relative_to(path.parent):
                checked_file = self._parse_and_check(text, str(path), errors)
            return checked_file._replace(folder=path.parent, path=path)
        except (UsageError, PrologError) as error:
            errors.append(RuleError(error.message, entry.place))
            return None

    def _check_and_activate(self, check_program: Callable[[Errors], CheckedProgram], errors: Errors) -> None:
        """Check the whole program, then make it take effect; undo everything after an error."""
        loaded = set(self._files.loaded)
        if self._rollbacks:
            self._check_then_activate(check_program, errors, loaded)
            return
        self._rollbacks = [LoadSavepoint(self._rules, loaded)]
        try:
            self._check_then_activate(check_program, errors, loaded)
        except ProgramErrors:
            raise
        except BaseException:
            # An internal error may come at any step. The first two entries undo nested loads, too.
            for savepoint in self._rollbacks[:2]:
                savepoint.restore()
            raise
        finally:
            self._rollbacks = []

    def _check_then_activate(
        self, check_program: Callable[[Errors], CheckedProgram], errors: Errors, loaded: Set[Path]
    ) -> None:
        """Check a program and make it take effect; after an error, restore the state, with the loaded files."""
        rollback: Optional[LoadRollback] = None
        try:
            checked = check_program(errors)
            if errors:
                raise ProgramErrors(_sort_errors(errors))
            # Copies of all sets of clauses cost time in proportion to the program, so they are made only if needed.
            if checked.can_fail_partially:
                rollback = LoadRollback(self._rules)
                self._rollbacks.append(rollback)
            self._activate(checked)
        except RetalisError as error:
            if rollback is not None:
                rollback.restore()
            # Necessary even if nothing took effect, because reading has marked the files as loaded.
            self._files.set_loaded(loaded)
            if isinstance(error, ProgramErrors):
                raise
            raise ProgramErrors([error]) from error

    @property
    def is_loading(self) -> bool:
        """True while a load is in progress."""
        return bool(self._rollbacks or self._active_files)

    def _activate(self, checked: CheckedProgram) -> None:
        self._active_files.append(checked)
        try:
            with self._files.relative_to(checked.folder):
                self._process_in_module(checked)
        finally:
            self._active_files.pop()
        self._warn_of_undefined_predicates(checked.calls)

    def _warn_of_undefined_predicates(self, calls: List[PredicateCall]) -> None:
        if self._deferred_calls is not None:
            self._deferred_calls.extend(calls)
            return
        for warning in undefined_call_warnings(self._rules.logic, calls, self._rules.terms):
            self._rules.network.on_warning(warning)

    def _process_in_module(self, checked: CheckedProgram) -> None:
        with self._modules.loading_file(not checked.rules):
            self._process_entries(checked)

    def _process_entries(self, checked: CheckedProgram) -> None:
        rules, final_entries = self._rules, []
        for entry in checked.entries:
            rules.logic.machine.budget.check_interrupt()
            if isinstance(entry, CheckedProgram):
                module = "" if entry.path is None else self._files.module(entry.path)
                # A file that precedes this one may have loaded it meanwhile.
                if not module:
                    self._activate(entry)
                    module = self._modules.last_loaded_name
                self._modules.import_exports(module)
            elif isinstance(entry, PrologSource):
                self._consult(entry, checked)
            elif entry.kind is EntryKind.AT_END:
                final_entries.append(entry)
            elif entry.kind is EntryKind.CLAUSE:
                rules.logic.add_clause(entry.term, entry.place)
            elif isinstance(entry.term, Property):
                rules.set_property(entry.term)
            else:
                self._run_directive(entry)
        # Rules are activated after all clauses, so that an event of a directive cannot reach a rule whose clauses are
        # incomplete; goals of `initialization/1` follow, so that their events reach the rules.
        for rule in checked.rules:
            rules.activate(rule)
        for entry in final_entries:
            self._run_directive(entry)

    def _consult(self, file: PrologSource, checked: CheckedProgram) -> None:
        if checked.path is None:
            self._prolog_loader.load(file, checked.calls.extend)
            return
        with self._files.loading_file(checked.path):
            self._prolog_loader.load(file, checked.calls.extend)

    def _run_directive(self, entry: FileEntry) -> None:
        warning = self._directives.run(entry.term, entry.goals, entry.place)
        if warning is not None:
            self._rules.network.on_warning(warning)


def _sort_errors(errors: Errors) -> Errors:
    """Sort errors by file, in the order in which the files first occur, then by line and column."""
    files: Dict[Optional[str], int] = {}
    for error in errors:
        files.setdefault(error.place.source if error.place else None, len(files))

    def position_of(error: RetalisError) -> Tuple[int, int, int]:
        place = error.place
        return (files[None], 0, 0) if place is None else (files[place.source], place.line, place.column)

    errors.sort(key=position_of)
    return errors


def apply_reader_settings(goal: Term, program: Program) -> None:
    """Apply operators and flags that a directive sets to the rest of the text."""
    for goal_part in conjuncts(goal):
        if goal_part.__class__ is not tuple:
            continue
        arguments = [deref(argument) for argument in goal_part[1:]]
        if goal_part[0] is _OP and arguments[0].__class__ is int and arguments[1].__class__ is Atom:
            for name in _operator_names(arguments[2]):
                try:
                    program.operators.add(arguments[0], arguments[1].name, name)
                except (RetalisError, ValueError):
                    # The directive itself reports the error when it runs.
                    continue
        elif goal_part[0] is _SET_FLAG and arguments[0].__class__ is Atom and arguments[1].__class__ is Atom:
            name = arguments[0].name
            if name in ("double_quotes", "back_quotes"):
                changed: Any = {name: arguments[1].name}
                program.flags = program.flags._replace(**changed)


def _operator_names(term: Term) -> List[str]:
    items = list_items(term)
    terms = [deref(item) for item in items] if items else [term]
    return [item.name for item in terms if item.__class__ is Atom]


_RULE_SIGNS = re.compile(r"<-|'rule:'|'?\b(?:do|iff|IFF|event_rule_property|include)\b")
"""Signs of event rules; a text without any has no event rule."""

_DIRECTIVE_CALLS = re.compile(r"[:?]-\s*(?:\(\s*)?([a-z]\w*)")
"""Directives, with the first predicate that they call."""

_EVENT_PREDICATES = frozenset(
    (
        "event",
        "declare_event",
        "new_event",
        "timer",
        "cancel_timer",
        "state",
        "delete_state",
        "memorize",
        "memorize_diactive",
        "delete_memory",
        "subscribe",
        "delete_subscription",
        "subscribe_to",
        "ins_event_rule",
        "del_event_rule",
        "del_all_event_rules",
        "compile_event_file",
        "compile_events",
        "compile_event_rules",
        "execute_event_stream_file",
        "fire_event_list",
        "fire_event_list_return_external_events",
        "set_etalis_flag",
        "reset_db",
        "reset_etalis",
        "reset_etalis_state",
    )
)
"""Predicates of the event language that no Prolog program uses."""

OpenIncluded = Callable[[Term], Optional[Tuple[str, str]]]
"""Takes the name of an included file; returns its text, and its name for errors, or None without such a file."""


def is_event_file(text: str, logic: PrologSystem, open_included: OpenIncluded) -> bool:
    """Return whether a text contains an event rule, or a directive that calls a predicate of the event language.

    Args:
        text: text of the file.
        logic: provides predicates and operators.
        open_included: opens included files.
    """
    if not _may_contain_rules(text):
        return False
    return _contains_rules(
        read_program(text, logic.operators.copy(), flags=OF_FILES), logic, open_included, 0
    )


def _may_contain_rules(text: str) -> bool:
    if _RULE_SIGNS.search(text):
        return True
    return any(match.group(1) in _EVENT_PREDICATES for match in _DIRECTIVE_CALLS.finditer(text))


_MAX_INCLUDE_DEPTH = 50
"""Maximum depth of included files."""


def _contains_rules(program: Program, logic: PrologSystem, open_included: OpenIncluded, depth: int) -> bool:
    for read_term in program:
        if isinstance(read_term, SyntaxFault):
            # A rule with a syntax error must not turn the file into a Prolog program, where it would only be a
            # warning.
            if read_term.place is not None and "<-" in read_term.place.text:
                return True
            continue
        term = deref(read_term.term)
        if is_rule(term) or term.__class__ is tuple and (term[0] is PROPERTY_FACT or term[0] is RULE):
            return True
        if term.__class__ is not tuple or term[0] not in DIRECTIVES:
            continue
        name = included_file_name(term)
        if name is not None and depth < _MAX_INCLUDE_DEPTH:
            included_file = _read_included(name, open_included)
            if included_file is not None:
                inner = read_program(included_file[0], program.operators, included_file[1], program.flags)
                if _contains_rules(inner, logic, open_included, depth + 1):
                    return True
                program.flags = inner.flags
            continue
        goal = next(iter(conjuncts(term[1])))
        key = goal[0] if goal.__class__ is tuple else goal.functor if isinstance(goal, Atom) else None
        if key is not None and key.name in _EVENT_PREDICATES and logic.is_added(key):
            return True
        apply_reader_settings(term[1], program)
    return False


def _read_included(name: Term, open_included: OpenIncluded) -> Optional[Tuple[str, str]]:
    try:
        return open_included(name)
    except RetalisError:
        # Reading the file later reports the error.
        return None
