"""Goals that Python code calls: compiled once, with inputs and outputs by position."""

from typing import Any, List, Optional, Sequence, Union

from ...foundation.errors import Place
from ..compiler.clause_nodes import KnownPredicate
from ..compiler.goal_code import GoalGenerator
from ..machine.errors import PrologError, from_python
from ..machine.machine import BAIL, Code
from ..terms.types import Frame, Term, Values, Var
from ..terms.unification import undo
from .database import Database

_MAX_BAILS = 20


class CompiledGoal:
    """A goal compiled with inputs and outputs; made by `Logic.compile_goal`.

    Attributes:
        straight: a Python function of the inputs that returns the outputs of the first solution or None;
            `BAIL` where it cannot tell, and None where the goal needs the machine.
        code: runs the goal without its outputs, by frames ``(code, inputs..., next)``.
        name: who asks, for errors.
        term: the goal.
        place: where it was read.
        from_outside: whether others than the program have given it: then it may not change flags.
    """

    def __init__(
        self,
        database: Database,
        term: Term,
        inputs: Sequence[Var],
        outputs: Sequence[Term],
        place: Optional[Place] = None,
        name: str = "goal",
        from_outside: bool = False,
    ):
        self.term = term
        self.from_outside = from_outside
        self.place = place
        self.name = name
        self._database = database
        self._machine = database.machine
        self._inputs = tuple(inputs)
        self._outputs = tuple(outputs)
        self._source = GoalGenerator(database, term, self._inputs, self._outputs, place, name)
        self._source.parse()
        self._compile()
        database.goals.add(self)

    def _compile(self) -> None:
        """Set up code that is generated when it is first run."""
        source = self._source
        self.straight: Any = self._first_straight
        self._bailed = 0
        self._handing_over = Code(self.name, self._first_enter)
        called = source.call()
        self.code: Union[Code, KnownPredicate] = (
            Code(self.name, self._first_plain) if called is None else called
        )

    def forget(self) -> None:
        """Drop code whose references to predicates are out of date."""
        self._source.parse()
        self.straight = self._first_straight
        self._handing_over.run = self._first_enter
        code: Any = self.code
        if code.__class__ is Code:  # others may have it
            code.run, code.steady = self._first_plain, False
        else:
            self.code = self._source.call() or Code(self.name, self._first_plain)

    def _first_straight(self, *values: Term) -> Any:
        # Not before it is first called: the predicates that it calls may be defined after it. A goal from outside has
        # none: an attempt that calls the function does not tell the budget which goal is at work.
        self.straight = None if self.from_outside else self._source.straight()
        return BAIL if self.straight is None else self.straight(*values)

    def prepare(self) -> None:
        """Make the function before the goal is first asked, where all that it calls is there."""
        if self.straight != self._first_straight or self.from_outside:
            return
        try:
            self.straight = self._source.straight() or self._first_straight
        except (PrologError, RecursionError):  # whoever asks the goal gets the error
            return

    def bail(self) -> None:
        """Note that the function could not tell; where that happens often it is not asked any more."""
        self._bailed += 1
        if self._bailed > _MAX_BAILS:
            self.straight = None

    def _first_enter(self, frame: Frame) -> Optional[Frame]:
        self._handing_over.run, _ = self._source.enter(True)
        return self._handing_over.run(frame)

    def _first_plain(self, frame: Frame) -> Optional[Frame]:
        run, steady = self._source.enter(False)
        code: Any = self.code  # not a predicate here: those run themselves
        code.run, code.steady = run, steady
        return self.code.run(frame)

    def enter(self, values: Values, collector: Frame) -> Frame:
        """Return the frame that runs the goal and hands its resolved outputs over.

        For each solution it calls ``collector[0].take(collector, outputs)``, which returns the frame to go
        on with.
        """
        return (self._handing_over, *values, collector)

    def test(self, values: Values) -> Optional[Values]:
        """Run the goal at once.

        Args:
            values: of the inputs, by position.

        Returns:
            The resolved outputs of the first solution, or None. No bindings are left.

        Raises:
            PrologError: what the goal threw.
        """
        budget = self._machine.budget
        if budget.closed:
            budget.admit()
        asked = budget.goal
        budget.goal = self
        try:
            if self.straight is not None:
                result: Any = self._ask_straight(values)
                if result is not BAIL:
                    return result  # type: ignore[no-any-return]
                self.bail()
            return self._run(values)
        finally:
            budget.goal = asked

    def _run(self, values: Values) -> Optional[Values]:
        machine = self._machine
        mark = len(machine.trail)
        if not self._outputs:
            frame = (self.code, *values, machine.done)
            if self.code.steady:
                return () if machine.check(frame, self) else None
            succeeded = machine.run(frame)
            undo(machine.trail, mark)
            return () if succeeded else None
        found: List[Values] = []
        if not machine.run((self._handing_over, *values, (_STORE, found, machine.done))):
            return None
        undo(machine.trail, mark)
        return found[0]

    def _ask_straight(self, values: Values) -> Any:
        """Return what the function says, with the errors and under the limits of a run."""
        machine = self._machine
        budget = machine.budget
        limited = budget.limited
        saved = budget.enter() if limited else None
        mark = len(machine.trail)
        try:
            return self.straight(*values)
        except BaseException as exc:
            undo(machine.trail, mark)
            error = from_python(exc)
            if error is None or error is exc:
                raise
            raise error from exc
        finally:
            if limited:
                budget.leave(saved)

    def all(self, values: Values) -> List[Values]:
        """Run the goal at once and return the resolved outputs of all its solutions."""
        machine = self._machine
        mark = len(machine.trail)
        found: List[Values] = []
        machine.run((self._handing_over, *values, (_STORE_ALL, found)))
        undo(machine.trail, mark)
        return found

    def __repr__(self) -> str:
        return f"<Goal {self.name}>"


class _KeepOne:
    """Continuation that keeps the outputs and goes on."""

    def take(self, frame: Frame, outputs: Values) -> Frame:
        frame[1].append(outputs)
        return frame[2]  # type: ignore[no-any-return]


class _KeepAll:
    """Continuation that keeps the outputs and asks for the next solution."""

    def take(self, frame: Frame, outputs: Values) -> None:
        frame[1].append(outputs)


_STORE = _KeepOne()
_STORE_ALL = _KeepAll()
