"""Results of cases as JUnit XML, which CI systems, ``catkin_test_results`` and ``colcon test-result`` read."""

from pathlib import Path
from typing import Dict, List, Sequence, Tuple
from xml.etree import ElementTree

from ..foundation.displayed_text import printable
from ..foundation.errors import RetalisError
from ..foundation.output_files import write_xml
from .case_definition import Case
from .case_run import CaseResult

FileError = Tuple[Path, RetalisError]
"""A test file that cannot be read, and the error."""


def write_junit_report(
    path: Path, results: Sequence[Tuple[Case, CaseResult]], file_errors: Sequence[FileError] = ()
) -> None:
    """Write the results of cases, in place of an existing file. Each test file is a test suite.

    Raises:
        UsageError: if the file cannot be written.
    """
    by_file: Dict[str, List[Tuple[Case, CaseResult]]] = {}
    for case, result in results:
        by_file.setdefault(str(case.path), []).append((case, result))
    # Without counts, which catkin_test_results would add to those of the suites.
    root = ElementTree.Element("testsuites")
    for file_name, file_results in by_file.items():
        root.append(_make_suite(file_name, file_results))
    for file_path, error in file_errors:
        root.append(_make_error_suite(file_path, error))
    write_xml(path, root, creates_folder=True)


def _make_suite(file_name: str, results: Sequence[Tuple[Case, CaseResult]]) -> ElementTree.Element:
    failure_count = sum(1 for _, result in results if result.failures)
    seconds = sum(result.seconds for _, result in results)
    suite = _create_suite(file_name, len(results), failure_count, 0, seconds)
    for case, result in results:
        element = ElementTree.SubElement(
            suite,
            "testcase",
            classname=_class_name(file_name),
            name=printable(case.name),
            file=file_name,
            line=str(case.place.line),
            time=f"{result.seconds:.3f}",
        )
        if result.failures:
            message = result.failures[0].splitlines()[0]
            failure = ElementTree.SubElement(element, "failure", message=printable(message), type="failure")
            failure.text = printable("\n".join(result.failures))
        if result.incomplete_files:
            text = "\n".join(f"warning: {description}" for description in result.incomplete_files)
            ElementTree.SubElement(element, "system-out").text = text
    return suite


def _make_error_suite(path: Path, error: RetalisError) -> ElementTree.Element:
    suite = _create_suite(str(path), 1, 0, 1, 0.0)
    element = ElementTree.SubElement(
        suite, "testcase", classname=_class_name(str(path)), name="file", file=str(path), time="0"
    )
    problem = ElementTree.SubElement(element, "error", message=printable(error.message), type="error")
    problem.text = printable(str(error))
    return suite


def _create_suite(name: str, tests: int, failures: int, errors: int, seconds: float) -> ElementTree.Element:
    return ElementTree.Element(
        "testsuite",
        name=printable(name),
        tests=str(tests),
        failures=str(failures),
        errors=str(errors),
        skipped="0",
        time=f"{seconds:.3f}",
    )


def _class_name(file_name: str) -> str:
    """Return the name of a file in the form of a class name, by which the tools group cases."""
    return printable(str(Path(file_name).with_suffix("")).strip("./").replace("/", "."))
