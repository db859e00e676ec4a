"""What a program has of SWI-Prolog: an engine of it for each thread."""

from contextlib import closing
from threading import local
from typing import Callable, Iterator, Optional, Union

from ..logic import Logic
from ..machine import MEGABYTE, Machine
from ..terms import COLON, Term, atom, functor
from .binding import FAILED
from .session import SwiEngine
from .starting import BRIDGE, Started


class SwiProgram:
    """What a program has of SWI-Prolog: an engine for each thread that runs its goals.

    SWI-Prolog notes with an engine where the stack of its thread lies, and ends the process where that is elsewhere
    later. So an engine goes with its thread.

    Args:
        logic: of the program.
        started: SWI-Prolog.
    """

    def __init__(self, logic: Logic, started: Started):
        self._logic = logic
        self._started = started
        self._threads = local()

    def predicate(self, module: str, name: str, arity: int) -> Callable[..., Union[bool, Iterator[object]]]:
        """Return what calls a predicate of a module, for `Logic.define_nondeterministic`."""
        threads, budget = self._threads, self._logic.machine.budget
        handle = self.engine().handle(module, name, arity)
        key = functor(name, arity)
        where = atom(module)

        def call(machine: Machine, *arguments: Term) -> Union[bool, Iterator[object]]:
            try:
                engine: SwiEngine = threads.engine
            except AttributeError:
                engine = self.engine()
            left = budget.left()
            if left is not None and left.inferences is not None:
                goal = (COLON, where, (key, *arguments) if arguments else atom(name))
                return engine.call(machine, engine.limited, (goal, max(left.inferences, 0)), left)
            return engine.call(machine, handle, arguments, left)

        return call

    def engine(self) -> SwiEngine:
        """Return the engine of this thread."""
        found: Optional[SwiEngine] = getattr(self._threads, "engine", None)
        if found is None:
            found = self._threads.engine = SwiEngine(self._logic, self._started)
            megabytes = self._logic.limits.megabytes
            if megabytes is not None:
                self.ask("limit_stacks", int(megabytes * MEGABYTE))
        return found

    def ask(self, name: str, *arguments: Term) -> bool:
        """Call a predicate of the bridge once; its bindings stay."""
        found = self.predicate(BRIDGE, name, len(arguments))(self._logic.machine, *arguments)
        if isinstance(found, bool):
            return found
        with closing(found) as solutions:  # type: ignore[type-var]
            return next(solutions, FAILED) is not FAILED
