"""Loading event files: read, check all of it, then act; what is refused leaves nothing behind."""

from contextlib import contextmanager
from pathlib import Path
from typing import Any, Iterable, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ..errors import Place, ProgramErrors, RetalisError, RuleError, SyntaxFault, UsageError
from ..logic import PrologError, permission_error
from ..syntax import read_program
from ..terms import Atom, String, Term, atom, conjuncts, copy, deref, functor
from .clauses import Checker, Definition, Step, clause_error
from .rule import Rule

_DIRECTIVES = frozenset((functor(":-", 1), functor("?-", 1)))
_OP = functor("op", 3)
_SET_FLAG = functor("set_prolog_flag", 2)


class Plan(NamedTuple):
    """A file that has no errors in itself: what to do, and the rules to add then."""

    steps: List[Any]
    rules: List[Rule]


class Loader:
    """Loads event files into `Rules`."""

    def __init__(self, rules: Any):
        self._rules = rules
        self._folder: Optional[Path] = None
        self._open: List[Path] = []
        self._allowed: Optional[List[Path]] = None
        self._trusted = False

    def allow_only(self, folders: Optional[Iterable[Any]]) -> None:
        """Have goals open files in these folders and below only; None allows all."""
        self._allowed = None if folders is None else [Path(folder).resolve() for folder in folders]

    @property
    def allowed(self) -> Optional[List[Path]]:
        """The folders in which goals may open files; None means all."""
        return self._allowed

    @contextmanager
    def trusted(self) -> Iterator[None]:
        """Allow all files meanwhile; the folders of those that are opened stay allowed."""
        before = self._trusted
        self._trusted = True
        try:
            yield
        finally:
            self._trusted = before

    @contextmanager
    def relative_to(self, folder: Optional[Path]) -> Iterator[None]:
        """Have relative paths be relative to a folder."""
        before = self._folder
        if folder is not None:
            self._folder = Path(folder)
        try:
            yield
        finally:
            self._folder = before

    def resolve(self, path: Any) -> Path:
        """Return a path, seen from the file that names it.

        Raises:
            PrologError: a permission error where it leads out of the folders that are allowed.
        """
        found = Path(path)
        if not found.is_absolute() and self._folder is not None:
            found = self._folder / found
        if self._allowed is not None:
            real = found.resolve()
            inside = any(folder in real.parents for folder in self._allowed)
            if self._trusted and not inside:
                self._allowed.append(real.parent)
            elif not inside:
                raise permission_error("open", "source_sink", atom(str(path)))
        return found

    def load_text(self, text: str, source: str, folder: Optional[Path]) -> None:
        """Load a text; see `Rules.load_text`."""
        errors: List[RetalisError] = []
        with self.relative_to(folder):
            plan = self._plan(text, source, errors)
            self._finish(plan, errors)

    def load_file(self, path: Any) -> None:
        """Load a file; see `Rules.load_file`."""
        place = self.resolve(path)
        text = _text_of(place)
        with self._inside(place):
            self.load_text(text, str(path), place.parent)

    def load_terms(self, terms: Sequence[Tuple[Term, Optional[Place]]]) -> None:
        """Load terms; see `Rules.load_terms`."""
        checker = Checker()
        for term, place in terms:
            checker.term(copy(term), lambda part: None, place)
        errors: List[RetalisError] = []
        plan = self._checked(checker, errors)
        self._finish(plan, errors)

    @contextmanager
    def _inside(self, place: Path) -> Iterator[None]:
        place = place.resolve()
        if place in self._open:
            raise UsageError(f"{place.name} loads itself")
        self._open.append(place)
        try:
            yield
        finally:
            self._open.pop()

    def _plan(self, text: str, source: str, errors: List[RetalisError]) -> Plan:
        operators = self._rules.logic.operators.copy()
        program = read_program(text, operators, source)
        checker = Checker()
        for read in program:
            if isinstance(read, SyntaxFault):
                errors.append(read)
                continue
            checker.read(read)
            if read.singletons and self._rules.warn_singletons:
                names = ", ".join(read.singletons)
                self._rules.on_warning(RuleError(f"singleton variables: {names}", read.place))
            term = deref(read.term)
            if term.__class__ is tuple and term[0] in _DIRECTIVES:
                self._change_reading(term[1], program)
        return self._checked(checker, errors)

    def _change_reading(self, goal: Term, program: Any) -> None:
        """Have operators and flags that a directive sets hold for the rest of the file."""
        for one in conjuncts(goal):
            if one.__class__ is not tuple:
                continue
            arguments = [deref(argument) for argument in one[1:]]
            if one[0] is _OP and arguments[0].__class__ is int and arguments[1].__class__ is Atom:
                for name in _names(arguments[2]):
                    try:
                        program.operators.add(arguments[0], arguments[1].name, name)
                    except (RetalisError, ValueError):
                        continue  # the directive itself reports it when it is run
            elif one[0] is _SET_FLAG and arguments[0].__class__ is Atom and arguments[1].__class__ is Atom:
                name = arguments[0].name
                if name in ("double_quotes", "back_quotes"):
                    program.flags = program.flags._replace(**{name: arguments[1].name})

    def _checked(self, checker: Checker, errors: List[RetalisError]) -> Plan:
        """Check what needs the logic: clauses, goals of rules, files that are used."""
        errors += checker.errors
        logic = self._rules.logic
        steps: List[Any] = []
        for step in checker.steps:
            if step.kind == "clause":
                problem = clause_error(logic, step.term)
                if problem is not None:
                    errors.append(RuleError(problem, step.place))
            if step.kind == "use":
                plan = self._used(step, errors)
                if plan is not None:
                    steps.append(plan)
            else:
                steps.append(step)
        rules = self._compiled([*checker.rules, *checker.inner], errors)
        for warning in checker.warnings:
            self._rules.on_warning(warning)
        return Plan(steps, rules)

    def _compiled(self, definitions: List[Definition], errors: List[RetalisError]) -> List[Rule]:
        rules = []
        for definition in definitions:
            try:
                rules.append(self._rules.compile(definition))
            except RetalisError as error:
                errors.append(error if error.place else RuleError(error.message, definition.place))
        return rules

    def _used(self, step: Step, errors: List[RetalisError]) -> Optional[Plan]:
        name = step.term
        if name.__class__ not in (Atom, String):
            return None  # library(...): there is one library, and it is always there
        try:
            place = self.resolve(name.name if name.__class__ is Atom else name.text)
            text = _text_of(place)
            with self._inside(place), self.relative_to(place.parent):
                return self._plan(text, str(place), errors)
        except (UsageError, PrologError) as error:
            errors.append(RuleError(error.message, step.place))
            return None

    def _finish(self, plan: Plan, errors: List[RetalisError]) -> None:
        if errors:
            raise ProgramErrors(errors)
        before = _Snapshot(self._rules)
        try:
            self._act(plan)
        except RetalisError as error:
            before.restore()
            if isinstance(error, ProgramErrors):
                raise
            raise ProgramErrors([error]) from error

    def _act(self, plan: Plan) -> None:
        rules = self._rules
        for step in plan.steps:
            if isinstance(step, Plan):
                self._act(step)
            elif step.kind == "clause":
                rules.logic.add_clause(step.term, step.place)
            elif step.kind == "property":
                rules.set_property(step.term)
            else:
                self._direct(step)
        for rule in plan.rules:
            rules.activate(rule)

    def _direct(self, step: Step) -> None:
        """Run a directive.

        Raises:
            RetalisError: what it raised.
        """
        rules = self._rules
        try:
            if not rules.logic.once(step.term):
                rules.on_warning(RuleError("this directive fails", step.place))
        except PrologError as error:
            raise RuleError(f"this directive raises an error: {error.message}", step.place) from error


