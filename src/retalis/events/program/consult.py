"""What files are loaded into, as those who load or check them know it.

Prolog files: loaded clause by clause, as other Prologs do, so that what is wrong costs itself and nothing else.

A file of event rules is read and checked as a whole, and accepted or refused as a whole (see `loading`). A file that
has none is a Prolog program: each of its directives runs before the next term is read, so that operators, flags and
``term_expansion/2`` hold from there on, and a term that does not read, a clause that cannot be added or a directive
that raises an error is left out, with a warning. A file of which nothing is left is refused.
"""

from typing import TYPE_CHECKING, Any, Callable, List, NamedTuple, Optional

from ...foundation.errors import Errors, Omission, Place, ProgramErrors, RetalisError, RuleError, SyntaxFault
from ...prolog.machine.errors import PrologError
from ...prolog.machine.resource_limits import LimitError
from ...prolog.syntax.term_reader import OF_FILES, Program, ReadTerm, read_program
from ...prolog.terms.types import Atom, Term, Var, atom, deref, functor
from ..language.goal_analysis import Unknown
from ..language.rule_parser import Property
from .event_file_checker import (
    DIRECTIVES,
    FileChecker,
    FileEntry,
    clause_error,
    fact_error,
    included,
    nowhere,
)
from .file_directives import Directives, Goals
from .source_files import SourceFiles, declare_operators
from .source_preprocessing import ConditionalCompilation, TermExpansion

if TYPE_CHECKING:
    from ..rules.rule_base import RuleBase


_END = atom("end_of_file")
_MODULES = frozenset((functor("module", 2), functor("module", 3)))
_OF_FILES = ("double_quotes", "back_quotes")
"""Flags that hold to the end of the file that sets them."""

Use = Callable[[Term, bool], None]


class Consulted(NamedTuple):
    """The text of a Prolog file, to be loaded when its turn comes."""

    text: str
    source: str


class Consultation:
    """Loads Prolog files.

    Args:
        rules: takes what they say.
        directives: runs directives.
        use: loads another file, or does so once.
    """

    def __init__(self, rules: "RuleBase", directives: Directives, use: Use):
        self._rules = rules
        self._directives = directives
        self._use = use

    def load(self, one: Consulted, note_calls: Callable[[List[Unknown]], None]) -> None:
        """Load a file.

        Raises:
            ProgramErrors: all errors, where nothing of the file is left.
            LimitError: where it takes longer than it may.
        """
        flags = self._rules.logic.flags
        kept = {name: flags[name] for name in _OF_FILES}
        try:
            _PrologFile(self._rules, self._directives, self._use, note_calls).load(one)
        finally:
            flags.update(kept)


class _Omissions:
    """What is left out of a file: told as it is found, as soon as something of the file is not.

    Args:
        tell: takes warnings.
        most: how much may be left out; None for any number.
    """

    def __init__(self, tell: Callable[[RetalisError], None], most: Optional[int]):
        self._tell = tell
        self._most = most
        self._found = Errors()
        self._left = False

    def __len__(self) -> int:
        return len(self._found) + self._found.more

    def append(self, error: RetalisError) -> None:
        """Take a problem."""
        before = len(self._found)
        self._found.append(error)
        if self._left and len(self._found) > before:
            self._tell(Omission(error))

    def accept(self) -> None:
        """Note that something of the file is left."""
        if not self._left:
            self._left = True
            for error in self._found:
                self._tell(Omission(error))

    def end(self) -> None:
        """Refuse the file where nothing is left of it, or more is left out than may be.

        Raises:
            ProgramErrors: all that is wrong with it.
        """
        too_many = self._most is not None and len(self) > self._most
        if too_many or self._found and not self._left:
            raise ProgramErrors(self._found)
        if self._found.more:
            self._tell(self._found.with_rest()[-1])


