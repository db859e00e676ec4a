"""A program's files read once more for the places of what stands in them: what was loaded does not keep those."""

import os
from pathlib import Path
from typing import Any, Iterable, Iterator, List, NamedTuple, Optional, Set, Tuple, Union

from ...foundation import Place, SyntaxFault, UsageError
from ...prolog.logic import Logic
from ...prolog.syntax import OF_FILES, ReadTerm, read_program
from ...prolog.terms import TRUE, Atom, CompoundTerm, Functor, String, Term, Var, deref, functor
from ..language import RuleDefinition, Spot
from ..program import GOALS, FileChecker, goal_of, nowhere, read_goals, read_text

LONGEST = 1 << 20
"""Characters of a file that is read once more; of what stands in a longer one only the rules' places are known."""

_MOST_FILES = 100

NECK = functor(":-", 2)
_GRAMMAR = functor("-->", 2)
_HOLDER = functor("$goal", 1)
_INCLUDE = functor("include", 1)
_LOADS = frozenset(
    functor(name, 1)
    for name in ("compile_event_file", "compile_events", "consult", "ensure_loaded", "use_module")
)


class WrittenRule(NamedTuple):
    """A rule and what gives the places of its parts."""

    definition: RuleDefinition
    spot: Spot


class WrittenTerm(NamedTuple):
    """A clause, or a goal of a goal file or directive, whose head is None.

    Attributes:
        head: of the clause.
        parent: the term of which the body is an argument, the ``number``-th.
        spot: gives the places of its parts.
        place: where it begins.
    """

    head: Optional[Term]
    parent: CompoundTerm
    number: int
    spot: Spot
    place: Optional[Place]


class Inner(NamedTuple):
    """A term inside another, as the ``number``-th argument of ``parent``."""

    term: Any
    parent: CompoundTerm
    number: int
    spot: Spot

    @property
    def place(self) -> Optional[Place]:
        """Where it begins; of an operator, where that stands."""
        if self.term.__class__ is tuple:
            return self.spot(self.term)
        return self.spot(self.parent, self.number)

    @property
    def key(self) -> Optional[Functor]:
        """The functor of an atom or a compound term."""
        return key_of(self.term)


def key_of(term: Any) -> Optional[Functor]:
    """Return the functor of an atom or a compound term, None for another term."""
    term = deref(term)
    return term[0] if term.__class__ is tuple else term.functor if term.__class__ is Atom else None


def inners(parent: CompoundTerm, number: int, spot: Spot) -> Iterator[Inner]:
    """Yield an argument of a term and all terms in it, from left to right."""
    stack = [Inner(deref(parent[number]), parent, number, spot)]
    while stack:
        inner = stack.pop()
        yield inner
        term = inner.term
        if term.__class__ is tuple:
            stack += [Inner(deref(term[at]), term, at, spot) for at in range(len(term) - 1, 0, -1)]


def held(term: Term) -> CompoundTerm:
    """Return a term that has another as its only argument."""
    return (_HOLDER, term)


class Written(NamedTuple):
    """What stands in a program's files."""

    rules: List[WrittenRule]
    clauses: List[WrittenTerm]
    goals: List[WrittenTerm]
    reads: List[ReadTerm]
    sources: Set[str]


def read_again(logic: Logic, folder: Path, loaded: Iterable[Path]) -> Written:
    """Read the files of a program once more.

    Args:
        logic: by whose operators they are read.
        folder: the program's.
        loaded: the real paths of its files; one that a goal names and that was not loaded is read, too.
    """
    found = Written([], [], [], [], set())
    real = Path(os.path.realpath(folder))
    goal_files = [folder / GOALS]
    for path in goal_files:
        _add_goals(found, goal_files, path, logic)
    seen = {os.path.realpath(path) for path in goal_files}
    named = [*_named(found.goals, folder), *sorted(_shown(path, real, folder) for path in loaded)]
    for path in named:
        if os.path.realpath(path) not in seen:
            seen.add(os.path.realpath(path))
            text = _text(path)
            if text:
                found.sources.add(str(path))
                _add_file(found, read_program(text, logic.operators.copy(), str(path), OF_FILES))
    return found


