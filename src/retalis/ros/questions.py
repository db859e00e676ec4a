"""The services that answer questions: ``~query`` and ``~explain``."""

from threading import BoundedSemaphore
from typing import Any, List

from ..engine import Engine, ask, await_memories
from ..engine.explaining import explain, records_origins
from ..foundation import RetalisError, SyntaxFault, UsageError
from ..prolog.machine import Limits, checked_number
from .services import LONGEST_ANSWER, OK, name, provide, reason

MOST = 100
"""Solutions of a query that does not say how many."""

MOST_OF_ALL = 100_000
"""Solutions of a query, whatever it says."""

PATIENCE = 10.0
"""Seconds that a query waits for memories where it does not say how long."""

AT_ONCE = 50
"""Queries that may wait for memories at once: each holds a thread and a connection."""

LONGEST_LINE = LONGEST_ANSWER
"""Characters of a line of an explanation."""

EXPLAINING = 2.0
"""Seconds in which an explanation has to be found: no event is taken meanwhile."""

MOST_LINES = 1_000
"""Lines of an explanation."""

NOT_RECORDED = (
    "what events come from is not recorded: "
    "start the node with ~explain (explain:=true with roslaunch), or call set_etalis_flag(etalis_justification, on)"
)


class Questions:
    """Services ``~query`` and ``~explain`` of node retalis.

    Args:
        engine: answers.
    """

    def __init__(self, engine: Engine):
        from retalis import msg, srv  # noqa: PLC0415 - generated: there only where the package was built

        self._engine = engine
        self._msg, self._srv = msg, srv
        self._waiting = BoundedSemaphore(AT_ONCE)
        provide("~query", srv.Query, self._query)
        provide("~explain", srv.Explain, self._explain)

    def _query(self, request: Any) -> Any:
        response = self._srv.QueryResponse
        try:
            seconds = checked_number("seconds", request.seconds, float)
            limits = Limits(seconds or None, request.inferences or None, output_megabytes=None)
            most = min(request.max_solutions or MOST, MOST_OF_ALL)
            if request.wait_for:
                self._await(request)
            found = ask(self._engine, request.goal, most, limits)
        except SyntaxFault as fault:
            return response(f"error: goal: {fault.brief()}", False, [])
        except RetalisError as error:
            return response(reason(error), False, [])
        solutions = [
            self._msg.Solution([self._msg.Binding(*value) for value in solution])
            for solution in found.solutions
        ]
        return response(OK, found.complete, solutions)

    def _await(self, request: Any) -> None:
        names = [name(text, "wait_for") for text in request.wait_for]
        seconds = checked_number("timeout", request.timeout, float) or PATIENCE
        if not self._waiting.acquire(blocking=False):
            raise UsageError(f"{AT_ONCE} queries wait already")
        try:
            await_memories(self._engine, names, request.stamp.to_nsec(), seconds)
        finally:
            self._waiting.release()

    def _explain(self, request: Any) -> Any:
        response = self._srv.ExplainResponse
        if not records_origins(self._engine):
            return response(f"error: {NOT_RECORDED}", False, [])
        try:
            found = explain(self._engine, request.event, EXPLAINING)
        except RetalisError as error:
            return response(reason(error), False, [])
        lines: List[str] = []
        for tree in found.lines:
            lines += tree.indented()
            if len(lines) > MOST_LINES:
                lines = [*lines[:MOST_LINES], "..."]
                break
        return response(OK, found.happened, [line[:LONGEST_LINE] for line in lines])