class _Snapshot:
    """What the program was before a file was loaded: clauses, rules and properties."""

    def __init__(self, rules: Any):
        self._rules = rules
        self._active = list(rules.rules)
        self._clauses = {
            predicate: list(predicate.live())
            for predicate in rules.logic.database.predicates.values()
            if predicate.kind == "user"
        }
        self._properties = {key: list(found) for key, found in rules._properties.items()}

    def restore(self) -> None:
        """Take back what has come since."""
        rules = self._rules
        for rule in list(rules.rules):
            if not any(rule is one for one in self._active):
                rules.remove(rule)
        for predicate in list(rules.logic.database.predicates.values()):
            if predicate.kind == "user":
                kept = self._clauses.get(predicate, [])
                for clause in list(predicate.live()):
                    if not any(clause is one for one in kept):
                        predicate.remove(clause)
                if not predicate.clauses and predicate not in self._clauses and not predicate.dynamic:
                    predicate.kind = "undefined"
        rules._properties = self._properties


def _names(term: Term) -> List[str]:
    from ..terms import list_items

    items = list_items(term)
    found = [deref(item) for item in items] if items else [term]
    return [item.name for item in found if item.__class__ is Atom]


def _text_of(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no UTF-8 text"
        raise UsageError(f"cannot read {path}: {reason}") from error
