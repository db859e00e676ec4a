"""Comparison of the answers to random goals with those of SWI-Prolog.

Usage: python swi_comparison.py COUNT [SEED]      print the differences
       python swi_comparison.py --record COUNT    write goals and SWI-Prolog's answers to goals_kinds.tsv
"""

import random
import re
import sys
from collections import Counter
from pathlib import Path
from typing import Any, List

from retalis import Term

sys.path.insert(0, str(Path(__file__).parent))

from difference_classes import REASONS, reason  # noqa: E402, F401
from random_goals import Generator  # noqa: E402
from swipl import ask  # noqa: E402

from retalis import Limits, PrologError, String, SyntaxFault, functor  # noqa: E402
from retalis.foundation.errors import TermTooLarge  # noqa: E402
from retalis.prolog.syntax.term_reader import read_term  # noqa: E402
from retalis.prolog.syntax.term_writer import write_term  # noqa: E402
from retalis.prolog.system.prolog_system import PrologSystem  # noqa: E402
from retalis.prolog.terms.term_traversal import copy, variables  # noqa: E402

RECORD = Path(__file__).with_name("goals_kinds.tsv")
MAX_SOLUTIONS = 5
_FREE_NAME = re.compile(r"_G?[0-9]+")
_SYNTAX_ERROR = re.compile(r"(?<=^error\()syntax_error\(.*\)(?=\)$)")
_ERROR = functor("error", 2)
_RESOURCE = functor("resource_error", 1)
_NUMBERED = functor("$VAR", 1)


def answer(text: str) -> str:
    """Return the answer to a goal: the list of instantiated goals or the error term, and the output."""
    logic = PrologSystem()
    logic.limits = Limits(inferences=200_000, seconds=5, megabytes=300)
    output: List[str] = []
    logic.output = output.append
    logic.error_output = lambda text: None
    try:
        goal = read_term(text, logic.operators).term
    except SyntaxFault:
        return "unread"
    try:
        result = solutions(logic, goal)
    except PrologError as error:
        result = fault(error.term)
    except Exception as error:
        result = f"raised {error!r}"
    printed = "".join(output)
    return result + (f" printed {write_term(String(printed))}" if printed else "")


def solutions(logic: PrologSystem, goal: Term) -> str:
    """Return the first instances of a goal that are true, as the text of a list."""
    instances: List[Any] = []
    for _ in logic.solutions(goal):
        instances.append(shown(goal))
        if len(instances) == MAX_SOLUTIONS:
            break
    return f"[{','.join(instances)}]"


def fault(term: Term) -> str:
    """Return the text of an error: of its formal term, or of the ball."""
    if term.__class__ is not tuple or term[0] is not _ERROR:
        return f"ball({shown(term)})"
    formal = term[1]
    if formal.__class__ is tuple and formal[0] is _RESOURCE:
        return "limit"
    return f"error({shown(formal)})"


def shown(term: Term) -> str:
    """Return a term as canonical text with its variables named in order."""
    try:
        numbered = copy(term)
    except TermTooLarge:
        return "cyclic"
    for number, var in enumerate(variables(numbered)):
        var.ref = (_NUMBERED, number)
    return write_term(numbered, quoted=True, ignore_ops=True, numbervars=True)


def plain(answer: str) -> str:
    """Return an answer without names of variables and texts of syntax errors, which may differ."""
    answer = _FREE_NAME.sub("_", answer)
    return _SYNTAX_ERROR.sub("syntax_error(_)", answer)


def main() -> None:
    """Compare the answers, or record those of SWI-Prolog."""
    if sys.argv[1] == "--record":
        texts = Generator(7).goals(int(sys.argv[2]))
        rows = [(text, reply) for text, reply in zip(texts, ask(texts)) if reply not in ("limit", "lost")]
        RECORD.write_text("".join(f"{text}\t{reply}\n" for text, reply in rows))
        return
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else random.randrange(1 << 30)
    texts = Generator(seed).goals(int(sys.argv[1]))
    classes: Counter = Counter()
    for text, theirs in zip(texts, ask(texts)):
        ours = answer(text)
        if plain(ours) != plain(theirs):
            name = reason(text, ours, theirs) or "unexplained"
            classes[name] += 1
            print(f"{name}: {text}\n  here  {ours}\n  swipl {theirs}")
    print(f"seed {seed}: {len(texts) - sum(classes.values())} of {len(texts)} agree")
    for name, count in classes.most_common():
        print(f"{count:6} {name}")


if __name__ == "__main__":
    main()
