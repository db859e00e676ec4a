"""Loading of a program's files.

While files are loaded, their goals may read any file, and they can have other limits than goals that run later.
`ProgramLoader.load_folder` records what a folder has created (its `Deployment`), so that `hot_reload` can replace it.
"""

import os
from pathlib import Path
from typing import Callable, ContextManager, Dict, Optional, TypeVar

from ..events.dispatch.dispatcher import Dispatcher
from ..events.program.goal_file import FileGoal, errors_of_goal, read_file_goals
from ..events.program.topic_configuration import GOALS, Topics, find_topics, read_text
from ..foundation.errors import (
    Errors,
    ProgramErrors,
    RetalisError,
    RuleError,
    UsageError,
)
from ..prolog.machine.resource_limits import NO_LIMITS
from ..prolog.terms.types import Term, atom
from .loaded_items import (
    EMPTY_DEPLOYMENT,
    Deployment,
    LoadedProgram,
    current_deployment,
)
from .runtime.serial_executor import UNNAMED_REQUEST, SerialExecutor

Result = TypeVar("Result")


LOADING_WORK = atom("the program's folder")
"""Name in reports for the load of a folder during a reload."""


class ProgramLoader:
    """Loads the texts of a program.

    Args:
        program: receives the contents of the files.
        executor: runs the goals; its `entry` is set to the running goal, for the watchdog.
        dispatcher: its event context is restored if loading raises an exception.
        limits_file_goals: whether the limits of later goals also apply to goals of files.
        call_once: calls a goal, and returns whether it succeeds.
        declare_topics: receives the topics of a folder; None if its ``pub_sub.xml`` is invalid or missing.
        await_constants: returns a context in which constants of unknown types are accepted, because the folder can be
            loaded again.

    Attributes:
        program: the program that receives the contents of the files.
        deployments: deployments by the real path of the program's folder.
    """

    def __init__(
        self,
        program: LoadedProgram,
        executor: SerialExecutor,
        dispatcher: Dispatcher,
        limits_file_goals: bool,
        call_once: Callable[[Term], bool],
        declare_topics: Callable[[Optional[Topics]], None],
        await_constants: Callable[[], ContextManager[object]],
    ):
        self.program = program
        self.deployments: Dict[str, Deployment] = {}
        self._files = program.rules.files
        self._executor = executor
        self._dispatcher = dispatcher
        self._limits_file_goals = limits_file_goals
        self._call_once = call_once
        self._declare_topics = declare_topics
        self._await_constants = await_constants

    def load(self, rules: str, goals: str, source: str, folder: Optional[Path]) -> None:
        """Load the texts of a program; see `Engine.load`."""
        has_both = bool(rules and goals)
        # Goals and rules may refer to each other, so warnings about unknown predicates wait until both are loaded.
        if has_both:
            self.program.loader.defer_warnings()
        try:
            if goals:
                self.call_goals(goals, f"goals of {source}" if source == "text" else source, folder)
            if rules:
                self.load_rules(rules, source, folder)
        finally:
            if has_both:
                self._executor.call(self.program.loader.log_deferred_warnings, (UNNAMED_REQUEST,))

    def load_rules(self, text: str, source: str, folder: Optional[Path]) -> None:
        """Load the text of an event file; see `Engine.load_rules`."""
        self._register_program_folder(folder)
        self._run_with_file_permissions(folder, lambda: self.program.loader.load_text(text, source, folder))

    def call_goals(self, text: str, source: str, folder: Optional[Path]) -> None:
        """Call the goals of a goal file; see `Engine.call_goals`."""
        self._register_program_folder(folder)
        errors = Errors()
        # Each goal is read after the previous one has run, because a goal may define operators for later goals.
        for goal in read_file_goals(
            text, source, folder, self.program.logic.operators, self._files, self._run_with_file_permissions
        ):
            if isinstance(goal, RetalisError):
                errors.append(goal)
                continue
            try:
                if not self._run_with_file_permissions(goal.folder, lambda: self._call_file_goal(goal)):  # noqa: B023
                    errors.append(RuleError("this goal fails", goal.place))
            except RetalisError as error:
                errors.extend(errors_of_goal(error, goal.place))
        if errors:
            raise ProgramErrors(errors)

    def load_folder(self, folder: Path) -> None:
        """Load a program's folder or an event file, and record its deployment; see `Engine.load_program`."""
        key = resolve_path(folder)
        before = current_deployment(self.program)
        try:
            self.load_files(folder)
        finally:
            # Also after an error: what was loaded before the error belongs to the folder, and a reload replaces it.
            self.deployments[key] = self.deployments.get(key, EMPTY_DEPLOYMENT).union(
                current_deployment(self.program).added_since(before)
            )

    def load_alone(self, folder: Path, omitted: Dict[str, int]) -> Deployment:
        """Load a program's folder into an engine that serves this trial only; return the deployment.

        Args:
            folder: the folder.
            omitted: numbers of the terms that may be omitted from each file, see `SourceFiles.reloading`.
        """
        self.program.logic.discard_output()
        with self._files.reloading(omitted):
            self._executor.call(lambda: self.load_files(folder), (LOADING_WORK,))
        return current_deployment(self.program)

    def load_files(self, folder: Path) -> None:
        """Load a program's folder or an event file, without a record of its deployment."""
        with self._await_constants():
            self._load_files(folder)

    def _load_files(self, folder: Path) -> None:
        if os.path.isfile(folder):
            self.load_rules(read_text(folder), str(folder), folder.parent)
            return
        if not os.path.isdir(folder):
            raise UsageError(f"cannot read {folder}: there is no such file or folder")
        path = folder / GOALS
        # Types of event names and the form of strings must be known before the goals run: rules in the folder are
        # checked against them.
        self._declare_topics(find_topics(folder))
        self.call_goals(read_text(path), str(path), folder)

    def _call_file_goal(self, goal: FileGoal) -> bool:
        budget = self.program.logic.machine.budget
        # The watchdog names this entry, with its place in the file, if the goal takes long.
        self._executor.replace_entry(goal)
        limits = budget.limits
        if not self._limits_file_goals:
            budget.set_limits(NO_LIMITS)
        try:
            return self._call_once(goal.term)
        finally:
            budget.set_limits(limits)

    def _register_program_folder(self, folder: Optional[Path]) -> None:
        """Register a folder as the program's own."""
        if folder is not None:
            self._files.sandbox.add_program_folder(folder)

    def _run_with_file_permissions(self, folder: Optional[Path], work: Callable[[], Result]) -> Result:
        """Execute a function with the permission to read any file; relative paths start in ``folder``."""

        def run_with_files() -> Result:
            with self._files.loading(folder):
                return work()

        return self._executor.call(
            lambda: self._dispatcher.run_restoring_context(run_with_files), (UNNAMED_REQUEST,)
        )


def resolve_path(folder: Path) -> str:
    """Return the absolute path of a folder, which identifies its deployment."""
    try:
        return os.path.realpath(folder)
    except ValueError as error:
        # The name contains a NUL character or surrogates.
        raise UsageError(f"cannot read {str(folder)!r}: {error}") from error
