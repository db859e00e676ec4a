#!/usr/bin/env python3
"""Conformity test with Prolog files of other projects: answers of this package and of SWI-Prolog to the same goals.

    bench/answers.py FOLDER [--swi-results FILE.json] [--most N] [--goals N] [--seconds S] [--only WORD]
                            [--details FILE.json]

Each folder in FOLDER is a repository, of which N files are taken, as by ``bench/corpus.py``. Both Prologs load a file
and are asked the same goals: the queries that its comments show (``% ?- goal.``), and each of its predicates with
variables as arguments. What loading prints, what a goal prints, its first five solutions with their variables
renamed, and the error that ends them are compared. Goals that take more than 300,000 inferences in SWI-Prolog, and
those that it answers in two ways when it is asked twice (random numbers, times), are left out.

A line for each repository says how many of its files and goals were compared and how many were answered alike, first
of all files, then of those that load no library that is not here. Lines after that count what is answered
differently, in how many files, with the first such goal. The files are programs of strangers: they run as
``bench/corpus.py`` runs them, and where it cannot, nothing is run.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any, Dict, Iterator, List, NamedTuple, Tuple

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "bench"), str(ROOT / "src")]

from arguments import above_zero, existing, positive, target  # noqa: E402
from corpus import chosen, closed, is_closed, kind  # noqa: E402

from retalis import Engine, Limits, PrologError, RetalisError, Settings, SyntaxFault, Term, deref, functor  # noqa: E402
from retalis.foundation.errors import TermTooLarge  # noqa: E402
from retalis.prolog.machine.resource_limits import LimitError  # noqa: E402
from retalis.prolog.syntax.term_reader import read_term  # noqa: E402
from retalis.prolog.syntax.term_writer import write_term  # noqa: E402
from retalis.prolog.system.prolog_system import PrologSystem  # noqa: E402
from retalis.prolog.terms.term_traversal import copy, variables  # noqa: E402

MOST_SOLUTIONS = 5
PRINTED = 20_000
"""Limit for the compared characters of a goal's output."""

LIBRARIES = "libraries that are not here"
_BEGIN, _RESULT, _END = "\n@@begin ", "\n@@result ", "\n@@end\n"

_SWI = r"""
:- use_module(library(unix)).
:- use_module(library(solution_sequences)).
:- use_module(library(readutil)).

:- dynamic '$module'/1.

'$answers' :-
    current_prolog_flag(argv, Arguments), append(_, [Name, Queries, Most], Arguments),
    absolute_file_name(Name, File),
    format("~n@@begin load~n"),
    catch(load_files(user:File, []), E, print_message(error, E)),
    format("~n@@result loaded~n@@end~n"),
    (   module_property(Module, file(File)) -> true ; Module = user ),
    assertz('$module'(Module)),
    read_file_to_terms(Queries, Examples, []),
    forall(member(Example, Examples), '$text'(Example)),
    atom_number(Most, Number),
    findall(Module:Plain, '$of_file'(File, Module, Plain), Heads0), sort(Heads0, Heads),
    forall(limit(Number, member(_:Head, Heads)), '$asked'(Module, Head)).

'$of_file'(File, Module, Plain) :-
    source_file(Module:Plain, File),
    \+ predicate_property(Module:Plain, multifile),
    functor(Plain, Name, _), \+ ( member(Own, [$, '__aux', 'unit ']), sub_atom(Name, 0, _, _, Own) ).

'$text'(Text) :-
    '$module'(Module),
    (   catch(term_to_atom(Goal0, Text), _, fail), nonvar(Goal0)
    ->  '$asked'(Module, Goal0)
    ;   true
    ).

'$asked'(Module, Goal) :-
    (   Module == user -> Whole = Goal ; Whole = Module:Goal ),
    format("~n@@begin "), '$shown'(Whole), nl, flush_output,
    fork(Pid),
    (   Pid == child
    ->  alarm(8, exec(false), _, []),
        '$found'(Module:Goal, Goal, R), format("~n@@result "), '$result'(R), nl, flush_output, exec(true)
    ;   wait(Pid, Status),
        (   Status == exited(0) -> true ; format("~n@@result lost~n") ),
        format("~n@@end~n"), flush_output
    ).

'$found'(Whole, Goal, R) :-
    catch(call_with_inference_limit(findall(Goal, limit(5, Whole), L), 300 000, Within), E, true),
    (   nonvar(E) -> R = raised(E)
    ;   Within == inference_limit_exceeded -> R = limit
    ;   R = found(L)
    ).

'$result'(limit) :- write(limit).
'$result'(found(L)) :- write('['), '$items'(L), write(']').
'$result'(raised(E)) :-
    (   subsumes_term(error(resource_error(_), _), E) -> write(limit)
    ;   subsumes_term(error(_, _), E) -> arg(1, E, F), write('error('), '$shown'(F), write(')')
    ;   write('ball('), '$shown'(E), write(')')
    ).

'$items'([]).
'$items'([X]) :- !, '$shown'(X).
'$items'([X|Xs]) :- '$shown'(X), write(','), '$items'(Xs).

'$shown'(T) :-
    (   acyclic_term(T)
    ->  copy_term(T, C, Left),
        (   Left == [] -> true ; write(constrained) ),
        numbervars(C, 0, _),
        write_term(C, [quoted(true), ignore_ops(true), numbervars(true)])
    ;   write(cyclic)
    ).
""".replace("300 000", "300_000")


