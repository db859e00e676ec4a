"""Plugin of pytest: test files are collected, and fixtures provide engines.

pytest loads the plugin wherever the package is installed. It therefore imports the rest of the package only when a
test file or a fixture needs it.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, Iterable, Iterator, List, Optional, Tuple

import pytest

if TYPE_CHECKING:
    from .case_definition import Case
    from .engine_driver import EngineDriver

_SUFFIXES = (".yaml", ".yml")
"""Suffixes of test files, also in `case_file`."""


def pytest_collect_file(file_path: Path, parent: Any) -> Optional["CaseFile"]:
    """Collect test files: ``tests/*.yaml`` and ``*_test.yaml``."""
    if file_path.suffix not in _SUFFIXES:
        return None
    from .case_file import is_case_file, is_foreign_file  # noqa: PLC0415 - see the docstring of the module

    if not is_case_file(file_path) or is_foreign_file(file_path):
        return None
    collected: CaseFile = CaseFile.from_parent(parent, path=file_path)
    return collected


class CaseFile(pytest.File):
    """A test file."""

    def collect(self) -> Iterable["CaseItem"]:
        """Yield the cases of the file."""
        from .case_file import read_case_file  # noqa: PLC0415 - see the docstring of the module

        for case in read_case_file(self.path):
            item: CaseItem = CaseItem.from_parent(self, name=case.name)
            item.case = case
            yield item

    def repr_failure(self, excinfo: Any, style: Any = None) -> Any:
        """Return the error of a file without traceback."""
        return _describe_error(excinfo) or super().repr_failure(excinfo)


class _CaseFailed(Exception):
    """A case has failed; the message lists what differs."""


class CaseItem(pytest.Item):
    """A test case."""

    case: "Case"

    def runtest(self) -> None:
        """Run the case in a process of its own, which ends at the time limit of the case.

        Raises:
            _CaseFailed: if an expectation does not hold.
        """
        from ..messages.type_registry import Definitions  # noqa: PLC0415 - see the docstring of the module
        from .case_processes import run_cases  # noqa: PLC0415

        ((_, result),) = run_cases([self.case], Definitions(), 1)
        if result.failures:
            raise _CaseFailed("\n".join(result.failures))

    def repr_failure(self, excinfo: Any, style: Any = None) -> Any:
        """Return the failures of the case without traceback."""
        return _describe_error(excinfo) or super().repr_failure(excinfo, style)

    def reportinfo(self) -> Tuple[Path, Optional[int], str]:
        """Return the place of the case, whose line counts from 0."""
        return self.path, self.case.place.line - 1, self.name


def _describe_error(excinfo: Any) -> Optional[str]:
    """Return the text of a failed case or of an error of the package; None for other exceptions."""
    from ..foundation.errors import RetalisError  # noqa: PLC0415 - see the docstring of the module

    return str(excinfo.value) if isinstance(excinfo.value, (_CaseFailed, RetalisError)) else None


@pytest.fixture
def retalis_engine() -> Iterator["EngineDriver"]:
    """Provide an engine without program; the test fails if a rule or goal reports an error."""
    from .engine_driver import EngineDriver  # noqa: PLC0415 - see the docstring of the module

    yield from _check_errors(EngineDriver())


@pytest.fixture
def retalis_program(request: "pytest.FixtureRequest") -> Iterator[Callable[..., "EngineDriver"]]:
    """Provide a function that loads a program; the test fails if a program reports an error.

    Without argument, the program is that of the nearest folder above the test module.
    """
    from ..events.program.topic_configuration import find_program_folder  # noqa: PLC0415 - see docstring
    from .engine_driver import EngineDriver  # noqa: PLC0415

    checks: List[Iterator[EngineDriver]] = []

    def load(folder: Optional[Path] = None) -> EngineDriver:
        program = folder or find_program_folder(request.path)
        if program is None:
            pytest.fail("no program: expected goalPredicates.txt or pub_sub.xml in a folder above the test")
        check = _check_errors(EngineDriver(program))
        checks.append(check)
        return next(check)

    yield load
    for check in checks:
        # The rest of the check, after the driver has been provided.
        next(check, None)


def _check_errors(driver: "EngineDriver") -> Iterator["EngineDriver"]:
    with driver.problems.attached():
        yield driver
    if driver.problems.errors:
        pytest.fail("\n".join(driver.problems.errors), pytrace=False)
