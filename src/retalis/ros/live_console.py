"""Prolog top level for a running node: goals are parsed here and solved by the node's service ``~query``."""

import argparse
import sys
from io import StringIO
from typing import Union

from .. import srv
from ..cli import toplevel_io
from ..foundation.errors import SyntaxFault, UsageError, printable
from ..prolog.syntax.term_reader import ReadTerm
from ..prolog.syntax.term_writer import write_term
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.types import Atom, deref
from .live_commands import LiveNode, check_result, solution_lines

_MAX_TERMINAL_SOLUTIONS = 100


def run(options: argparse.Namespace) -> int:
    """Run ``console --node``; from a pipe or with goals the status is 1 if there was an error."""
    if options.files:
        raise UsageError("files are loaded where the console is: leave them out with --node")
    console = LiveConsole(LiveNode(options.node), options.most)
    if options.goal:
        for goal in options.goal:
            console.solve_goals(
                toplevel_io.PipedInput(StringIO(goal if goal.rstrip().endswith(".") else f"{goal} .\n"))
            )
    elif sys.stdin.isatty():
        print(f"% {console.node.name}: goals end with a full stop; quit. or ctrl-D ends the console")
        console.solve_goals(toplevel_io.TerminalInput(list))
        return 0
    else:
        console.solve_goals(toplevel_io.PipedInput(sys.stdin))
    return 1 if console.errors else 0


class LiveConsole:
    """Top level whose goals are solved by a node.

    Args:
        node: the node.
        max_solutions: limit for the solutions of a goal if the input is not a terminal.

    Attributes:
        errors: number of errors.
    """

    def __init__(self, node: LiveNode, max_solutions: int):
        self.node = node
        self.errors = 0
        self._max_solutions = max_solutions
        self._logic = PrologSystem()

    def solve_goals(self, lines: Union[toplevel_io.PipedInput, toplevel_io.TerminalInput]) -> None:
        """Read and solve goals until the end of the input or ``halt``."""
        while True:
            try:
                parsed = toplevel_io.read_clause(lines, self._logic, "?- ")
                if parsed is None:
                    return
                if isinstance(parsed, SyntaxFault):
                    self._print_error(str(parsed))
                    continue
                goal = deref(parsed.term)
                if isinstance(goal, Atom) and goal.name in toplevel_io.QUIT_GOALS:
                    return
                self._solve(parsed, lines)
            except UsageError as error:
                self._print_error(str(error))
            except KeyboardInterrupt:
                lines.unread_text = ""
                print("\n% interrupted", flush=True)

    def _print_error(self, text: str) -> None:
        self.errors += 1
        print(text, file=sys.stderr, flush=True)

    def _solve(
        self, parsed: ReadTerm, lines: Union[toplevel_io.PipedInput, toplevel_io.TerminalInput]
    ) -> None:
        names = {var: name for name, var in parsed.names.items()}
        # Parsed and written again: the node gets a single goal without comments, with the names of its variables.
        goal = write_term(parsed.term, self._logic.operators, quoted=True, variable_names=names)
        limit = _MAX_TERMINAL_SOLUTIONS if lines.is_terminal else self._max_solutions
        response = check_result(self.node.call("query", srv.Query, goal=goal, max_solutions=limit))
        lines_shown = list(solution_lines(response))
        for number, line in enumerate(lines_shown, 1):
            print(printable(line), end="", flush=True)
            if number == len(lines_shown) and response.complete:
                print(".")
            elif number == len(lines_shown) or not lines.wants_more():
                print(" .")
                break
            else:
                print(" ;", flush=True)
        if not lines_shown:
            print("false.")
        elif not response.complete and number == len(lines_shown):
            print("% there may be more")