class Answer(NamedTuple):
    """Output and solutions of a goal."""

    printed: str
    result: str

    @property
    def plain(self) -> Tuple[str, str]:
        """The answer without differences that do not matter: variable names, modules of missing predicates."""
        result = _SYNTAX_ERROR.sub("syntax_error(_)", _FREE_NAME.sub("_", self.result))
        result = _MODULE.sub(r"\1", result)
        if result == "error(permission_error(halt,process,true))":
            result = "halted"
        printed = _STREAM.sub("<stream>", _FREE_NAME.sub("_", self.printed))
        return printed.strip("\n"), result


Answers = Dict[str, Answer]
"""Answers by goal, in order; ``load`` stands for the output of loading."""

_FREE_NAME = re.compile(r"_G?[0-9]+")
_MODULE = re.compile(r"(?<=existence_error\(procedure,):\([^,]*,(.*)\)(?=\)\)$)")
_MISSING = re.compile(r"Unknown library: (\S+?):")
_STREAM = re.compile(r"<stream>\(0x[0-9a-f]+\)")
_SYNTAX_ERROR = re.compile(r"(?<=^error\()syntax_error\(.*\)(?=\)$)")
_QUERY = re.compile(r"^[\s%*|]*\?-\s*([^%\n]*?[^%\n.\s])\s*\.(?=\s|$)", re.MULTILINE)
_COMMENT = re.compile(r"/\*.*?\*/|%[^\n]*", re.DOTALL)


def queries(text: str, most: int) -> List[str]:
    """Return the queries in the comments of a program, without duplicates."""
    found = (query for comment in _COMMENT.findall(text) for query in _QUERY.findall(comment))
    return list(dict.fromkeys(found))[:most]


def parts(output: str) -> Iterator[Tuple[str, Answer]]:
    """Yield the goals and answers in the output of a Prolog."""
    for part in output.split(_BEGIN)[1:]:
        goal, _, rest = part.partition("\n")
        printed, marked, result = rest.partition(_END)[0].rpartition(_RESULT)
        yield (
            goal,
            (Answer(printed[:PRINTED], result.strip()) if marked else Answer(result[:PRINTED], "halted")),
        )


def ask_swi(path: Path, goals: int, seconds: float, program: str) -> Answers:
    """Return SWI-Prolog's answers for a file, without inconsistent and timed-out goals."""
    text = path.read_text(encoding="utf-8", errors="replace")
    with tempfile.TemporaryDirectory() as folder:
        asking, examples = Path(folder) / "asking.pl", Path(folder) / "examples.pl"
        asking.write_text(_SWI, encoding="utf-8")
        examples.write_text(
            "".join(f"{json.dumps(one)}.\n" for one in queries(text, goals)), encoding="utf-8"
        )
        command = [
            program,
            "-q",
            "-f",
            "none",
            "--no-tty",
            "-l",
            str(asking),
            "-g",
            "'$answers',halt",
            "-t",
            "halt(1)",
            "--",
        ]
        command += [str(path), str(examples), str(goals)]
        both = []
        for _ in range(2):
            try:
                both.append(dict(parts(closed(command, path, 3 * seconds).stdout)))
            except subprocess.TimeoutExpired:
                return {}
    first, second = both
    return {
        goal: answer
        for goal, answer in first.items()
        if answer.result not in ("limit", "lost") and goal in second and answer.plain == second[goal].plain
    }