def _shown(path: Path, real: Path, folder: Path) -> Path:
    """Return a path as the program's own goals name it."""
    try:
        return folder / path.relative_to(real)
    except ValueError:
        return path


def _named(goals: Iterable[WrittenTerm], folder: Path) -> Iterator[Path]:
    """Yield the files that goals load, in their order."""
    for goal in goals:
        for inner in inners(goal.parent, goal.number, goal.spot):
            if inner.term.__class__ is tuple and inner.key in _LOADS:
                name = _plain(deref(inner.term[1]))
                if name and os.path.isfile(folder / name):
                    yield folder / name


def _plain(name: Any) -> str:
    """Return the text of an atom or string that a file may be called."""
    text = name.name if name.__class__ is Atom else name.text if name.__class__ is String else ""
    return "" if "\0" in text else text


def _text(path: Path) -> str:
    try:
        text = read_text(path)
    except UsageError:  # said when it was loaded
        return ""
    return text if len(text) <= LONGEST else ""


def _add_goals(found: Written, files: List[Path], path: Path, logic: Logic) -> None:
    for read in read_goals(_text(path), logic.operators, str(path)):
        if not isinstance(read, ReadTerm):
            continue
        goal: Any = goal_of(read.term)
        if goal.__class__ is tuple and goal[0] is _INCLUDE:
            included = path.parent / (_plain(deref(goal[1])) or path.name)
            if included not in files and len(files) < _MOST_FILES:
                files.append(included)
            continue
        found.reads.append(read)
        found.goals.append(_goal(goal, read))


def _goal(goal: Term, read: ReadTerm) -> WrittenTerm:
    parent = held(goal)

    def spot(part: Term, number: int = 0) -> Place:
        return read.place_of(goal) if part is parent else read.place_of(part, number)

    return WrittenTerm(None, parent, 1, spot, read.place)


def _add_file(found: Written, program: Iterable[Union[ReadTerm, SyntaxFault]]) -> None:
    for read in program:
        if isinstance(read, SyntaxFault):
            continue
        checker = FileChecker()
        checker.read(read)
        found.reads.append(read)
        for definition in [*checker.rules, *checker.inner]:
            found.rules.append(WrittenRule(definition, read.place_of))
        for step in checker.steps:
            if step.kind == "clause":
                found.clauses.append(clause_of(step.term, read.place_of, read.place))
            elif step.kind == "directive":
                found.goals.append(_goal(step.term, read))


def clause_of(term: Any, spot: Spot, place: Optional[Place]) -> WrittenTerm:
    """Return a clause, taken apart; of a grammar rule only which predicate it is."""
    if term.__class__ is tuple and term[0] is NECK:
        return WrittenTerm(deref(term[1]), term, 2, spot, place)
    if term.__class__ is tuple and term[0] is _GRAMMAR:
        key = key_of(term[1])
        if key is not None:
            head: Tuple[Any, ...] = (functor(key.name, key.arity + 2), *[Var() for _ in range(key.arity + 2)])
            return WrittenTerm(head, held(TRUE), 1, spot, place)
    return WrittenTerm(term, held(TRUE), 1, spot, place)


def clause_at(head: Term, body: Term, place: Optional[Place]) -> WrittenTerm:
    """Return a clause of which only the place is known where it begins."""
    return WrittenTerm(head, (NECK, head, body), 2, everywhere(place), place)


def everywhere(place: Optional[Place]) -> Spot:
    """Return what gives one place for all parts."""
    if place is None:
        return nowhere

    def spot(part: Term, number: int = 0) -> Optional[Place]:
        return place

    return spot
