"""Loading of a program's own files: their goals may read files, and have other limits than goals that run later."""

from pathlib import Path
from typing import Callable, Optional, TypeVar

from ..events.dispatch.dispatcher import Dispatcher
from ..events.program.goal_file import FileGoal, errors_in, read_file_goals
from ..events.rules.rule_base import RuleBase
from ..foundation.errors import Errors, ProgramErrors, RetalisError, RuleError
from ..prolog.machine.resource_limits import NO_LIMITS
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.types import Term, atom
from .runtime.serial_executor import SerialExecutor

Result = TypeVar("Result")

REQUEST = atom("a request")
"""Name of unnamed work in warnings about its duration."""


class ProgramLoader:
    """Loads the texts of a program.

    Args:
        logic: calls goals.
        rules: receives rules.
        executor: executes the goals exclusively and is told which goal runs.
        dispatcher: its event context is restored if loading raises an exception.
        has_start_limits: whether the limits of later goals also apply to goals of files.
        once: calls a goal.
    """

    def __init__(
        self,
        logic: PrologSystem,
        rules: RuleBase,
        executor: SerialExecutor,
        dispatcher: Dispatcher,
        has_start_limits: bool,
        once: Callable[[Term], bool],
    ):
        self._logic = logic
        self._rules = rules
        self._files = rules.files
        self._executor = executor
        self._dispatcher = dispatcher
        self._has_start_limits = has_start_limits
        self._once = once

    def load(self, rules: str, goals: str, source: str, folder: Optional[Path]) -> None:
        """Load the texts of a program; see `Engine.load`."""
        has_both = bool(rules and goals)
        # Goals and rules may refer to each other, so warnings about unknown predicates wait until both are loaded.
        if has_both:
            self._rules.loader.defer_warnings()
        try:
            if goals:
                self.call_goals(goals, f"goals of {source}" if source == "text" else source, folder)
            if rules:
                self.load_rules(rules, source, folder)
        finally:
            if has_both:
                self._executor.call(self._rules.loader.log_deferred_warnings, (REQUEST,))

    def load_rules(self, text: str, source: str, folder: Optional[Path]) -> None:
        """Load the text of an event file; see `Engine.load_rules`."""
        self._register_own(folder)
        self._load(folder, lambda: self._rules.load_text(text, source, folder))

    def call_goals(self, text: str, source: str, folder: Optional[Path]) -> None:
        """Call the goals of a goal file; see `Engine.call_goals`."""
        self._register_own(folder)
        errors = Errors()
        # Each goal is read after the previous one has run, because a goal may define operators for later goals.
        for goal in read_file_goals(text, source, folder, self._logic.operators, self._files, self._load):
            if isinstance(goal, RetalisError):
                errors.append(goal)
                continue
            try:
                if not self._load(goal.folder, lambda: self._call_file_goal(goal)):  # noqa: B023
                    errors.append(RuleError("this goal fails", goal.place))
            except RetalisError as error:
                errors.extend(errors_in(error, goal.place))
        if errors:
            raise ProgramErrors(errors)

    def _call_file_goal(self, goal: FileGoal) -> bool:
        """Call a goal of a goal file."""
        budget = self._logic.machine.budget
        # The watchdog names this entry, with its place in the file, if the goal takes long.
        self._executor.entry = goal
        limits = budget.limits
        if not self._has_start_limits:
            budget.set_limits(NO_LIMITS)
        try:
            return self._once(goal.term)
        finally:
            budget.set_limits(limits)

    def _register_own(self, folder: Optional[Path]) -> None:
        """Register a folder as the program's own."""
        if folder is not None:
            self._files.sandbox.add_program_folder(folder)

    def _load(self, folder: Optional[Path], work: Callable[[], Result]) -> Result:
        """Execute a function with the permission to read any file; relative paths start in ``folder``."""

        def run_with_files() -> Result:
            with self._files.loading(folder):
                return work()

        return self._executor.call(lambda: self._dispatcher.run_restoring_context(run_with_files), (REQUEST,))
