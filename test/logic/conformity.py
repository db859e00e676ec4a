"""Goals with the answers that the standard gives, and what this Prolog answers.

Usage: python conformity.py       print what does not agree
"""

from pathlib import Path
from typing import Any, Iterator, List, NamedTuple, Tuple

from retalis.errors import SyntaxFault
from retalis.logic import Limits, Logic, PrologError
from retalis.syntax import ReadFlags, read_program, read_term, write_term
from retalis.terms import Term, atom, copy, deref, functor, make_list, variables

DATA = Path(__file__).resolve().parents[1] / "data" / "conformity"
ISO = ReadFlags(double_quotes="codes", iso=True)
_OR = functor(";", 2)
_ERROR = functor("error", 2)
_EQUAL = functor("=", 2)
_MOST = 20


class Case(NamedTuple):
    """A goal (or a text to be read and run) and the answer that the standard gives."""

    file: str
    number: int
    section: str
    goal: str
    answer: str

    def __str__(self) -> str:
        return f"{self.file}:{self.number}"


def cases(file: str) -> Iterator[Case]:
    """Yield the cases of a file."""
    section = ""
    for number, line in enumerate((DATA / file).read_text(encoding="utf-8").replace("\\\n", "\0").split("\n"), 1):
        if line.startswith("% "):
            section = line[2:]
        elif "==>" in line and not line.startswith(("%", "|")):
            goal, _, answer = line.rpartition(" ==>")
            yield Case(file, number, section, goal.replace("\0", "\\\n"), answer.strip())


def clauses(file: str) -> str:
    """Return the program that a file's goals use."""
    lines = (DATA / file).read_text(encoding="utf-8").split("\n")
    return "\n".join(line[2:] for line in lines if line.startswith("| "))


def prepared(program: str) -> Tuple[Logic, List[str]]:
    """Return a Prolog in the standard's mode with a program, and the list that collects what it writes."""
    logic = Logic()
    logic.limits = Limits(inferences=2_000_000)
    written: List[str] = []
    logic.output = logic.error_output = written.append
    terms = [(read.term, read.place) for read in read_program(program, logic.operators, "program", ISO)]
    logic.load(terms, lambda message, place: written.append(f"{place}: {message}"))
    assert not written, written
    logic.flags["iso"] = atom("true")
    logic.flags["double_quotes"] = atom("codes")
    return logic, written


def agrees(case: Case, program: str = "") -> Tuple[bool, str]:
    """Run a case; return whether the answer is the standard's, and the answer."""
    logic, written = prepared(program)
    try:
        goal = read_term(case.goal, logic.operators, flags=ISO)
    except SyntaxFault:
        return case.answer == "! syntax", "! syntax"
    kind, _, rest = case.answer.partition(" ")
    if kind in ("!", "throws"):
        return _raises(logic, goal.term, kind, rest)
    if kind == "prints":
        return _prints(logic, goal.term, written, rest)
    if case.answer in ("true", "false"):
        try:
            found = "true" if logic.once(goal.term) else "false"
        except PrologError as error:
            found = _text(error.term)
        return found == case.answer, found
    return _binds(logic, goal, case.answer)


def _raises(logic: Logic, goal: Term, kind: str, rest: str) -> Tuple[bool, str]:
    try:
        return False, "true" if logic.once(goal) else "false"
    except PrologError as error:
        ball = error.term
    if kind == "!":
        if ball.__class__ is not tuple or ball[0] is not _ERROR:
            return False, _text(ball)
        ball = deref(ball[1])
    expected = read_term(rest, logic.operators, flags=ISO).term
    return logic.machine.unify(copy(ball), expected) if "_)" in rest else _same(ball, expected), _text(ball)


def _prints(logic: Logic, goal: Term, written: List[str], rest: str) -> Tuple[bool, str]:
    try:
        succeeded = logic.once(goal)
    except PrologError as error:
        return False, _text(error.term)
    text = "".join(written)
    return succeeded and text.strip() == rest.strip(), text if succeeded else "false"


def _binds(logic: Logic, goal: Any, answer: str) -> Tuple[bool, str]:
    expected = read_term(answer, logic.operators, flags=ISO)
    names = list(dict.fromkeys(name for name in goal.names if name in expected.names))
    solutions = _alternatives(expected.term)
    found: List[Term] = []
    wanted = [goal.names[name] for name in names]
    others = [goal.names[name] for name in goal.names]
    try:
        for _ in logic.solutions(goal.term):
            found.append(copy(make_list([make_list(wanted), make_list(others)])))
            if len(found) == _MOST:
                break
    except PrologError as error:
        return False, _text(error.term)
    shown = " ; ".join(_text(one[1]) for one in found) or "false"
    if len(found) != len(solutions):
        return False, shown
    for one, solution in zip(found, solutions):
        values = dict(zip(names, _items(one[1])))
        for equation in _equations(solution):
            name = next(name for name, var in expected.names.items() if var is equation[1])
            values.setdefault(name, None)
        pattern = copy((functor("s", 2), make_list([v for v in expected.names.values()]), solution))
        ours = make_list([values[_name(expected, eq[1])] for eq in _equations(solution)])
        theirs = copy(make_list([_filled(eq[2], expected, values, goal, one) for eq in _equations(solution)]))
        del pattern
        if not _same(ours, theirs):
            return False, shown
    return True, shown


def _name(read: Any, var: Any) -> str:
    return next(name for name, one in read.names.items() if one is var)


def _filled(term: Term, expected: Any, values: Any, goal: Any, one: Term) -> Term:
    """Return the expected value with the goal's other variables in it replaced by what they became."""
    from retalis.terms import rebuild

    became = dict(zip(goal.names, _items(deref(deref(one[2])[1]))))
    known = {var: became[name] for name, var in expected.names.items() if name in became}
    return rebuild(term, lambda var: known.get(var, var))


def _items(term: Term) -> List[Term]:
    from retalis.terms import list_items

    return list_items(term) or []


def _alternatives(term: Term) -> List[Term]:
    found = []
    while term.__class__ is tuple and term[0] is _OR:
        found.append(term[1])
        term = deref(term[2])
    return [*found, term]


def _equations(term: Term) -> List[Any]:
    from retalis.terms import conjuncts

    return [deref(one) for one in conjuncts(term)]


def _same(left: Term, right: Term) -> bool:
    """Tell whether terms are the same but for the names of variables."""
    return _text(left) == _text(right)


def _text(term: Term) -> str:
    term = copy(term)
    names = {var: f"_{number}" for number, var in enumerate(variables(term))}
    return write_term(term, quoted=True, ignore_ops=True, variable_names=names)


def main() -> None:
    """Print the cases that do not agree."""
    for file in sorted(path.name for path in DATA.glob("*.txt")):
        program = clauses(file)
        found = [(case, *agrees(case, program)) for case in cases(file)]
        wrong = [(case, answer) for case, good, answer in found if not good]
        for case, answer in wrong:
            print(f"{case.goal}\n    standard  {case.answer}\n    here      {answer}")
        print(f"{file}: {len(found) - len(wrong)} of {len(found)} agree")


if __name__ == "__main__":
    main()
