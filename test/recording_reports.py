"""Reports of problems for tests that read them."""

from typing import Any, List, Tuple

from retalis import Reports


class RecordingReports(Reports):
    """Reports that are recorded, and not logged.

    Attributes:
        problems: kind of each report, "error" or "warning", and its exception or text.
    """

    def __init__(self) -> None:
        super().__init__()
        self.problems: List[Tuple[str, Any]] = []

    @property
    def recorded_errors(self) -> List[Any]:
        """The reported errors."""
        return [problem for kind, problem in self.problems if kind == "error"]

    @property
    def recorded_warnings(self) -> List[Any]:
        """The reported warnings."""
        return [problem for kind, problem in self.problems if kind == "warning"]

    @property
    def records(self) -> List[Tuple[str, str]]:
        """The kind and text of all reports."""
        return [(kind, str(problem)) for kind, problem in self.problems]

    @property
    def texts(self) -> List[str]:
        """The texts of all reports."""
        return [str(problem) for _, problem in self.problems]

    @property
    def messages(self) -> List[str]:
        """The messages of all reports, without their places."""
        return [getattr(problem, "message", str(problem)) for _, problem in self.problems]

    def error(self, error: Exception, kind: object = None) -> None:
        self.problems.append(("error", error))

    def warning(self, problem: object, kind: object = None, texts: int = 1, once: bool = False) -> None:
        self.problems.append(("warning", problem))
