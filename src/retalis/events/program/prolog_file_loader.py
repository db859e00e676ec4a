"""Loader of Prolog files: each clause and directive takes effect before the next one is read.

A file with event rules is checked as a whole and accepted or rejected as a whole (see `event_file_loader`). A file
without them is a Prolog program and is consulted as other Prolog systems do: each directive runs before the next term
is read, so that operators, flags and ``term_expansion/2`` apply from there on. A term with a syntax error, a clause
that cannot be added, or a directive that raises an error is omitted with a warning. If every term of a file is
omitted, the file is rejected. During a reload, it is also rejected if more terms are omitted than at the last load.
"""

from typing import TYPE_CHECKING, Any, Callable, List, NamedTuple, Optional

from ...foundation.errors import Errors, Omission, ProgramErrors, RetalisError, RuleError, SyntaxFault
from ...foundation.source_places import Place
from ...prolog.files.library_names import declare_operators
from ...prolog.machine.errors import PrologError
from ...prolog.machine.resource_limits import LimitError
from ...prolog.syntax.term_reader import OF_FILES, Program, ReadTerm, read_program
from ...prolog.terms.types import Atom, Term, Var, atom, deref, functor
from ..language.called_predicates import PredicateCall
from ..language.pattern_parser import no_place
from ..language.rule_labels import Property
from ..rules.rule_base import RuleBase
from .conditional_compilation_and_expansion import ConditionalCompilation, TermExpansion
from .event_file_parser import (
    DIRECTIVES,
    EntryKind,
    EventFileParser,
    FileEntry,
    clause_error,
    fact_error,
    included_file_name,
)
from .file_directives import Directives, Goals

if TYPE_CHECKING:
    from ...prolog.files.source_files import SourceFiles

_END_OF_FILE = atom("end_of_file")
_MODULE_DECLARATIONS = frozenset((functor("module", 2), functor("module", 3)))
_FILE_FLAGS = ("double_quotes", "back_quotes")
"""Flags that apply until the end of the file that sets them."""

LoadFile = Callable[[Term, bool], None]
"""Loads the file that a term names; the flag is true if the file is loaded only once."""


class PrologSource(NamedTuple):
    """The text of a Prolog file that is to be consulted."""

    text: str
    source: str


class PrologFileLoader:
    """Loads Prolog files.

    Args:
        rules: receives clauses and rules.
        directives: runs directives.
        load_file: loads files that directives name.
        warn_of_singletons: called with each clause that is read.
    """

    def __init__(
        self,
        rules: RuleBase,
        directives: Directives,
        load_file: LoadFile,
        warn_of_singletons: Callable[[ReadTerm], None],
    ):
        self._rules = rules
        self._directives = directives
        self._load_file = load_file
        self._warn_of_singletons = warn_of_singletons

    def load(self, source: PrologSource, record_calls: Callable[[List[PredicateCall]], None]) -> None:
        """Consult a file.

        Raises:
            ProgramErrors: all errors, if the whole file is rejected.
            LimitError: if a resource limit is exceeded.
        """
        flags = self._rules.logic.flags
        saved_flags = {name: flags[name] for name in _FILE_FLAGS}
        try:
            _FileConsultation(
                self._rules, self._directives, self._load_file, self._warn_of_singletons, record_calls
            ).load(source)
        finally:
            flags.update(saved_flags)


class _OmittedTerms:
    """Terms that are omitted from a file.

    When the first term is accepted, they are reported as warnings. Before that, the file may still be rejected as a
    whole, and then they are reported as errors.

    Args:
        warn: receives warnings.
        max_count: maximum number of omitted terms; None for any number.
    """

    def __init__(self, warn: Callable[[RetalisError], None], max_count: Optional[int]):
        self._warn = warn
        self._max_count = max_count
        self._errors = Errors()
        self._is_accepted = False

    def __len__(self) -> int:
        return len(self._errors) + self._errors.omitted_count

    def append(self, error: RetalisError) -> None:
        """Record an omitted term."""
        previous_count = len(self._errors)
        # `Errors` is bounded: it counts the errors beyond its limit, and these are not reported one by one.
        self._errors.append(error)
        if self._is_accepted and len(self._errors) > previous_count:
            self._warn(Omission(error))

    def record_accepted(self) -> None:
        """Record that a term was accepted."""
        if not self._is_accepted:
            self._is_accepted = True
            for error in self._errors:
                self._warn(Omission(error))

    def finish(self) -> None:
        """Reject the file if no term was accepted or too many were omitted.

        Raises:
            ProgramErrors: the errors of all omitted terms.
        """
        has_too_many = self._max_count is not None and len(self) > self._max_count
        if has_too_many or self._errors and not self._is_accepted:
            raise ProgramErrors(self._errors)
        if self._errors.omitted_count:
            self._warn(self._errors.with_omitted_count()[-1])