class _PrologFile:
    """A Prolog file that is being loaded."""

    def __init__(
        self,
        rules: "RuleBase",
        directives: Directives,
        use: Use,
        note_calls: Callable[[List[Unknown]], None],
    ):
        self._rules = rules
        self._logic = rules.logic
        self._files: SourceFiles = rules.files
        self._directives = directives
        self._use = use
        self._note_calls = note_calls
        self._omitted = _Omissions(rules.on_warning, None)
        self._conditions = ConditionalCompilation(self._holds)
        self._expansion = TermExpansion(rules.logic)
        self._checker = FileChecker(rules.logic.brief, rules.declared.now())
        self._late: List[FileEntry] = []

    def load(self, one: Consulted) -> None:
        """Load its text, then run the goals that are called when it has been loaded."""
        omitted = self._omitted = _Omissions(self._rules.on_warning, self._files.may_omit(one.source))
        program = read_program(one.text, self._logic.operators, one.source, OF_FILES)
        self._terms(program)
        for unclosed in self._conditions.unclosed():
            self._omitted.append(unclosed)
        self._at_end()
        omitted.end()
        self._files.note_omitted(one.source, len(omitted))

    def _at_end(self) -> None:
        """Take in what the program puts at the end of its files, and call what was put off until then."""
        try:
            self._expanded(_END, None, None)
        except RetalisError as error:
            self._omit(error, None)
        for step in self._late:
            try:
                self._run(step.term, step.goals, step.place)
            except RetalisError as error:
                self._omit(error, step.place)

    def _terms(self, program: Program) -> None:
        """Take in the terms of a text, and in their places those of files that it includes."""
        for read in program:
            if isinstance(read, SyntaxFault):
                if not self._conditions.skip:
                    self._omitted.append(read)
                continue
            term = deref(read.term)
            if term is _END:
                return
            place = read.place
            try:
                if term.__class__ is tuple and term[0] in DIRECTIVES:
                    self._directive(read, program)
                    self._follow_flags(program)
                elif not self._conditions.skip:
                    self._read(read, place)
            except RetalisError as error:
                self._omit(error, place)

    def _directive(self, read: ReadTerm, program: Program) -> None:
        term: Any = deref(read.term)
        place = read.place_of(term, 1)
        if self._conditions.take(term[1], place) or self._conditions.skip:
            return
        name = included(term)
        if name is None:
            self._name_module(term[1])
            self._read(read, read.place)
            return
        try:
            self._include(name, program)
        except RetalisError as error:
            self._omit(error, place)

    def _name_module(self, goal: Term) -> None:
        """Give a module whose name is a variable that of its file."""
        goal, path = deref(goal), self._files.innermost
        if goal.__class__ is tuple and goal[0] in _MODULES and path is not None:
            name = deref(goal[1])
            if isinstance(name, Var):
                name.ref = atom(path.stem)

    def _read(self, read: ReadTerm, place: Place) -> None:
        term = deref(read.term)
        if self._expanded(term, read, place):
            return
        if read.singletons and self._rules.warn_singletons:
            self._rules.on_warning(RuleError(f"singleton variables: {', '.join(read.singletons)}", place))
        self._take(self._expansion.goals(term), read, place)

    def _expanded(self, term: Term, read: Optional[ReadTerm], place: Optional[Place]) -> bool:
        """Take in what the program puts in the place of a term; return whether it does."""
        found = self._expansion.terms(term)
        for one in found or ():
            if one is not _END:
                self._take(self._expansion.goals(one), read if one is term else None, place)
        return found is not None

    def _take(self, term: Term, read: Optional[ReadTerm], place: Optional[Place]) -> None:
        """Take a term in; where it was read itself, the places of its parts are known."""
        checker = self._checker
        if read is not None and term is deref(read.term):
            checker.read(read, place)
        else:
            checker.term(term, nowhere, place)
        steps = checker.steps[:]
        checker.steps.clear()
        if not self._accepted(checker):
            return
        for step in steps:
            try:
                self._do(step)
            except RetalisError as error:
                self._omit(error, step.place or place)

    def _accepted(self, checker: FileChecker) -> bool:
        """Tell what was found about a term, take in the rules made of it; return whether nothing is wrong with it."""
        if checker.warnings:
            for warning in checker.warnings:
                self._rules.on_warning(warning)
            checker.warnings.clear()
        if checker.calls:
            self._note_calls(checker.calls[:])
            checker.calls.clear()
        wrong, rules = checker.errors[:], [*checker.rules, *checker.inner]
        if wrong or rules:
            for found in (checker.errors, checker.rules, checker.inner):
                found.clear()
        for error in wrong:
            self._omitted.append(error)
        for definition in () if wrong else rules:
            self._rules.activate(self._rules.compile(definition))
            self._omitted.accept()
        return not wrong

    def _do(self, step: FileEntry) -> None:
        if step.kind == "clause":
            problem = clause_error(self._logic, step.term)
            if problem is None:
                problem = fact_error(self._logic, step.term, set(), self._logic.is_added)
            if problem is not None:
                raise RuleError(problem, step.place)
            self._logic.add_clause(step.term, step.place)
            self._omitted.accept()
        elif isinstance(step.term, Property):
            self._rules.set_property(step.term)
        elif step.kind in ("use", "ensure"):
            declare_operators(step.term, self._logic.operators)
            self._use(step.term, step.kind == "ensure")
            self._omitted.accept()
        elif step.kind == "later":
            self._late.append(step)
        else:
            self._run(step.term, step.goals, step.place)

    def _run(self, goal: Term, goals: Goals, place: Optional[Place]) -> None:
        warning = self._directives.run(goal, goals, place)
        self._omitted.accept()
        if warning is not None:
            self._rules.on_warning(warning)

    def _include(self, name: Term, outer: Program) -> None:
        path = self._files.find(name)
        text = self._files.text(path)
        with self._files.inside(path), self._files.relative_to(path.parent):
            program = read_program(text, self._logic.operators, str(path))
            program.flags = outer.flags
            self._terms(program)
            outer.flags = program.flags

    def _holds(self, goal: Term, place: Optional[Place]) -> bool:
        """Tell whether the goal of an ``if`` is true; one that raises an error is not."""
        try:
            return self._logic.once(goal)
        except LimitError:
            raise
        except PrologError as error:
            self._omitted.append(RuleError(f"this condition raises an error: {error.message}", place))
            return False

    def _follow_flags(self, program: Program) -> None:
        """Have the flags that a directive has set hold for what is read next."""
        flags = self._logic.flags
        quotes, back = deref(flags["double_quotes"]), deref(flags["back_quotes"])
        if not isinstance(quotes, Atom) or not isinstance(back, Atom):
            return
        if (quotes.name, back.name) != (program.flags.double_quotes, program.flags.back_quotes):
            program.flags = program.flags._replace(double_quotes=quotes.name, back_quotes=back.name)

    def _omit(self, error: RetalisError, place: Optional[Place]) -> None:
        """Leave out the term at a place for an error, or what was wrong in another file that it loads.

        Raises:
            RetalisError: that error, where it is that a limit has run out.
        """
        if isinstance(error, ProgramErrors):
            for one in error.errors:
                self._omitted.append(one)
        elif _is_final(error):
            raise error
        else:
            self._omitted.append(error if error.place else RuleError(error.message, place))


def _is_final(error: RetalisError) -> bool:
    """Tell whether an error, or what caused it, is that a limit has run out."""
    return isinstance(error, LimitError) or isinstance(error.__cause__, LimitError)
