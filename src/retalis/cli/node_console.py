"""Command ``console --node``: a Prolog top level whose goals a running node solves."""

import argparse
import sys
from typing import Sequence, Union

from ..foundation.displayed_text import printable
from ..foundation.errors import SyntaxFault, UsageError
from ..foundation.interrupts import interruptible
from ..prolog.syntax.term_reader import ReadTerm
from ..prolog.syntax.term_writer import write_term
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.types import Atom, deref
from . import toplevel_io
from .node_client import NodeClient, format_solutions, print_json_solutions, require_ok
from .optional_ros_imports import connect_client

_MAX_TERMINAL_SOLUTIONS = 100
"""Limit for the solutions of a goal that is typed in a terminal."""


def run(options: argparse.Namespace) -> int:
    """Run the command: goals are parsed here and solved by the node.

    Returns:
        The exit status: 1 after an error or if a goal of ``--goal`` failed, 0 otherwise and always for a terminal.
    """
    connection = connect_client()
    try:
        if options.files:
            raise UsageError("files are loaded where the console is: leave them out with --node")
        node = NodeClient(connection, options.node)
        return _run_console(NodeConsole(node, options.max_solutions, options.json), options.goal)
    finally:
        connection.end()


def _run_console(console: "NodeConsole", goals: Sequence[str]) -> int:
    for goal in goals:
        console.solve_goals(toplevel_io.open_goal_text(goal))
    if not goals and sys.stdin.isatty():
        print(f"% {console.node.name}: goals end with a full stop; quit. or ctrl-D ends the console")
        console.solve_goals(toplevel_io.TerminalInput(list_names=list))
        return 0
    if not goals:
        console.solve_goals(toplevel_io.PipedInput(sys.stdin))
    return 1 if console.errors or (goals and console.has_failed_goal) else 0


class NodeConsole:
    """Top level whose goals are solved by a node.

    Args:
        max_solutions: limit for the solutions of a goal if the input is not a terminal.
        as_json: whether to print solutions as JSON objects.

    Attributes:
        errors: number of errors.
        has_failed_goal: whether a goal had no solution.
    """

    def __init__(self, node: NodeClient, max_solutions: int, as_json: bool = False):
        self.node = node
        self.errors = 0
        self.has_failed_goal = False
        self._as_json = as_json
        self._max_solutions = max_solutions
        self._logic = PrologSystem()

    def solve_goals(self, source: Union[toplevel_io.PipedInput, toplevel_io.TerminalInput]) -> None:
        """Read and solve goals until the end of the input or ``halt``."""
        while True:
            try:
                parsed = toplevel_io.read_clause(source, self._logic, "?- ")
                if parsed is None:
                    return
                if isinstance(parsed, SyntaxFault):
                    self._print_error(str(parsed))
                    continue
                goal = deref(parsed.term)
                if isinstance(goal, Atom) and goal.name in toplevel_io.QUIT_GOALS:
                    return
                with interruptible():
                    self._solve(parsed, source)
            except UsageError as error:
                self._print_error(str(error))
            except KeyboardInterrupt:
                # At a terminal it ends the goal; the goals of a pipe and of --goal have nobody to ask others.
                if not source.is_terminal:
                    raise
                toplevel_io.discard_unread_text(source)
                print("\n% interrupted", flush=True)

    def _print_error(self, text: str) -> None:
        self.errors += 1
        print(text, file=sys.stderr, flush=True)

    def _solve(
        self, parsed: ReadTerm, source: Union[toplevel_io.PipedInput, toplevel_io.TerminalInput]
    ) -> None:
        variable_names = {var: name for name, var in parsed.names.items()}
        # Parsed and written again: the node gets a single goal without comments, with the names of its variables.
        goal = write_term(parsed.term, self._logic.operators, quoted=True, variable_names=variable_names)
        limit = _MAX_TERMINAL_SOLUTIONS if source.is_terminal else self._max_solutions
        response = require_ok(self.node.call("query", "Query", goal=goal, max_solutions=limit))
        self.has_failed_goal |= not response.solutions
        if self._as_json:
            print_json_solutions(response)
            if not response.complete:
                print("there may be more solutions (see --most)", file=sys.stderr, flush=True)
            return
        texts = list(format_solutions(response))
        if not texts:
            print("false.")
        for number, text in enumerate(texts, 1):
            print(printable(text), end="", flush=True)
            if number < len(texts):
                if not source.wants_more():
                    print(" .")
                    return
                print(" ;", flush=True)
            elif response.complete:
                print(".")
            else:
                print(" .\n% there may be more")
