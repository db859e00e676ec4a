"""Loading what a program's own files say: their goals have other rights and limits than those that come later."""

from pathlib import Path
from typing import Callable, Optional, TypeVar

from ..events.dispatch.dispatcher import Dispatcher
from ..events.program.goal_file import FileGoal, errors_in, goals_of
from ..events.rules.rule_base import RuleBase
from ..foundation.errors import Errors, ProgramErrors, RetalisError, RuleError
from ..prolog.machine.resource_limits import NO_LIMITS
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.types import Term, atom
from .runtime.serial_executor import SerialExecutor

Result = TypeVar("Result")

REQUEST = atom("a request")
"""What is named where work takes long that has no name."""


class ProgramLoader:
    """Loads the texts of a program.

    Args:
        logic: calls goals.
        rules: takes rules.
        runner: lets one piece of work at a time be done, and is told which goal that is.
        dispatcher: of the engine's events, which are not disturbed.
        limited: whether the limits of later goals hold for these too.
        once: calls a goal.
    """

    def __init__(
        self,
        logic: PrologSystem,
        rules: RuleBase,
        runner: SerialExecutor,
        dispatcher: Dispatcher,
        limited: bool,
        once: Callable[[Term], bool],
    ):
        self._logic = logic
        self._rules = rules
        self._files = rules.files
        self._runner = runner
        self._dispatcher = dispatcher
        self._limited = limited
        self._once = once

    def load(self, rules: str, goals: str, source: str, folder: Optional[Path]) -> None:
        """Load the texts of a program, which belong together; see `Engine.load`."""
        together = bool(rules and goals)
        if together:
            self._rules.loader.gather()
        try:
            if goals:
                self.call_goals(goals, f"goals of {source}" if source == "text" else source, folder)
            if rules:
                self.load_rules(rules, source, folder)
        finally:
            if together:
                self._runner.call(self._rules.loader.end_gathering, (REQUEST,))

    def load_rules(self, text: str, source: str, folder: Optional[Path]) -> None:
        """Load the text of an event file; see `Engine.load_rules`."""
        self._own(folder)
        self._load(folder, lambda: self._rules.load_text(text, source, folder))

    def call_goals(self, text: str, source: str, folder: Optional[Path]) -> None:
        """Call the goals of a goal file; see `Engine.call_goals`."""
        self._own(folder)
        errors = Errors()
        for goal in goals_of(text, source, folder, self._logic.operators, self._files, self._load):
            if isinstance(goal, RetalisError):
                errors.append(goal)
                continue
            try:
                if not self._load(goal.folder, lambda: self._start(goal)):  # noqa: B023
                    errors.append(RuleError("this goal fails", goal.place))
            except RetalisError as error:
                errors.extend(errors_in(error, goal.place))
        if errors:
            raise ProgramErrors(errors)

    def _start(self, goal: FileGoal) -> bool:
        """Call a goal of a goal file."""
        budget = self._logic.machine.budget
        self._runner.entry = goal
        limits = budget.limits
        if not self._limited:
            budget.allow(NO_LIMITS)
        try:
            return self._once(goal.term)
        finally:
            budget.allow(limits)

    def _own(self, folder: Optional[Path]) -> None:
        """Count a folder as the program's own."""
        if folder is not None:
            self._files.door.add_own(folder)

    def _load(self, folder: Optional[Path], work: Callable[[], Result]) -> Result:
        """Do work of the program's own files, which stand in a folder: it may name any file."""

        def run() -> Result:
            with self._files.loading(folder):
                return work()

        return self._runner.call(lambda: self._dispatcher.undisturbed(run), (REQUEST,))