def ask_here(path: Path, goals: List[str], seconds: float) -> Answers:
    """Return the answers of this package."""
    with tempfile.TemporaryDirectory() as folder:
        asked = Path(folder) / "goals.json"
        asked.write_text(json.dumps(goals), encoding="utf-8")
        command = [
            sys.executable,
            str(Path(__file__).resolve()),
            "--ask",
            str(asked),
            "--seconds",
            str(seconds),
            str(path),
        ]
        try:
            return dict(parts(closed(command, path, seconds * (len(goals) + 2)).stdout))
        except subprocess.TimeoutExpired:
            return {}


def tell(path: Path, goals: List[str], seconds: float) -> None:
    """Load a file in this process and print its answers; each goal runs in its own process."""
    engine = Engine(settings=Settings(limits=Limits(seconds=seconds), folders=None))
    logic = engine.logic
    logic.output = lambda text: print(text, end="")
    logic.error_output = lambda text: None
    missing: List[str] = []
    engine.rules.on_warning = lambda one: missing.extend(_MISSING.findall(str(one)))
    print(f"{_BEGIN}load")
    try:
        engine.load_program(path)
    except RetalisError as error:
        print(f"{_RESULT}{kind(str(error))}", end=_END)
    else:
        print(f"{_RESULT}loaded", end=_END)
    print(f"{_BEGIN}{LIBRARIES}\n{_RESULT}{' '.join(missing)}", end=_END)
    for goal in goals:
        print(f"{_BEGIN}{goal}", flush=True)
        child = os.fork()
        if child == 0:
            try:
                found = result(logic, goal)
            except Exception as error:
                found = f"raised {error!r}"
            print(f"{_RESULT}{found}", flush=True)
            os._exit(0)
        os.waitpid(child, 0)
        print(end=_END)


def result(logic: PrologSystem, text: str) -> str:
    """Return the instances of a goal that are true, or the error."""
    try:
        goal = read_term(text, logic.operators).term
    except SyntaxFault:
        return "unread"
    plain: Any = deref(goal)
    if plain.__class__ is tuple and plain[0] is functor(":", 2):
        plain = plain[2]
    found = []
    try:
        for _ in logic.solutions(goal):
            found.append(shown(plain))
            if len(found) == MOST_SOLUTIONS:
                break
    except LimitError:
        return "limit"
    except PrologError as error:
        term = deref(error.term)
        if term.__class__ is not tuple or term[0] is not functor("error", 2):
            return f"ball({shown(term)})"
        formal: Any = deref(term[1])
        return (
            "limit"
            if formal.__class__ is tuple and formal[0].name == "resource_error"
            else f"error({shown(formal)})"
        )
    return f"[{','.join(found)}]"


def shown(term: Term) -> str:
    """Return a term as canonical text with its variables named in order."""
    try:
        numbered = copy(term)
    except TermTooLarge:
        return "cyclic"
    for number, var in enumerate(variables(numbered)):
        var.ref = (functor("$VAR", 1), number)
    return write_term(numbered, quoted=True, ignore_ops=True, numbervars=True)


def difference(wanted: Answer, found: Answer) -> str:
    """Return a short description of the difference between two answers."""
    if found.result in ("limit", "unread", "halted") or found.result.startswith("raised"):
        return found.result[:60]
    if found.result.startswith("error("):
        return f"error here: {found.result[6:90]}"
    if wanted.plain[1] == found.plain[1]:
        return "prints something else"
    if wanted.result.startswith("error("):
        return f"error there: {wanted.result[6:90]}"
    if wanted.result == "[]" or found.result == "[]":
        return "fails here" if found.result == "[]" else "fails there"
    return "other solutions"