class _FileConsultation:
    """Consultation of one Prolog file."""

    def __init__(
        self,
        rules: RuleBase,
        directives: Directives,
        load_file: LoadFile,
        warn_of_singletons: Callable[[ReadTerm], None],
        record_calls: Callable[[List[PredicateCall]], None],
    ):
        self._rules = rules
        self._logic = rules.logic
        self._files: SourceFiles = rules.files
        self._directives = directives
        self._load_file = load_file
        self._warn_of_singletons = warn_of_singletons
        self._record_calls = record_calls
        self._omitted = _OmittedTerms(rules.network.on_warning, None)
        self._conditions = ConditionalCompilation(self._condition_holds)
        self._expansion = TermExpansion(rules.logic)
        self._parser = EventFileParser(rules.logic.brief, rules.declared_events.current_declarations())
        self._final_entries: List[FileEntry] = []

    def load(self, source: PrologSource) -> None:
        """Consult the text, then run the goals that are scheduled for the end."""
        omitted = self._omitted = _OmittedTerms(
            self._rules.network.on_warning, self._files.max_omitted(source.source)
        )
        program = read_program(source.text, self._logic.operators, source.source, OF_FILES)
        self._process_terms(program)
        for error in self._conditions.unclosed_errors():
            self._omitted.append(error)
        self._finish()
        omitted.finish()
        self._files.record_omitted(source.source, len(omitted))

    def _finish(self) -> None:
        """Expand ``end_of_file``, and run the goals of ``initialization/1``."""
        # As in SWI-Prolog, `term_expansion/2` is called for `end_of_file` and may append clauses.
        try:
            self._process_expansion(_END_OF_FILE, None, None)
        except RetalisError as error:
            self._omit(error, None)
        for entry in self._final_entries:
            try:
                self._run_goal(entry.term, entry.goals, entry.place)
            except RetalisError as error:
                self._omit(error, entry.place)

    def _process_terms(self, program: Program) -> None:
        """Process the terms of a text; the terms of included files take the place of the ``include`` directive."""
        for read_term in program:
            self._logic.machine.budget.check_interrupt()
            if isinstance(read_term, SyntaxFault):
                if not self._conditions.is_skipping:
                    self._omitted.append(read_term)
                continue
            term = deref(read_term.term)
            if term is _END_OF_FILE:
                return
            place = read_term.place
            try:
                if term.__class__ is tuple and term[0] in DIRECTIVES:
                    self._process_directive(read_term, program)
                    # The reader shares the operator table, but it copies the flags when it starts: flags that a
                    # directive changes must be copied again.
                    self._update_read_flags(program)
                elif not self._conditions.is_skipping:
                    self._process_term(read_term, place)
            except RetalisError as error:
                self._omit(error, place)

    def _process_directive(self, read_term: ReadTerm, program: Program) -> None:
        term: Any = deref(read_term.term)
        place = read_term.place_of(term, 1)
        if self._conditions.process(term[1], place) or self._conditions.is_skipping:
            return
        name = included_file_name(term)
        if name is None:
            self._name_module(term[1])
            self._process_term(read_term, read_term.place)
            return
        try:
            self._include(name, program)
        except RetalisError as error:
            self._omit(error, place)

    def _name_module(self, goal: Term) -> None:
        """Bind the name of a module to the name of its file if it is a variable."""
        goal, path = deref(goal), self._files.innermost_file
        if goal.__class__ is tuple and goal[0] in _MODULE_DECLARATIONS and path is not None:
            name = deref(goal[1])
            if isinstance(name, Var):
                name.ref = atom(path.stem)

    def _process_term(self, read_term: ReadTerm, place: Place) -> None:
        term = deref(read_term.term)
        if self._process_expansion(term, read_term, place):
            return
        self._warn_of_singletons(read_term)
        self._check_and_run(self._expansion.expand_goals(term), read_term, place)

    def _process_expansion(self, term: Term, read_term: Optional[ReadTerm], place: Optional[Place]) -> bool:
        """Process the expansion of a term by ``term_expansion/2``; return whether there is one."""
        expansion = self._expansion.expand_term(term)
        for expanded in expansion or ():
            if expanded is not _END_OF_FILE:
                self._check_and_run(
                    self._expansion.expand_goals(expanded), read_term if expanded is term else None, place
                )
        return expansion is not None

    def _check_and_run(self, term: Term, read_term: Optional[ReadTerm], place: Optional[Place]) -> None:
        """Process a term; if it is the one that was read, the places of its parts are known."""
        parser = self._parser
        if read_term is not None and term is deref(read_term.term):
            parser.parse_read_term(read_term, place)
        else:
            parser.parse_term(term, no_place, place)
        entries = parser.entries[:]
        parser.entries.clear()
        # The parser accumulates results for a whole file, so the results of this term are removed after each term.
        if not self._accept_parsed(parser):
            return
        for entry in entries:
            try:
                self._process_entry(entry)
            except RetalisError as error:
                self._omit(error, entry.place or place)

    def _accept_parsed(self, parser: EventFileParser) -> bool:
        """Report the findings about a term and activate its rules; return whether there are no errors."""
        if parser.warnings:
            for warning in parser.warnings:
                self._rules.network.on_warning(warning)
            parser.warnings.clear()
        if parser.calls:
            self._record_calls(parser.calls[:])
            parser.calls.clear()
        # Copied, because the parser uses its lists again for the next term.
        errors, rules = parser.errors[:], [*parser.rules, *parser.nested_rules]
        if errors or rules:
            for results in (parser.errors, parser.rules, parser.nested_rules):
                results.clear()
        for error in errors:
            self._omitted.append(error)
        for definition in () if errors else rules:
            self._rules.activate(self._rules.compile(definition))
            self._omitted.record_accepted()
        return not errors

    def _process_entry(self, entry: FileEntry) -> None:
        if entry.kind is EntryKind.CLAUSE:
            # Facts must not replace predicates of the event language; other library predicates may be redefined.
            problem = clause_error(self._logic, entry.term)
            if problem is None:
                problem = fact_error(self._logic, entry.term, set(), self._logic.is_added)
            if problem is not None:
                raise RuleError(problem, entry.place)
            self._logic.add_clause(entry.term, entry.place)
            self._omitted.record_accepted()
        elif isinstance(entry.term, Property):
            self._rules.set_property(entry.term)
        elif entry.kind in (EntryKind.LOAD, EntryKind.LOAD_ONCE):
            declare_operators(entry.term, self._logic.operators)
            self._load_file(entry.term, entry.kind is EntryKind.LOAD_ONCE)
            self._omitted.record_accepted()
        elif entry.kind is EntryKind.AT_END:
            self._final_entries.append(entry)
        else:
            self._run_goal(entry.term, entry.goals, entry.place)

    def _run_goal(self, goal: Term, goals: Goals, place: Optional[Place]) -> None:
        warning = self._directives.run(goal, goals, place)
        self._omitted.record_accepted()
        if warning is not None:
            self._rules.network.on_warning(warning)

    def _include(self, name: Term, outer_program: Program) -> None:
        path = self._files.find(name)
        text = self._files.text(path)
        with self._files.loading_file(path), self._files.relative_to(path.parent):
            program = read_program(text, self._logic.operators, str(path))
            # Flags of directives apply across the boundaries of included files, in both directions.
            program.flags = outer_program.flags
            self._process_terms(program)
            outer_program.flags = program.flags

    def _condition_holds(self, goal: Term, place: Optional[Place]) -> bool:
        """Return whether the goal of an ``if`` succeeds; a goal that raises an error counts as failed."""
        try:
            return self._logic.once(goal)
        # A resource limit ends the load; any other error concerns this directive only.
        except LimitError:
            raise
        except PrologError as error:
            self._omitted.append(RuleError(f"this condition raises an error: {error.message}", place))
            return False

    def _update_read_flags(self, program: Program) -> None:
        """Apply the flags that a directive has set to the reading of the following terms."""
        flags = self._logic.flags
        double_quotes, back_quotes = deref(flags["double_quotes"]), deref(flags["back_quotes"])
        if not isinstance(double_quotes, Atom) or not isinstance(back_quotes, Atom):
            return
        if (double_quotes.name, back_quotes.name) != (program.flags.double_quotes, program.flags.back_quotes):
            program.flags = program.flags._replace(
                double_quotes=double_quotes.name, back_quotes=back_quotes.name
            )

    def _omit(self, error: RetalisError, place: Optional[Place]) -> None:
        """Omit the term at a place because of an error.

        Raises:
            RetalisError: the error itself, if a resource limit is exceeded.
        """
        if isinstance(error, ProgramErrors):
            for nested_error in error.errors:
                self._omitted.append(nested_error)
        elif _is_limit_error(error):
            raise error
        else:
            self._omitted.append(error if error.place else RuleError(error.message, place))


def _is_limit_error(error: RetalisError) -> bool:
    """Return whether an error, or its cause, is an exceeded resource limit."""
    return isinstance(error, LimitError) or isinstance(error.__cause__, LimitError)