class Table:
    """Counts of files and goals: all, and those of files whose libraries are available."""

    def __init__(self) -> None:
        self.rows: Dict[str, List[int]] = defaultdict(lambda: [0] * 8)
        self.kinds: Dict[str, List[Tuple[str, str]]] = defaultdict(list)
        self.details: Dict[str, Any] = {}

    def add(self, name: str, wanted: Answers, found: Answers) -> None:
        """Count the goals of a file. A file without goals or output is not counted."""
        if not any(answer.printed.strip() or goal != "load" for goal, answer in wanted.items()):
            return
        none = Answer("", "not answered")
        wrong = {
            goal: (answer, found.get(goal, none))
            for goal, answer in wanted.items()
            if found.get(goal, none).plain != answer.plain
        }
        missing = found.get(LIBRARIES, Answer("", "")).result
        row = self.rows[name.split("/")[0]]
        for at, number in enumerate((1, not wrong, len(wanted), len(wanted) - len(wrong))):
            row[at] += number
            row[at + 4] += 0 if missing else number
        self.details[name] = {"missing": missing, "wrong": wrong}
        for what in Counter(
            "a library is not here" if missing else difference(*both) for both in wrong.values()
        ):
            goal = next(goal for goal, both in wrong.items() if missing or difference(*both) == what)
            self.kinds[what].append((name, goal))

    def show(self) -> None:
        """Print the table, and the number of files for each difference."""
        print(
            f"{'repository':45} {'files':>6} {'alike':>6} {'goals':>6} {'alike':>6}   {'with all libraries':>27}"
        )
        rows = sorted(self.rows.items())
        for name, row in [*rows, ("all", [sum(row[at] for _, row in rows) for at in range(8)])]:
            print(f"{name:45} {' '.join(f'{n:6}' for n in row[:4])}   {' '.join(f'{n:6}' for n in row[4:])}")
        shares = " ".join(f"{100 * row[at + 1] / max(1, row[at]):5.1f}%" for at in (0, 2, 4, 6))
        print(f"{'alike, of files and goals':45} {shares}")
        for what, where in sorted(self.kinds.items(), key=lambda item: -len(item[1])):
            print(f"{len(where):4} {what}  | {where[0][0]}: {where[0][1][:60]}")


def compare(options: argparse.Namespace) -> Table:
    """Compare all files; SWI-Prolog runs only if the file of results does not contain its answers."""
    kept, table = options.swi_results, Table()
    known: Dict[str, Answers] = {}
    if kept is not None and kept.exists():
        for name, answers in json.loads(kept.read_text(encoding="utf-8")).items():
            known[name] = {goal: Answer(*answer) for goal, answer in answers.items()}
    for path in chosen(options.folder, options.most, options.only):
        name, whole = str(path), options.folder / path
        if name not in known:
            known[name] = ask_swi(whole, options.goals, options.seconds, options.swipl)
            if kept is not None:
                kept.write_text(json.dumps(known), encoding="utf-8")
        wanted = known[name]
        if wanted:
            table.add(
                name, wanted, ask_here(whole, [goal for goal in wanted if goal != "load"], options.seconds)
            )
    return table


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("folder", nargs="?", type=existing, help="holds a folder for each repository")
    add(
        "--swi-results",
        type=target,
        metavar="FILE",
        help="keep what SWI-Prolog answers, and take it from there",
    )
    add("--swipl", default="swipl", metavar="PROGRAM", help="SWI-Prolog")
    add("--most", type=positive, default=25, metavar="N", help="files of a repository (25)")
    add(
        "--goals",
        type=positive,
        default=25,
        metavar="N",
        help="queries of a file, and predicates (25 of each)",
    )
    add("--seconds", type=above_zero, default=10.0, metavar="S", help="time of a goal here (10)")
    add("--only", default="", metavar="WORD", help="files with this in their names")
    add("--details", type=target, metavar="FILE", help="write both answers of what differs, as JSON")
    add("--ask", type=existing, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.folder is None:
        parser.error("which folder?")
    if options.ask is not None:
        tell(options.folder, json.loads(options.ask.read_text(encoding="utf-8")), options.seconds)
        return 0
    if not is_closed():
        parser.error("unshare(1) makes no process without network and with a read-only file system here")
    options.folder = options.folder.resolve()
    table = compare(options)
    table.show()
    if options.details is not None:
        options.details.write_text(json.dumps(table.details, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
